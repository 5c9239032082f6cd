"""Identified values held against the listed ones of the same beam: confused units, exchanged sets, other settings."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from modaltouch.lab.identification.modal_parameters import Identification, IdentifiedMode
from modaltouch.protocol import Apparatus

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
