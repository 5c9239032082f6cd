"""What is wrong with an identification: the cause of its residual, and of values unlike the listed ones.

The cause of a residual is the pattern over points and modes that explains most of it. The responses are fitted again
with one pole for each pair of close poles, which drift splits. The residual is then projected on the changes that a
fault makes to first order: of natural frequencies, by point, by set or by the mass of a sensor that moves along the
beam; of the phase, by point, in proportion to the frequency or not; of the phase, by mode.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from modaltouch.lab.common import FloatArray
from modaltouch.lab.identification.joint_fit import make_problem, refine
from modaltouch.lab.identification.kernel import Evaluation, Poles
from modaltouch.lab.identification.modal_parameters import REMEDIES, Identification, IdentifiedMode
from modaltouch.lab.identification.shapes import bending_likeness, straightened
from modaltouch.protocol import Apparatus

EXPLAINS = 0.4
"""Minimum share of the residual that a pattern explains if it is the cause [1]."""

ALMOST = 0.85
"""Share explained by a second pattern, relative to the first, above which both are named [1]."""

UNMISTAKABLE = 0.98
"""Minimum MAC of a folded mode with its shape, and of the modes above it with theirs [1]."""

FILTERED = 0.05
"""Minimum share of the residual explained by one phase for each mode if a filter is the cause [1]."""


def probable_cause(
    found: Identification, odd_point: str = "", least: float = 0.0, fit: Evaluation | None = None
) -> str:
    """Describe the most probable cause of the residual with its remedy, or the two most probable; empty if unclear.

    A point that holds most of the residual, if described, is the cause unless a pattern explains it. None is named if
    the misfit of the poles with one in place of close ones, of which the fit may be given, is below `least`.
    """
    fit = fit or _refitted(found)
    if fit is None or fit.variance < least:
        return odd_point
    shares, moved, sensor = _shares(fit, *found.responses.response.shape[:2])
    names = _explaining(shares)
    if not names:
        return odd_point or _named(*_common_causes(found, fit))
    if names[0] == "drift":
        return _other_beam(found, moved) or _named(*names)
    return _named(*names, size=f"about {sensor:.2g} of the beam's; " if names[0].startswith("the mass") else "")


def causes_by_mode(found: Identification, modes: Sequence[IdentifiedMode]) -> dict[str, list[IdentifiedMode]]:
    """Describe the most probable causes of the residual around modes, with the modes that each of them affects.

    The cause of the whole residual is that of a mode unless other patterns explain what is left around it.
    """
    fit = _refitted(found) if modes else None
    whole = probable_cause(found, fit=fit) if modes else ""
    grouped: dict[str, list[IdentifiedMode]] = {}
    for mode in modes:
        names, known = [mode.rest.cause], whole
        if fit is not None and len(modes) > 1:
            near = _around(fit, mode)
            shares = _shares(near, *found.responses.response.shape[:2])[0]
            names = _explaining(shares) or _common_causes(found, near) or names
            # A pattern of several modes explains one of them if no other does so far better.
            explained = max((share for name, share in shares.items() if name in whole), default=EXPLAINS)
            known = whole if any(name in whole for name in names) or explained >= EXPLAINS else ""
        grouped.setdefault(known or _named(*names), []).append(mode)
    return grouped


def _refitted(found: Identification) -> Evaluation | None:
    """Return the fit of one measurement with one pole in place of close ones; None without shapes."""
    if found.poles is None or not found.responses.places:
        return None
    poles = _merged(found, found.poles)
    # The mean of repeats hides how they differ.
    responses = found.responses.repeats[0].aligned() if found.responses.repeats else found.responses
    return refine(make_problem(responses, poles), poles)


def _around(fit: Evaluation, mode: IdentifiedMode) -> Evaluation:
    """Return a fit within two half-power bandwidths on either side of a mode."""
    own, ratio = mode.natural_frequency.value, mode.damping_ratio.value
    bins, inside = fit.problem.bins.between(own * (1 - 4 * ratio), own * (1 + 4 * ratio))
    rows = np.tile(inside, 2)
    problem = replace(fit.problem, bins=bins)
    return replace(fit, problem=problem, rest=fit.rest[rows], slope=fit.slope[rows], turned=fit.turned[rows])


def _explaining(shares: Mapping[str, float]) -> list[str]:
    """Return the pattern that explains the residual, and the second if it is almost as good; empty if none does."""
    first, second, *_ = sorted(shares, key=lambda each: -shares[each])
    also = [second] if shares[second] > ALMOST * shares[first] else []
    return [first, *also] if shares[first] >= EXPLAINS else []


def _named(first: str = "", *others: str, size: str = "") -> str:
    also = "".join(f"; or {other}: {REMEDIES[other]}" for other in others)
    return first and f"the most probable cause is {first}: {size}{REMEDIES[first]}{also}"


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


def _shares(fit: Evaluation, n_sets: int, n_points: int) -> tuple[dict[str, float], FloatArray, float]:
    """Return the share of the residual that each pattern explains, the points' frequency changes, and a moved mass."""
    n, rest, residue = fit.n_modes, fit.rest, fit.residue
    by_frequency = fit.slope[:, :n] / fit.poles.damping_ratio
    omega = 2 * np.pi * fit.poles.natural_frequency / fit.problem.highest
    by_phase = fit.turned[:, :n] / omega
    total = max(float((rest**2).sum()) - rest.size, 1e-300)

    def explained(pattern: FloatArray, axis: int) -> tuple[FloatArray, float]:
        """Return the factors of a pattern, one for each point or set, and the share that it explains."""
        overlap = (pattern * rest).sum(axis=0).reshape(n_sets, n_points).sum(axis=axis)
        size = np.maximum((pattern**2).sum(axis=0).reshape(n_sets, n_points).sum(axis=axis), 1e-300)
        return overlap / size, float((overlap**2 / size).sum()) / total

    moved = by_frequency @ residue[:n]
    factor, drift = explained(moved, 0)
    # A sensor lowers each natural frequency by its mass and the square of the shape where it is.
    common = np.array(
        [np.linalg.svd(each.reshape(n_sets, n_points), full_matrices=False)[2][0] for each in residue[:n]]
    )
    square, power = n_points * np.tile(common**2, n_sets), residue[:n] ** 2
    mean = (square * power).sum(axis=1, keepdims=True) / power.sum(axis=1, keepdims=True)
    loaded = by_frequency @ (residue[:n] * (square - mean))
    mass = float((loaded * rest).sum() / max(float((loaded**2).sum()), 1e-300))
    shares = {
        "drift": drift,
        "drift between the sets": explained(moved, 1)[1] if n_sets > 1 else 0.0,
        "the mass of a sensor that is moved": mass**2 * float((loaded**2).sum()) / total * (mass < 0),
        "a trigger that is late at some points": explained(fit.turned @ residue, 0)[1],
        "a phase that differs between the points": explained(by_phase @ residue[:n], 0)[1],
    }
    return shares, factor, -2 * mass


def _common_causes(found: Identification, fit: Evaluation) -> list[str]:
    """Return the causes of a residual that has the shapes of the modes themselves; empty if it has not."""
    n, rest, left = fit.n_modes, fit.rest, fit.left
    power = float((rest**2).sum()) - rest.size
    nearest = np.abs(np.log(fit.problem.bins.centre[:, None] / fit.poles.natural_frequency)).argmin(axis=1)
    shape = fit.residue[nearest] / np.linalg.norm(fit.residue[nearest], axis=1, keepdims=True)
    if (np.abs((left * shape).sum(axis=1)) ** 2).sum() - 2 * len(left) <= EXPLAINS * power:
        return []
    by_phase = fit.turned[:, :n]
    overlap = ((by_phase.T @ rest) * fit.residue[:n]).sum(axis=1)
    curvature = (by_phase.T @ by_phase) * (fit.residue[:n] @ fit.residue[:n].T)
    filtered = float(overlap @ np.linalg.lstsq(curvature, overlap, rcond=1e-12)[0])
    if filtered > FILTERED * power:
        # The phase of a high-pass leads in proportion to the reciprocal frequency; an exponential window lags alike.
        steep = 1 / fit.poles.natural_frequency**2
        along = float(steep @ overlap)
        if 2 * along**2 > filtered * float(steep @ curvature @ steep):
            return ["a high-pass" if along < 0 else "an exponential window"]
        return ["a filter that is not listed"]
    first = found.responses.frequency[0] / found.responses.spacing
    if abs(first - round(first)) > 1e-3 * max(1.0, first / 1e3):
        return ["interpolation of the responses", "nonlinearity"]
    return ["nonlinearity"]


def aliased(found: Identification) -> str:
    """Describe resonances with shapes of modes that lie higher, as folded at half the sampling rate; else empty."""
    places, length = found.responses.places, found.length
    # On a single row torsion resembles rigid motion and the lowest modes, and drift leaves these labels free.
    labels = [mode.label if mode.mac > UNMISTAKABLE else None for mode in found.modes]
    if not places or length is None:
        return ""
    likeness = bending_likeness(np.array([straightened(mode.residue).real for mode in found.modes]), places, length)
    folded = [
        f"{mode.name} is that of mode {int(alike.argmax()) + 1}"
        for k, (mode, alike) in enumerate(zip(found.modes, likeness, strict=True))
        if not (mode.label or mode.torsion) and alike.max() > UNMISTAKABLE
        if any(label is not None and label <= alike.argmax() for label in labels[k:])
    ]
    return folded and f"the shape at {', '.join(folded)}, which lies higher: {_named('aliasing')}" or ""


def _other_beam(found: Identification, moved: FloatArray) -> str:
    """Describe points of which all natural frequencies differ alike from those of the others; empty if there are none.

    Those of a beam that drifts change gradually, and those of one that was changed during the scan once.
    """
    order = np.argsort(moved)
    at = int(np.diff(moved[order]).argmax()) + 1
    groups = order[:at], order[at:]
    step = float(moved[groups[1]].mean() - moved[groups[0]].mean())
    high = np.isin(np.arange(moved.size), groups[1])
    if max(moved[each].std() for each in groups) > step / 8 or np.count_nonzero(np.diff(high)) < 2:
        return ""
    few = min(groups, key=len)
    named = ", ".join(str(found.responses.places[point]) for point in np.sort(few))
    size = f"{step:.2%} {'higher' if few is groups[1] else 'lower'}"
    return (
        f"the responses at {named} have resonances of their own, {size} than those of the other points: "
        f"{REMEDIES['a strange point']}"
    )


FEWEST_GAINS = 3
"""Minimum number of listed gains, or natural frequencies, to recognise a common factor."""

SPREAD = 0.1
"""Relative tolerance of a factor between units that are often confused [1]."""

FACTORS = {
    9.80665: "an acceleration in g was taken for m/s^2, or the other way round, or a 10 : 1 probe for 1 : 1",
    1e3: "a prefix, milli or kilo, was missed",
}
"""Factors between units that are often confused, and their meaning."""

ROUGHLY = 1.0
"""Relative tolerance of gains for a factor of a thousand [1]."""

MOST_GAINS = 0.75
"""Minimum fraction of the gains within the tolerance; labels at the end of the band may belong to other modes [1]."""


AXES = {
    2 * np.pi: "angular frequencies [rad/s] taken for frequencies [Hz]",
    1e3: "a prefix, milli or kilo, was missed",
}
"""Factors between frequency units that are often confused, and their meaning."""


MOVED, FASTER = 0.05, 2.5
"""Relative change of a natural frequency, and factor of a gain, above which a warning is given [1]."""

SCALE, EQUALLY = 1.25, 0.2
"""Factor of all gains of a set above which a warning is given, and their median relative deviation from it below which
the factor is that of a drive or a sensor, not of the beam [1]."""


def check_gains(identification: Identification, apparatus: Apparatus, labels: Sequence[int] | None = None) -> list[str]:
    """Refuse natural frequencies, or gains of one set or all, that differ from the listed ones by a factor of units.

    Other large differences from the listed values may be real and are returned as warnings, a sentence each.

    Parameters
    ----------
    identification, apparatus
        The modes found, and the table of the same beam; fewer than three values in common are not checked.
    labels : sequence of int, optional
        Modes to warn about; all if not given.

    Raises
    ------
    ValueError
        If such a factor is found; the message states it and the units that were probably confused.
    """
    found, sets = identification.by_label, identification.responses.sets
    listed = {
        (name, mode.label): (own.gain[sets.index(name)].value * 1e3 / value, own.natural_frequency.value)
        for mode in apparatus.modes
        for own in [found.get(mode.label)]
        for name, value in mode.gain_mm_s2_per_V.items()
        if own is not None and own.gain and name in sets and value
    }
    ratios = {
        mode.label: found[mode.label].natural_frequency.value / mode.natural_frequency_Hz
        for mode in apparatus.modes
        if mode.label in found
    }
    _refuse_axis([*ratios.values()], apparatus)
    _refuse_exchanged(found, sets, apparatus)
    for chosen in dict.fromkeys((sets, *((name,) for name in sets))):
        _refuse_factor([each for (name, _), each in listed.items() if name in chosen], chosen, apparatus)
    if len(ratios) < FEWEST_GAINS:
        return []
    if mirrored := _mirrored({key: each for key, (each, _) in listed.items()}, apparatus):
        return [mirrored]
    shown = ratios if labels is None else labels
    moved = {f"mode {label}": each for label, each in ratios.items() if label in shown and abs(each - 1) > MOVED}
    other: dict[str, float] = {}
    for name in sets:
        own = {label: each for (by, label), (each, _) in listed.items() if by == name}
        common = float(np.median([*own.values()])) if len(own) >= FEWEST_GAINS else 1.0
        if not 1 / SCALE < common < SCALE and np.median(np.abs(np.array([*own.values()]) / common - 1)) < EQUALLY:
            other[f"every mode by {name}"] = common
            continue
        far = {label: each for label, each in own.items() if label in shown and not 1 / FASTER < each < FASTER}
        other |= {f"mode {label} by {name}": each for label, each in far.items()}
    return [
        f"{what}, times those listed: {', '.join(f'{each:.3g} for {name}' for name, each in far.items())}; check "
        f"{remedy}, or give the file of this beam with --apparatus"
        for what, far, remedy in (
            ("natural frequencies", moved, "the sampling rate and the frequency axis"),
            ("gains", other, "units, settings, signs and wiring of drive and sensor, and which set is which"),
        )
        if far
    ]


def _refuse_axis(ratios: Sequence[float], apparatus: Apparatus) -> None:
    """Refuse ratios of natural frequencies to the listed ones that equal a factor between units."""
    for factor, meaning in AXES.items():
        for size in (factor, 1 / factor):
            near = np.abs(np.array(ratios) / size - 1) < SPREAD
            if len(ratios) >= FEWEST_GAINS and near.mean() >= MOST_GAINS:
                raise ValueError(
                    f"the natural frequencies are {np.median(ratios):.3g} times those of {apparatus.apparatus}: "
                    f"{meaning}; check the frequencies or times in the files, or give the file of this beam with "
                    "--apparatus"
                )


def _mirrored(ratios: Mapping[tuple[str, int], float], apparatus: Apparatus) -> str:
    """Describe gains of which those of all antisymmetric modes have the other sign than the listed ones; else empty."""
    antisymmetric = [each for (_, label), each in ratios.items() if label % 2 == 0]
    symmetric = [each for (_, label), each in ratios.items() if label % 2]
    if len(antisymmetric) < FEWEST_GAINS or not symmetric or max(antisymmetric) > 0 or min(symmetric) < 0:
        return ""
    return (
        f"the gains of all antisymmetric modes have the opposite sign of those of {apparatus.apparatus}, as if the "
        "scan were mirrored: count positions from mid-beam, positive to the participant's right, or give the file of "
        "this beam with --apparatus"
    )


def _refuse_exchanged(found: Mapping[int, IdentifiedMode], sets: Sequence[str], apparatus: Apparatus) -> None:
    """Refuse gains of the sets that are the listed ones of other sets."""
    factor, off = np.full((2, len(sets), len(sets)), np.nan)
    for (row, _), (column, other) in itertools.product(enumerate(sets), enumerate(sets)):
        known = [
            (found[mode.label], mode.gain_mm_s2_per_V.get(other)) for mode in apparatus.modes if mode.label in found
        ]
        ratio = [own.gain[row].value * 1e3 / value for own, value in known if own.gain and value]
        if len(ratio) >= FEWEST_GAINS:
            size = np.log(np.abs(ratio))
            factor[row, column], off[row, column] = np.median(size), np.median(np.abs(size))
    # Sets that move each other's modes by a tenth seem exchanged if all gains are tenfold, as by a wrong unit.
    if len(sets) < 2 or np.isnan(off).any() or (np.diag(factor) > np.log(SCALE)).all():
        return
    nearest, correct = off.argmin(axis=1), np.arange(len(sets))
    if (nearest != correct).all() and (off[correct, nearest] < np.log(SCALE)).all():
        pairs = " and ".join(f"{sets[other]} under the name {name}" for name, other in zip(sets, nearest, strict=True))
        raise ValueError(f"the sets are exchanged: the files hold the gains of {pairs}; name each set after its wiring")


def _refuse_factor(listed: Sequence[tuple[float, float]], sets: Sequence[str], apparatus: Apparatus) -> None:
    """Refuse ratios of gains to the listed ones, each with its natural frequency, that equal a factor between units."""
    if len(listed) < FEWEST_GAINS:
        return
    ratio, frequency = np.abs(np.array(listed)).T
    for power, quantity in ((0, ""), (1, " times 2 pi f"), (-1, " over 2 pi f")):
        each = ratio / (2 * np.pi * frequency) ** power
        factor = float(np.median(each))
        meaning, spread = "", SPREAD
        if power and abs(factor - 1) < SPREAD:
            meaning = "the motion is not the quantity given with --quantity"
        for size, units in FACTORS.items():
            # An approximately correct table suffices for a factor of a thousand.
            wide = ROUGHLY if size > 1 / SPREAD**2 and not power else SPREAD
            if abs(abs(np.log(factor)) - np.log(size)) < np.log1p(wide):
                meaning, spread = units, wide
        if meaning and (np.abs(np.log(each / factor)) < np.log1p(spread)).mean() >= MOST_GAINS:
            raise ValueError(
                f"the gains of {' and '.join(sets)} are {factor:.3g}{quantity} times those of {apparatus.apparatus}: "
                f"{meaning}; check the units of the measurement, or give the file of this beam with --apparatus"
            )
