"""Where the fingers lie in a session of another process: read in its log, since no instrument tells."""

from __future__ import annotations

import json
from pathlib import Path


class FollowedSession:
    """The latest placement in a session's log, which grows, and may not be there yet.

    Parameters
    ----------
    path : Path
        The log, ``session.jsonl``.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = 0
        self._zones: tuple[str, ...] = ()

    def zones(self) -> tuple[str, ...]:
        """Return the zones under the two fingers; none before the first placement."""
        try:
            if self._path.stat().st_size <= self._read:
                return self._zones
            with self._path.open("rb") as log:
                log.seek(self._read)
                lines = log.read().splitlines(keepends=True)
        except FileNotFoundError:
            return self._zones
        for line in lines:
            if not line.endswith(b"\n"):
                break  # is being written
            self._read += len(line)
            if b'"event":"placement"' in line:
                placement = json.loads(line)
                self._zones = placement.get("zone_left", ""), placement.get("zone_right", "")
        return self._zones
