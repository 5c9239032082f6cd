"""Before anybody sits down: a voice nobody has, a level that clips, a machine that cannot speak."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modaltouch.preflight import examine, examine_findings
from modaltouch.preflight.speech import prepare_prompts
from modaltouch.protocol import examine_files
from modaltouch.speech import espeak
from modaltouch.speech.espeak import synthesise
from modaltouch.speech.interface import Silence, SpeechError
from modaltouch.speech.prompts import make_prompts

Edit = Callable[..., Path]
OLD = "answers:\n  given_by"


@pytest.fixture
def spoken(edit: Edit) -> Callable[..., Path]:
    """Return a function that gives the demonstration sections of its own."""

    def change(speech: str = "", masking: str = "", *texts: tuple[str, str]) -> Path:
        if texts:
            edit("texts/english.yaml", *texts)
        noise = f"masking: {{{masking}}}\n" if masking else ""
        return edit("demo.yaml", (OLD, f"speech: {{{speech}}}\n{noise}{OLD}"))

    return change


@pytest.fixture
def no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the library away, and what it has said before."""
    make_prompts.cache_clear()
    synthesise.cache_clear()
    monkeypatch.setattr(espeak, "find_spec", lambda name: None)


@pytest.mark.parametrize(
    ("speech", "masking", "fault"),
    [
        ("voice: fr-fr", "", "speech.voice: given 'fr-fr', and eSpeak NG has no voice 'fr-fr'"),
        ("voice: en+sings", "", "has no variant 'sings'"),
        ("voice: 'en; rm'", "", "speech.voice: given 'en; rm'"),
        ("screens: [questions]", "", "speech.screens[0]: given 'questions'"),
        ("screens: []", "", "speech.screens"),
        ("screens: [break, break]", "", "speech.screens[1]: given break, the screen of screens[0] again"),
        ("rate_words_per_min: 1000", "", "speech.rate_words_per_min: given 1000"),
        ("level_dB_FS: -5", "", "speech.level_dB_FS: given -5 dB FS, at which the peaks of the speech pass full scale"),
        ("level_dB_FS: -18", "level_dB_FS: -14", "the peaks of the speech on top of the masking noise pass full scale"),
    ],
)
def test_speech_that_cannot_be_as_asked_is_a_fault(
    spoken: Callable[..., Path], speech: str, masking: str, fault: str
) -> None:
    """Told with its place before anybody sits."""
    problems = [str(each) for each in examine(spoken(speech, masking)).problems]
    assert any(fault in each and "demo.yaml:" in each for each in problems)


def test_the_level_that_is_allowed_is_allowed(spoken: Callable[..., Path]) -> None:
    """What the refusal names as the highest level passes, and a tenth of a decibel more does not."""
    file = spoken("level_dB_FS: -1")
    (problem,) = examine(file).problems
    highest = float(problem.allowed.removeprefix("at most ").removesuffix(" dB FS"))
    text = file.read_text(encoding="utf-8")
    for level, n_problems in ((highest, 0), (highest + 0.1, 1)):
        file.write_text(text.replace("level_dB_FS: -1", f"level_dB_FS: {level:.1f}"), encoding="utf-8")
        assert len(examine(file).problems) == n_problems


@pytest.mark.parametrize(
    ("given", "fault"),
    [("", "language_code: given no language code"), ("language_code: zz", "language_code: given 'zz'")],
)
def test_texts_that_do_not_say_their_language_are_told_so(spoken: Callable[..., Path], given: str, fault: str) -> None:
    """In the texts' own file; a voice in the protocol does without."""
    file = spoken("", "", ("language_code: en", given))
    (problem,) = examine(file).problems
    assert fault in str(problem)
    assert "english.yaml:" in str(problem)
    file.write_text(file.read_text(encoding="utf-8").replace("speech: {}", "speech: {voice: en}"), encoding="utf-8")
    assert examine(file).problems == ()


def test_the_check_tells_who_will_say_what(spoken: Callable[..., Path]) -> None:
    """As JSON: voice, library and every prompt with its length; the voice of the texts' language."""
    figures = examine(spoken("screens: [question]")).as_dict()["speech"]
    assert (figures["state"], figures["voice"]) == ("spoken", "en")
    (question,) = figures["prompts"]
    assert question["words"] == "Where did you feel the vibration?"
    assert 1 < question["duration_s"] < 3


def test_a_protocol_without_speech_says_nothing_of_it(shipped: Path) -> None:
    """Expected: no figures, no warning, and the library is not asked."""
    values = examine(shipped / "demo.yaml").as_dict()
    assert values["speech"] is None
    assert not any("spoken" in said or "speech" in said for said in values["warnings"])


def test_speech_below_the_noise_is_warned_of(spoken: Callable[..., Path]) -> None:
    """Speech at -30 dB FS under noise at -20: not refused, for a lab may want it so."""
    preflight = examine(spoken("level_dB_FS: -30", "level_dB_FS: -20"))
    assert preflight.problems == ()
    (said,) = [each for each in preflight.as_dict()["warnings"] if "speech" in each]
    assert "speech at -30 dB FS under masking noise at -20 dB FS" in said


def test_speech_that_is_loud_at_the_ear_is_warned_of(spoken: Callable[..., Path], edit: Edit) -> None:
    """-17 dB FS are 83 dB SPL where a sine of full scale gives 100; uncalibrated, nobody knows."""
    file = spoken("level_dB_FS: -17")
    assert not [each for each in examine(file).as_dict()["warnings"] if "dB SPL" in each]
    edit("apparatus/beam_100x6x2.yaml", ("\nsafety:", "\nsound: {full_scale_dB_SPL: 100}\nsafety:"))
    (said,) = [each for each in examine(file).as_dict()["warnings"] if "dB SPL" in each]
    assert "speech at 83 dB SPL: above 80 dB it may harm hearing" in said


def test_a_record_is_examined_without_asking_this_machine_s_voices(spoken: Callable[..., Path]) -> None:
    """A session recorded with a voice that this machine lacks can still be verified and resumed."""
    file = spoken("voice: xx-gone")
    (problem,) = examine(file).problems
    assert "speech.voice" in str(problem)
    assert examine_findings(examine_files(file)).problems == ()


@pytest.mark.usefixtures("no_library")
@pytest.mark.parametrize("required", [True, False])
def test_a_machine_that_cannot_speak_is_told_of_and_refused_where_speech_is_demanded(
    spoken: Callable[..., Path],
    required: bool,
) -> None:
    """`check` warns; a session does not begin, or its record says why it is silent."""
    preflight = examine(spoken(f"required: {str(required).lower()}"))
    assert preflight.problems == ()
    values: dict[str, Any] = preflight.as_dict()
    assert values["speech"]["state"] == "silent"
    (said,) = [each for each in values["warnings"] if "spoken" in each]
    assert ("no session will begin" if required else "sessions will go on without") in said
    assert "install modaltouch[speech]" in said
    if required:
        with pytest.raises(SpeechError, match=r"install modaltouch\[speech\], or set speech.required: false"):
            prepare_prompts(preflight.experiment)
    else:
        silence = prepare_prompts(preflight.experiment)
        assert isinstance(silence, Silence)
        assert "not installed" in silence.reason
