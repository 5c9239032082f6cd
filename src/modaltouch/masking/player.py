"""Masking noise and prompts on a sound device, through PortAudio, in one stream.

A device that is lost in mid-session (unplugged, taken away by the system) leaves the trial that is on alone: its
answer is recorded as not masked. Before the next trial the device is opened again; where that fails, a protocol
that demands what is lost ends the session in order, and `modaltouch resume` goes on once the device is back; any
other goes on without, every trial recorded as such.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

from modaltouch.masking.device import DeviceError, open_stream
from modaltouch.masking.interface import Masking, MaskingError, NoMasking
from modaltouch.masking.noise import SEED, amplitude_at, make_noise
from modaltouch.masking.playback import Playback
from modaltouch.speech.interface import Silence, Speech, SpeechError
from modaltouch.speech.prompts import Prompts
from modaltouch.speech.voice import Voice

if TYPE_CHECKING:
    from modaltouch.apparatus import Sound
    from modaltouch.protocol import MaskingSection

Log = Callable[..., None]

STALE = 1.0
"""A device that asks for no samples for so long is lost [s]."""
_HURRY = 0.1
"""Longest fade where something went wrong [s]."""


def open_masking(
    section: MaskingSection | None, sound: Sound, log: Log, prompts: Prompts | Silence | None = None
) -> Masking:
    """Return the masking that a protocol wants, silent until `start`, and what speaks in the same stream.

    Parameters
    ----------
    section : MaskingSection or None
        What the protocol wants.
    sound : Sound
        What the apparatus plays it with.
    log : callable
        Takes what happens to it for the record.
    prompts : Prompts or Silence, optional
        What can be said, or why nothing can.

    Raises
    ------
    MaskingError, SpeechError
        If it cannot be played and the protocol demands it.
    """
    spoken, silence = (prompts, Silence()) if isinstance(prompts, Prompts) else (None, prompts or Silence())
    if silence.reason:
        log("speech_lost", reason=silence.reason)
    if section is None and spoken is None:
        return NoMasking(speech=silence)
    try:
        return SoundOutput(section, sound, log, spoken or silence)
    except (MaskingError, SpeechError) as error:
        if (section is not None and section.required) or (spoken is not None and spoken.section.required):
            raise
        reason = str(error)
        for event in [*(["masking_lost"] if section is not None else []), *(["speech_lost"] if spoken else [])]:
            log(event, reason=reason)
        return NoMasking(reason if section is not None else "", Silence(reason) if spoken else silence)


class SoundOutput:
    """Noise, prompts or both on a sound device.

    Parameters
    ----------
    section : MaskingSection or None
        Which noise, how loud; None for prompts alone.
    sound : Sound
        Device, sampling rate, calibration.
    log : callable
        Takes what happens for the record.
    prompts : Prompts or Silence, optional
        What can be said, or why nothing can.

    Raises
    ------
    MaskingError, SpeechError
        If the device cannot be opened.
    """

    def __init__(
        self, section: MaskingSection | None, sound: Sound, log: Log, prompts: Prompts | Silence | None = None
    ) -> None:
        self._section, self._sound, self._log, self._level = section, sound, log, 0.0
        self._playback: Playback | None = None
        self._voice = Voice(prompts, log) if isinstance(prompts, Prompts) else None
        self._silence = prompts if isinstance(prompts, Silence) else Silence()
        if section is not None:
            level = section.level(sound)
            if level is None:
                raise MaskingError("the masking noise has no level; give masking.level_dB_FS")
            self._level = level
            period = make_noise(section.noise, sound.sampling_rate_Hz) * amplitude_at(level)
            self._playback = Playback(period, round(section.fade_s * sound.sampling_rate_Hz))
        self._device: dict[str, Any] = {}
        self._stream: Any = None
        self._asked = 0.0
        self._n_underflows = 0
        self._is_lost = self._given_up = False
        self._open()

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record; None where only prompts are played."""
        if self._section is None:
            return None
        full_scale = self._sound.full_scale_dB_SPL
        return {
            "state": "masked",
            "noise": self._section.noise,
            "level_dB_FS": self._level,
            "level_dB_SPL": None if full_scale is None else round(self._level + full_scale, 2),
            "fade_s": self._section.fade_s,
            "seed": SEED,
            "device": self._device.get("name"),
            "sampling_rate_Hz": self._sound.sampling_rate_Hz,
            "required": self._section.required,
        }

    @property
    def speech(self) -> Speech:
        """What speaks the prompts."""
        return self._voice or self._silence

    def start(self) -> None:
        """Begin to fade in."""
        if self._playback is not None:
            self._playback.fade_in()
            self._log("masking", state="on")

    def ensure(self, tick: Callable[[], object]) -> None:
        """See before a trial that the noise is on and at its level; open the device again where it was lost.

        Raises
        ------
        MaskingError, SpeechError
            If it is lost and the protocol demands it.
        """
        self._watch()
        if self._is_lost and not self._given_up:
            self._reopen()
        while self._playback is not None and not (self._is_lost or self._playback.is_full):
            tick()
            time.sleep(1e-3)
            self._watch()

    @property
    def is_on(self) -> bool | None:
        """Whether the noise has been on since `ensure`; None where only prompts are played."""
        self._watch()
        if self._playback is None:
            return None
        return not self._is_lost and self._playback.is_full

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        """Let the device go, whatever happened."""
        self._close()

    def stop(self, *, hurry: bool) -> None:
        """Fade out, in an instant where something went wrong, and let the device go.

        How often the device got no samples in time, a click each, goes into the record.
        """
        if self._stream is None:
            return
        self.speech.hush()
        fade = 0.0
        if self._section is not None and self._playback is not None:
            self._playback.fade_out()
            fade = self._section.fade_s
        until = time.perf_counter() + (_HURRY if hurry else fade + STALE)
        while not (self._is_lost or self._is_silent) and time.perf_counter() < until:
            time.sleep(0.01)
            self._watch()
        self._close()
        self.speech.write_down()
        self._log("masking" if self._section is not None else "speech", state="off", n_underflows=self._n_underflows)

    @property
    def _is_silent(self) -> bool:
        return (self._playback is None or self._playback.is_silent) and not self.speech.is_speaking

    def _open(self) -> None:
        """Open the device.

        Raises
        ------
        MaskingError, SpeechError
            If that fails; the former where there should be noise.
        """
        try:
            self._device, self._stream = open_stream(self._sound, self._fill)
        except DeviceError as error:
            keys = [
                *(["masking"] if self._section is not None else []),
                *(["speech"] if self._voice is not None else []),
            ]
            switch = " and ".join(f"{key}.required: false" for key in keys)
            if self._section is not None:
                raise MaskingError(f"no masking noise can be played: {error}, or set {switch}") from error
            raise SpeechError(f"no prompts can be spoken: {error}, or set {switch}") from error
        self._asked = time.perf_counter()
        if self._voice is not None:
            self._voice.stream = {
                "device": self._device.get("name"),
                "sampling_rate_Hz": self._sound.sampling_rate_Hz,
                "latency_s": round(float(self._stream.latency), 4),
            }

    def _fill(self, out: Any, n_frames: int, moment: Any, status: Any) -> None:
        """Hand over the next samples; called by PortAudio in a thread of its own."""
        self._asked = time.perf_counter()
        self._n_underflows += bool(status.output_underflow)
        if self._playback is not None:
            self._playback.fill(out)
        else:
            out.fill(0)
        if self._voice is not None:
            self._voice.mix(out)

    def _watch(self) -> None:
        """Notice that the device is gone, and write it down once."""
        if self._is_lost:
            return
        stale = time.perf_counter() - self._asked > STALE
        if stale or self._stream is None or not self._stream.active:
            self._is_lost = True
            reason = f"the sound device {self._device.get('name')!r} takes no more samples"
            # On the record's clock: an answer of the last second may have been written down as masked.
            self._tell_lost(reason, last_samples_s=round(self._asked, 6))

    def _tell_lost(self, reason: str, **facts: Any) -> None:
        """Write down what is lost with the device."""
        if self._section is not None:
            self._log("masking_lost", reason=reason, **facts)
        if self._voice is not None:
            self._voice.reason = reason
            self._log("speech_lost", reason=reason, **facts)

    def _reopen(self) -> None:
        self._close()
        with contextlib.suppress(Exception):
            import sounddevice

            # PortAudio knows only the devices that were there when it began.
            sounddevice._terminate()
            sounddevice._initialize()
        try:
            self._open()
        except (MaskingError, SpeechError) as error:
            wants_noise = self._section is not None and self._section.required
            if wants_noise or (self._voice is not None and self._voice.prompts.section.required):
                raise
            self._given_up = True
            self._tell_lost(str(error))
            return
        self._is_lost = False
        if self._section is not None:
            self._log("masking", state="on again", device=self._device.get("name"))
        if self._voice is not None:
            self._voice.reason = ""
            self._log("speech", state="on again", device=self._device.get("name"))

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(Exception):
                stream.abort()
            with contextlib.suppress(Exception):
                stream.close()
