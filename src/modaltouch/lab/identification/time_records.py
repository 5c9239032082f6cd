"""Frequency responses from time records: one for each impact, or the average over a record without impacts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from modaltouch.lab.common import ComplexArray, FloatArray
from modaltouch.lab.identification.responses import Key, MeasuredResponse, Part, Quantity, ResponseFormat


class TimeRecord(NamedTuple):
    """Excitation and motion over time, in SI units."""

    key: Key
    drive: FloatArray
    motion: FloatArray
    step: float


UNITS: dict[str, tuple[Quantity, float]] = {
    "m/s^2": ("acceleration", 1.0),
    "m/s2": ("acceleration", 1.0),
    "mm/s^2": ("acceleration", 1e-3),
    "g": ("acceleration", 9.80665),
    "m/s": ("velocity", 1.0),
    "mm/s": ("velocity", 1e-3),
    "um/s": ("velocity", 1e-6),
    "m": ("displacement", 1.0),
    "mm": ("displacement", 1e-3),
    "um": ("displacement", 1e-6),
}
"""Units of motion: quantity and conversion factor to SI."""

DRIVES = {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "n": 1.0, "newton": 1.0, "newtons": 1.0, "kn": 1e3}
"""Units of excitation, in lower case, and their conversion factors to SI."""

MOST_AT_END = 3
"""Maximum number of samples at the extreme value of an unsaturated record."""

CUT = 4
"""Ratio of samples at a record's extreme to those at the next value, above which the record is saturated [1]."""

WHITE = 1.7
"""Standard deviation of second differences, relative to that of the values, above which they are noise; white noise has
the square root of 6 [1]."""

STEEP = 0.8
"""Value next to equal samples, relative to theirs, below which they are saturated rather than a rounded peak [1]."""

DECAY = "free decay"
STILL_MOVES = "has not died out at the end of a record: record for longer"
WINDOWED = "an exponential window, which makes damping ratios too large, was applied: record without it"
"""Words of the marks on free decays, truncated ones, and windows."""

FADED = 0.2
"""Noise at the end of a decay, relative to that before the impact, below which a window was applied [1]."""

FEWEST_SAMPLES = 64
"""Minimum number of samples of a record."""

HIT = 0.1
"""Excitation above which it is a hit, relative to its maximum [1]."""

IMPULSIVE = 0.1
"""Largest fraction of samples within hits in a record of impacts [1]."""

APART = 0.5
"""Time between two hits, relative to the median, from which they are separate impacts rather than a double hit [1]."""


def read_lvm(path: Path, how: ResponseFormat) -> Part:
    """Read the responses of a LabVIEW measurement: one motion and one excitation, in one or more segments."""
    pieces = path.read_text(encoding="utf-8-sig").split("***End_of_Header***")
    if len(pieces) < 2:
        raise ValueError(f"{path}: there is no ***End_of_Header***; export a LabVIEW measurement (LVM) with its header")
    # After the header of the file, each segment has a header, which follows the numbers of the previous segment.
    n_heads = min(2, len(pieces) - 1)
    head = "".join(pieces[:n_heads])
    comma = re.search(r"^Decimal_Separator\t,", head, re.MULTILINE) is not None
    fields = {row[0]: row[1:] for row in (line.split("\t") for line in head.splitlines()) if row}
    units = [unit.strip() for unit in fields.get("Y_Unit_Label", ()) if unit.strip()]
    motion = [index for index, unit in enumerate(units) if unit in UNITS]
    drive = [index for index, unit in enumerate(units) if unit.casefold() in DRIVES]
    if len(motion) != 1 or len(drive) != 1:
        raise ValueError(
            f"{path}: its channels are in {', '.join(units) or 'no unit'}; it needs one motion (in "
            f"{', '.join(UNITS)}) and one excitation (in V or N)"
        )

    def number(cell: str) -> float:
        return float(cell.replace(",", ".") if comma else cell)

    quantity, size = UNITS[units[motion[0]]]
    try:
        step, other = (number(fields["Delta_X"][index]) for index in (motion[0], drive[0]))
        start = [number(fields["X0"][index]) if "X0" in fields else 0.0 for index in (motion[0], drive[0])]
        n_samples = [int(cell) for cell in fields.get("Samples", ())[: len(units)] if cell.strip()]
    except (KeyError, IndexError, ValueError):
        step = other = 0.0
    if not step > 0:
        raise ValueError(f"{path}: its header gives no time step (Delta_X) of both channels; export it again")
    if step != other or abs(start[0] - start[1]) > step / 100:
        raise ValueError(f"{path}: motion and excitation differ in time step or start (Delta_X, X0); export them alike")
    # With `Multi`, each channel has its own column of times.
    every = 2 if fields.get("X_Columns", [""])[0].strip() == "Multi" else 1
    records, first_line = [], head.count("\n") + 1
    for piece in pieces[n_heads:]:
        rows: list[list[float]] = []
        for line, cells in enumerate((row.split("\t") for row in piece.splitlines()), start=first_line):
            wanted = [cell for cell in cells[1::every][: len(units)] if cell.strip()]
            heading = not wanted or cells[0][:1].isalpha() or cells[0].startswith("*")
            if heading or (not rows and (len(wanted) != len(units) or wanted[0][:1].isalpha())):
                continue
            # A line that is left out would shift all later samples.
            try:
                rows.append([number(cell) for cell, _ in zip(wanted, units, strict=True)])
            except ValueError:
                raise ValueError(f"{path}:{line}: {wanted} are not numbers of all {len(units)} channels") from None
        first_line += piece.count("\n")
        record = np.array(rows).T if rows else np.zeros((len(units), 0))
        if n_samples and record.shape[1] < max(n_samples):
            held = f"{record.shape[1]} of {max(n_samples)} samples"
            raise ValueError(f"{path}: a record has {held}: the file was cut off; export or copy it again")
        driven = record[drive[0]] * DRIVES[units[drive[0]].casefold()]
        records.append(TimeRecord((units[drive[0]], None), driven, record[motion[0]] * size, step))
    return part_of(path, records, quantity, how, "V" if "v" in units[drive[0]].casefold() else "N")


def part_of(
    path: Path, records: Sequence[TimeRecord], quantity: Quantity | None, how: ResponseFormat, per: str = ""
) -> Part:
    """Compute the responses of time records, up to the highest frequency at which all of them are excited.

    Parameters
    ----------
    path : Path
        The file, for messages.
    records : sequence of TimeRecord
        Records with the same sampling rate.
    quantity : str or None
        Quantity of the motion, if the file states it.
    how : ResponseFormat
        Number of averages, and whether the free decay of a saturated record is used.
    per : str
        Unit of the excitation, V or N, if the file states it.

    Raises
    ------
    ValueError
        If a record is too short or saturated, or all impacts are double hits.
    """
    found: list[tuple[Key, FloatArray, ComplexArray, FloatArray | None]] = []
    marks: list[str] = []
    n_double, n_hits = 0, 0
    for key, drive, motion, step in records:
        _refuse_unusable(path, drive, motion)
        last_drive, last = (_last_cut(path, *each, step, how) for each in (("excitation", drive), ("motion", motion)))
        if last_drive >= 0:
            raise ValueError(f"{path}: its excitation was saturated, so no response can be computed: measure again")
        if last >= 0:
            # Only natural frequencies and damping ratios are identified from it, so the phase of each mode is free.
            decay = np.where(np.arange(motion.size) > last, motion - motion[: _quiet(motion)].mean(), 0.0)
            frequency, _ = transfer(motion, drive, step)
            found.append((key, frequency, np.fft.rfft(np.roll(decay, -last - 1))[: frequency.size], None))
            since = (last + 1) * step * 1e3
            marks.append(f"the record {path.name} was saturated: only its {DECAY} from {since:.4g} ms on was used")
            continue
        hits, n_left_out = impacts(drive, motion)
        if hits is None:
            if how.n_averages < 2:
                raise ValueError(f"{path}: its excitation goes on throughout, so averages are needed: give --averages")
            found.append((key, *averaged(motion, drive, step, how.n_averages)))
            continue
        marks += _spoilt(path.name, drive, motion)
        n_double, n_hits = n_double + n_left_out, n_hits + n_left_out + len(hits)
        found += [(key, *transfer(motion[hit], drive[hit], step), None) for hit in hits]
        if not all(_rests(motion[hit]) or _is_white(motion[hit][-motion[hit].size // 50 :]) for hit in hits):
            marks.append(f"the motion of {path.name} {STILL_MOVES}")
    if not found:
        raise ValueError(f"{path}: all {n_hits} impacts are double hits: strike again, or leave the file out")
    if n_double:
        words = "were left out: double impacts, or cut off by the end of the record"
        marks.append(f"{n_double} of {n_hits} hits of {path.name} {words}")
    axis, responses = _on_one_axis(path, found)
    return Part(axis, responses, quantity, tuple(dict.fromkeys(marks)), per)


def _on_one_axis(
    path: Path, found: Sequence[tuple[Key, FloatArray, ComplexArray, FloatArray | None]]
) -> tuple[FloatArray, list[MeasuredResponse]]:
    """Return the frequencies up to the highest that all responses have [Hz], and the responses at these."""
    n_bins = min(frequency.size for _, frequency, _, _ in found)
    axis = found[0][1][:n_bins]  # spectra of equal records differ in how far their drive reaches
    if not all(np.allclose(frequency[:n_bins], axis) for _, frequency, _, _ in found):
        raise ValueError(
            f"{path}: its records differ in length or sampling rate, or not all of them end at rest; export them all "
            "the same way"
        )
    return axis, [
        MeasuredResponse(key, values[:n_bins], None if c is None else c[:n_bins]) for key, _, values, c in found
    ]


def _spoilt(name: str, drive: FloatArray, motion: FloatArray) -> list[str]:
    """Return a mark on a motion with less noise at its end than before the impact."""
    size = np.abs(drive - np.median(drive))
    high = np.flatnonzero(size > HIT * size.max())
    n_before, n_quiet = int(high[0]) * 3 // 4, (size.size - int(high[-1])) // 4
    # The noise of the drive after the impact tells of a window if there is no record before it.
    pairs = [(motion[:n_before], motion[-n_before:])] * (n_before >= FEWEST_SAMPLES)
    # A window that sets the drive to a constant after the impact is no exponential one.
    is_noisy = n_quiet >= FEWEST_SAMPLES and np.ptp(drive[-n_quiet:]) > 0
    pairs += [(drive[high[-1] :][n_quiet : 2 * n_quiet], drive[-n_quiet:])] * bool(is_noisy)
    noise = [(float(np.std(np.diff(before, 2))), float(np.std(np.diff(after, 2)))) for before, after in pairs]
    return [f"to the motion of {name} {WINDOWED}"] * any(after < FADED * before for before, after in noise)


def _refuse_unusable(path: Path, drive: FloatArray, motion: FloatArray) -> None:
    """Refuse a record that is too short, is not finite, has a constant channel, or begins within its excitation."""
    if not FEWEST_SAMPLES <= drive.size == motion.size:
        raise ValueError(
            f"{path}: it has {drive.size} samples of the excitation and {motion.size} of the motion; both need "
            f"the same number, at least {FEWEST_SAMPLES}"
        )
    if not np.isfinite([drive, motion]).all():
        raise ValueError(f"{path}: its excitation or motion has a value that is not a finite number; measure it again")
    for name, row in (("excitation", drive), ("motion", motion)):
        if not np.ptp(row) > 0:
            raise ValueError(f"{path}: its {name} is constant; measure it again")
    size = np.abs(drive - np.median(drive))
    if size[0] > HIT * size.max() and (size > HIT * size.max()).mean() <= IMPULSIVE:
        raise ValueError(
            f"{path}: its record begins within an impact, whose start is missing: set a pre-trigger, and measure again"
        )


def impacts(drive: FloatArray, motion: FloatArray) -> tuple[list[slice] | None, int]:
    """Return the single impacts of a record with their decays, of equal length, and the number of hits left out.

    A hit less than half the median interval after another, or before another or the end, is left out: it belongs to a
    double impact, or its decay is truncated. A burst with its decay is one impact; the impacts of a record that never
    comes to rest are None.
    """
    size = np.abs(drive - np.median(drive))
    high = np.flatnonzero(size > HIT * size.max())
    if high.size > IMPULSIVE * drive.size:
        return ([slice(0, drive.size)] if _rests(drive) and _rests(motion) else None), 0
    widest = max(part.size for part in np.split(high, np.flatnonzero(np.diff(high) > 1) + 1))
    # Excitation that rises again within the duration of a hit belongs to that hit.
    start = np.append(high[0], high[1:][np.diff(high) > max(3, widest)])
    if start.size == 1:
        return [slice(0, drive.size)], 0
    time = np.diff(np.append(start, drive.size))
    long = time >= APART * np.median(time)
    single = long & np.append(True, long[:-1])
    length = int(time[single].min(initial=drive.size))
    before = min(int(start[0]), length // 50)
    return [slice(at - before, at - before + length) for at in start[single]], int((~single).sum())


def _rests(row: FloatArray) -> bool:
    """Return whether a record ends at rest, apart from a constant offset."""
    size = np.abs(row - np.median(row))
    return bool(size[-size.size // 50 :].max() < HIT * size.max())


def _is_white(tail: FloatArray) -> bool:
    """Return whether the end of a record is noise, of which the second differences are far larger than its values."""
    return bool(np.std(np.diff(tail, 2)) > WHITE * np.std(tail))


def averaged(
    motion: FloatArray, drive: FloatArray, step: float, n_averages: int
) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Return frequencies, H1 and coherence of a record without impacts, with half-overlapping Hann windows."""
    from scipy.signal import csd, welch

    how = {"fs": 1 / step, "nperseg": 2 * drive.size // (n_averages + 1)}
    frequency, power = welch(drive, **how)
    _, cross = csd(drive, motion, **how)
    _, moved = welch(motion, **how)
    return frequency, cross / power, np.abs(cross) ** 2 / (power * moved)


def _last_cut(path: Path, name: str, row: FloatArray, step: float, how: ResponseFormat) -> int:
    """Return the last saturated sample of a record, at its highest or lowest value; -1 if it is not saturated."""
    cut = []
    for end in (each for each in (row.max(), row.min()) if abs(each) > 0.5 * np.abs(row).max()):
        at = np.flatnonzero(row == end)
        # Without saturation, adjacent levels of a converter have similar numbers of samples.
        below = np.abs(row[(row != end) & (row / end > 0.9)])
        # Three equal samples next to a steep fall are not a rounded peak, unless the converter has only a few steps.
        beside = np.abs(row[[max(at[0] - 1, 0), min(at[-1] + 1, row.size - 1)]]).max()
        flat = at.size == at[-1] - at[0] + 1 >= MOST_AT_END and beside < STEEP * abs(end)
        if flat or at.size > max(MOST_AT_END, CUT * int((below == below.max(initial=0.0)).sum())):
            cut.append(at)
    last = max((int(at[-1]) for at in cut), default=-1)
    if cut and not how.use_clipped:
        raise ValueError(
            f"{path}: the {name} stays at {row[cut[0][0]]:g} for {cut[0].size} samples: it was saturated; measure "
            "again with a wider range"
            + (name == "motion")
            * f", or use only its free decay from {(last + 1) * step * 1e3:.4g} ms on with --use-clipped"
        )
    return last


def _quiet(record: FloatArray) -> int:
    """Return the number of initial samples used to determine zero."""
    return max(8, record.size // 2500)


def transfer(motion: FloatArray, drive: FloatArray, step: float) -> tuple[FloatArray, ComplexArray]:
    """Compute the response of a record that begins and ends at rest.

    Parameters
    ----------
    motion, drive : (n_samples,) array
        Time series; the mean of the first samples of the motion and the median of the drive are subtracted.
    step : float
        Time between samples [s].

    Returns
    -------
    frequency : (n_bins,) array
        Frequencies below the point where the drive's amplitude spectrum, smoothed over 25 bins, falls below 10 % of its
        maximum [Hz].
    response : (n_bins,) complex array
        Spectrum of the motion over that of the drive.
    """
    quiet = _quiet(motion)
    # An impact may begin with the record.
    motion, drive = motion - motion[:quiet].mean(), drive - np.median(drive)
    spectrum = np.fft.rfft(drive)
    frequency = np.fft.rfftfreq(drive.size, step)
    level = np.convolve(np.abs(spectrum), np.ones(25) / 25, "same")
    weak = np.flatnonzero(level < 0.1 * level.max())
    # The smoothed level of a drive with a sharp end falls half its width later.
    end = int(weak[weak > level.argmax()][0]) - 12 if (weak > level.argmax()).any() else frequency.size
    return np.asarray(frequency[:end], dtype=float), np.asarray(np.fft.rfft(motion)[:end] / spectrum[:end])


def step_of(path: Path, time: FloatArray) -> float:
    """Return the sampling interval; each time may be rounded by less than half of it."""
    step = float(time[-1] - time[0]) / max(time.size - 1, 1)
    off = np.abs(time - time[0] - step * np.arange(time.size)).max()
    if time.size > 1 and not off < step / 2:
        raise ValueError(
            f"{path}: its times are not evenly spaced and increasing: samples are missing, or the time has too few "
            "digits; export them evenly spaced, with more digits"
        )
    return step
