"""The fingers on the beam in a session of any process, read from its log, since no instrument reports them."""

from __future__ import annotations

import contextlib
import json
import threading
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.protocol import Apparatus, Schedule
from modaltouch.stimulus import Finger

KINDS = (b'"event":"start"', b'"event":"placement"', b'"event":"hands_off"', b'"event":"trial"')
"""Lines with the participant and the placements of fingers; the fingers are drawn again after each trial."""


class FollowedSession:
    """The fingers of the latest placement in a session's log, which may still grow or not yet exist.

    Parameters
    ----------
    path : Path
        The log, ``session.jsonl``.
    apparatus : Apparatus
        The apparatus; its section ``twin`` specifies the fingers and their variation between placements and trials.
    """

    def __init__(self, path: Path, apparatus: Apparatus) -> None:
        self._path, self._apparatus = path, apparatus
        self._read = self._n_placements = self._n_trials = 0
        self._who = 0, "", 0
        self._fingers: dict[str, Finger] = {}
        self._placed: dict[str, tuple[Any, float]] = {}
        self._lock = threading.Lock()

    def fingers(self) -> dict[str, Finger]:
        """Return the fingers on the beam by zone; none before the first placement or while hands are off."""
        # Also called from the thread that reports bursts; a line read by both would count twice.
        with self._lock, contextlib.suppress(FileNotFoundError):
            if self._path.stat().st_size > self._read:
                with self._path.open("rb") as log:
                    log.seek(self._read)
                    lines = log.read().splitlines(keepends=True)
                # The last line may be incomplete.
                for line in (each for each in lines if each.endswith(b"\n")):
                    self._read += len(line)
                    if any(kind in line for kind in KINDS):
                        self._take(json.loads(line))
        return self._fingers

    def _take(self, event: dict[str, Any]) -> None:
        if event["event"] == "start":
            self._who = event["seed"], event["participant"], event["session"]
            return
        if event["event"] == "trial":
            self._n_trials += 1
            self._drift()
            return
        self._fingers, self._placed = {}, {}
        if event["event"] == "hands_off":
            return
        self._n_placements += 1
        rng, twin = self._drawn_by(f"placement {self._n_placements}"), self._apparatus.twin
        for zone in (event.get(f"zone_{side}") for side in ("left", "between", "right")):
            if zone in self._apparatus.zones:
                centre = self._apparatus.zones[zone].centre_mm * 1e-3
                if twin.fingers is None:
                    self._fingers[zone] = Finger(centre)
                else:
                    self._placed[zone] = twin.finger_spread.drawn(twin.fingers, rng), centre
        self._drift()

    def _drift(self) -> None:
        """Draw the fingers of a trial around those of its placement."""
        rng, spread = self._drawn_by(f"trial {self._n_trials}"), self._apparatus.twin.finger_trial_spread
        self._fingers |= {zone: spread.drawn(own, rng).at(centre) for zone, (own, centre) in self._placed.items()}

    def _drawn_by(self, what: str) -> np.random.Generator:
        return Schedule.random_generator(*self._who, what)
