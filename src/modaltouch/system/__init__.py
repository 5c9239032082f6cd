"""What the computer gives to every room: clocks, locks between processes, signals, and which build this is.

Nothing goes in but what the caller times, locks or waits for; out come instants, locks, signals as exceptions, and the
version that a record names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system.faces import lazily

if TYPE_CHECKING:
    from modaltouch.system.clock import SYSTEM_CLOCK, Clock, VirtualClock
    from modaltouch.system.clock_timing import measure_clock
    from modaltouch.system.files import lock, sync_file
    from modaltouch.system.interruption import Interrupted, Interruption
    from modaltouch.system.provenance import commit, version, versions
else:
    __getattr__ = lazily(
        __name__,
        {
            "clock": "Clock SYSTEM_CLOCK VirtualClock",
            "clock_timing": "measure_clock",
            "files": "lock sync_file",
            "interruption": "Interrupted Interruption",
            "provenance": "commit version versions",
        },
    )

__all__ = [
    "lazily",
    "Clock",
    "Interrupted",
    "Interruption",
    "SYSTEM_CLOCK",
    "VirtualClock",
    "commit",
    "lock",
    "measure_clock",
    "sync_file",
    "version",
    "versions",
]
