"""Words to samples: the same ones in every session, at the level and rate asked for; or a refusal."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import resample_poly

from modaltouch.protocol import SpeechSection
from modaltouch.speech import espeak
from modaltouch.speech.espeak import find_voices, synthesise
from modaltouch.speech.interface import SpeechError
from modaltouch.speech.prompts import make_prompts

QUESTION = "Where did you feel the vibration?"
TEXTS = (QUESTION, "Time for a break.\n\nGo on whenever you feel ready.")


def test_the_same_words_give_the_same_samples_in_every_session() -> None:
    """Two processes, byte for byte; within one process eSpeak NG varies its tremor from call to call."""
    first = synthesise(TEXTS, "en", 160)
    synthesise.cache_clear()
    again = synthesise(TEXTS, "en", 160)
    assert first is not again
    assert all(np.array_equal(a, b) for a, b in zip(first.samples, again.samples, strict=True))
    assert first.library.startswith("eSpeak NG 1.")


def test_what_is_said_sounds_like_speech_of_its_length() -> None:
    """Six words at 160 a minute take 2.25 s, pauses of its own aside; most of a voice lies between 80 Hz and 4 kHz."""
    made = synthesise(TEXTS, "en", 160)
    samples = made.samples[0].astype(float)
    assert len(samples) / made.sampling_rate == pytest.approx(6 / 160 * 60, rel=0.3)
    power = np.abs(np.fft.rfft(samples)) ** 2
    frequency = np.fft.rfftfreq(len(samples), 1 / made.sampling_rate)
    assert power[(frequency > 80) & (frequency < 4000)].sum() > 0.8 * power.sum()


def test_twice_the_rate_takes_about_half_the_time() -> None:
    """80 and 160 words/min."""
    slow, fast = (len(synthesise(TEXTS[:1], "en", rate).samples[0]) for rate in (80, 160))
    assert slow / fast == pytest.approx(2, rel=0.2)


def test_another_language_or_voice_says_the_same_words_otherwise() -> None:
    """Expected: other samples from en, fr, and a variant of fr."""
    voices = ("en", "fr", "fr+f2")
    made = {synthesise(("Où avez-vous senti la vibration ?",), voice, 160).samples[0].tobytes() for voice in voices}
    assert len(made) == len(voices)


def test_the_voices_are_known_without_loading_the_library() -> None:
    """The languages of the shipped texts, and variants of a voice."""
    voices, variants = find_voices()
    assert {"en", "en-us", "fr"} <= voices
    assert "f2" in variants


@pytest.mark.parametrize(
    ("text", "voice", "said"),
    [("hello", "xx", "it has no voice 'xx'"), (" ", "en", "it cannot say ' '"), ("..", "en", "it cannot say '..'")],
)
def test_what_the_library_cannot_say_is_told(text: str, voice: str, said: str) -> None:
    """An unknown voice, and texts without a word."""
    with pytest.raises(SpeechError, match=r"eSpeak NG made no samples") as error:
        synthesise((text,), voice, 160)
    assert said in str(error.value)


def test_without_the_package_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: the extra that brings it."""
    monkeypatch.setattr(espeak, "find_spec", lambda name: None)
    with pytest.raises(SpeechError, match=r"espeakng-loader is not installed; install modaltouch\[speech\]"):
        synthesise(("never said before",), "en", 160)


def test_a_synthesis_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: no endless wait before a session; some texts made eSpeak NG speak for ever (its issue 1817)."""
    monkeypatch.setattr(espeak, "_PATIENCE", 1e-3 - 1)
    with pytest.raises(SpeechError, match="timed out.*look for odd signs in the texts"):
        synthesise(("never said before either",), "en", 160)


@pytest.mark.parametrize("level", [-30.0, -20.0])
@pytest.mark.parametrize("rate", [8000.0, 44_100.0, 48_000.0])
def test_all_prompts_together_have_the_level(level: float, rate: float) -> None:
    """0 dB FS is the rms of a sine of full scale (AES17); at 8 kHz what lies above 4 kHz is lost: 1 dB at most."""
    prompts = make_prompts(SpeechSection(level_dB_FS=level), "en", TEXTS, rate)
    heard = np.concatenate(list(prompts.samples.values())).astype(float)
    rms = math.sqrt(np.mean(heard**2))
    assert 20 * math.log10(rms / math.sqrt(0.5)) == pytest.approx(level, abs=1.0 if rate < 22_050 else 0.05)
    assert prompts.peak == np.abs(heard).max()


def test_the_device_s_rate_changes_nothing_that_is_heard() -> None:
    """Against scipy's polyphase filter, another method: a residue of less than -40 dB; the length to a sample."""
    made = synthesise(TEXTS, "en", 160)
    prompts = make_prompts(SpeechSection(), "en", TEXTS, 48_000.0)
    for words, source in zip(TEXTS, made.samples, strict=True):
        reference = resample_poly(source.astype(float), 320, 147)
        heard = prompts.samples[words].astype(float)
        assert abs(len(heard) - len(reference)) <= 1
        n = min(len(heard), len(reference))
        gain = heard[:n] @ reference[:n] / (reference[:n] @ reference[:n])
        assert np.sum((heard[:n] - gain * reference[:n]) ** 2) < 1e-4 * np.sum(heard**2)


def test_the_prompts_say_who_speaks_them() -> None:
    """What the record keeps: library, voice, and of every prompt its words, its length and a hash."""
    facts = make_prompts(SpeechSection(screens=("question",)), "en", TEXTS, 48_000.0).describe()
    assert facts["library"].startswith("eSpeak NG")
    assert (facts["voice"], facts["level_dB_FS"], facts["screens"]) == ("en", -20.0, ["question"])
    assert [each["words"] for each in facts["prompts"]] == list(TEXTS)
    assert len({each["sha256"] for each in facts["prompts"]}) == 2
