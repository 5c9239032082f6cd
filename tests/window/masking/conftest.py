"""Sound devices of the tests: ALSA's null device in a separate process, and a fake PortAudio stream."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sounddevice

NO_CARD = "pcm.!default { type hw card 31 }\nctl.!default { type null }\n"


@pytest.fixture
def in_a_process() -> Callable[[str, Path], subprocess.CompletedProcess[str]]:
    """Run a script with its own ALSA configuration."""

    def run(script: str, alsa: Path) -> subprocess.CompletedProcess[str]:
        env = {**os.environ, "ALSA_CONFIG_PATH": str(alsa), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        return subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, env=env, timeout=120, check=False
        )

    return run


@pytest.fixture
def no_card() -> str:
    """An ALSA configuration whose only device is a missing card."""
    return NO_CARD


@pytest.fixture
def null_device(tmp_path: Path) -> Path:
    """An ALSA configuration that discards every sample."""
    file = tmp_path / "asound.conf"
    file.write_text("pcm.!default { type null }\nctl.!default { type null }\n")
    return file


@pytest.fixture
def no_device(tmp_path: Path) -> Path:
    """An ALSA configuration whose only device is a missing card."""
    file = tmp_path / "asound.conf"
    file.write_text(NO_CARD)
    return file


class Device:
    """A fake PortAudio stream, which requests samples on demand and can be unplugged."""

    latency = 0.1

    def __init__(self, **options: Any) -> None:
        self.options, self.active = options, False

    def start(self) -> None:
        self.active = True

    def ask(self, n: int) -> Any:
        out = np.empty((n, self.options["channels"]), dtype=np.float32)
        self.options["callback"](out, n, None, type("Status", (), {"output_underflow": False}))
        return out

    def abort(self) -> None:
        self.active = False

    close = abort


@pytest.fixture
def devices(monkeypatch: pytest.MonkeyPatch) -> list[Device]:
    """The streams opened so far, newest last."""
    opened: list[Device] = []

    def open_stream(**options: Any) -> Device:
        opened.append(Device(**options))
        return opened[-1]

    monkeypatch.setattr(sounddevice, "OutputStream", open_stream)
    monkeypatch.setattr(
        "modaltouch.window.masking.default_device",
        lambda name="": {"name": "earphones", "max_output_channels": 8},
    )
    return opened
