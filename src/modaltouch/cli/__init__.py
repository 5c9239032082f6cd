"""The command line: everything that is printed, every exit status, and nothing else.

Arguments go in; lines, JSON and an exit status come out. The work is done by the other rooms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.cli.commands import app
    from modaltouch.cli.output import BAD_INPUT, INTERRUPTED, print_json
else:
    __getattr__ = lazily(__name__, {"commands": "app", "output": "BAD_INPUT INTERRUPTED print_json"})

__all__ = ["BAD_INPUT", "INTERRUPTED", "app", "print_json"]
