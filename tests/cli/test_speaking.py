"""``modaltouch speak`` as a lab meets it: listed, saved, refused."""

from __future__ import annotations

import json
import subprocess
import sys
import wave
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.preflight import examine
from modaltouch.preflight.speech import find_prompts
from modaltouch.speech.prompts import Prompts

OLD = "answers:\n  given_by"
NO_LIBRARY = "import modaltouch.speech.espeak as espeak; espeak.find_spec = lambda name: None; "


def run(*words: object, first: str = "") -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    script = f"import sys; {first}from modaltouch.__main__ import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", script, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def protocol(edit: Callable[..., Path]) -> Path:
    """Give the demonstration in French, its question and its farewell spoken."""
    speech = "speech: {screens: [question, goodbye]}\n"
    return edit("demo.yaml", (OLD, speech + OLD), ("english.yaml", "french.yaml"))


def test_the_prompts_are_listed_and_saved_as_they_will_be_heard(protocol: Path, tmp_path: Path) -> None:
    """Each WAV holds the samples of a session, to half a step of 16 bits; the list names words and voice."""
    done = run("speak", protocol, "--out", tmp_path / "spoken", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["voice"] == "fr"
    assert [each["words"] for each in told["prompts"]][0] == "Où avez-vous senti la vibration\N{NO-BREAK SPACE}?"
    experiment = examine(protocol).experiment
    prompts = find_prompts(experiment.protocol, experiment.apparatus, experiment.texts)
    assert isinstance(prompts, Prompts)
    assert len(told["files"]) == len(prompts.samples) == 2
    for name, samples in zip(told["files"], prompts.samples.values(), strict=True):
        with wave.open(name, "rb") as file:
            assert (file.getnchannels(), file.getframerate()) == (1, 48_000)
            saved = np.frombuffer(file.readframes(file.getnframes()), dtype="<i2") / 32767
        assert np.abs(saved - samples).max() <= 0.501 / 32767


def test_nothing_of_a_stranger_is_overwritten(protocol: Path, tmp_path: Path) -> None:
    """A WAV that another program put there stays; exit status 4."""
    strange = tmp_path / "spoken" / "prompt_001.wav"
    strange.parent.mkdir()
    strange.write_bytes(b"mine")
    assert run("speak", protocol, "--out", strange.parent).returncode == 4
    assert strange.read_bytes() == b"mine"


def test_a_protocol_without_speech_has_nothing_to_say(shipped: Path) -> None:
    """Exit status 2, with what to add."""
    done = run("speak", shipped / "demo.yaml")
    assert done.returncode == 2
    assert "add `speech: {}`" in " ".join(done.stderr.split())


@pytest.mark.parametrize("command", [("speak",), ("run", "-p", "p01", "--rig", "simulated", "--yes")])
def test_without_the_library_nothing_begins(protocol: Path, tmp_path: Path, command: tuple[str, ...]) -> None:
    """Exit status 3 with the remedy, before any device, window or record."""
    results = ("--results", tmp_path / "results") if command[0] == "run" else ()
    done = run(command[0], protocol, *command[1:], *results, first=NO_LIBRARY)
    assert done.returncode == 3, done.stdout
    assert "install modaltouch[speech]" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("session.jsonl"))


def test_the_check_shows_it(protocol: Path) -> None:
    """Who speaks, how fast, how loud, how much."""
    said = " ".join(run("check", protocol).stdout.split())
    assert "voice fr, 160 words/min, -20 dB FS: 2 prompts" in said


def test_the_check_names_the_extra_that_brings_the_voice(protocol: Path) -> None:
    """Its brackets are words: without them `install modaltouch` would be told to who has it."""
    done = run("check", protocol, first=NO_LIBRARY)
    assert done.returncode == 0, done.stderr
    assert "install modaltouch[speech]" in " ".join(done.stdout.split())
