"""Whether the BIDS view beside a log was made from it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from modaltouch.record.session import Session
from modaltouch.record.view import form_text, table_text


@dataclass(frozen=True)
class ViewFound:
    """How a view stands to its log.

    Attributes
    ----------
    line : str
        What holds, in words; empty where nothing does.
    problem : str
        What does not hold; empty for a sound view.
    is_mendable : bool
        Whether the problem is that there is none, or that it knows the very line that was cut: `resume` mends both.
    is_current : bool
        Whether it was made from the whole log, so that nothing is to be written.
    """

    line: str = ""
    problem: str = ""
    is_mendable: bool = False
    is_current: bool = False


def check_view(session: Session) -> ViewFound:
    """Return how the BIDS view beside a log stands to it.

    Parameters
    ----------
    session : Session
        As it was read from its log.
    """
    checks = session.chain.checks
    found = {path.name: path for path in session.path.parent.glob("*_beh.tsv")}
    forms = {name: found[name] for name in found if name.replace("form_beh.tsv", "_beh.tsv") in found.keys() - {name}}
    tables = [found[name] for name in found.keys() - forms.keys()]
    if len(tables) != 1:
        said = f"{session.path.parent}: holds {len(tables)} BIDS tables (*_beh.tsv), exactly one is needed"
        return ViewFound(problem=said, is_mendable=not tables)
    table, side = tables[0], tables[0].with_suffix(".json")
    # The table is written before its side file: a session killed between the two for the first time has no side file.
    is_described = side.exists()
    head: dict[str, Any] = {"lines": 0, "check": ""}
    try:
        if is_described:
            head = json.loads(side.read_text(encoding="utf-8"))["SessionLog"]
        text, n_lines, check = table.read_text(encoding="utf-8"), int(head["lines"]), head["check"]
        form = "".join(path.read_text(encoding="utf-8") for path in forms.values())
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        return ViewFound(problem=f"{table}: the BIDS view cannot be read ({error}); move it away, and {_REMAKE}")
    if n_lines > len(checks):
        return ViewFound(
            problem=f"{session.path}: the BIDS view was made from {n_lines} lines, the log has {len(checks)}: "
            "lines were removed from its end",
            is_mendable=bool(session.chain.torn) and n_lines == len(checks) + 1,
        )
    if n_lines > 0 and checks[n_lines - 1] != check:
        return ViewFound(problem=f"{side}: was made from another log")
    # After a kill between the two, the table is of a later line than its side file.
    made_from = (Session(session.path, session.events[:n]) for n in range(max(n_lines, 0), len(checks) + 1))
    # The form's own table is written first.
    shown = next((each for each in made_from if text == table_text(each)), None)
    if shown is not None and form not in {form_text(shown), form_text(session)}:
        named = next(iter(forms.values()), session.path.parent)
        return ViewFound(problem=f"{named}: the table of the form differs from the log; move it away, and {_REMAKE}")
    if shown is None:
        return ViewFound(
            problem=f"{table}: differs from what the log says; the log is the truth: move the table away, and {_REMAKE}"
        )
    if not is_described:
        return ViewFound(problem=f"{side}: is missing; `modaltouch resume` writes it", is_mendable=True)
    if session.trials != shown.trials:
        behind = len(checks) - len(shown.events)
        return ViewFound(f"BIDS view agrees, {behind} lines behind the log: `modaltouch resume` brings it up")
    said = f"BIDS view agrees: {len(session.trials)} answers, practice included"
    return ViewFound(said, is_current=n_lines == len(checks))


_REMAKE = "`modaltouch resume` makes it anew"
