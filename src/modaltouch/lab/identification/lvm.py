"""Responses of a blow that LabVIEW recorded (LVM)."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.identification.responses import Quantity

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

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
"""Units of motion: what they are of, and their size in SI."""

DRIVES = {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "n": 1.0, "newton": 1.0, "newtons": 1.0, "kn": 1e3}
"""Units of excitation and their size in SI, folded to small letters."""


def read_lvm(path: Path) -> tuple[FloatArray, str, ComplexArray, Quantity]:
    """Return the response of a LabVIEW measurement: one motion and one excitation over time, of one blow.

    Parameters
    ----------
    path : Path
        The file, with its header; decimal commas are read by what the header says.

    Returns
    -------
    frequency : (n_bins,) array
        [Hz].
    excitation : str
        Unit of the excitation, as the file has it.
    response : (n_bins,) complex array
        In SI units of the quantity per unit of the excitation.
    quantity : str
        By the unit of the motion.

    Raises
    ------
    ValueError
        If the file has no such channels, is cut, or holds no numbers; the message begins with the path.
    """
    text = path.read_text(encoding="utf-8-sig")
    head, mark, body = text.rpartition("***End_of_Header***")
    if not mark:
        raise ValueError(f"{path}: has no ***End_of_Header***; export a LabVIEW measurement (LVM) with its header")
    comma = re.search(r"^Decimal_Separator\t,", head, re.MULTILINE) is not None
    fields = {row[0]: row[1:] for row in (line.split("\t") for line in head.splitlines()) if row}
    units = [unit.strip() for unit in fields.get("Y_Unit_Label", ()) if unit.strip()]
    motion = [index for index, unit in enumerate(units) if unit in UNITS]
    drive = [index for index, unit in enumerate(units) if unit.casefold() in DRIVES]
    if len(motion) != 1 or len(drive) != 1:
        raise ValueError(
            f"{path}: its channels are in {', '.join(units) or 'no unit'}; needed are one motion (in "
            f"{', '.join(UNITS)}) and one excitation (in V or N)"
        )
    number = _number_reader(comma)
    rows: list[list[float]] = []
    first_line = head.count("\n") + 1
    for line, cells in enumerate((row.split("\t") for row in body.splitlines()), start=first_line):
        wanted = [cell for cell in cells[1 : len(units) + 1] if cell.strip()]
        if len(wanted) != len(units) or wanted[0][:1].isalpha():
            continue
        try:
            rows.append([number(cell) for cell in wanted])
        except ValueError:
            raise ValueError(f"{path}:{line}: {wanted} are no numbers") from None
    if len(rows) < 64:
        raise ValueError(f"{path}: holds {len(rows)} samples; at least 64 are needed")
    record = np.array(rows).T
    quantity, size = UNITS[units[motion[0]]]
    _refuse_cut(path, record, units)
    step = number(fields["Delta_X"][motion[0]])
    frequency, response = transfer(
        record[motion[0]] * size, record[drive[0]] * DRIVES[units[drive[0]].casefold()], step
    )
    return frequency, units[drive[0]], response, quantity


def _number_reader(comma: bool) -> Callable[[str], float]:
    return lambda cell: float(cell.replace(",", ".") if comma else cell)


def _refuse_cut(path: Path, record: FloatArray, units: Sequence[str]) -> None:
    """Refuse a record that stays at its highest or lowest value, as a converter at its end does."""
    for row, unit in zip(record, units, strict=True):
        for end in (row.max(), row.min()):
            run = int((row == end).sum())
            if run > 3 and abs(end) > 0.5 * np.abs(row).max():
                raise ValueError(
                    f"{path}: the channel in {unit} stays at {end:g} for {run} samples: it was saturated; measure "
                    "again with a wider range"
                )


def transfer(motion: FloatArray, drive: FloatArray, step: float) -> tuple[FloatArray, ComplexArray]:
    """Return the response of one record that begins and ends at rest.

    Parameters
    ----------
    motion, drive : (n_samples,) array
        Over time; their first samples, before the blow, count as zero.
    step : float
        Between samples [s].

    Returns
    -------
    frequency : (n_bins,) array
        As far as the drive has a hundredth of its highest spectral density [Hz].
    response : (n_bins,) complex array
        Spectrum over spectrum.
    """
    quiet = max(8, motion.size // 2500)
    motion, drive = motion - motion[:quiet].mean(), drive - drive[:quiet].mean()
    spectrum = np.fft.rfft(drive)
    frequency = np.fft.rfftfreq(drive.size, step)
    level = np.convolve(np.abs(spectrum), np.ones(25) / 25, "same")
    weak = np.flatnonzero(level < 0.05 * level.max())
    end = int(weak[weak > level.argmax()][0]) if (weak > level.argmax()).any() else frequency.size
    return np.asarray(frequency[:end], dtype=float), np.asarray(np.fft.rfft(motion)[:end] / spectrum[:end])
