"""``modaltouch study``, ``verify`` and ``doctor``: read-only checks of records and of this machine."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from modaltouch import protocol, record, report, rig, session, system, window
from modaltouch.cli import (
    APPARATUS,
    JSON,
    RECORD_AT_RISK,
    RIG_FAILED,
    SHIPPED_APPARATUS,
    print_json,
    print_table,
    progress,
    reporting,
    say,
)

RECORDS = "A session's folder or its session.jsonl, or a folder of sessions"
STATES = {"ok": ("ok", "green"), "warning": ("warning", "yellow"), "fault": ("FAULT", "red")}


def verify(
    session: Annotated[Path, typer.Argument(help=f"{RECORDS}.", show_default=False)], json_output: JSON = False
) -> None:
    """Check the record of a session, or of all in a folder: recompute lines, order, drive and BIDS view."""
    with reporting(json_output=json_output):

        def look(log: Path, several: bool) -> _Result:
            session = record.Session.find(log)
            verdict = record.audit_session(session)
            remedy = (f"`modaltouch doctor {log.parent}` says what can be recovered",) * bool(session.chain.problems)
            return verdict.as_dict(), verdict.lines, verdict.problems + remedy

        _look_at(session, look, json_output=json_output)


_Result = tuple[dict[str, Any], Sequence[str], Sequence[str]]
"""Result for one record: plain values, lines to print, and problems."""


def _look_at(place: Path, look: Callable[[Path, bool], _Result], *, json_output: bool) -> None:
    """Print the result for each record at a place; exit with `RECORD_AT_RISK` if any record is faulty."""
    logs = record.SessionFolder.logs_under(place)
    several, found = len(logs) > 1, []
    for log in logs:
        try:
            values, lines, problems = look(log, several)
        except record.RecordError as error:
            # One unreadable record must not prevent the others from being checked.
            if not several:
                raise
            values, lines, problems = {"session": str(log), "sound": False}, (), (str(error),)
        found.append(values)
        for line in () if json_output else (*([f"{log.parent}:"] if several else []), *lines):
            print(line)
        for problem in () if json_output else problems:
            typer.secho(problem, err=True, fg=typer.colors.RED)
    n_sound = sum(each["sound"] for each in found)
    if json_output:
        print_json({"sound": n_sound == len(logs), "sessions": found} if several else found[0])
    elif several:
        print(f"{n_sound} of {len(logs)} records are sound")
    if not all(each["sound"] or each.get("recovered_into") for each in found):
        raise typer.Exit(RECORD_AT_RISK)


def doctor(
    session: Annotated[
        Path | None, typer.Argument(help=f"{RECORDS}: say what can be recovered.", show_default=False)
    ] = None,
    into: Annotated[
        Path | None, typer.Option(help="Recover damaged records into this new results folder.", show_default=False)
    ] = None,
    results: Annotated[Path, typer.Option(help="Folder where sessions would be recorded.")] = Path("results"),
    timing: Annotated[
        bool, typer.Option("--timing", help="Measure frames, keys and generator instead; takes some seconds.")
    ] = False,
    packages: Annotated[
        bool, typer.Option("--packages", help="Print only the Debian packages that are missing, for `apt install`.")
    ] = False,
    rig: Annotated[
        str, typer.Option(help="For --timing: `simulated`, or the generator's VISA address; nothing is played.")
    ] = "simulated",
    apparatus: APPARATUS = SHIPPED_APPARATUS,
    json_output: JSON = False,
) -> None:
    """Check that this machine has what a session needs, and say how to get what is missing.

    With a SESSION, or a folder of sessions, examine the records instead: what is damaged and what can still be
    verified. --into writes the verified part to a new record. The damaged record is never touched.
    """
    with reporting(json_output=json_output):
        if session is not None:
            _look_at(session, partial(_examine_record, into=into), json_output=json_output)
            return
        if into is not None:
            raise typer.BadParameter("--into needs a session: modaltouch doctor SESSION --into FOLDER")
        if timing:
            _measure(rig, apparatus, json_output=json_output)
            return
        if packages:
            print(*(package for check in window.examine_machine(quick=True) for package in check.packages))
            return
        findings = window.examine_machine(results)
        if json_output:
            named = "subject", "state", "found", "remedy"
            print_json({"findings": [dict(zip(named, finding, strict=False)) for finding in findings]})
        else:
            for finding in findings:
                word, colour = STATES[finding.state]
                remedy = f": {finding.remedy}" if finding.remedy else ""
                typer.echo(f"{typer.style(f'{word:8}', fg=colour)} {finding.subject:16} {finding.found}{remedy}")
        if any(finding.state == "fault" for finding in findings):
            raise typer.Exit(RIG_FAILED)


def _examine_record(session: Path, several: bool, into: Path | None) -> _Result:
    """Examine a record and, if `into` is given, recover it; in a folder of several, only the damaged ones."""
    found = record.survey(session)
    lines = found.lines
    recovered = None
    if into is not None and not (several and found.is_sound):
        recovered = found.write(into)
        lines.append(f"recovered into {recovered}; check it with `modaltouch verify {recovered.parent}`")
    elif found.is_cut:
        lines.append(
            f"continue with `modaltouch resume {found.path.parent}`, which marks the truncated line and keeps the rest"
        )
    elif not found.is_sound and found.has_start:
        lines.append("recover it into a new results folder with --into FOLDER; this record is never touched")
    elif not found.has_start:
        lines.append("nothing can be recovered without its first line, the start record; look for a copy of the file")
    return {**found.as_dict(), "recovered_into": str(recovered) if recovered else None}, lines, ()


def _measure(address: str, apparatus: Path, *, json_output: bool) -> None:
    """Print the timing of window, keyboard and generator; one that cannot be reached is a fault."""
    figures: dict[str, Any] = {}
    verdicts: dict[str, str] = {}
    faults: dict[str, str] = {}
    for subject, measure in (
        ("window", window.WindowOptions().measure_timing),
        ("generator", lambda: _measure_generator(address, apparatus)),
    ):
        try:
            figures[subject], verdicts[subject] = measure()
        except (window.WindowError, rig.RigError) as error:
            faults[subject] = str(error)
    if address == "simulated" and "generator" in verdicts:
        verdicts["generator"] = f"On the simulated rig, not on yours (--rig): {verdicts['generator']}"
    if json_output:
        print_json({**figures, "verdicts": verdicts, "faults": faults})
    else:
        marked = {subject: f"{typer.style('FAULT', fg='red')} {fault}" for subject, fault in faults.items()}
        for subject, words in {**verdicts, **marked}.items():
            typer.echo(f"{subject:10} {words}")
    if faults:
        raise typer.Exit(RIG_FAILED)


def _measure_generator(address: str, apparatus: Path) -> tuple[dict[str, Any], str]:
    parts = protocol.Apparatus.read(apparatus)
    with ExitStack() as stack:
        where = stack.enter_context(rig.Simulator(parts)).address if address == "simulated" else address
        return stack.enter_context(rig.Generator(where, parts)).command_latency()


_MAKER = '<meta name="generator" content="modaltouch study">'


def study(
    results: Annotated[Path, typer.Argument(help="A results folder, or a folder in it.", show_default=False)],
    html: Annotated[
        Path | None, typer.Option(help="Also write the result as a page to this file, such as study.html.")
    ] = None,
    json_output: JSON = False,
) -> None:
    """Show completed and open sessions, and the next participant with their order.

    This changes nothing. A session that `modaltouch verify` refuses is damaged, with its reason.
    """
    with reporting(json_output=json_output):
        with progress("sessions read") as on_progress:
            datasets = session.survey_results(results, on_progress)
        shown = [_in_words(dataset) for dataset in datasets]
        if html is not None:
            _write_page(html, results, shown)
        if json_output:
            print_json({"results": str(results), "datasets": datasets, "page": str(html) if html else None})
            return
        for each in shown:
            _show(each)
        if html is not None:
            print(f"Page: {html}")


def _write_page(file: Path, results: Path, shown: list[dict[str, Any]]) -> None:
    """Write the study page; replace a file only if it is an earlier study page."""
    if not file.exists():
        record.prepare_file(file, "--html")
    elif not (file.is_file() and _is_ours(file)):  # opening a pipe would block
        raise record.RecordError(
            f"{file}: exists already and is not from `modaltouch study`; give another file with --html"
        )
    headings = {"sessions": _SESSION_HEADINGS, "orders": _ORDER_HEADINGS}
    page = report.render_page(
        "modaltouch.cli", "study.html.j2",
        title="Study", maker=_MAKER, results=results, datasets=shown, headings=headings, version=system.version(),
    )  # fmt: skip
    record.replace_file(file, page.encode(), "give another file with --html")


def _is_ours(file: Path) -> bool:
    """Return whether a file is an earlier study page; False if it cannot be read."""
    with suppress(OSError), file.open(encoding="utf-8", errors="replace") as page:
        return _MAKER in page.read(20_000)
    return False


def _show(shown: dict[str, Any]) -> None:
    """Print one dataset, at most 80 columns wide."""
    say(shown["heading"], bold=True)
    say(shown["folder"], dim=True)
    print_table("", _SESSION_HEADINGS, shown["sessions"], n_words=3)
    if shown["orders"]:
        print_table("", _ORDER_HEADINGS, shown["orders"])
    say(*shown["remarks"], fg="yellow")
    say(*(f"next: {line}" for line in shown["next"]))


_SESSION_HEADINGS = ("participant", "session", "state", "begun (UTC)", "duration (min)", "answers")
_ORDER_HEADINGS = ("order", "complete", "left incomplete", "open")


def _in_words(dataset: dict[str, Any]) -> dict[str, Any]:
    """Return the text shown for a dataset: rows of the two tables, remarks, and the next sessions."""
    rows, n_each = dataset["sessions"], dataset["sessions_each"]
    n_complete = sum(row["state"] == "complete" for row in rows)
    title, mode = dataset["title"] or dataset["protocol"], dataset["mode"]
    kind = "" if mode == "real" else f", {mode} data"
    left_out: dict[str, list[str]] = defaultdict(list)
    for row in rows:
        if why := row["excluded"].replace(f"{row['log']}: ", "").replace(f"{row['log']}:", "line "):
            left_out[why].append(f"{row['participant']} session {row['session']}")
    each = "" if n_each is None else f", {n_each} planned for each participant"
    return {
        "folder": dataset["folder"],
        "mode": mode,
        "heading": f"{title}{kind}: {n_complete} of {len(rows)} sessions complete{each}",
        "sessions": [
            (
                row["participant"] + (f" ({row['group']})" if "group" in row else ""),
                f"{row['session']} {row.get('session_kind', '')}".strip(),
                row["state"]
                + (f" in {row['n_sittings']} parts" if row["n_sittings"] > 1 else "")
                + (f": {row['why']}" if row["state"] in ("interrupted", "closed") else ""),
                "–" if row["begun"] is None else str(row["begun"])[:16].replace("T", " "),
                f"{row['duration_min']:.0f}",
                "–" if row["n_answered"] is None else f"{row['n_answered']}/{row['n_trials']}",
            )
            for row in rows
        ],
        "orders": [
            (_order(row), *(str(row[name]) for name in ("filled", "left_incomplete", "open")))
            for row in dataset["orders"]
        ],
        "remarks": [
            *(
                f"{', '.join(who) if len(who) < 3 else f'{len(who)} sessions'}: excluded, {why}"
                for why, who in left_out.items()
            ),
            *dataset["notes"],
        ],
        "next": [
            f"{row['participant']} session {row['session']}, "
            + (f"from {row['from'][:16].replace('T', ' ')} UTC on, " if "from" in row else "")
            + (_order(row) if row["do"] == "run" else f"`modaltouch {row['do']} {Path(row['log']).parent.parent}`")
            for row in dataset["next"]
        ],
    }


def _order(row: dict[str, Any]) -> str:
    """Return the text for an order of finger conditions, with the placement if it is not the normal one."""
    placed = "" if row["placement"] == "normal" else f" ({row['placement']})"
    named = ", ".join(row[key] for key in ("group", "session_kind") if key in row)
    return (f"{named}: " if named else "") + " then ".join(row["finger_conditions"]) + placed
