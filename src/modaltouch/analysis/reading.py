"""Reading of answers from a CSV file or a results tree."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from modaltouch.protocol import InputError

if TYPE_CHECKING:
    from modaltouch.analysis.responses import Responses, TableFormat


def read_responses(
    path: Path | str,
    *labs: Path | str,
    mode: str | None = None,
    stimulus: str | None = None,
    table_format: TableFormat | None = None,
) -> Responses:
    """Read the answers in a CSV file, a session log, or a tree of sessions.

    Parameters
    ----------
    path : Path or str
        A CSV file; or a results folder, or any folder or session log in it.
    *labs : Path or str
        Results folders of other labs with the same protocol.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions of a tree, or rows of a CSV with a column ``mode``, to use. By default the real ones; if there
        are none, those of the only mode.
    stimulus : str, optional
        Stimulus to analyse, if there are several; by default all.
    table_format : TableFormat, optional
        The answers offered, their spelling and the equivalence margin, for a CSV; recorded sessions contain them.

    Raises
    ------
    InputError
        With all problems found, their locations and remedies: unknown words, missing columns or cells, duplicate rows,
        a tree with mixed modes or protocols.
    """
    place, *further = map(Path, (path, *labs))
    for each in (place, *further):
        if not each.exists():
            remedy = "check the name; results are in results/<protocol> unless --results named another folder"
            raise InputError.of(each, "no such file or folder", "a CSV file or a results folder", remedy)
        if further and not each.is_dir():
            remedy = "give the results folder of each lab; combine tables into one"
            raise InputError.of(each, "a file among several sources", "folders alone", remedy)
    if place.is_dir() or place.suffix == ".jsonl":
        if table_format is not None:
            given = "a protocol or answer words with recorded sessions, which contain their own"
            raise InputError.of(place, given, "these only with a CSV file", "leave the option out")
        from modaltouch.analysis.results_tree import read_tree

        return _refuse_none(place, read_tree(place, *further, mode=mode, stimulus=stimulus))
    if place.name.endswith("_beh.tsv") and (place.parent / "session.jsonl").exists():
        remedy = f"give its folder {place.parent}, or that of the whole study"
        raise InputError.of(place, "the table of one recorded session", "a CSV file or a results folder", remedy)
    if table_format is not None and table_format.design.get("adaptive"):
        given = "a table with an adaptive protocol, whose levels followed from the answers"
        raise InputError.of(place, given, "recorded sessions", "give the folder of the sessions, without --protocol")
    from modaltouch.analysis.tidy import read_csv

    return _refuse_none(place, read_csv(place, table_format, mode, stimulus))


def _refuse_none(place: Path, responses: Responses) -> Responses:
    if responses.frame.empty:
        given = "no answer to any trial: each timed out, or has none"
        raise InputError.of(
            place, given, "at least one answer", "look at answers.time_out_s, or at the column response"
        )
    return responses
