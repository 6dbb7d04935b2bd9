"""`python -m gaussray` is the command."""

from gaussray.cli.main import main


if __name__ == "__main__":
    main()
