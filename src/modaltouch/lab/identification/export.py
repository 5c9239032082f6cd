"""Responses and mode shapes for other programs: a universal file (data sets 164, 2411, 58 and 55) or CSV."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.identification.estimates import Identification
from modaltouch.lab.identification.files import CSV_COLUMNS
from modaltouch.protocol import InputError, Problem
from modaltouch.record import RecordError

ENDINGS = (".uff", ".unv", ".csv")
"""Endings of an export, which select its format."""


def check_export(path: Path) -> None:
    """Refuse, before anything is measured, a file whose ending is not one of `ENDINGS`.

    Raises
    ------
    InputError
        With the allowed endings.
    """
    if path.suffix.lower() not in ENDINGS:
        given = f"--export with the ending '{path.suffix}'"
        raise InputError(
            [Problem(str(path), 0, 0, "", given, ", ".join(ENDINGS), "give the file one of these endings")]
        )


def export(identification: Identification, path: Path) -> None:
    """Write the measured responses and, in a universal file, the mode shapes; all or nothing.

    Parameters
    ----------
    identification : Identification
        The responses and the modes found.
    path : Path
        The file; its ending is one of `ENDINGS`.

    Raises
    ------
    RecordError
        If it cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == ".csv":
            with part.open("w", encoding="utf-8", newline="") as file:
                file.writelines(_lines(identification))
        else:
            import pyuff

            with warnings.catch_warnings():
                # pyuff does not close the file object that it uses for binary data.
                warnings.simplefilter("ignore", ResourceWarning)
                pyuff.UFF(str(part)).write_sets(list(_sets(identification)), mode="overwrite")
        part.replace(path)
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; name another file with --export") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _lines(identification: Identification) -> Iterator[str]:
    """Yield the header and one line per number, in the format that `identify` reads."""
    responses = identification.responses
    coherence, rows = responses.coherence, bool(np.any(responses.across))
    further = ("coherence", "across_mm") if rows else ("coherence",)
    yield ",".join((*CSV_COLUMNS, *further[coherence is None :])) + "\n"
    for s, name in enumerate(responses.sets):
        for p in range(responses.n_points):
            place = "" if responses.positions is None else f"{responses.positions[p] * 1e3:.9g}"
            row = f",{responses.places[p].across * 1e3:.9g}" if rows else ""
            for k, (frequency, value) in enumerate(zip(responses.frequency, responses.response[s, p], strict=True)):
                certain = "" if coherence is None else f",{coherence[s, p, k]:.6g}"
                yield f"{frequency:.12g},{name},{place},{value.real:.9g},{value.imag:.9g}{certain}{row}\n"


def _sets(identification: Identification) -> Iterator[dict[str, Any]]:
    """Yield the data sets in the order in which they refer to each other, all in SI units."""
    responses = identification.responses
    nodes, origin = np.arange(1, responses.n_points + 1), np.zeros(responses.n_points)
    yield {
        "type": 164, "units_code": 1, "units_description": "SI: Meter (newton)", "temp_mode": 1,
        "length": 1.0, "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
    }  # fmt: skip
    if responses.positions is not None:
        yield {
            "type": 2411, "node_nums": nodes, "def_cs": nodes * 0, "disp_cs": nodes * 0, "color": nodes * 0 + 11,
            "x": responses.positions, "y": origin + responses.across, "z": origin,
        }  # fmt: skip
    for s, name in enumerate(responses.sets):
        for p in range(responses.n_points):
            yield {
                "type": 58, "binary": 1, "func_type": 4,
                "id1": f"velocity per unit of excitation, {name}", "id2": "NONE", "id3": "NONE", "id4": "NONE",
                "id5": "NONE", "rsp_node": p + 1, "rsp_dir": 3, "ref_node": responses.n_points + 1 + s, "ref_dir": 3,
                "ord_data_type": 6, "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
                "ordinate_spec_data_type": 11, "orddenom_spec_data_type": 0,
                "x": responses.frequency, "data": responses.response[s, p],
            }  # fmt: skip
    for number, mode in enumerate(identification.modes, start=1):
        if mode.shape is not None:
            yield {
                "type": 55, "id1": f"mode {mode.name}, of unit mean square", "id2": "NONE",
                "id3": "NONE", "id4": "NONE", "id5": "NONE", "model_type": 1, "analysis_type": 2, "data_ch": 2,
                "spec_data_type": 8, "data_type": 2, "n_data_per_node": 3, "load_case": 1,
                "mode_n": mode.label or number, "freq": mode.natural_frequency.value, "modal_m": 1.0,
                "modal_damp_vis": mode.damping_ratio.value, "modal_damp_his": 0.0,
                "node_nums": nodes, "r1": origin, "r2": origin, "r3": mode.shape,
            }  # fmt: skip
