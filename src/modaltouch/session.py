"""The one loop: place the fingers, fire, ask, stop, write down."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from modaltouch.account import describe_answer, describe_placement, describe_trial
from modaltouch.adaptive import Levels
from modaltouch.console.experimenter import Experimenter
from modaltouch.masking.interface import Masking, NoMasking
from modaltouch.practice import expected_answer, judge_round
from modaltouch.protocol import Protocol, ScheduleSection
from modaltouch.record.log import SessionLog
from modaltouch.record.session import Session
from modaltouch.rig.interface import Firing, Rig, RigError
from modaltouch.trial import Response, Trial
from modaltouch.window.interface import AnswerWindow, Progress, SessionStopped, Tick, TrialInterrupted

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
    levels : Levels
        What decides the levels of an adaptive run.
    speeds : callable
        Predicted peak speeds under the left and the right finger in a trial [m/s].
    rig, window, log
        The open instrument, answer window and session log.
    save_view : callable
        Brings the BIDS view up to date with the log.
    tick : callable
        Called between steps; raises when the session was told to end.
    experimenter : Experimenter
        Is told what happens, and asks for repeats and for the end of the session after a block.
    masking : Masking
        Noise that masks the sound of the beam.
    """

    protocol: Protocol
    trials: tuple[Trial, ...]
    total: int
    levels: Levels
    speeds: Callable[[Trial], tuple[float, float]]
    rig: Rig
    window: AnswerWindow
    log: SessionLog
    save_view: Callable[[], None]
    tick: Tick
    experimenter: Experimenter = field(default_factory=Experimenter)
    masking: Masking = field(default_factory=NoMasking)


def conduct(sitting: Sitting) -> None:
    """Run every remaining trial of a session.

    Each answer is on the disk before the next trial begins, and the outputs are off whenever no stimulus is
    wanted.

    Raises
    ------
    SessionStopped, Interrupted, RigError, RecordError, WindowError, MaskingError
        Whatever ended the session early; what was answered is kept.
    """
    sitting.window.welcome(sitting.trials[0])
    previous = practise(sitting)
    rested = time.perf_counter()
    for trial in sitting.trials:
        if trial.practice:
            continue
        if previous is not None and trial.block != previous.block and sitting.experimenter.ends_after_block:
            sitting.window.goodbye()
            raise SessionStopped("end of block")
        if previous is None or previous.practice:
            sitting.window.announce("start")
        elif _rest_is_due(sitting.protocol.schedule, trial, rested):
            sitting.log.append("rest", before_trial=trial.index)
            sitting.window.rest(Progress(trial.index, sitting.total))
            rested = time.perf_counter()
        # The record alone decides the next level, so that a session that was killed goes on with the very same one.
        settled = sitting.levels.settle(trial, _counted(sitting))
        run(sitting, settled, previous)
        previous = repeat(sitting, settled)
    sitting.window.goodbye()
    # The last trial may be wanted again while the participant is thanked; the fingers are lifted by then.
    while repeat(sitting, None) is not None:
        sitting.window.goodbye()


def repeat(sitting: Sitting, previous: Trial | None) -> Trial | None:
    """Ask again what the experimenter wants repeated, and return the last trial that was run.

    The first answer stays in the record, withdrawn: if nothing comes after it, `resume` asks the trial again. In an
    adaptive run, what was answered since is asked again too, for its level followed from that answer. A practice trial
    may be repeated until its round is judged, or the first trial that counts begins.
    """
    while (event := sitting.experimenter.take_repeat()) is not None:
        again = [event]
        if sitting.protocol.adaptive is not None and not event["trial"]["practice"]:
            first = event["trial"]["index"]
            again = [e for e in _counted(sitting) if not e["trial"]["practice"] and e["trial"]["index"] >= first]
        lines = [each["n"] for each in again]
        sitting.log.append("withdrawn", lines=lines, reason="the experimenter has the trial repeated")
        for each in again:
            trial = sitting.levels.settle(Trial.from_dict(each["trial"]), _counted(sitting))
            response = run(sitting, trial, previous)
            _comment(sitting, trial, response)
            previous = trial
    return previous


def _counted(sitting: Sitting) -> tuple[dict[str, Any], ...]:
    """Return the trial events that count so far."""
    return Session(sitting.log.path, tuple(sitting.log.events), ()).trials


def practise(sitting: Sitting) -> Trial | None:
    """Run rounds of practice until one is passed, and return the last practice trial.

    Raises
    ------
    SessionStopped
        If no round was passed and the protocol then ends the session.
    """
    schedule, previous = sitting.protocol.schedule, None
    _close_rounds(sitting)
    for trial in sitting.trials:
        if not trial.practice or _has_passed_practice(sitting):
            break
        is_first = (trial.index - 1) % schedule.practice_trials == 0
        if previous is None or is_first:
            sitting.window.announce("practice" if previous is None else "practice_again")
        response = run(sitting, trial, previous)
        _comment(sitting, trial, response)
        previous = repeat(sitting, trial)
        _close_rounds(sitting)
    failed = schedule.practice_criterion is not None and not _has_passed_practice(sitting)
    if failed and schedule.practice_trials and schedule.after_failed_practice == "stop":
        sitting.window.goodbye()
        raise SessionStopped("practice not passed")
    return previous


def _comment(sitting: Sitting, trial: Trial, response: Response) -> None:
    """Tell a participant who practises what was to be felt, where the protocol wants it and there is no doubt."""
    if not (trial.practice and sitting.protocol.schedule.practice_feedback):
        return
    expected = expected_answer(*sitting.speeds(trial))
    if expected is not None:
        sitting.window.give_feedback(response, expected)


def _has_passed_practice(sitting: Sitting) -> bool:
    return any(event.get("event") == "practice_round" and event["passed"] for event in sitting.log.events)


def _close_rounds(sitting: Sitting) -> None:
    """Write down how each round of practice went that is over and not yet judged, before a kill or after it."""
    schedule, events = sitting.protocol.schedule, sitting.log.events
    counted = [event for event in _counted(sitting) if event["trial"]["practice"]]
    if schedule.practice_criterion is None or not schedule.practice_trials:
        return
    done = {event["trial"]["index"] for event in counted}
    judged = {event["round"] for event in events if event.get("event") == "practice_round"}
    for number in range(1, schedule.practice_rounds + 1):
        last = number * schedule.practice_trials
        if number not in judged and done.issuperset(range(last - schedule.practice_trials + 1, last + 1)):
            outcome = judge_round(counted, number, schedule.practice_trials)
            sitting.log.append(
                "practice_round",
                round=number,
                n_judged=outcome.n_judged,
                n_agreed=outcome.n_agreed,
                criterion=schedule.practice_criterion,
                passed=outcome.passes(schedule.practice_criterion),
            )


def run(sitting: Sitting, trial: Trial, previous: Trial | None) -> Response:
    """Present one trial until the instrument confirms what it played, write every answer down; return the last.

    Raises
    ------
    RigError
        If the outputs could not be switched off, or the instrument changed under every presentation.
    """
    sitting.tick()
    sitting.experimenter.tell(
        {"event": "trial_next", "trial": describe_trial(sitting.protocol, sitting.speeds(trial), trial)}
    )
    if previous is None or _placement(trial) != _placement(previous):
        sitting.window.place_fingers(trial)
        sitting.log.append("placement", **describe_placement(sitting.protocol, trial))
    for _ in range(ATTEMPTS):
        response, firing, fault = present(sitting, trial)
        write_down(sitting, trial, response, firing)
        if fault:
            raise fault
        sitting.window.confirm(response)
        sitting.window.wait(sitting.protocol.answers.pause_s)
        if firing.confirmed:
            return response
    raise RigError(
        f"trial {trial.index}: in {ATTEMPTS} presentations the generator's settings changed while it played "
        f"({firing.reason}); the outputs are off and the answers are kept as unconfirmed; find out what changes "
        "the instrument, then `modaltouch resume`"
    )


def present(sitting: Sitting, trial: Trial) -> tuple[Response, Firing, RigError | None]:
    """Fire and ask until the trial is answered; return the answer before anything else can go wrong.

    Returns
    -------
    response : Response
        What the participant answered.
    firing : Firing
        What the instrument confirmed, before the stimulus and still at its end.
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
        sitting.window.settle(trial, progress)
        sitting.masking.ensure(sitting.tick)
        firing = fire(sitting, trial)
        try:
            # Whatever ends the session now, the record knows that this stimulus had begun.
            sitting.log.append("fired", trial=trial.as_dict(), confirmed=firing.as_dict())
            response = sitting.window.ask(trial, progress, onset=firing.onset, stop=stop)
        except TrialInterrupted as cut:
            sitting.log.append("trial_cut", trial=trial.as_dict(), reason=cut.reason, confirmed=firing.as_dict())
        else:
            return response, sitting.rig.firing or firing, faults[0] if faults else None
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
    # A catch trial does all that one at the lowest level does, but lets no burst go.
    silent = trial.condition.is_catch
    level = min(sitting.protocol.conditions.peak_velocities_mm_s) if silent else trial.condition.velocity_mm_s
    names = sitting.protocol.stimulus_names
    which = names.index(trial.condition.stimulus) if trial.condition.stimulus in names else 0
    for attempt in range(1, ATTEMPTS + 1):
        firing = sitting.rig.fire(level * 1e-3, silent=silent, which=which)
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
    """Put the answer on the disk."""
    facts = describe_answer(
        sitting.protocol,
        sitting.speeds(trial),
        trial,
        response,
        firing,
        masked=sitting.masking.is_on,
        events=sitting.log.events,
    )
    sitting.log.append("trial", **facts)
    sitting.save_view()


def _rest_is_due(schedule: ScheduleSection, trial: Trial, rested: float) -> bool:
    """Return whether a break comes before a trial, by count or by the time since `rested` [s]."""
    by_count = schedule.break_after_trials is not None and (trial.index - 1) % schedule.break_after_trials == 0
    minutes = (time.perf_counter() - rested) / 60
    return by_count or (schedule.break_after_min is not None and minutes >= schedule.break_after_min)


def _placement(trial: Trial) -> tuple[Any, ...]:
    return (trial.condition.finger_condition, *trial.condition.pair, trial.condition.placement)
