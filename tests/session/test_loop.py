"""The session loop with a fake rig and a scripted participant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from modaltouch.protocol import Experiment, Findings, Protocol
from modaltouch.protocol.levels import Levels
from modaltouch.protocol.questions import QuestionSection
from modaltouch.protocol.schedule import Schedule
from modaltouch.protocol.trial import Condition, Response, Trial
from modaltouch.record.chain import RecordError
from modaltouch.record.log import SessionLog
from modaltouch.record.session import Session
from modaltouch.rig.interface import Bursts, Firing, RigError, StimulusLost
from modaltouch.session.console import Console, Experimenter, Request
from modaltouch.session.console.status import Status
from modaltouch.session.events import describe_answer, describe_ending, describe_trial, how_to_continue
from modaltouch.session.loop import SessionRun, conduct
from modaltouch.system.clock import VirtualClock
from modaltouch.system.operating_system import Interrupted
from modaltouch.window.interface import (
    Masking,
    MaskingError,
    Presentation,
    SessionStopped,
    TrialInterrupted,
    WindowError,
)

SPEEDS = {"A": 0.12, "B": 0.115, "C": 0.2, "D": 0.115, "E": 0.12}


@dataclass
class PaperRig:
    """Fires nothing and notes its calls."""

    told: list[str] = field(default_factory=list)
    fired: list[dict[str, object]] = field(default_factory=list)
    unstarted: int = 0
    unconfirmed: int = 0
    stalled: int = 0
    breaks: bool = False
    lead: float = 0.0
    firing: Firing | None = None

    def fire(self, velocity: float, *, silent: bool = False, **options: object) -> Firing:
        self.fired.append({"velocity": velocity, "silent": silent, **options})
        self.told.append(f"silent {velocity:g}" if silent else f"fire {velocity:g}")
        started = self.unstarted == 0
        self.unstarted = max(self.unstarted - 1, 0)
        reason = "" if started else "the amplitude reads 5"
        self.firing = Firing((1.0, 1.0), (1.0, 1.0), 0.0, 0.001, started=started, reason=reason)
        return self.firing

    def end(self) -> None:
        self.told.append("end")

    def stop(self, *, at_once: bool = False) -> None:
        self.told.append("cut" if at_once else "stop")
        if self.firing is None:
            return
        if self.breaks:
            self.firing = replace(self.firing, reason="the link broke")
            raise RigError("the outputs could not be confirmed off")
        failed = self.unconfirmed > 0 or self.stalled > 0
        stalled = self.stalled > 0
        self.unconfirmed, self.stalled = max(self.unconfirmed - 1, 0), max(self.stalled - 1, 0)
        reason = "held up" if stalled else "the knob was turned"
        bursts = Bursts(8, 8, 8, 0, 0.0, 0.001)
        self.firing = replace(
            self.firing, confirmed=not failed, stalled=stalled, reason=reason if failed else "", bursts=bursts
        )


@dataclass
class Person:
    """Answers by a rule and notes every screen."""

    rule: Callable[[Trial], str]
    seen: list[str] = field(default_factory=list)
    cut: list[str | Exception] = field(default_factory=list)
    waited: list[float] = field(default_factory=list)

    def welcome(self, trial: Trial) -> None:
        self.seen.append("welcome " + "".join(trial.condition.zones))

    def announce(self, text: str, progress: tuple[int, int] | None = None) -> None:
        self.seen.append(text)

    def place_fingers(self, trial: Trial) -> None:
        self.seen.append("place " + "".join(trial.condition.zones))

    def ask(self, trial: Trial, progress: tuple[int, int], presentation: Presentation) -> Response:
        self.seen.append(f"{'practice' if trial.practice else 'trial'} {trial.index}")
        if self.cut:
            cut = self.cut.pop()
            raise cut if isinstance(cut, Exception) else TrialInterrupted(cut)
        presentation.end()
        return Response(self.rule(trial), 1.0, way="free_hand")

    def confirm(self, response: Response) -> None:
        self.seen.append(response.answer)

    def give_feedback(self, response: Response, expected: str) -> None:
        self.seen.append(f"feedback {response.answer} {expected}")

    def wait(self, seconds: float) -> None:
        self.waited.append(seconds)

    def settle(self, trial: Trial, progress: tuple[int, int], lead: float = 0.0) -> float:
        return 100.0 + lead

    def ask_further(self, name: str, asked: object, trial: Trial | None = None) -> Response:
        self.seen.append(f"further {name}")
        return Response("yes", 1.0, onset="question")

    def show_stall(self) -> None:
        self.seen.append("stall")

    def goodbye(self) -> None:
        self.seen.append("goodbye")


class Keys(Console):
    """A console whose keys are pressed by the test."""

    def __init__(self) -> None:
        self.asked: list[Request] = []

    def requests(self) -> list[Request]:
        asked, self.asked = self.asked, []
        return asked


def right_answer(trial: Trial) -> str:
    """Return the answer of a noiseless participant to SPEEDS."""
    left, right = (SPEEDS[zone] for zone in trial.condition.zones)
    return "both" if left == right else ("left" if left > right else "right")


def wrong_answer(trial: Trial) -> str:
    """Return another answer."""
    return "left" if right_answer(trial) == "both" else "both"


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    """Provide the shipped demonstration."""
    return Findings.read(Path(__file__).resolve().parents[2] / "protocols" / "demo.yaml").experiment()


@pytest.fixture
def sit(experiment: Experiment, tmp_path: Path) -> Iterator[Callable[..., SessionRun]]:
    """Provide session runs whose logs are closed at the end."""
    logs: list[SessionLog] = []

    def make(rule: Callable[[Trial], str] = right_answer, **schedule: Any) -> SessionRun:
        protocol = change(experiment.protocol, **schedule)
        drawn = Schedule.draw(protocol, "p01", 1)
        log = SessionLog.create(tmp_path / f"session{len(logs)}.jsonl", "start")
        logs.append(log)
        return SessionRun(
            protocol=protocol,
            trials=(*drawn.practice, *drawn.trials),
            total=len(drawn.trials),
            levels=Levels(protocol),
            speeds=lambda trial: (SPEEDS[trial.condition.zone_left], SPEEDS[trial.condition.zone_right]),
            rig=PaperRig(),  # type: ignore[arg-type]
            window=Person(rule),  # type: ignore[arg-type]
            log=log,
            save_view=lambda: None,
            tick=lambda: None,
        )

    yield make
    for log in logs:
        log.close()


def change(protocol: Protocol, **schedule: Any) -> Protocol:
    """Return the protocol with another schedule."""
    return protocol.model_copy(update={"schedule": protocol.schedule.model_copy(update=schedule)})


def events(sitting: SessionRun, name: str) -> list[dict[str, Any]]:
    """Return the events of one kind in the log."""
    return [event for event in sitting.log.events if event["event"] == name]


def seen(sitting: SessionRun) -> list[str]:
    """Return the screens that the person saw."""
    return sitting.window.seen  # type: ignore[attr-defined,no-any-return]


def test_every_trial_is_answered_once_in_order(sit: Callable[..., SessionRun]) -> None:
    """One practice trial and twelve main trials, each fired, stopped and recorded."""
    sitting = sit()
    conduct(sitting)
    done = [(event["trial"]["practice"], event["trial"]["index"]) for event in events(sitting, "trial")]
    assert done == [(True, 1), *((False, index) for index in range(1, 13))]
    assert events(sitting, "practice_round") == [], "practice is not judged without a criterion"
    told = sitting.rig.told  # type: ignore[attr-defined]
    fired = [place for place, command in enumerate(told) if command.startswith("fire")]
    assert len(fired) == 13
    assert all(told[place + 1 : place + 3] == ["end", "stop"] for place in fired)
    first = "".join(sitting.trials[0].condition.zones)
    assert seen(sitting)[:2] == [f"welcome {first}", "practice"], "the fingers of the first trial, as they are placed"
    assert seen(sitting)[-1] == "goodbye"


def test_a_stimulus_is_fired_as_the_protocol_has_it(sit: Callable[..., SessionRun]) -> None:
    """Its burst, at the level played, in m/s; as many bursts as there may be, at the instant that the window gave."""
    sitting = sit(practice_trials=0)
    sitting.rig.lead = 0.25  # type: ignore[misc]
    conduct(replace(sitting, which=lambda trial: trial.index, played=lambda _, level: level / 2))
    n_bursts = sitting.protocol.n_bursts("")
    assert sitting.rig.fired == [  # type: ignore[attr-defined]
        {"velocity": pytest.approx(trial.condition.velocity_mm_s * 0.5e-3), "silent": False, "n_bursts": n_bursts,
         "exactly": False, "which": trial.index, "due": 100.25}
        for trial in sitting.trials
    ]  # fmt: skip


def test_a_session_ends_before_a_trial_where_its_ticks_say_so(sit: Callable[..., SessionRun]) -> None:
    """Nothing is placed nor fired any more, whatever the window does."""
    left = [None, None]

    def tick() -> None:
        if not left:
            raise SessionStopped("experimenter")
        left.pop()

    sitting = sit()
    with pytest.raises(SessionStopped, match="experimenter"):
        conduct(replace(sitting, tick=tick))
    assert len(events(sitting, "trial")) == len(events(sitting, "placement")) == 2


def test_the_form_asks_what_is_left_and_each_answer_is_shown(sit: Callable[..., SessionRun]) -> None:
    """Before the thanks; where the experimenter answers, the console is given the keys of each question."""
    sitting, saved, told = sit(), list[int](), list[dict[str, Any]]()
    question = QuestionSection.model_validate({"keys": {"yes": ["a"], "no": ["b"]}})
    answers = sitting.protocol.answers.model_copy(update={"given_by": "experimenter"})
    form = {"dizzy": question, "cold": question}
    protocol = sitting.protocol.model_copy(update={"form": form, "answers": answers})
    sitting.log.append("form", name="dizzy", response=Response("no", 1.0).as_dict())
    experimenter: Any = Mock(take_repeat=lambda: None, ends_after_block=False, tell=told.append)

    def save_view() -> None:
        saved.append(len(events(sitting, "form")))

    conduct(replace(sitting, protocol=protocol, experimenter=experimenter, save_view=save_view))
    assert seen(sitting)[-2:] == ["further cold", "goodbye"]
    answered = [(event["name"], event["response"]["answer"]) for event in events(sitting, "form")]
    assert answered == [("dizzy", "no"), ("cold", "yes")]
    assert saved == [1] * 13 + [2]
    asked = {"event": "question_next", "keys": {"yes": ["a"], "no": ["b"]}, "rates": False}
    assert [event for event in told if event["event"] == "question_next"] == [asked]


@pytest.mark.parametrize(
    ("lead", "busy", "left"), [(0.0, 0.0, 0.9), (0.25, 0.0, 0.65), (0.25, 0.5, 0.15), (1.0, 0.5, 0)]
)
def test_the_pause_counts_what_the_instrument_needs(
    sit: Callable[..., SessionRun], lead: float, busy: float, left: float
) -> None:
    """A pause of 0.9 s less the lead of the generator and the work on the fingers, and never below nothing."""
    sitting = sit()
    answers = sitting.protocol.answers.model_copy(update={"pause_s": 0.9})
    protocol = sitting.protocol.model_copy(update={"answers": answers})
    sitting.rig.lead = lead  # type: ignore[misc]
    probing = Mock(busy=busy, delivered=lambda trial: {"delivered": {"refused": "nothing was measured"}})
    conduct(replace(sitting, protocol=protocol, probing=probing))
    assert sitting.window.waited == pytest.approx([left] * 13)  # type: ignore[attr-defined]
    assert [event["delivered"] for event in events(sitting, "trial")] == [{"refused": "nothing was measured"}] * 13


def test_fingers_are_measured_at_each_placement_and_after_each_break(sit: Callable[..., SessionRun]) -> None:
    """Hands off the beam before they are placed; what is measured is listened to once a stimulus."""
    sitting = sit(break_after_trials=4)
    probing = Mock(busy=0.0, delivered=lambda trial: {})
    conduct(replace(sitting, probing=probing))
    called = [call[0] for call in probing.method_calls]
    n_placed = len(events(sitting, "placement"))
    assert called.count("lift_hands") == called.count("measure") == n_placed
    assert called.count("listen") == 13
    assert called[:3] == ["lift_hands", "measure", "listen"]
    names = [name for name in seen(sitting) if name == "rest" or name.startswith(("trial", "place"))]
    after = [names[place + 1] for place, name in enumerate(names) if name == "rest"]
    assert [name.split()[0] for name in after] == ["place", "place"]


def test_the_last_trial_can_be_repeated_while_the_participant_is_thanked(sit: Callable[..., SessionRun]) -> None:
    """Expected: placed anew, asked again, the first answer withdrawn, thanked again; nothing is asked for in vain."""
    sitting = sit()
    console = Keys()
    experimenter = Experimenter(console)
    sitting.log.listener = experimenter.tell
    thank = sitting.window.goodbye

    def goodbye() -> None:
        thank()
        if seen(sitting).count("goodbye") <= 2:
            console.asked.append(Request("repeat"))
        experimenter.attend()

    sitting.window.goodbye = goodbye  # type: ignore[method-assign]
    conduct(replace(sitting, experimenter=experimenter))
    last = seen(sitting)[seen(sitting).index("goodbye") :]
    answer, place = right_answer(sitting.trials[-1]), "place " + "".join(sitting.trials[-1].condition.zones)
    assert last == ["goodbye", *[place, "trial 12", answer, "goodbye"] * 2]
    assert len(events(sitting, "withdrawn")) == 2
    assert Session(sitting.log.path, tuple(sitting.log.events)).n_answered == 12


def pressing(sitting: SessionRun, *moments: int) -> SessionRun:
    """Return the session run with `repeat` pressed while the answers of these numbers, from 1, are confirmed."""
    console, confirmed = Keys(), list[Response]()
    experimenter = Experimenter(console)
    sitting.log.listener = experimenter.tell
    confirm = sitting.window.confirm

    def press(response: Response) -> None:
        confirmed.append(response)
        confirm(response)
        if len(confirmed) in moments:
            console.asked.append(Request("repeat"))
        experimenter.attend()

    sitting.window.confirm = press  # type: ignore[method-assign]
    return replace(sitting, experimenter=experimenter)


def asked(sitting: SessionRun) -> list[str]:
    """Return the questions asked, in order."""
    return [name for name in seen(sitting) if name.split()[0] in ("practice", "trial") and " " in name]


def test_a_practice_trial_can_be_repeated(sit: Callable[..., SessionRun]) -> None:
    """Asked again immediately, with feedback; the first answer is withdrawn but kept, and the round continues."""
    sitting = pressing(sit(practice_trials=3, practice_feedback=True), 2)
    conduct(sitting)
    names = asked(sitting)
    assert names[:4] == ["practice 1", "practice 2", "practice 2", "practice 3"]
    shown = [name for name in seen(sitting) if name.startswith("feedback")]
    assert len(shown) == sum(name.startswith("practice") for name in names)
    (withdrawn,) = events(sitting, "withdrawn")
    kept = [event for event in events(sitting, "trial") if event["trial"]["practice"] and event["trial"]["index"] == 2]
    assert len(kept) == 2
    assert withdrawn["lines"] == [kept[0]["n"]]
    session = Session(sitting.log.path, tuple(sitting.log.events))
    assert {kept[0]["n"], kept[1]["n"]} & {event["n"] for event in session.trials} == {kept[1]["n"]}
    assert session.n_answered == 12


def test_a_round_is_judged_by_the_repeated_answer(sit: Callable[..., SessionRun]) -> None:
    """The last trial of a round is answered wrongly and repeated: the round is passed by the second answer."""
    given: list[Trial] = []

    def rule(trial: Trial) -> str:
        first = trial.practice and trial.index == 3 and trial not in given
        given.append(trial)
        return wrong_answer(trial) if first else right_answer(trial)

    sitting = pressing(sit(rule, practice_trials=3, practice_criterion=1.0), 3)
    conduct(sitting)
    assert asked(sitting)[:5] == ["practice 1", "practice 2", "practice 3", "practice 3", "trial 1"]
    (judged,) = events(sitting, "practice_round")
    assert judged["passed"]
    assert judged["n_agreed"] == judged["n_judged"]


def test_practice_is_judged_by_confirmed_stimuli_only(sit: Callable[..., SessionRun]) -> None:
    """Killed after the answer, before the end of its stimulus was confirmed: the trial is presented again."""

    def end(response: Response) -> None:
        raise SessionStopped("killed")

    sitting = sit(practice_trials=1, practice_criterion=1.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sitting.window, "confirm", end)
        with pytest.raises(SessionStopped, match="killed"):
            conduct(sitting)
    assert [event["trial"]["practice"] for event in events(sitting, "answered")] == [True]
    conduct(sitting)
    assert asked(sitting)[:3] == ["practice 1", "practice 1", "trial 1"]


def test_finished_practice_is_not_repeated() -> None:
    """R between practice and the first main trial has no effect, and the console says so."""
    console, status = Keys(), Status()
    experimenter = Experimenter(console, status=status)
    practice = {"event": "trial", "n": 5, "clock": 1.0, "trial": {"practice": True, "index": 3},
                "response": {"answer": "left", "reaction_time": 1.0}, "confirmed": {"confirmed": True}}  # fmt: skip
    experimenter.tell(practice)
    console.asked.append(Request("repeat"))
    experimenter.attend()
    assert (status.facts()["repeats_trial"], status.facts()["repeats_practice"]) == (3, True)
    experimenter.tell({"event": "trial_next", "trial": {"practice": False}})
    assert experimenter.take_repeat() is None
    assert status.facts()["nothing_to_repeat"]
    assert status.facts()["repeats_trial"] is None
    experimenter.tell(practice)
    experimenter.tell({"event": "practice_round"})
    console.asked.append(Request("repeat"))
    experimenter.attend()
    assert experimenter.take_repeat() is None, "a judged round stays as it was judged"


def test_fingers_are_placed_again_only_if_they_change(sit: Callable[..., SessionRun]) -> None:
    """Before each trial whose pair or finger condition differs from that of the trial before."""
    sitting = sit()
    conduct(sitting)
    trials = [event["trial"]["condition"] for event in events(sitting, "trial")]
    places = [(c["finger_condition"], c["zone_left"], c["zone_right"]) for c in trials]
    changes = 1 + sum(one != other for one, other in zip(places, places[1:], strict=False))
    assert len(events(sitting, "placement")) == changes
    first = events(sitting, "placement")[0]
    assert {"finger_left", "finger_right", "zone_left", "zone_right", "placement", "way"} <= set(first)


def test_an_answer_is_confirmed_only_after_it_is_written(sit: Callable[..., SessionRun]) -> None:
    """When the window confirms, the log's last line is the answer; the stimulus is not over yet."""
    sitting = sit()
    confirm = sitting.window.confirm
    last: list[str] = []

    def note(response: Response) -> None:
        last.append(sitting.log.events[-1]["event"])
        assert not sitting.log.events[-1]["confirmed"]["confirmed"]
        confirm(response)

    sitting.window.confirm = note  # type: ignore[method-assign]
    conduct(sitting)
    assert set(last) == {"answered"}
    answered = {event["n"]: event for event in events(sitting, "answered")}
    for event in events(sitting, "trial"):
        assert event["response"] == answered[event["answered"]]["response"]
        assert event["confirmed"]["confirmed"]
        assert event["bursts"]["whole"] == 8


def test_an_interrupted_trial_is_repeated(sit: Callable[..., SessionRun]) -> None:
    """The same trial is fired twice, with the interruption in the log and one answer."""
    sitting = sit()
    sitting.window.cut.append("escape")  # type: ignore[attr-defined]
    conduct(sitting)
    assert [name for name in seen(sitting) if name == "practice 1"] == ["practice 1"] * 2
    assert [event["reason"] for event in events(sitting, "trial_cut")] == ["escape"]
    assert len(events(sitting, "trial")) == 13


def test_a_stimulus_that_does_not_start_is_tried_again(sit: Callable[..., SessionRun]) -> None:
    """No question is asked before it has started; after three attempts RigError."""
    sitting = sit()
    sitting.rig.unstarted = 1  # type: ignore[attr-defined]
    conduct(sitting)
    assert len(events(sitting, "unconfirmed")) == 1
    sitting = sit()
    sitting.rig.unstarted = 3  # type: ignore[attr-defined]
    with pytest.raises(RigError, match=r"3 presentations could not be confirmed .the amplitude reads 5.; the outputs"):
        conduct(sitting)
    assert "practice 1" not in seen(sitting)


def test_an_answer_to_an_unconfirmed_stimulus_is_kept_and_the_trial_repeated(
    sit: Callable[..., SessionRun],
) -> None:
    """The second answer supersedes the first; three unconfirmed ones in a row end the session."""
    sitting = sit()
    sitting.rig.unconfirmed = 1  # type: ignore[attr-defined]
    conduct(sitting)
    first, second = events(sitting, "trial")[:2]
    assert (first["confirmed"]["confirmed"], second["confirmed"]["confirmed"]) == (False, True)
    assert second["supersedes"] == first["n"]
    assert (first["presentation"], second["presentation"]) == (1, 2)
    sitting = sit()
    sitting.rig.unconfirmed = 3  # type: ignore[attr-defined]
    with pytest.raises(RigError, match=r"the knob was turned.*the answers are kept as unconfirmed"):
        conduct(sitting)


def test_stalls_use_up_no_attempt(sit: Callable[..., SessionRun]) -> None:
    """After ten stalls in a row, each shown to the participant, the session continues."""
    sitting = sit()
    sitting.rig.stalled = 10  # type: ignore[attr-defined]
    conduct(sitting)
    assert seen(sitting).count("stall") == 10
    assert Session(sitting.log.path, tuple(sitting.log.events)).n_answered == 12


def test_permanent_stalls_end_the_session(sit: Callable[..., SessionRun]) -> None:
    """After 30 presentations of a trial, without blaming the instrument."""
    sitting = sit()
    sitting.rig.stalled = 30  # type: ignore[attr-defined]
    with pytest.raises(RigError, match=r"30 presentations could not be confirmed .held up.*close other programs$"):
        conduct(sitting)
    sitting = sit()
    sitting.rig.stalled = 29  # type: ignore[attr-defined]
    conduct(sitting)


def test_a_lost_stimulus_is_not_answered(sit: Callable[..., SessionRun]) -> None:
    """If the link is lost, the trial is recorded as interrupted and repeated."""
    sitting = sit()
    sitting.window.cut.append(StimulusLost("the bursts ended"))  # type: ignore[attr-defined]
    conduct(sitting)
    (cut,) = events(sitting, "trial_cut")
    assert cut["reason"] == "the bursts ended"
    assert len(events(sitting, "trial")) == 13
    sitting = sit()
    sitting.window.cut.extend([StimulusLost("the bursts ended")] * 3)  # type: ignore[attr-defined]
    with pytest.raises(RigError, match=r"3 presentations could not be confirmed \(the bursts ended\)"):
        conduct(sitting)


def test_an_instrument_that_dies_in_a_stimulus_confirms_nothing(sit: Callable[..., SessionRun]) -> None:
    """The outputs cannot be switched off: the answer is recorded as unconfirmed, and the session ends."""
    sitting = sit()
    sitting.rig.breaks = True  # type: ignore[attr-defined]
    with pytest.raises(RigError, match="could not be confirmed off"):
        conduct(sitting)
    (trial,) = events(sitting, "trial")
    assert not trial["confirmed"]["confirmed"]
    assert trial["confirmed"]["reason"] == "the link broke"


def test_an_emergency_stop_interrupts_the_burst(sit: Callable[..., SessionRun]) -> None:
    """Outputs off immediately, and a line with the bursts played until then."""
    sitting = sit()
    sitting.window.cut.append(SessionStopped("emergency stop"))  # type: ignore[attr-defined]
    with pytest.raises(SessionStopped, match="emergency stop"):
        conduct(sitting)
    assert sitting.rig.told[-1] == "cut"  # type: ignore[attr-defined]
    (cut,) = events(sitting, "trial_cut")
    assert cut["reason"] == "emergency stop"
    assert cut["bursts"]["played"] == 8


@pytest.mark.parametrize(("rule", "passed"), [(right_answer, True), (wrong_answer, False)])
def test_practice_is_judged_by_its_criterion(
    sit: Callable[..., SessionRun],
    rule: Callable[[Trial], str],
    passed: bool,
) -> None:
    """One round if it is passed, else all rounds; then the session continues."""
    sitting = sit(rule, practice_trials=3, practice_criterion=0.6, practice_rounds=2)
    conduct(sitting)
    rounds = events(sitting, "practice_round")
    assert [event["passed"] for event in rounds] == ([True] if passed else [False, False])
    assert seen(sitting).count("practice_again") == (0 if passed else 1)
    n_practised = sum(event["trial"]["practice"] for event in events(sitting, "trial"))
    assert n_practised == (3 if passed else 6)
    assert sum(not event["trial"]["practice"] for event in events(sitting, "trial")) == 12


def test_failed_practice_may_end_the_session(sit: Callable[..., SessionRun]) -> None:
    """SessionStopped after the last screen, without a main trial; the same after resuming."""
    sitting = sit(wrong_answer, practice_trials=2, practice_criterion=1.0, after_failed_practice="stop")
    with pytest.raises(SessionStopped, match="practice not passed"):
        conduct(sitting)
    assert seen(sitting)[-1] == "goodbye"
    assert not any(not event["trial"]["practice"] for event in events(sitting, "trial"))
    resumed = replace(sitting, trials=tuple(trial for trial in sitting.trials if not trial.practice))
    with pytest.raises(SessionStopped, match="practice not passed"):
        conduct(resumed)


def test_a_round_answered_before_a_kill_is_judged_after_it(sit: Callable[..., SessionRun]) -> None:
    """Killed between the last practice answer and its verdict, the session gives the verdict first."""
    sitting = sit(practice_trials=2, practice_criterion=1.0, practice_rounds=3)
    conduct(sitting)
    trials = [event for event in events(sitting, "trial") if event["trial"]["practice"]]
    killed = sit(practice_trials=2, practice_criterion=1.0, practice_rounds=3)
    for event in trials:
        killed.log.append("trial", **{name: event[name] for name in ("trial", "planned", "response", "confirmed")})
    conduct(replace(killed, trials=tuple(t for t in killed.trials if not t.practice or t.index > 2)))
    assert [event["passed"] for event in events(killed, "practice_round")] == [True]
    assert not any(name.startswith("practice") for name in seen(killed))


def test_feedback_follows_only_practice_trials(sit: Callable[..., SessionRun]) -> None:
    """After each of three practice trials the predicted answer, and never after a main trial."""
    sitting = sit(wrong_answer, practice_trials=3, practice_feedback=True)
    conduct(sitting)
    given = [name for name in seen(sitting) if name.startswith("feedback")]
    assert len(given) == 3
    assert all(name.split()[1] != name.split()[2] for name in given)
    assert seen(sitting).index("start") > max(seen(sitting).index(name) for name in given)


def test_breaks_come_by_count(sit: Callable[..., SessionRun]) -> None:
    """After every four of twelve trials, but not after the last."""
    sitting = sit(break_after_trials=4)
    conduct(sitting)
    names = [name for name in seen(sitting) if name == "rest" or name.startswith("trial")]
    assert [place for place, name in enumerate(names) if name == "rest"] == [4, 9]


def test_breaks_come_by_time(sit: Callable[..., SessionRun]) -> None:
    """At the first trial after five minutes; with 70 s per answer, after every fifth of twelve."""
    clock = VirtualClock()

    def slowly(trial: Trial) -> str:
        clock.sleep(70.0)
        return right_answer(trial)

    sitting = replace(sit(slowly, break_after_trials=None, break_after_min=5.0, practice_trials=0), clock=clock)
    conduct(sitting)
    names = [name for name in seen(sitting) if name == "rest" or name.startswith("trial")]
    assert [place for place, name in enumerate(names) if name == "rest"] == [5, 11]


def test_no_breaks_by_default_settings_of_null(sit: Callable[..., SessionRun]) -> None:
    """If both kinds of break are null."""
    sitting = sit(break_after_trials=None, break_after_min=None)
    conduct(sitting)
    assert "rest" not in seen(sitting)


def test_a_catch_trial_is_asked_like_any_other_and_drives_nothing(sit: Callable[..., SessionRun]) -> None:
    """Fired silently at the lowest level, 80 mm/s; the same screens; recorded as catch with speeds of 0."""
    sitting = sit(lambda trial: "none" if trial.condition.is_catch else right_answer(trial), catch_trials=2)
    conduct(sitting)
    told = sitting.rig.told  # type: ignore[attr-defined]
    assert [each for each in told if each.startswith("silent")] == ["silent 0.08"] * 4
    caught = [event for event in events(sitting, "trial") if event.get("catch")]
    assert [event["response"]["answer"] for event in caught] == ["none"] * 4
    assert [event["trial"]["condition"]["velocity_mm_s"] for event in caught] == [0.0] * 4
    assert [event["instants"]["first_burst"] for event in caught] == [None] * 4
    asked = [name for name in seen(sitting) if name.startswith("trial ")]
    assert asked == [f"trial {index}" for index in range(1, 17)]
    assert not any(
        "catch" in event for event in events(sitting, "trial") if event["trial"]["condition"]["velocity_mm_s"]
    )


class FragileNoise(Masking):
    """Masking that is lost during the third trial and, if required, cannot be restored."""

    def __init__(self, *, required: bool) -> None:
        super().__init__("stands in")
        object.__setattr__(self, "n_ensured", 0)
        object.__setattr__(self, "required", required)

    def ensure(self, tick: Callable[[], object], *, on: bool = True) -> None:
        object.__setattr__(self, "n_ensured", self.n_ensured + 1)  # type: ignore[attr-defined]
        if self.n_ensured > 3 and self.required:  # type: ignore[attr-defined]
            raise MaskingError("no sound device")

    @property
    def is_on(self) -> bool | None:
        return bool(self.n_ensured < 3)  # type: ignore[attr-defined]


def test_each_trial_records_whether_it_was_masked(sit: Callable[..., SessionRun]) -> None:
    """Two masked trials, then none; without `required`, all trials are answered."""
    sitting = replace(sit(), masking=FragileNoise(required=False))
    conduct(sitting)
    masked = [event["masked"] for event in events(sitting, "trial")]
    assert masked == [True, True, *([False] * 11)]


def test_a_lost_required_noise_ends_the_session(sit: Callable[..., SessionRun]) -> None:
    """The third answer is recorded as not masked, and nothing is fired after it."""
    sitting = replace(sit(), masking=FragileNoise(required=True))
    with pytest.raises(MaskingError, match="no sound device"):
        conduct(sitting)
    assert [event["masked"] for event in events(sitting, "trial")] == [True, True, False]
    assert sum(told.startswith("fire") for told in sitting.rig.told) == 3  # type: ignore[attr-defined]


def test_without_masking_trials_have_no_such_key(sit: Callable[..., SessionRun]) -> None:
    """In no trial of the log."""
    sitting = sit()
    conduct(sitting)
    assert not any("masked" in event for event in events(sitting, "trial"))


def test_the_experimenter_is_told_of_each_trial_before_it_begins(experiment: Experiment) -> None:
    """What is presented where, and how fast it is predicted to be under each finger; stimulus and interval if any."""
    trial = Trial(3, 1, Condition("one_hand", "A", "C", 80.0))
    told = describe_trial(experiment.protocol, (0.04128, 0.08), trial)
    assert told == {
        "number": 3, "practice": False, "block": 1, "velocity_mm_s": 80.0, "predicted_left_mm_s": 41.3,
        "predicted_right_mm_s": 80.0, "finger_condition": "one_hand", "placement": "normal", "way": "free_hand",
        "zone_left": "A", "zone_right": "C", "finger_left": "right index", "finger_right": "right middle",
    }  # fmt: skip
    named = replace(trial, interval=2, condition=replace(trial.condition, stimulus="sharp"))
    assert (
        describe_trial(experiment.protocol, (0.0, 0.0), named).items() >= {"stimulus": "sharp", "interval": 2}.items()
    )


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (SessionStopped("escape"), {"reason": "escape"}),
        (Interrupted("SIGTERM"), {"reason": "SIGTERM"}),
        (WindowError("gone"), {"reason": "window lost", "message": "WindowError: gone"}),
        (RigError("no answer"), {"reason": "rig fault", "message": "RigError: no answer"}),
        (RecordError("disk full"), {"reason": "record fault", "message": "RecordError: disk full"}),
        (ValueError("2"), {"reason": "error", "message": "ValueError: 2"}),
    ],
)
def test_the_stop_record_says_why_a_session_ended(error: BaseException, said: dict[str, str]) -> None:
    """Whoever reads it later has nothing else to go by."""
    assert describe_ending(error) == said


def test_what_to_do_after_an_early_end_depends_on_its_reason(tmp_path: Path) -> None:
    """Failed practice is begun anew; all else goes on where it was."""
    assert how_to_continue("practice not passed", tmp_path) == (
        f"`modaltouch resume --restart {tmp_path}` starts it over, including practice"
    )
    assert how_to_continue("rig fault", tmp_path) == f"continue with `modaltouch resume {tmp_path}`"


@pytest.mark.parametrize(("repetition", "is_dated"), [("single", True), ("timer", True), ("wired", False)])
def test_instants_are_as_sure_as_what_was_timed(experiment: Experiment, repetition: Any, is_dated: bool) -> None:
    """A press is read after it happened, a frame shown before its flip returned; pulses of others date no burst."""
    trial = Trial(3, 1, Condition("one_hand", "A", "C", 80.0))
    bursts = Bursts(8, 8, 8, 0, 10.0, 0.001)
    firing = Firing((1.0, 1.0), (1.0, 1.0), 10.0, 0.001, started=True, repetition=repetition, bursts=bursts)
    response = Response("left", 1.0, question_after=0.3, question_uncertainty=0.02, time_uncertainty=0.004)
    told = describe_answer(
        experiment.protocol, lambda trial: (0.1, 0.2), trial, response, [firing], masked=None, events=[]
    )
    assert told["instants"] == {
        "first_burst": {"earliest_s": 9.999, "latest_s": 10.001} if is_dated else None,
        "question": {"earliest_s": 10.28, "latest_s": 10.3},
        "answer": {"earliest_s": 10.996, "latest_s": 11.0},
    }
    asked = replace(response, onset="question")
    told = describe_answer(
        experiment.protocol, lambda trial: (0.1, 0.2), trial, asked, [firing], masked=None, events=[]
    )
    assert told["instants"]["answer"] == {"earliest_s": 11.296, "latest_s": 11.3}, "from the question on"
