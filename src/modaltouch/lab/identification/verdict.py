"""Checks of an identification: faults that are refused, with their most probable cause, and warnings."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from modaltouch.lab.common import FloatArray
from modaltouch.lab.identification.joint_fit import FROM_ZERO, make_problem, refine
from modaltouch.lab.identification.kernel import Evaluation, Poles
from modaltouch.lab.identification.modal_parameters import REMEDIES, WELL_FITTED, Identification, IdentifiedMode
from modaltouch.lab.identification.peaks import FEWEST_BINS
from modaltouch.lab.identification.shapes import BELONGS, bending_likeness, in_two_units, mac, misplaced, unevenness
from modaltouch.lab.identification.time_records import DECAY, STILL_MOVES

LEAST_COHERENCE = 0.5
"""Median coherence below which a mode is refused (at its peak) or a warning is given (over the band) [1]."""

MOST_LEFT = 0.1
"""Amplitude of the residual near a mode, relative to that of the responses, above which the mode is refused [1]."""

MARKED = 0.004
"""Amplitude of the residual's smooth part, relative to the responses, above which a warning is given [1]."""

REMEDY = (
    "; drive harder, average more, look higher with --highest-kHz, check positions and signs of the points, or name "
    "with --modes those to be found"
)


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
    missing = [label for label in labels if label not in found]
    faults = {label: _faults(f"mode {label}", found[label]) for label in labels if label in found}
    faulty = [label for label, lines in faults.items() if lines]
    if not (missing or faulty):
        return
    # Low noise alone may raise the misfit, but does not spoil shapes.
    spoilt = identification.misfit > WELL_FITTED or any(found[label].rest.share > MOST_LEFT for label in faulty)
    cause = (_in_two_units(identification) if missing else "") or _split(identification, missing, faulty)
    cause = cause or (_misplaced(identification) if missing else "")
    if not cause and spoilt:
        cause = _cause(identification)
    elif not cause and missing:
        # A mode that moved far has several poles, which fit well but have no mode's shape.
        cause = probable_cause(identification, least=WELL_FITTED)
    absent = "mode {} was not found: no resonance has its mode shape" + ("" if cause else REMEDY)
    lines = itertools.chain(*(faults.get(label, [absent.format(label)]) for label in labels))
    raise ValueError("\n".join([*lines, *([cause] if cause else [])]))


def _split(identification: Identification, missing: Sequence[int] | None = None, faulty: Sequence[int] = ()) -> str:
    """Describe two resonances within one half-power bandwidth that are a single drifting mode; empty if there are none.

    If the mode drifted between sets, both resonances have its shape; if it drifted during a scan, only their sum has
    it. Neither is true of bending and torsion with close natural frequencies. If missing or faulty labels are given,
    only resonances of these modes are considered.
    """
    # Drift that hides modes also leaves resonances at single points.
    at_one_point = _at_one_point(identification) if missing is None else ""
    if at_one_point:
        return at_one_point
    # A mode that moved far has a pole for each of its places, which fit well: the causes of what is left are others.
    unclear = f"the most probable cause is drift or nonlinearity: {REMEDIES['drift']}, or {REMEDIES['nonlinearity']}"
    for one, other in itertools.pairwise(identification.modes):
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


def _at_one_point(identification: Identification) -> str:
    """Describe a resonance that only one point shows, such as one of another beam; empty if there is none."""
    places = identification.responses.places
    for mode in identification.modes if len(places) >= FEWEST_PLACES else ():
        power = np.abs(mode.residue) ** 2
        if not (mode.label or mode.torsion) and power.max() > ALONE * power.sum():
            return (
                f"only the point at {places[int(power.argmax())]} shows the resonance at "
                f"{mode.natural_frequency.value:.6g} Hz: {REMEDIES['a strange point']}"
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


def check_all(identification: Identification) -> None:
    """Refuse an identification without shapes if most of its modes are incoherent or badly fitted."""
    modes = identification.modes
    faults = [_faults(f"the mode at {mode.natural_frequency.value:.6g} Hz", mode) for mode in modes]
    if 2 * sum(bool(each) for each in faults) > len(modes):
        cause = [_cause(identification)] if any(mode.rest.share > MOST_LEFT for mode in modes) else []
        raise ValueError("\n".join([*itertools.chain(*faults), *cause]))


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


MAINS, FEW, CERTAINLY = (50.0, 60.0), 0.4, 10.0
"""Mains frequencies [Hz], the largest fraction of bins near their multiples at which hum is detectable [1], and its
minimum there in standard deviations of noise [1]."""


def _hum(identification: Identification) -> str:
    """Describe a disturbance if most of the residual is at one frequency or at multiples of a mains frequency."""
    responses = identification.responses
    left = (np.abs(responses.response - identification.fitted) ** 2 / responses.noise[:, None] - 1).sum(axis=(0, 1))
    for mains in MAINS:
        off = np.abs(responses.frequency - mains * np.round(responses.frequency / mains))
        on = off <= 0.51 * responses.spacing
        # The sum over so many values is far from zero by chance alone.
        chance = CERTAINLY * (on.sum() * responses.response[..., 0].size) ** 0.5
        if on.mean() < FEW and left[on].sum() > max(chance, OF_ALL * left.sum()):
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
"""Minimum number of points for most of the residual, or of a resonance, at one of them to be remarkable."""

ALONE = 0.8
"""Share of a resonance's power from which it is that of a single point [1]."""

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
        described = f"most of the residual is at {responses.places[point]}: {REMEDIES['a strange point']}"
        # A beam that drifts has the largest residual where it moves most.
        return described if probable_cause(identification, described) == described else ""
    return ""


def _cause(identification: Identification, split: str = "") -> str:
    """Describe the most probable cause of the residual with its remedy; empty if unclear and small.

    A mode that is split may be described.
    """
    known = [mark for mark in identification.responses.marks if mark.endswith((STILL_MOVES, FROM_ZERO))]
    worst = max((mode.rest for mode in identification.modes), key=lambda each: each.share)
    # In a residual of the noise alone, one value or one frequency may lead by chance.
    is_clear = identification.misfit > WELL_FITTED or worst.share > MOST_LEFT
    if cause := "; ".join(known) or (is_clear and (_digit(identification) or _hum(identification))) or split:
        return cause
    name = "nonlinearity or a missing mode" if worst.smooth else "noise"
    is_large = worst.share > MOST_LEFT or worst.smooth > MARKED
    unclear = f"the most probable cause is {name}: {REMEDIES[name]}" if is_large else ""
    # In noise, some pattern explains much of the little that is left.
    is_noise = identification.misfit <= WELL_FITTED and not worst.smooth
    pattern = "" if is_noise else probable_cause(identification)
    return pattern or unclear


EXPLAINS = 0.4
"""Minimum share of the residual that a pattern explains if it is the cause [1]."""

FILTERED = 0.05
"""Minimum share of the residual explained by one phase for each mode if a filter is the cause [1]."""


def probable_cause(found: Identification, odd_point: str = "", least: float = 0.0) -> str:
    """Describe the most probable cause of the residual with its remedy; empty if unclear.

    A pattern over points and modes that explains most of the residual is the cause. The responses are fitted again with
    one pole for each pair of close poles, which drift splits. The residual is then projected on the changes that a
    fault makes to first order: of the natural frequencies, by point or by set; of the phase, by point, in proportion to
    the frequency or not; of the phase, by mode.

    A point that holds most of the residual, if described, is the cause unless a pattern explains it. None is named if
    the misfit of the poles with one in place of close ones is below `least`.
    """
    if found.poles is None or not found.responses.places:
        return odd_point
    poles = _merged(found, found.poles)
    # The mean of repeats hides how they differ.
    responses = found.responses.repeats[0].aligned() if found.responses.repeats else found.responses
    fit = refine(make_problem(responses, poles), poles)
    if fit.variance < least:
        return odd_point
    shares = _shares(fit, *responses.response.shape[:2])
    cause = max(shares, key=lambda each: shares[each])
    if found.responses.repeats and fit.variance <= WELL_FITTED:
        cause = "drift"
    elif shares[cause] < EXPLAINS:
        cause = "" if odd_point else _common_cause(fit)
    return f"the most probable cause is {cause}: {REMEDIES[cause]}" if cause else odd_point


def _merged(found: Identification, poles: Poles) -> Poles:
    """Return the poles with one in place of two within a half-power bandwidth that are not both known modes."""
    own, ratio = poles.natural_frequency, poles.damping_ratio
    known = [mode.natural_frequency.value for mode in found.modes if mode.label or mode.torsion]
    named = np.isin(own.round(6), np.round(known, 6))
    apart = [
        other - one > 2 * wide * one or (named[k] and named[k + 1])
        for k, ((one, other), wide) in enumerate(zip(itertools.pairwise(own), ratio, strict=False))
    ]
    start = np.flatnonzero(np.append(True, apart))
    number = np.diff(np.append(start, own.size))
    return Poles(np.add.reduceat(own, start) / number, np.add.reduceat(ratio, start) / number, poles.delay)


def _shares(fit: Evaluation, n_sets: int, n_points: int) -> dict[str, float]:
    """Return the share of the residual that each pattern over points or sets explains."""
    n, rest, residue = fit.n_modes, fit.rest, fit.residue
    omega = 2 * np.pi * fit.poles.natural_frequency / fit.problem.highest
    total = max(float((rest**2).sum()) - rest.size, 1e-300)

    def explained(pattern: FloatArray, axis: int) -> float:
        """Return the share that a pattern explains with a factor for each point or set."""
        overlap, size = (
            product.sum(axis=0).reshape(n_sets, n_points).sum(axis=axis) for product in (pattern * rest, pattern**2)
        )
        return float((overlap**2 / np.maximum(size, 1e-300)).sum()) / total

    patterns = {
        "drift": [(fit.slope[:, :n] / fit.poles.damping_ratio) @ residue[:n]],
        "a phase that differs between points or sets": [
            fit.turned @ residue,
            (fit.turned[:, :n] / omega) @ residue[:n],
        ],
    }
    axes = (0, 1) if n_sets > 1 else (0,)
    return {cause: max(explained(each, axis) for each in of for axis in axes) for cause, of in patterns.items()}


def _common_cause(fit: Evaluation) -> str:
    """Return the cause of a residual that has the shapes of the modes themselves; empty if it has not."""
    n, rest, left = fit.n_modes, fit.rest, fit.left
    power = float((rest**2).sum()) - rest.size
    nearest = np.abs(np.log(fit.problem.bins.centre[:, None] / fit.poles.natural_frequency)).argmin(axis=1)
    shape = fit.residue[nearest] / np.linalg.norm(fit.residue[nearest], axis=1, keepdims=True)
    if (np.abs((left * shape).sum(axis=1)) ** 2).sum() - 2 * len(left) <= EXPLAINS * power:
        return ""
    by_phase = fit.turned[:, :n]
    overlap = ((by_phase.T @ rest) * fit.residue[:n]).sum(axis=1)
    curvature = (by_phase.T @ by_phase) * (fit.residue[:n] @ fit.residue[:n].T)
    filtered = float(overlap @ np.linalg.lstsq(curvature, overlap, rcond=1e-12)[0])
    return "a filter or window that is not listed" if filtered > FILTERED * power else "nonlinearity"


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
    spoilt = [mode for mode in identification.modes if mode.rest.smooth > MARKED or mode.rest.share > MOST_LEFT]
    badly, split = identification.misfit > WELL_FITTED, _split(identification) if identification.length else ""
    cause = _cause(identification, split) if spoilt or badly else split
    if spoilt:
        left = max(max(each.rest.smooth, each.rest.share) for each in spoilt)
        names = ", ".join(each.name for each in spoilt)
        cause = (
            f"the residual is up to {left:.1%} of the response around {names}, and the intervals may not cover it: "
            f"{cause}"
        )
    elif badly:
        verdict = misfit_verdict(identification)
        cause = f"{verdict}: the intervals are widened accordingly, but may not cover it{cause and '; '}{cause}"
    of_points = _misplaced(identification) or _uneven(identification)
    return [*sentences, *(each for each in (cause, of_points) if each)]


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


FEWEST_ANTISYMMETRIC = 3
"""Minimum number of listed gains of antisymmetric modes to recognise a mirrored scan."""


def mirrored_scan(ratios: Mapping[tuple[str, int], float], listed_in: str) -> str:
    """Describe gains of which those of all antisymmetric modes have the other sign than the listed ones; else empty.

    Parameters
    ----------
    ratios : mapping of (str, int) to float
        Gains relative to the listed ones, by actuator set and label of the mode [1].
    listed_in : str
        Name of the apparatus that lists them.
    """
    antisymmetric = [each for (_, label), each in ratios.items() if label % 2 == 0]
    symmetric = [each for (_, label), each in ratios.items() if label % 2]
    if len(antisymmetric) < FEWEST_ANTISYMMETRIC or not symmetric or max(antisymmetric) > 0 or min(symmetric) < 0:
        return ""
    return (
        f"the gains of all antisymmetric modes have the opposite sign of those of {listed_in}, as if the scan were "
        "mirrored: count positions from mid-beam, positive to the participant's right, or give the file of this beam "
        "with --apparatus"
    )
