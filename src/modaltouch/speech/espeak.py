"""Words to samples, by eSpeak NG in a process of its own.

The library draws the tremor of its voice from a random source that nothing but a new process sets back, so one process
for all the prompts of a protocol makes the same samples in every session. And it is native code, fed with any words a
lab may write: what it does with them cannot touch a session.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.speech.interface import SpeechError

PACKAGE = "espeakng-loader"
"""Brings the library and its voices as a wheel for Linux, Windows and macOS."""
_PATIENCE = 30.0
"""Longest time for all prompts of a protocol [s], and a second more for each; they take a hundredth of that."""
_LONGEST = 300
"""Longest prompt [s]; eSpeak NG is stopped there."""

_SYNCHRONOUS, _DONT_EXIT, _UTF8, _RATE = 2, 0x8000, 1, 1
"""Of speak_lib.h: AUDIO_OUTPUT_SYNCHRONOUS, espeakINITIALIZE_DONT_EXIT, espeakCHARS_UTF8, espeakRATE."""


@dataclass(frozen=True, eq=False)
class Synthesis:
    """What eSpeak NG made.

    Attributes
    ----------
    library : str
        Name and version of what made it.
    sampling_rate : float
        Samples per second [Hz].
    samples : tuple of (n_samples,) arrays of int16
        One to each text.
    """

    library: str
    sampling_rate: float
    samples: tuple[NDArray[np.int16], ...]


def has_library() -> bool:
    """Return whether eSpeak NG is installed; it is not loaded."""
    return find_spec("espeakng_loader") is not None


def find_voices() -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of the voices, and of the variants that may follow one after a ``+``; needs the library."""
    data = _package() / "espeak-ng-data"
    voices = frozenset(file.name.lower() for file in (data / "lang").rglob("*") if file.is_file())
    return voices, frozenset(file.name for file in (data / "voices" / "!v").iterdir())


@lru_cache(maxsize=4)
def synthesise(texts: tuple[str, ...], voice: str, words_per_min: int) -> Synthesis:
    """Return the texts as samples, the same ones for the same arguments.

    Parameters
    ----------
    texts : tuple of str
        What is said, one after the other.
    voice : str
        Name of the voice, such as ``en`` or ``fr+f2``.
    words_per_min : int
        How fast it speaks [words/min].

    Raises
    ------
    SpeechError
        If the library is not installed, knows no such voice, or fails.
    """
    if not has_library():
        raise SpeechError(f"the package {PACKAGE} is not installed; install modaltouch[speech]")
    order = json.dumps({"texts": texts, "voice": voice, "words_per_min": words_per_min})
    try:
        done = subprocess.run(
            # It imports what this process would, and nothing besides out of the folder it is started in (-P).
            [sys.executable, "-P", "-m", "modaltouch.speech.espeak"],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            input=order.encode(),
            capture_output=True,
            timeout=_PATIENCE + len(texts),
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SpeechError(f"eSpeak NG made no samples ({error}); look for odd signs in the texts") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        why = said[-1] if said else f"it ended with status {done.returncode}"
        raise SpeechError(f"eSpeak NG made no samples ({why})")
    head, _, sound = done.stdout.partition(b"\n")
    facts = json.loads(head)
    ends = np.cumsum(facts["n_samples"])[:-1]
    samples = np.split(np.frombuffer(sound, dtype=np.int16), ends)
    library = f"eSpeak NG {facts['version']} ({PACKAGE} {version(PACKAGE)})"
    return Synthesis(library, float(facts["sampling_rate_Hz"]), tuple(samples))


def _package() -> Path:
    import espeakng_loader

    return Path(espeakng_loader.__file__).parent


def _open(voice: str, words_per_min: int) -> tuple[ctypes.CDLL, int]:
    """Return the library, ready to speak, and its sampling rate [Hz]."""
    import espeakng_loader

    library = ctypes.CDLL(espeakng_loader.get_library_path())
    library.espeak_Synth.argtypes = [
        ctypes.c_char_p,
        ctypes.c_size_t,
        ctypes.c_uint,
        ctypes.c_int,
        ctypes.c_uint,
        ctypes.c_uint,
        ctypes.c_void_p,
        ctypes.c_void_p,
    ]
    library.espeak_Info.restype = ctypes.c_char_p
    library.espeak_Info.argtypes = [ctypes.c_void_p]
    # Its paths are cut at 160 signs: from inside the package they are short.
    os.chdir(_package())
    rate = library.espeak_Initialize(_SYNCHRONOUS, 0, b".", _DONT_EXIT)
    if rate <= 0:
        sys.exit(f"its data in {_package()} cannot be read")
    if library.espeak_SetVoiceByName(voice.encode()) != 0:
        sys.exit(f"it has no voice {voice!r}")
    library.espeak_SetParameter(_RATE, words_per_min, 0)
    return library, int(rate)


def _speak(order: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """Return the facts of a synthesis and its samples, one text after the other; in the process of its own."""
    library, rate = _open(order["voice"], order["words_per_min"])
    heard = bytearray()

    def take(samples: int | None, n_samples: int, events: int | None) -> int:
        if samples and n_samples > 0:
            heard.extend(ctypes.string_at(samples, 2 * n_samples))
        return int(len(heard) > 2 * rate * _LONGEST)

    # Kept by a name, since the library keeps but its address.
    callback = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(take)
    library.espeak_SetSynthCallback(callback)
    sound, counts = bytearray(), []
    for text in order["texts"]:
        words = text.encode() + b"\0"
        heard.clear()
        if library.espeak_Synth(words, len(words), 0, 1, 0, _UTF8, None, None) != 0 or not any(heard):
            sys.exit(f"it cannot say {text!r}")
        counts.append(len(heard) // 2)
        sound += heard
    info = library.espeak_Info(None).decode()
    return {"sampling_rate_Hz": rate, "version": info.split()[0], "n_samples": counts}, bytes(sound)


def _main() -> None:
    facts, sound = _speak(json.load(sys.stdin.buffer))
    sys.stdout.buffer.write(json.dumps(facts).encode() + b"\n" + sound)


if __name__ == "__main__":
    _main()
