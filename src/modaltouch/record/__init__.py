"""Record of a session: the append-only session log, which is the only original, and the BIDS view derived from it.

`SessionLog` writes the events of a session into its `SessionFolder`, and `Session` reads them. `audit_session` checks a
log against its start record, and `survey` finds what can be recovered from a damaged log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.record.audit import audit_session
    from modaltouch.record.chain import RecordError, RecordExistsError, RecordInputError
    from modaltouch.record.files import move, prepare_file, replace_file
    from modaltouch.record.folders import SessionFolder
    from modaltouch.record.log import SessionLog
    from modaltouch.record.recovery import survey
    from modaltouch.record.session import Session, read_session
else:
    __getattr__ = lazily(
        __name__,
        {
            "audit": "audit_session",
            "chain": "RecordError RecordExistsError RecordInputError",
            "files": "move prepare_file replace_file",
            "folders": "SessionFolder",
            "log": "SessionLog",
            "recovery": "survey",
            "session": "Session read_session",
        },
    )

__all__ = [
    "RecordError",
    "RecordExistsError",
    "RecordInputError",
    "Session",
    "SessionFolder",
    "SessionLog",
    "audit_session",
    "move",
    "prepare_file",
    "read_session",
    "replace_file",
    "survey",
]
