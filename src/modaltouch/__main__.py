"""``python -m modaltouch``, and the ``modaltouch`` command."""

from modaltouch.cli.app import app


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
