"""Study at a glance: the state of every session from its log, and the next participant by the assignment."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import pytest
from outside import call

from modaltouch.cli.records import study
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError
from modaltouch.record.chain import GENESIS, encode_line, read_chain
from modaltouch.session import survey_results

SHIPPED = Path(__file__).parents[2] / "protocols"
ONE, TWO = ["one_hand", "two_hands"], ["two_hands", "one_hand"]


@pytest.fixture(scope="module")
def demo() -> Preflight:
    """Return a protocol of two sessions each, with orders by the participant's number."""
    return examine(SHIPPED / "demo.yaml").require()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory, demo: Preflight, scribe: Callable[..., Path]) -> Path:
    """Record a complete session, an interrupted one, a damaged one, a restarted one, and a pilot."""
    results = tmp_path_factory.mktemp("study") / "results"
    scribe(demo, results, "p01")
    cut = scribe(demo, results, "p02", n_answered=5)
    cut.write_bytes(cut.read_bytes()[:-20])
    damaged = scribe(demo, results, "p03")
    damaged.write_bytes(damaged.read_bytes().replace(b'"answer":"both"', b'"answer":"left"', 1))
    scribe(demo, results, "p04", n_answered=3, also=({"event": "closed", "begun_anew_as": 2},))
    scribe(demo, results, "p04", session=2)
    stopped = {"event": "stop", "reason": "emergency stop", "complete": False, "n_answered": 4}
    again = {"event": "resume", "boot": ""}
    scribe(demo, results, "p06", n_answered=4, also=(again, stopped))
    scribe(demo, results, "p09", mode="pilot")
    return results


@pytest.fixture(scope="module")
def real(tree: Path) -> dict[str, Any]:
    """Return the survey of the real sessions."""
    found = {each["mode"]: each for each in survey_results(tree)}
    assert set(found) == {"real", "pilot"}
    return found["real"]


def test_every_session_is_listed_with_its_state(real: dict[str, Any]) -> None:
    """Complete, interrupted, damaged, closed or stopped, by the logs."""
    assert [(row["participant"], row["session"], row["state"], row["why"]) for row in real["sessions"]] == [
        ("p01", 1, "complete", ""),
        ("p02", 1, "interrupted", "killed"),
        ("p03", 1, "damaged", real["sessions"][2]["why"]),
        ("p04", 1, "closed", "started over as session 2"),
        ("p04", 2, "complete", ""),
        ("p06", 1, "interrupted", "emergency stop"),
    ]
    assert "the chain breaks" in real["sessions"][2]["why"]
    assert [row["n_answered"] for row in real["sessions"]] == [12, 4, None, 3, 12, 4]
    assert [row["n_sittings"] for row in real["sessions"]] == [1, 1, 1, 1, 1, 2]
    assert all(row["n_trials"] == 12 for row in real["sessions"] if row["state"] != "damaged")


def test_excluded_sessions_have_the_reason_of_the_analysis(tree: Path, real: dict[str, Any]) -> None:
    """In the words of `analyse`."""
    from modaltouch.analysis import read_responses

    left_out = read_responses(tree, mode="real").left_out
    said = {Path(row["log"]).parent.as_posix(): row["excluded"] for row in real["sessions"] if row["excluded"]}
    analysed = {item.source: item.reason for item in left_out if not item.reason.startswith("pilot")}
    assert said == analysed
    assert len(said) == 4


def test_orders_are_balanced_over_those_who_finished(real: dict[str, Any]) -> None:
    """P01 and p04 completed one order each; p02 and p06 left one incomplete, p03 the other."""
    orders = {each["finger_conditions"][0]: each for each in real["orders"]}
    counts = {name: (each["filled"], each["left_incomplete"], each["open"]) for name, each in orders.items()}
    assert counts == {"one_hand": (1, 1, 0), "two_hands": (1, 2, 0)}


def test_the_next_sessions_are_listed_with_their_order(real: dict[str, Any]) -> None:
    """Interrupted ones to resume, damaged ones to verify, then a new participant."""
    told = [(each["participant"], each["session"], each["do"], each["finger_conditions"]) for each in real["next"]]
    assert told == [
        ("p02", 1, "resume", TWO),
        ("p03", 1, "verify", ONE),
        ("p06", 1, "resume", TWO),
        ("p07", 1, "run", ONE),
    ]


def test_the_next_participant_fills_the_least_filled_order(
    tmp_path: Path, edit: Callable[..., Path], scribe: Callable[..., Path]
) -> None:
    """The new one gets the order that p02 left; p01 gets the other order next."""
    changes = "practice_trials: 1", "practice_trials: 1\n  balance: least_filled\n  sessions: 2"
    preflight = examine(edit("demo.yaml", changes)).require()
    scribe(preflight, tmp_path, "p01")
    scribe(preflight, tmp_path, "p02", n_answered=2)
    (found,) = survey_results(tmp_path / "demo" / "sub-p01")
    assert [each["participant"] for each in found["sessions"]] == ["p01"]
    (found,) = survey_results(tmp_path)
    told = [(each["participant"], each["session"], each["finger_conditions"]) for each in found["next"]]
    assert told == [("p01", 2, TWO), ("p02", 1, TWO), ("p03", 1, TWO)]
    assert [each["open"] for each in found["orders"]] == [0, 1]


def test_rows_of_a_square_are_balanced_once_each_has_been_used(
    tmp_path: Path, edit: Callable[..., Path], scribe: Callable[..., Path]
) -> None:
    """Two conditions in either order, six orders of three pairs: 12 in all (Williams 1949), though 36 turns."""
    preflight = examine(
        edit("demo.yaml", ("repetitions: 1", "order: by_pair"), ("max_same_pair_running: 2", ""))
    ).require()
    for number in range(1, 6):
        scribe(preflight, tmp_path, f"p{number:02d}")
    (found,) = survey_results(tmp_path)
    counts = [(each["filled"], each["open"], each["n_turns"]) for each in found["orders"]]
    assert counts == [(3, 3, 6), (2, 4, 6)]


def test_a_session_of_the_future_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, demo: Preflight, scribe: Callable[..., Path]
) -> None:
    """The clock was a year ahead for p02, as with an empty battery; a least gap would be reckoned from then."""

    class Ahead(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) + timedelta(days=365)

    scribe(demo, tmp_path, "p01")
    (found,) = survey_results(tmp_path)
    assert found["notes"] == []
    monkeypatch.setattr("modaltouch.record.log.datetime", Ahead)
    scribe(demo, tmp_path, "p02")
    (found,) = survey_results(tmp_path)
    assert found["notes"] == ["p02 session 1: begun later than now, so this computer's clock is wrong, or was then"]


def test_a_session_begun_anew_counts_once_and_the_time_between_sittings_not(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    edit: Callable[..., Path],
    scribe: Callable[..., Path],
) -> None:
    """Of two sessions, one was closed and repeated as the second: the third is due. Minutes by hand."""
    preflight = examine(edit("demo.yaml", ("practice_trials: 1", "practice_trials: 1\n  sessions: 2"))).require()
    later = ({"event": "resume", "boot": "", "clock": 9000.0}, {"event": "rest", "clock": 9630.0})
    scribe(preflight, tmp_path, "p01", n_answered=3, also=(*later, {"event": "closed", "begun_anew_as": 2}))
    scribe(preflight, tmp_path, "p01", session=2)
    (found,) = survey_results(tmp_path)
    assert [(each["participant"], each["session"], each["do"]) for each in found["next"]][0] == ("p01", 3, "run")
    assert (found["sessions"][0]["n_sittings"], found["sessions"][0]["duration_min"]) == (2, 10.5)
    monkeypatch.setenv("COLUMNS", "80")
    study(tmp_path)
    shown = [line for line in capsys.readouterr().out.splitlines() if line[:1] in "┃│"]
    assert shown and max(map(len, shown)) <= 80
    assert any("duration" in line for line in shown) and any(" in 2 " in line for line in shown)


@pytest.mark.parametrize(
    ("change", "state"),
    [
        ({"clock": "noon"}, "damaged"),
        ({"event": ["stop"]}, "damaged"),
        ({"event": "start", "design": "a design"}, "damaged"),
        ({"event": "start", "schedule": "12 trials"}, "damaged"),
        ({"event": "start", "time": 5}, "damaged"),
        ({"event": "start", "schedule": {"n_trials": 12, "order_hash": "", "seeds": "1"}}, "damaged"),
    ],
)
def test_a_log_with_impossible_values_does_not_end_the_survey(
    demo: Preflight, tmp_path: Path, scribe: Callable[..., Path], change: dict[str, Any], state: str
) -> None:
    """Its checksums are right, but a value is invalid: the other sessions are still listed."""
    scribe(demo, tmp_path, "p01")
    log = scribe(demo, tmp_path, "p03", n_answered=3)
    events = list(read_chain(log).events)
    place = 0 if change.get("event") == "start" else -1
    events[place] = events[place] | change
    lines, check = b"", GENESIS
    for event in events:
        line, check = encode_line(event, check)
        lines += line
    log.write_bytes(lines)
    (found,) = json.loads(call(f"study {tmp_path} --json").stdout)["datasets"]
    states = {row["participant"]: row["state"] for row in found["sessions"]}
    assert states == {"p01": "complete", "p03": state}
    assert call(f"study {tmp_path}").status == 0


def test_a_log_without_a_valid_line_is_damaged(tmp_path: Path, demo: Preflight, scribe: Callable[..., Path]) -> None:
    """Not even its start can be read."""
    scribe(demo, tmp_path, "p01").write_bytes(b"x\ny\n")
    (found,) = survey_results(tmp_path)
    assert [(row["state"], row["n_sittings"]) for row in found["sessions"]] == [("damaged", 0)]
    reason = "the start record of the latest session is missing or incomplete"
    assert found["notes"] == [f"orders and next sessions are not known: {reason}"]


def test_sessions_of_two_modes_in_one_folder_are_told(
    tmp_path: Path, demo: Preflight, scribe: Callable[..., Path]
) -> None:
    """A pilot that was copied into the study would be counted in the balance of its orders."""
    scribe(demo, tmp_path, "p01")
    copied = scribe(demo, tmp_path, "p02", mode="pilot").parents[2]
    copied.rename(tmp_path / "demo" / copied.name)
    (found,) = survey_results(tmp_path / "demo")
    kinds = "pilot sessions of demo and real sessions of demo"
    assert found["notes"] == [f"holds {kinds}, which are counted together here: move them to folders of their own"]


def test_a_complete_session_with_a_torn_log_is_for_resume(
    tmp_path: Path, demo: Preflight, scribe: Callable[..., Path]
) -> None:
    """All answers are there, but the analysis excludes it until it is repaired."""
    log = scribe(demo, tmp_path, "p01")
    log.write_bytes(log.read_bytes() + b'{"n":')
    (found,) = survey_results(tmp_path)
    assert [row["excluded"].startswith("damaged") for row in found["sessions"]] == [True]
    assert [(each["participant"], each["do"]) for each in found["next"]] == [("p01", "resume"), ("p02", "run")]


@pytest.mark.parametrize("n_lost", [1, 3])
def test_a_log_shorter_than_its_view_is_damaged(
    tmp_path: Path, demo: Preflight, scribe: Callable[..., Path], n_lost: int
) -> None:
    """Its lines are valid, but `resume` refuses it; `verify` says what is missing."""
    log = scribe(demo, tmp_path, "p01", n_answered=5)
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[:-n_lost]))
    (found,) = survey_results(tmp_path)
    told = f"{log}: the BIDS view was made from {len(lines)} lines, but the log has {len(lines) - n_lost}: lines were "
    assert [(row["state"], row["why"]) for row in found["sessions"]] == [
        ("damaged", f"{told}removed from its end; look for a copy")
    ]
    assert [(each["participant"], each["do"]) for each in found["next"]] == [("p01", "verify"), ("p02", "run")]


def move_to_another_participant(log: Path) -> str:
    """Rename the participant's folder."""
    log.parents[2].rename(log.parents[3] / "sub-p08")
    return "is the record of sub-p01, ses-1; move it to sub-p01/ses-1/beh"


def move_to_another_session(log: Path) -> str:
    """Rename the session's folder."""
    log.parents[1].rename(log.parents[2] / "ses-2")
    return "is the record of sub-p01, ses-1; move it to sub-p01/ses-1/beh"


def rename_log(log: Path) -> str:
    """Give the log another name."""
    log.rename(log.with_name("old.jsonl"))
    return r"session.jsonl: cannot be read \(No such file or directory\)"


def edit_table(log: Path) -> str:
    """Change an answer in the table."""
    (table,) = log.parent.glob("*_beh.tsv")
    table.write_text(table.read_text(encoding="utf-8").replace("both", "left", 1), encoding="utf-8")
    return "differs from the log, which is the original"


@pytest.mark.parametrize("change", [move_to_another_participant, move_to_another_session, rename_log, edit_table])
def test_a_session_that_was_moved_or_lost_is_found_by_every_reader(
    tmp_path: Path, demo: Preflight, scribe: Callable[..., Path], change: Callable[[Path], str]
) -> None:
    """`study`, `verify` and `analyse` name it with the same words, and the others are read."""
    scribe(demo, tmp_path, "p02")
    said = change(scribe(demo, tmp_path, "p01"))
    (found,) = survey_results(tmp_path)
    states = {row["state"]: row["excluded"] for row in found["sessions"]}
    assert re.search(said, states.pop("damaged"))
    assert states == {"complete": ""}
    assert "excluded, damaged: line " not in call(f"study {tmp_path}").stdout
    done = call(f"verify {tmp_path}")
    assert (done.status, bool(re.search(said, done.stderr.replace("\n", " ")))) == (4, True)
    from modaltouch.analysis import read_responses

    (left_out,) = read_responses(tmp_path).left_out
    assert re.search(said, left_out.reason)
    assert call(f"doctor {tmp_path}").status in (0, 4)


def test_a_folder_without_sessions_is_refused(tmp_path: Path) -> None:
    """The message says what to give instead."""
    with pytest.raises(InputError, match="a folder without a recorded session; allowed: a results folder"):
        survey_results(tmp_path)
    with pytest.raises(InputError, match="given no such file or folder"):
        survey_results(tmp_path / "none")


def test_sessions_are_shown_within_80_columns_and_on_a_page(tree: Path, tmp_path: Path) -> None:
    """The page lists every session, loads nothing external, and overwrites only itself."""
    page = tmp_path / "study.html"
    done = call(f"study {tree} --html {page}")
    assert done.status == 0, done.stderr
    assert "p07 session 1, one_hand then two_hands" in done.stdout
    assert call(f"study {tree} --html {page} --json").status == 0
    text = page.read_text(encoding="utf-8")
    assert "PILOT DATA" in text
    assert all(f">p0{number}<" in text for number in (1, 2, 3, 4, 6, 9))
    assert not re.search(r'(src|href)="(?!#|data:)', text)
    page.write_text("mine")
    assert call(f"study {tree} --html {page}").status == 4
    assert page.read_text() == "mine"
    done = call(f"study {tree} --html /proc/none.html")
    assert (done.status, "give another file with --html" in done.stderr.replace("\n", " ")) == (4, True)
    os.mkfifo(pipe := tmp_path / "pipe")
    for kept in ("/proc/self/mem", pipe):  # cannot be read; would keep the command waiting
        done = call(f"study {tree} --html {kept}")
        assert done.status == 4
        assert "is not from `modaltouch study`" in done.stderr.replace("\n", " ")


def test_verify_and_doctor_take_a_whole_tree(tree: Path, tmp_path: Path) -> None:
    """A damaged record does not hide the others; only damaged ones are written again."""
    done = call(f"verify {tree} --json")
    assert done.status == 4
    found = json.loads(done.stdout)
    assert len(found["sessions"]) == 7
    assert not found["sound"]
    assert [each["sound"] for each in found["sessions"]].count(False) == 2
    assert "5 of 7 records are sound" in call(f"verify {tree}").stdout
    done = call(f"doctor {tree} --into {tmp_path / 'anew'}")
    assert done.status == 0, done.stderr
    anew = sorted(log.parts[-4] for log in (tmp_path / "anew").rglob("session.jsonl"))
    assert anew == ["sub-p02", "sub-p03"]
    assert call(f"verify {tmp_path / 'anew'}").status == 0
