"""``modaltouch speak``: hear, list or save what a protocol has spoken, before anybody sits down."""

from __future__ import annotations

import io
import wave
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.faults import print_json, reporting
from modaltouch.cli.options import JSON, PROTOCOL

if TYPE_CHECKING:
    from modaltouch.protocol import Experiment
    from modaltouch.speech.prompts import Prompts


def speak(
    protocol: PROTOCOL,
    out: Annotated[
        Path | None, typer.Option(help="Folder for one WAV file of each prompt.", show_default="nothing is written")
    ] = None,
    play: Annotated[
        bool, typer.Option("--play", help="Play every prompt on the sound device, masking noise and all.")
    ] = False,
    json_output: JSON = False,
) -> None:
    """List what a protocol has spoken to the participant (`speech`), and save or play it.

    What is saved and played are the very samples of a session.
    """
    from modaltouch.preflight import examine
    from modaltouch.preflight.speech import find_prompts
    from modaltouch.speech.prompts import Prompts

    with reporting(json_output=json_output):
        experiment = examine(protocol, uncalibrated=True).experiment
        prompts = find_prompts(experiment.protocol, experiment.apparatus, experiment.texts)
        if not isinstance(prompts, Prompts):
            raise typer.BadParameter(
                f"{protocol} has no section `speech`, so that nothing is spoken; add `speech: {{}}`"
            )
        facts: dict[str, Any] = prompts.describe()
        if out is not None:
            facts["files"] = _save(out, prompts)
        if not json_output:
            for number, each in enumerate(facts["prompts"], 1):
                typer.echo(f"{number:3} {each['duration_s']:5.1f} s  {' '.join(each['words'].split())}")
            typer.echo(f"{facts['library']}, voice {facts['voice']}{f', in {out}' if out is not None else ''}")
        if play:
            _play(experiment, prompts)
        if json_output:
            print_json(facts)


def _save(out: Path, prompts: Prompts) -> list[str]:
    """Return the WAV files that were written, in the order of the prompts."""
    import numpy as np

    from modaltouch.analysis.output import write_files

    files = {}
    for number, samples in enumerate(prompts.samples.values(), 1):
        with io.BytesIO() as buffer:
            with wave.open(buffer, "wb") as file:
                file.setnchannels(1)
                file.setsampwidth(2)
                file.setframerate(round(prompts.sampling_rate))
                file.writeframes(np.round(samples * 32767).astype("<i2").tobytes())
            files[f"prompt_{number:03}.wav"] = buffer.getvalue()
    return [str(path) for path in write_files(out, files, prompts.describe(), "speak").values()]


def _play(experiment: Experiment, prompts: Prompts) -> None:
    """Play the prompts one after the other, over the masking noise where the protocol wants it."""
    import time

    from modaltouch.masking.player import open_masking
    from modaltouch.speech.interface import SpeechError

    with open_masking(
        experiment.protocol.masking, experiment.apparatus.sound, lambda *a, **k: None, prompts
    ) as masking:
        if reason := (masking.speech.describe() or {}).get("reason"):
            raise SpeechError(reason)
        masking.start()
        for words in prompts.samples:
            masking.ensure(lambda: None)
            masking.speech.say(words)
            while masking.speech.is_speaking:
                time.sleep(0.01)
                masking.ensure(lambda: None)
        masking.stop(hurry=False)
