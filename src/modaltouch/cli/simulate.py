"""``modaltouch simulate``: sessions of a cohort of simulated participants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modaltouch import planning, preflight, session
from modaltouch.cli import (
    CALIBRATION,
    JSON,
    PROTOCOL,
    RESULTS,
    SEED,
    USUAL_OBSERVER,
    WITH_MARKED,
    print_json,
    progress,
    reporting,
)


def simulate(
    protocol: PROTOCOL,
    participants: Annotated[int, typer.Option("--participants", "-n", min=1, help="Size of the cohort.")] = 10,
    seed: SEED = 1,
    observer: USUAL_OBSERVER = None,
    results: RESULTS = Path("results"),
    calibration: CALIBRATION = None,
    with_marked_calibration: WITH_MARKED = False,
    json_output: JSON = False,
) -> None:
    """Run a cohort of simulated participants through the same code on the simulated rig.

    Each has one session, or every kind of session that the protocol lists.
    """
    with reporting(json_output=json_output):
        # An observer that does not exist is reported before the protocol's stimuli are designed.
        given = None if observer is None else planning.Observer.read(observer)
        checked = preflight.examine(protocol, calibration, marked=with_marked_calibration).require()
        population = given or planning.Observer.read(planning.Observer.usual_name(checked.experiment.protocol))
        sessions, schedule = [], checked.experiment.protocol.schedule
        with progress("participants") as on_progress:
            for number in range(1, participants + 1):
                on_progress(number - 1, participants)
                name = f"sim{number:0{max(2, len(str(participants)))}d}"
                sessions += [
                    session.simulate_session(checked, name, results, seed=seed, observer=population, session=each)
                    for each in range(1, len(schedule.session_kinds or (1,)) + 1)
                ]
            on_progress(participants, participants)
        dataset = sessions[0].path.parents[3]
        if json_output:
            print_json({"sessions": [str(each.path.parent) for each in sessions], "dataset": str(dataset)})
        else:
            print(f"{len(sessions)} session{'s' * (len(sessions) > 1)} in {dataset}")
            print(f"Next: modaltouch analyse {dataset}")
