"""One prompt at a time on top of what a stream plays: whole, cut, replaced; no device is opened."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.protocol import SpeechSection
from modaltouch.speech.prompts import Prompts
from modaltouch.speech.voice import FADE, Voice

RATE = 8000.0
N_FADE = round(FADE * RATE)


def make(**samples: np.ndarray) -> tuple[Voice, list[dict[str, Any]]]:
    """Return a voice that knows some words, and what it tells."""
    told: list[dict[str, Any]] = []
    sounds = {words: each.astype(np.float32) for words, each in samples.items()}
    prompts = Prompts(SpeechSection(), "en", "eSpeak NG", RATE, sounds, dict.fromkeys(sounds, ""))
    return Voice(prompts, lambda event, **facts: told.append({"event": event, **facts})), told


def listen(voice: Voice, n: int, *, size: int = 64, beneath: float = 0.0) -> np.ndarray:
    """Return what is heard in one channel, asked for in blocks."""
    heard = []
    while n > 0:
        block = np.full((min(size, n), 2), beneath, dtype=np.float32)
        voice.mix(block)
        assert np.array_equal(block[:, 0], block[:, 1])
        heard.append(block[:, 0])
        n -= size
    return np.concatenate(heard)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 700), st.integers(1, 600))
def test_a_prompt_is_added_whole_however_the_device_asks(n: int, size: int) -> None:
    """Expected: what was beneath, and on it the very samples of the prompt, then what was beneath again."""
    sound = np.random.default_rng(n).uniform(-0.3, 0.3, n)
    voice, told = make(hello=sound)
    voice.say("hello")
    heard = listen(voice, 800, size=size, beneath=0.25)
    assert np.array_equal(heard[:n], np.float32(0.25) + sound.astype(np.float32))
    assert (heard[n:] == 0.25).all()
    assert not voice.is_speaking
    voice.write_down()
    assert told[0]["words"] == "hello"
    assert told[0]["whole"] is True
    assert told[0]["heard_s"] == pytest.approx(n / RATE, abs=1e-3)


def test_a_prompt_that_is_cut_falls_silent_in_20_ms_without_a_jump() -> None:
    """On a constant: along half a sine, never faster than its steepest slope; then nothing."""
    voice, told = make(long=np.ones(5000))
    voice.say("long")
    listen(voice, 1000)
    voice.hush()
    heard = listen(voice, 1000)
    assert np.abs(np.diff(np.concatenate([[1.0], heard[: N_FADE + 1]]))).max() < 1.01 * np.pi / 2 / N_FADE
    assert (heard[N_FADE:] == 0).all()
    assert heard[N_FADE // 2] == pytest.approx(0.5, abs=0.02)
    voice.write_down()
    (said,) = told
    assert said["whole"] is False
    assert said["heard_s"] == pytest.approx((1000 + N_FADE) / RATE, abs=1e-3)


def test_another_prompt_follows_the_fade_of_the_one_before() -> None:
    """Expected: 20 ms of fade, then the new one from its first sample."""
    voice, told = make(old=np.ones(5000), new=np.full(100, -0.5))
    voice.say("old")
    listen(voice, 500)
    voice.say("new")
    heard = listen(voice, 400)
    assert (heard[:N_FADE] >= 0).all()
    assert (heard[N_FADE : N_FADE + 100] == -0.5).all()
    assert (heard[N_FADE + 100 :] == 0).all()
    voice.write_down()
    assert [(said["words"], said["whole"]) for said in told] == [("old", False), ("new", True)]


def test_the_same_words_again_are_said_again() -> None:
    """The question of the next trial is the same text."""
    voice, _ = make(question=np.ones(100))
    for _ in range(2):
        voice.say("question")
        assert listen(voice, 200).sum() == 100


def test_what_is_answered_before_it_was_heard_is_written_down_as_unheard() -> None:
    """Hushed before the device asked for a sample."""
    voice, told = make(question=np.ones(100))
    voice.say("question")
    voice.hush()
    assert (listen(voice, 200) == 0).all()
    voice.write_down()
    assert (told[0]["began_s"], told[0]["heard_s"], told[0]["whole"]) == (None, 0, False)


def test_what_is_still_said_is_written_down_when_it_is_over() -> None:
    """Once, with how much of it was heard."""
    voice, told = make(long=np.ones(5000))
    voice.say("long")
    listen(voice, 100)
    voice.write_down()
    assert told == []
    assert voice.is_speaking
    listen(voice, 5000)
    voice.write_down()
    voice.write_down()
    assert [said["whole"] for said in told] == [True]


def test_words_it_has_no_samples_for_end_what_is_said() -> None:
    """A picture that is not spoken has no words."""
    voice, _ = make(long=np.ones(5000))
    voice.say("long")
    listen(voice, 100)
    voice.say("")
    listen(voice, N_FADE)
    assert not voice.is_speaking
