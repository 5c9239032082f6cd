"""Prompts of ``modaltouch run``: rig, participant, questions about the participant, and start."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from modaltouch import record, rig, session
from modaltouch.cli.check import show
from modaltouch.cli.output import INTERRUPTED, leave


def can_ask() -> bool:
    """Return whether standard input is a terminal and prompts are visible."""
    return sys.stdin.isatty() and (sys.stderr.isatty() or sys.stdout.isatty())


def ask_rig(may_ask: bool) -> str:
    """Prompt for the generator's VISA address, listing those visible to this machine; return it or ``simulated``."""
    if not may_ask:
        raise typer.BadParameter(
            "a session needs a rig: give --rig with the generator's VISA address (`modaltouch rig list` shows what "
            "this machine can see), or --rig simulated, where nothing vibrates"
        )
    try:
        found = rig.find_instruments()
    except rig.RigError as error:
        found = ()
        typer.secho(str(error), err=True, fg=typer.colors.YELLOW)
    for number, address in enumerate(found, start=1):
        typer.echo(f"{number}  {address}", err=True)
    hint = "its number above" if found else "none is seen; one on the network answers at TCPIP::<its address>::INSTR"
    while True:
        given = str(
            _prompt(f"Generator's VISA address ({hint}), or {session.SIMULATED}", default="", shown=False)
        ).strip()
        if given.isdecimal() and 1 <= int(given) <= len(found):
            return found[int(given) - 1]
        if given.casefold() == session.SIMULATED or "::" in given:
            return given if "::" in given else session.SIMULATED
        typer.secho(f"given {given!r}; allowed: a VISA address, or {session.SIMULATED}", err=True, fg=typer.colors.RED)


def ask_participant(dataset: Path) -> str:
    """Prompt for a participant id until it is valid in a file name, and return it."""
    if not can_ask():
        raise typer.BadParameter("a session needs a participant id: give it with -p, for example -p p01")
    while True:
        words = "Participant id (a code of letters and digits, never a name)"
        participant = str(_prompt(words, default=session.propose_participant(dataset))).strip()
        try:
            return record.SessionFolder.check_participant(participant)
        except record.RecordError as error:
            typer.secho(str(error), err=True, fg=typer.colors.RED)


def ask_people(fields: Mapping[str, Any], may_ask: bool) -> dict[str, Any]:
    """Prompt for the answers to the protocol's questions, consents first; stop if a required consent is refused."""
    if not may_ask:
        listed = ", ".join(fields)
        raise typer.BadParameter(f"the protocol asks each participant for {listed}: give a YAML file with --people")
    answers: dict[str, Any] = {}
    for name in sorted(fields, key=lambda name: str(fields[name].kind) != "consent"):
        while name not in answers:
            words = str(_prompt(f"{fields[name].question} ({fields[name].allowed})", default="", shown=False))
            try:
                answers[name] = fields[name].read(words)
            except ValueError as error:
                typer.secho(str(error), err=True, fg=typer.colors.RED)
        if fields[name].kind == "consent" and fields[name].required and answers[name] == "no":
            break
    return answers


def wait_for_start(setup: session.Setup, rig: str) -> None:
    """Show a summary of the session and wait for ``start``; quitting records nothing."""
    place = setup.place
    show(setup.preflight)
    if own := setup.facts.get("sensation_levels"):
        said = f"found in {own['session']}" if own["found"] == "session" else "as given"
        typer.echo(f"Levels calibrated by participant: threshold {own['threshold_mm_s']:g} mm/s, {said}")
    kind = "" if place.mode == "real" else f" ({place.mode} data)"
    typer.echo(f"Participant {place.participant}, session {place.session}, rig {rig}{kind}, to {place.folder}")
    while True:
        word = str(_prompt("Type start to begin, or q to leave", default="", shown=False)).strip().casefold()
        if word == "start":
            return
        if word in ("q", "quit", "exit", "n", "no"):
            leave(INTERRUPTED, "not started; nothing was recorded")


def _prompt(words: str, *, default: object, shown: bool = True) -> object:
    # Standard output is for the command's result, so prompt on standard error if it is a terminal.
    try:
        answer: object = typer.prompt(words, default=default, type=str, show_default=shown, err=sys.stderr.isatty())
    except typer.Abort:
        typer.echo("", err=True)
        leave(INTERRUPTED, "not started; nothing was recorded")
    return answer
