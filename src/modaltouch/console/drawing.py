"""How a session stands, drawn for a terminal of at least 80 by 24 characters; readable without colour."""

from __future__ import annotations

import textwrap
from typing import Any

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from modaltouch.console.interface import Facts

STATES = {
    "waiting": "between trials",
    "trial": "trial on",
    "paused": "PAUSED",
    "break": "break",
    "ended": "ended",
}
HELP = "p pause/go on   r repeat last trial   n note   b end after this block   q stop"
_BAR = 40
"""Width of the bar of progress [characters]."""
_MOST_WARNINGS = 4


def draw_session(
    facts: Facts, prompt: str, *, width: int, since_s: float = 0.0, emergency: str = "f12"
) -> RenderableType:
    """Return the console's picture.

    Parameters
    ----------
    facts : dict
        How the session stands (`status.Status.facts`).
    prompt : str
        The line that asks the experimenter something, or tells of a key.
    width : int
        Width of the terminal [characters].
    since_s : float
        Age of the facts, for the times to run on [s].
    emergency : str
        Name of the key for emergencies.
    """
    head = f"{facts['participant']}, session {facts['session']}, {facts['protocol']}"
    mode = "" if facts["mode"] == "real" else f"  [{facts['mode'].upper()}]"
    state = Text(
        STATES.get(str(facts["state"]), str(facts["state"])),
        style="bold reverse" if facts["state"] == "paused" else "bold",
    )
    if facts["stopped_by"]:
        state.append(f": {facts['stopped_by']}")
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True, style="dim")
    table.add_column(overflow="ellipsis", no_wrap=True, max_width=max(width - 16, 20))
    table.add_row("state", state)
    table.add_row("progress", describe_progress(facts, since_s))
    for name, words in (*describe_trial(facts["trial"]), *_describe_generator(facts["generator"])):
        table.add_row(name, words)
    table.add_row("last answer", describe_last(facts["last"]))
    table.add_row(
        "answers", ", ".join(f"{answer} {count}" for answer, count in sorted(facts["answers"].items())) or "-"
    )
    table.add_row("asked", _describe_wishes(facts))
    return Group(
        Rule(Text(head + mode, style="bold"), style="dim"),
        Padding(table, (0, 1)),
        Rule(style="dim"),
        *_describe_warnings(facts["warnings"], width),
        Text(f" {HELP}", style="dim", no_wrap=True, overflow="ellipsis"),
        Text(f" {emergency.upper()} or x   EMERGENCY STOP: outputs off at once", style="bold", no_wrap=True),
        Text(f" {prompt}", style="bold", no_wrap=True, overflow="ellipsis"),
    )


def describe_progress(facts: Facts, since_s: float = 0.0) -> str:
    """Return the bar of progress, the count, and the time left."""
    done, total = facts["n_answered"], max(facts["n_trials"], 1)
    full = round(_BAR * min(done / total, 1))
    bar = "#" * full + "." * (_BAR - full)
    ticking = since_s if facts["state"] != "ended" else 0.0
    left = max(facts["time_left_s"] - (ticking if facts["state"] == "trial" else 0.0), 0.0)
    return f"{bar} {done} of {facts['n_trials']}, {_minutes(left)} left"


def describe_trial(trial: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Return what is presented, in two rows."""
    if trial is None:
        return [("trial", "-"), ("predicted", "-")]
    kind = "practice " if trial["practice"] else ""
    placed = "" if trial["placement"] == "normal" else f", {trial['placement'].replace('_', ' ')}"
    fingers = (
        f"{trial['finger_left']} on {trial['zone_left']}, {trial['finger_right']} on {trial['zone_right']}{placed}"
    )
    which = f"{trial['stimulus']} at " if trial.get("stimulus") else ""
    level = "catch trial" if trial["velocity_mm_s"] == 0 else f"{which}{trial['velocity_mm_s']:g} mm/s"
    left, right = (f"{trial[f'predicted_{side}_mm_s']:.3g} mm/s" for side in ("left", "right"))
    return [
        ("trial", f"{kind}{trial['number']}, block {trial['block']}, {level}: {fingers}"),
        ("predicted", f"left {left}, right {right}"),
    ]


def describe_last(last: dict[str, Any] | None) -> str:
    """Return the last answer in words."""
    if last is None:
        return "-"
    kind = "practice" if last["practice"] else "trial"
    since = {"first_burst": "first burst", "question": "question"}.get(last["counted_from"], last["counted_from"])
    return f"{last['answer']}, {last['reaction_time_s']:.2f} s after the {since} ({kind} {last['number']})"


def _describe_generator(generator: dict[str, Any]) -> list[tuple[str, str]]:
    volts = " and ".join(f"{value:.3g}" for value in generator["amplitude_Vpp"])
    played = f", {volts} Vpp" if generator["outputs"] == "on" and volts else ""
    sure = {True: ", confirmed", False: ", NOT CONFIRMED", None: ""}[generator["confirmed"]]
    name = ", ".join(part.strip() for part in generator["identity"].split(",")[:3])
    return [
        ("generator", name or "-"),
        ("outputs", f"{generator['outputs'].upper()}{played}{sure}"),
        ("last error", generator["last_error"] or "none"),
    ]


def _describe_wishes(facts: Facts) -> str:
    wishes = []
    if facts["repeats_trial"] is not None:
        wishes.append(f"repeat trial {facts['repeats_trial']}")
    if facts["ends_after_block"]:
        wishes.append("end after this block")
    if facts["n_notes"]:
        wishes.append(f"{facts['n_notes']} note{'s' * (facts['n_notes'] > 1)} kept")
    return ", ".join(wishes) or "-"


def _describe_warnings(warnings: list[str], width: int) -> list[RenderableType]:
    if not warnings:
        return [Text(" no warnings", style="dim")]
    lines: list[RenderableType] = []
    for warning in warnings[:_MOST_WARNINGS]:
        text = textwrap.shorten(f"! {warning}", max(width - 2, 20), placeholder="...")
        lines.append(Text(f" {text}", style="yellow", no_wrap=True))
    return lines


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
