"""Agreement of a session's BIDS view with its log."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from modaltouch.record.session import Session
from modaltouch.record.view import form_text, table_text


@dataclass(frozen=True)
class ViewFound:
    """Result of checking a view against its log."""

    line: str = ""  # sentence on a view that agrees; empty otherwise
    problem: str = ""  # problem of the view; empty if it agrees
    # whether `resume` repairs the problem: a table or sidecar file is missing, or the view includes the line that is
    # incomplete in the log
    is_mendable: bool = False
    is_current: bool = False  # whether the view was made from the whole log


def check_view(session: Session) -> ViewFound:
    """Check the BIDS view of a session against its log."""
    checks = session.chain.checks
    found = {path.name: path for path in session.path.parent.glob("*_beh.tsv")}
    forms = {name: found[name] for name in found if name.replace("form_beh.tsv", "_beh.tsv") in found.keys() - {name}}
    tables = [found[name] for name in found.keys() - forms.keys()]
    if len(tables) != 1:
        problem = f"{session.path.parent}: holds {len(tables)} BIDS tables (*_beh.tsv), but exactly one is needed"
        return ViewFound(problem=problem, is_mendable=not tables)
    table, side = tables[0], tables[0].with_suffix(".json")
    # The table is written before its sidecar: a session killed between the two the first time has no sidecar.
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
        if session.chain.damage:  # lines after the damage were not read, so missing lines cannot be detected
            return ViewFound()
        return ViewFound(
            problem=f"{session.path}: the BIDS view was made from {n_lines} lines, but the log has {len(checks)}: "
            "lines were removed from its end",
            is_mendable=bool(session.chain.torn) and n_lines == len(checks) + 1,
        )
    if n_lines > 0 and checks[n_lines - 1] != check:
        return ViewFound(problem=f"{side}: was made from another log")
    # After a kill between the two, the table includes more lines than its sidecar states.
    made_from = (Session(session.path, session.events[:n]) for n in range(max(n_lines, 0), len(checks) + 1))
    # The form's table is written first.
    shown = next((each for each in made_from if text == table_text(each)), None)
    if shown is not None and form not in {form_text(shown), form_text(session)}:
        named = next(iter(forms.values()), session.path.parent)
        return ViewFound(problem=f"{named}: the table of the form differs from the log; move it away, and {_REMAKE}")
    if shown is None:
        return ViewFound(
            problem=f"{table}: differs from the log, which is the original: move the table away, and {_REMAKE}"
        )
    if not is_described:
        return ViewFound(problem=f"{side}: is missing; `modaltouch resume` writes it", is_mendable=True)
    if session.trials != shown.trials:
        behind = len(checks) - len(shown.events)
        return ViewFound(f"BIDS view agrees, {behind} lines behind the log: `modaltouch resume` brings it up to date")
    line = f"BIDS view agrees: {len(session.trials)} answers, practice included"
    return ViewFound(line, is_current=n_lines == len(checks))


_REMAKE = "`modaltouch resume` writes it again"
