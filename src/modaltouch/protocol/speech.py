"""The section ``speech``: which screens are also spoken, and how."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from modaltouch.document import Problem, Reading
from modaltouch.document.section import Section, described
from modaltouch.protocol.masking import Decibels

SpokenScreen = Literal["instructions", "placement", "question", "feedback", "break", "goodbye"]
VoiceName = Annotated[
    str,
    Field(
        strict=True,
        pattern=r"^[A-Za-z]{2,3}(-[A-Za-z0-9]+)*(\+[A-Za-z0-9_-]+)?$",
        max_length=40,
        json_schema_extra={"x-allowed": "the name of a voice, such as en-us or fr+f2"},
    ),
]


class SpeechSection(Section):
    """Words of the screens, spoken to the participant while they are shown."""

    screens: tuple[SpokenScreen, ...] = described(
        "Which screens are spoken. instructions: the first two, and what announces practice and trials; placement: "
        "which finger goes where; feedback: after a practice trial; break: pauses, too.",
        default=("instructions", "placement", "question", "feedback", "break", "goodbye"),
        min_length=1,
        json_schema_extra={"uniqueItems": True},
    )
    voice: VoiceName | None = described(
        "Voice of eSpeak NG, such as en, en-us, fr or fr+f2; null for the language of the texts.", default=None
    )
    rate_words_per_min: Annotated[int, Field(strict=True, ge=80, le=300)] = described(
        "How fast it is spoken [words/min].", default=160
    )
    level_dB_FS: Decibels = described(  # noqa: N815
        "Level of the speech against a sine of full scale [dB FS, rms over all that is spoken].", default=-20.0
    )
    required: bool = Field(
        strict=True,
        default=True,
        description="Whether a session may not begin or go on without it; otherwise the record says where it lacks.",
    )


def check_speech(protocol: Reading[Any], texts: Reading[Any]) -> Iterator[Problem]:
    """Yield that nobody says in which language the screens are spoken, where that is so.

    Parameters
    ----------
    protocol, texts : Reading
        Both files, as far as they are sound.
    """
    node = protocol.find(("speech",))
    if node is None or not isinstance(node.content, dict) or "voice" in node.content:
        return
    code = texts.find(("language_code",))
    if code is None or code.content is None:
        allowed = f"one, as {protocol.source.path.name} wants the screens spoken"
        remedy = "add `language_code`, such as en or fr, or give speech.voice in the protocol"
        yield texts.problem(("language_code",), "no language code", allowed, remedy)
