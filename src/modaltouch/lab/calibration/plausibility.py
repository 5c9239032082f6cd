"""Plausibility checks of a calibration.

Measurements that cannot come from the rig of the apparatus file are refused. A calibration whose errors are not shown
to be within its limits is marked with the cause.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from modaltouch.lab.calibration.decay import Decay
from modaltouch.lab.calibration.file import CERTAIN, CalibrationResult, Level
from modaltouch.lab.calibration.plant import DriveDelay, ModalState, Plant, modal_swings, peak_shortfall
from modaltouch.lab.common import GAINS, NORMAL_95, FloatArray
from modaltouch.protocol import Protocol
from modaltouch.rig import Recording, RigError
from modaltouch.stimulus import ModalModel

SPEEDS = (0.6, 1.6)
"""Plausible range of measured over listed gain, common to all modes [1]; outside, a setting differs from the file."""

ALIKE = 0.2
"""Median relative deviation of gains from a common factor, below which the factor is that of the vibrometer [1]."""

NOTHING = 0.02
"""Ratio of measured to commanded drive below which the drive is missing [1]."""

LARGEST_REST = 0.3
"""Largest part of the measured drive not explained by delay, lag and gain [1]; noise alone amounts to a twentieth."""

LEAST_CERTAINTY = 8.0
"""Minimum amplitude of a mode, in standard errors [1]."""

FURTHEST = 0.05
"""Largest relative deviation of a natural frequency from the listed one [1]; beyond, it may be that of another mode."""

MOST_LACKING = 0.5
"""Largest shortfall of the measured drive's peaks for the listed stimulus [1] (see `LARGEST_SHORTFALL` for the
calibrated one), and largest deviation of a point's velocity from that expected from the other points [1]."""

CLEARLY_LACKING = 0.1
"""The same where the gains of the modes differ from the table, for which the shortfall is then the cause [1]."""

MOST_MOVED = 0.1e-6
"""Largest change of the trigger latency since the identification [s]; it changes w eta by up to 0.16 mm/s."""

LARGEST_STRAIN = 0.2
"""Largest change of a natural frequency between the probes, or since, over the mode's decay rate [1]."""

LARGEST_EXCESS = 0.04
"""Largest relative deviation of the speed at the focus from that expected from the other points [1]."""

MOST_DISPROPORTION = 0.02
"""Largest relative deviation of the modes' speed at half a level from half their speed at the level [1]."""

HYSTERESIS = (
    "the beam is not linear, though the amplifier is: its actuators have hysteresis; bring the levels closer "
    "together, or calibrate one protocol for each level"
)

CHANGING = (
    "the outputs are off; the beam drifts, its frequencies change with the amplitude, or the records of a point are "
    "late or clipped: let beam, patches and amplifier reach a steady temperature, check the patches, the suspension, "
    "the trigger and the vibrometer's range, and calibrate again"
)

LARGEST_PHASE = 0.2
"""Largest phase not explained by the vibrometer's delay and lag [rad]."""

LEAST_COHERENCE = 0.3
"""Minimum fraction of a velocity's power that repeats with every burst [1]."""

FAR_OFF, MOST_FAR_OFF = 6.0, 5e-5
"""Standard deviations above which a sample is a gap or a shock, and largest plausible fraction of such samples [1]."""


def refuse_implausible_drive(drive: DriveDelay) -> None:
    """Refuse a measured drive that does not match the commanded drive after the amplifier."""
    believed = drive.rest <= LARGEST_REST
    for number, gain in enumerate(drive.gain, start=1):
        if (believed or abs(gain) < NOTHING) and not GAINS[0] <= gain <= GAINS[1]:
            raise RigError(
                f"the drive measured at the beam is {gain:.2f} times what output {number} commands: allowed "
                f"{GAINS[0]:g} to {GAINS[1]:g}; the outputs are off; check that the amplifier is on, its gain matches "
                "the apparatus file, the probe is at its output and not inverted, "
                "`acquisition.probe_attenuation` is right, and the scope is triggered by the start of a burst"
            )
    if not believed:
        raise RigError(
            f"{drive.rest:.0%} of the drive measured at the beam is not the commanded drive with a delay and a lag: "
            f"allowed {LARGEST_REST:.0%}; the outputs are off; check that the probes are at the amplifier's "
            "outputs, that it does not saturate, that the scope is triggered by the start of a burst, and that its "
            "clock runs at the generator's rate"
        )


def refuse_changing_beam(decays: Sequence[Decay], shapes: FloatArray) -> None:
    """Refuse a beam whose natural frequencies differ between two fits of decays with the same poles."""
    n, size = len(shapes), np.sqrt((shapes**2).sum(axis=1))
    for one, other in itertools.pairwise(decays):
        moved = np.abs(one.pole_error.imag - other.pole_error.imag)[:n] / -one.pole.real[:n]
        # A change is significant only in modes that both bursts excite well.
        least = np.minimum(
            *(np.abs(modal_swings(each, shapes)) * size / np.maximum(each.spread[:n], 1e-30) for each in (one, other))
        )
        doubtful = (moved > LARGEST_STRAIN) & (moved * least > 5 * 2 * np.sqrt(2))
        if doubtful.any():
            mode = int(np.argmax(np.where(doubtful, moved, 0.0)))
            raise RigError(
                f"the mode near {one.pole.imag[mode] / (2 * np.pi):.0f} Hz moved by {moved[mode]:.0%} of its half "
                f"bandwidth between two measurements: allowed {LARGEST_STRAIN:.0%}; {CHANGING}"
            )


def refuse_tones(decay: Decay, n_listed: int, length: float) -> None:
    """Refuse records of a given length [s] that contain a tone which does not decay after the burst."""
    # Over a record the slowest mode decays by 1.2 time constants.
    for pole in decay.pole[n_listed:][-decay.pole.real[n_listed:] * length < 0.1]:
        raise RigError(
            f"the velocity holds a tone near {abs(pole.imag) / (2 * np.pi):.0f} Hz that does not decay after the "
            "burst; the outputs are off; below 500 Hz it is mains hum or a swinging beam: connect vibrometer, scope "
            "and amplifier to one earth, keep cables away from transformers, and let the beam come to rest; above, a "
            "disturbance, such as a fan or a switching power supply: find it and switch it off; calibrate again"
        )


def refuse_odd_point(decay: Decay, shapes: FloatArray, points: FloatArray) -> None:
    """Refuse a point whose velocity disagrees with the prediction from the other points, such as an inverted one."""
    seen = decay.residue[: len(shapes)].reshape(len(shapes), -1, points.size)
    here = shapes[:, None]
    others = ((seen * here).sum(axis=2, keepdims=True) - seen * here) / ((here**2).sum(axis=2, keepdims=True) - here**2)
    expected = others * here
    factor = (np.conj(expected) * seen).real.sum(axis=(0, 1)) / (np.abs(expected) ** 2).sum(axis=(0, 1))
    factor = factor / np.median(factor)
    odd = int(np.abs(factor - 1).argmax())
    if abs(factor[odd] - 1) > MOST_LACKING:
        raise RigError(
            f"at {points[odd] * 1e3:g} mm the modes move {factor[odd]:.2f} times as fast as the other points predict: "
            f"allowed {1 - MOST_LACKING:g} to {1 + MOST_LACKING:g}; the outputs are off; check the sensor there, its "
            "sign, range and place, and whether its records are late; measure again"
        )


def refuse_implausible_plant(plant: Plant, listed: ModalModel, margin: float) -> None:
    """Refuse modes that are weak or differ from the table, and a vibrometer with other filters or a long delay."""
    found = plant.model
    for row, label in enumerate(listed.label):
        if not plant.certainty[row] >= LEAST_CERTAINTY:
            raise RigError(
                f"mode {label} at {listed.natural_frequency[row]:.0f} Hz is not seen: it rises above the noise by "
                f"{plant.certainty[row]:.1f} standard errors, and needs {LEAST_CERTAINTY:g}; the outputs are off; "
                "check that the vibrometer is focused on the beam and that its signal reaches the scope"
            )
        moved = found.natural_frequency[row] / listed.natural_frequency[row] - 1
        if abs(moved) > FURTHEST:
            raise RigError(
                f"mode {label} was found at {found.natural_frequency[row]:.0f} Hz, {moved:+.1%} from the listed "
                f"{listed.natural_frequency[row]:.0f} Hz: allowed {FURTHEST:.0%}; the outputs are off; identify the "
                f"beam again with `modaltouch identify`"
            )
    vibrometer = plant.vibrometer
    if vibrometer.rest > LARGEST_PHASE:
        raise RigError(
            f"the modes' phases differ by {vibrometer.rest:.2f} rad from those of a delay and a low-pass: allowed "
            f"{LARGEST_PHASE:g} rad; the outputs are off; check which filters of the vibrometer are on"
        )
    if vibrometer.delay + 10 * vibrometer.lag > margin:
        raise RigError(
            f"the vibrometer is {vibrometer.delay * 1e6:.0f} us late, with a low-pass of {vibrometer.lag * 1e6:.1f} "
            f"us: the delay plus ten times the low-pass may be at most {margin * 1e6:.0f} us; the outputs are off; "
            "choose a faster filter"
        )
    known = listed.modal_gain != 0
    ratio = np.where(known, found.modal_gain / np.where(known, listed.modal_gain, 1.0), 1.0)
    if (ratio[known] < 0).all():
        raise RigError(
            "every mode moves against the sign of its listed gain: the vibrometer's signal or the drive is inverted; "
            "the outputs are off; invert the signal"
        )
    refuse_common_factor(found, listed, SPEEDS)
    for row, channel in np.argwhere((ratio < 0.4) | (ratio > 2.5)).tolist():
        # A frequency that changes from point to point looks like two resonances, which share the gain.
        near = np.abs(plant.unlisted - found.exponent[row]) < -2 * found.exponent[row].real
        if ratio[row, channel] < 0.4 and near.any():
            raise RigError(
                f"mode {listed.label[row]} near {found.natural_frequency[row]:.0f} Hz looks like two resonances; "
                f"{CHANGING}"
            )
        raise RigError(
            f"the gain of mode {listed.label[row]} by output {channel + 1} is "
            f"{found.modal_gain[row, channel] * 1e3:.4g} mm/s^2 per V, but "
            f"{listed.modal_gain[row, channel] * 1e3:.4g} is listed: allowed 0.4 to 2.5 times that; the outputs are "
            "off; check that the sets are wired as listed, or identify the beam again with `modaltouch identify`"
        )


def common_factor(found: ModalModel, listed: ModalModel) -> float:
    """Return the factor between found and listed gains [1]; 1 if they have none in common."""
    known = listed.modal_gain != 0
    ratio = found.modal_gain[known] / listed.modal_gain[known]
    common = float(np.median(ratio))
    return common if np.median(np.abs(ratio / common - 1)) < ALIKE else 1.0


def refuse_common_factor(found: ModalModel, listed: ModalModel, allowed: tuple[float, float]) -> None:
    """Refuse gains that differ from the listed ones by a common factor outside a range."""
    common, (low, high) = common_factor(found, listed), allowed
    if not low <= common <= high:
        raise RigError(
            f"the modes move {common:.2f} times as fast as their listed gains predict: allowed {low:g} to {high:g}; "
            "the outputs are off; check that the vibrometer is set to the listed `acquisition.sensitivity_mm_s_per_V`, "
            "that the amplifier does not saturate and that the actuators have no strong hysteresis, or identify the "
            "beam again with `modaltouch identify`"
        )


def refuse_implausible_velocity(recording: Recording) -> None:
    """Refuse records of a decay that differ from burst to burst, as with a loose sensor."""
    velocity = recording.velocity
    n_records = len(velocity)
    off = velocity - np.median(velocity, axis=0)
    # A quantile, since the median is 0 if most samples agree to within one step of the converter.
    noise = float(np.quantile(np.abs(off), 0.95)) / NORMAL_95
    power = float(np.mean(velocity**2))
    if n_records < 4 or power == 0:
        return
    # Averaging over n records leaves 1/n of the noise power.
    steady = (float(np.mean(velocity.mean(axis=0) ** 2)) - power / n_records) * n_records / (n_records - 1) / power
    far = float(np.mean(np.abs(off) > FAR_OFF * max(noise, 1e-12)))
    remedy = (
        "the outputs are off; check that the sensor is fastened, in focus and on a spot that reflects, that nothing "
        "touches the beam, that the scope is triggered by the start of a burst, and that there is neither mains hum "
        "nor another disturbance in its record; measure again"
    )
    where = f"at {recording.position * 1e3:g} mm"
    if noise > 0 and far > MOST_FAR_OFF:
        raise RigError(
            f"{where} the velocity has gaps or shocks: {far:.3%} of its samples are more than {FAR_OFF:g} standard "
            f"deviations of the noise away, allowed {MOST_FAR_OFF:.3%}; {remedy}"
        )
    if steady < LEAST_COHERENCE:
        raise RigError(
            f"{where} the velocity differs from burst to burst: {max(steady, 0.0):.0%} of its power repeats, at least "
            f"{LEAST_COHERENCE:.0%} must; {remedy}"
        )


def refuse_wrong_drive(
    predicted: FloatArray, measured: FloatArray, step: float, most_lacking: float = MOST_LACKING
) -> None:
    """Refuse drives [V] that are exchanged, strongly saturated, or early or late.

    Predicted and measured drives are (n_channels, n_samples) arrays, with samples `step` apart [s].
    """
    likeness = np.abs(measured @ predicted.T) / np.maximum(np.linalg.norm(predicted, axis=1), 1e-300)
    if len(predicted) > 1 and (likeness.argmax(axis=1) != np.arange(len(predicted))).all():
        raise RigError(
            "the drive measured for each output is that of another: the probes are exchanged; the outputs are off; "
            "check which probe is at which amplifier"
        )
    lacking = peak_shortfall(predicted, measured)
    output = int(lacking.argmax())
    if lacking[output] > most_lacking:
        raise RigError(
            f"the amplifier saturates: the measured peaks of output {output + 1} are {lacking[output]:.0%} below the "
            f"predicted {np.abs(predicted[output]).max():.0f} V, allowed {most_lacking:.0%}; the outputs are off; "
            "check its supply, set amplifier.limit_V to its true value, and lower the levels to suit"
        )
    slope = np.gradient(predicted, step, axis=1)
    # An error of a gain, to which this part of the slope is orthogonal, is none of the time.
    slope -= predicted * ((slope * predicted).sum(axis=1) / np.maximum((predicted**2).sum(axis=1), 1e-300))[:, None]
    moved = float(np.sum(slope * measured) / np.sum(slope**2))
    # Clipped peaks, which are reported as such, also seem early or late.
    if abs(moved) > MOST_MOVED and lacking.max() <= LARGEST_SHORTFALL:
        raise RigError(
            f"the scope's trigger moved by {moved * 1e6:+.2f} us since the identification: allowed "
            f"{MOST_MOVED * 1e6:g} us; the outputs are off; trigger the scope by the generator's trigger output, not "
            "by the drive, check `acquisition.trigger_latency_us`, and calibrate again"
        )


def refuse_disproportion(whole: ModalState, half: ModalState) -> None:
    """Refuse a beam whose modes do not move half as fast at half the level."""
    off = 2 * float(half.velocity @ whole.velocity / (whole.velocity @ whole.velocity)) - 1
    if abs(off) > MOST_DISPROPORTION:
        raise RigError(
            f"at half the level the speed of the modes differs by {off:+.1%} from half: allowed "
            f"{MOST_DISPROPORTION:.0%}; the outputs are off; {HYSTERESIS}"
        )


LARGEST_SHORTFALL, LARGEST_CHANGE = 0.01, 0.01
"""Largest shortfall of the measured drive's peaks for the calibrated stimulus, and largest change of all speeds since
the identification [1]."""


def mark_of(outcome: CalibrationResult, protocol: Protocol) -> dict[str, Any]:
    """Return the limits that a calibration misses, with its uncertainty added to its errors, and the causes.

    They are ``missed`` and ``causes`` in the calibration file, both empty if every limit in ``calibration.limits`` of
    the protocol is kept.
    """
    reference, limits = outcome.inputs.reference, protocol.calibration.limits
    highest = max(outcome.levels, key=lambda level: level.velocity)
    top, reached = highest.velocity * 1e3, list[tuple[str, float, float, float]]()
    for turn, level in ((outcome.best, reference), (outcome.halfway, outcome.halfway_level * 1e3)):
        state, half_width = turn.state, turn.state.half_width
        velocity = np.hypot(state.velocity - outcome.target * level / reference, half_width).max()
        displacement = np.hypot(state.displacement, half_width).max()
        reached += [
            ("velocity_mm_s", level, velocity * 1e3, limits.velocity_mm_s),
            ("displacement_mm_s", level, displacement * 1e3, limits.displacement_mm_s),
            ("frequencies_mm_s", level, state.significant_slip.max() * 1e3, limits.displacement_mm_s),
        ]
    for asked in outcome.levels:
        error = _level_error(asked, limits.level_percent, highest.velocity)
        reached.append(("level_percent", asked.velocity * 1e3, error, limits.level_percent))
    reached += [
        ("focus_percent", top, 100 * abs(highest.excess), 100 * LARGEST_EXCESS),
        ("drive_percent", top, 100 * outcome.drive_shortfall.max(), 100 * LARGEST_SHORTFALL),
        ("reading_percent", reference, 100 * abs(outcome.reading_change), 100 * LARGEST_CHANGE),
    ]
    missed = [
        {
            "limit": limit,
            "level_mm_s": round(level, 6),
            "reached": round(float(np.nan_to_num(value, nan=1e9, posinf=1e9)), 4),
            "allowed": allowed,
        }
        for limit, level, value, allowed in reached
        if not value <= allowed  # NaN counts as missed.
    ]
    return {"missed": missed, "causes": list(_causes(outcome, protocol, missed)) if missed else []}


def _level_error(level: Level, allowed: float, highest: float) -> float:
    """Return a level's deviation [percent]; 0 if it may be noise, unless the noise is too large for the highest level.

    Vibrometer noise makes low levels less precise; they are assumed to be proportional.
    """
    deviation = 100 * abs(level.at_focus / level.velocity - 1)
    noise = 100 * level.spread / level.velocity
    if deviation > max(allowed, CERTAIN * noise):
        return deviation
    uncertainty = 100 * NORMAL_95 * level.spread / highest
    return uncertainty if uncertainty > allowed else 0.0


def _causes(outcome: CalibrationResult, protocol: Protocol, missed: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the cause indicated by the records, with its remedy."""
    limits, last = protocol.calibration.limits, outcome.turns[-1].state
    allowed = min(limits.velocity_mm_s, limits.displacement_mm_s) * 1e-3
    noise = NORMAL_95 * float(outcome.best.state.spread.max())
    highest, excess = max((level.velocity, level.excess) for level in outcome.levels)
    level_noise = NORMAL_95 * max(level.spread for level in outcome.levels)
    elsewhere = [each["limit"] for each in missed if each["level_mm_s"] != outcome.inputs.reference]
    if any(each["limit"] == "drive_percent" for each in missed):
        output = int(outcome.drive_shortfall.argmax())
        yield (
            f"the amplifier saturates: output {output + 1} is commanded to give {outcome.drive_peak[output]:.0f} V, "
            f"but the measured peaks fall short by {outcome.drive_shortfall[output]:.1%}; lower the highest level, or "
            "set amplifier.limit_V to its true value"
        )
    # Changed frequencies hardly make the points disagree; a late record at one point has both effects.
    elif float(last.significant_slip.max()) > max(allowed / 2, noise, float(last.disagreement.max())):
        yield _changed_frequencies(outcome)
    elif any((s.disagreement > np.maximum(4 * s.spread, allowed / 4)).any() for s in (last, outcome.halfway.state)):
        yield (
            "the points along the beam disagree: the sensor is loose, its spot is in the wrong place, or a record is "
            "late; fasten it, aim it again, check the trigger, and calibrate again"
        )
    elif noise > allowed / 2:
        yield (
            f"the velocity is noisy: the uncertainty is {noise * 1e3:.2g} mm/s per mode and {level_noise * 1e3:.2g} "
            "mm/s per level; focus the vibrometer on a spot that reflects, fasten the sensor, and choose the "
            "smallest range that covers the velocity"
        )
    elif any(each["limit"] == "focus_percent" for each in missed):
        yield (
            f"at the focus the beam moves {1 + excess:.2f} times as fast as the other points predict: the spot "
            "misses the centre of the focus zone, or the vibrometer's angle or range is different there; aim it again, "
            "and calibrate again"
        )
    elif 100 * level_noise > limits.level_percent * highest:
        yield (
            f"at the focus the records leave {level_noise * 1e3:.2g} mm/s of a level uncertain, though the other "
            "points agree: the spot reflects badly there, or the records are late; aim the vibrometer again, check the "
            "trigger, and calibrate again"
        )
    # A changed sensor leaves half the level proportional.
    elif elsewhere and ("velocity_mm_s" in elsewhere or len(elsewhere) == len(missed)):
        yield HYSTERESIS
    elif any(each["limit"] == "reading_percent" for each in missed):
        yield (
            f"all speeds are {1 + outcome.reading_change:.3f} times those expected from the probes: the sensor's "
            "range, angle or focus changed; fasten it, and calibrate again"
        )
    else:
        yield (
            "the records do not show the cause; identify the beam again with `modaltouch identify`, and calibrate "
            "with the new apparatus file"
        )


def _changed_frequencies(outcome: CalibrationResult) -> str:
    """Describe whether the natural frequencies drift with time or change with the amplitude, and the remedy.

    The frequencies of all iterations are fitted by a constant, a term proportional to the number of records taken and
    one proportional to the voltage squared; the larger of the last two terms is the cause.
    """
    turns, state = (*outcome.turns, outcome.halfway), outcome.turns[-1].state
    # Use the significant mode with the smallest change relative to its decay rate, where first order is most accurate.
    strain = state.slip / np.hypot(state.velocity, state.displacement)
    mode = int(np.argmin(np.where(state.significant_slip > 0, strain, np.inf)))
    taken = np.array([turn.n_taken for turn in turns], dtype=float)
    volts = np.array([turn.peak_voltage for turn in turns])
    terms = np.stack([np.ones(taken.size), taken / taken.max(), (volts / volts.max()) ** 2], axis=1)
    found = np.array([turn.state.change[mode] for turn in turns])
    parts = np.linalg.lstsq(terms, found, rcond=None)[0] * np.ptp(terms, axis=0)
    label = outcome.refined.modes[mode].label
    if abs(parts[2]) > abs(parts[1]):
        return (
            f"the natural frequencies change with the amplitude: that of mode {label} by {parts[2]:+.2g} of its value "
            f"from {volts.min():.0f} to {volts.max():.0f} V; lower the highest level, bring the levels closer "
            "together, and check the patches and the suspension"
        )
    return (
        f"the beam drifts: the natural frequency of mode {label} changed by {parts[1]:+.2g} of its value from the "
        "first iteration to the last record; let beam, patches and amplifier reach a steady temperature, check the "
        "suspension, and calibrate again"
    )
