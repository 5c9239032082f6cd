"""``python -m modaltouch``, and the ``modaltouch`` command."""

from modaltouch.cli.app import app


def main(arguments: list[str] | None = None) -> None:
    """Run the command line, with the given arguments instead of the process's own."""
    app(arguments)


if __name__ == "__main__":
    main()
