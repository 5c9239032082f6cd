"""Trial loop: place the fingers, play the stimulus, ask, stop, record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from modaltouch import protocol
from modaltouch.protocol import TIME_OUT, AnswersSection, Protocol, Response, Trial
from modaltouch.record import RecordError, SessionLog
from modaltouch.rig import Firing, Rig, RigError, StimulusLost
from modaltouch.session.console import Experimenter
from modaltouch.session.events import (
    PRACTICE_FAILED,
    describe_answer,
    describe_ending,
    describe_placement,
    describe_trial,
)
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window import AnswerWindow, Masking, Presentation, SessionStopped, TrialInterrupted

if TYPE_CHECKING:
    from modaltouch.protocol import Levels
    from modaltouch.session.probing import Probing

ATTEMPTS = 3
"""Maximum number of presentations of a trial that the instrument does not confirm."""

MOST_STALLS = 30
"""Maximum number of presentations of a trial that fail because this computer is busy, over a minute or more."""

NOT_OVER = "the stimulus is not over yet"
"""Reason for an unconfirmed stimulus when the answer is first recorded."""


@dataclass(frozen=True)
class SessionRun:
    """Parts and parameters of the trial loop in one sitting."""

    protocol: Protocol
    trials: tuple[Trial, ...]  # remaining trials in order, practice first
    total: int  # number of scheduled trials, without practice
    levels: Levels | None  # sets the levels of adaptive runs; None if the protocol fixes them
    # predicted peak speeds under the fingers in a trial, from left to right [m/s]
    speeds: Callable[[Trial], tuple[float, ...]]
    # rig, window, log: the open instrument, answer window and session log
    rig: Rig
    window: AnswerWindow
    log: SessionLog
    save_view: Callable[[], None]  # updates the BIDS view from the log
    tick: Callable[[], object]  # called between steps, where the window does not wait; raises to end the session
    which: Callable[[Trial], int] = lambda _: 0  # index of the loaded burst for a trial; the first by default
    # level played for a trial and a nominal level [mm/s]; the nominal level by default
    played: Callable[[Trial, float], float] = lambda _, level: level
    probing: Probing | None = None  # measures the fingers at each placement; None if they are not measured
    # receives the events, and requests repeats and the end of the session after a block
    experimenter: Experimenter = field(default_factory=Experimenter)
    masking: Masking = field(default_factory=Masking)  # noise that masks the sound of the beam
    clock: Clock = SYSTEM_CLOCK  # clock of session, window, instrument and record


def conduct(sitting: SessionRun) -> None:
    """Run all remaining trials of a session.

    Each answer is on disk before the next trial begins, and the outputs are off between stimuli. Raises SessionStopped,
    Interrupted, RigError, RecordError, WindowError if the session ended early; all answers are kept.
    """
    if sitting.trials:
        sitting.window.welcome(sitting.trials[0])
    previous = practise(sitting)
    rested = sitting.clock.now()
    for trial in sitting.trials:
        if trial.practice:
            continue
        if previous is not None and trial.block != previous.block and sitting.experimenter.ends_after_block:
            sitting.window.goodbye()
            raise SessionStopped("end of block")
        if previous is None or previous.practice:
            sitting.window.announce("start")
        elif _rest_is_due(sitting, trial, rested):
            sitting.log.append("rest", before_trial=trial.index)
            sitting.window.announce("rest", (trial.index, sitting.total))
            rested = sitting.clock.now()
            if sitting.probing is not None:
                previous = None  # place and measure the fingers again after a break
        # The next level depends only on the record, so that a killed session continues at the same level.
        settled = _settle(sitting, trial)
        run(sitting, settled, previous)
        previous = repeat(sitting, settled)
    fill_in(sitting)
    sitting.window.goodbye()
    # The experimenter may request the last trial again during the goodbye, when the fingers are already lifted.
    while repeat(sitting, None) is not None:
        sitting.window.goodbye()


def repeat(sitting: SessionRun, previous: Trial | None) -> Trial | None:
    """Repeat the trials requested by the experimenter, and return the last trial run.

    The first answer stays in the record but is withdrawn: if the session ends before a new answer, `resume` repeats
    the trial. In an adaptive run, all later trials are repeated too, because their levels depend on that answer. A
    practice trial can be repeated until its round is judged or the first main trial begins.
    """
    while (event := sitting.experimenter.take_repeat()) is not None:
        again = [event]
        if sitting.protocol.adaptive is not None and not event["trial"]["practice"]:
            first = event["trial"]["index"]
            again = [
                e for e in sitting.log.session.trials if not e["trial"]["practice"] and e["trial"]["index"] >= first
            ]
        lines = [each["n"] for each in again]
        sitting.log.append("withdrawn", lines=lines, reason="the experimenter has the trial repeated")
        for each in again:
            trial = _settle(sitting, Trial.from_dict(each["trial"]))
            _comment(sitting, trial, run(sitting, trial, previous))
            previous = trial
    return previous


def practise(sitting: SessionRun) -> Trial | None:
    """Run practice rounds until one is passed, and return the last trial, unless the protocol ends the session here."""
    schedule, previous = sitting.protocol.schedule, None
    _close_rounds(sitting)
    for trial in sitting.trials:
        if not trial.practice or _has_passed_practice(sitting):
            break
        if previous is None or (trial.index - 1) % schedule.practice_trials == 0:
            sitting.window.announce("practice" if previous is None else "practice_again")
        _comment(sitting, trial, run(sitting, trial, previous))
        previous = repeat(sitting, trial)
        _close_rounds(sitting)
    failed = schedule.practice_criterion is not None and not _has_passed_practice(sitting)
    if failed and schedule.practice_trials and schedule.after_failed_practice == "stop":
        sitting.window.goodbye()
        raise SessionStopped(PRACTICE_FAILED)
    return previous


def _comment(sitting: SessionRun, trial: Trial, response: Response) -> None:
    """Give feedback after a practice trial if the protocol has feedback and the expected answer is unambiguous."""
    if not (trial.practice and sitting.protocol.schedule.practice_feedback):
        return
    expected = sitting.protocol.expected(trial, sitting.speeds(trial))
    if expected is not None:
        sitting.window.give_feedback(response, expected)


def _has_passed_practice(sitting: SessionRun) -> bool:
    return any(event.get("event") == "practice_round" and event["passed"] for event in sitting.log.events)


def _settle(sitting: SessionRun, trial: Trial) -> Trial:
    """Return a trial at the level determined by the answers so far; unchanged if levels are fixed."""
    if sitting.levels is None:
        return trial
    algorithm = str(sitting.log.session.start.get("adaptive", {}).get("algorithm", ""))
    return sitting.levels.settle(trial, sitting.log.session.trials, algorithm)


def _close_rounds(sitting: SessionRun) -> None:
    """Judge and record all completed practice rounds not judged yet, including one completed before a kill."""
    schedule, events = sitting.protocol.schedule, sitting.log.events
    confirmed = (event for event in sitting.log.session.trials if event["confirmed"]["confirmed"])
    counted = [event for event in confirmed if event["trial"]["practice"]]
    if schedule.practice_criterion is None or not schedule.practice_trials:
        return
    done = {event["trial"]["index"] for event in counted}
    judged = {event["round"] for event in events if event.get("event") == "practice_round"}
    for number in range(1, schedule.practice_rounds + 1):
        last = number * schedule.practice_trials
        if number not in judged and done.issuperset(range(last - schedule.practice_trials + 1, last + 1)):
            outcome = protocol.judge_round(counted, number, schedule.practice_trials, sitting.protocol)
            sitting.log.append(
                "practice_round",
                round=number,
                n_judged=outcome.n_judged,
                n_agreed=outcome.n_agreed,
                criterion=schedule.practice_criterion,
                passed=outcome.passes(schedule.practice_criterion),
            )


def run(sitting: SessionRun, trial: Trial, previous: Trial | None) -> Response:
    """Present a trial until its stimulus is confirmed, record all answers and return the last.

    Raises RigError if the outputs cannot be switched off, or no presentation was confirmed.
    """
    sitting.tick()
    sitting.experimenter.tell(
        {"event": "trial_next", "trial": describe_trial(sitting.protocol, sitting.speeds(trial), trial)}
    )
    if previous is None or _placement(trial) != _placement(previous):
        place(sitting, trial)
    attempts = stalls = answers = 0
    while attempts < ATTEMPTS and stalls < MOST_STALLS:
        response, firing = present(sitting, trial)
        if response is not None:
            answers += 1
            busy = 0.0 if sitting.probing is None else sitting.probing.busy
            sitting.window.wait(max(sitting.protocol.answers.pause_s - busy - sitting.rig.lead, 0.0))
            if firing.confirmed:
                return response
        if firing.stalled:
            # The instrument is fine, but the computer was busy: present the trial again later.
            stalls += 1
            sitting.window.show_stall()
        else:
            attempts += 1
    by_instrument = ATTEMPTS, "check the instrument with `modaltouch rig check`"
    n, remedy = by_instrument if attempts == ATTEMPTS else (MOST_STALLS, "close other programs")
    raise RigError(
        f"trial {trial.index}: {n} presentations could not be confirmed ({firing.reason}); the outputs are off"
        + ("; the answers are kept as unconfirmed" if answers else "")
        + f"; {remedy}"
    )


def place(sitting: SessionRun, trial: Trial) -> None:
    """Have the fingers placed for a trial, and measure them if the protocol requires it."""
    if sitting.probing is not None:
        sitting.probing.lift_hands(trial)
    sitting.window.place_fingers(trial)
    sitting.log.append("placement", **describe_placement(sitting.protocol, trial))
    if sitting.probing is not None:
        sitting.probing.measure(trial, (trial.index, sitting.total))


def present(sitting: SessionRun, trial: Trial) -> tuple[Response | None, Firing]:
    """Present a trial, repeatedly if it is interrupted, and record the answer at once.

    Returns the response, or None if the stimulus failed before, and the stimulus as played. Raises RigError if the
    outputs cannot be switched off.
    """
    while True:
        # Setting and read-back of the generator are part of the pause, to keep its duration as in the protocol.
        due = sitting.window.settle(trial, (trial.index, sitting.total), sitting.rig.lead)
        sitting.masking.ensure(sitting.tick, on=sitting.protocol.is_masked(trial.condition.stimulus))
        try:
            return _present_once(sitting, trial, due)
        except TrialInterrupted:
            continue


def _present_once(sitting: SessionRun, trial: Trial, due: float) -> tuple[Response | None, Firing]:
    """Present the stimulus of a trial, or of each interval in turn, and ask; raise if interrupted."""
    parts, over, response = sitting.protocol.presented(trial), list[Firing](), None
    for number, part in enumerate(parts, 1):
        facts: dict[str, Any] = {"trial": trial.as_dict()} | ({"interval": number} if len(parts) > 1 else {})
        firing = fire(sitting, part, due, heard=number == max(trial.interval, 1))
        if not firing.started:
            sitting.log.append("unconfirmed", **facts, confirmed=firing.as_dict())
            break
        faults: list[RigError] = []

        def stop(faults: list[RigError] = faults) -> None:
            try:
                sitting.rig.stop()
            except RigError as error:
                faults.append(error)

        is_last, ends = number == len(parts), firing.onset + sitting.protocol.longest_s(part.condition.stimulus)
        # Failure to switch the outputs off ends the session before a gap, or in the last interval after the answer.
        ceases = stop if is_last else sitting.rig.stop
        presentation = Presentation(firing.onset, ends, sitting.rig.end, ceases, facts.get("interval", 0))
        try:
            # From here on, the record shows that this stimulus had begun, however the session ends.
            sitting.log.append("fired", **facts, confirmed=firing.as_dict())
            if is_last:
                response = sitting.window.ask(part, (trial.index, sitting.total), presentation)
                line = _write_down(sitting, "answered", trial, response, [*over, firing.pending(NOT_OVER)])
                sitting.window.confirm(response)
            elif sitting.protocol.intervals is not None:
                due = ends + sitting.protocol.intervals.gap_s
                sitting.window.feel(part, (trial.index, sitting.total), presentation, due - sitting.rig.lead)
        except (TrialInterrupted, StimulusLost) as cut:
            stop()
            firing, reason = sitting.rig.firing or firing, cut.reason if isinstance(cut, TrialInterrupted) else str(cut)
            _write_cut(sitting, facts, reason, firing)
            if faults:
                raise faults[0] from cut
            if isinstance(cut, StimulusLost):
                return None, replace(firing, reason=firing.reason or reason)
            raise
        except BaseException as error:
            with suppress(RigError):
                sitting.rig.stop(at_once=True)
            with suppress(RecordError):
                _write_cut(sitting, facts, describe_ending(error)["reason"], sitting.rig.firing or firing)
            raise
        stop()
        over.append(firing := sitting.rig.firing or firing)
        if response is not None:
            counts = firing.confirmed and not faults
            response, delivered = _complete(sitting, trial, response) if counts else (response, {})
            _write_down(sitting, "trial", trial, response, over, answered=line, **delivered)
            sitting.save_view()
        elif not firing.confirmed:
            _write_cut(sitting, facts, firing.reason, firing)
        if faults:
            raise faults[0]
        if not firing.confirmed:
            break
    return response, firing


def _complete(sitting: SessionRun, trial: Trial, response: Response) -> tuple[Response, dict[str, Any]]:
    """Return a response completed with the answers to further questions, and the delivered speeds if measured.

    A trial that is interrupted here is repeated as a whole.
    """
    if response.answer != TIME_OUT:
        asked = sitting.protocol.answers.further
        further = {name: _ask_further(sitting, name, how, trial).as_dict() for name, how in asked.items()}
        response = replace(response, further=further)
    return response, {} if sitting.probing is None else sitting.probing.delivered(trial)


def _ask_further(sitting: SessionRun, name: str, asked: AnswersSection, trial: Trial | None = None) -> Response:
    """Ask a further question, also at the console if the experimenter answers."""
    if (asked.given_by if trial is None else asked.way(trial.condition.finger_condition)) == "experimenter":
        keys = {answer: list(keys) for answer, keys in asked.actions.items()}
        sitting.experimenter.tell({"event": "question_next", "keys": keys, "rates": asked.scale is not None})
    return sitting.window.ask_further(name, asked, trial)


def fill_in(sitting: SessionRun) -> None:
    """Ask the remaining questions of the closing form; each answer is on disk before the next question."""
    done = {event["name"] for event in sitting.log.events if event["event"] == "form"}
    for name, asked in sitting.protocol.closing.items():
        if name not in done:
            sitting.log.append("form", name=name, response=_ask_further(sitting, name, asked).as_dict())
            sitting.save_view()


def fire(sitting: SessionRun, trial: Trial, due: float, *, heard: bool) -> Firing:
    """Start the stimulus of a trial, or the silence of a catch trial, when due; measure it if `heard`."""
    if heard and sitting.probing is not None:
        sitting.probing.listen(trial)
    # A catch trial runs like a trial at the lowest level, but plays no burst.
    silent = trial.condition.is_catch
    level = min(sitting.protocol.conditions.peak_velocities_mm_s) if silent else trial.condition.velocity_mm_s
    level = sitting.played(trial, level)
    n_bursts = sitting.protocol.n_bursts(trial.condition.stimulus)
    exactly = sitting.protocol.answers.stimulus_until == "question"
    return sitting.rig.fire(
        level * 1e-3, n_bursts=n_bursts, exactly=exactly, silent=silent, which=sitting.which(trial), due=due
    )


def _write_down(
    sitting: SessionRun, event: str, trial: Trial, response: Response, firings: Sequence[Firing], **further: Any
) -> int:
    """Record an answer, and return the number of its line."""
    facts = describe_answer(
        sitting.protocol,
        sitting.speeds,
        trial,
        response,
        firings,
        masked=sitting.masking.is_on,
        events=sitting.log.events_of(trial.as_dict()),
    )
    return int(sitting.log.append(event, **facts, **further)["n"])


def _write_cut(sitting: SessionRun, facts: dict[str, Any], reason: str, firing: Firing) -> None:
    sitting.log.append(
        "trial_cut",
        **facts,
        reason=reason,
        confirmed=firing.as_dict(),
        bursts=firing.bursts.as_dict(),
    )


def _rest_is_due(sitting: SessionRun, trial: Trial, rested: float) -> bool:
    """Return whether a break is due before a trial, by count or by the time since `rested` [s]."""
    schedule = sitting.protocol.schedule
    by_count = schedule.break_after_trials is not None and (trial.index - 1) % schedule.break_after_trials == 0
    minutes = (sitting.clock.now() - rested) / 60
    return by_count or (schedule.break_after_min is not None and minutes >= schedule.break_after_min)


def _placement(trial: Trial) -> tuple[Any, ...]:
    return (trial.condition.finger_condition, *trial.condition.zones, trial.condition.placement)
