"""The command `gaussray`."""

from gaussray.cli.main import main as main
