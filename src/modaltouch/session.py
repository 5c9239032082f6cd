"""The one loop: place the fingers, fire, ask, stop, write down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from modaltouch.protocol import Protocol
from modaltouch.record.log import SessionLog
from modaltouch.rig.interface import Firing, Rig, RigError
from modaltouch.trial import FINGERS, Response, Trial
from modaltouch.window.interface import AnswerWindow, Progress, TrialInterrupted

ATTEMPTS = 3
"""How often a trial whose amplitude the instrument does not confirm is set up again before the session ends."""


@dataclass(frozen=True)
class Sitting:
    """Everything one sitting of one participant needs.

    Attributes
    ----------
    protocol : Protocol
        What is presented and asked.
    trials : tuple of Trial
        What is still to be answered, in order, practice first.
    total : int
        Number of scheduled trials, without practice.
    speeds : callable
        Predicted peak speeds under the left and the right finger in a trial [m/s].
    rig, window, log
        The open instrument, answer window and session log.
    save_view : callable
        Brings the BIDS view up to date with the log.
    tick : callable
        Called between steps; raises when the session was told to end.
    """

    protocol: Protocol
    trials: tuple[Trial, ...]
    total: int
    speeds: Callable[[Trial], tuple[float, float]]
    rig: Rig
    window: AnswerWindow
    log: SessionLog
    save_view: Callable[[], None]
    tick: Callable[[], None]


def conduct(sitting: Sitting) -> None:
    """Run every remaining trial of a session.

    Each answer is on the disk before the next trial begins, and the outputs are off whenever no stimulus is
    wanted.

    Raises
    ------
    SessionStopped, Interrupted, RigError, RecordError, WindowError
        Whatever ended the session early; what was answered is kept.
    """
    sitting.window.welcome()
    previous: Trial | None = None
    for trial in sitting.trials:
        sitting.tick()
        _prepare(sitting, trial, previous)
        response, firing, fault = present(sitting, trial)
        write_down(sitting, trial, response, firing)
        if fault:
            raise fault
        sitting.window.confirm(response)
        sitting.window.wait(sitting.protocol.answers.pause_s)
        previous = trial
    sitting.window.goodbye()


def present(sitting: Sitting, trial: Trial) -> tuple[Response, Firing, RigError | None]:
    """Fire and ask until the trial is answered; return the answer before anything else can go wrong.

    Returns
    -------
    response : Response
        What the participant answered.
    firing : Firing
        What the instrument confirmed beforehand.
    fault : RigError or None
        A failure to switch off, to be raised once the answer is written down.
    """
    progress = Progress(trial.index, sitting.total)
    faults: list[RigError] = []

    def stop() -> None:
        try:
            sitting.rig.stop()
        except RigError as error:
            faults.append(error)

    while True:
        firing = fire(sitting, trial)
        try:
            response = sitting.window.ask(trial, progress, onset=firing.onset, stop=stop)
        except TrialInterrupted as cut:
            sitting.log.append(
                "trial_cut", trial=trial.as_dict(), reason=cut.reason, confirmed=firing.as_dict()
            )
        else:
            return response, firing, faults[0] if faults else None
        finally:
            stop()
        if faults:
            raise faults[0]


def fire(sitting: Sitting, trial: Trial) -> Firing:
    """Start the stimulus, and again where the instrument does not confirm what was asked of it.

    Raises
    ------
    RigError
        If the instrument cannot be brought to confirm it.
    """
    velocity = trial.condition.velocity_mm_s * 1e-3
    for attempt in range(1, ATTEMPTS + 1):
        firing = sitting.rig.fire(velocity)
        if firing.confirmed:
            return firing
        sitting.rig.stop()
        sitting.log.append("unconfirmed", trial=trial.as_dict(), attempt=attempt, confirmed=firing.as_dict())
    raise RigError(
        f"trial {trial.index}: the generator did not confirm {trial.condition.velocity_mm_s:g} mm/s in {ATTEMPTS} "
        f"attempts (sent {firing.commanded_amplitude} Vpp, read back {firing.confirmed_amplitude} Vpp); the outputs "
        "are off; check the instrument with `modaltouch rig check`, then `modaltouch resume`"
    )


def write_down(sitting: Sitting, trial: Trial, response: Response, firing: Firing) -> None:
    """Put the answer on the disk: planned, commanded, confirmed and answered apart."""
    speed_left, speed_right = sitting.speeds(trial)
    sitting.log.append(
        "trial",
        trial=trial.as_dict(),
        fingers=list(fingers(sitting.protocol, trial)),
        planned={
            "velocity_mm_s": trial.condition.velocity_mm_s,
            "speed_left_mm_s": round(speed_left * 1e3, 3),
            "speed_right_mm_s": round(speed_right * 1e3, 3),
        },
        commanded={"amplitude_Vpp": list(firing.commanded_amplitude)},
        confirmed=firing.as_dict(),
        response=response.as_dict(),
        supersedes=None,
    )
    sitting.save_view()


def fingers(protocol: Protocol, trial: Trial) -> tuple[str, str]:
    """Return the fingers on the left and on the right zone."""
    return FINGERS[trial.condition.finger_condition, protocol.conditions.hand]


def _prepare(sitting: Sitting, trial: Trial, previous: Trial | None) -> None:
    window, every = sitting.window, sitting.protocol.schedule.break_after_trials
    if trial.practice and previous is None:
        window.announce("practice")
    if not trial.practice and (previous is None or previous.practice):
        window.announce("start")
    elif not trial.practice and every and (trial.index - 1) % every == 0:
        window.rest(Progress(trial.index, sitting.total))
    if previous is None or _placement(trial) != _placement(previous):
        window.place_fingers(trial)
        sitting.log.append("placement", **_describe_placement(sitting.protocol, trial))


def _placement(trial: Trial) -> tuple[Any, ...]:
    return (trial.condition.finger_condition, *trial.condition.pair)


def _describe_placement(protocol: Protocol, trial: Trial) -> dict[str, Any]:
    left, right = fingers(protocol, trial)
    condition = trial.condition
    return {
        "finger_condition": condition.finger_condition,
        "zone_left": condition.zone_left,
        "zone_right": condition.zone_right,
        "finger_left": left,
        "finger_right": right,
    }
