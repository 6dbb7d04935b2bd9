"""`python -m gaussray` is the command."""

from gaussray.cli.main import program


if __name__ == "__main__":
    program()
