"""Frequency responses of a beam: H1 estimates with their coherence, as velocity per volt or per newton."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import ComplexArray, FloatArray
from modaltouch.lab.scan import Scan
from modaltouch.record import RecordInputError

Quantity = Literal["velocity", "displacement", "acceleration"]
QUANTITIES: tuple[Quantity, ...] = ("velocity", "displacement", "acceleration")


class Place(NamedTuple):
    """A point of a beam: distance along it from mid-beam and across it from the mid-line [m]."""

    along: float
    across: float = 0.0

    def __str__(self) -> str:
        """Return the place in millimetres, for messages."""
        return f"{self.along * 1e3:.6g} mm" + (f", {self.across * 1e3:.6g} mm across" if self.across else "")


Key = tuple[str, Place | None]
"""Excitation and place of a response; the place is None if the file does not state it."""

CLEAR_LINE, CERTAIN_LINE = 0.5, 0.75
"""Fraction of the phases that must agree on a time offset of all responses, and on one between some and others [1]."""

SAME_PLACE = 5e-6
"""Distance within which a given position counts as a measured one [m]."""

ROWS_APART = 0.2e-3
"""Minimum distance across the width between two rows of points; smaller ones are scatter within a row [m]."""

LIKE_THE_FIRST, AS_THE_FIRST = 0.5, 0.1
"""Minimum share of a repeat's power that matches the first, and minimum factor between the two; largest deviation of
their median ratio from 1 if they differ at resonances only [1]."""


@dataclass(frozen=True)
class ResponseFormat:
    """Properties that a file does not state, and options for reading it.

    Attributes
    ----------
    quantity : str or None
        ``velocity``, ``displacement`` or ``acceleration``; None to use what the file states.
    conjugated : bool
        Whether the responses follow the time convention exp(-i w t).
    n_averages : int
        Number of records per response with a coherence; number of segments of a record without impacts.
    use_clipped : bool
        Whether to use the free decay after the last saturated sample of a motion.
    band : (lowest, highest)
        Frequencies that are used, and whose values must be sound [Hz].
    """

    quantity: Quantity | None = None
    conjugated: bool = False
    n_averages: int = 1
    use_clipped: bool = False
    band: tuple[float, float] = (0.0, math.inf)


class MeasuredResponse(NamedTuple):
    """A response in SI units of its quantity; another with the same key is a repeat."""

    key: Key
    values: ComplexArray
    coherence: FloatArray | None = None


class Part(NamedTuple):
    """The responses of one file, with their quantity if it is stated."""

    frequency: FloatArray
    responses: list[MeasuredResponse]
    quantity: Quantity | None
    marks: tuple[str, ...] = ()
    per: str = ""  # unit of the excitation, V or N; empty if unknown


@dataclass(frozen=True, eq=False)
class FrequencyResponses:
    """Velocity responses at points of a beam to one or more excitations."""

    frequency: FloatArray  # (n_bins,): evenly spaced, increasing [Hz]
    # (n_sets, n_points, n_bins): velocity per unit of excitation [m/s per V, or per N for a hammer]
    response: ComplexArray
    positions: FloatArray | None  # (n_points,): measurement points, origin at mid-beam [m]; None if unknown
    sets: tuple[str, ...]  # excitations of the beam: actuator sets, or the references of a file
    # (n_sets, n_points, n_bins): ordinary coherence [1]; None for a single record, or if unknown
    coherence: FloatArray | None = None
    n_averages: int = 1  # number of records averaged
    # corner of the vibrometer's first-order low-pass, which is not removed from the responses [Hz]
    bandwidth: float | None = None
    offset: float = 0.0  # time offset between excitation and response that has been removed [s]
    marks: tuple[str, ...] = ()  # warnings that apply to any result from these responses, a sentence each
    # the measurements of which these are the mean, or the responses of each file; empty for a single one
    repeats: tuple[FrequencyResponses, ...] = ()
    across: FloatArray | float = 0.0  # (n_points,): distance of each point from the beam's mid-line [m]
    per: str = ""  # unit of the excitation, V or N; empty if unknown

    @classmethod
    def of_rows(cls, rows: Sequence[FrequencyResponses]) -> FrequencyResponses:
        """Join the responses of several rows of points across the width of a beam."""
        known = [row.coherence for row in rows if row.coherence is not None]
        places = np.array([place for row in rows for place in row.places])
        return replace(
            rows[0],
            response=np.concatenate([row.response for row in rows], axis=1),
            positions=places[:, 0],
            coherence=np.concatenate(known, axis=1) if known else None,
            across=places[:, 1],
        )

    @classmethod
    def of_repeats(cls, repeats: Sequence[FrequencyResponses]) -> FrequencyResponses:
        """Average repeated measurements; those without coherences get the coherence between the repeats.

        Raises
        ------
        ValueError
            If a repeat does not match the first one.
        """
        first = repeats[0]
        if len(repeats) == 1:
            return first
        each = np.array([repeat.response for repeat in repeats])
        power = (np.abs(each) ** 2).sum(axis=(1, 2, 3))
        shared = (np.conj(each[0]) * each).sum(axis=(1, 2, 3))
        factor, likeness = shared.real / power[0], np.abs(shared) ** 2 / (power[0] * power)
        if any(np.array_equal(*pair) for pair in itertools.combinations(each, 2)):
            raise ValueError("two measurements are identical: the same one was given twice; give each once")
        odd = (likeness < LIKE_THE_FIRST) | (np.abs(factor - 1) > 1 - LIKE_THE_FIRST)
        if odd.any():
            number = int(odd.argmax())
            ratio = float(np.median((each[number] / each[0]).real))
            remedy = "check positions, sign, units and trigger of both, and give only repeats of one measurement"
            if abs(ratio - 1) < AS_THE_FIRST:
                remedy = "it does between the resonances, so the beam drifted: let it warm up, and measure again"
            raise ValueError(
                f"measurement {number + 1} does not repeat the first: {likeness[number]:.0%} of its power matches the "
                f"first, scaled {factor[number]:.3g} times; {remedy}"
            )
        mean, n_averages = each.mean(axis=0), sum(repeat.n_averages for repeat in repeats)
        coherence = np.abs(mean) ** 2 / np.maximum((np.abs(each) ** 2).mean(axis=0), 1e-300)
        if first.coherence is not None:
            coherence = np.mean([repeat.coherence for repeat in repeats if repeat.coherence is not None], axis=0)
        return replace(first, response=mean, coherence=coherence, n_averages=n_averages, repeats=tuple(repeats))

    @property
    def n_points(self) -> int:
        """Number of points."""
        return int(self.response.shape[1])

    @property
    def places(self) -> tuple[Place, ...]:
        """Places of the points; empty if unknown."""
        if self.positions is None:
            return ()
        across = np.broadcast_to(self.across, self.positions.shape)
        return tuple(Place(*each) for each in np.stack([self.positions, across], axis=1).tolist())

    @property
    def spacing(self) -> float:
        """Bin spacing [Hz]."""
        return float(self.frequency[1] - self.frequency[0])

    @cached_property
    def noise(self) -> FloatArray:
        r"""Variance of the estimated responses, pooled over points and neighbouring bins, (n_sets, n_bins) array.

        For n averaged records it is :math:`|H|^2 (1 - \gamma^2) / (\gamma^2 (n - 1))`. Without a coherence it is
        estimated from the second differences over the bins, and assumed to be similar within an octave.
        """
        from scipy.ndimage import percentile_filter

        steep: FloatArray | float = 1.0
        if self.coherence is not None and self.n_averages > 1:
            gamma, n_free = np.clip(self.coherence, 1e-9, 1.0), self.n_averages - 1
            variance = np.abs(self.response) ** 2 * (1 - gamma) / gamma / n_free
        else:
            second = np.zeros_like(self.response)
            second[..., 1:-1] = self.response[..., 2:] - 2 * self.response[..., 1:-1] + self.response[..., :-2]
            second[..., 0], second[..., -1] = second[..., 1], second[..., -2]
            n_free, variance = 1, np.abs(second) ** 2 / 6
            # White noise of an accelerometer, the steepest towards 0 Hz.
            steep = self.frequency**2
        # The median of fewer than five points is hardly more robust than their mean.
        pooled = np.median(variance, axis=1) if self.n_points >= 5 else variance.mean(axis=1)
        # Like the excitation, the noise varies slowly with frequency.
        smooth = np.array([_running_median(row * steep, 33) / steep for row in pooled])
        if self.coherence is None or self.n_averages < 2:
            # At a resonance the response itself dominates the second difference, so use what is around it.
            grid = np.geomspace(self.frequency[0], self.frequency[-1], 400)
            octave = max(3, round(400 * np.log(2) / np.log(grid[-1] / grid[0])))
            rows = (np.interp(grid, self.frequency, row) for row in smooth)
            quiet = (percentile_filter(row, 25, octave, mode="nearest") for row in rows)
            smooth = np.array([np.interp(self.frequency, grid, row) for row in quiet])
        # Ratio of mean to median of a gamma distribution of shape n_free: 1/ln 2 for one.
        scale = n_free / (n_free - 1 / 3 + 0.024 / n_free)
        floor = (1e-7 * np.abs(self.response).max(axis=(1, 2))) ** 2
        return np.asarray(np.maximum(smooth * scale, floor[:, None]))

    def aligned(self) -> FrequencyResponses:
        r"""Remove the time offset between motion and excitation, estimated from the slope of the phase.

        Away from resonances the square of a response with real residues and an offset has the phase
        :math:`\pi - 2\omega\tau`, for either sign of the shape, so its Fourier transform over the band has a line at
        :math:`2\tau`. An offset of less than half a cycle of phase over the band is left to the delay of the fit.
        """
        power = np.abs(self.response) ** 2
        squares = self.response**2 / np.maximum(power + self.noise[:, None], 1e-300)
        if self.positions is not None:
            self._refuse_several_delays(squares)
        # An offset turns the phase by half a cycle over the band.
        resolution = float(1 / (2 * (self.frequency[-1] - self.frequency[0])))
        offset = self._offset(squares.sum(axis=(0, 1)), 16, CLEAR_LINE, resolution)
        if not offset:
            return self
        turned = self.response * np.exp(2j * np.pi * self.frequency * offset)
        return replace(self, response=turned, offset=self.offset + offset)

    def _offset(self, squares: ComplexArray, finer: int, least: float, reach: float) -> float | None:
        """Return the time offset of squared responses to a fraction of the resolution; None without a clear line.

        It is 0 unless the line is clearly higher than any within `reach` of 0 [s].
        """
        n_fft = 1 << int(np.ceil(np.log2(finer * squares.size)))
        time = np.fft.fftfreq(n_fft, self.spacing) / 2
        near = np.abs(time) <= reach
        line = np.abs(np.fft.ifft(squares, n_fft)) * n_fft / max(float(np.abs(squares).sum()), 1e-300)
        # No offset beyond 20 ms is looked for.
        line[np.abs(time) > min(20e-3, 1 / (8 * self.spacing))] = 0.0
        at, at_zero = int(line.argmax()), float(line[near].max())
        if line[at] < least:
            return None
        return float(time[at]) if not near[at] and line[at] >= 1.2 * at_zero else 0.0

    def _refuse_several_delays(self, squares: ComplexArray) -> None:
        """Refuse sets or points whose delays differ from those of the others; a filter common to all cancels."""
        by_set, by_point = squares.sum(axis=1), squares.sum(axis=0)
        total = by_point.sum(axis=0)
        relative = {
            "sets": zip(self.sets, by_set * by_set[0].conj(), strict=True),
            "points": zip(self.places, by_point * (total - by_point).conj(), strict=True),
        }
        for what, each in relative.items():
            late = {str(name): self._offset(values, 4, CERTAIN_LINE, 0.0) or 0.0 for name, values in each}
            named = [f"{name} {delay * 1e3:.4g} ms" for name, delay in late.items() if delay or what == "sets"]
            if any(late.values()):
                raise ValueError(
                    f"the delay of the motion differs between the {what} ({', '.join(named)}): start all records at "
                    "their excitation, check the trigger, and export them again"
                )

    def without(self, places: Sequence[float]) -> FrequencyResponses:
        """Leave out the responses at given positions [m], and note it in the marks."""
        positions = np.array([]) if self.positions is None else self.positions
        left_out, across = np.zeros(positions.size, dtype=bool), np.broadcast_to(self.across, positions.shape)
        for place in places:
            at = np.isclose(positions, place, rtol=0.0, atol=SAME_PLACE)
            if not at.any():
                held = ", ".join(f"{each * 1e3:g}" for each in np.unique(positions)) or "none"
                raise ValueError(f"--leave-out {place * 1e3:g} is not a measured position; allowed: {held} mm")
            left_out |= at
        named = ", ".join(f"{place * 1e3:g}" for place in np.unique(positions[left_out]))
        return replace(
            self,
            response=self.response[:, ~left_out],
            positions=positions[~left_out],
            across=across[~left_out],
            coherence=None if self.coherence is None else self.coherence[:, ~left_out],
            marks=(*self.marks, f"the responses at {named} mm were left out"),
            repeats=tuple(each.without(places) for each in self.repeats),
        )

    def between(self, lowest: float, highest: float) -> FrequencyResponses:
        """Return the responses within a band [Hz]."""
        kept = (self.frequency >= lowest) & (self.frequency <= highest)
        if kept.sum() < FEWEST_BINS:
            low, high = self.frequency[[0, -1]]
            raise ValueError(
                f"{int(kept.sum())} bins lie between {lowest:g} and {min(highest, high):g} Hz; at least {FEWEST_BINS} "
                f"are needed: choose a wider band within {low:g} to {high:g} Hz"
            )
        return replace(
            self,
            frequency=self.frequency[kept],
            response=self.response[..., kept],
            coherence=None if self.coherence is None else self.coherence[..., kept],
            repeats=tuple(each.between(lowest, highest) for each in self.repeats),
        )


FEWEST_BINS = 16
"""Minimum number of bins of responses."""

LONGEST_RUN = 16
"""Maximum number of equal values in a row in a measured response."""


def refuse_faulty_values(which: str, values: ComplexArray, place: Place | None) -> None:
    """Refuse values of a response that are not finite, zero, or held over many bins, or a place that is not finite."""
    if not np.isfinite([*values, *(place or ())]).all():
        raise ValueError(f"{which} contains a value that is not finite; measure it again")
    n_zeros = int((values == 0).sum())
    if n_zeros:
        often = "throughout" if n_zeros == values.size else f"at {n_zeros} of {values.size} frequencies"
        raise ValueError(
            f"{which} is zero {often}; measure it again, export it with more digits, or use a narrower band"
        )
    run = int(np.diff(np.flatnonzero(np.append(True, np.append(np.diff(values) != 0, True)))).max())
    if run > LONGEST_RUN:
        raise ValueError(f"{which} has the same value at {run} frequencies in a row; export it again")


def refuse_copies(path: Path, response: Mapping[Key, ComplexArray]) -> None:
    """Refuse a response that is a copy of another; mirror images are alike if they are computed without noise."""
    own = {values.tobytes(): key for key, values in response.items()}
    for (name, place), values in response.items():
        named, other = own[values.tobytes()]
        if (named, other) != (name, place) and not (place and other and abs(place.along + other.along) < SAME_PLACE):
            both = f"{name} at {place or 'one point'} and {named} at {other or 'one point'}"
            raise ValueError(f"{path}: the responses to {both} are identical: one is a copy of the other")


def _running_median(values: FloatArray, width: int) -> FloatArray:
    """Return the medians of blocks of neighbouring values, interpolated linearly."""
    blocks = np.array_split(values, max(1, values.size // width))
    centres = np.cumsum([block.size for block in blocks]) - np.array([(block.size + 1) / 2 for block in blocks])
    return np.interp(np.arange(values.size), centres, [np.median(block) for block in blocks])


def responses_of(scans: Mapping[str, Scan], bandwidth: float | None = None) -> FrequencyResponses:
    r"""Estimate H1 responses from scans of spectra: :math:`H_1 = S_{vu} / S_{uu}` with the *measured* drive u.

    Parameters
    ----------
    scans : mapping of str to Scan
        One complete scan per actuator set, all at the same positions.
    bandwidth : float, optional
        Corner of the vibrometer's low-pass [Hz].

    Raises
    ------
    RecordInputError
        If a scan is incomplete, contains no drive, or has different positions, frequencies or numbers of records from
        the first.
    """
    response: list[ComplexArray] = []
    coherence: list[FloatArray] = []
    positions, across = next(iter(scans.values())).positions, next(iter(scans.values())).across
    first = next(iter(scans.values())).arrays[0]
    for name, scan in scans.items():
        scan.require_complete()
        if (
            scan.positions.shape != positions.shape
            or not np.allclose(scan.positions, positions)
            or scan.across != across
        ):
            raise RecordInputError(
                f"the positions in the scan of the set {name} differ from those of the first: scan it again"
            )
        for position, each in zip(positions, scan.arrays, strict=True):
            if any(not np.array_equal(each.get(key, ()), first[key]) for key in ("frequency", "n_records")):
                raise RecordInputError(
                    f"frequencies or number of records of the set {name} at {position * 1e3:g} mm differ from those of "
                    "the first scan: scan all sets with the same options"
                )
        drive, velocity = scan.stacked("drive_power"), scan.stacked("velocity_power")
        cross = np.stack([np.asarray(each["cross_power"], dtype=complex) for each in scan.arrays])
        faulty = ~(np.isfinite(cross) & np.isfinite(velocity) & (drive > 0)).all(axis=-1)
        if faulty.any():
            raise RecordInputError(
                f"the drive of the set {name} at {positions[faulty.argmax()] * 1e3:g} mm is zero, or a value is not "
                "finite: check the probe at the amplifier's output, and scan again into another folder"
            )
        response.append(np.asarray(cross / drive, dtype=complex))
        coherence.append(np.abs(cross) ** 2 / (drive * velocity))
    n_averages = int(first["n_records"])
    order = np.argsort(positions)
    return FrequencyResponses(
        frequency=np.asarray(first["frequency"], dtype=float),
        response=np.stack(response)[:, order],
        positions=positions[order],
        sets=tuple(scans),
        coherence=np.stack(coherence)[:, order] if n_averages > 1 else None,
        n_averages=n_averages,
        bandwidth=bandwidth,
        across=across,
        per="V",
    )


def along(places: Sequence[Place]) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the distinct positions along a beam, common to all its rows, and the index of each point's position.

    Since the positions of a scanned grid scatter, points of different rows share a position if they are within a
    quarter of the smallest spacing in a row.
    """
    x, y = np.array(places).T
    row = _grouped(y, ROWS_APART)
    order = np.lexsort((x, row))
    spacing = np.diff(x[order])[np.diff(row[order]) == 0]
    spacing = spacing[spacing > SAME_PLACE]
    which = _grouped(x, max(SAME_PLACE, float(spacing.min()) / 4) if spacing.size else SAME_PLACE)
    return np.bincount(which, x) / np.bincount(which), which


def _grouped(values: FloatArray, apart: float) -> NDArray[np.intp]:
    """Return a group number for each value, in increasing order; a larger distance begins a new group."""
    order = np.argsort(values)
    group = np.empty(values.size, dtype=np.intp)
    group[order] = np.cumsum(np.diff(values[order], prepend=values[order[0]]) > apart)
    return group


def as_velocity(frequency: FloatArray, response: ComplexArray, quantity: Quantity) -> ComplexArray:
    r"""Convert responses in SI units to velocity; the result at 0 Hz must not be used.

    A displacement is multiplied by :math:`i\omega`, an acceleration divided by it.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = 2j * np.pi * frequency
        if quantity == "displacement":
            return np.asarray(response * turn)
        return np.asarray(response / turn) if quantity == "acceleration" else response
