"""Prompts in the stream of the masking noise, in one of their own, and on a device that is lost or not there."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.apparatus import Sound
from modaltouch.masking.interface import Masking, MaskingError
from modaltouch.masking.noise import amplitude_at, make_noise
from modaltouch.masking.player import SoundOutput, open_masking
from modaltouch.protocol import MaskingSection, SpeechSection
from modaltouch.speech.interface import Silence, SpeechError
from modaltouch.speech.prompts import Prompts, make_prompts

NOISE = MaskingSection(noise="pink", level_dB_FS=-25.0, fade_s=0.05)
QUESTION = "Where did you feel the vibration?"
Told = list[tuple[str, dict[str, Any]]]


def prompts(**options: Any) -> Prompts:
    """Return the question, spoken by the real library."""
    return make_prompts(SpeechSection(**options), "en", (QUESTION,), 48_000.0)


def make(section: MaskingSection | None, spoken: Prompts | Silence) -> tuple[Masking, Told]:
    """Return an open stream and what it tells."""
    told: Told = []
    return open_masking(section, Sound(), lambda event, **facts: told.append((event, facts)), spoken), told


def test_a_prompt_is_heard_on_top_of_noise_that_stays_as_it_is(devices: list[Any]) -> None:
    """Stream less noise is the prompt, to a bit of float32; before and after, the noise alone; one device for both."""
    spoken = prompts()
    masking, _ = make(NOISE, spoken)
    masking.start()
    masking.ensure(lambda: devices[0].ask(2400))
    period = (make_noise("pink", 48_000.0) * amplitude_at(-25.0)).astype(np.float32)
    question = spoken.samples[QUESTION]
    before = devices[0].ask(1000)
    masking.speech.say(QUESTION)
    during = devices[0].ask(len(question))
    after = devices[0].ask(1000)
    played = np.concatenate([before, during, after])
    beneath = np.take(period, np.arange(2400, 2400 + len(played)), mode="wrap")
    assert np.array_equal(before[:, 0], beneath[:1000])
    assert np.abs(played[1000:-1000, 1] - beneath[1000:-1000] - question).max() < 1e-6
    assert np.array_equal(after[:, 1], beneath[-1000:])
    assert np.std(question) > 0.05
    assert np.abs(played).max() <= 1
    assert masking.is_on
    assert len(devices) == 1


def test_an_answer_stops_the_prompt_and_not_the_noise(devices: list[Any]) -> None:
    """Within 20 ms of samples nothing but the noise is left."""
    masking, told = make(NOISE, prompts())
    masking.start()
    masking.ensure(lambda: devices[0].ask(2400))
    masking.speech.say(QUESTION)
    devices[0].ask(24_000)
    masking.speech.hush()
    devices[0].ask(960)
    period = make_noise("pink", 48_000.0) * amplitude_at(-25.0)
    assert np.array_equal(devices[0].ask(500)[:, 0], period[27_360:27_860].astype(np.float32))
    masking.stop(hurry=True)
    assert [event for event, _ in told] == ["masking", "spoken", "masking"]
    assert told[1][1]["words"] == QUESTION
    assert told[1][1]["heard_s"] == pytest.approx(0.52, abs=1e-3)
    assert told[1][1]["whole"] is False


def test_without_masking_the_prompt_has_a_stream_of_its_own(devices: list[Any]) -> None:
    """Silence, the prompt, silence; nothing is said of masking."""
    spoken = prompts()
    output, told = make(None, spoken)
    output.start()
    output.ensure(lambda: pytest.fail("waits for no noise"))
    assert (devices[0].ask(100) == 0).all()
    output.speech.say(QUESTION)
    assert np.array_equal(devices[0].ask(len(spoken.samples[QUESTION]))[:, 0], spoken.samples[QUESTION])
    assert (devices[0].ask(100) == 0).all()
    assert output.describe() is None
    assert output.is_on is None
    facts = output.speech.describe()
    assert facts is not None
    assert (facts["state"], facts["device"], facts["latency_s"]) == ("spoken", "earphones", 0.1)
    output.stop(hurry=False)
    assert [event for event, _ in told] == ["spoken", "speech"]


@pytest.mark.parametrize("noise", [NOISE, None])
@pytest.mark.parametrize("required", [True, False])
def test_a_device_that_stays_away_ends_a_session_that_demands_speech(
    devices: list[Any],
    unplug: Callable[[Any], None],
    noise: MaskingSection | None,
    required: bool,
) -> None:
    """Before the next trial; where nothing lost is demanded, the session goes on and the record says what it lacks."""
    section = noise and noise.model_copy(update={"required": False})
    masking, told = make(section, prompts(required=required))
    masking.start()
    masking.ensure(lambda: devices[-1].ask(2400))
    unplug(devices[0])
    if required:
        with pytest.raises((SpeechError, MaskingError), match=r"there is no sound device.*speech.required: false"):
            masking.ensure(lambda: None)
        return
    for _ in range(2):
        masking.ensure(lambda: None)
    masking.speech.say(QUESTION)
    assert not masking.speech.is_speaking
    assert [event for event, _ in told].count("speech_lost") == 2
    assert [event for event, _ in told].count("masking_lost") == 2 * (noise is not None)


def test_a_device_that_comes_back_speaks_again(devices: list[Any]) -> None:
    """Opened again before the next trial."""
    masking, told = make(None, prompts())
    devices[0].active = False
    masking.ensure(lambda: None)
    masking.speech.say(QUESTION)
    assert np.abs(devices[1].ask(24_000)).max() > 0.1
    assert [(event, facts.get("state")) for event, facts in told] == [("speech_lost", None), ("speech", "on again")]


@pytest.mark.parametrize("required", [True, False])
def test_without_a_device_speech_is_refused_or_recorded_as_lacking(
    in_a_process: Any,
    no_device: Path,
    required: bool,
) -> None:
    """A protocol that demands it does not begin; one that does not goes on, its record saying why it is silent."""
    script = f"""
import json
from modaltouch.apparatus import Sound
from modaltouch.masking.player import open_masking
from modaltouch.protocol import SpeechSection
from modaltouch.speech.interface import SpeechError
from modaltouch.speech.prompts import make_prompts
told = []
prompts = make_prompts(SpeechSection(required={required}), "en", ("hello",), 48000.0)
try:
    masking = open_masking(None, Sound(), lambda event, **facts: told.append(event), prompts)
    print(json.dumps([masking.speech.describe(), masking.describe(), told]))
except SpeechError as error:
    print(json.dumps(str(error)))
"""
    run = in_a_process(script, no_device)
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout.splitlines()[-1])
    if required:
        assert said.startswith("no prompts can be spoken: there is no sound device")
        assert said.endswith("or set speech.required: false")
    else:
        assert said[0]["state"] == "silent"
        assert "no sound device" in said[0]["reason"]
        assert said[1:] == [None, ["speech_lost"]]


def test_prompts_that_could_not_be_made_leave_the_noise_alone(devices: list[Any]) -> None:
    """Not demanded and the library absent: masked all the same, and the record says why it is silent."""
    masking, told = make(NOISE, Silence("no library"))
    assert isinstance(masking, SoundOutput)
    assert masking.speech.describe() == {"state": "silent", "reason": "no library"}
    assert told == [("speech_lost", {"reason": "no library"})]
    nothing, _ = make(None, Silence("no library"))
    assert nothing.speech.describe() == {"state": "silent", "reason": "no library"}
    assert len(devices) == 1
