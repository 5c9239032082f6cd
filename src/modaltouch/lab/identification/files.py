"""Frequency responses and time records from other programs: universal files, CSV, NPZ, LVM."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from modaltouch.lab.common import ComplexArray, FloatArray
from modaltouch.lab.identification.responses import (
    QUANTITIES,
    FrequencyResponses,
    Key,
    MeasuredResponse,
    Part,
    Place,
    Quantity,
    ResponseFormat,
    as_velocity,
    refuse_copies,
    refuse_faulty_values,
)
from modaltouch.lab.identification.time_records import TimeRecord, part_of, read_lvm, step_of
from modaltouch.lab.identification.universal_file import read_universal

if TYPE_CHECKING:
    from pandas import DataFrame

CSV_COLUMNS = ("frequency_Hz", "set", "position_mm", "real", "imag")
"""Columns of responses in a CSV file; ``coherence`` and ``across_mm``, from the mid-line, may follow. Repeats follow
each other in one file or come in several files."""

LEAST_DECIBELS, ALIKE = 10.0, 3.0
"""Minimum median magnitude of numbers that may be decibels, and their maximum over it; responses exceed that [1]."""

MOST = 2.5 * np.pi
"""Largest phase change of a response across its highest peak [rad]; that of a resonance is less than pi."""

FEWEST_SIGNED = 6
"""Number of places from which at least one response of a beam must have a negative real part."""

TIME_COLUMNS = ("time_s", "set", "position_mm", "drive", "motion")
"""Columns of time records in a CSV file, drive and motion in SI units."""


def read_responses(paths: Sequence[Path], how: ResponseFormat | None = None) -> FrequencyResponses:
    """Read velocity responses from files with a common frequency axis.

    Parameters
    ----------
    paths : sequence of Path
        The extension determines the format: ``.uff`` or ``.unv``, ``.csv``, ``.npz``, or ``.lvm``.
    how : ResponseFormat, optional
        What the files do not state.

    Raises
    ------
    ValueError
        If a file cannot be read, does not state its quantity, or does not match the others; the message begins with its
        path.
    """
    how = how or ResponseFormat()
    if not paths:
        raise ValueError("no file is given: give at least one")
    parts = [(path, _with_even_axis(path, _read(path, how))) for path in paths]
    first_path, first = parts[0]
    n_bins = min(part.frequency.size for _, part in parts)
    frequency = first.frequency[:n_bins]
    found: dict[Key, list[MeasuredResponse]] = {}
    by_file: list[dict[Key, list[MeasuredResponse]]] = []
    for path, part in parts:
        if not np.allclose(part.frequency[:n_bins], frequency):
            raise ValueError(
                f"{path}: its frequencies differ from those of {first_path}; give files of one measurement"
            )
        quantity = _quantity(path, part, how)
        _refuse_amplitudes(path, part)
        of_file: dict[Key, list[MeasuredResponse]] = {}
        for key, values, coherence in part.responses:
            # Without places, responses with equal names in different files may belong to different points.
            name = (f"{path.stem} {key[0]}", None) if key[1] is None and key in found else key
            velocity = as_velocity(part.frequency, np.conj(values) if how.conjugated else values, quantity)[:n_bins]
            each = MeasuredResponse(name, velocity, None if coherence is None else coherence[:n_bins])
            of_file.setdefault(name, []).append(each)
        for name, repeats in of_file.items():
            found.setdefault(name, []).extend(repeats)
        by_file.append(of_file)
    marks = [mark for _, part in parts for mark in part.marks]
    n_repeats = [len(repeats) for repeats in found.values()]
    if min(n_repeats) < max(n_repeats):
        marks.append(
            f"{sum(n_repeats) - min(n_repeats) * len(n_repeats)} repeats were left out: some points have fewer"
        )
    whole = FrequencyResponses.of_repeats(
        [_assemble(first_path, frequency, found, repeat, how) for repeat in range(min(n_repeats))]
    )
    if whole.positions is None and not whole.repeats and len(by_file) > 1:
        alone = [_assemble(path, frequency, each, 0, how) for path, each in zip(paths, by_file, strict=True)]
        whole = replace(whole, repeats=tuple(alone))
    units = {part.per for _, part in parts}
    return replace(whole, marks=tuple(marks), per=units.pop() if len(units) == 1 else "")


def _quantity(path: Path, part: Part, how: ResponseFormat) -> Quantity:
    given, found = how.quantity, part.quantity
    if given is None and found is None:
        raise ValueError(
            f"{path}: it does not say whether it contains a velocity, a displacement or an acceleration; say so with "
            "--quantity")  # fmt: skip
    if given is not None and found is not None and given != found:
        raise ValueError(f"{path}: its quantity is {found}, but --quantity says {given}; leave --quantity out")
    return given or found  # type: ignore[return-value]


def _refuse_amplitudes(path: Path, part: Part) -> None:
    """Refuse numbers that cannot be complex responses of a beam."""
    # Undefined values count as none, as those at 0 Hz often are.
    values = np.nan_to_num([each.values for each in part.responses], posinf=0.0, neginf=0.0)
    size, places = np.abs(values), {key[1] for key, *_ in part.responses if key[1] is not None}
    typical = float(np.median(size))
    faults = {
        "the imaginary part is zero throughout": not values.imag.any(),
        "the real part is zero throughout": not values.real.any(),
        "no response has a negative real part: magnitudes were exported in its place": bool((values.real >= 0).all()),
        "the values are large and alike: they are decibels": typical > LEAST_DECIBELS and size.max() < ALIKE * typical,
        "the phase turns several times within each peak: degrees were taken for radians": _turns(values, size) > MOST,
    }
    fault = next((fault for fault, found in faults.items() if found), None)
    if fault and len(places) >= FEWEST_SIGNED:
        raise ValueError(f"{path}: {fault}; export real and imaginary part, in SI units")
    first, start = values[:, 0], part.frequency[0]
    if start > 0 and first.all() and values.imag.any() and not first.imag.any():
        raise ValueError(
            f"{path}: the responses at its first frequency, {start:.6g} Hz, are all real, as they can only be at 0 Hz: "
            "its frequencies are that much too high; export them from 0 Hz on"
        )


def _assemble(
    path: Path, frequency: FloatArray, found: dict[Key, list[MeasuredResponse]], repeat: int, how: ResponseFormat
) -> FrequencyResponses:
    """Assemble one repeat: sets by positions if all sets were measured at all places, else one set per response."""
    response = {key: repeats[repeat].values for key, repeats in found.items()}
    coherence = {key: repeats[repeat].coherence for key, repeats in found.items()}
    usable, n_averages = frequency > 0, how.n_averages
    used = usable & (frequency >= how.band[0]) & (frequency <= how.band[1])
    for (name, place), values in response.items():
        which = f"{path}: the response to {name}" + ("" if place is None else f" at {place}")
        refuse_faulty_values(which, values[used], place)
        certainty = coherence[name, place]
        # An excess of a thousandth is rounding.
        if certainty is not None and not ((certainty >= 0) & (certainty <= 1.001))[used].all():
            raise ValueError(
                f"{which} has a coherence that is not between 0 and 1 throughout; export it as a share of 1, or leave "
                "it out"
            )
    sets = tuple(dict.fromkeys(name for name, _ in response))
    places = sorted({place for _, place in response if place is not None})
    whole = bool(places) and all((name, place) in response for name in sets for place in places)
    if not whole and places and len(places) > 1:
        name, place = next((s, p) for s in sets for p in places if (s, p) not in response)
        raise ValueError(
            f"{path}: {name} has no response at {place}, but another excitation has; give every excitation at every "
            "position"
        )
    refuse_copies(path, response)
    keys = [[(name, place) for place in places] for name in sets] if whole else [[key] for key in response]
    certain = [[coherence[key] for key in row] for row in keys]
    known = n_averages > 1 and all(each is not None for row in certain for each in row)
    return FrequencyResponses(
        frequency=frequency[usable],
        response=np.array([[response[key][usable] for key in row] for row in keys]),
        positions=np.array([place.along for place in places]) if whole else None,
        across=np.array([place.across for place in places]) if whole else 0.0,
        sets=sets if whole else tuple(row[0][0] for row in keys),
        coherence=np.array(certain)[..., usable] if known else None,
        n_averages=n_averages if known else 1,
    )


def _with_even_axis(path: Path, part: Part) -> Part:
    """Return the responses with the rounding of their evenly spaced frequencies removed; refuse other frequencies."""
    frequency = part.frequency
    if frequency.size < 32:
        raise ValueError(f"{path}: it has {frequency.size} bins; at least 32 are needed")
    even = np.linspace(frequency[0], frequency[-1], frequency.size)
    off, step = np.abs(frequency - even).max(), even[1] - even[0]
    if not off < step / 4:
        raise ValueError(f"{path}: its frequencies are not evenly spaced and increasing; export them that way")
    return part._replace(frequency=even if off > 1e-3 * step else frequency)


def _read(path: Path, how: ResponseFormat) -> Part:
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    readers: dict[str, Callable[[Path, ResponseFormat], Part]] = {
        ".uff": read_universal,
        ".unv": read_universal,
        ".csv": _read_csv,
        ".npz": _read_npz,
        ".lvm": read_lvm,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        remedy = "; give an apparatus with --apparatus" if path.suffix.lower() in (".yaml", ".yml") else ""
        problem = f"files that end in '{path.suffix}' cannot be read; allowed: {', '.join(readers)}"
        raise ValueError(f"{path}: {problem}{remedy}")
    try:
        return reader(path, how)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is not text in UTF-8 (byte {error.start}); export it again") from None
    except (csv.Error, IndexError, KeyError) as error:
        raise ValueError(f"{path}: is damaged or incomplete ({error}); export it again") from None


def _read_csv(path: Path, how: ResponseFormat) -> Part:
    table = _table(path)
    over_time, known = TIME_COLUMNS[0] in table, "coherence" in table
    axis, *_, first_part, second_part = TIME_COLUMNS if over_time else CSV_COLUMNS
    repeats: list[tuple[Key, FloatArray]] = []
    for which, lines in table.groupby(["set", "position_mm", "across_mm"], sort=False, dropna=False):
        name, along, across = cast(tuple[str, float, float], which)
        key = (name, None if math.isnan(along) else Place(along * 1e-3, across * 1e-3))
        numbers = lines[[axis, first_part, second_part, *["coherence"] * known]].to_numpy().T
        # A repeat begins where the frequency returns to its first value.
        back = np.flatnonzero(np.diff(numbers[0]) < -np.ptp(numbers[0]) / 2) + 1
        repeats += [(key, each) for each in np.split(numbers, back, axis=1)]
    first = repeats[0][1][0]
    odd = next((key for key, numbers in repeats if not np.array_equal(numbers[0], first)), None)
    if odd is not None:
        what = "times" if over_time else "frequencies"
        raise ValueError(f"{path}: the set {odd[0]} at {odd[1]} does not have the {what} of the first response")
    columns = [(key, numbers[1], numbers[2], numbers[3] if known else None) for key, numbers in repeats]
    return _part(path, first, columns, over_time, None, how)


def _part(
    path: Path,
    axis: FloatArray,
    columns: Sequence[tuple[Key, FloatArray, FloatArray, FloatArray | None]],
    over_time: bool,
    quantity: Quantity | None,
    how: ResponseFormat,
) -> Part:
    """Return the responses with these real and imaginary parts and coherences, or of these drives and motions."""
    if over_time:
        step = step_of(path, axis)
        return part_of(path, [TimeRecord(key, drive, motion, step) for key, drive, motion, _ in columns], quantity, how)
    return Part(axis, [MeasuredResponse(key, real + 1j * imag, known) for key, real, imag, known in columns], quantity)


def _table(path: Path) -> DataFrame:
    """Read a CSV file, also with semicolons or tabs and decimal commas; an unknown position is NaN."""
    import pandas as pd

    with path.open(encoding="utf-8-sig", newline="") as file:
        heading = file.readline()
        separator = max(",;\t", key=heading.count)
        rows = list(csv.reader(file, delimiter=separator))
    names = [name.strip(' "') for name in heading.rstrip(f"{separator} \r\n").split(separator)]
    needed = TIME_COLUMNS if TIME_COLUMNS[0] in names else CSV_COLUMNS
    missing = [name for name in needed if name not in names]
    if missing:
        raise ValueError(f"{path}:1: the column {missing[0]} is missing; it needs {', '.join(needed)}")
    if len(set(names)) < len(names):
        raise ValueError(f"{path}:1: a column appears twice in {', '.join(names)}; export each once")
    for line, row in enumerate(rows, start=2):
        if "".join(row[len(names) :]).strip():
            cause = ": a decimal comma splits a number" if separator == "," else ""
            raise ValueError(
                f"{path}:{line}: {separator.join(row)[:80]!r} has more fields than columns{cause}; export points in "
                "numbers, and quotation marks around a name that contains a separator"
            )
    given = pd.DataFrame([[*row, *[""] * len(names)][: len(names)] for row in rows], columns=names, dtype=object)
    given = given[(given != "").any(axis=1)]
    if given.empty:
        raise ValueError(f"{path}: there is no line below the header")
    used = [name for name in names if name in {*needed, "across_mm", "coherence"} - {"set"}]
    marked = [given[used].sum(axis=1).str.contains(mark, regex=False).to_numpy(dtype=bool) for mark in ",."]
    mixed = np.logical_and(*np.logical_or.accumulate(marked, axis=1))
    if mixed.any():
        line = given.index[mixed.argmax()]
        raise ValueError(
            f"{path}:{line + 2}: {separator.join(given.loc[line])[:80]!r}: commas and points are mixed in the numbers "
            "of the file; export one decimal mark for all, and no mark between thousands"
        )
    comma = "." if separator == "," else ","
    table: DataFrame = given[used].apply(lambda cells: pd.to_numeric(cells.str.replace(comma, "."), errors="coerce"))
    # A place may be unknown, and a ratio undefined where nothing is excited, as at 0 Hz.
    undefined = {
        name: [""] if name.endswith("_mm") else ["nan", "-nan", "inf", "-inf"] for name in used if name != needed[0]
    }
    cells = given[used].apply(lambda cells: cells.str.strip().str.lower())
    faulty = ~(np.isfinite(table) | cells.isin(undefined)).all(axis=1)
    if faulty.any():
        line = given.index[np.flatnonzero(faulty)[0]]
        raise ValueError(
            f"{path}:{line + 2}: {separator.join(given.loc[line])[:80]!r} does not give a number for each column of "
            "the header"
        )
    table["set"] = given["set"].str.strip()
    table["across_mm"] = table["across_mm"].fillna(0.0) if "across_mm" in table else 0.0
    return table


def _read_npz(path: Path, how: ResponseFormat) -> Part:
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = dict(file)
        over_time = "time" in arrays
        axis = arrays["time" if over_time else "frequency"].astype(float, casting="same_kind")
        values = arrays["drive"] + 1j * arrays["motion"] if over_time else np.asarray(arrays["response"], dtype=complex)
        sets = [str(name) for name in arrays["sets"]]
        n_points = values.shape[-2]
        places: list[Place | None] = [None] * n_points
        if "positions" in arrays:
            across = np.broadcast_to(arrays.get("across", 0.0), n_points)
            places = [Place(*map(float, each)) for each in zip(arrays["positions"], across, strict=True)]
        if values.shape[-3:] != (len(sets), len(places), axis.size) or values.ndim > 4:
            raise ValueError(f"{'drive' if over_time else 'response'} has the shape {values.shape}")
        values = values.reshape(-1, *values.shape[-3:])
        coherence = np.asarray(arrays.get("coherence", np.nan), dtype=float) * np.ones(values.shape)
    # A damaged file makes numpy and zipfile raise almost anything.
    except Exception as error:
        raise ValueError(
            f"{path}: cannot be read ({error}); it needs frequency [Hz] and response (sets, positions, bins), or time "
            "[s], drive and motion (sets, positions, samples), sets, positions [m] and, for rows, across [m]; "
            "repeats may come first"
        ) from None
    quantity = str(arrays["quantity"]) if "quantity" in arrays else None
    if quantity is not None and quantity not in QUANTITIES:
        raise ValueError(f"{path}: the quantity is '{quantity}'; allowed: {', '.join(QUANTITIES)}")
    # Without positions the points are distinguished by their number.
    columns = [
        (
            (name if place is not None else f"{name} {point + 1}", place),
            each[s, point].real,
            each[s, point].imag,
            certain[s, point] if "coherence" in arrays else None,
        )
        for each, certain in zip(values, coherence, strict=True)
        for s, name in enumerate(sets)
        for point, place in enumerate(places)
    ]
    return _part(path, axis, columns, over_time, quantity, how)


def _turns(values: ComplexArray, size: FloatArray) -> float:
    """Return the median phase change of responses, a row each, across their peaks, excluding a delay [rad]."""
    turned = []
    for row, amplitude in zip(values, size, strict=True):
        turn = np.angle(row[1:] * row[:-1].conj())
        turn = np.angle(np.exp(1j * (turn - np.median(turn))))
        top, low = int(amplitude.argmax()), np.flatnonzero(amplitude < amplitude.max() / 2**0.5)
        first, last = low[low < top].max(initial=0), low[low > top].min(initial=turn.size)
        turned.append(np.abs(turn[first:last]).sum())
    return float(np.median(turned))
