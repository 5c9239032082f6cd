"""Sessions in separate processes, so that they can be killed."""

import multiprocessing
import os
import random
import signal
import time
from pathlib import Path

import pytest
from quickly import run

from modaltouch.record.chain import read_chain

REPOSITORY = Path(__file__).parents[2]
PROTOCOL = REPOSITORY / "protocols" / "differentiated_stimulation.yaml"


@pytest.fixture(scope="session")
def context():
    """Processes forked from a server that has loaded the imports."""
    context = multiprocessing.get_context("forkserver")
    # questplus brings pandas and xarray along, which a session of fixed levels does not load; xarray in its turn looks
    # for pint, which is here with the tests' own tools.
    context.set_forkserver_preload(
        ["modaltouch.session.wiring", "modaltouch.cli.run", "modaltouch.rig.generator", "modaltouch.rig.simulator"]
        + ["modaltouch.session.console.consoles", "rich.table", "questplus", "pint"]
    )
    return context


@pytest.fixture
def start(context):
    """Start ``modaltouch`` with some arguments in a separate process."""
    started = []

    def begin(*words):
        process = context.Process(target=run, args=([str(word) for word in words],))
        process.start()
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.join()


@pytest.fixture
def finish(start):
    """Run ``modaltouch`` with some arguments and return the exit status."""

    def run(*words, timeout=150):
        process = start(*words)
        process.join(timeout)
        assert process.exitcode is not None, f"{words} did not end within {timeout} s"
        return process.exitcode

    return run


@pytest.fixture
def wait_for_trials():
    """Wait until a session log has a number of answers."""
    return _wait_for_trials


@pytest.fixture
def answers_of():
    """Return (practice, index, condition, answer) of every answer in a log, in order."""
    return _answers_of


def _wait_for_trials(log, n_trials, timeout=100.0):
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if log.exists() and log.read_bytes().count(b'"event":"trial"') >= n_trials:
            return
        time.sleep(0.001)
    pytest.fail(f"{log} did not reach {n_trials} answers within {timeout} s")


def _answers_of(log):
    return [
        (event["trial"]["practice"], event["trial"]["index"], event["trial"]["condition"], event["response"]["answer"])
        for event in read_chain(log).events
        if event["event"] == "trial"
    ]


@pytest.fixture
def log_of():
    """Return the log of a participant's simulated session."""

    def place(results, participant, session=1):
        folder = results / "simulated" / "differentiated_stimulation" / f"sub-{participant}" / f"ses-{session}"
        return folder / "beh" / "session.jsonl"

    return place


@pytest.fixture
def kill():
    """Send a signal to a process and wait for its end."""

    def send(process, number):
        os.kill(process.pid, number)
        process.join(30)
        assert process.exitcode is not None, f"signal {number} did not end the session within 30 s"
        return process.exitcode

    return send


@pytest.fixture
def kill_after(start, tmp_path):
    """Start a session, kill it some time after a number of answers, and return its log."""

    def begin(words, log_in, n_trials, seed):
        chance = random.Random(seed)
        # Where the machine has other things to do, a simulated session may be over before this process sees it run.
        for attempt in range(10):
            results = tmp_path / f"attempt_{attempt}"
            session, log = start(*words, "--results", results), log_in(results)
            _wait_for_trials(log, n_trials)
            session.join(chance.uniform(0, 0.04))
            session.kill()
            session.join(30)
            if session.exitcode == -signal.SIGKILL:
                return log
        pytest.fail(f"ten sessions were over before they could be killed after {n_trials} answers")

    return begin


@pytest.fixture(scope="session")
def protocol_path():
    """The paper's experiment."""
    return PROTOCOL
