"""Whether a session is simulated, a pilot or real is decided in one place, and kept when it is resumed."""

from dataclasses import replace
from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.record.chain import RecordError
from modaltouch.session.console import Console, Request
from modaltouch.session.resumption import wire_resume
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run
from modaltouch.window import WindowOptions
from modaltouch.window.interface import Masking, SessionStopped

PROTOCOL = Path(__file__).parents[2] / "protocols" / "demo.yaml"
ADDRESS = "TCPIP::192.0.2.1::INSTR"


@pytest.fixture(scope="module")
def preflight():
    """The demonstration, checked."""
    return examine(PROTOCOL).require()


class Keys(Console):
    """A console with given requests, which continues from every pause."""

    def __init__(self):
        self.asked, self.was = [], ""

    def show(self, facts):
        if facts["state"] == "paused" != self.was:
            self.asked.append(Request("go_on"))
        self.was = facts["state"]

    def requests(self):
        asked, self.asked = self.asked, []
        return asked


def test_a_pause_requested_during_a_fade_is_kept(preflight, tmp_path):
    """It takes effect as soon as the window waits for events."""
    keys = Keys()

    class Fading(Masking):
        requests = (Request("pause"),)

        def ensure(self, tick, *, on=True):
            keys.asked += self.requests
            self.requests = ()
            tick()

    setup = wire_run(preflight, "p01", answers="simulated", results=tmp_path)
    session = begin(replace(setup, console=keys, open_masking=lambda log: Fading()))
    assert session.complete
    assert [event["by"] for event in session.events if event["event"] == "pause"] == ["experimenter"]


@pytest.mark.parametrize(
    ("rig", "answers", "pilot", "mode"),
    [
        (ADDRESS, "window", False, "real"),
        (ADDRESS, "window", True, "pilot"),
        ("simulated", "window", False, "simulated"),
        ("simulated", "window", True, "simulated"),
        (ADDRESS, "robot", False, "simulated"),
        (ADDRESS, "simulated", True, "simulated"),
    ],
)
def test_a_session_with_any_simulated_part_is_simulated(preflight, rig, answers, pilot, mode):
    """The mode is also the folder and cannot be chosen."""
    setup = wire_run(preflight, "p01", rig=rig, answers=answers, pilot=pilot)
    assert setup.place.mode == mode


def test_a_session_cannot_be_resumed_in_another_mode(preflight, tmp_path):
    """A simulated session resumed by a person at a real rig would be neither."""
    session = begin(wire_run(preflight, "p01", answers="simulated", results=tmp_path))
    with pytest.raises(RecordError, match="would continue as another kind"):
        wire_resume(session.path, rig=ADDRESS, answers="window")


def test_a_simulated_participant_is_masked_without_a_sound_device(edit, tmp_path):
    """No noise is played; the record has masking by the twin."""
    old = "answers:\n  given_by"
    demanding = examine(edit("demo.yaml", (old, f"masking: {{level_dB_FS: -20}}\n{old}"))).require()
    for answers in ("simulated", "robot"):
        with wire_run(demanding, "p01", answers=answers).open_masking(lambda event, **facts: None) as masking:
            said = masking.describe()
            assert (said["state"], said["level_dB_FS"], said["device"]) == ("masked", -20, "simulated")
    session = begin(wire_run(demanding, "p01", answers="simulated", results=tmp_path))
    assert session.start["masking"]["device"] == "simulated"
    assert {event["masked"] for event in session.trials} == {True}
    table = next(session.path.parent.glob("*_beh.tsv")).read_text().splitlines()
    assert table[0].split("\t")[-1] == "masked"
    assert {row.split("\t")[-1] for row in table[1:]} == {"1"}


@pytest.mark.parametrize(
    ("recorded", "given", "opened"),
    [
        (
            {"size_px": [1024, 768], "fullscreen": False, "monitor": 1, "theme": "light"},
            {},
            WindowOptions((1024, 768), False, "light", 1),
        ),
        (
            {"size_px": [1024, 768], "fullscreen": False, "monitor": 1, "theme": "light"},
            {"theme": "dark", "screen": 0},
            WindowOptions((1024, 768), False, "dark", 0),
        ),
        (
            {"size_px": [1920, 1080], "fullscreen": True, "monitor": 0, "theme": "dark"},
            {},
            WindowOptions(fullscreen=True),
        ),
        ({"size_px": [1920, 1080], "fullscreen": True, "theme": "dark"}, {"fullscreen": False}, WindowOptions()),
        ({"backend": "psychopy", "size_px": [800, 600]}, {}, WindowOptions((800, 600))),
    ],
)
def test_a_resumed_window_keeps_its_options(preflight, tmp_path, recorded, given, opened):
    """A full screen has the monitor's size; older records have defaults."""
    setup = wire_run(preflight, "p01", answers="simulated", results=tmp_path)

    def open_window(tick, log):
        def leave(trial):
            raise SessionStopped("experimenter")

        window = setup.open_window(tick, log)
        window.describe, window.welcome = lambda: recorded, leave
        return window

    with pytest.raises(SessionStopped):
        begin(replace(setup, open_window=open_window))
    again = wire_resume(setup.place.log, window=given)
    assert again.open_window.__self__.window_options == opened
