"""Masking noise on a device: ALSA's null device in a separate process, no device, and a lost device."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import sounddevice

from modaltouch.protocol import MaskingSection
from modaltouch.protocol.apparatus import Apparatus, Sound
from modaltouch.window import masking as player
from modaltouch.window.interface import Masking, MaskingError
from modaltouch.window.masking import PlayedMasking, amplitude_at, make_noise

SECTION = MaskingSection(noise="pink", level_dB_FS=-20.0, fade_s=0.05)
ALSA = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ALSA is Linux's")


@ALSA
def test_the_device_gets_the_noise_faded_in_and_out(in_a_process: Any, null_device: Path) -> None:
    """It gets silence, a fade, the period at -20 dB FS and a fade, and is then released."""
    script = """
import json
import numpy as np
from modaltouch.protocol.apparatus import Apparatus, Sound
from modaltouch.window.masking import PlayedMasking, amplitude_at, make_noise
from modaltouch.protocol import MaskingSection

events, blocks = [], []
section = MaskingSection(noise="pink", level_dB_FS=-20.0, fade_s=0.05)
apparatus = Apparatus.model_construct(sound=Sound())
masking = PlayedMasking(section, apparatus, lambda event, **facts: events.append((event, facts)))
fill = masking._playback.fill
def spy(out):
    fill(out)
    if sum(map(len, blocks)) < 96000 and out.any():
        blocks.append(out.copy())
masking._playback.fill = spy
with masking:
    described = masking.describe()
    masking.start()
    masking.ensure(lambda: None)
    on = masking.is_on
    while sum(map(len, blocks)) < 96000:
        masking.ensure(lambda: None)
    masking.stop(hurry=False)
    masking.stop(hurry=False)
played = np.concatenate(blocks)[:96000]
period = make_noise("pink", 48000.0) * amplitude_at(-20.0)
print(json.dumps({
    "described": described, "on": on, "channels": played.shape[1], "events": events,
    "fade": float(np.abs(played[:2400, 0]).max() <= np.abs(period[:2400]).max()),
    "same": bool(np.array_equal(played[2400:, 0], period[2400:96000].astype(np.float32))),
    "peak": float(np.abs(played).max()), "closed": masking._stream is None,
}))
"""
    run = in_a_process(script, null_device)
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    assert told["on"] is True
    assert told["same"] is True
    assert told["fade"] == 1
    assert told["channels"] == 2
    assert told["closed"] is True
    assert 0 < told["peak"] < 1
    assert told["described"]["device"] == "default"
    assert told["described"]["level_dB_FS"] == -20
    assert told["events"] == [["masking", {"state": "on"}], ["masking", {"state": "off", "n_underflows": 0}]]


@ALSA
def test_without_a_device_masking_is_refused_or_recorded_as_missing(in_a_process: Any, no_device: Path) -> None:
    """A protocol that requires it does not begin; otherwise the record has the reason."""
    script = """
import json
from modaltouch.protocol.apparatus import Apparatus, Sound
from modaltouch.window.masking import MaskingError, MaskingNoise
from modaltouch.protocol import MaskingSection
said = {}
for required in (True, False):
    section = MaskingSection(noise="white", level_dB_FS=-20.0, required=required)
    try:
        masking = MaskingNoise(section, Apparatus.model_construct(sound=Sound())).open(lambda event, **facts: None)
        said[str(required)] = [masking.describe(), masking.is_on]
    except MaskingError as error:
        said[str(required)] = str(error)
print(json.dumps(said))
"""
    run = in_a_process(script, no_device)
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout.splitlines()[-1])
    assert "there is no sound device" in told["True"]
    assert "masking.required: false" in told["True"]
    (described, is_on) = told["False"]
    assert described["state"] == "not masked"
    assert "no sound device" in described["reason"]
    assert is_on is False


@ALSA
@pytest.mark.parametrize(("there", "state"), [(True, "ok"), (False, "warning")])
def test_the_doctor_reports_the_sound_device(
    in_a_process: Any,
    no_card: str,
    null_device: Path,
    there: bool,
    state: str,
) -> None:
    """A missing device is a warning, since only some protocols need it."""
    if not there:
        null_device.write_text(no_card)
    script = """
import json
from modaltouch.window import machine
print(json.dumps(machine._sound(quick=False)._asdict()))
"""
    run = in_a_process(script, null_device)
    assert run.returncode == 0, run.stderr
    sound = json.loads(run.stdout.splitlines()[-1])
    assert sound["state"] == state
    assert ("default" in sound["found"]) == there
    assert bool(sound["remedy"]) != there


@ALSA
def test_a_session_that_requires_noise_does_not_begin_without_a_device(
    in_a_process: Any, tmp_path: Path, no_device: Path, edit: Any
) -> None:
    """Exit status 3 with the remedy, before any window or record."""
    old = "answers:\n  given_by"
    protocol = edit("demo.yaml", (old, "masking: {noise: pink, level_dB_FS: -20}\n" + old))
    words = ["run", str(protocol), "-p", "p01", "--rig", "simulated", "--yes", "--results", str(tmp_path / "results")]
    script = f"import sys; from modaltouch.__main__ import main; sys.argv = ['modaltouch']; main({words!r})"
    run = in_a_process(script, no_device)
    assert run.returncode == 3
    assert "there is no sound device" in run.stderr
    assert "required: false" in run.stderr
    assert not list((tmp_path / "results").rglob("session.jsonl"))


def events_of(log: list[tuple[str, dict[str, Any]]]) -> list[str]:
    """Return the events as short strings."""
    return [f"{name} {facts.get('state', '')}".strip() for name, facts in log]


def make(section: MaskingSection) -> tuple[PlayedMasking, list[tuple[str, dict[str, Any]]]]:
    """Return masking and its events."""
    log: list[tuple[str, dict[str, Any]]] = []
    return PlayedMasking(
        section,
        Apparatus.model_construct(sound=Sound(full_scale_dB_SPL=100.0)),
        lambda event, **facts: log.append((event, facts)),
    ), log


def test_a_trial_waits_until_the_noise_is_faded_in(devices: list[Any]) -> None:
    """50 ms of samples, requested by the device during the session's ticks."""
    masking, _ = make(SECTION)
    assert masking.is_on is False
    masking.start()
    ticks = []

    def tick() -> None:
        ticks.append(1)
        devices[0].ask(240)

    masking.ensure(tick)
    assert len(ticks) == 10
    assert masking.is_on
    period = make_noise("pink", 48_000.0) * amplitude_at(-20.0)
    assert np.array_equal(devices[0].ask(100)[:, 1], period[2400:2500].astype(np.float32))


def test_a_stimulus_without_masking_waits_for_silence(devices: list[Any]) -> None:
    """The noise fades out before it, and in again before the next trial with masking."""
    masking, log = make(SECTION)
    masking.start()
    masking.ensure(lambda: devices[0].ask(2400))
    masking.ensure(lambda: devices[0].ask(2400), on=False)
    assert masking.is_on is False
    assert not devices[0].ask(100).any()
    masking.ensure(lambda: devices[0].ask(2400))
    assert masking.is_on
    assert devices[0].ask(100).any()
    assert [facts["state"] for event, facts in log if event == "masking"] == ["on", "silent", "on"]


def test_the_level_at_the_ear_follows_from_the_calibration() -> None:
    """If a full-scale sine gives 100 dB SPL, 60 dB SPL are -40 dB FS."""
    section = MaskingSection(noise="pink", level_dB_SPL=60.0)
    assert section.level(Sound(full_scale_dB_SPL=100.0)) == -40
    assert section.level(Sound()) is None


@pytest.mark.parametrize("required", [True, False])
def test_a_device_that_stays_away_ends_the_session_or_is_recorded(
    devices: list[Any],
    required: bool,
) -> None:
    """If masking is required: MaskingError before the next trial; otherwise silence."""
    masking, log = make(SECTION.model_copy(update={"required": required}))
    masking.start()
    masking.ensure(lambda: devices[-1].ask(2400))
    devices[0].active = False
    assert masking.is_on is False
    if required:
        with pytest.raises(MaskingError, match="accepts no more samples; connect it again and resume"):
            masking.ensure(lambda: None)
        assert events_of(log) == ["masking on", "masking_lost"]
        return
    masking.ensure(lambda: None)
    masking.ensure(lambda: None, on=False)
    masking.ensure(lambda: None)
    assert masking.is_on is False
    assert events_of(log) == ["masking on", "masking_lost"]


def test_a_device_that_requests_no_samples_is_lost(devices: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """PortAudio reports some lost devices as active; one that takes no samples for a second is lost until it does."""
    masking, log = make(SECTION)
    masking.start()
    masking.ensure(lambda: devices[-1].ask(2400))
    now = time.perf_counter()
    monkeypatch.setattr(player.time, "perf_counter", lambda: now + 1.5)
    assert masking.is_on is False
    assert events_of(log) == ["masking on", "masking_lost"]
    devices[0].ask(2400)
    assert masking.is_on is False, "not in this trial"
    masking.ensure(lambda: devices[0].ask(2400))
    assert masking.is_on
    assert events_of(log) == ["masking on", "masking_lost", "masking on again"]


class Stuck:
    """A stream that opens but does not start."""

    closed: ClassVar[list[Any]] = []

    def __init__(self, **options: Any) -> None:
        self.options = options

    def start(self) -> None:
        raise sounddevice.PortAudioError("Device unavailable")

    def close(self) -> None:
        self.closed.append(self)


@pytest.mark.usefixtures("devices")
def test_a_device_that_does_not_start_is_released(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error has the remedy, and the device is closed for other programs."""
    monkeypatch.setattr(sounddevice, "OutputStream", Stuck)
    with pytest.raises(MaskingError, match="'earphones' refuses 48000 Hz .*change sound.sampling_rate_Hz"):
        make(SECTION)
    assert len(Stuck.closed) == 1


def test_without_masking_in_the_protocol_nothing_is_opened() -> None:
    """Nothing is recorded either."""
    masking = Masking()
    assert masking.describe() is None
    assert masking.is_on is None
