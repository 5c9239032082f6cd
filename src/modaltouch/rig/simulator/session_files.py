"""Files between a twin and other processes: the bursts that it played, and the fingers of the session that it follows.

Bursts are written as one line of JSON each; the fingers are read from the session's log, since no instrument reports
them.
"""

from __future__ import annotations

import contextlib
import json
import math
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.protocol import Apparatus, InputError, Schedule
from modaltouch.rig.simulator.timeline import Playback, PlayedBurst
from modaltouch.rig.simulator.twin import Twin
from modaltouch.stimulus import Finger

KINDS = (b'"event":"start"', b'"event":"placement"', b'"event":"hands_off"', b'"event":"trial"')
"""Lines with the participant and the placements of fingers; the fingers are drawn again after each trial."""

TICK = 2e-3
"""Time between two checks for ended bursts [s]."""


class PlayedLog:
    """Appends a line for each burst when it ends, from a separate thread.

    Parameters
    ----------
    path : Path
        The file.
    twin : Twin
        The beam that the bursts move.
    settle : callable
        Passes all bursts that have ended by now to `take`.
    touched : callable
        Returns the fingers on the beam, by zone or position.

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(
        self, path: Path, twin: Twin, settle: Callable[[], None], touched: Callable[[], Mapping[str, Finger]]
    ) -> None:
        try:
            # The file stays open until `close`.
            self._file = path.open("a", encoding="utf-8", newline="\n")
        except OSError as error:
            given = f"a file that cannot be written ({error.strerror})"
            allowed = "a file in a folder you may write to"
            raise InputError.of(path, given, allowed, "give another one with --played") from error
        self._twin = twin
        self._settle = settle
        self._touched = touched
        self._ended: queue.SimpleQueue[tuple[PlayedBurst, bool, Mapping[str, Finger]]] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._keep_writing, daemon=True, name="twin-played")
        self._thread.start()

    def take(self, played: PlayedBurst) -> None:
        """Queue a burst to be written."""
        self._ended.put((played, self._twin.tripped, self._touched()))

    def close(self) -> None:
        """Write the bursts that have ended and close the file."""
        self._closing.set()
        self._thread.join()
        with contextlib.suppress(OSError):
            self._file.close()

    def _keep_writing(self) -> None:
        try:
            while not self._closing.wait(TICK):
                self._settle()
                self._write()
            self._write()
        except OSError as error:
            sys.stderr.write(
                f"{self._file.name}: {error.strerror}; no burst is listed from here on; restart the twin\n"
            )

    def _write(self) -> None:
        while not self._ended.empty():
            played, tripped, touched = self._ended.get()
            self._file.write(json.dumps(self._line(played, touched, tripped=tripped)) + "\n")
            self._file.flush()

    def _line(self, played: PlayedBurst, touched: Mapping[str, Finger], *, tripped: bool) -> dict[str, Any]:
        zones = {name: zone.centre_mm * 1e-3 for name, zone in self._twin.apparatus.zones.items()}
        sent = played.sent if played.whole else tuple(map(_passed, played.sent, played.passed))
        alone = [None if playback is None or tripped else replace(playback, period=math.inf) for playback in sent]
        places = [*zones.values(), *(finger.position for finger in touched.values())]
        peaks = (self._twin.felt(alone, places, touched=tuple(touched.values())) * 1e3).round(4).tolist()
        return {
            "start_s": round(played.start, 9),
            "end_s": round(played.end, 9),
            "whole": played.whole,
            "amplitude_Vpp": [0.0 if playback is None else abs(playback.amplitude) for playback in played.sent],
            "zone_peak_mm_s": dict(zip(zones, peaks, strict=False)),
            "finger_peak_mm_s": dict(zip(touched, peaks[len(zones) :], strict=True)),
            "link": played.link,
        }


def _passed(playback: Playback | None, span: tuple[float, float] | None) -> Playback | None:
    """Return, as one record, the part of a burst between two instants since its first sample [s]."""
    if playback is None or span is None:
        return None
    # Of a record repeated without triggers, only the cycle in which the span ends matters.
    codes = np.frombuffer(playback.record, ">u2").copy()
    before = max(0, math.ceil(span[1] / playback.duration) - 1)
    start, end = ((instant / playback.duration - before) * codes.size for instant in span)
    codes[: max(math.floor(start), 0)] = codes[math.ceil(end) :] = playback.idle_code
    return replace(playback, record=codes.tobytes())


class FollowedSession:
    """The fingers of the latest placement in a session's log, which may still grow or not yet exist.

    Parameters
    ----------
    path : Path
        The log, ``session.jsonl``.
    apparatus : Apparatus
        The apparatus; its section ``twin`` specifies the fingers and their variation between placements and trials.

    Raises
    ------
    InputError
        If the path is that of a folder.
    """

    def __init__(self, path: Path, apparatus: Apparatus) -> None:
        if path.is_dir():
            allowed = "the log of a session, even a future one"
            raise InputError.of(path, "a folder", allowed, "give its session.jsonl with --follow")
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
                        # A line cut by a crash stays in a resumed log.
                        with contextlib.suppress(json.JSONDecodeError, UnicodeDecodeError):
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
        drawn = {zone: spread.drawn(own, rng).at(centre) for zone, (own, centre) in self._placed.items()}
        # A burst that waits to be listed keeps the fingers of its trial.
        self._fingers = self._fingers | drawn

    def _drawn_by(self, what: str) -> np.random.Generator:
        return Schedule.random_generator(*self._who, what)
