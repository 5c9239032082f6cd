"""The audit detects a forged log even when every checksum has been recomputed.

Each test forges one value in a copy of a sound session and makes the checksums and the BIDS view consistent with it;
the audit must report the value with its line.
"""

from __future__ import annotations

import copy
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modaltouch import examine
from modaltouch.analysis.pipeline import read_responses
from modaltouch.protocol import InputError, Schedule, Sources
from modaltouch.protocol.findings import Findings
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, RecordError, encode_line, read_chain
from modaltouch.record.folders import SessionFolder
from modaltouch.record.log import SessionLog
from modaltouch.record.session import Session
from modaltouch.record.view import write_view
from modaltouch.session.resumption import wire_resume
from modaltouch.session.wiring import simulate_session
from modaltouch.stimulus import Stimulus

Events = list[dict[str, Any]]
Lie = Callable[[Events], object]

PROTOCOLS = Path(__file__).parents[2] / "protocols"
FORMAT_1 = Path(__file__).parent / "format_1"
REAL = "TEKTRONIX,AFG3022B,C012345,SCPI:99.0 FV:3.2.1"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results with sessions of the current log format and of the previous one."""
    now = tmp_path_factory.mktemp("now")
    for name in ("demo", "with_catch_trials"):
        simulate_session(PROTOCOLS / f"{name}.yaml", "sim01", now)
    return {"2": now, "1": FORMAT_1}


@pytest.fixture
def copied(recorded: dict[str, Path], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that copies a session and returns the copy's log."""

    def copy_of(protocol: str = "demo", schema: str = "2") -> Path:
        shutil.copytree(recorded[schema] / "simulated" / protocol, tmp_path / "simulated" / protocol)
        (log,) = (tmp_path / "simulated" / protocol).rglob("session.jsonl")
        return log

    return copy_of


def rewritten(log: Path, events: Events) -> Session:
    """Write the lines of a log with checks that fit, and return the session."""
    check, lines = GENESIS, []
    for event in events:
        line, check = encode_line(event, check)
        lines.append(line)
    log.write_bytes(b"".join(lines))
    return Session.find(log)


def forge(log: Path, lie: Lie) -> None:
    """Tell a lie in a log, and make its checks and its view fit."""
    events: Events = [copy.deepcopy(event) for event in read_chain(log).events]
    place = SessionFolder.of(log, "simulated", events[0]["protocol"])
    lie(events)
    written = rewritten(log, events)
    write_view(place, Session(log, tuple(events)), {"lines": len(events), "check": written.chain.last_check})


def of(events: Events, *kinds: str) -> Events:
    """Return the lines of the given kinds."""
    return [event for event in events if event["event"] in kinds]


def last(events: Events, kind: str = "trial") -> dict[str, Any]:
    """Return the last line of a kind."""
    return of(events, kind)[-1]


def everywhere(change: Callable[[dict[str, Any]], None], *kinds: str) -> Lie:
    """Return the forgery that changes the last presentation in each of its lines."""

    def lie(events: Events) -> None:
        told = last(events)["trial"]
        for event in of(events, *(kinds or ("answered", "trial"))):
            if event["trial"] == told:
                change(event)

    return lie


def rewrite_levels(events: Events) -> None:
    """Halve the recorded level of every trial, with its speeds and amplitudes."""
    for event in of(events, "fired", "answered", "trial"):
        event["trial"]["condition"]["velocity_mm_s"] /= 2
        for name in event.get("planned", {}):
            event["planned"][name] /= 2
        for said in (event["confirmed"], event.get("commanded", {})):
            for name in {"commanded_amplitude", "confirmed_amplitude", "amplitude_Vpp"} & said.keys():
                said[name] = [round(each / 2, 4) for each in said[name]]


def rewrite_levels_and_order(events: Events) -> None:
    """Halve the recorded levels in the order as well."""
    rewrite_levels(events)
    for name in ("order", "practice"):
        for brief in events[0]["schedule"][name]:
            brief[4] /= 2


def rewrite_protocol(events: Events) -> None:
    """Change a level of the protocol consistently: in its text, hash, design, drawn order and every line."""
    start = events[0]
    source = start["sources"]["protocol"]
    source["text"] = re.sub(r"peak_velocities_mm_s: \[80,", "peak_velocities_mm_s: [90,", source["text"])
    sources = Sources.from_dict(start["sources"])
    source["sha256"] = sources.protocol.sha256
    protocol = Findings.restored(sources).experiment().protocol
    start["design"] = protocol.model_dump(mode="json")
    start["schedule"] = Schedule.draw_again(protocol, start, Session(Path(), tuple(events)).drawn_as).as_dict()
    for event in of(events, "fired", "answered", "trial"):
        condition = event["trial"]["condition"]
        condition["velocity_mm_s"] = 90.0 if condition["velocity_mm_s"] == 80 else condition["velocity_mm_s"]
        if "planned" in event and event["planned"]["velocity_mm_s"] == 80:
            event["planned"] = {name: round(value * 90 / 80, 3) for name, value in event["planned"].items()}


def swap(events: Events) -> None:
    """Exchange the conditions of the last two presentations."""
    one, other = (event["trial"] for event in of(events, "trial")[-2:])
    one, other = copy.deepcopy(one), copy.deepcopy(other)
    for event in of(events, "fired", "answered", "trial"):
        if event["trial"] in (one, other):
            event["trial"] = copy.deepcopy(other if event["trial"] == one else one)


def leave_out(*kinds: str) -> Lie:
    """Return the forgery that removes the lines of the first scheduled trial and renumbers the rest."""

    def lie(events: Events) -> None:
        told = next(event["trial"] for event in of(events, "trial") if not event["trial"]["practice"])
        events[:] = [event for event in events if event["event"] not in kinds or event["trial"] != told]
        numbers = {event["n"]: number for number, event in enumerate(events, 1)}
        for number, event in enumerate(events, 1):
            event["n"] = number
            if event.get("answered") in numbers:
                event["answered"] = numbers[event["answered"]]

    return lie


def change_start(**facts: Any) -> Lie:
    """Return the forgery that changes values of the start record."""

    def lie(events: Events) -> None:
        for name, value in facts.items():
            section, _, key = name.partition("__")
            if key:
                events[0][section][key] = value
            else:
                events[0][section] = value

    return lie


def set_in(section: str, **facts: Any) -> Callable[[dict[str, Any]], None]:
    """Return a function that changes members of a section of a line."""
    return lambda event: event[section].update(facts)


def shift(section: str, name: str, by: float) -> Callable[[dict[str, Any]], None]:
    """Return a function that shifts a number of a line."""
    return lambda event: event[section].update({name: event[section][name] + by})


def shift_answer(event: dict[str, Any], by: float = -30.0) -> None:
    """Record an answer as earlier."""
    event["instants"]["answer"] = {name: value + by for name, value in event["instants"]["answer"].items()}


def shift_first(event: dict[str, Any]) -> None:
    """Record the first burst 50 ms later everywhere except in the reaction time."""
    event["instants"]["first_burst"] = {k: v + 0.05 for k, v in event["instants"]["first_burst"].items()}
    event["confirmed"]["onset"] += 0.05
    if event["bursts"]["first_s"] is not None:
        event["bursts"]["first_s"] += 0.05


def forge_field(change: Callable[[dict[str, Any]], object]) -> Lie:
    """Return the forgery of the predicted field that reports show."""
    return lambda events: [change(field) for field in events[0]["stimulus"]["fields"]]


def count(**counts: int) -> Callable[[dict[str, Any]], None]:
    """Return a function that adds to the burst counts."""
    return lambda event: event["bursts"].update({name: event["bursts"][name] + n for name, n in counts.items()})


def to_line(event: dict[str, Any], **facts: Any) -> None:
    """Change members of a line."""
    event.update(facts)


def insert(event: str, of_trial: dict[str, Any] | None = None, **facts: Any) -> Lie:
    """Return the lie of a line more, before the end of the session; its trial is the last one but for what is given."""

    def lie(events: Events) -> None:
        stop = events.index(last(events, "stop"))
        clock = {"time": events[stop]["time"], "clock": events[stop]["clock"]}
        trial = {} if of_trial is None else {"trial": {**last(events)["trial"], **of_trial}}
        events.insert(stop, {"n": stop + 1, **clock, "event": event, **trial, **facts})
        for number, each in enumerate(events[stop + 1 :], stop + 2):
            each["n"] = number

    return lie


def withdraw(events: Events) -> None:
    """Say that the last answer was withdrawn, and leave the number of answers at the end as it was."""
    insert("withdrawn", lines=[last(events)["n"]], reason="the experimenter has the trial repeated")(events)


IN_BOTH: dict[str, tuple[Lie, str]] = {
    "every level": (rewrite_levels, "has the velocity_mm_s"),
    "every level and the order": (rewrite_levels_and_order, "draws a different order"),
    "the protocol": (rewrite_protocol, "90 mm/s needs"),
    "one level": (
        everywhere(lambda e: e["trial"]["condition"].update(velocity_mm_s=81.0), "trial"),
        "velocity_mm_s 81",
    ),
    "two trials exchanged": (swap, "was presented out of order"),
    "a trial left out": (leave_out("fired", "answered", "trial"), "was presented out of order"),
    "a stimulus left out": (leave_out("fired"), "was answered but not presented"),
    "a trial of nobody": (everywhere(lambda e: e["trial"].update(index=99), "trial"), "is not one of the"),
    "a planned level": (everywhere(set_in("planned", velocity_mm_s=100.5)), "was planned at 100.5 mm/s"),
    "a speed": (everywhere(shift("planned", "speed_left_mm_s", 1)), "at the fingers, not"),
    "a commanded amplitude": (everywhere(set_in("commanded", amplitude_Vpp=[1.0, 1.0])), "1, 1 Vpp were commanded"),
    "a read-back": (
        everywhere(set_in("confirmed", confirmed_amplitude=[1.0, 1.0]), "trial"),
        "1, 1 Vpp were read back",
    ),
    "fingers": (everywhere(lambda e: e["fingers"].reverse()), "was felt with"),
    "a catch trial": (everywhere(lambda e: to_line(e, catch=True)), "it is not a catch trial"),
    "a word": (everywhere(set_in("response", answer="upwards")), "was answered 'upwards'; allowed:"),
    "a reaction time": (everywhere(set_in("response", reaction_time=-1.0)), "has a reaction time of -1.0 s"),
    "a presentation": (everywhere(lambda e: to_line(e, presentation=2)), "is called presentation 2"),
    "a replaced answer": (everywhere(lambda e: to_line(e, supersedes=5)), "replaces the answer on line 5"),
    "a withdrawn line": (lambda events: events[4].update(event="withdrawn", lines=[3]), "withdraws line 3"),
    "a line number": (lambda events: to_line(events[9], n=11), "is numbered 11"),
    "the clock": (lambda events: to_line(events[9], clock=events[8]["clock"] - 1), "its clock says"),
    "the time": (lambda events: to_line(events[9], time="2026-11-22T05:00:00"), "names no zone"),
    "an end": (
        lambda events: to_line(last(events, "stop"), n_answered=11),
        "says that 11 trials are answered, but 12 are",
    ),
    "a completion": (
        lambda events: to_line(last(events, "stop"), complete=False),
        "says complete: false, which does not follow from trials and form",
    ),
    "an answer that was withdrawn": (withdraw, "says that 12 trials are answered, but 11 are"),
    "a cut of nobody": (insert("trial_cut", {"index": 99}), "trial 99 is not one of the 12 trials of its order"),
    "a cut of practice": (
        insert("trial_cut", {"index": 99, "practice": True}),
        ": practice trial 99 is not one of the 12 trials of its order, or of the 1 of practice",
    ),
    "what was not confirmed": (insert("unconfirmed", {"repetition": 7}), "has the repetition 7, but its order has 1"),
    "a practice round": (
        insert("practice_round", round=1, n_judged=7, n_agreed=7, passed=True),
        "of 1 answers agreed, but the record says otherwise",
    ),
    "the seed": (change_start(seed=2), "seed 2 draws a different order"),
    "the codes": (change_start(stimulus__content_hash="0" * 64), "the recomputed drive has the hash"),
    "a speed at a zone": (
        lambda events: events[0]["stimulus"]["stimuli"][0]["zone_peak_mm_s"].update(A=1.0),
        "its speeds at the zones at 80 mm/s are not those recomputed",
    ),
    "the design": (
        change_start(design__stimulus={"focus": "A"}),
        "its design differs from its protocol file in stimulus",
    ),
    "the protocol's name": (change_start(protocol="other"), "is a session of 'other'"),
    "the mode": (change_start(mode="real"), "is called a real session, but its rig or its answers were simulated"),
    "a text": (change_start(sources__texts={"path": "t", "text": "", "sha256": "0" * 64}), "its files are not valid"),
}
"""Lies that are found in a log of either format, and the words that find them."""

IN_FORMAT_2: dict[str, tuple[Lie, str]] = {
    "a burst more than whole": (everywhere(count(whole=1), "trial"), "is confirmed with"),
    "a burst that was cut": (everywhere(count(whole=-1), "trial"), "is confirmed with"),
    "bursts that nobody waited for": (
        everywhere(count(asked=20, played=20, whole=20), "trial"), "were due by its answer"),
    "bursts left out": (everywhere(count(asked=-3, played=-3, whole=-3), "trial"), "were due by its answer"),
    "a number that is none": (everywhere(set_in("bursts", asked=-1), "trial"), "though its bursts are not all counted"),
    "uncounted bursts": (everywhere(set_in("bursts", whole=None), "trial"), "though its bursts are not all counted"),
    "the first burst": (everywhere(shift("bursts", "first_s", 0.01), "trial"), "its first burst came at"),
    "the first burst, everywhere": (everywhere(shift_first), "but its instants give"),
    "how sure it is": (everywhere(shift("bursts", "uncertainty_s", -0.0009), "trial"), "its first burst came at"),
    "an answer before its stimulus": (everywhere(shift_answer), "its answer came before its first burst"),
    "an answer after its line": (everywhere(lambda e: shift_answer(e, 30.0)), "after its line was written"),
    "a quicker answer": (everywhere(set_in("response", reaction_time=0.2)), "has a reaction time of 0.2 s"),
    "an interval": (
        everywhere(lambda e: e["instants"]["answer"].update(earliest_s=e["clock"] + 1)), "its answer came between"),
    "another answer": (everywhere(set_in("response", answer="upwards"), "trial"), "where it was answered, in response"),
    "an answer of nobody": (everywhere(lambda e: to_line(e, answered=3), "trial"), "finishes the answer on line 3"),
    "confirmed too soon": (
        everywhere(set_in("confirmed", confirmed=True), "answered"), "is confirmed before its end"),
    "a point of the field": (
        forge_field(lambda field: field["predicted_mm_s"].__setitem__(9, 1.0)), "its field is not"),
    "half a field": (forge_field(lambda field: field["target_mm_s"].pop()), "its field is not"),
    "a field without zones": (forge_field(lambda field: field.pop("zones_mm")), "its field is not"),
    "a focus": (forge_field(lambda field: field.update(focus="A")), "its field is not the one recomputed"),
    "what repeats": (everywhere(set_in("confirmed", repetition="timer"), "trial"), "were repeated as 'timer'"),
}  # fmt: skip
"""Lies about what only format 2 tells."""


@pytest.mark.parametrize("schema", ["1", "2"])
@pytest.mark.parametrize("name", IN_BOTH)
def test_a_forged_log_is_detected(copied: Callable[..., Path], name: str, schema: str) -> None:
    """The message of the check that detects the forgery gives the file and the line."""
    lie, words = IN_BOTH[name]
    log = copied(schema=schema)
    forge(log, lie)
    found = [problem for problem in audit_session(Session.find(log)).problems if words in problem]
    assert found, audit_session(Session.find(log)).problems
    assert re.match(rf"{re.escape(str(log))}:\d+: ", found[0])


def test_every_line_of_a_trial_of_nobody_is_named(copied: Callable[..., Path]) -> None:
    """That it was fired, that it was answered, and its end."""
    log = copied()
    forge(log, everywhere(lambda e: e["trial"].update(index=99), "fired", "answered", "trial"))
    problems = audit_session(Session.find(log)).problems
    assert sum("trial 99 is not one of the 12 trials of its order" in problem for problem in problems) == 3


@pytest.mark.parametrize("name", IN_FORMAT_2)
def test_forged_bursts_and_instants_are_detected(copied: Callable[..., Path], name: str) -> None:
    """Burst counts and instants exist in log format 2 only; forging them is reported with the file."""
    lie, words = IN_FORMAT_2[name]
    log = copied()
    forge(log, lie)
    problems = audit_session(Session.find(log)).problems
    assert any(words in problem and problem.startswith(f"{log}:") for problem in problems), problems


def test_a_catch_trial_with_bursts_is_detected(copied: Callable[..., Path]) -> None:
    """A catch trial plays no burst and sets the lowest level's amplitudes."""
    log = copied("with_catch_trials")

    def lie(events: Events) -> None:
        event = next(event for event in of(events, "trial") if event.get("catch"))
        event["bursts"] |= {"asked": 1, "played": 1, "whole": 1}
        event["commanded"]["amplitude_Vpp"] = [each * 2 for each in event["commanded"]["amplitude_Vpp"]]

    forge(log, lie)
    problems = "\n".join(audit_session(Session.find(log)).problems)
    assert "is a catch trial with 1 bursts due" in problems
    assert "80 mm/s needs" in problems


def nothing(events: Events) -> None:
    """Change nothing."""


@pytest.mark.parametrize("schema", ["1", "2"])
@pytest.mark.parametrize("protocol", ["demo", "with_catch_trials"])
def test_a_log_rewritten_without_a_forgery_passes(copied: Callable[..., Path], protocol: str, schema: str) -> None:
    """The rewriting itself changes no byte, so the other tests detect the forgery alone."""
    log = copied(protocol, schema)
    before = log.read_bytes()
    forge(log, nothing)
    assert log.read_bytes() == before
    assert audit_session(Session.find(log)).problems == ()


@pytest.mark.parametrize(
    ("rig_choice", "answers_choice", "identity", "is_real"),
    [
        ("TCPIP::192.168.0.7::INSTR", "window", REAL, True),
        ("TCPIP::192.168.0.7::INSTR", "simulated", REAL, False),
        ("simulated", "window", REAL, False),
        ("TCPIP::192.168.0.7::INSTR", "window", None, False),
    ],
)
def test_a_session_is_real_if_rig_and_answers_are(
    copied: Callable[..., Path], rig_choice: str, answers_choice: str, identity: str | None, is_real: bool
) -> None:
    """By what was chosen and by the serial number that the generator gave: the twin's is none of the maker's."""
    log = copied()
    events = [copy.deepcopy(event) for event in read_chain(log).events]
    events[0] |= {"mode": "real", "rig_choice": rig_choice, "answers_choice": answers_choice}
    events[0]["rig"]["identity"] = identity or events[0]["rig"]["identity"]
    problems = audit_session(rewritten(log, events)).problems
    assert any("but its rig or its answers were simulated" in problem for problem in problems) is not is_real


def test_a_record_that_names_no_format_is_of_the_first(copied: Callable[..., Path]) -> None:
    """The first records named none, and counted no bursts."""
    log = copied(schema="1")
    forge(log, lambda events: events[0].pop("schema", None))
    audit = audit_session(Session.find(log))
    assert audit.problems == ()
    assert audit.lines[3] == "13 answers, each in its place, with its level and amplitudes"


@pytest.mark.parametrize("name", ["every level", "the codes", "a speed at a zone", "a line number"])
def test_a_log_that_verify_refuses_is_neither_analysed_nor_resumed(copied: Callable[..., Path], name: str) -> None:
    """Resume and analysis refuse it with the message of verify."""
    log = copied()
    forge(log, IN_BOTH[name][0])
    said = audit_session(Session.find(log)).problems[0]
    with pytest.raises(RecordError, match=re.escape(said)):
        wire_resume(log)
    with pytest.raises(InputError, match=re.escape(said)):
        read_responses(log)


def test_verify_does_not_offer_to_resume_a_running_session(copied: Callable[..., Path]) -> None:
    """A log whose lock is held is being recorded; without the lock, verify points to `modaltouch resume`."""
    log = copied()
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:12]))
    for view in log.parent.glob("sub-*"):
        view.unlink()
    with SessionLog.reopen(log):
        said = audit_session(Session.find(log)).lines[-1]
    assert said == "not complete: another program is running this session now"
    assert audit_session(Session.find(log)).lines[-1].startswith("not complete: `modaltouch resume` continues it")


def test_the_list_of_faults_is_cut_at_twenty(copied: Callable[..., Path]) -> None:
    """After 20 faults one line says that there are more."""
    log = copied("with_catch_trials")
    forge(log, rewrite_levels)
    problems = audit_session(Session.find(log)).problems
    assert len(problems) == 21
    assert problems[-1].endswith("more such faults")


@pytest.mark.parametrize("protocol", ["demo", "two_fields", "threshold", "with_catch_trials"])
def test_a_session_of_format_1_is_still_verified_and_analysed(copied: Callable[..., Path], protocol: str) -> None:
    """Format 1 was recorded before bursts were counted; its answers are all read."""
    log = copied(protocol, "1")
    assert audit_session(Session.find(log)).problems == ()
    stimulus = "sharp" if protocol == "two_fields" else None
    assert len(read_responses(log, stimulus=stimulus).frame) == {"two_fields": 16, "threshold": 90}.get(
        protocol, 12 if protocol == "demo" else 24
    )


def test_a_cut_session_of_format_1_is_started_over_instead_of_resumed(copied: Callable[..., Path]) -> None:
    """A session does not mix two formats: resume refuses and points to `--restart`, which starts session 2."""
    log = copied("demo", "1")
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:40]))
    for view in log.parent.glob("*_beh.*"):
        view.unlink()
    with pytest.raises(RecordError, match="modaltouch resume --restart"):
        wire_resume(log)
    assert wire_resume(log, restart=True).place.session == 2


def test_speeds_that_were_sought_at_the_samples_alone_are_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Earlier versions recorded lower peaks of a burst with few samples, and did not say where they sought them."""
    for name in ("apparatus", "texts"):
        shutil.copytree(PROTOCOLS / name, tmp_path / name)
    text = (PROTOCOLS / "demo.yaml").read_text(encoding="utf-8")
    (tmp_path / "demo.yaml").write_text(text.replace("n_samples: 125000", "n_samples: 12000"), encoding="utf-8")
    with monkeypatch.context() as earlier:
        earlier.setattr(
            Stimulus,
            "peak_velocity",
            lambda self, *given: abs(self.velocity_history(*given, whole_period=True)).max(axis=1),
        )
        simulate_session(tmp_path / "demo.yaml", "sim01", tmp_path)
    (log,) = tmp_path.rglob("session.jsonl")
    level = Session.find(log).start["stimulus"]["stimuli"][0]
    found = examine(tmp_path / "demo.yaml").zone_peaks("", level["velocity_mm_s"])
    assert found["A"] * 1e3 > level["zone_peak_mm_s"]["A"] + 0.1
    assert "its speeds at the zones" in audit_session(Session.find(log)).problems[0]
    forge(log, lambda events: events[0]["stimulus"].pop("peaks"))
    assert audit_session(Session.find(log)).problems == ()
    assert len(read_responses(log).frame) == 12


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results with a session of three two-interval comparisons."""
    folder = tmp_path_factory.mktemp("intervals")
    text = (PROTOCOLS / "comparison_2ifc.yaml").read_text(encoding="utf-8")
    for name in ("apparatus", "texts"):
        text = text.replace(f"{name}: {name}/", f"{name}: {PROTOCOLS / name}/")
    text = re.sub("repetitions: 8|practice_trials: 4|70, 80, 90, ", "", text)
    (folder / "comparison_2ifc.yaml").write_text(text, encoding="utf-8")
    simulate_session(folder / "comparison_2ifc.yaml", "sim01", folder)
    return folder / "simulated"


def in_interval(number: int, change: Callable[[dict[str, Any]], object]) -> Lie:
    """Return the forgery that changes an interval in both lines of the last answer."""
    return everywhere(lambda event: change(event["intervals"][number - 1]))


def remove_first_interval(events: Events) -> None:
    """Remove the line that starts the first interval of the last trial."""
    told = last(events)["trial"]
    gone = next(e for e in events if e["event"] == "fired" and e["trial"] == told)
    events.remove(gone)
    for number, event in enumerate(events, 1):
        event["n"] = number
        event["answered"] = event["answered"] - 1 if event.get("answered", 0) > gone["n"] else event.get("answered")


def delay_first_interval(events: Events) -> None:
    """Record the first interval of the last trial half a second later in all its lines."""
    told = last(events)["trial"]
    for event in of(events, "fired", "answered", "trial"):
        for each in event.get("intervals", [])[:1] or ([event] if event.get("interval") == 1 else []):
            if event["trial"] == told:
                each["confirmed"]["onset"] = round(each["confirmed"]["onset"] + 0.5, 6)
                for name in ("earliest_s", "latest_s"):
                    if "first_burst" in each:
                        each["first_burst"][name] = round(each["first_burst"][name] + 0.5, 6)
                if "bursts" in each:
                    each["bursts"]["first_s"] = each["confirmed"]["onset"]


OF_INTERVALS: dict[str, tuple[Lie, str]] = {
    "a level": (
        in_interval(1, lambda each: each["planned"].update(velocity_mm_s=90.0)),
        "interval 1: was planned at 90",
    ),
    "an amplitude": (
        in_interval(2, lambda each: each["confirmed"].update(commanded_amplitude=[1.0, 1.0])),
        "interval 2: .* Vpp, but 1, 1 Vpp were commanded",
    ),
    "a burst": (in_interval(1, lambda each: each["bursts"].update(whole=4)), "interval 1: is confirmed with 5 bursts"),
    "an onset": (
        in_interval(1, lambda each: each["confirmed"].update(onset=each["confirmed"]["onset"] - 1)),
        "interval 1: is not the one that began",
    ),
    "a confirmation": (
        in_interval(1, lambda each: each["confirmed"].update(confirmed=False)),
        "counts, although one of its intervals is not confirmed",
    ),
    "an interval": (everywhere(lambda event: event["intervals"].pop()), "its line lists 1"),
    "where it stood": (
        everywhere(lambda event: event["trial"].update(interval=3 - event["trial"]["interval"])),
        "has the interval",
    ),
    "the verdict": (
        everywhere(lambda event: event.update(correct=not event["correct"])),
        "the record says (right|wrong)",
    ),
    "no first interval": (remove_first_interval, "its stimulus began 0 times"),
    "the gap": (delay_first_interval, "its protocol has a gap of 0.5 s"),
}


@pytest.mark.parametrize("name", OF_INTERVALS)
def test_forged_intervals_are_detected(compared: Path, tmp_path: Path, name: str) -> None:
    """The audit covers the order, levels, amplitudes, counts and instants of every interval."""
    shutil.copytree(compared, tmp_path / "simulated")
    (log,) = tmp_path.rglob("session.jsonl")
    lie, said = OF_INTERVALS[name]
    forge(log, lie)
    problems = "\n".join(audit_session(Session.find(log)).problems)
    assert re.search(said, problems), problems
