"""Display of a session's state for terminals of at least 40 by 12 characters; readable without colour."""

from __future__ import annotations

import textwrap
from typing import Any

from rich.console import Group, RenderableType
from rich.rule import Rule
from rich.text import Text

from modaltouch.session.console import SessionState

STATES = {
    "waiting": "between trials",
    "trial": "trial on",
    "paused": "PAUSED",
    "break": "break",
    "ended": "ended",
}
HELP = ("p pause", "space go on", "r repeat", "n note", "b end after block", "q stop")
_EFFECT = ": outputs off at once"
"""Effect of the emergency stop, shown on wide terminals."""

_WIDE = 60
"""Minimum number of columns for the effect of the emergency stop."""

_ARROWS = {name: f"{name} arrow" for name in ("left", "right", "up", "down")}
_BAR = 40
"""Maximum width of the progress bar [characters]."""
_NAMES = 14
"""Width of the column of names [characters]."""
_BY_ANSWER = ("answer by", "answers")
"""Rows that list all answers and must be shown in full."""
_MOST_WARNINGS = 4


def draw_session(
    facts: SessionState, prompt: str, *, width: int, height: int = 24, since_s: float = 0.0, emergency: str = "f12"
) -> RenderableType:
    """Render the state of a session for the console.

    Parameters
    ----------
    facts : dict
        State of the session (`status.Status.facts`).
    prompt : str
        Line that prompts the experimenter or echoes a key.
    width, height : int
        Size of the terminal [characters].
    since_s : float
        Age of the state, by which displayed times are advanced [s].
    emergency : str
        Name of the emergency key.
    """
    mode = "" if facts["mode"] == "real" else f"[{facts['mode'].upper()}] "
    head = f"{mode}{facts['participant']}, session {facts['session']}, {facts['protocol']}"
    state = STATES.get(str(facts["state"]), str(facts["state"]))
    foot = [
        *_wrap("   ".join(key.replace(" ", "\N{NO-BREAK SPACE}") for key in HELP), width, "dim"),
        *_wrap(f"{emergency.upper()} or x   EMERGENCY STOP{_EFFECT if width >= _WIDE else ''}", width, "bold"),
        *(_wrap(prompt, width, "bold") or [Text("")]),
    ]
    (trial, fingers, predicted), (generator, outputs, error) = (
        describe_trial(facts["trial"]),
        _describe_generator(facts),
    )
    # The most important rows come first, since short terminals leave out the last ones.
    rows = [
        ("state", f"{state}{_describe_cause(facts)}"),
        *([("answer by", _describe_question(facts["question"]))] if facts["question"] is not None else []),
        ("progress", describe_progress(facts, since_s, width - _NAMES)),
        trial,
        error,
        fingers,
        ("last answer", describe_last(facts["last"])),
        outputs,
        ("asked", _describe_requests(facts)),
        predicted,
        ("answers", ", ".join(f"{answer} {count}" for answer, count in sorted(facts["answers"].items())) or "-"),
        generator,
    ]
    # Besides the table: two rules, a line for the cursor, and the warnings (only the first on short terminals).
    room = height - 3 - len(foot)
    warnings = _describe_warnings(facts["warnings"][: _MOST_WARNINGS if height >= 24 else 1], width)
    table = [line for name, words in rows for line in _draw_row(name, words, width)][: max(room - len(warnings), 1)]
    return Group(Rule(Text(head, style="bold"), style="dim"), *table, Rule(style="dim"), *warnings, *foot)


def _draw_row(name: str, words: str, width: int) -> list[Text]:
    most = 7 if name in _BY_ANSWER else 3
    lines = textwrap.wrap(words, max(width - _NAMES - 1, 20), max_lines=most, placeholder=" ...") or ["-"]
    style = {"state": "bold reverse" if words.startswith(STATES["paused"]) else "bold", "last error": "bold"}.get(
        name, ""
    )
    return [
        Text.assemble((f" {'' if place else name:{_NAMES - 1}}", "dim"), (line, style), no_wrap=True)
        for place, line in enumerate(lines)
    ]


def _wrap(words: str, width: int, style: str) -> list[Text]:
    return [Text(f" {line}", style=style, no_wrap=True) for line in textwrap.wrap(words, max(width - 2, 20))]


def describe_progress(facts: SessionState, since_s: float = 0.0, width: int = 80) -> str:
    """Return the progress bar (if it fits the width [characters]), the count, and the time left."""
    done, total = facts["n_answered"], max(facts["n_trials"], 1)
    ticking = since_s if facts["state"] != "ended" else 0.0
    left = max(facts["time_left_s"] - (ticking if facts["state"] == "trial" else 0.0), 0.0)
    said = f"{done} of {facts['n_trials']}, {describe_time(left)} left"
    length = min(_BAR, width - len(said) - 3)
    full = round(length * min(done / total, 1))
    return f"{'#' * full}{'.' * (length - full)} {said}" if length > 5 else said


def describe_time(seconds: float) -> str:
    """Format a time, in seconds below 90 s and in minutes above."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def describe_trial(trial: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Return three rows that describe a trial."""
    if trial is None:
        return [("trial", "-"), ("fingers", "-"), ("predicted", "-")]
    number = f"practice {trial['number']}" if trial["practice"] else f"{trial['number']}, block {trial['block']}"
    which = f"{trial['stimulus']} at " if trial.get("stimulus") else ""
    level = "catch trial" if trial["velocity_mm_s"] == 0 else f"{which}{trial['velocity_mm_s']:g} mm/s"
    level += f" in interval {trial['interval']}" if trial.get("interval") else ""
    placed = "" if trial["placement"] == "normal" else f" ({trial['placement'].replace('_', ' ')})"
    sides = [side for side in ("left", "between", "right") if f"zone_{side}" in trial]
    fingers = ", ".join(f"{trial[f'finger_{side}']} on {trial[f'zone_{side}']}" for side in sides)
    predicted = ", ".join(f"{side} {trial[f'predicted_{side}_mm_s']:.3g} mm/s" for side in sides)
    return [
        ("trial", f"{number}, {level}"),
        ("fingers", f"{fingers}{placed}"),
        ("predicted", predicted),
    ]


def describe_last(last: dict[str, Any] | None) -> str:
    """Return the text for the last answer."""
    if last is None:
        return "-"
    kind = "practice" if last["practice"] else "trial"
    since = {"first_burst": "first burst", "question": "question"}.get(last["counted_from"], last["counted_from"])
    return f"{last['answer']}, {last['reaction_time_s']:.2f} s after the {since} ({kind} {last['number']})"


def _describe_cause(facts: SessionState) -> str:
    """Return the suffix of the state: why a session is paused or ended, or the interval being played."""
    if facts["state"] == "paused" and facts["paused_by"] == "lost focus":
        return ": the window lost the keyboard focus; click in it"
    if facts["state"] == "paused":
        return f" by the {facts['paused_by']}"
    if facts["state"] == "trial" and facts["trial"].get("plays"):
        return f": interval {facts['trial']['plays']}"
    return f": {facts['stopped_by']}" if facts["stopped_by"] else ""


def _describe_generator(facts: SessionState) -> list[tuple[str, str]]:
    generator = facts["generator"]
    volts = " and ".join(f"{value:.3g}" for value in generator["amplitude_Vpp"])
    played = f", {volts} Vpp" if generator["outputs"] == "on" and volts else ""
    sure = {True: ", confirmed", False: ", NOT CONFIRMED", None: ""}[generator["confirmed"]]
    name = ", ".join(part.strip() for part in generator["identity"].split(",")[:3])
    return [
        ("generator", name or "-"),
        ("outputs", f"{generator['outputs'].upper()}{played}{sure}"),
        ("last error", generator["last_error"] or "none"),
    ]


def _describe_question(question: dict[str, Any]) -> str:
    """Return the console keys of each answer while a trial is on."""
    if not question["open"]:
        return "-"
    named = {
        answer: " or ".join(_ARROWS.get(key, key) for key in keys)
        for answer, keys in question["keys"].items()
        if not (answer.isdecimal() and answer in keys)
    }
    typed = ["digits"] if len(named) < len(question["keys"]) else []
    return "; ".join([*typed, *(f"{answer}: {keys}" for answer, keys in named.items())])


def _describe_requests(facts: SessionState) -> str:
    requests = []
    if facts["too_early"]:
        requests.append(f"{facts['too_early']} came before the question and does not count")
    if facts["repeats_trial"] is not None:
        kind = "practice" if facts["repeats_practice"] else "trial"
        requests.append(f"repeat {kind} {facts['repeats_trial']} after this one (r takes it back)")
    elif facts["nothing_to_repeat"]:
        requests.append("nothing to repeat: no trial of this part is answered yet")
    if facts["ends_after_block"]:
        requests.append("end after this block (b takes it back)")
    if facts["n_notes"]:
        requests.append(f"{facts['n_notes']} note{'s' * (facts['n_notes'] > 1)} kept")
    return ", ".join(requests) or "-"


def _describe_warnings(warnings: list[str], width: int) -> list[Text]:
    if not warnings:
        return [Text(" no warnings", style="dim")]
    shortened = [textwrap.shorten(f"! {warning}", max(width - 2, 20), placeholder="...") for warning in warnings]
    return [Text(f" {words}", style="yellow", no_wrap=True) for words in shortened]
