"""Mixes one prompt at a time into a stream; pure, so that it is heard in tests without a device."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.speech.prompts import Prompts

FADE = 0.02
"""How long a prompt takes to fall silent where it is cut [s]."""


class _Utterance:
    """A prompt on its way: how far it came, and whether it was cut."""

    def __init__(self, words: str, samples: NDArray[np.float32]) -> None:
        self.words, self.samples = words, samples
        self.wanted_at, self.began = time.perf_counter(), 0.0
        self.place = self.faded = 0
        self.is_cut = False

    @property
    def is_whole(self) -> bool:
        return self.place >= len(self.samples)


class Voice:
    """Says the prompts of one session.

    `mix` is called by the device's thread, all else by the session's; what passes between them is one reference.

    Parameters
    ----------
    prompts : Prompts
        What can be said.
    log : callable
        Takes what was said for the record.
    """

    def __init__(self, prompts: Prompts, log: Callable[..., None]) -> None:
        self.prompts = prompts
        self._log = log
        self._n_fade = max(round(FADE * prompts.sampling_rate), 1)
        self._wanted: _Utterance | None = None
        self._heard: _Utterance | None = None
        self._unwritten: list[_Utterance] = []
        self.stream: dict[str, Any] = {}
        """Facts of the stream it speaks into, for the record."""
        self.reason = ""
        """Why nothing can be heard any more; empty while it can."""

    def describe(self) -> dict[str, Any] | None:
        """Return voice, library and prompts for the start record."""
        return {"state": "spoken", **self.prompts.describe(), **self.stream}

    def say(self, words: str) -> None:
        """Begin to say the words, in place of what is being said; hush where they are empty."""
        samples = self.prompts.samples.get(words)
        if samples is None or self.reason:
            self.hush()
            return
        utterance = _Utterance(words, samples)
        self._unwritten.append(utterance)
        self._wanted = utterance

    def hush(self) -> None:
        """Let what is being said fade out."""
        self._wanted = None

    @property
    def is_speaking(self) -> bool:
        """Whether something is being said or about to be."""
        wanted = self._wanted
        return not self.reason and (self._heard is not None or (wanted is not None and not wanted.is_whole))

    def write_down(self) -> None:
        """Write what was said since the last call into the record; what is still being said, later."""
        busy = [each for each in self._unwritten if each is self._wanted and not (each.is_whole or self.reason)]
        done = [each for each in self._unwritten if each not in busy]
        self._unwritten = busy
        for each in done:
            self._log(
                "spoken",
                words=each.words,
                wanted_at_s=round(each.wanted_at, 6),
                began_s=round(each.began, 6) if each.place else None,
                heard_s=round(each.place / self.prompts.sampling_rate, 3),
                whole=each.is_whole and not each.is_cut,
            )

    def mix(self, out: NDArray[np.float32]) -> None:
        """Add what comes next to a block.

        Parameters
        ----------
        out : (n_samples, n_channels) array
            Where it goes; every channel gets the same.
        """
        done = 0
        while done < len(out):
            wanted = self._wanted
            if self._heard is None:
                if wanted is None or wanted.is_whole or wanted.is_cut:
                    return
                self._heard = wanted
                wanted.began = time.perf_counter() + done / self.prompts.sampling_rate
            done += self._go_on(self._heard, out[done:], cut=self._heard is not wanted)

    def _go_on(self, heard: _Utterance, out: NDArray[np.float32], *, cut: bool) -> int:
        """Add the next samples of what is heard, and return how many; faded out where it was cut."""
        heard.is_cut |= cut
        n = min(len(out), len(heard.samples) - heard.place, self._n_fade - heard.faded if cut else len(out))
        samples = heard.samples[heard.place : heard.place + n]
        if cut:
            way = self._n_fade - heard.faded - np.arange(1, n + 1)
            samples = samples * np.sin(np.pi / 2 * way / self._n_fade).astype(np.float32) ** 2
            heard.faded += n
        out[:n] += samples[:, np.newaxis]
        heard.place += n
        if heard.is_whole or heard.faded >= self._n_fade:
            self._heard = None
        return n
