"""Whether a protocol's screens can be spoken: voice, level, library; and all that is to be said."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from modaltouch.apparatus import Apparatus
from modaltouch.document import Problem, suggest
from modaltouch.masking.noise import amplitude_at, make_noise
from modaltouch.preflight.sound import LOUD
from modaltouch.protocol import Experiment, Findings, Protocol, Texts
from modaltouch.speech.espeak import find_voices, has_library
from modaltouch.speech.interface import Silence, SpeechError
from modaltouch.speech.prompts import Prompts, make_prompts
from modaltouch.window.spoken import spoken_texts


def find_prompts(protocol: Protocol, apparatus: Apparatus, texts: Texts) -> Prompts | Silence:
    """Return all that a session may say; silence where the protocol wants none.

    Parameters
    ----------
    protocol, apparatus, texts
        The files' contents.

    Raises
    ------
    SpeechError
        If eSpeak NG is missing or fails.
    """
    section = protocol.speech
    if section is None:
        return Silence()
    said = spoken_texts(protocol, apparatus.zones, texts)
    voice = section.voice or texts.language_code or ""
    return make_prompts(section, voice.lower(), said, apparatus.sound.sampling_rate_Hz)


def prepare_prompts(experiment: Experiment) -> Prompts | Silence:
    """Return all that a session may say, before it begins; silence where it cannot and need not be said.

    Parameters
    ----------
    experiment : Experiment
        The files' contents.

    Raises
    ------
    SpeechError
        If it cannot be said and the protocol demands it.
    """
    try:
        return find_prompts(experiment.protocol, experiment.apparatus, experiment.texts)
    except SpeechError as error:
        reason = f"no prompts can be spoken: {error}"
        if experiment.protocol.speech is not None and experiment.protocol.speech.required:
            raise SpeechError(f"{reason}, or set speech.required: false") from error
        return Silence(reason)


def check_speech(findings: Findings) -> Iterator[Problem]:
    """Yield a voice that the library lacks, and a level at which what is heard would pass full scale.

    Parameters
    ----------
    findings : Findings
        The files and what is wrong with them.
    """
    if findings.protocol is None or findings.texts is None or findings.problems:
        return
    experiment = findings.experiment()
    section = experiment.protocol.speech
    if section is None or not has_library():
        return
    voice = section.voice or experiment.texts.language_code or ""
    voices, variants = find_voices()
    name, _, variant = voice.lower().partition("+")
    if name not in voices or (variant and variant not in variants):
        unknown, known = (name, voices) if name not in voices else (variant, variants)
        given = f"{voice!r}, and eSpeak NG has no {'voice' if name not in voices else 'variant'} {unknown!r}"
        meant = suggest(unknown, sorted(known))
        remedy = f"did you mean {meant!r}?" if meant else "give speech.voice one it has, such as en, en-us or fr"
        where = (findings.protocol, ("speech", "voice")) if section.voice else (findings.texts, ("language_code",))
        yield where[0].problem(where[1], given, "a voice of eSpeak NG", remedy)
        return
    try:
        prompts = find_prompts(experiment.protocol, experiment.apparatus, experiment.texts)
    except SpeechError:
        return  # told among the warnings; a session that demands it does not begin
    if isinstance(prompts, Prompts) and (problem := _too_loud(findings, experiment, prompts)) is not None:
        yield problem


def _too_loud(findings: Findings, experiment: Experiment, prompts: Prompts) -> Problem | None:
    """Return the problem of a level at which peaks of speech and noise, should they meet, pass full scale."""
    masking, sound, section = experiment.protocol.masking, experiment.apparatus.sound, prompts.section
    noise, level = 0.0, None if masking is None else masking.level(sound)
    if masking is not None and level is not None:
        noise = float(np.abs(make_noise(masking.noise, sound.sampling_rate_Hz)).max()) * amplitude_at(level)
    if prompts.peak + noise <= 1 or findings.protocol is None:
        return None
    beside = " on top of the masking noise" if noise else ""
    room = 1 - noise
    highest = section.level_dB_FS + 20 * math.log10(room / prompts.peak) if room > 1e-3 else -math.inf
    # Rounded down, so that what is allowed is allowed.
    allowed = f"at most {math.floor(highest * 10) / 10:g} dB FS" if math.isfinite(highest) else "less noise"
    given = f"{section.level_dB_FS:g} dB FS, at which the peaks of the speech{beside} pass full scale"
    return findings.protocol.problem(
        ("speech", "level_dB_FS"), given, allowed, "lower it or the noise, and turn the amplifier up"
    )


def speech_figures(experiment: Experiment) -> dict[str, Any] | None:
    """Return who will say what, for `modaltouch check`; None where the protocol wants no speech.

    Parameters
    ----------
    experiment : Experiment
        The files' contents.
    """
    section = experiment.protocol.speech
    if section is None:
        return None
    try:
        prompts = find_prompts(experiment.protocol, experiment.apparatus, experiment.texts)
    except SpeechError as error:
        return {"state": "silent", "reason": str(error)}
    return {"state": "spoken", **prompts.describe()} if isinstance(prompts, Prompts) else None


def speech_warnings(experiment: Experiment) -> list[str]:
    """Return what a lab should know of its spoken prompts.

    Parameters
    ----------
    experiment : Experiment
        The files' contents.
    """
    section, masking = experiment.protocol.speech, experiment.protocol.masking
    if section is None:
        return []
    said = []
    figures = speech_figures(experiment)
    if figures is not None and figures["state"] == "silent":
        end = "no session will begin" if section.required else "sessions will go on without"
        said.append(f"the screens cannot be spoken on this machine, {end}: {figures['reason']}")
    noise = None if masking is None else masking.level(experiment.apparatus.sound)
    if noise is not None and section.level_dB_FS < noise:
        said.append(
            f"speech at {section.level_dB_FS:g} dB FS under masking noise at {noise:g} dB FS: it will be hard to "
            "understand; give speech.level_dB_FS at least the level of the noise"
        )
    full_scale = experiment.apparatus.sound.full_scale_dB_SPL
    if full_scale is not None and section.level_dB_FS + full_scale > LOUD:
        said.append(f"speech at {section.level_dB_FS + full_scale:g} dB SPL: above {LOUD:g} dB it may harm hearing")
    return said
