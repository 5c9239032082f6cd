"""Whole sessions through the real window with real key presses, on a rig in a separate process."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import pyvisa
from Xlib import XK, X, display
from Xlib.error import ConnectionClosedError
from Xlib.ext import xtest

from modaltouch.record.session import read_session
from modaltouch.window.machine import virtual_display

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"


class Hands:
    """Press keys on an X display."""

    KEYS = ("space", "Left", "Escape", "q")

    def __init__(self, name):
        self._display = display.Display(name)
        self._codes = {key: self._display.keysym_to_keycode(XK.string_to_keysym(key)) for key in self.KEYS}

    def press(self, key):
        for kind in (X.KeyPress, X.KeyRelease):
            xtest.fake_input(self._display, kind, self._codes[key])
            self._display.sync()
            time.sleep(0.03)

    @contextmanager
    def hurrying(self):
        """Type Space and the left arrow alternately, as fast as a hurried participant."""
        stop = threading.Event()

        def type_on():
            while not stop.wait(0.15):
                for key in ("space", "Left"):
                    self.press(key)

        thread = threading.Thread(target=type_on, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        with suppress(ConnectionClosedError):
            self._display.close()


@pytest.fixture
def protocol(edit):
    """The demonstration without pauses between trials."""
    return edit("demo.yaml", ("\nanswers:\n", "\nanswers:\n  pause_s: 0.2\n  settling_s: 0.05\n"))


@pytest.fixture
def rig():
    """The VISA address of a simulator in a separate process."""
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--apparatus", str(APPARATUS)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process.stdout.readline().strip()
        process.terminate()


@pytest.fixture
def outputs(rig):
    """Return which outputs are on, over another link, which the lock on this machine does not block."""
    resource = pyvisa.ResourceManager("@py").open_resource(rig)
    resource.timeout = 5000
    yield lambda: (resource.query("OUTP1?").strip(), resource.query("OUTP2?").strip())
    resource.close()


@contextmanager
def session(display_name, *words):
    """Run ``modaltouch`` with some arguments on a display."""
    command = [sys.executable, "-m", "modaltouch", *map(str, words)]
    environment = {**os.environ, "DISPLAY": display_name}
    with subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until(holds, what, timeout=120.0):
    """Wait until a condition holds."""
    end = time.monotonic() + timeout
    while not holds():
        assert time.monotonic() < end, f"{what} did not come true within {timeout} s"
        time.sleep(0.005)


def n_answers(log):
    """Count the answers in a session log."""
    return log.read_bytes().count(b'"event":"trial"') if log.exists() else 0


@pytest.mark.window
def test_a_session_survives_the_death_of_its_display(tmp_path, protocol, rig, outputs):
    """Xlib would end the process (status 1); the session stops as at any lost window, and another display resumes."""
    log = tmp_path / "simulated" / "demo" / "sub-p01" / "ses-1" / "beh" / "session.jsonl"
    with (
        virtual_display((1280, 800)) as name,
        session(name, "run", protocol, "-p", "p01", "--rig", rig, "--results", tmp_path) as run,
        Hands(name) as hands,
    ):
        with hands.hurrying():
            wait_until(lambda: n_answers(log) >= 3, "three answers")
        wait_until(lambda: (hands.press("space"), outputs())[1] == ("1", "1"), "a stimulus")
        # The newest server that this process started; another test may keep an older one.
        subprocess.run(["pkill", "-KILL", "-n", "-P", str(os.getpid()), "Xvfb"], check=True)
        assert run.wait(20) == 3
        said = run.stderr.read()
        assert f"the display {name!r} is gone" in said
        assert "continue with `modaltouch resume" in said
        assert "Traceback" not in said
        wait_until(lambda: outputs() == ("0", "0"), "both outputs off", timeout=5)
    assert [event["reason"] for event in read_session(log).events if event["event"] == "stop"] == ["window lost"]
    kept = n_answers(log)
    assert kept >= 3
    with (
        virtual_display((1280, 1024)) as name,
        session(name, "resume", log.parent) as run,
        Hands(name) as hands,
        hands.hurrying(),
    ):
        assert run.wait(120) == 0, run.stderr.read()
    recorded = read_session(log)
    assert recorded.problems == ()
    assert recorded.complete
    assert recorded.mode == "simulated", "a simulator's data never land among real ones, whatever its address"
    assert {event["response"]["answer"] for event in recorded.trials} == {"left"}
    assert {event["response"]["answered_by"] for event in recorded.trials} == {"participant"}
    assert {event["response"]["device"] for event in recorded.trials} == {"key"}
    assert len({(event["trial"]["practice"], event["trial"]["index"]) for event in recorded.trials}) == len(
        recorded.trials
    )
    assert outputs() == ("0", "0")


@pytest.mark.window
@pytest.mark.parametrize("ending", ["escape", "SIGTERM"])
def test_a_session_ended_on_purpose_is_kept_with_outputs_off(tmp_path, protocol, rig, outputs, ending):
    """Escape asks first, then Q ends; SIGTERM ends immediately. Exit status 130, reason in the record."""
    log = tmp_path / "simulated" / "demo" / "sub-p01" / "ses-1" / "beh" / "session.jsonl"
    with (
        virtual_display((1280, 800)) as name,
        session(name, "run", protocol, "-p", "p01", "--rig", rig, "--results", tmp_path) as run,
        Hands(name) as hands,
    ):
        with hands.hurrying():
            wait_until(lambda: n_answers(log) >= 2, "two answers")
        wait_until(lambda: (hands.press("space"), outputs())[1] == ("1", "1"), "a stimulus")
        if ending == "escape":
            hands.press("Escape")
            wait_until(lambda: outputs() == ("0", "0"), "both outputs off while it asks", timeout=5)
            assert run.poll() is None
            wait_until(lambda: (hands.press("q"), run.poll())[1] is not None, "the end", timeout=60)
        else:
            run.send_signal(signal.SIGTERM)
        assert run.wait(20) == 130
    assert outputs() == ("0", "0")
    recorded = read_session(log)
    assert recorded.problems == ()
    assert recorded.events[-1]["event"] == "stop"
    assert recorded.events[-1]["reason"] == ending
