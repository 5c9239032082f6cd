"""Checks of an identification: faults that are refused, with their most probable cause, and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from modaltouch.lab.identification.causes import aliased, causes_by_mode, probable_cause
from modaltouch.lab.identification.joint_fit import axis_error
from modaltouch.lab.identification.modal_parameters import (
    REMEDIES,
    SMOOTH,
    WELL_FITTED,
    Identification,
    IdentifiedMode,
    neighbouring,
)
from modaltouch.lab.identification.peaks import FEWEST_BINS
from modaltouch.lab.identification.shapes import BELONGS, bending_likeness, in_two_units, mac, misplaced, unevenness
from modaltouch.lab.identification.time_records import DECAY, STILL_MOVES

LEAST_COHERENCE = 0.5
"""Median coherence below which a mode is refused (at its peak) or a warning is given (over the band) [1]."""

MOST_LEFT = 0.1
"""Amplitude of the residual near a mode, relative to that of the responses, above which the mode is refused [1]."""

AS_HIGH = 0.1
"""Height of a peak, relative to the median peak, above which it is more than weak torsion or noise [1]."""

MARKED = {"nonlinearity": 0.004, "drift": 0.004}
"""Amplitude of the residual's smooth part, relative to the responses, above which a warning is given, by cause [1]."""

REMEDY = "; drive harder, average more, look higher with --highest-kHz, or name with --modes those to be found"

MARKED_ELSE = 0.02
"""The same as `MARKED` for any other cause [1]."""


def check_modes(identification: Identification, labels: Sequence[int]) -> None:
    """Refuse an identification in which a mode is missing, too weak or badly fitted.

    Parameters
    ----------
    identification : Identification
        The modes found.
    labels : sequence of int
        Required modes.

    Raises
    ------
    ValueError
        If a mode is missing, incoherent or badly fitted; the message lists all of them and the remedy.
    """
    found = identification.by_label
    badly = any(mode.rest.share > MARKED_ELSE for mode in identification.modes)
    spoilt = badly or identification.misfit > WELL_FITTED
    missing = [label for label in labels if label not in found]
    faulty = [label for label, mode in found.items() if label in labels and _faults(f"mode {label}", mode)]
    # A missing mode is split if the beam drifts, and has a single resonance of another shape if points are exchanged.
    split = _split(identification, missing, faulty)
    strange = aliased(identification) or split
    if missing:
        strange = _in_two_units(identification) or strange or _misplaced(identification)
    # Low noise alone may raise the misfit, but does not spoil shapes.
    if not (strange or badly):
        strange = _implausible_modes(identification.modes, missing)
    if missing and not (strange or spoilt):
        # A mode that moved far has several poles, which fit well but have no mode's shape.
        strange = probable_cause(identification, least=WELL_FITTED)
    remedy = "" if spoilt or strange else REMEDY
    lines = []
    for label in labels:
        if label not in found:
            lines.append(f"mode {label} was not found: no resonance has its mode shape{remedy}")
        else:
            lines += _faults(f"mode {label}", found[label])
    if lines and strange:
        lines.append(strange)
    elif lines and spoilt:
        cut = [mark for mark in identification.responses.marks if mark.endswith(STILL_MOVES)]
        known = axis_error(identification) or _digit(identification) or _hum(identification)
        lines += cut or ([known] if known else _causes(identification, [found[label] for label in faulty]))
    if lines:
        raise ValueError("\n".join(lines))


def _split(identification: Identification, missing: Sequence[int] | None = None, faulty: Sequence[int] = ()) -> str:
    """Describe two resonances within one half-power bandwidth that are a single drifting mode; empty if there are none.

    If the mode drifted between sets, both resonances have its shape; if it drifted during a scan, only their sum has
    it. Neither is true of bending and torsion with close natural frequencies. If missing or faulty labels are given,
    only resonances of these modes are considered.
    """
    # A mode that moved far has a pole for each of its places, which fit well: the causes of what is left are others.
    unclear = (
        "the most probable cause is drift, also between sets or by the mass of a sensor that is moved, or "
        f"nonlinearity: {REMEDIES['drift']}, or {REMEDIES['nonlinearity']}"
    )
    for one, other in pairwise(identification.modes):
        apart = other.natural_frequency.value - one.natural_frequency.value
        width = 2 * one.natural_frequency.value * one.damping_ratio.value
        named = all(each.label or each.torsion for each in (one, other))
        label = _is_one(identification, one, other) if apart < width and not named else None
        if label is not None and (missing is None or label in {*missing, *faulty}):
            return (
                f"the resonances at {one.natural_frequency.value:.6g} and {other.natural_frequency.value:.6g} Hz are "
                "within one width of each other, like a single mode that moved: "
                f"{probable_cause(identification) or unclear}"
            )
    return ""


def _is_one(identification: Identification, one: IdentifiedMode, other: IdentifiedMode) -> int | None:
    """Return the label of the mode whose shape two resonances have, both or in their sum; None for two modes."""
    places, parts = identification.responses.places, np.stack([one.residue.real, other.residue.real])
    length = identification.length or np.ptp(np.array(places)[:, 0])
    likeness = bending_likeness(np.stack([*parts, parts.sum(axis=0)]), places, length)
    lacking = 1 - likeness.max(axis=1)
    alike = mac(parts[:1], parts[1:])[0, 0] >= BELONGS
    return int(likeness[2].argmax()) + 1 if alike or lacking[2] < min(1 - BELONGS, *(lacking[:2] / 2)) else None


def _in_two_units(identification: Identification) -> str:
    """Describe points with far larger values than the others; empty if there are none."""
    places, residue = identification.responses.places, np.array([mode.residue.real for mode in identification.modes])
    return in_two_units(residue, places, identification.length) if places and identification.length else ""


UNEVEN, LIKE_THEORY = 0.01, 0.97
"""Deviation of the points' factors from each other above which a warning is given, and the minimum MAC of the modes
used to determine them [1]."""


def _uneven(identification: Identification) -> str:
    """Describe a difference between the points that is common to all modes; empty if it is small."""
    known = [(mode.label, shape) for mode, shape in identification.shaped if mode.label and mode.mac > LIKE_THEORY]
    if len(known) < 4 or identification.length is None:
        return ""
    labels, shapes = zip(*known, strict=True)
    positions = np.array(identification.responses.places)[:, 0]
    uneven = unevenness(np.array(shapes), labels, positions, identification.length)
    if uneven <= UNEVEN:
        return ""
    return (
        f"the points differ by {uneven:.1%} (rms) in all modes alike, and the gains may be off by as much: check that "
        "range, angle and focus of the sensor, and the voltage, were the same at all of them"
    )


def _misplaced(identification: Identification) -> str:
    """Describe an error of all positions, or of the length, found from the shapes; empty if there is none."""
    known = [(mode.label, shape) for mode, shape in identification.shaped if mode.label]
    if not known or identification.length is None:
        return ""
    labels, shapes = zip(*known, strict=True)
    return misplaced(np.array(shapes), labels, identification.responses.places, identification.length)


def _implausible_modes(modes: Sequence[IdentifiedMode], missing: Sequence[int]) -> str:
    """Describe strong, well-fitted resonances without a mode's shape where a mode is missing; empty if none."""
    least = AS_HIGH * float(np.median([mode.half_power.height for mode in modes]))
    strange = []
    for one in modes:
        own, width = one.natural_frequency.value, 2 * one.damping_ratio.value
        alone = all(abs(each.natural_frequency.value / own - 1) > width for each in modes if each is not one)
        fitted = one.half_power.height > least and one.rest.share <= MARKED_ELSE
        if alone and fitted and not (one.label or one.torsion):
            strange += [one.name] * _lacks(modes, missing, one)
    if not strange:
        return ""
    return (
        f"the shape at {', '.join(strange)} is not that of a mode: check the positions and the signs of the points "
        "(two may be exchanged) and the length of the beam"
    )


def _lacks(modes: Sequence[IdentifiedMode], missing: Sequence[int], one: IdentifiedMode) -> bool:
    """Return whether a missing mode belongs between the labelled modes below and above a resonance."""
    labelled = [(mode.label, mode.natural_frequency.value) for mode in modes if mode.label is not None]
    own = one.natural_frequency.value
    below = max((label for label, frequency in labelled if frequency < own), default=0)
    above = min((label for label, frequency in labelled if frequency > own), default=np.inf)
    return any(below < label < above for label in missing)


def check_all(identification: Identification) -> None:
    """Refuse an identification without shapes if most of its modes are incoherent or badly fitted."""
    modes = identification.modes
    faults = [_faults(f"the mode at {mode.natural_frequency.value:.6g} Hz", mode) for mode in modes]
    if 2 * sum(bool(each) for each in faults) > len(modes):
        cause = _causes(identification, modes) if any(mode.rest.share > MOST_LEFT for mode in modes) else []
        raise ValueError("\n".join([*(line for each in faults for line in each), *cause]))


def _faults(name: str, mode: IdentifiedMode) -> list[str]:
    lines = []
    if mode.coherence < LEAST_COHERENCE:
        remedy = "drive harder (--drive-V) or average more (--averages)"
        if mode.half_power.n_bins < FEWEST_BINS:
            remedy = f"its peak is {mode.half_power.n_bins:.1f} bins wide; record for longer, or {remedy}"
        lines.append(
            f"{name} has a coherence of {mode.coherence:.2f} at its peak, but at least {LEAST_COHERENCE:g} is needed: "
            f"{remedy}"
        )
    if mode.rest.share > MOST_LEFT:
        lines.append(
            f"{name} is not fitted well: the residual is {mode.rest.share:.0%} of the response around it, at most "
            f"{MOST_LEFT:.0%} is allowed"
        )
    return lines


MAINS, FEW = (50.0, 60.0), 0.4
"""Mains frequencies [Hz], and the largest fraction of bins near their multiples at which hum is detectable [1]."""


def _hum(identification: Identification) -> str:
    """Describe a disturbance if most of the residual is at one frequency or at multiples of a mains frequency."""
    responses = identification.responses
    left = (np.abs(responses.response - identification.fitted) ** 2 / responses.noise[:, None] - 1).sum(axis=(0, 1))
    for mains in MAINS:
        off = np.abs(responses.frequency - mains * np.round(responses.frequency / mains))
        on = off <= 0.51 * responses.spacing
        if on.mean() < FEW and left[on].sum() > 0.5 * left.sum():
            return (
                f"the most probable cause is mains hum: most of the residual lies at multiples of {mains:g} Hz; "
                "connect all instruments to one earth, keep cables away from transformers, and measure again"
            )
    at = int(left.argmax())
    if left[at] > max(STRAY, OF_ALL * left.sum()):
        return (
            f"most of the residual is at one frequency, {responses.frequency[at]:.6g} Hz: look for a disturbance, "
            "such as a fan or a switching power supply, and measure again"
        )
    return ""


FEWEST_PLACES = 6
"""Minimum number of points for most of the residual at one of them to be remarkable."""

OF_ALL, STRAY = 0.5, 100.0
"""Minimum fraction of the residual in excess of the noise for a single value to explain it, and its minimum square in
units of the noise [1]."""


def _digit(identification: Identification) -> str:
    """Describe a single value, or a point, that accounts for most of the residual; empty if there is none."""
    responses = identification.responses
    left = np.abs(responses.response - identification.fitted) ** 2 / responses.noise[:, None] - 1
    most = np.unravel_index(int(left.argmax()), left.shape)
    where = f" at {responses.places[most[1]]}" if responses.places else ""
    if left[most] > max(STRAY, OF_ALL * left.sum()):
        return (
            f"most of the residual is in one value, the response to {responses.sets[most[0]]}{where} at "
            f"{responses.frequency[most[2]]:.6g} Hz: look for a wrong digit in the file, or measure that point again"
        )
    by_point = left.sum(axis=(0, 2))
    if where and by_point.size >= FEWEST_PLACES and by_point.max() > OF_ALL * by_point.sum() > STRAY:
        point = int(by_point.argmax())
        rest = np.moveaxis(responses.response[:, point] - identification.fitted[:, point], -1, 0)
        cause = "a strange point" if neighbouring(rest).sum() > SMOOTH * (np.abs(rest) ** 2).sum() else "a noisy point"
        described = f"most of the residual is at {responses.places[point]}: {REMEDIES[cause]}"
        # A beam that drifts has the largest residual where it moves most.
        return described if probable_cause(identification, described) == described else ""
    return ""


def _causes(identification: Identification, modes: Sequence[IdentifiedMode]) -> list[str]:
    """Return the causes of the residual around badly fitted modes, or the worst of all, with their remedies."""
    spoilt = [mode for mode in modes if mode.rest.share > MOST_LEFT]
    worst = max(identification.modes, key=lambda each: each.rest.share)
    grouped = causes_by_mode(identification, spoilt or [worst])
    if len(grouped) == 1:
        return [*grouped]
    return [f"around {_names(each)} {cause}" for cause, each in grouped.items()]


def _names(modes: Sequence[IdentifiedMode]) -> str:
    return ", ".join(each.name for each in sorted(modes, key=lambda each: each.natural_frequency.value))


def warnings(identification: Identification) -> list[str]:
    """Return the warnings for an accepted result, a sentence each."""
    responses, sentences = identification.responses, list(identification.responses.marks)
    # A free decay begins at any phase.
    if responses.offset and not any(DECAY in mark for mark in responses.marks):
        sentences.append(
            f"the motion is {abs(responses.offset) * 1e3:.4g} ms {'behind' if responses.offset > 0 else 'before'} its "
            "excitation, judging by the slope of the phase over frequency; this offset was removed"
        )
    if responses.coherence is not None and (median := float(np.median(responses.coherence))) < LEAST_COHERENCE:
        sentences.append(f"the median coherence over the band is {median:.2f}, below {LEAST_COHERENCE:g}: average more")
    noisy = identification.misfit <= WELL_FITTED
    known = "" if noisy else _digit(identification) or _hum(identification)
    marked = [mode for mode in identification.modes if mode.rest.smooth > MARKED.get(mode.rest.cause, MARKED_ELSE)]
    badly = [mode for mode in identification.modes if mode.rest.share > MOST_LEFT and mode not in marked]
    spoilt = [*marked, *badly]
    by_cause = {known: spoilt} if known and spoilt else causes_by_mode(identification, spoilt)
    for cause, chosen in by_cause.items():
        left = max(max(each.rest.smooth, each.rest.share) for each in chosen)
        sentences.append(
            f"the residual is up to {left:.1%} of the response around {_names(chosen)}, and the intervals may not "
            f"cover it: {cause}"
        )
    if folded := aliased(identification):
        sentences.append(folded)
    if of_points := _misplaced(identification) or _uneven(identification):
        sentences.append(of_points)
    split = _split(identification) if identification.length and not folded else ""
    if split or not (noisy or (known and (marked or badly))):
        sentences.append(
            known
            or split
            or f"{misfit_verdict(identification)}: the intervals are widened accordingly, but may not cover it"
            + (f"; {cause}" if (cause := probable_cause(identification)) else "")
        )
    return sentences


def misfit_verdict(identification: Identification) -> str:
    """Describe the misfit in words."""
    left = max(mode.rest.share for mode in identification.modes)
    means = "the noise alone" if identification.misfit <= WELL_FITTED else "more than the noise"
    return f"misfit {identification.misfit:.3g}, {means}; residual at most {left:.1%} of the response around a mode"


def repeatability(identification: Identification) -> str:
    """Describe in words whether the intervals include the repeatability of the measurement on the same beam."""
    n = [mode.n_repeats for mode in identification.modes]
    if max(n) < 2:
        return "repeatability is unknown: the intervals come from one measurement; repeat it, and give all measurements"
    alone = sum(each < 2 for each in n)
    return f"the intervals include the scatter of {max(n)} measurements" + (
        f", except for {alone} modes" if alone else ""
    )
