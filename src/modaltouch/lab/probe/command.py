"""The command ``modaltouch fingers probe``: measurements with hands off and hands on, and the file of fingers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from modaltouch.lab.laboratory import (
    SILENT_PROGRESS,
    SIMULATED,
    Laboratory,
    MeasurementProgress,
    open_laboratory,
    quiet,
)
from modaltouch.lab.output import rounded, write_yaml
from modaltouch.lab.probe.prober import SPEED, Prober
from modaltouch.preflight import design, examine
from modaltouch.protocol import InputError
from modaltouch.record import prepare_file
from modaltouch.stimulus import Finger, Probe

HEAD = """\
# Fingers as measured on the beam by `modaltouch fingers probe`: name this file in `stimulus.fingers`, or give
# it to `modaltouch check --fingers`. Fingers change with every placement; probe again rather than edit it.
"""

Laid = dict[str, tuple[str, Finger]]
"""Zone and values of fingers, by name."""

PLACE_ERROR = 2e-3
"""Standard deviation of the twin's fingers from their expected positions [m]."""


@dataclass(frozen=True)
class ProbeReport:
    """The results of every placement.

    Attributes
    ----------
    placements : list of dict
        Plain values of each placement: its fingers, the misfit, and the level at the focus with its interval.
    file : dict
        Contents of the file of fingers.
    out : Path
        The file.
    sensitivity_percent : float
        Half-width of the 95 % interval of the vibrometer's sensitivity, common to all levels and not included in their
        intervals [%].
    """

    placements: list[dict[str, Any]]
    file: dict[str, Any]
    out: Path
    sensitivity_percent: float

    def write(self) -> dict[str, Any]:
        """Write the file, and return the plain values with its path."""
        write_yaml(self.out, HEAD, self.file)
        return {
            "placements": rounded(self.placements, 6),
            "fingers": self.file["fingers"],
            "sensitivity_uncertainty_percent": self.sensitivity_percent,
            "file": str(self.out),
        }


def probe_fingers(
    protocol: Path,
    out: Path,
    *,
    rig: str = SIMULATED,
    pair: str = "",
    hand: Literal["left", "right"] | None = None,
    laser: float | None = None,
    speed: float = SPEED,
    seed: int | None = None,
    progress: MeasurementProgress = SILENT_PROGRESS,
    lay: Callable[[str], None] = quiet,
) -> ProbeReport:
    """Measure the fingers of every finger condition of a protocol on one pair of zones.

    Parameters
    ----------
    protocol, out : Path
        A YAML file or the name of a shipped protocol, and the file of fingers, which is never overwritten.
    rig : str
        ``simulated``, or the generator's VISA address.
    pair : str
        Zones under the fingers, such as ``A-C``; the protocol's first pair if empty.
    hand : str, optional
        Hand to use in ``one_hand``, instead of the protocol's.
    laser, speed : float
        Position of the vibrometer's spot [m], by default near the end of the beam farther from the fingers, and the
        highest speed there and under the fingers [m/s].
    seed : int, optional
        Seed of the simulated rig and its fingers, in place of the one in the apparatus file.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.
    lay : callable
        Called with an instruction to place or lift the hands; returns once that is done. Not called for the twin.

    Raises
    ------
    ValueError
        If the protocol has faults, modes are missing from the table, or a probe is refused.
    RecordError
        If the file exists already or cannot be written.
    RigError
        If the rig fails.
    """
    plan = _Plan(protocol, pair, hand, seed)
    prepare_file(out)
    with (
        progress.interruptible() as heard,
        open_laboratory(plan.apparatus, rig, heard, seed=seed) as bench,
    ):
        prober = Prober(bench, plan.fingers, laser, speed)
        return plan.carried_out(prober, bench, lay, out)


class _Plan:
    """The placements to probe, checked before any instrument is opened."""

    def __init__(self, file: Path, pair: str, hand: Literal["left", "right"] | None, seed: int | None) -> None:
        preflight = examine(file)
        self.inputs, _ = preflight.sound
        findings = preflight.findings
        if findings.fingers is None:
            findings = findings.under("typical")
        placements, protocol = findings.placements, findings.experiment().protocol
        if placements is None:
            raise InputError(findings.problems)
        if hand is not None:
            conditions = protocol.conditions.model_copy(update={"hand": hand})
            placements = replace(placements, protocol=protocol.model_copy(update={"conditions": conditions}))
        self.placements = placements
        self.rng = np.random.default_rng([seed or 0, 2])
        self.apparatus = findings.with_true_fingers(self.rng)
        Probe.check_table(self.apparatus.modal_model())
        pairs = {"-".join(zones): zones for zones in protocol.conditions.contacts}
        pair = pair or next(iter(pairs))
        if pair not in pairs:
            raise ValueError(f"--pair is {pair!r}; allowed: {', '.join(pairs)}, the zones of {protocol.protocol}")
        self.conditions = {
            each: placements.expected(each, pairs[pair]) for each in protocol.conditions.finger_conditions
        }
        self.fingers = [[finger for _, finger in expected.values()] for expected in self.conditions.values()]

    def lay(self, bench: Laboratory, expected: Laid, lay: Callable[[str], None], words: str) -> None:
        """Have fingers placed on the beam, or lifted if none is expected."""
        if bench.simulator is None:
            lay(words)
        else:
            places = np.array([finger.position for _, finger in expected.values()])
            bench.simulator.touch((places + PLACE_ERROR * self.rng.standard_normal(places.size)).tolist())

    def carried_out(self, prober: Prober, bench: Laboratory, lay: Callable[[str], None], out: Path) -> ProbeReport:
        """Probe all placements and return the report; the first result counts if a finger is measured repeatedly."""
        self.lay(bench, {}, lay, "Take all hands off the beam")
        prober.hands_off()
        hands: dict[str, dict[str, Any]] = {}
        probes, shown = [], []
        for number, (condition, expected) in enumerate(self.conditions.items(), start=1):
            bench.progress.show("probes", number, 1 + len(self.conditions))
            words = " and ".join(f"the {name} finger on {zone}" for name, (zone, _) in expected.items())
            self.lay(bench, expected, lay, f"Place {words} ({condition.replace('_', ' ')}) and keep still")
            found = prober.hands_on(expected)
            for name, values in found["fingers"].items():
                hand, which = name.split()
                del values["zone"]
                hands.setdefault(hand, {}).setdefault(which, values)
            own = replace(self.inputs, fingers=prober.fingers)
            stimulus = design(own)
            level = prober.predict(own, stimulus)
            room = stimulus.amplifier.limit / float(stimulus.peak_drive(own.reference * 1e-3).max())
            probes.append(
                {
                    "placement": ", ".join(f"{name} on {zone}" for name, (zone, _) in expected.items()),
                    "date": datetime.now().astimezone().isoformat(timespec="seconds"),
                    "mode": bench.mode,
                    "misfit": found["misfit"],
                    "level_percent": [round(100 * each / own.reference, 3) for each in level["interval_mm_s"]],
                    "covariance": found["covariance"],
                }
            )
            shown.append(probes[-1] | level | {"attainable_mm_s": level["level_mm_s"] * room})
        bench.progress.show("probes", 1 + len(self.conditions), 1 + len(self.conditions))
        about = {"description": f"Measured by `modaltouch fingers probe` for {self.placements.protocol.protocol}"}
        file = self.placements.file.model_validate(about | {"fingers": hands, "probes": probes})
        values = file.model_dump(mode="json", exclude_defaults=True)
        doubt = self.apparatus.acquisition.sensitivity_uncertainty_percent
        return ProbeReport(shown, values, out, doubt)
