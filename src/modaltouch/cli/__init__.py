"""The command line: options, printed output and exit statuses.

Commands take arguments and produce lines, JSON and an exit status. The other packages do the work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.cli.commands import app
    from modaltouch.cli.common import BAD_INPUT, INTERRUPTED, print_json
else:
    __getattr__ = lazily(__name__, {"commands": "app", "common": "BAD_INPUT INTERRUPTED print_json"})

__all__ = ["BAD_INPUT", "INTERRUPTED", "app", "print_json"]
