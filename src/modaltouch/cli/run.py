"""``modaltouch run``, ``resume`` and ``demo``: sessions with one participant, and the prompts before them."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from modaltouch import analysis, preflight, protocol, record, window
from modaltouch import session as sessions
from modaltouch.cli import (
    CALIBRATION,
    INTERRUPTED,
    JSON,
    PROTOCOL,
    RESULTS,
    SEED,
    WITH_MARKED,
    leave,
    print_json,
    reporting,
)

AnswersChoice = Literal["window", "robot", "simulated"]
"""Source of the answers."""

ThemeChoice = Literal["dark", "light"]
"""Colours of the window."""
SESSION = Annotated[Path, typer.Argument(help="A session's folder or its session.jsonl.", show_default=False)]
FULLSCREEN = Annotated[
    bool | None,
    typer.Option(
        "--fullscreen/--windowed",
        help="Show the answer window full screen.",
        show_default="windowed, or as before",
    ),
]
SIZE = Annotated[
    str | None,
    typer.Option(
        help="Size of the answer window in pixels, unless it is full screen.",
        show_default="1280x800, or as before",
    ),
]
THEME = Annotated[
    ThemeChoice | None,
    typer.Option(help="Colours of the answer window.", show_default="dark, or as before"),
]
SCREEN = Annotated[
    int | None,
    typer.Option(min=0, help="Which screen shows the answer window.", show_default="0, or as before"),
]
SCREENSHOTS = Annotated[Path | None, typer.Option(help="Folder for a screenshot of each kind of screen.")]
EVENTS = Annotated[
    Path | None,
    typer.Option(
        help="File or named pipe for the session's state as JSON lines; a pipe that nobody reads causes no delay."
    ),
]
PLAIN = Annotated[bool, typer.Option("--plain", help="Print plain lines instead of the live console, without keys.")]
RIG = Annotated[
    str | None,
    typer.Option(
        help="The generator's VISA address, such as TCPIP::192.168.1.20::INSTR, or `simulated`, where nothing "
        "vibrates.",
        show_default="asked",
    ),
]
ANSWERS = Annotated[
    AnswersChoice,
    typer.Option(
        help="window: a person at the answer window; robot: a simulated participant at that window; "
        "simulated: a simulated participant without a window."
    ),
]
PARTICIPANT = Annotated[
    str | None, typer.Option("--participant", "-p", help="Participant id: letters and digits.", show_default=False)
]
SESSION_NUMBER = Annotated[
    int | None,
    typer.Option("--session", "-s", min=1, help="Number of the session.", show_default="the participant's next"),
]
PILOT = Annotated[bool, typer.Option("--pilot", help="Mark the session as a pilot; pilot data are kept separate.")]
YES = Annotated[bool, typer.Option("--yes", "-y", help="Begin without asking.")]
THRESHOLD = Annotated[
    float | None,
    typer.Option(
        "--threshold",
        min=1e-3,
        help="The participant's own threshold in mm/s, if the protocol calibrates levels by participant and the "
        "threshold was measured in another way.",
        show_default="from the participant's session that found it",
    ),
]

GROUP = Annotated[
    str | None, typer.Option(help="The participant's group, if the protocol has groups.", show_default="the one due")
]
ANY_GAP = Annotated[
    bool, typer.Option("--any-gap", help="Begin even if the minimum time since the previous session has not passed.")
]
PEOPLE = Annotated[
    Path | None,
    typer.Option(
        help="YAML file with the answers to the protocol's questions about the participant, one line per field.",
        show_default="asked, before the first session",
    ),
]


def run(
    protocol: PROTOCOL,
    participant: PARTICIPANT = None,
    session: SESSION_NUMBER = None,
    rig: RIG = None,
    answers: ANSWERS = "window",
    pilot: PILOT = False,
    seed: SEED = 1,
    results: RESULTS = Path("results"),
    fullscreen: FULLSCREEN = None,
    size: SIZE = None,
    theme: THEME = None,
    screen: SCREEN = None,
    screenshots: SCREENSHOTS = None,
    events: EVENTS = None,
    plain: PLAIN = False,
    calibration: CALIBRATION = None,
    with_marked_calibration: WITH_MARKED = False,
    threshold: THRESHOLD = None,
    people: PEOPLE = None,
    group: GROUP = None,
    any_gap: ANY_GAP = False,
    yes: YES = False,
    json_output: JSON = False,
) -> None:
    """Run one participant's session, after a full check of the protocol.

    In a terminal it asks for what is missing, shows the check and waits for `start`; then the terminal is the
    experimenter's console. Every answer is on disk before the next trial. If anything ends the session early, the
    outputs are off and `modaltouch resume` continues where it stopped.
    """
    may_ask = can_ask() and not yes and not json_output
    with reporting(json_output=json_output):
        if people is not None and answers != "window":
            given = f"given --people {people} with --answers {answers}"
            raise typer.BadParameter(f"{given}, whose answers are drawn; leave it out, or have a person answer")
        chosen = _chosen(size, theme, fullscreen=fullscreen, screen=screen, screenshots=screenshots)
        window_options = window.WindowOptions(**chosen)
        checked = preflight.examine(protocol, calibration, marked=with_marked_calibration)
        if answers != "simulated":
            checked = preflight.check_legibility(checked, window_options)
        checked.require()
        mode = sessions.mode_of(rig := rig or ask_rig(may_ask), answers, pilot=pilot)
        dataset = record.SessionFolder.dataset_of(results, mode, checked.experiment.protocol.protocol)
        participant = record.SessionFolder.check_participant(
            ask_participant(dataset) if participant is None else participant
        )
        setup = sessions.wire_run(
            checked, participant, session=session, rig=rig, answers=answers, pilot=pilot, seed=seed,
            results=results, window_options=window_options, threshold_mm_s=threshold, group=group, any_gap=any_gap,
        )  # fmt: skip
        setup.place.refuse_existing()
        setup = _with_people(setup, people, may_ask)
        _try_masking(setup)
        if may_ask:
            wait_for_start(setup)
        _conduct(sessions.begin, setup, events, plain=plain, json_output=json_output)


def _with_people(setup: sessions.Setup, people: Path | None, may_ask: bool) -> sessions.Setup:
    """Return the setup with the answers to the questions about the participant, from a file or prompts."""
    if not setup.to_ask:
        return setup
    protocol = setup.preflight.experiment.protocol
    return setup.with_people(ask_people(setup.to_ask, may_ask) if people is None else protocol.read_people(people))


def _try_masking(setup: sessions.Setup) -> None:
    """Open the masking noise briefly without sound, to report a fault before the session begins."""
    with setup.open_masking(lambda event, **facts: None) as masking:
        found = masking.describe()
    if found is not None and found["state"] != "masked":
        typer.secho(f"The beam is not masked: {found['reason']}", err=True, fg=typer.colors.YELLOW)


def resume(
    session: SESSION,
    rig: Annotated[str | None, typer.Option(help="VISA address to use instead of the recorded one.")] = None,
    answers: Annotated[
        AnswersChoice | None, typer.Option(help="Way of answering to use instead of the recorded one.")
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Close the session, keep its answers, and start over as the next session.")
    ] = False,
    fullscreen: FULLSCREEN = None,
    size: SIZE = None,
    theme: THEME = None,
    screen: SCREEN = None,
    screenshots: SCREENSHOTS = None,
    events: EVENTS = None,
    plain: PLAIN = False,
    yes: YES = False,
    json_output: JSON = False,
) -> None:
    """Continue an interrupted session: the remaining trials, in their original order.

    Where the protocol says so (`schedule.resume`), the interrupted block or the whole session starts over.

    Everything is taken from the record itself, so later changes to the protocol's files do not matter. The answer
    window opens as before, unless an option says otherwise. In a terminal it shows how many trials are answered, and
    waits for `start`.
    """
    with reporting(json_output=json_output):
        setup = sessions.wire_resume(
            session,
            rig=rig,
            answers=answers,
            restart=restart,
            window=_chosen(size, theme, fullscreen=fullscreen, screen=screen, screenshots=screenshots),
        )
        earlier = record.Session.find((setup.replaces or setup.place).log)
        if can_ask() and not (yes or json_output or earlier.complete):
            answered = f"{setup.n_answered} of {len(setup.schedule.trials)} trials answered"
            replaced = f"in place of session {earlier.start['session']} with {answered}, "
            wait_for_start(setup, replaced if setup.replaces else f"{answered}, ")
        _conduct(sessions.resume, setup, events, plain=plain, json_output=json_output)


DEMO_PARTICIPANT = "demo"


def demo(
    results: RESULTS = Path("results"),
    size: SIZE = None,
    theme: THEME = None,
    seed: SEED = 1,
    json_output: JSON = False,
) -> None:
    """Run a short session on the simulated rig, in the real window, and write its report.

    A simulated participant answers by typing into the window. Without a screen, a virtual one is started.
    """
    with reporting(json_output=json_output):
        chosen = _chosen(size, theme)
        checked = preflight.examine(protocol.Source.shipped("protocol")["demo"]).require()
        design = checked.experiment.protocol
        with window.some_display() as display:
            places = (
                record.SessionFolder(results, "simulated", design.protocol, DEMO_PARTICIPANT, n)
                for n in itertools.count(1)
            )
            place = next(place for place in places if not place.log.exists())
            traces = place.dataset / "derivatives" / f"sub-{DEMO_PARTICIPANT}_ses-{place.session}"
            options = window.WindowOptions(**chosen, screenshots=traces / "screenshots")
            what = "a simulated participant answers in the window, about a minute"
            typer.echo(f"Session {place.session} on {display}: {what}.", err=json_output)
            setup = sessions.wire_run(
                checked, DEMO_PARTICIPANT, session=place.session, answers="robot", seed=seed, results=results,
                window_options=options,
            )  # fmt: skip
            with sessions.open_console(None, design.answers.emergency_keys, plain=False) as console:
                session = sessions.begin(replace(setup, console=console))
        typer.echo(f"{session.n_answered} answers recorded; now the analysis.", err=json_output)
        report = analysis.analyse(session.path.parent, traces / "analysis", mode="simulated").files["report.html"]
        found = {"session": session.path.parent, "screenshots": traces / "screenshots", "report": report}
        if json_output:
            print_json({name: str(path) for name, path in found.items()})
        else:
            for name, path in found.items():
                print(f"{name.capitalize():12} {path}")


def _chosen(
    size: str | None,
    theme: ThemeChoice | None,
    *,
    fullscreen: bool | None = None,
    screen: int | None = None,
    screenshots: Path | None = None,
) -> dict[str, Any]:
    """Return the answer window's options that were given."""
    given = {
        "fullscreen": fullscreen,
        "size": None if size is None else _read_size(size),
        "theme": theme,
        "screen": screen,
        "screenshots": screenshots,
    }
    return {name: value for name, value in given.items() if value is not None}


def _read_size(size: str) -> tuple[int, int]:
    """Parse the window size into width and height [pixels]."""
    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) >= 640 and int(height) >= 480):
        raise typer.BadParameter(f"given {size!r}; allowed: WIDTHxHEIGHT in pixels, at least 640x480")
    return int(width), int(height)


def _conduct(
    sit: Callable[[sessions.Setup], record.Session],
    setup: sessions.Setup,
    events: Path | None,
    *,
    plain: bool,
    json_output: bool,
) -> None:
    """Run a sitting with the experimenter's console, and print the outcome."""
    emergency_keys = setup.preflight.experiment.protocol.answers.emergency_keys
    try:
        opened = sessions.open_console(events, emergency_keys, plain=plain)
    except OSError as error:
        raise typer.BadParameter(
            f"given --events {events}, which cannot be written ({error.strerror}); give a file in a folder you "
            "may write to, or a named pipe (`mkfifo`)"
        ) from error
    with opened as console:
        session = sit(replace(setup, console=console))
    folder = session.path.parent
    if json_output:
        print_json({"session": str(folder), "complete": session.complete, "n_answered": session.n_answered})
    else:
        print(f"Done: {session.n_answered} answers in {folder}")


def can_ask() -> bool:
    """Return whether standard input is a terminal and prompts are visible."""
    return sys.stdin.isatty() and (sys.stderr.isatty() or sys.stdout.isatty())


def ask_rig(may_ask: bool) -> str:
    """Prompt for the generator's VISA address until it is one; return it, or ``simulated``."""
    if not may_ask:
        raise typer.BadParameter(
            "a session needs a rig: give --rig with the generator's VISA address (`modaltouch rig list` shows what "
            "this machine can see), or --rig simulated, where nothing vibrates"
        )
    hint = "such as TCPIP::192.168.1.20::INSTR; `modaltouch rig list` shows what this machine can see"
    while True:
        given = str(
            _prompt(f"Generator's VISA address ({hint}), or {sessions.SIMULATED}", default="", shown=False)
        ).strip()
        if given.casefold() == sessions.SIMULATED or "::" in given:
            return given if "::" in given else sessions.SIMULATED
        typer.secho(f"given {given!r}; allowed: a VISA address, or {sessions.SIMULATED}", err=True, fg=typer.colors.RED)


def ask_participant(dataset: Path) -> str:
    """Prompt for a participant id until it is valid in a file name, and return it."""
    if not can_ask():
        raise typer.BadParameter("a session needs a participant id: give it with -p, for example -p p01")
    while True:
        words = "Participant id (a code of letters and digits, never a name)"
        participant = str(_prompt(words, default=sessions.propose_participant(dataset))).strip()
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


def wait_for_start(setup: sessions.Setup, answered: str = "") -> None:
    """Show a summary of the session and wait for ``start``; quitting records nothing."""
    from modaltouch.cli.check import show

    place = setup.place
    show(setup.preflight)
    if own := setup.facts.get("sensation_levels"):
        source = f"found in {own['session']}" if own["found"] == "session" else "as given"
        typer.echo(f"Levels calibrated by participant: threshold {own['threshold_mm_s']:g} mm/s, {source}")
    kind = "" if place.mode == "real" else f" ({place.mode} data)"
    rig = f"rig {setup.facts['rig_choice']}{kind}"
    typer.echo(f"Participant {place.participant}, session {place.session}, {answered}{rig}, to {place.folder}")
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
