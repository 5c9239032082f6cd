"""``python -m modaltouch``, and the ``modaltouch`` command."""

import sys
from typing import Any

import typer

from modaltouch.cli.app import app
from modaltouch.cli.faults import BAD_INPUT, INTERRUPTED, print_json

USAGE_ERROR: Any = typer.BadParameter.__base__
"""What typer raises for a wrong option or a missing argument."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line, with the given arguments instead of the process's own."""
    words = sys.argv[1:] if arguments is None else arguments
    if "--json" not in words:
        app(words)
    # Standard output carries one JSON object whatever happens, so a wrong option is told there too.
    try:
        status = app(words, standalone_mode=False)
    except USAGE_ERROR as error:
        print_json({"error": error.format_message(), "problems": []})
        sys.exit(BAD_INPUT)
    except typer.Abort:
        sys.exit(INTERRUPTED)
    sys.exit(status if isinstance(status, int) else 0)


if __name__ == "__main__":
    main()
