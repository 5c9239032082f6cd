"""``python -m modaltouch``, and the ``modaltouch`` command."""

import atexit
import errno
import gc
import os
import sys
from types import SimpleNamespace
from typing import Any, NoReturn

# What loading makes stays: to look for what could go would cost a twentieth of the time.
gc.set_threshold(100_000)
# Nor is it taken apart at the end, which took a sixth of the time of a check: the system frees it at once.
atexit.register(gc.freeze)
# Before NumPy is imported. The matrices are small: further threads of BLAS only wait for each other, busily, and take
# the processor from the window and from the process that watches the outputs.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# No section of a file has a plugin: to look for some would read the metadata of every installed package, and merely to
# load what looks for them loads e-mail, sockets and archives, a twentieth of a check. A pydantic without this module is
# told by the variable.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
sys.modules.setdefault("pydantic.plugin._loader", SimpleNamespace(get_plugins=tuple))  # type: ignore[arg-type]


def _leave() -> NoReturn:
    """End after a Ctrl-C that came while the program was still being loaded."""
    sys.stderr.write("interrupted; nothing was begun\n")
    sys.exit(130)


try:
    import typer

    from modaltouch.cli import BAD_INPUT, INTERRUPTED, app, print_json
except KeyboardInterrupt:
    _leave()

USAGE_ERROR: Any = typer.BadParameter.__base__
"""What typer raises for a wrong option or a missing argument."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line, with the given arguments instead of the process's own."""
    words = sys.argv[1:] if arguments is None else arguments
    _open_streams()
    try:
        try:
            if "--json" not in words:
                app(words)
            sys.exit(_run_as_json(words))
        finally:
            sys.stdout.flush()
    except KeyboardInterrupt:
        _leave()
    except OSError as error:
        if error.filename or error.errno not in (errno.EPIPE, errno.ENOSPC):
            raise
        # What could not be printed would be tried again at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        text = f"the output cannot be written ({error.strerror}); free some space, or give it another place"
        sys.exit(1 if error.errno == errno.EPIPE else text)  # `head` leaves once it has what it wants


def _open_streams() -> None:
    """Have all letters printed, those of no encoding too; what a closed stream is told goes nowhere."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if (stream := getattr(sys, name)) is None:
            # Its number would go to the next file opened, perhaps a record, and with it what libraries complain of.
            os.set_inheritable(number := os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, os.fdopen(number, mode))
        elif mode == "w" and hasattr(stream, "reconfigure"):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")


def _run_as_json(words: list[str]) -> int:
    """Return the exit status; standard output carries one JSON object whatever happens, a wrong option included."""
    try:
        status = app(words, standalone_mode=False)
    except USAGE_ERROR as error:
        print_json({"error": error.format_message(), "problems": []})
        return BAD_INPUT
    except typer.Abort:
        return INTERRUPTED
    return status if isinstance(status, int) else 0


if __name__ == "__main__":
    main()
