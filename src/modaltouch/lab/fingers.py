"""Measurement of the fingers on a beam, first with hands off, then at each placement, and the file of fingers.

`probe_fingers` is the command ``modaltouch fingers probe``; a session uses the `Prober` alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from modaltouch.lab.common import COMMON_FACTORS, NORMAL_95, FloatArray, rounded, write_yaml
from modaltouch.lab.laboratory import (
    SILENT_PROGRESS,
    SIMULATED,
    Laboratory,
    MeasurementProgress,
    open_laboratory,
    quiet,
)
from modaltouch.lab.probe_excitation import BurstRecord, Excitation
from modaltouch.preflight import DesignInputs, design, examine
from modaltouch.protocol import InputError
from modaltouch.record import prepare_file
from modaltouch.rig import RigError
from modaltouch.stimulus import Finger, ModalModel, Probe, Stimulus

SPEED = 15e-3
"""Default limit of the beam's speed under the fingers and at the vibrometer's spot [m/s]."""

FURTHEST = 10.0
"""Largest distance of a finger from the centre of its zone, as in a file of fingers [mm]."""

FROM_END = 1e-3
"""Distance of the vibrometer's spot from the end of the beam, where every mode moves [m]."""


DOUBTFUL = 4.0
"""Misfit with hands off above which the table or the amplifier may be why fingers do not fit [1]; usually 2."""

LARGEST_DOUBT = 0.2
"""Largest half-width of a level's 95 % interval, relative to the level, for which a file is written [1]."""


class Prober:
    """Measurement of fingers with the same excitation for all placements.

    Parameters
    ----------
    laboratory : Laboratory
        Generator and scope.
    placements : sequence of sequences of Finger
        Expected fingers of each placement.
    laser : float, optional
        Position of the vibrometer's spot [m from mid-beam]; near the end farther from the first placement if not given.
    speed : float
        Highest speed under the fingers and at the spot [m/s].
    """

    def __init__(
        self,
        laboratory: Laboratory,
        placements: Sequence[Sequence[Finger]],
        laser: float | None = None,
        speed: float = SPEED,
    ) -> None:
        apparatus = laboratory.apparatus
        self._laboratory, self._model, self.speed = laboratory, apparatus.modal_model(), speed
        end = self._model.length / 2 - FROM_END
        middle = sum(finger.position for finger in placements[0])
        self.laser = float(np.copysign(end, -middle)) if laser is None else laser
        self._excitation = Excitation.of(apparatus, self._model, placements, self.laser, speed)
        self._slopes: dict[str, FloatArray] = {}
        corner = apparatus.acquisition.vibrometer_bandwidth_kHz
        self._bandwidth = None if corner is None else corner * 1e3

    def hands_off(self) -> dict[str, Any]:
        """Measure the untouched beam, and return the misfit and the modes.

        Raises
        ------
        ValueError
            If something moved or touches the beam, an input was overloaded, or the mode table or the vibrometer's
            sensitivity does not fit the beam.
        RigError
            If the rig fails.
        """
        self._free = self._beam = self._record().untouched(self._model)
        listed = self._model.modal_gain
        strong = np.abs(listed) == np.abs(listed).max(axis=1, keepdims=True)
        common = float(np.median(self._free.model.modal_gain[strong] / listed[strong]))
        low, high = COMMON_FACTORS
        if not low <= common <= high:
            raise ValueError(
                f"the modes move {common:.2f} times as fast as their listed gains predict: allowed {low:g} to "
                f"{high:g}; check that the vibrometer is set to the listed `acquisition.sensitivity_mm_s_per_V`, its "
                f"spot is {self.laser * 1e3:+g} mm from mid-beam and the amplifier is set to its `amplifier.gain`, or "
                "identify the beam again with `modaltouch identify --modes all`"
            )
        return {"misfit": round(self._beam.misfit, 3), "modes": self._modes(self._beam.model)}

    def hands_on(self, expected: Mapping[str, tuple[str, Finger]]) -> dict[str, Any]:
        """Measure the fingers on the beam, after `hands_off`.

        Parameters
        ----------
        expected : mapping of str to (str, Finger)
            Zone and approximate values of each finger, by name.

        Returns
        -------
        dict
            ``fingers``: ``zone`` and file keys of each finger, by name; ``covariance`` of the fingers, as in a file of
            fingers; ``misfit``; and ``modes`` of the beam.

        Raises
        ------
        ValueError
            If the fingers moved, an input was overloaded, a finger is not on its zone, or no impedance fits them.
        RigError
            If the rig fails.
        """
        try:
            self._beam = beam = self._record().touched(self._free, [finger for _, finger in expected.values()])
        except ValueError as error:
            raise ValueError(f"{error}{self.doubt}") from error
        self._laid = {name: zone for name, (zone, _) in expected.items()}
        self._slopes.clear()
        covariance = beam.covariance[beam.n_beam :, beam.n_beam :].tolist()
        return {
            **self._found(beam.model, beam.misfit),
            "covariance": [[float(f"{value:.4g}") for value in row] for row in covariance],
        }

    @property
    def doubt(self) -> str:
        """Remedy for a table that barely describes the untouched beam, added to a refusal; empty if it fits."""
        if self._free.misfit <= DOUBTFUL:
            return ""
        remedy = "enter the corner of a slow amplifier as `amplifier.bandwidth_kHz`, or identify the beam again"
        return f"; with hands off the misfit was {self._free.misfit:.1f}, usually below {DOUBTFUL:g}: {remedy}"

    def predict(self, inputs: DesignInputs, stimulus: Stimulus) -> dict[str, Any]:
        """Predict the effect of a stimulus on the beam with the identified fingers.

        Returns
        -------
        dict
            ``asked_mm_s``, the highest level; ``level_mm_s``, the velocity at the focus at the focusing instant, and
            ``interval_mm_s``, its 95 % interval; ``below_1_kHz_mm_s``, the peak at the focus below that frequency;
            ``finger_peak_mm_s`` and ``finger_interval_mm_s``, the peak speeds under the fingers, from the left end of
            the beam, and their intervals.
        """
        model, figures = self._beam.model, self._figures(inputs, stimulus, self._beam.model)
        slopes = self._slopes[stimulus.burst.content_hash] = self._beam.slopes(figures)
        speed, half = figures(model), NORMAL_95 * self._beam.spread(slopes)
        played, unit = replace(stimulus.touched(()), model=model), stimulus.volts_per_code(inputs.reference * 1e-3)
        intervals = np.stack([speed - half, speed + half], axis=1).tolist()
        return dict(
            rounded(
                {
                    "asked_mm_s": inputs.reference,
                    "level_mm_s": float(speed[0]),
                    "interval_mm_s": intervals[0],
                    "below_1_kHz_mm_s": played.peak_below(1e3, inputs.centre_mm * 1e-3, unit) * 1e3,
                    "finger_peak_mm_s": speed[1:].tolist(),
                    "finger_interval_mm_s": intervals[1:],
                },
                6,
            )
        )

    def arm(self, inputs: DesignInputs, stimulus: Stimulus, level: float) -> None:
        """Arm the scope to record the next burst, after `predict`; returns at once.

        Parameters
        ----------
        inputs, stimulus
            The stimulus to be played, and the inputs from which it was designed.
        level : float
            Level at which it is played [mm/s].

        Raises
        ------
        RigError
            If the scope fails.
        """
        scope, burst = self._laboratory.scope, BurstRecord(stimulus, level * 1e-3, self._model.natural_frequency)
        played = replace(stimulus.touched(()), model=self._beam.model)
        fastest = float(played.peak_velocity([self.laser], stimulus.volts_per_code(level * 1e-3))[0])
        scope.configure(burst.acquisition(min(fastest, self._laboratory.apparatus.acquisition.range_mm_s * 1e-3)))
        scope.arm()
        self._armed = burst, inputs, level / inputs.reference

    def delivered(self) -> dict[str, Any]:
        """Identify the fingers during the burst for which the scope was armed.

        Returns
        -------
        dict
            ``fingers``, ``misfit`` and ``modes`` as from `hands_on`; ``half_width_mm_s``, the half-width of the 95 %
            interval of the peak speed under the finger on each zone.

        Raises
        ------
        ValueError
            If no drift of the fingers explains the record.
        RigError
            If no burst arrived, or the rig fails.
        """
        burst, inputs, share = self._armed
        beam = burst.probe(self._laboratory.scope.fetch(self.laser), self._bandwidth).later(self._beam)
        known = self._slopes[burst.stimulus.burst.content_hash]
        slopes = beam.slopes(self._figures(inputs, burst.stimulus, beam.model), known)
        half = NORMAL_95 * share * beam.spread(slopes)[1:]
        widths = dict(zip(self._laid.values(), (float(f"{each:.4g}") for each in half), strict=True))
        return {**self._found(beam.model, beam.misfit), "half_width_mm_s": widths}

    def _figures(
        self, inputs: DesignInputs, stimulus: Stimulus, near: ModalModel
    ) -> Callable[[ModalModel], FloatArray]:
        """Return a function from a model near a given one to its level at the focus and finger peak speeds [mm/s]."""
        unit, played = stimulus.volts_per_code(inputs.reference * 1e-3), replace(stimulus.touched(()), model=near)
        # The time derivative is zero at a peak, so the peak changes as the velocity at that instant.
        peaks = played.peak_instants([finger.position for finger in near.fingers], unit)
        instants = [stimulus.timing.focusing_instant, *peaks.tolist()]

        def figures(model: ModalModel) -> FloatArray:
            places = [inputs.centre_mm * 1e-3, *(finger.position for finger in model.fingers)]
            return np.abs(replace(played, model=model).velocity_at(places, instants, unit)) * 1e3

        return figures

    def _found(self, model: ModalModel, misfit: float) -> dict[str, Any]:
        """Return misfit, fingers with their zones, by name, and modes of the beam."""
        zones, fingers = self._laboratory.apparatus.zones, {}
        for (name, zone), finger in zip(self._laid.items(), model.fingers, strict=True):
            fingers[name] = {"zone": zone, **_section(finger, zones[zone].centre_mm)}
            if abs(offset := fingers[name]["offset_mm"]) > FURTHEST:
                raise ValueError(
                    f"the {name} finger lies {offset:+.1f} mm from the centre of zone {zone}: allowed at most "
                    f"{FURTHEST:g} mm; place it there and probe again"
                )
        return {"misfit": round(misfit, 3), "fingers": fingers, "modes": self._modes(model)}

    def _record(self) -> Probe:
        return Probe.averaged(self._excitation.probe(self._laboratory, self.laser, self.speed, self._bandwidth))

    def _modes(self, model: ModalModel) -> list[dict[str, Any]]:
        """Return the values of each mode by the keys of an apparatus file, to seven digits."""
        sets = self._laboratory.apparatus.actuator_sets
        return [
            {
                "natural_frequency_Hz": float(f"{frequency:.7g}"),
                "damping_ratio": float(f"{ratio:.7g}"),
                "gain_mm_s2_per_V": {
                    name: float(f"{gain[actuators.channel - 1] * 1e3:.7g}") for name, actuators in sets.items()
                },
            }
            for frequency, ratio, gain in zip(
                model.natural_frequency, model.damping_ratio, model.modal_gain, strict=True
            )
        ]


def _section(finger: Finger, centre_mm: float) -> dict[str, Any]:
    """Return the values of a finger by the keys of a file of fingers, to five digits; the offset is from its zone."""
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


HEAD = """\
# Fingers as measured on the beam by `modaltouch fingers probe`: name this file in `stimulus.fingers`, or give
# it to `modaltouch check --fingers`. Fingers change with every placement; probe again rather than edit it.
"""

PLACE_ERROR = 2e-3
"""Standard deviation of the twin's fingers from their expected positions [m]."""


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
    record: Path | None = None,
    progress: MeasurementProgress = SILENT_PROGRESS,
    lay: Callable[[str], None] = quiet,
) -> dict[str, Any]:
    """Measure the fingers of every finger condition of a protocol on one pair of zones, and write their file.

    Parameters
    ----------
    protocol, out : Path
        A YAML file or the name of a shipped protocol, and the file of fingers, which is never overwritten.
    rig, pair : str
        ``simulated``, or the generator's VISA address; zones under the fingers, such as ``A-C``, by default the
        protocol's first pair.
    hand : str, optional
        Hand to use in ``one_hand``, instead of the protocol's.
    laser, speed : float
        Position of the vibrometer's spot [m], by default near the end of the beam farther from the fingers, and the
        highest speed there and under the fingers [m/s].
    seed : int, optional
        Seed of the simulated rig and its fingers, in place of the one in the apparatus file.
    record : Path, optional
        Folder into which another scope saves its records as files; a PicoScope is used if not given.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.
    lay : callable
        Called with an instruction to place or lift the hands; returns once that is done. Not called for the twin.

    Returns
    -------
    dict
        ``placements``: each with the level at the focus and its interval; ``fingers``, and ``file``, their path;
        ``sensitivity_uncertainty_percent``, common to all levels and not included in their intervals.

    Raises
    ------
    ValueError
        If the protocol has faults, or modes are missing from the table.
    RecordError
        If the file exists already or cannot be written.
    RigError
        If the rig fails, or a probe is refused.
    """
    plan = _Plan(protocol, pair, hand, seed)
    prepare_file(out)
    with progress.interruptible() as heard, _open(plan, rig, seed, record, heard) as bench:
        try:
            return plan.carried_out(Prober(bench, plan.fingers, laser, speed), bench, lay, out)
        except ValueError as error:
            raise RigError(f"{error}; the outputs are off") from error


def _open(
    plan: _Plan, rig: str, seed: int | None, record: Path | None, progress: MeasurementProgress
) -> AbstractContextManager[Laboratory]:
    """Open the laboratory, with a scope whose records arrive in a folder if one is given."""
    # A session that measures fingers reads no files.
    from modaltouch.lab.recorded_files import RecordedFiles

    scope = RecordedFiles(record, plan.apparatus, progress) if record else None
    return open_laboratory(plan.apparatus, rig, progress, seed=seed, scope=scope)


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
        self.apparatus.modal_model().require_all_modes()
        pairs = {"-".join(zones): zones for zones in protocol.conditions.contacts}
        pair = pair or next(iter(pairs))
        if pair not in pairs:
            raise ValueError(f"--pair is {pair!r}; allowed: {', '.join(pairs)}, the zones of {protocol.protocol}")
        self.conditions = {
            each: placements.expected(each, pairs[pair]) for each in protocol.conditions.finger_conditions
        }
        self.fingers = [[finger for _, finger in expected.values()] for expected in self.conditions.values()]

    def lay(
        self, bench: Laboratory, expected: Mapping[str, tuple[str, Finger]], lay: Callable[[str], None], words: str
    ) -> None:
        """Have fingers placed on the beam, or lifted if none is expected."""
        if bench.simulator is None:
            lay(words)
        else:
            off = PLACE_ERROR * self.rng.standard_normal(len(expected))
            bench.simulator.touch(
                [finger.position + by for (_, finger), by in zip(expected.values(), off, strict=True)]
            )

    def carried_out(self, prober: Prober, bench: Laboratory, lay: Callable[[str], None], out: Path) -> dict[str, Any]:
        """Probe all placements and write the file; the first result counts if a finger is measured repeatedly."""
        self.lay(bench, {}, lay, "Take all hands off the beam")
        prober.hands_off()
        hands: dict[str, dict[str, Any]] = {}
        probes, shown = [], []
        for number, (condition, expected) in enumerate(self.conditions.items(), start=1):
            bench.progress.show("probes", number, 1 + len(self.conditions))
            words = " and ".join(f"the {name} finger on {zone}" for name, (zone, _) in expected.items())
            self.lay(bench, expected, lay, f"Place {words} ({condition.replace('_', ' ')}) and keep still")
            found = prober.hands_on(expected)
            own = replace(self.inputs, fingers=tuple(self.placements.measured(found["fingers"]).values()))
            for name, values in found["fingers"].items():
                hand, which = name.split()
                del values["zone"]
                hands.setdefault(hand, {}).setdefault(which, values)
            stimulus = design(own)
            level = prober.predict(own, stimulus)
            half = float(np.ptp(level["interval_mm_s"])) / 2 / own.reference
            if half > LARGEST_DOUBT:
                known = f"the level under these fingers is known to within {half:.0%}: allowed {LARGEST_DOUBT:.0%}"
                raise ValueError(f"{known}; place {words} again and keep still{prober.doubt}")
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
        about = f"Measured by `modaltouch fingers probe` for {self.placements.protocol.protocol}"
        file = self.placements.file.model_validate({"description": about, "fingers": hands, "probes": probes})
        values = file.model_dump(mode="json", exclude_defaults=True)
        write_yaml(out, HEAD, values)
        return {
            "placements": rounded(shown, 6),
            "fingers": values["fingers"],
            "sensitivity_uncertainty_percent": self.apparatus.acquisition.sensitivity_uncertainty_percent,
            "file": str(out),
        }
