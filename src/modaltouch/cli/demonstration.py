"""A whole short session for a first look: simulated rig, real window, simulated participant, report."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from modaltouch.analysis import analyse
from modaltouch.preflight import examine
from modaltouch.protocol import Source
from modaltouch.record import RecordExistsError, SessionFolder
from modaltouch.session import begin, wire_run
from modaltouch.window import WindowOptions

PARTICIPANT = "demo"


def demonstrate(
    results: Path,
    *,
    seed: int,
    window_options: WindowOptions,
    tell: Callable[[str], None],
    on_progress: Callable[[int, int], None],
) -> dict[str, Path]:
    """Run the demonstration and return where its traces are.

    Parameters
    ----------
    results : Path
        Folder where sessions are recorded; every demonstration is a new session in its simulated tree.
    seed : int
        Seed of the order and of the simulated participant.
    window_options : WindowOptions
        How the window is opened.
    tell : callable
        Takes a sentence on what happens next.
    on_progress : callable
        Called with (answered, total) after each trial.
    """
    preflight = examine(Source.shipped("protocol")["demo"]).require()
    number = 0
    with window_options.display() as display:
        while True:
            number += 1
            place = SessionFolder(results, "simulated", preflight.experiment.protocol.protocol, PARTICIPANT, number)
            if place.log.exists():
                continue
            traces = place.dataset / "derivatives" / f"sub-{PARTICIPANT}_ses-{number}"
            screenshots = window_options.screenshots or traces / "screenshots"
            tell(f"Session {number} on {display}: a simulated participant answers in the window, about a minute.")
            setup = wire_run(
                preflight,
                PARTICIPANT,
                session=number,
                answers="robot",
                seed=seed,
                results=results,
                window_options=replace(window_options, screenshots=screenshots),
            )
            # Another demonstration may take the number while this one opens its window.
            with suppress(RecordExistsError):
                session = begin(replace(setup, on_progress=on_progress))
                break
    tell(f"{session.n_answered} answers recorded; now the analysis.")
    analysis = analyse(session.path.parent, traces / "analysis", mode="simulated")
    return {"session": session.path.parent, "screenshots": screenshots, "report": analysis.files["report.html"]}
