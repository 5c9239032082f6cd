"""An answer confirmed on screen survives any interruption (docs/explanation/promises.md).

Sessions run in separate processes against a rig in this one. Each is interrupted at a seeded point, resumed and
interrupted again until it is complete. After every interruption: no answer confirmed to the participant is missing,
answers and order are those of an uninterrupted session, no output is on, and the BIDS view, as far as it exists, is
valid. The shipped protocols share the points equally, with every kind of interruption: fixed levels, catch trials,
several stimuli, and adaptive runs, whose levels must be those of the uninterrupted session, too.

``MODALTOUCH_KILL_POINTS`` sets the total number of points, ``MODALTOUCH_FIRST_SEED`` the first seed; ``make soak`` uses
more and writes the results.
"""

import json
import math
import os
import random
import re
import runpy
import shutil
import signal
import time
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import read_chain
from modaltouch.record.session import Session, read_session
from modaltouch.rig.simulator import Simulator

CUT_SHORT = Path(__file__).with_name("cut_short.py")
N_POINTS = int(os.environ.get("MODALTOUCH_KILL_POINTS", "44"))
FIRST_SEED = int(os.environ.get("MODALTOUCH_FIRST_SEED", "1"))
SOAK = os.environ.get("MODALTOUCH_SOAK_RESULTS", "")
PROTOCOLS = ("differentiated_stimulation", "with_catch_trials", "two_fields", "threshold")
"""Shipped protocols; the runs of the adaptive one are as short as the other sessions."""

KINDS = {
    "SIGKILL": 4,
    "SIGKILL in a stimulus": 3,
    "SIGKILL at a call": 4,
    "torn write": 2,
    "SIGTERM": 2,
    "SIGINT": 2,
    "SIGHUP": 1,
    "exception": 2,
    "rig fault": 2,
    "full disk": 2,
    "clock set back": 1,
}
"""Ways to end, and how often each comes in so many points, after each has come once."""

N_PARTICIPANTS = 3
"""How many participants a protocol has; each is cut short again, at other points, when the others have been."""

ATTEMPTS = 40
"""After so many cuts a session that never ends is a failure."""

OFF_WITHIN = 3.0
"""Longest time until the outputs are off after any end [s]."""


@dataclass
class Tally:
    """Results of the kill points."""

    points: Counter = field(default_factory=Counter)
    points_of: Counter = field(default_factory=Counter)
    exits: Counter = field(default_factory=Counter)
    answers_confirmed: int = 0
    answers_lost: int = 0
    changed_orders: int = 0
    outputs_on: int = 0
    invalid_views: int = 0
    cut_while_on: int = 0
    slowest_off_s: float = 0.0

    def add(self, other):
        """Add the points of another protocol."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            setattr(self, name, max(mine, value) if name == "slowest_off_s" else mine + value)


@pytest.fixture(scope="module")
def soaked():
    """Collect the results of all protocols, and write them for the soak."""
    tally = Tally()
    yield tally
    if SOAK:
        Path(SOAK).write_text(
            json.dumps({**vars(tally), "points_in_all": tally.points.total()}, indent=1, sort_keys=True) + "\n"
        )


@pytest.fixture(scope="module")
def simulator(protocol_path):
    """A rig that outlives the sessions, so that its outputs can be checked after each."""
    with Simulator(Apparatus.read(protocol_path.parent / "apparatus" / "beam_100x6x2.yaml")) as simulator:
        yield simulator


class Subject:
    """A participant whose session is interrupted repeatedly."""

    def __init__(self, context, simulator, protocol, results, participant):
        self.simulator = simulator
        self._context = context
        self._protocol, self._results, self._participant = protocol, results, participant
        self.name = protocol.stem
        self.log = results / "simulated" / self.name / f"sub-{participant}" / "ses-1" / "beh" / "session.jsonl"
        self._witness = results.parent / f"{results.name}-{participant}.witness"

    def start(self, cut):
        """Begin or continue in a separate process."""
        words = ("run", self._protocol, "-p", self._participant, "--rig", self.simulator.address, "--yes")
        words = (*words, "--answers", "simulated", "--results", self._results)
        if self.log.exists():
            words = ("resume", self.log.parent)
        plan = {"words": [str(word) for word in words], "cut": cut, "witness": str(self._witness)}
        process = self._context.Process(
            target=runpy.run_path, args=(str(CUT_SHORT),), kwargs={"init_globals": {"PLAN": plan}}
        )
        process.start()
        return process

    @property
    def confirmed(self):
        """Number of answers confirmed to the participant."""
        return self._witness.stat().st_size if self._witness.exists() else 0

    @property
    def answers(self):
        """All answers in the log, including superseded ones."""
        if not self.log.exists():
            return []
        return [
            (event["trial"]["practice"], event["trial"]["index"], event["trial"]["condition"], event["response"])
            for event in read_chain(self.log).events
            if event["event"] == "answered"
        ]

    @property
    def done(self):
        """Answers that count, in order, with their levels, without members that differ between presentations."""
        kept = read_session(self.log).trials if self.log.exists() else ()
        return [
            (e["trial"]["practice"], e["trial"]["index"], e["trial"]["condition"], e["response"]["answer"])
            for e in kept
            if e["confirmed"]["confirmed"]
        ]

    @property
    def complete(self):
        """Whether all trials are answered."""
        return self.log.exists() and read_session(self.log).complete


@pytest.fixture
def subject(context, simulator, protocol_path, tmp_path, tmp_path_factory):
    """Make participants whose sessions can be interrupted."""
    folder = tmp_path_factory.mktemp("shipped") / "protocols"
    shutil.copytree(protocol_path.parent, folder)
    for file in folder.glob("*.yaml"):
        # Nobody's fingers have to come back to the beam, and one burst is as good as many.
        text = re.sub(r"\n  pause_s: .*", "", file.read_text(encoding="utf-8"))
        text = re.sub(r"\n  presentation_s: .*", "\n  presentation_bursts: 1", text)
        text = re.sub(r"\n  question_delay_s: .*", "\n  question_delay_s: 0.15", text)
        # Half of the levels: as many ways to be cut in half of the time.
        text = text.replace("[80, 100, 150, 200]", "[80, 200]").replace("repetitions: 2", "repetitions: 1")
        file.write_text(
            text.replace("\nanswers:\n", "\nanswers:\n  pause_s: 0.0\n  settling_s: 0.0\n"), encoding="utf-8"
        )
    file = folder / "threshold.yaml"
    text = file.read_text(encoding="utf-8").replace("trials: 40", "trials: 12")
    file.write_text(text.replace("catch_trials: 10", "catch_trials: 3"), encoding="utf-8")
    return lambda participant, protocol, results="results": Subject(
        context, simulator, folder / f"{protocol}.yaml", tmp_path / results, participant
    )


def end(process, kind, rng, simulator, seconds):
    """End a session from outside at a seeded instant; return its exit status."""
    if kind.startswith("SIG") and kind.isalpha():
        process.join(rng.uniform(0, seconds))
        if process.exitcode is None:
            os.kill(process.pid, getattr(signal, kind))
    if kind == "rig fault":
        process.join(rng.uniform(0, seconds))
        fault = rng.choice(["unplugged", "power cycle", "lost_reply", "dropped_connection", "scpi_error"])
        if fault == "unplugged":
            simulator.server.refuse()
            simulator.server.drop_connections()
        elif fault == "power cycle":
            simulator.power_cycle()
        else:
            simulator.faults.inject(fault, times=50, value=-310.0)
        process.join(rng.uniform(0.5, 1.5))
        simulator.server.listen() if fault == "unplugged" else simulator.faults.clear()
    process.join(60)
    simulator.faults.clear()
    assert process.exitcode is not None, f"{kind}: the session did not end"
    return process.exitcode


def plan_of(kind, rng, seconds, size):
    """Return the plan for an interruption inside the process."""
    if kind == "SIGKILL in a stimulus":
        return {"stimulus": rng.randint(1, 12), "signal": int(signal.SIGKILL)}
    if kind == "SIGKILL at a call":
        return {"call": rng.randint(1, 400), "torn": 0.0}
    if kind == "torn write":
        return {"call": rng.randint(1, 400), "torn": rng.uniform(0.01, 0.99)}
    if kind == "exception":
        return {"raise_after_s": rng.uniform(0.02, seconds)}
    if kind == "full disk":
        return {"largest_file": size + rng.randint(0, 60_000)}
    if kind == "clock set back":
        return {"clock_back_s": rng.uniform(1, 1e5), "call": rng.randint(1, 400), "torn": 0.0}
    return {}


def seconds_until_off(simulator):
    """Wait until no output is on and return the time taken [s]; infinity if one stays on."""
    start, waited = time.monotonic(), 0.0
    while any(simulator.outputs):
        if waited > OFF_WITHIN:
            return math.inf
        time.sleep(0.001)
        waited = time.monotonic() - start
    return waited


def view_is_valid(log):
    """Return whether the BIDS view, as far as it exists, is complete and agrees with the log."""
    dataset = log.parents[3]
    try:
        for path in dataset.rglob("*.json"):
            json.loads(path.read_text(encoding="utf-8"))
        for path in dataset.rglob("*.tsv"):
            header, *rows = [line.split("\t") for line in path.read_text(encoding="utf-8").splitlines()]
            if any(len(row) != len(header) for row in rows):
                return False
    except ValueError:
        return False
    tables = list(log.parent.glob("*_beh.tsv")) if log.exists() else []
    answered = len(read_session(log).trials) if log.exists() else 0
    return all(answered - 1 <= len(table.read_text(encoding="utf-8").splitlines()) - 1 <= answered for table in tables)


def kinds_by_turns(rng):
    """Yield kinds of interruption in a random order: each once, then each with its frequency."""
    yield from rng.sample(list(KINDS), len(KINDS))
    while True:
        pack = [kind for kind, n in KINDS.items() for _ in range(n)]
        rng.shuffle(pack)
        yield from pack


def cut_until_complete(person, whole, seconds, rng, tally, kinds):
    """Interrupt a session once by each kind and let it end; count broken promises."""
    for _ in range(ATTEMPTS):
        kind = None if person.complete else next(kinds, None)
        if kind is None:
            break
        before = person.answers
        size = person.log.stat().st_size if person.log.exists() else 60_000
        status = end(person.start(plan_of(kind, rng, seconds, size)), kind, rng, person.simulator, seconds)
        tally.points[kind] += 1
        tally.points_of[person.name] += 1
        tally.exits[f"{kind}: {status}"] += 1
        off = seconds_until_off(person.simulator)
        tally.outputs_on += off == math.inf
        tally.cut_while_on += off > 0
        tally.slowest_off_s = max(tally.slowest_off_s, off)
        answers = person.answers
        tally.answers_lost += max(0, person.confirmed - len(answers)) + (answers[: len(before)] != before)
        tally.changed_orders += person.done != whole[: len(person.done)]
        tally.invalid_views += not view_is_valid(person.log)
    problems = audit_session(Session.find(person.log)).problems if person.complete else None
    if problems != ():  # a last line that was cut is declared by the one that a resumption writes
        assert end(person.start({}), "nothing", rng, person.simulator, seconds) == 0
        problems = audit_session(Session.find(person.log)).problems
    assert problems == ()
    assert person.done == whole
    tally.answers_confirmed += person.confirmed
    assert person.confirmed <= len(person.answers)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_no_kill_point_loses_an_answer_changes_an_order_or_leaves_an_output_on(
    subject, simulator, soaked, tmp_path, protocol
):
    """A quarter of the seeded points: 0 answers lost, 0 orders changed, 0 outputs on, 0 invalid views."""
    n_points, place = N_POINTS // len(PROTOCOLS), PROTOCOLS.index(protocol)
    kinds = islice(kinds_by_turns(random.Random(f"{FIRST_SEED} {protocol}")), n_points)
    tally, turn, uncut = Tally(), 0, {}
    while tally.points.total() < n_points:
        number = FIRST_SEED + len(PROTOCOLS) * turn + place
        rng, name = random.Random(number), f"p{number % (N_PARTICIPANTS * len(PROTOCOLS))}"
        if name not in uncut:
            person, begin = subject(name, protocol, f"whole-{name}"), time.monotonic()
            assert end(person.start({}), "nothing", rng, simulator, 0) == 0
            uncut[name] = person.done, time.monotonic() - begin
        cut_until_complete(subject(name, protocol), *uncut[name], rng, tally, kinds)
        turn += 1
        for folder in tmp_path.iterdir():
            shutil.rmtree(folder) if folder.is_dir() else folder.unlink()
    soaked.add(tally)
    assert (tally.answers_lost, tally.changed_orders, tally.outputs_on, tally.invalid_views) == (0, 0, 0, 0), tally
    assert tally.answers_confirmed > 0
    assert n_points < len(KINDS) or set(tally.points) == set(KINDS)
    assert n_points < 50 or tally.cut_while_on > 0, "no cut met a stimulus: nothing is proved of the outputs"
