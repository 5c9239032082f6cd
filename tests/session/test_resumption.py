"""An interrupted session continues by its protocol's policy, in the same order, wherever its log ends."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.planning.observer import Observer
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol.schedule import Schedule
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import RecordInputError, read_chain
from modaltouch.record.session import Session, read_session
from modaltouch.rig.interface import Bursts, Firing
from modaltouch.session.console import Console, Request, SessionState
from modaltouch.session.resumption import answers_to_ask_again, examine_interruption, refuse_old, resume, wire_resume
from modaltouch.session.setup import Setup, begin
from modaltouch.session.wiring import wire_run
from modaltouch.window.interface import AnswerWindow, SessionStopped
from modaltouch.window.simulated import Answerer, SimulatedParticipant

Edit = Callable[..., Path]


class PaperRig:
    """Fires nothing and confirms it, in the time that bursts would take."""

    identity = "TEKTRONIX,AFG3022B,SIMULATED,paper"
    address = "paper"
    lead = 0.0
    firing: Firing | None = None

    def __init__(self, setup: Setup) -> None:
        self._bursts, self._clock = setup.preflight.bursts, setup.clock
        self._chosen, self._most = 0, 0

    def load(self, *bursts: Any) -> None:
        pass

    def fire(self, velocity: float, *, n_bursts: int, silent: bool = False, which: int = 0, **_: object) -> Firing:
        amplitude = self._bursts[which].amplitude_for(velocity)
        self._chosen, self._most = which, 0 if silent else n_bursts
        self._clock.sleep(0.05)
        self.firing = Firing(amplitude, amplitude, self._clock.now(), 0.001, started=True)
        self._clock.sleep(0.001)
        return self.firing

    def end(self) -> None:
        pass

    def stop(self, *, at_once: bool = False) -> None:
        if self.firing is None or self.firing.confirmed:
            return
        burst, onset = self._bursts[self._chosen], self.firing.onset
        n = min(int((self._clock.now() - onset) * burst.repetition_rate) + 1, self._most)
        self._clock.sleep(onset + (n - 1) / burst.repetition_rate + burst.duration - self._clock.now() if n else 0.0)
        counted = Bursts(n, n, n, 0, *((onset, 0.001) if n else ()))
        self.firing = replace(self.firing, confirmed=True, bursts=counted)

    def heartbeat(self) -> None:
        pass

    def close(self) -> None:
        pass


def on_paper(setup: Setup) -> Setup:
    """Return a setup without instrument and window, answered by a model."""

    @contextmanager
    def open_rig(log: Callable[..., None]) -> Iterator[PaperRig]:
        yield PaperRig(setup)

    def open_window(tick: Callable[[], None], log: Callable[..., None]) -> AnswerWindow:
        person = Observer().draw(Schedule.random_generator(1, "p01", 1, "observer"))
        answerer = Answerer(person, setup.preflight.speeds, Schedule.random_generator(1, "p01", 1, "answers"))
        until = setup.preflight.experiment.protocol.answers.stimulus_until
        return SimulatedParticipant(answerer, tick=tick, stimulus_until=until, clock=setup.clock, step=0.1)

    return replace(setup, open_rig=open_rig, open_window=open_window)  # type: ignore[arg-type]


def with_policy(edit: Edit, policy: str) -> Preflight:
    """Return the demonstration with another policy for resuming."""
    path = edit("demo.yaml", ("  break_after_trials: 6", f"  break_after_trials: 6\n  resume: {policy}"))
    return examine(path).require()


def asked(session: Session) -> list[tuple[bool, int, str]]:
    """Return the answers in the order of the record."""
    return [
        (event["trial"]["practice"], event["trial"]["index"], event["response"]["answer"])
        for event in session.events
        if event["event"] == "trial"
    ]


def cut_at(whole: Path, place: Path, n_lines: int, extra: bytes = b"") -> Path:
    """Return a copy of a session's log that ends after some lines, as after a kill."""
    folder = place / whole.parent.relative_to(whole.parents[5])
    folder.mkdir(parents=True)
    lines = whole.read_bytes().splitlines(keepends=True)
    log = folder / whole.name
    log.write_bytes(b"".join(lines[:n_lines]) + extra)
    return log


@pytest.mark.parametrize("at", ["trial", "block", "restart"])
def test_the_order_is_kept_wherever_the_log_ends(edit: Edit, tmp_path: Path, at: str) -> None:
    """Kill points at every second or third line, complete or torn; by policy the rest, the block or all."""
    preflight = with_policy(edit, f"{{at: {at}}}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "whole")))
    expected = asked(whole)
    first_of_block = {trial[1]: 1 if trial[1] <= 6 else 7 for trial in expected if not trial[0]}
    n_lines = len(whole.events) - 1  # without the stop record: that session is complete
    for n in range(1, n_lines, 2 if at == "trial" else 3):
        torn = b'{"n":' if n % 3 == 0 else b""
        log = cut_at(whole.path, tmp_path / str(n), n, torn)
        before = asked(read_session(log))
        complete = read_session(log).complete
        done = resume(on_paper(wire_resume(log)))
        assert done.complete
        # Verification draws and synthesises anew, which takes longer than the session.
        assert n % 8 or audit_session(Session.find(done.path)).problems == ()
        after = asked(done)
        if at == "restart" and not complete:
            assert done.path != log
            assert after == expected
            assert asked(read_session(log)) == before
            assert read_session(log).started_over_as == 2
            assert audit_session(Session.find(log)).lines[-1] == "closed and not complete: started over as session 2"
            continue
        assert after[: len(before)] == before
        counted = [event for event in before if not event[0]]
        begun = at == "block" and not complete and counted and counted[-1][1] not in (6, 12)
        first = first_of_block[counted[-1][1]] if begun else len(counted) + 1
        rest = [
            event for event in expected if (event[0] and event not in before) or (not event[0] and event[1] >= first)
        ]
        assert after[len(before) :] == rest
        assert [(e["trial"]["practice"], e["trial"]["index"], e["response"]["answer"]) for e in done.trials] == expected
        table = next(done.path.parent.glob("*_beh.tsv")).read_text().splitlines()
        assert len(table) == 1 + len(expected)


@pytest.mark.parametrize("cut", [1, 40])
def test_a_complete_session_with_a_torn_last_line_is_repaired(edit: Edit, tmp_path: Path, cut: int) -> None:
    """No answer is missing, so nothing is asked, and the analysis accepts the session again."""
    preflight = with_policy(edit, "{at: trial}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path)))
    whole.path.write_bytes(whole.path.read_bytes()[:-cut])
    assert audit_session(Session.find(whole.path)).problems
    told = CliRunner().invoke(app, ["doctor", str(whole.path)])
    assert told.exit_code == (4 if cut > 1 else 0), "a newline is no loss"
    assert f"continue with `modaltouch resume {whole.path.parent}`" in told.output
    assert "--into" not in told.output
    done = resume(on_paper(wire_resume(whole.path)))
    assert done.problems == ()
    assert audit_session(Session.find(done.path)).problems == ()
    assert CliRunner().invoke(app, ["doctor", str(whole.path)]).exit_code == 0
    assert asked(done) == asked(whole)
    assert done.events[-1]["reason"] == "finished"


def test_failed_practice_is_restarted_and_never_resumed(edit: Edit, tmp_path: Path) -> None:
    """Resuming would end again; both messages give the restart as the remedy."""
    failing = (
        "  practice_trials: 1",
        "  practice_trials: 6\n  practice_criterion: 1.0\n  after_failed_practice: stop",
    )
    preflight = examine(edit("demo.yaml", failing)).require()

    def open_window(tick: Callable[[], None], log: Callable[..., None]) -> AnswerWindow:
        person = Observer().draw(Schedule.random_generator(1, "p01", 1, "observer"))
        answerer = Answerer(
            person, lambda trial: preflight.speeds(trial)[::-1], Schedule.random_generator(1, "p01", 1, "answers")
        )
        return SimulatedParticipant(answerer, tick=tick, clock=setup.clock)

    setup = on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path))
    with pytest.raises(SessionStopped, match="practice not passed") as ended:
        begin(replace(setup, open_window=open_window))  # type: ignore[arg-type]
    assert f"`modaltouch resume --restart {setup.place.folder}` starts it over" in ended.value.__notes__[0]
    before = setup.place.log.read_bytes()
    with pytest.raises(RecordInputError, match=r"practice was not passed.*resume --restart"):
        resume(on_paper(wire_resume(setup.place.log)))
    assert setup.place.log.read_bytes() == before


def test_an_interrupted_stimulus_is_recorded_and_repeated(edit: Edit, tmp_path: Path) -> None:
    """Killed between stimulus and answer: `trial_cut` when resumed, then the second presentation."""
    preflight = with_policy(edit, "{at: trial}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "whole")))
    fired = [event["n"] for event in whole.events if event["event"] == "fired"]
    log = cut_at(whole.path, tmp_path / "cut", fired[4])
    done = resume(on_paper(wire_resume(log)))
    cut = [event for event in done.events if event["event"] == "trial_cut"]
    assert [event["reason"] for event in cut] == ["interrupted (killed)"]
    again = next(event for event in done.trials if event["trial"] == cut[0]["trial"])
    assert again["presentation"] == 2
    assert {event["presentation"] for event in done.trials if event is not again} == {1}
    told = next(event for event in done.events if event["event"] == "resume")
    assert told["interruption"]["cut_trial"] == cut[0]["trial"]
    assert told["interruption"]["reason"] == "killed"


def test_a_restarted_session_cannot_be_resumed(edit: Edit, tmp_path: Path) -> None:
    """The message has the session that replaced it, whose order is the same."""
    preflight = with_policy(edit, "{at: trial}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "whole")))
    log = cut_at(whole.path, tmp_path / "cut", 12)
    anew = resume(on_paper(wire_resume(log, restart=True)))
    assert anew.start["begins_anew"]["session"] == 1
    assert anew.start["schedule"]["order_hash"] == whole.start["schedule"]["order_hash"]
    with pytest.raises(RecordInputError, match="was started over as session 2"):
        wire_resume(log)


def test_a_killed_restart_is_repeated_in_the_same_place(edit: Edit, tmp_path: Path) -> None:
    """Killed between closing the old session and starting the new one; nothing is closed twice."""
    preflight = with_policy(edit, "{at: restart}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "whole")))
    log = cut_at(whole.path, tmp_path / "cut", 12)
    anew = resume(on_paper(wire_resume(log)))
    shutil.rmtree(anew.path.parents[1])
    again = resume(on_paper(wire_resume(log)))
    assert again.path == anew.path
    assert [event["event"] for event in read_chain(log).events].count("closed") == 1


class Repeating(Console):
    """A console at which a trial is repeated during the next one."""

    def __init__(self, index: int) -> None:
        self._index = index
        self._asks = False

    def show(self, facts: SessionState) -> None:
        shown = facts["trial"]
        self._asks = self._asks or bool(
            facts["state"] == "trial" and shown["number"] == self._index and not shown["practice"]
        )

    def requests(self) -> list[Request]:
        if not self._asks:
            return []
        self._asks, self._index = False, -1
        return [Request("repeat")]


@pytest.mark.parametrize(("protocol", "lines"), [("demo.yaml", 1), ("threshold.yaml", 2)])
def test_a_repeated_trial_supersedes_its_answer(edit: Edit, tmp_path: Path, protocol: str, lines: int) -> None:
    """The old answer is withdrawn; in an adaptive run also the next one, whose level followed from it."""
    preflight = examine(edit(protocol)).require()
    setup = wire_run(preflight, "p01", answers="simulated", results=tmp_path)
    done = begin(replace(on_paper(setup), console=Repeating(6)))
    assert done.complete
    withdrawn = [event for event in done.events if event["event"] == "withdrawn"]
    assert [len(event["lines"]) for event in withdrawn] == [lines]
    old = [done.events[line - 1] for line in withdrawn[0]["lines"]]
    assert [event["trial"]["index"] for event in old] == [5, 6][:lines]
    assert len(asked(done)) == len(done.trials) + lines
    assert audit_session(Session.find(done.path)).problems == ()


def interrupted(hours_ago: float, *, clock: float = 1000.0, boot: str = "one") -> Session:
    """Return a session of two lines that ended some hours ago."""
    then = datetime.now(UTC) - timedelta(hours=hours_ago)
    start = {"n": 1, "time": then.isoformat(), "clock": clock, "event": "start", "boot": boot}
    return Session(Path("s/session.jsonl"), (start, {**start, "n": 2, "event": "placement"}))


def test_an_interruption_within_the_age_limit_may_continue() -> None:
    """Both clocks give two hours; the limit is three."""
    session = interrupted(2)
    cut = examine_interruption(session, now=datetime.now(UTC), clock=1000.0 + 7200, boot="one")
    assert cut["age_s"] == pytest.approx(7200, abs=1)
    assert cut["clock_set_back_s"] == 0
    refuse_old(session, cut, 3.0)


def test_an_interruption_beyond_the_age_limit_is_refused() -> None:
    """With its age, the limit and the remedy."""
    session = interrupted(30)
    cut = examine_interruption(session, now=datetime.now(UTC), clock=5.0, boot="two")
    with pytest.raises(
        RecordInputError, match=r"30\.0 h ago.*within 24 h \(schedule.resume.within_hours\).*--restart s"
    ):
        refuse_old(session, cut, 24.0)
    refuse_old(session, cut, None)


@pytest.mark.parametrize(
    ("hours_ago", "clock", "boot"),
    [(-5, 10.0, "two"), (2, 1000.0 + 30 * 3600, "one")],
    ids=["earlier than the record itself", "later than the record, behind the monotonic clock"],
)
def test_a_clock_set_back_does_not_defeat_the_age_limit(hours_ago: float, clock: float, boot: str) -> None:
    """By the times in the record, or by the monotonic clock."""
    session = interrupted(hours_ago)
    cut = examine_interruption(session, now=datetime.now(UTC), clock=clock, boot=boot)
    assert cut["clock_set_back_s"] > 3600
    with pytest.raises(RecordInputError, match="clock of this machine is at least"):
        refuse_old(session, cut, 24.0)


def test_a_machine_that_slept_is_not_taken_for_a_clock_set_back() -> None:
    """The monotonic clock stops during sleep; the wall clock is right."""
    session = interrupted(10)
    cut = examine_interruption(session, now=datetime.now(UTC), clock=1000.0 + 60, boot="one")
    assert cut["clock_set_back_s"] == 0
    assert cut["age_s"] == pytest.approx(36000, abs=1)


@pytest.mark.parametrize(
    ("seconds", "hours", "said"),
    [(0, 1, ""), (3599.96, 1, ""), (3600, 1, ""), (3601, 1, "1.0 h ago"), (10801, 3, "3.0 h ago"),
     (3599, 0.5, "60.0 min ago"), (3600, 0.5, "1.0 h ago")],
)  # fmt: skip
def test_the_age_limit_is_exact_to_the_second(seconds: float, hours: float, said: str) -> None:
    """With a given clock; without a known boot only the time of day counts."""
    session = interrupted(0)
    now = datetime.fromisoformat(session.events[-1]["time"]) + timedelta(seconds=seconds)
    cut = examine_interruption(session, now=now, clock=5.0, boot="")
    assert cut["age_s"] == round(seconds, 1)
    if not said:
        refuse_old(session, cut, hours)
        return
    with pytest.raises(
        RecordInputError, match=f"was interrupted {said}, and the protocol allows it to continue within"
    ):
        refuse_old(session, cut, hours)


def test_resuming_at_the_trial_withdraws_no_answer(edit: Edit) -> None:
    """Only the policy `block` repeats answers."""
    schedule = Schedule.draw(with_policy(edit, "{at: trial}").experiment.protocol, "p01", 1)
    assert answers_to_ask_again(interrupted(1), schedule, "trial") == ()


def test_a_session_that_may_not_continue_is_refused_before_the_prompt(
    edit: Edit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When the session is wired, with the log unchanged."""
    preflight = with_policy(edit, "{at: trial, within_hours: 1}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "whole")))
    log = cut_at(whole.path, tmp_path / "cut", whole.trials[4]["n"])
    kept, old = log.read_bytes(), examine_interruption(read_session(log), now=datetime.now(UTC), clock=0, boot="")
    monkeypatch.setattr("modaltouch.session.resumption.examine_interruption", lambda *_, **__: {**old, "age_s": 7200})
    with pytest.raises(RecordInputError, match=r"interrupted 2\.0 h ago.*within 1 h \(schedule.resume.within_hours\)"):
        wire_resume(log)
    assert log.read_bytes() == kept


@pytest.mark.parametrize(("at", "kept"), [("trial", 9), ("block", 6)])
def test_kept_answers_are_counted(edit: Edit, tmp_path: Path, at: str, kept: int) -> None:
    """Of nine answers in blocks of six, three are repeated if the block is restarted."""
    preflight = with_policy(edit, f"{{at: {at}}}")
    whole = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "whole")))
    answers = [event for event in whole.trials if not event["trial"]["practice"]]
    assert [event["trial"]["block"] for event in answers[4:8]] == [1, 1, 2, 2]
    log = cut_at(whole.path, tmp_path / "cut", answers[8]["n"])
    assert wire_resume(log).n_answered == kept
    assert wire_resume(log, restart=True).n_answered == 9


def test_the_record_has_instants_as_intervals(edit: Edit, tmp_path: Path) -> None:
    """First burst and answer of each trial, in their order."""
    preflight = with_policy(edit, "{at: trial}")
    done = begin(on_paper(wire_run(preflight, "p01", answers="simulated", results=tmp_path)))
    for event in done.trials:
        instants, bursts = event["instants"], event["bursts"]
        assert instants["question"] is None
        burst, answer = (instants[name] for name in ("first_burst", "answer"))
        assert burst["earliest_s"] == pytest.approx(bursts["first_s"] - bursts["uncertainty_s"], abs=2e-6)
        assert burst["latest_s"] == pytest.approx(bursts["first_s"] + bursts["uncertainty_s"], abs=2e-6)
        expected = event["confirmed"]["onset"] + event["response"]["reaction_time"]
        assert answer["latest_s"] == pytest.approx(expected, abs=1e-5)
