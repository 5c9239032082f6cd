"""Corrupted files of every kind are refused clearly or read correctly, without a traceback or a hang.

``MODALTOUCH_MUTATIONS`` sets the total number of corrupted files; ``make fuzz`` takes 20,000.
"""

import gc
import os
import random
import re
import resource
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.pipeline import read_responses
from modaltouch.analysis.statistics import find
from modaltouch.cli import app
from modaltouch.planning.observer import Observer
from modaltouch.preflight import examine
from modaltouch.protocol import InputError
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import RecordError
from modaltouch.record.recovery import survey
from modaltouch.record.session import Session, read_session
from modaltouch.session.wiring import simulate_session

ROOT = Path(__file__).parents[1]
N_MUTATIONS = int(os.environ.get("MODALTOUCH_MUTATIONS", "240"))
GROWTH = 200e6
"""Most by which the process may grow over all of them, caches of the first included [bytes]."""

WORDS = """-1 0 1e400 .nan .inf 1e308 true ~ [] {} '' *a &a !!int | 5e F [[A,C]] 131072 null one_hand free none
9999999999999 ../../etc/passwd <script> \x00 \ufeff \u202e é ; ,""".split()  # noqa: SIM905


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with some words, lines or bytes changed, duplicated, moved or removed."""
    text = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        if not text:
            break
        place, length = rng.randrange(len(text)), rng.choice([1, 1, 2, 8, 40, 400])
        kind = rng.choice(["flip", "word", "cut", "double", "move", "line", "number", "truncate"])
        if kind == "flip":
            text[place] ^= 1 << rng.randrange(8)
        elif kind == "word":
            words = list(re.finditer(rb"[\w.]+", text))
            if words:
                word = rng.choice(words)
                text[word.start() : word.end()] = rng.choice(WORDS).encode()
        elif kind == "cut":
            del text[place : place + length]
        elif kind == "double":
            text[place:place] = text[place : place + length]
        elif kind == "move":
            piece = text[place : place + length]
            del text[place : place + length]
            to = rng.randrange(len(text) + 1)
            text[to:to] = piece
        elif kind == "line":
            lines = bytes(text).splitlines(keepends=True)
            line = rng.randrange(len(lines))
            lines[line : line + 1] = rng.choice([[], [lines[line]] * 2, [b"\n"], [rng.choice(lines)]])
            text = bytearray(b"".join(lines))
        elif kind == "number":
            numbers = list(re.finditer(rb"\d+(\.\d+)?", text))
            if numbers:
                number = rng.choice(numbers)
                value = float(number.group()) * 10 ** rng.uniform(-6, 6)
                text[number.start() : number.end()] = f"{value:.6g}".encode()
        elif kind == "truncate" and rng.random() < 0.2:
            del text[place:]
    return bytes(text)


class Kind:
    """A kind of file: its valid content, its path, its readers, and a command that reads it."""

    def __init__(self, name, sound, place, readers, command):
        self.name, self.sound, self.place, self.readers, self.command = name, sound, place, readers, command


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """Every kind of file that the program reads."""
    folder = tmp_path_factory.mktemp("spoilt")
    shutil.copytree(ROOT / "protocols", folder / "protocols")
    protocol = folder / "protocols" / "with_catch_trials.yaml"
    session = simulate_session(protocol, "p01", folder / "results").path
    rows = [f"p{n},one_hand,{left},{right},{level},{answer}" for n in range(4) for left, right in ("AC", "BD")
            for level, answer in ((80, "left"), (200, "both"))]  # fmt: skip
    table = folder / "answers.csv"
    table.write_text("participant,finger_condition,zone_left,zone_right,velocity_mm_s,response\n" + "\n".join(rows))
    observer = folder / "protocols" / "observers" / "paper.yaml"

    def verified(path):
        return audit_session(Session.find(path))

    def analysed(path):
        responses = read_responses(path)
        find(count_answers(responses.frame, responses.focus), responses.frame)

    def of(name, place, readers, *command):
        return Kind(name, place.read_bytes(), place, readers, command)

    checked = ([lambda _: examine(protocol).as_dict()], "check", protocol)
    return [
        of("protocol", protocol, *checked),
        of("apparatus", folder / "protocols" / "apparatus" / "beam_100x6x2.yaml", *checked),
        of("texts", folder / "protocols" / "texts" / "english.yaml", *checked),
        of(
            "observer", observer, [Observer.read], "simulate", protocol, "--observer", observer, "--results", os.devnull
        ),
        of("session log", session, [read_session, survey, verified, analysed], "verify", session),
        of("table of answers", table, [analysed], "analyse", table, "--out", folder / "out"),
    ]


def read_with_all(kind, spoilt):
    """Read a corrupted file with every reader of its kind."""
    kind.place.write_bytes(spoilt)
    for reader in kind.readers:
        try:
            reader(kind.place)
        except (InputError, RecordError) as refused:
            said = str(refused)
        else:
            said = "read"
        assert said, f"{kind.name}: refused without a message"


def memory():
    """Return the peak memory of this process [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.mark.timeout(3600)
@pytest.mark.filterwarnings("ignore")
def test_corrupted_files_are_refused_with_a_message_or_read(kinds):
    """Each kind has the same number of files, read by all its readers; the memory of the process does not grow."""
    before = None
    for number in range(N_MUTATIONS):
        kind = kinds[number % len(kinds)]
        spoilt = mutate(kind.sound, random.Random(number))
        try:
            read_with_all(kind, spoilt)
        except (InputError, RecordError, AssertionError):
            raise
        except BaseException as error:
            found = Path("build") / f"spoilt_{kind.name.replace(' ', '_')}_{number}"
            found.parent.mkdir(exist_ok=True)
            found.write_bytes(spoilt)
            raise AssertionError(f"{kind.name} number {number} ({found}) raised {error!r}") from error
        finally:
            kind.place.write_bytes(kind.sound)
        if number == min(300, N_MUTATIONS // 2):
            gc.collect()
            before = memory()
    assert before is not None
    assert memory() - before < GROWTH


@pytest.mark.parametrize("number", range(24))
def test_a_command_on_a_corrupted_file_ends_with_a_documented_status(kinds, number):
    """The exit status is 0, 2 or 4, with a message and no traceback."""
    kind = kinds[number % len(kinds)]
    kind.place.write_bytes(mutate(kind.sound, random.Random(1000 + number)))
    try:
        ended = CliRunner().invoke(app, [str(word) for word in kind.command])
    finally:
        kind.place.write_bytes(kind.sound)
    assert ended.exit_code in (0, 2, 4), ended.output
    assert ended.exception is None or isinstance(ended.exception, SystemExit), ended.exception
    assert "Traceback" not in ended.output
