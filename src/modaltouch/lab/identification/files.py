"""Frequency responses from files of other programs: UFF (data set 58), CSV, NPZ, LabVIEW (LVM), plain numbers."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.identification.responses import QUANTITIES, FrequencyResponses, Quantity, as_velocity

Key = tuple[str, float | None]
"""Excitation and position [m] of a response; no position where a file does not say it."""


@dataclass(frozen=True)
class ResponseFormat:
    """How a file is to be read where it does not say so itself.

    Attributes
    ----------
    quantity : str or None
        ``velocity``, ``displacement`` or ``acceleration``; None takes the file's word.
    conjugated : bool
        Whether the responses follow the time law exp(-i w t).
    spacing : float or None
        Distance of two bins of a file that holds bare numbers [Hz].
    n_averages : int
        Records behind each response, where there is a coherence.
    use_clipped : bool
        Whether the free decay after the last saturated sample of a motion is used.
    """

    quantity: Quantity | None = None
    conjugated: bool = False
    spacing: float | None = None
    n_averages: int = 1
    use_clipped: bool = False


class _Part(NamedTuple):
    """The responses of one file, by excitation and position [m], in SI units of the quantity, where it names one."""

    frequency: FloatArray
    response: dict[Key, ComplexArray]
    coherence: dict[Key, FloatArray]
    quantity: Quantity | None
    marks: tuple[str, ...] = ()


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

MOST_AT_END = 3
"""Samples at its highest or lowest value up to which a record was not saturated."""

DRIVES = {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "n": 1.0, "newton": 1.0, "newtons": 1.0, "kn": 1e3}
"""Units of excitation and their size in SI, folded to small letters."""


def _read_lvm(path: Path, how: ResponseFormat) -> _Part:
    """Return the response of a LabVIEW measurement: one motion and one excitation over time, of one blow."""
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

    def number(cell: str) -> float:
        return float(cell.replace(",", ".") if comma else cell)

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
    step = number(fields["Delta_X"][motion[0]])
    moved, driven = record[motion[0]] * size, record[drive[0]] * DRIVES[units[drive[0]].casefold()]
    frequency, response = transfer(moved, driven, step)
    key = (units[drive[0]], None)
    last = [_last_cut(path, row, unit, step, how.use_clipped) for row, unit in zip(record, units, strict=True)]
    if max(last) < 0:
        return _Part(frequency, {key: response}, {}, quantity)
    if last[drive[0]] >= 0:
        raise ValueError(f"{path}: its excitation was saturated, and nothing can be divided by it: measure again")
    # Only natural frequencies and damping ratios are read off it, each mode with a phase of its own.
    decay = np.where(np.arange(moved.size) > max(last), moved - moved[: _quiet(moved)].mean(), 0.0)
    spectrum = np.fft.rfft(np.roll(decay, -max(last) - 1))[: frequency.size]
    since = (max(last) + 1) * step * 1e3
    mark = f"the record {path.name} was saturated: its free decay from {since:.4g} ms on was used alone"
    return _Part(frequency, {key: np.asarray(spectrum, dtype=complex)}, {}, quantity, (mark,))


def _last_cut(path: Path, row: FloatArray, unit: str, step: float, use_clipped: bool) -> int:
    """Return the last sample at which a record stays at its highest or lowest value, as a converter does; else -1."""
    cut = [np.flatnonzero(row == end) for end in (row.max(), row.min()) if abs(end) > 0.5 * np.abs(row).max()]
    cut = [at for at in cut if at.size > MOST_AT_END]
    last = max((int(at[-1]) for at in cut), default=-1)
    if cut and not use_clipped:
        raise ValueError(
            f"{path}: the channel in {unit} stays at {row[cut[0][0]]:g} for {cut[0].size} samples: it was saturated; "
            f"measure again with a wider range, or use its free decay from {(last + 1) * step * 1e3:.4g} ms on with "
            "--use-clipped"
        )
    return last


def _quiet(record: FloatArray) -> int:
    """Return how many first samples count as zero."""
    return max(8, record.size // 2500)


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
    quiet = _quiet(motion)
    motion, drive = motion - motion[:quiet].mean(), drive - drive[:quiet].mean()
    spectrum = np.fft.rfft(drive)
    frequency = np.fft.rfftfreq(drive.size, step)
    level = np.convolve(np.abs(spectrum), np.ones(25) / 25, "same")
    weak = np.flatnonzero(level < 0.05 * level.max())
    end = int(weak[weak > level.argmax()][0]) if (weak > level.argmax()).any() else frequency.size
    return np.asarray(frequency[:end], dtype=float), np.asarray(np.fft.rfft(motion)[:end] / spectrum[:end])


_FUNCTION, _RESPONSE = 58, 4
_NODES = (15, 2411)
_UNITS = 164
_QUANTITIES: dict[int, Quantity] = {8: "displacement", 11: "velocity", 12: "acceleration"}
"""What a specific data type of an ordinate's numerator is."""


def _read_universal(path: Path, how: ResponseFormat) -> _Part:
    """Return the responses of a universal file.

    Positions are those of the response nodes along the axis in which the nodes spread most, from their middle.
    """
    sets = _read_sets(path)
    functions = [each for each in sets if each["type"] == _FUNCTION and each["func_type"] == _RESPONSE]
    if not functions:
        held = ", ".join(sorted({str(each["type"]) for each in sets})) or "none"
        raise ValueError(f"{path}: no frequency response among the data sets ({held}); export data set 58 of type 4")
    places = _places(sets, functions)
    size = _size(sets)
    kinds = {int(each.get("ordinate_spec_data_type", 0)) for each in functions}
    if len(kinds) > 1:
        raise ValueError(f"{path}: its responses are of several quantities (types {sorted(kinds)}); export one of them")
    frequency = np.asarray(functions[0]["x"], dtype=float)
    found: dict[Key, ComplexArray] = {}
    for each in functions:
        x = np.asarray(each["x"], dtype=float)
        if x.shape != frequency.shape or not np.allclose(x, frequency):
            raise ValueError(f"{path}: its responses have different frequencies; export them on one axis")
        node = int(each["rsp_node"])
        key = (f"reference {int(each['ref_node'])}", places.get(node))
        if key in found:
            key = (f"{key[0]} node {node} direction {int(each['rsp_dir'])}", key[1])
        found[key] = np.asarray(np.asarray(each["data"], dtype=complex) / size, dtype=complex)
    return _Part(frequency, found, {}, _QUANTITIES.get(next(iter(kinds))))


def _read_sets(path: Path) -> list[dict[str, Any]]:
    """Return the data sets of a universal file."""
    import pyuff

    try:
        read = pyuff.UFF(str(path)).read_sets()
    # The library raises bare exceptions, and whatever its parsing meets.
    except Exception as error:
        raise ValueError(f"{path}: cannot be read as a universal file ({error}); export it again") from error
    return [read] if isinstance(read, dict) else list(read)


def _places(sets: list[dict[str, Any]], functions: list[dict[str, Any]]) -> dict[int, float]:
    """Return where the response nodes lie along the beam, from their middle [m]; nothing without coordinates."""
    measured = {int(each["rsp_node"]) for each in functions}
    place = {
        int(number): [float(each[axis][i]) for axis in ("x", "y", "z")]
        for each in sets
        if each["type"] in _NODES
        for i, number in enumerate(each["node_nums"])
    }
    if not measured <= set(place) or len(measured) < 2:
        return {}
    coordinates = np.array(list(place.values()))
    along = int(np.ptp(coordinates, axis=0).argmax())
    middle = (coordinates[:, along].max() + coordinates[:, along].min()) / 2
    return {node: (place[node][along] - middle) / _size(sets) for node in measured}


def _size(sets: list[dict[str, Any]]) -> float:
    """Return the file's unit of length as its number per metre; 1 where it names none."""
    factors = [float(each["length"]) for each in sets if each["type"] == _UNITS]
    return factors[0] if factors and factors[0] > 0 else 1.0


CSV_COLUMNS = ("frequency_Hz", "set", "position_mm", "real", "imag")
"""Columns of responses as CSV; ``coherence`` may follow."""


def read_responses(paths: Sequence[Path], how: ResponseFormat | None = None) -> FrequencyResponses:
    """Return the velocity responses of files, all of one frequency axis.

    Parameters
    ----------
    paths : sequence of Path
        By their ending: ``.uff`` or ``.unv``, ``.csv``, ``.npz``, ``.lvm``, or ``.txt`` with a complex number a line.
    how : ResponseFormat, optional
        What the files do not say.

    Raises
    ------
    ValueError
        If a file cannot be read, does not say what it holds, or does not fit the others; the message begins with its
        path.
    """
    how = how or ResponseFormat()
    if not paths:
        raise ValueError("no file is given: name at least one")
    parts = [(path, _read(path, how)) for path in paths]
    first_path, first = parts[0]
    response: dict[Key, ComplexArray] = {}
    coherence: dict[Key, FloatArray] = {}
    for path, part in parts:
        if part.frequency.shape != first.frequency.shape or not np.allclose(part.frequency, first.frequency):
            raise ValueError(f"{path}: has other frequencies than {first_path}; give files of one measurement")
        quantity = _quantity(path, part, how)
        for key, values in part.response.items():
            name = key if key not in response else (f"{path.stem} {key[0]}", key[1])
            if name in response:
                raise ValueError(f"{path}: has {key[0]} at {key[1]} again; give each response once")
            response[name] = as_velocity(part.frequency, np.conj(values) if how.conjugated else values, quantity)
            if key in part.coherence:
                coherence[name] = part.coherence[key]
    marks = tuple(mark for _, part in parts for mark in part.marks)
    return replace(_assemble(first_path, first.frequency, response, coherence, how.n_averages), marks=marks)


def _quantity(path: Path, part: _Part, how: ResponseFormat) -> Quantity:
    said, found = how.quantity, part.quantity
    if said is None and found is None:
        raise ValueError(f"{path}: does not say whether it holds a velocity, a displacement or an acceleration; say so "
                         "with --quantity")  # fmt: skip
    if said is not None and found is not None and said != found:
        raise ValueError(f"{path}: holds a {found} by its own word, --quantity says {said}; leave that out")
    return said or found  # type: ignore[return-value]


def _assemble(
    path: Path,
    frequency: FloatArray,
    response: dict[Key, ComplexArray],
    coherence: dict[Key, FloatArray],
    n_averages: int,
) -> FrequencyResponses:
    """Return responses as a whole: sets by positions where every set is measured everywhere, else one by one."""
    _check_axis(path, frequency)
    usable = frequency > 0
    for (name, place), values in response.items():
        if not np.isfinite(values[usable]).all():
            where = "" if place is None else f" at {place * 1e3:g} mm"
            raise ValueError(f"{path}: the response to {name}{where} holds what is no finite number; measure it again")
    sets = tuple(dict.fromkeys(name for name, _ in response))
    places = sorted({place for _, place in response if place is not None})
    whole = bool(places) and all((name, place) in response for name in sets for place in places)
    if not whole and places and len(places) > 1:
        name, place = next((s, p) for s in sets for p in places if (s, p) not in response)
        raise ValueError(
            f"{path}: {name} has no response at {place * 1e3:g} mm, where another has; give every excitation at every "
            "position"
        )
    keys = [[(name, place) for place in places] for name in sets] if whole else [[key] for key in response]
    known = n_averages > 1 and all(key in coherence for row in keys for key in row)
    return FrequencyResponses(
        frequency=frequency[usable],
        response=np.array([[response[key][usable] for key in row] for row in keys]),
        positions=np.array(places) if whole else None,
        sets=sets if whole else tuple(row[0][0] for row in keys),
        coherence=np.array([[coherence[key][usable] for key in row] for row in keys]) if known else None,
        n_averages=n_averages if known else 1,
    )


def _check_axis(path: Path, frequency: FloatArray) -> None:
    step = np.diff(frequency)
    if frequency.size < 32:
        raise ValueError(f"{path}: holds {frequency.size} bins; at least 32 are needed")
    if not np.isfinite(frequency).all() or (step <= 0).any() or np.ptp(step) > 1e-3 * step.mean():
        raise ValueError(f"{path}: its frequencies are not evenly spaced and increasing; export them so")


def _read(path: Path, how: ResponseFormat) -> _Part:
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    readers: dict[str, Callable[[Path, ResponseFormat], _Part]] = {
        ".uff": _read_universal,
        ".unv": _read_universal,
        ".csv": _read_csv,
        ".npz": _read_npz,
        ".lvm": _read_lvm,
        ".txt": _read_text,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        remedy = "; an apparatus is named with --apparatus" if path.suffix.lower() in (".yaml", ".yml") else ""
        said = f"files that end in '{path.suffix}' are not read; allowed: {', '.join(readers)}"
        raise ValueError(f"{path}: {said}{remedy}")
    try:
        return reader(path, how)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is no text in UTF-8 (byte {error.start}); export it again") from None


def _read_csv(path: Path, how: ResponseFormat) -> _Part:
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.reader(file))
    header = [cell.strip() for cell in rows[0]] if rows else []
    missing = [name for name in CSV_COLUMNS if name not in header]
    if missing:
        raise ValueError(f"{path}:1: lacks the column {missing[0]}; needed are {', '.join(CSV_COLUMNS)}")
    read: dict[Key, list[tuple[float, complex, float]]] = {}
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            cells = {name: row[index].strip() for index, name in enumerate(header)}
            key = (cells["set"], float(cells["position_mm"]) * 1e-3 if cells["position_mm"] else None)
            number = complex(float(cells["real"]), float(cells["imag"]))
            certain = float(cells["coherence"]) if "coherence" in cells else math.nan
            read.setdefault(key, []).append((float(cells["frequency_Hz"]), number, certain))
        except (ValueError, IndexError):
            raise ValueError(f"{path}:{line}: {','.join(row)!r} is not a line of numbers under the header") from None
    if not read:
        raise ValueError(f"{path}: no line below the header")
    columns = {key: [np.array(column) for column in zip(*each, strict=True)] for key, each in read.items()}
    first = next(iter(columns.values()))[0]
    odd = next((key for key, each in columns.items() if not np.array_equal(each[0], first, equal_nan=True)), None)
    if odd is not None:
        raise ValueError(f"{path}: the set {odd[0]} at {odd[1]} m has other frequencies than the first response")
    coherence = {key: each[2] for key, each in columns.items()} if "coherence" in header else {}
    return _Part(first, {key: each[1] for key, each in columns.items()}, coherence, None)


def _read_npz(path: Path, how: ResponseFormat) -> _Part:
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = dict(file)
        frequency = np.asarray(arrays["frequency"], dtype=float)
        response = np.asarray(arrays["response"], dtype=complex)
        sets = [str(name) for name in arrays["sets"]]
        n_points = response.shape[1]
        places = [float(each) for each in arrays["positions"]] if "positions" in arrays else [None] * n_points
        if response.shape != (len(sets), len(places), frequency.size):
            raise ValueError(f"response has the form {response.shape}")
    # numpy and zipfile raise whatever damage makes them meet.
    except Exception as error:
        raise ValueError(
            f"{path}: cannot be read ({error}); needed are frequency [Hz], response (sets, positions, bins), sets, and "
            "positions [m]"
        ) from None
    # Without positions the points are told apart by their number.
    keys = [
        [(name if place is not None else f"{name} {point}", place) for point, place in enumerate(places, start=1)]
        for name in sets
    ]
    cells = [(key, s, p) for s, row in enumerate(keys) for p, key in enumerate(row)]
    coherence = arrays.get("coherence")
    quantity = str(arrays["quantity"]) if "quantity" in arrays else None
    if quantity is not None and quantity not in QUANTITIES:
        raise ValueError(f"{path}: the quantity is '{quantity}'; allowed: {', '.join(QUANTITIES)}")
    return _Part(
        frequency,
        {key: response[s, p] for key, s, p in cells},
        {} if coherence is None else {key: np.asarray(coherence[s, p], dtype=float) for key, s, p in cells},
        quantity,
    )


def _read_text(path: Path, how: ResponseFormat) -> _Part:
    """Read one complex number a line, as Python prints it, from 0 Hz on."""
    if how.spacing is None:
        raise ValueError(f"{path}: holds bare numbers; say how far its bins are apart with --spacing-Hz")
    values = []
    for line, text in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if not text.strip():
            continue
        try:
            values.append(complex(re.sub(r"\s", "", text).replace("i", "j")))
        except ValueError:
            raise ValueError(f"{path}:{line}: {text[:40]!r} is no complex number such as (1.5-0.2j)") from None
    frequency = np.arange(len(values), dtype=float) * how.spacing
    return _Part(frequency, {(path.stem, None): np.array(values)}, {}, None)
