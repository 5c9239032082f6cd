"""What is kept: the append-only session log, the only truth, and the BIDS view derived from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.record.audit import audit_session, require_sound
    from modaltouch.record.audit.view import check_view
    from modaltouch.record.chain import (
        Chain,
        RecordError,
        RecordInputError,
        UnreadableLineError,
        read_chain,
        read_object,
    )
    from modaltouch.record.files import move, open_file, prepare_file, replace_file, sync_file
    from modaltouch.record.folders import LOG_NAME, Mode, SessionFolder, check_participant, dataset_of, find_log, locate
    from modaltouch.record.log import RecordExistsError, SessionLog, refuse_existing
    from modaltouch.record.recovery import recover, survey
    from modaltouch.record.session import Session, read_session
    from modaltouch.record.shape import SCHEMA, check_shape
    from modaltouch.record.view import describe_dataset, hold_dataset, list_participants, write_view
else:
    __getattr__ = lazily(
        __name__,
        {
            "audit": "audit_session require_sound",
            "audit.view": "check_view",
            "chain": "Chain RecordError RecordInputError UnreadableLineError read_chain read_object",
            "files": "move open_file prepare_file replace_file sync_file",
            "folders": "LOG_NAME Mode SessionFolder check_participant dataset_of find_log locate",
            "log": "RecordExistsError SessionLog refuse_existing",
            "recovery": "recover survey",
            "session": "Session read_session",
            "shape": "SCHEMA check_shape",
            "view": "describe_dataset hold_dataset list_participants write_view",
        },
    )

__all__ = [
    "Chain",
    "LOG_NAME",
    "Mode",
    "RecordError",
    "RecordExistsError",
    "RecordInputError",
    "SCHEMA",
    "Session",
    "SessionFolder",
    "SessionLog",
    "UnreadableLineError",
    "audit_session",
    "check_participant",
    "check_shape",
    "check_view",
    "dataset_of",
    "describe_dataset",
    "find_log",
    "hold_dataset",
    "list_participants",
    "locate",
    "move",
    "open_file",
    "prepare_file",
    "read_chain",
    "read_object",
    "read_session",
    "recover",
    "refuse_existing",
    "replace_file",
    "require_sound",
    "survey",
    "sync_file",
    "write_view",
]
