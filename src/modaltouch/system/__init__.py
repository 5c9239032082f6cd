"""What the computer gives to every room: clocks, locks between processes, signals, and which build this is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system.faces import lazily

if TYPE_CHECKING:
    from modaltouch.system.clock import SYSTEM_CLOCK, Clock, VirtualClock, measure_clock
    from modaltouch.system.interruption import Interrupted, Interruption
    from modaltouch.system.locking import LOCK_NAME, hold, is_locked, lock
    from modaltouch.system.provenance import boot, commit, version, versions
else:
    __getattr__ = lazily(
        __name__,
        {
            "clock": "Clock SYSTEM_CLOCK VirtualClock measure_clock",
            "interruption": "Interrupted Interruption",
            "locking": "LOCK_NAME hold is_locked lock",
            "provenance": "boot commit version versions",
        },
    )

__all__ = [
    "lazily",
    "Clock",
    "Interrupted",
    "Interruption",
    "LOCK_NAME",
    "SYSTEM_CLOCK",
    "VirtualClock",
    "boot",
    "commit",
    "hold",
    "is_locked",
    "lock",
    "measure_clock",
    "version",
    "versions",
]
