"""A scope whose records arrive as files that other software writes on request.

``wanted.json`` in the folder describes the requested record; the scope, or its operator, writes the record as CSV::

    time_s,velocity_V,drive_1_V,drive_2_V
    0.02504,0.1873,-31.2,14.6
    0.0250422,0.1871,-31.4,14.1

A new record begins wherever the time jumps back; the file has as many records as requested. Time 0 is the trigger at
the start of the burst. ``velocity_V`` is the vibrometer's output, which ``acquisition.sensitivity_mm_s_per_V`` converts
to a velocity; a column ``velocity_m_s`` may replace it. ``drive_1_V`` is the voltage at the beam itself, with the
probe's attenuation already taken into account. An NPZ file holds arrays of these names, (n_samples,) or
(n_records, n_samples). Of records with n times the requested sampling rate every n-th sample is used.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import FloatArray
from modaltouch.lab.laboratory import MeasurementProgress
from modaltouch.lab.scan import LARGEST_SHIFT
from modaltouch.protocol import Apparatus
from modaltouch.record import replace_file
from modaltouch.rig import Acquisition, Recording, RigError, Scope

POLL = 0.5
"""Polling interval; a file is complete once it has not changed from one poll to the next [s]."""

PATIENCE = 20
"""Number of polls after which an unchanged file is one under another name, and not a record being written."""

MOST_OVERSAMPLED = 50.0
"""Largest sampling rate of a file, relative to the requested one [1]."""

WANTED = "wanted.json"
"""File that describes the requested record."""

REMEDY = "move it away, or give another folder with --record"

FORM = "save it as UTF-8, with commas between columns and points in decimals"


class RecordedFiles(Scope):
    """A scope that reads its records from files.

    Parameters
    ----------
    folder : Path
        Folder of the files; earlier files in it are left unchanged.
    apparatus : Apparatus
        Its section ``acquisition`` gives the vibrometer's sensitivity and range.
    progress : MeasurementProgress
        Reports the awaited file and why a file was refused; may stop the wait.
    """

    slowest = 1800.0

    def __init__(self, folder: Path, apparatus: Apparatus, progress: MeasurementProgress) -> None:
        self.identity = f"records in {folder}"
        self._folder, self._progress = folder, progress
        self._sensitivity = apparatus.acquisition.sensitivity_mm_s_per_V * 1e-3
        self._highest = apparatus.acquisition.range_mm_s * 1e-3
        self._grids: dict[tuple[float, ...], FloatArray] = {}
        self._former: dict[bytes, str] = {}
        self._asked = Acquisition()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RigError(f"{folder}: cannot hold records ({error.strerror}); {REMEDY}") from None

    def configure(self, acquisition: Acquisition) -> Acquisition:
        """Store the settings that the next records must match."""
        self._asked = acquisition
        return acquisition

    def measure(self, position: float, across: float = 0.0) -> Recording:
        """Request a record, and return it as soon as a valid file arrives."""
        known = {*self._folder.glob("*"), self._folder / WANTED}
        taken = [int(each.stem) for each in known if each.stem.isdecimal()]
        name = f"{max(taken, default=0) + 1:04d}"
        if taken and not self._former:
            self._remember(f"{max(taken):04d}")
        since, refused, why = dict[tuple[Path, int, int], float](), set[tuple[Path, int, int]](), ""
        deadline = time.monotonic() + self.slowest
        try:
            self._ask(name, position, across)
            while (now := time.monotonic()) < deadline:
                self._progress.check()
                before, since = since, {}
                # A file may disappear before it is examined; the next poll looks for it again.
                with suppress(OSError):
                    stats = ((path, path.stat()) for path in sorted({*self._folder.glob("[!.]*")} - known))
                    states = [(path, stat.st_size, stat.st_mtime_ns) for path, stat in stats]
                    since = {each: before.get(each, now) for each in states}
                # Some scopes write the file extension in capitals.
                found = {each for each in since if each[0].name.lower() in {name + end for end in READERS}}
                if found and found <= before.keys() and found != refused:
                    try:
                        return self._recording(*(path for path, *_ in sorted(found)), position=position)
                    except (OSError, ValueError) as error:
                        refused, why = found, f" ({error})"
                        self._progress.say(f"{error}; write it again")
                        self._ask(name, position, across, str(error))
                for path, *_ in (each for each in since.keys() - found if now - since[each] > PATIENCE * POLL):
                    why = f" ({path.name} came instead)"
                    self._progress.say(f"{path} is not read: the record that is awaited is {name}.csv or {name}.npz")
                    known.add(path)
                time.sleep(POLL)
            raise RigError(
                f"no usable record arrived as {self._folder / name}.csv or .npz within {self.slowest / 60:g} min{why}; "
                f"the outputs are off; get the scope ready and run the command again"
            )
        finally:
            # Not in `close`: another command, refused because the generator is in use, must not cancel the request.
            (self._folder / WANTED).unlink(missing_ok=True)

    def _ask(self, name: str, position: float, across: float, refused: str = "") -> None:
        """Announce the awaited record on the screen and in ``wanted.json``."""
        asked = self._asked
        first, last = asked.start, asked.start + (asked.n_samples - 1) / asked.sampling_rate
        highest = asked.velocity_range or self._highest
        wanted = {
            "file": name,
            "position_mm": position * 1e3,
            "across_mm": across * 1e3,
            "n_records": asked.n_records,
            "sampling_rate_Hz": asked.sampling_rate,
            "first_s": first,
            "last_s": last,
            "drives": list(asked.drives),
            "velocity_up_to_m_s": highest,
            "drive_up_to_V": asked.drive_range,
            "refused": refused,
        }
        replace_file(self._folder / WANTED, (json.dumps(wanted, indent=1) + "\n").encode(), REMEDY)
        if not refused:
            also = "".join(f", drive {number}" for number in asked.drives)
            where = f"{position * 1e3:+.2f} mm" + (f", {across * 1e3:+.2f} mm across," if across else "")
            self._progress.say(
                f"waiting for {self._folder / name}.csv or .npz: {asked.n_records} records at {where} of "
                f"velocity{also}, {first * 1e3:.6g} to {last * 1e3:.6g} ms after the trigger, at least "
                f"{asked.sampling_rate * 1e-3:.6g} kHz, up to {highest * 1e3:.4g} mm/s"
            )

    def _recording(self, path: Path, *others: Path, position: float) -> Recording:
        """Return the recording in a file, cut to the requested window; refuse further files of the same name."""
        if others:
            raise ValueError(f"{path}: {others[0].name} also exists; delete one of the two")
        asked, table = self._asked, READERS[path.suffix.lower()](path)
        names = ["velocity_m_s" if "velocity_m_s" in table else "velocity_V", *(f"drive_{n}_V" for n in asked.drives)]
        for name in ("time_s", *names):
            if name not in table:
                raise ValueError(f"{path}:1: the column {name} is missing; found: {', '.join(table)}")
            if not np.isfinite(table[name]).all():
                raise ValueError(f"{_place(path, ~np.isfinite(table[name]))}: {name} is not a finite number")
        begin, step, kept = _window(path, table["time_s"], asked)
        velocity, *drives = (table[name][:, kept] for name in names)
        n_samples = velocity.shape[1]
        key = asked.start, asked.n_samples, asked.sampling_rate
        grid = np.array([begin, begin + n_samples * step, n_samples])
        if np.abs(grid - self._grids.setdefault(key, grid)).max() > LARGEST_SHIFT:
            raise ValueError(
                f"{path}: its sampling instants differ from those of the records before; use the same sampling rate "
                "for all, and no interpolation of the trigger"
            )
        self._refuse_former(path, table[names[0]])
        velocity = velocity * (self._sensitivity if names[0] == "velocity_V" else 1.0)
        highest = float(np.abs(velocity).max())
        over = _is_cut(velocity) or highest > self._highest
        if over:
            self._progress.say(f"{path}: its velocity is clipped or out of range, with up to {highest * 1e3:.4g} mm/s")
        return Recording(
            position=position,
            time=np.asarray(begin + step * np.arange(n_samples), dtype=float),
            velocity=velocity,
            drive=np.stack(drives, axis=1) if drives else np.empty((asked.n_records, 0, n_samples)),
            sampling_rate=1 / step,
            overloaded=("velocity",) if over else (),
        )

    def _remember(self, name: str) -> None:
        """Store a digest of the last record left by an earlier command, if it can be read, to detect a repeat."""
        for path in self._folder.glob(f"{name}.*"):
            with suppress(KeyError, OSError, ValueError):
                table = READERS[path.suffix.lower()](path)
                self._refuse_former(path, table["velocity_m_s" if "velocity_m_s" in table else "velocity_V"])

    def _refuse_former(self, path: Path, velocity: FloatArray) -> None:
        """Refuse a record identical to an earlier one: the noise of two bursts is never the same."""
        marks = [hashlib.blake2b(record.tobytes(), digest_size=16).digest() for record in velocity]
        if len(marks) > len(set(marks)) == 1:
            raise ValueError(f"{path}: its {len(marks)} records are identical; record {len(marks)} bursts")
        former = next((self._former[mark] for mark in marks if mark in self._former), None)
        if former is not None:
            raise ValueError(f"{path}: its velocity is identical to that of {former}; arm the scope again")
        self._former |= dict.fromkeys(marks, path.name)


def _window(path: Path, time_s: FloatArray, asked: Acquisition) -> tuple[float, float, slice]:
    """Return the first kept instant and the time step [s], and the indices of the samples kept."""
    n_records, n = time_s.shape
    if n_records != asked.n_records or n < 2:
        raise ValueError(
            f"{path}: it contains {n_records} records of {n} samples; {asked.n_records} records were requested"
        )
    # Times in files have few digits: a fit over all samples is more accurate than any single one.
    order = np.arange(n) - (n - 1) / 2
    step = float((time_s @ order).mean() / (order @ order))
    uneven = np.abs(time_s - time_s.mean() - step * order) > max(step / 4, LARGEST_SHIFT)
    if uneven.any() or not step > 0:
        raise ValueError(f"{_place(path, uneven)}: time_s is not evenly spaced, or not as in the first record")
    if np.ptp(time_s.mean(axis=1)) > LARGEST_SHIFT:
        raise ValueError(
            f"{path}: the sampling instants of its records differ by {np.ptp(time_s.mean(axis=1)) * 1e9:.0f} ns, at "
            f"most {LARGEST_SHIFT * 1e9:.0f} ns are allowed; switch off interpolation of the trigger"
        )
    if not 0.999 <= 1 / step / asked.sampling_rate <= MOST_OVERSAMPLED:
        raise ValueError(
            f"{path}: it was sampled at {1e-3 / step:.6g} kHz; allowed: {asked.sampling_rate * 1e-3:.6g} to "
            f"{MOST_OVERSAMPLED * asked.sampling_rate * 1e-3:.6g} kHz; give time_s in seconds"
        )
    start, length = float(time_s.mean()) - step * (n - 1) / 2, (asked.n_samples - 1) / asked.sampling_rate
    first = max(0, math.ceil((asked.start - start) / step - 0.05))
    # A finer sampling than requested would show lines of the converter's steps that look like modes.
    every = int(1 / step / asked.sampling_rate + 2e-3)
    kept = slice(first, first + int(length / step + 1e-3), every)
    if start > asked.start + step or kept.stop > n:
        raise ValueError(
            f"{path}: its records last from {start * 1e3:.6g} to {(start + step * (n - 1)) * 1e3:.6g} ms after the "
            f"trigger; {asked.start * 1e3:.6g} to {(asked.start + length) * 1e3:.6g} ms were requested"
        )
    return start + step * first, step * every, kept


def _place(path: Path, faulty: NDArray[np.bool_]) -> str:
    """Return the location in a file of the first faulty sample of an (n_records, n_samples) array."""
    record, sample = np.unravel_index(int(faulty.argmax()), faulty.shape)
    if path.suffix == ".csv":
        return f"{path}:{2 + record * faulty.shape[1] + sample}"
    return f"{path}: record {record + 1}, sample {sample + 1}"


def _is_cut(velocity: FloatArray) -> bool:
    """Return whether records are clipped: far more samples sit at their extreme than at the next value."""
    for values in (velocity, -velocity):
        counts = np.unique(values, return_counts=True)[1]
        if counts.size > 1 and counts[-1] > 4 * (counts[-2] + len(velocity)):
            return True
    return False


def _read_csv(path: Path) -> dict[str, FloatArray]:
    """Return the columns of a CSV file, (n_records, n_samples) arrays."""
    # Bytes that are not UTF-8 are reported with their cell.
    header, *rows = path.read_text(encoding="utf-8-sig", errors="replace").splitlines() or [""]
    names = [name.strip() for name in header.split(",")]
    if "time_s" not in names:
        raise ValueError(f"{path}:1: the column time_s is missing; found: {header[:80]!r}; {FORM}")
    if len(set(names)) < len(names):
        raise ValueError(f"{path}:1: a column appears twice in {', '.join(names)}")
    values = np.array([_numbers(path, line, row, len(names)) for line, row in enumerate(rows or [""], start=2)])
    time_s = values[:, names.index("time_s")]
    if not np.isfinite(time_s).all():
        raise ValueError(f"{_place(path, ~np.isfinite(time_s)[np.newaxis])}: time_s is not a finite number")
    # A record begins wherever the time jumps back.
    begins = np.append(np.flatnonzero(np.diff(time_s, prepend=math.inf) <= 0), time_s.size)
    lengths = np.diff(begins)
    if np.ptp(lengths):
        odd = int((lengths != lengths[0]).argmax())
        raise ValueError(
            f"{path}:{2 + begins[odd]}: the record that begins here has {lengths[odd]} samples, but the first has "
            f"{lengths[0]}; give every record the same number of samples, with increasing time_s"
        )
    return {name: column.reshape(lengths.size, -1) for name, column in zip(names, values.T, strict=True)}


def _numbers(path: Path, line: int, row: str, n_columns: int) -> list[float]:
    """Return the numbers of a line of a CSV file."""
    cells, numbers = row.split(","), list[float]()
    if len(cells) != n_columns:
        raise ValueError(f"{path}:{line}: the line has {len(cells)} cells, but the header has {n_columns}; {FORM}")
    try:
        # float() would accept 1_000.
        numbers.extend(float(cell.replace("_", "?")) for cell in cells)
    except ValueError:
        column = len(numbers) + 1
        raise ValueError(f"{path}:{line}:{column}: {cells[len(numbers)][:40]!r} is not a number") from None
    return numbers


def _read_npz(path: Path) -> dict[str, FloatArray]:
    """Return the arrays of an NPZ file, (n_records, n_samples)."""
    try:
        with path.open("rb") as opened, np.lib.npyio.NpzFile(opened) as file:
            arrays = {name: np.atleast_2d(file[name].astype(float, casting="same_kind")) for name in file}
            if any(each.ndim > 2 for each in arrays.values()):
                raise ValueError("an array has more than 2 dimensions")
        return dict(zip(arrays, np.broadcast_arrays(*arrays.values()), strict=True))
    # A damaged file makes numpy and zipfile raise almost anything.
    except Exception as error:
        raise ValueError(f"{path}: cannot be read ({error}); it needs arrays named like the columns of a CSV") from None


READERS = {".csv": _read_csv, ".npz": _read_npz}
"""File readers, by file extension."""
