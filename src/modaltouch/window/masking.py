"""Noise that masks the sound of the beam, played continuously from before the first trial until after the last.

The noise has random phases and an exact spectrum, so that its period repeats seamlessly; it is played through
PortAudio. If the device is lost during a session (unplugged, or removed by the system), the current trial continues and
its answer is recorded as not masked. If the protocol requires masking, the session ends properly before the next trial,
and `modaltouch resume` continues it once the device is back; otherwise it continues without noise, and its trials are
recorded as not masked. A device that takes samples again by itself, as after the computer was held up, counts again.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus, Findings, MaskingSection, Problem
from modaltouch.window.interface import Log, Masking, MaskingError

LOWEST, HIGHEST = 20.0, 20_000.0
"""Band of the noise, the audible range [Hz]."""

PERIOD = 10.0
"""Period of the noise, too long for the repetition to be heard [s]."""

SEED = 20_120_501
"""Seed of the random phases; the noise is the same in every session."""

SINE_DB = 20 * math.log10(math.sqrt(2))
"""Difference between full scale and the RMS of a full-scale sine, which is 0 dB FS (AES17) [dB]."""


@lru_cache(maxsize=4)
def make_noise(kind: Literal["pink", "white"], sampling_rate: float) -> NDArray[np.float32]:
    """Return one period of seamless noise with an RMS of 1, a read-only (n_samples,) array [1].

    Parameters
    ----------
    kind : str
        ``pink``, with a power density proportional to 1/frequency, or ``white``, with a constant one.
    sampling_rate : float
        Samples per second [Hz].
    """
    n_samples = round(PERIOD * sampling_rate)
    frequency = np.fft.rfftfreq(n_samples, 1 / sampling_rate)
    in_band = (frequency >= LOWEST) & (frequency <= min(HIGHEST, 0.45 * sampling_rate))
    magnitude = np.zeros(frequency.size)
    magnitude[in_band] = 1.0 if kind == "white" else 1 / np.sqrt(frequency[in_band])
    # NumPy guarantees the stream of raw words, so the noise is the same in every version.
    phase = np.random.PCG64(SEED).random_raw(frequency.size).astype(np.float64) * (2 * np.pi / 2.0**64)
    samples = np.fft.irfft(magnitude * np.exp(1j * phase), n_samples)
    noise: NDArray[np.float32] = (samples / np.sqrt(np.mean(samples**2))).astype(np.float32)
    noise.flags.writeable = False
    return noise


def amplitude_at(level: float) -> float:
    """Return the RMS of noise at a level [dB FS], relative to full scale [1].

    Examples
    --------
    >>> round(amplitude_at(0.0), 4)
    0.7071
    """
    return float(10 ** ((level - SINE_DB) / 20))


def default_device(name: str = "") -> dict[str, Any]:
    """Return the properties of a sound device, as reported by PortAudio.

    Parameters
    ----------
    name : str
        Part of its name; empty for the system's default.

    Raises
    ------
    MaskingError
        If there is no such device or no PortAudio.
    """
    try:
        import sounddevice
    except OSError as error:
        raise MaskingError(f"{error}; install libportaudio2 (`make install`)") from error
    try:
        return dict(sounddevice.query_devices(name or None, kind="output"))
    except (sounddevice.PortAudioError, ValueError) as error:
        what = f"no sound device like {name!r}" if name else "no sound device"
        remedy = "connect one and choose it with sound.device in the apparatus"
        raise MaskingError(f"there is {what} ({error}); {remedy}") from error


def open_stream(apparatus: Apparatus, fill: Callable[..., None]) -> tuple[dict[str, Any], Any]:
    """Open and start a stream, and return the properties of its device and the stream."""
    sound = apparatus.sound
    device = default_device(sound.device)
    import sounddevice

    channels = max(1, min(2, int(device["max_output_channels"])))
    stream = None
    try:
        stream = sounddevice.OutputStream(
            samplerate=sound.sampling_rate_Hz,
            device=sound.device or None,
            channels=channels,
            dtype="float32",
            latency="high",
            callback=fill,
        )
        stream.start()
    except (sounddevice.PortAudioError, ValueError) as error:
        if stream is not None:
            stream.close()
        raise MaskingError(
            f"the sound device {device.get('name')!r} refuses {sound.sampling_rate_Hz:g} Hz ({error}); change "
            "sound.sampling_rate_Hz or sound.device in the apparatus"
        ) from error
    return device, stream


class LoopedNoise:
    """Endless repetition of a period of noise, with fades."""

    def __init__(self, period: NDArray[np.float32], n_fade: int) -> None:
        self._period = period
        self._n_fade = max(n_fade, 1)
        self._place = 0
        self._way = self._target = 0

    def fade(self, *, on: bool) -> None:
        """Fade in or out over the following samples."""
        self._target = self._n_fade * on

    def is_faded(self, *, on: bool) -> bool:
        """Return whether the noise has reached its full level, or silence."""
        return self._way == self._target == self._n_fade * on

    def fill(self, out: NDArray[np.float32]) -> None:
        """Write the next samples into a block.

        Parameters
        ----------
        out : (n_samples, n_channels) array
            Output block; all channels get the same samples.
        """
        if self.is_faded(on=False):
            out.fill(0)
            return
        n = len(out)
        samples = np.take(self._period, np.arange(self._place, self._place + n), mode="wrap")
        self._place = (self._place + n) % len(self._period)
        if self._way != self._target:
            ahead = np.arange(1, n + 1) * (1 if self._target > self._way else -1)
            way = np.clip(self._way + ahead, 0, self._n_fade)
            self._way = int(way[-1])
            # Raised cosine, smooth at both ends.
            samples = samples * np.sin(np.pi / 2 * way / self._n_fade).astype(np.float32) ** 2
        out[:] = samples[:, np.newaxis]


STALE = 1.0
"""Time without a request for samples after which a device counts as lost [s]."""


@dataclass(frozen=True)
class MaskingNoise:
    """The masking noise of a protocol.

    Attributes
    ----------
    section : MaskingSection
        The protocol's masking section.
    apparatus : Apparatus
        Apparatus with the sound device.
    """

    section: MaskingSection
    apparatus: Apparatus

    @property
    def highest_level(self) -> float:
        """Level at which the highest peak of the noise reaches full scale [dB FS]."""
        peak = abs(make_noise(self.section.noise, self.apparatus.sound.sampling_rate_Hz)).max()
        return SINE_DB - 20 * math.log10(float(peak))

    def check_level(self, findings: Findings) -> Iterator[Problem]:
        """Yield a problem if the peaks of the noise exceed full scale."""
        section, sound = self.section, self.apparatus.sound
        level = section.level(sound)
        if level is None or level <= (highest := self.highest_level):
            return
        unit = section.level_key.removeprefix("level_").replace("_", " ")
        shift = 0.0 if section.level_dB_FS is not None else sound.full_scale_dB_SPL or 0.0
        given = f"{level + shift:g} {unit}, at which the peaks of the {section.noise} noise pass full scale"
        # Round down, so that the level in the message is itself allowed.
        allowed = f"at most {math.floor((highest + shift) * 10) / 10:g} {unit}"
        yield findings.problem(("masking", section.level_key), given, allowed, "lower it, and turn up the amplifier")

    def open(self, log: Log, *, is_heard: bool = True) -> Masking:
        """Open the masking noise, silent until `Masking.start`.

        Parameters
        ----------
        log : callable
            Receives its events for the record.
        is_heard : bool
            Whether a person answers; no noise is played for a simulated participant.

        Raises
        ------
        MaskingError
            If the noise cannot be played and the protocol requires it.
        """
        if not is_heard:
            return SimulatedMasking(self.section, self.apparatus)
        try:
            return PlayedMasking(self.section, self.apparatus, log)
        except MaskingError as error:
            if self.section.required:
                raise
            log("masking_lost", reason=str(error))
            return Masking(str(error))


class SimulatedMasking(Masking):
    """Noise for a simulated participant: described in the record but not played."""

    def __init__(self, section: MaskingSection, apparatus: Apparatus) -> None:
        super().__init__()
        self._section, self._apparatus, self._level = section, apparatus, section.level(apparatus.sound)
        self._device: dict[str, Any] = {"name": "simulated"}
        self._is_wanted = True

    def describe(self) -> dict[str, Any] | None:
        """Return noise, level and device for the start record."""
        level, full_scale = self._level, self._apparatus.sound.full_scale_dB_SPL
        return {
            "state": "masked",
            "noise": self._section.noise,
            "level_dB_FS": level,
            "level_dB_SPL": None if full_scale is None or level is None else round(level + full_scale, 2),
            "fade_s": self._section.fade_s,
            "seed": SEED,
            "device": self._device.get("name"),
            "sampling_rate_Hz": self._apparatus.sound.sampling_rate_Hz,
            "required": self._section.required,
        }

    def ensure(self, tick: Callable[[], object], *, on: bool = True) -> None:
        """Set the noise on or silent."""
        self._is_wanted = on

    @property
    def is_on(self) -> bool | None:
        """Whether the noise was set on by the last `ensure`."""
        return self._is_wanted


class PlayedMasking(SimulatedMasking):
    """Noise on a sound device; PortAudio is loaded on first use."""

    def __init__(self, section: MaskingSection, apparatus: Apparatus, log: Log) -> None:
        super().__init__(section, apparatus)
        sound, level = apparatus.sound, self._level
        if level is None:
            raise MaskingError("the masking noise has no level; give masking.level_dB_FS")
        self._log = log
        period = make_noise(section.noise, sound.sampling_rate_Hz) * amplitude_at(level)
        self._playback = LoopedNoise(period, round(section.fade_s * sound.sampling_rate_Hz))
        self._n_underflows, self._is_lost = 0, False
        try:
            self._device, self._stream = open_stream(apparatus, self._fill)
        except MaskingError as error:
            raise MaskingError(f"no masking noise can be played: {error}, or set masking.required: false") from error
        self._asked = time.perf_counter()

    def start(self) -> None:
        """Start the fade-in."""
        self._playback.fade(on=True)
        self._log("masking", state="on")

    def ensure(self, tick: Callable[[], object], *, on: bool = True) -> None:
        """Ensure that the noise is at its level, or silent."""
        self._watch()
        if self._is_lost and self._is_fed:
            self._is_lost = False
            self._log("masking", state="on again")
        if self._is_lost and self._section.required:
            raise MaskingError(f"{self._loss}; connect it again and resume, or set masking.required: false")
        if on != self._is_wanted:
            self._is_wanted = on
            self._playback.fade(on=on)
            if not self._is_lost:
                self._log("masking", state="on" if on else "silent")
        while not (self._is_lost or self._playback.is_faded(on=on)):
            tick()
            time.sleep(1e-3)
            self._watch()

    @property
    def is_on(self) -> bool | None:
        """Whether the noise has been on since `ensure`."""
        self._watch()
        return self._is_wanted and not self._is_lost and self._playback.is_faded(on=True)

    def __exit__(self, *exc: object) -> None:
        """Release the device."""
        self._close()

    def stop(self, *, hurry: bool) -> None:
        """Fade out and release the device."""
        if self._stream is None:
            return
        self._playback.fade(on=False)
        until = time.perf_counter() + (0.1 if hurry else self._section.fade_s + STALE)
        while not (self._is_lost or self._playback.is_faded(on=False)) and time.perf_counter() < until:
            time.sleep(0.01)
            self._watch()
        self._close()
        self._log("masking", state="off", n_underflows=self._n_underflows)

    def _fill(self, out: Any, n_frames: int, moment: Any, status: Any) -> None:
        """Provide the next samples; called by PortAudio in a separate thread."""
        self._asked = time.perf_counter()
        self._n_underflows += bool(status.output_underflow)
        self._playback.fill(out)

    @property
    def _loss(self) -> str:
        return f"the sound device {self._device.get('name')!r} accepts no more samples"

    @property
    def _is_fed(self) -> bool:
        return self._stream is not None and self._stream.active and time.perf_counter() - self._asked <= STALE

    def _watch(self) -> None:
        """Detect a lost device, and record it once."""
        if not (self._is_lost or self._is_fed):
            self._is_lost = True
            # By the record's clock, since an answer of the last second may have been recorded as masked.
            self._log("masking_lost", reason=self._loss, last_samples_s=round(self._asked, 6))

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(Exception):
                stream.abort()
            with contextlib.suppress(Exception):
                stream.close()
