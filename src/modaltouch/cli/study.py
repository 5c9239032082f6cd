"""``modaltouch study``: a study at a glance."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.options import JSON
from modaltouch.cli.tables import print_table

_MAKER = '<meta name="generator" content="modaltouch study">'


def study(
    results: Annotated[Path, typer.Argument(help="A results folder, or a folder in it.", show_default=False)],
    html: Annotated[
        Path | None, typer.Option(help="Also write it as a page into this file, such as study.html.")
    ] = None,
    json_output: JSON = False,
) -> None:
    """Show who has done which session, what is open, and who is next with which order.

    Only the logs are read, and nothing is changed; `modaltouch verify` recomputes them.
    """
    from modaltouch.session import survey_results

    with reporting(json_output=json_output):
        datasets = survey_results(results)
        told = [_tell(dataset) for dataset in datasets]
        if html is not None:
            _write_page(html, results, told)
        if json_output:
            print_json({"results": str(results), "datasets": datasets, "page": str(html) if html else None})
            return
        for each in told:
            _show(each)
        if html is not None:
            print(f"Page: {html}")


def _write_page(file: Path, results: Path, told: list[dict[str, Any]]) -> None:
    """Write the page, over an earlier one alone."""
    from modaltouch.record import RecordError, prepare_file, replace_file
    from modaltouch.report import render_page
    from modaltouch.system import version

    if not file.exists():
        prepare_file(file)
    elif not file.is_file() or _MAKER not in file.read_text(encoding="utf-8", errors="replace"):
        raise RecordError(f"{file}: is there already and not from `modaltouch study`; give another file with --html")
    headings = {"sessions": _SESSION_HEADINGS, "orders": _ORDER_HEADINGS}
    page = render_page(
        "modaltouch.cli", "study.html.j2",
        title="Study", maker=_MAKER, results=results, datasets=told, headings=headings, version=version(),
    )  # fmt: skip
    replace_file(file, page.encode(), "give another file with --html")


def _show(told: dict[str, Any]) -> None:
    """Print one dataset within 80 columns."""
    from rich.console import Console
    from rich.markup import escape

    console = Console()
    console.print(f"[bold]{escape(told['heading'])}[/]\n[dim]{escape(told['folder'])}[/]")
    print_table("", _SESSION_HEADINGS, [list(map(escape, row)) for row in told["sessions"]], n_words=3)
    if told["orders"]:
        print_table("", _ORDER_HEADINGS, [list(map(escape, row)) for row in told["orders"]])
    remarks = (f"[yellow]{escape(line)}[/]" for line in told["remarks"])
    console.print(*remarks, *(f"next: {escape(line)}" for line in told["next"]), sep="\n")


_SESSION_HEADINGS = ("participant", "session", "state", "begun (UTC)", "min", "answers")
_ORDER_HEADINGS = ("order", "complete", "left incomplete", "open")


def _tell(dataset: dict[str, Any]) -> dict[str, Any]:
    """Return what a dataset holds in words: rows of the two tables, remarks, and who is next."""
    rows, n_each = dataset["sessions"], dataset["sessions_each"]
    n_complete = sum(row["state"] == "complete" for row in rows)
    title, mode = dataset["title"] or dataset["protocol"], dataset["mode"]
    kind = "" if mode == "real" else f", {mode} data"
    each = "" if n_each is None else f", {n_each} planned for each participant"
    return {
        "folder": dataset["folder"],
        "mode": mode,
        "heading": f"{title}{kind}: {n_complete} of {len(rows)} sessions complete{each}",
        "sessions": [
            (
                row["participant"] + (f" ({row['group']})" if "group" in row else ""),
                f"{row['session']} {row.get('session_kind', '')}".strip(),
                row["state"] + (f": {row['why']}" if row["state"] in ("interrupted", "closed") else ""),
                "–" if row["begun"] is None else str(row["begun"])[:16].replace("T", " "),
                f"{row['duration_min']:.0f}" + (f" in {row['n_sittings']}" if row["n_sittings"] > 1 else ""),
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
                f"{row['participant']} session {row['session']} is excluded: "
                + row["excluded"].replace(f"{row['log']}:", "line ")
                for row in rows
                if row["excluded"]
            ),
            *dataset["notes"],
        ],
        "next": [
            f"{row['participant']} session {row['session']}, "
            + (f"{row['session_kind']}, " if "session_kind" in row else "")
            + (_order(row) if row["do"] == "run" else f"`modaltouch {row['do']} {Path(row['log']).parent.parent}`")
            for row in dataset["next"]
        ],
    }


def _order(row: dict[str, Any]) -> str:
    """Return an order of finger conditions in words, with the placement where it is not the usual one."""
    placed = "" if row["placement"] == "normal" else f" ({row['placement']})"
    group = f"{row['group']}: " if "group" in row else ""
    return group + " then ".join(row["finger_conditions"]) + placed
