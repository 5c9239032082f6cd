"""Masking noise on a sound device, which may be lost and found again in mid-session."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from modaltouch.window.interface import Log
from modaltouch.window.masking import Masking, MaskingError
from modaltouch.window.noise import SEED, DeviceError, LoopedNoise, amplitude_at, make_noise, open_stream

if TYPE_CHECKING:
    from modaltouch.protocol import Apparatus, MaskingSection

STALE = 1.0
"""A device that asks for no samples for so long is lost [s]."""
_HURRY = 0.1
"""Longest fade where something went wrong [s]."""


class NoiseMasking(Masking):
    """Noise on a sound device."""

    def __init__(self, section: MaskingSection, apparatus: Apparatus, log: Log) -> None:
        sound, level = apparatus.sound, section.level(apparatus.sound)
        if level is None:
            raise MaskingError("the masking noise has no level; give masking.level_dB_FS")
        super().__init__()
        self._section, self._apparatus, self._log, self._level = section, apparatus, log, level
        period = make_noise(section.noise, sound.sampling_rate_Hz) * amplitude_at(level)
        self._playback = LoopedNoise(period, round(section.fade_s * sound.sampling_rate_Hz))
        self._device: dict[str, Any] = {}
        self._stream: Any = None
        self._asked = 0.0
        self._n_underflows = 0
        self._is_lost = self._given_up = False
        self._open()

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record."""
        full_scale = self._apparatus.sound.full_scale_dB_SPL
        return {
            "state": "masked",
            "noise": self._section.noise,
            "level_dB_FS": self._level,
            "level_dB_SPL": None if full_scale is None else round(self._level + full_scale, 2),
            "fade_s": self._section.fade_s,
            "seed": SEED,
            "device": self._device.get("name"),
            "sampling_rate_Hz": self._apparatus.sound.sampling_rate_Hz,
            "required": self._section.required,
        }

    def start(self) -> None:
        """Begin to fade in."""
        self._playback.fade_in()
        self._log("masking", state="on")

    def ensure(self, tick: Callable[[], object]) -> None:
        """See that the noise is on and at its level; open the device again where it was lost."""
        self._watch()
        if self._is_lost and not self._given_up:
            self._reopen()
        while not (self._is_lost or self._playback.is_full):
            tick()
            time.sleep(1e-3)
            self._watch()

    @property
    def is_on(self) -> bool | None:
        """Whether the noise has been on since `ensure`."""
        self._watch()
        return not self._is_lost and self._playback.is_full

    def __exit__(self, *exc: object) -> None:
        """Let the device go."""
        self._close()

    def stop(self, *, hurry: bool) -> None:
        """Fade out and let the device go."""
        if self._stream is None:
            return
        self._playback.fade_out()
        until = time.perf_counter() + (_HURRY if hurry else self._section.fade_s + STALE)
        while not (self._is_lost or self._playback.is_silent) and time.perf_counter() < until:
            time.sleep(0.01)
            self._watch()
        self._close()
        self._log("masking", state="off", n_underflows=self._n_underflows)

    def _open(self) -> None:
        try:
            self._device, self._stream = open_stream(self._apparatus, self._fill)
        except DeviceError as error:
            raise MaskingError(f"no masking noise can be played: {error}, or set masking.required: false") from error
        self._asked = time.perf_counter()

    def _fill(self, out: Any, n_frames: int, moment: Any, status: Any) -> None:
        """Hand over the next samples; called by PortAudio in a thread of its own."""
        self._asked = time.perf_counter()
        self._n_underflows += bool(status.output_underflow)
        self._playback.fill(out)

    def _watch(self) -> None:
        """Notice that the device is gone, and write it down once."""
        if self._is_lost:
            return
        stale = time.perf_counter() - self._asked > STALE
        if stale or self._stream is None or not self._stream.active:
            self._is_lost = True
            reason = f"the sound device {self._device.get('name')!r} takes no more samples"
            # On the record's clock: an answer of the last second may have been written down as masked.
            self._log("masking_lost", reason=reason, last_samples_s=round(self._asked, 6))

    def _reopen(self) -> None:
        self._close()
        with contextlib.suppress(Exception):
            import sounddevice

            # PortAudio knows only the devices that were there when it began.
            sounddevice._terminate()
            sounddevice._initialize()
        try:
            self._open()
        except MaskingError as error:
            if self._section.required:
                raise
            self._given_up = True
            self._log("masking_lost", reason=str(error))
            return
        self._is_lost = False
        self._log("masking", state="on again", device=self._device.get("name"))

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(Exception):
                stream.abort()
            with contextlib.suppress(Exception):
                stream.close()
