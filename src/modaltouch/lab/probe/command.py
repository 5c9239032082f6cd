"""``modaltouch fingers probe``: hands off, hands on, and the file of the fingers that lie on the beam."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.identification.estimates import NORMAL_95
from modaltouch.lab.laboratory import SIMULATED, Laboratory, MeasurementProgress, open_laboratory, quiet
from modaltouch.lab.output import rounded, yaml_text
from modaltouch.lab.probe.excitation import Excitation
from modaltouch.preflight import DesignInputs, design, examine
from modaltouch.protocol import InputError
from modaltouch.record import prepare_file, replace_file
from modaltouch.stimulus import Finger, ModalModel, Probe

HEAD = """\
# Fingers as they lay on the beam, written by `modaltouch fingers probe`: name this file in `stimulus.fingers`, or give
# it to `modaltouch check --fingers`. Fingers change with every placement; probe again rather than edit it.
"""

Laid = dict[str, tuple[str, Finger]]
"""Zone and values of fingers, by their names."""

FROM_END = 1e-3
"""From the end of the beam to the vibrometer's spot: there every mode moves [m]."""

PLACE_ERROR = 2e-3
"""How far from the centres of their zones fingers lie on the twin, standard deviation [m]."""


@dataclass(frozen=True)
class ProbeOptions:
    """What is probed.

    Attributes
    ----------
    protocol : Path
        A YAML file, or the name of a shipped protocol.
    out : Path
        The file of fingers; never overwritten.
    rig : str
        ``simulated``, or the generator's VISA address.
    pair : str
        Zones under the fingers, such as ``A-C``; the protocol's first pair if empty.
    hand : str or None
        Hand that is used in ``one_hand``, instead of the protocol's.
    laser : float or None
        Where the vibrometer aims [m from mid-beam]; near the end of the beam that is farther from fingers if not given.
    speed : float
        Highest that the beam is moved at under fingers and laser [m/s].
    seed : int or None
        Of the simulated rig and its fingers, instead of its own.
    """

    protocol: Path
    out: Path
    rig: str = SIMULATED
    pair: str = ""
    hand: Literal["left", "right"] | None = None
    laser: float | None = None
    speed: float = 15e-3
    seed: int | None = None


@dataclass(frozen=True)
class ProbeReport:
    """What was found at each placement.

    Attributes
    ----------
    placements : list of dict
        Plain values of each: its fingers, the misfit, and the level at the focus with its interval.
    fingers : dict
        Values of each finger, by hand.
    text : str
        The file of them.
    out : Path
        Where it goes.
    """

    placements: list[dict[str, Any]]
    fingers: dict[str, Any]
    text: str
    out: Path

    def write(self) -> dict[str, Any]:
        """Write the file, and return the plain values with its path."""
        prepare_file(self.out)
        replace_file(self.out, self.text.encode(), "free the place, or give another file with --out")
        return {"placements": rounded(self.placements, 6), "fingers": self.fingers, "file": str(self.out)}


def probe_fingers(
    options: ProbeOptions, progress: MeasurementProgress | None = None, lay: Callable[[str], None] = quiet
) -> ProbeReport:
    """Measure the fingers of every finger condition of a protocol, on one pair of zones.

    Parameters
    ----------
    options : ProbeOptions
        What is probed.
    progress : MeasurementProgress, optional
        What is called meanwhile.
    lay : callable
        Called with what hands are to do; returns when they have. The twin's need nobody.

    Raises
    ------
    ValueError
        If the protocol has faults, the table lacks modes, or a probe is refused.
    RecordError
        If the file is there already, or cannot be written.
    RigError
        If the rig fails.
    """
    plan = _Plan(options)
    prepare_file(options.out)
    with (
        (progress or MeasurementProgress()).interruptible() as heard,
        open_laboratory(
            plan.apparatus, options.rig, seed=options.seed, repetition="continuous", aim=heard.aim
        ) as bench,
    ):
        bench.load(plan.excitation.burst)
        return plan.carried_out(bench, partial(heard.show, "probes"), lay)


class _Plan:
    """What is probed and where, checked before anything is opened."""

    def __init__(self, options: ProbeOptions) -> None:
        self.options = options
        preflight = examine(options.protocol)
        self.inputs, _ = preflight.sound
        findings = preflight.findings
        if findings.fingers is None:
            findings = findings.under("typical")
        placements, protocol = findings.placements, findings.experiment().protocol
        if placements is None:
            raise InputError(findings.problems)
        if options.hand is not None:
            conditions = protocol.conditions.model_copy(update={"hand": options.hand})
            placements = replace(placements, protocol=protocol.model_copy(update={"conditions": conditions}))
        self.placements = placements
        self.rng = np.random.default_rng([options.seed or 0, 2])
        self.apparatus = findings.with_true_fingers(self.rng)
        self.model = self.apparatus.modal_model()
        Probe.check_table(self.model)
        pairs = {"-".join(pair): pair for pair in protocol.conditions.zone_pairs}
        pair = options.pair or next(iter(pairs))
        if pair not in pairs:
            raise ValueError(f"--pair is {pair!r}; allowed: {', '.join(pairs)}, the pairs of {protocol.protocol}")
        self.conditions = {
            each: placements.expected(each, *pairs[pair]) for each in protocol.conditions.finger_conditions
        }
        expected = [finger for _, finger in next(iter(self.conditions.values())).values()]
        middle = sum(finger.position for finger in expected)
        self.laser = (
            float(np.copysign(self.model.length / 2 - FROM_END, -middle)) if options.laser is None else options.laser
        )
        self.excitation = Excitation.of(self.apparatus, self.model, expected, self.laser, options.speed)

    def lay(self, bench: Laboratory, expected: Laid, lay: Callable[[str], None], words: str) -> None:
        """Have fingers laid on the beam, or taken away."""
        if bench.simulator is None:
            lay(words)
            return
        places = np.array([finger.position for _, finger in expected.values()])
        bench.simulator.touch((places + PLACE_ERROR * self.rng.standard_normal(places.size)).tolist())

    def record(self, bench: Laboratory) -> Probe:
        """A probe of the beam as it is."""
        corner = self.apparatus.acquisition.vibrometer_bandwidth_kHz
        bandwidth = None if corner is None else corner * 1e3
        return Probe.averaged(self.excitation.probe(bench, self.laser, self.options.speed, bandwidth))

    def carried_out(
        self, bench: Laboratory, show: Callable[[int, int], None], lay: Callable[[str], None]
    ) -> ProbeReport:
        """What was found, and the file of it; of a finger that lay on the beam twice, the first time counts."""
        self.lay(bench, {}, lay, "Take all hands off the beam")
        free, fingers = self.record(bench).untouched(self.model), dict[str, tuple[str, Finger]]()
        probes, shown = [], []
        for number, (condition, expected) in enumerate(self.conditions.items(), start=1):
            show(number, 1 + len(self.conditions))
            words = " and ".join(f"the {name} finger on {zone}" for name, (zone, _) in expected.items())
            self.lay(bench, expected, lay, f"Lay {words} ({condition.replace('_', ' ')}), and keep still")
            beam = self.record(bench).touched(free, [finger for _, finger in expected.values()])
            zones = [zone for zone, _ in expected.values()]
            fingers = dict(zip(expected, zip(zones, beam.model.fingers, strict=True), strict=True)) | fingers
            level = predicted_level(self.inputs, beam.model, beam.spread)
            own = beam.covariance[beam.n_beam :, beam.n_beam :].tolist()
            probes.append(
                {
                    "placement": ", ".join(f"{name} on {zone}" for name, (zone, _) in expected.items()),
                    "date": datetime.now().astimezone().isoformat(timespec="seconds"),
                    "mode": bench.mode,
                    "misfit": round(beam.misfit, 3),
                    "level_percent": [round(100 * each / self.inputs.reference, 3) for each in level["interval_mm_s"]],
                    "covariance": [[float(f"{value:.4g}") for value in row] for row in own],
                }
            )
            shown.append(probes[-1] | level)
        show(1 + len(self.conditions), 1 + len(self.conditions))
        hands: dict[str, dict[str, Any]] = {}
        for name, (zone, finger) in fingers.items():
            hand, which = name.split()
            hands.setdefault(hand, {})[which] = _section(finger, self.apparatus.zones[zone].centre_mm)
        about = {"description": f"Measured by `modaltouch fingers probe` for {self.placements.protocol.protocol}"}
        file = self.placements.file.model_validate(about | {"fingers": hands, "probes": probes})
        values = file.model_dump(mode="json", exclude_defaults=True)
        return ProbeReport(shown, values["fingers"], HEAD + yaml_text(values), self.options.out)


def _section(finger: Finger, centre_mm: float) -> dict[str, Any]:
    """Keys of a finger on a zone with its centre at a place of the beam, to five digits."""
    values = {
        "mass_g": finger.mass * 1e3,
        "damping_N_s_per_m": finger.damping,
        "stiffness_N_per_mm": finger.stiffness * 1e-3,
        "contact_width_mm": finger.width * 1e3,
        "offset_mm": finger.position * 1e3 - centre_mm,
    }
    terms = [{"stiffness_N_per_mm": k * 1e-3, "relaxation_ms": time * 1e3} for k, time in finger.maxwell]
    short = [{key: float(f"{value:.5g}") for key, value in each.items()} for each in (values, *terms)]
    return {**short[0], "maxwell": short[1:]}


def predicted_level(
    inputs: DesignInputs, beam: ModalModel, spread: Callable[[Callable[[ModalModel], FloatArray]], FloatArray]
) -> dict[str, Any]:
    """What the design for the fingers that were found does under them, on the beam as it was found.

    Parameters
    ----------
    inputs : DesignInputs
        What it is designed from, but for the fingers.
    beam : ModalModel
        The beam as found, with its fingers.
    spread : callable
        Standard deviations of figures of the beam.

    Returns
    -------
    dict
        ``asked_mm_s``, the highest level; ``level_mm_s``, that at the focus; ``interval_mm_s``, its 95 % interval;
        ``finger_mm_s`` and ``finger_deviation_mm_s``, speeds under the fingers at that instant; ``attainable_mm_s``,
        the level at the limit of the amplifier.
    """
    stimulus, level = design(replace(inputs, fingers=beam.fingers)), inputs.reference * 1e-3
    played, unit = stimulus.touched(()), stimulus.volts_per_code(level)

    def speeds(model: ModalModel) -> FloatArray:
        places = [inputs.centre_mm * 1e-3, *(finger.position for finger in model.fingers)]
        return replace(played, model=model).velocity_at_focus(places, unit)

    speed, deviation = speeds(beam) * 1e3, spread(speeds) * 1e3
    limit = stimulus.amplifier.limit / float(stimulus.peak_drive(level).max())
    return {
        "asked_mm_s": inputs.reference,
        "level_mm_s": float(speed[0]),
        "interval_mm_s": [float(speed[0] + side * NORMAL_95 * deviation[0]) for side in (-1, 1)],
        "finger_mm_s": speed[1:].tolist(),
        "finger_deviation_mm_s": deviation[1:].tolist(),
        "attainable_mm_s": float(speed[0]) * limit,
    }
