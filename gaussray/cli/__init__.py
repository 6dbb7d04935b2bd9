"""The command line program `gaussray`."""

from gaussray.cli.main import main as main
