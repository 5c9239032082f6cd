"""Verification of a session: chain, order, drive and BIDS view are recomputed; see also test_audit."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.preflight import examine
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, RecordError, encode_line, line_check, read_chain
from modaltouch.record.session import Session
from modaltouch.session.resumption import resume, wire_resume
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run

PROTOCOL = Path(__file__).parents[2] / "protocols" / "demo.yaml"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The folder of a valid session."""
    setup = wire_run(
        examine(PROTOCOL).require(), "p01", answers="simulated", results=tmp_path_factory.mktemp("results")
    )
    return begin(setup).path.parent


@pytest.fixture
def folder(sound, tmp_path):
    """A copy of it that a test may change."""
    return Path(shutil.copytree(sound, tmp_path / "beh"))


def forge(folder, change):
    """Rewrite the log with a changed start record and recomputed checksums."""
    log = folder / "session.jsonl"
    check, lines = GENESIS, []
    for event in read_chain(log).events:
        if event["event"] == "start":
            change(event)
        line, check = encode_line(event, check)
        lines.append(line)
    log.write_bytes(b"".join(lines))


def test_a_valid_session_passes(folder):
    """As recorded by the program itself."""
    verdict = audit_session(Session.find(folder))
    assert verdict.problems == ()
    assert verdict.lines[-1] == "complete"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"TaskName": "Threshold"}, "says TaskName: Threshold, where its log says demo"),
        ({"response": None}, "does not describe the column response"),
        ({"velocity_mm_s": {"Units": "mm s-1"}}, "gives the unit mm s-1 for velocity_mm_s, where its log has mm/s"),
    ],
)
def test_a_side_file_that_differs_from_its_log_is_named_and_excludes_no_answer(folder, change, words):
    """BIDS 1.10, tabular files: it gives the meaning and unit of each column, which a lab may write in its own way."""
    (side,) = folder.glob("*_beh.json")
    side.write_text(json.dumps(json.loads(side.read_text()) | change))
    audit = audit_session(Session.find(folder))
    assert f"BIDS view agrees, but {side} {words}" in audit.lines
    assert audit.problems == ()


def test_a_side_file_with_another_mode_is_a_fault(folder):
    """Simulated answers must not be taken for real ones."""
    (side,) = folder.glob("*_beh.json")
    side.write_text(json.dumps(json.loads(side.read_text()) | {"Mode": "real"}))
    (problem,) = audit_session(Session.find(folder)).problems
    assert problem.startswith(f"{side}: says Mode: real, but its log says simulated; move it away")


def test_the_words_of_a_side_file_are_the_labs(folder):
    """A lab may translate the descriptions and add keys before it shares them."""
    (side,) = folder.glob("*_beh.json")
    about = json.loads(side.read_text())
    about["response"]["Description"] = "Wo die Vibration war"
    side.write_text(json.dumps(about | {"InstitutionName": "A lab"}))
    assert audit_session(Session.find(folder)).problems == ()


def test_a_session_with_the_former_key_speech_is_readable(edit, tmp_path):
    """The key is ignored, also with its former additions in the record; only the view differs."""
    protocol = edit("demo.yaml", ("answers:\n  given_by", "speech: {voice: en}\nanswers:\n  given_by"))
    setup = wire_run(examine(protocol).require(), "p01", answers="simulated", results=tmp_path / "results")
    folder = begin(setup).path.parent
    former = {"voice": "en", "screens": ["question"], "rate_words_per_min": 160, "level_dB_FS": -20.0}
    forge(folder, lambda start: start["design"].update(speech=former))
    (problem,) = audit_session(Session.find(folder)).problems
    assert "was made from another log" in problem


def test_lines_removed_from_the_end_are_detected(folder):
    """By the BIDS side file, which has the number of lines; the chain alone cannot show it."""
    log = folder / "session.jsonl"
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:-3]))
    assert any("lines were removed from its end" in problem for problem in audit_session(Session.find(folder)).problems)


def test_a_changed_table_is_detected(folder):
    """An answer is changed in the table."""
    table = next(folder.glob("*_beh.tsv"))
    table.write_text(table.read_text().replace("\tboth\t", "\tleft\t", 1))
    assert any("differs from the log" in problem for problem in audit_session(Session.find(folder)).problems)


def test_an_order_that_does_not_follow_from_the_seed_is_detected(folder):
    """Even with all checksums recomputed."""
    forge(folder, lambda start: start.update(seed=start["seed"] + 1))
    assert any("draws a different order" in problem for problem in audit_session(Session.find(folder)).problems)


def test_a_drive_that_does_not_follow_from_the_apparatus_is_detected(folder):
    """A changed gain in the recorded apparatus gives other codes than those recorded."""

    def change(start):
        apparatus = start["sources"]["apparatus"]
        apparatus["text"] = apparatus["text"].replace("{centre: 114}", "{centre: 115}")

    forge(folder, change)
    assert any("the recomputed drive" in problem for problem in audit_session(Session.find(folder)).problems)


def test_the_side_file_has_the_head_of_the_log(folder):
    """The number of lines and the checksum of the last one."""
    head = json.loads(next(folder.glob("*_beh.json")).read_text())["SessionLog"]
    chain = read_chain(folder / "session.jsonl")
    assert head["lines"] == len(chain.events)
    assert head["check"] == chain.last_check


def test_a_table_newer_than_its_side_file_agrees(folder):
    """After a kill between the replacements of table and side file."""
    (side,) = folder.glob("*_beh.json")
    values = json.loads(side.read_text())
    chain = read_chain(folder / "session.jsonl")
    values["SessionLog"] |= {"lines": 5, "check": chain.checks[4]}
    side.write_text(json.dumps(values))
    verdict = audit_session(Session.find(folder))
    assert verdict.problems == ()
    assert any(line.startswith("BIDS view agrees: ") for line in verdict.lines)


def test_a_view_behind_its_log_is_reported(folder):
    """After a kill between log and table: not a fault, but not called up to date."""
    table = next(folder.glob("*_beh.tsv"))
    chain = read_chain(folder / "session.jsonl")
    n_lines = next(event["n"] for event in chain.events if event["event"] == "trial")
    side = table.with_suffix(".json")
    described = json.loads(side.read_text())
    described["SessionLog"] |= {"lines": n_lines, "check": chain.checks[n_lines - 1]}
    side.write_text(json.dumps(described))
    table.write_text("\n".join(table.read_text().splitlines()[:2]) + "\n")
    verdict = audit_session(Session.find(folder))
    assert verdict.problems == ()
    assert any("lines behind the log" in line for line in verdict.lines)


def test_a_complete_session_is_not_rewritten(folder, tmp_path):
    """Resuming leaves every file unchanged, including its modification time."""
    place = tmp_path / "simulated" / "demo" / "sub-p01" / "ses-1"
    place.mkdir(parents=True)
    folder = folder.rename(place / "beh")
    before = {path: (path.read_bytes(), path.stat()) for path in folder.iterdir()}
    assert resume(wire_resume(folder)).complete
    assert {path: (path.read_bytes(), path.stat()) for path in folder.iterdir()} == before


@pytest.mark.parametrize("n_rows", [0, 1, None])
def test_a_session_killed_before_its_first_side_file_continues(folder, tmp_path, n_rows):
    """`verify` reports the missing file, and `resume` writes it, whatever lines the table has."""
    place = tmp_path / "simulated" / "demo" / "sub-p01" / "ses-1"
    place.mkdir(parents=True)
    folder = folder.rename(place / "beh")
    (side,), (table,) = folder.glob("*_beh.json"), folder.glob("*_beh.tsv")
    described = side.read_bytes()
    side.unlink()
    if n_rows is not None:
        table.write_text("".join(table.read_text().splitlines(keepends=True)[: 1 + n_rows]))
    assert audit_session(Session.find(folder)).problems == (f"{side}: is missing; `modaltouch resume` writes it",)
    assert resume(wire_resume(folder)).complete
    assert side.read_bytes() == described
    assert audit_session(Session.find(folder)).problems == ()


def test_a_changed_table_without_side_file_is_refused(folder):
    """A table that does not follow from the log is not overwritten."""
    (side,), (table,) = folder.glob("*_beh.json"), folder.glob("*_beh.tsv")
    side.unlink()
    table.write_text(table.read_text().replace("left", "right", 1))
    (problem,) = audit_session(Session.find(folder)).problems
    assert "differs from the log" in problem
    with pytest.raises(RecordError, match="differs from the log"):
        wire_resume(folder)


@pytest.mark.parametrize("cut", [1, 40])
def test_the_torn_last_line_of_a_complete_session_is_repaired(folder, tmp_path, cut):
    """After a power cut, without the newline or half the line: no answer is missing."""
    place = tmp_path / "simulated" / "demo" / "sub-p01" / "ses-1"
    place.mkdir(parents=True)
    log = folder.rename(place / "beh") / "session.jsonl"
    log.write_bytes(log.read_bytes()[:-cut])
    assert audit_session(Session.find(log)).problems
    assert resume(wire_resume(log)).complete
    assert audit_session(Session.find(log)).problems == ()


UNREADABLE = {
    "no JSON": b'{"n":3,"event":nothing',
    "nested without end": b'{"n":3,"event":"rig","deep":' + b"[" * 100_000 + b"]" * 100_000,
    "a number of 6,000 digits": b'{"n":3,"event":"rig","number":' + b"7" * 6000,
}
COMMANDS = {
    "verify": "verify SESSION",
    "resume": "resume SESSION",
    "restart": "resume --restart SESSION",
    "analyse": "analyse SESSION --out OUT",
    "analyse a tree": "analyse TREE --out OUT",
    "run": "run PROTOCOL -p p01 --results RESULTS --rig simulated --answers simulated --yes",
    "fit": "fit PROTOCOL TREE --out OUT",
    "doctor": "doctor SESSION",
    "recover": "doctor SESSION --into OUT",
}


@pytest.mark.parametrize("kind", UNREADABLE)
@pytest.mark.parametrize("line", [1, 3])
@pytest.mark.parametrize("command", COMMANDS)
def test_an_unreadable_line_ends_in_a_clear_error(sound, tmp_path, command, line, kind):
    """Its checksum is right; every command that reads the log reports its position."""
    folder = tmp_path / "results" / "simulated" / "demo" / "sub-p01" / "ses-1" / "beh"
    log = Path(shutil.copytree(sound, folder)) / "session.jsonl"
    check, lines = GENESIS, []
    for number, event in enumerate(read_chain(log).events, 1):
        data, after = encode_line(event, check)
        if number == line:
            body = UNREADABLE[kind]
            after = line_check(check, body)
            data = body + b',"check":"' + after.encode() + b'"}\n'
        lines.append(data)
        check = after
    log.write_bytes(b"".join(lines))
    places = {"SESSION": folder, "TREE": tmp_path / "results", "RESULTS": tmp_path / "results", "PROTOCOL": PROTOCOL}
    words = [str(places.get(word, tmp_path / "out" if word == "OUT" else word)) for word in COMMANDS[command].split()]
    told = CliRunner().invoke(app, words)
    assert isinstance(told.exception, SystemExit | None), told.exception
    if command == "recover" and line == 3:
        assert told.exit_code == 0
    else:
        assert told.exit_code in (2, 4)
    assert ("nothing can be recovered without its first line" in told.output) == (command == "doctor" and line == 1)
    if command == "recover" and line == 1:
        assert "its start record is not intact" in told.output
    elif command in ("doctor", "recover"):
        assert f"line {line} is left out: it cannot be read: " in told.output
    else:
        assert f"session.jsonl:{line}: cannot be read: " in told.output


def test_a_damaged_log_is_not_reported_as_truncated(folder):
    """Lines after the damage were not read; `resume` refuses such a log."""
    log = folder / "session.jsonl"
    lines = log.read_bytes().splitlines(keepends=True)
    lines[9] = lines[9].replace(b'"event":"', b'"event":"x')
    log.write_bytes(b"".join(lines))
    audit = audit_session(Session.find(folder))
    assert audit.problems == (f"{log}:10: the chain breaks: a line was changed, removed, duplicated or moved",)
    assert audit.lines[-1] == "not complete; the analysis leaves it out"
