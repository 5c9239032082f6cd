"""Noise over an exact spectrum, whose period repeats without a seam, and the sound device that plays it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from modaltouch.protocol import Apparatus

Kind = Literal["pink", "white"]

LOWEST, HIGHEST = 20.0, 20_000.0
"""Band of the noise: what can be heard [Hz]."""

PERIOD = 10.0
"""Length of the period [s]; nobody hears a repetition this slow."""

SEED = 20_120_501
"""Of the random phases: the noise of every session is the same."""

SINE_DB = 20 * math.log10(math.sqrt(2))
"""How far the rms of a sine of full scale, 0 dB FS (AES17), lies below full scale [dB]."""


@lru_cache(maxsize=4)
def make_noise(kind: Kind, sampling_rate: float) -> NDArray[np.float32]:
    """Return one period of noise with a root mean square of 1, without a seam and read-only, (n_samples,) array [1].

    Parameters
    ----------
    kind : str
        ``pink``, power falling with frequency, or ``white``, power even.
    sampling_rate : float
        Samples per second [Hz].
    """
    n_samples = round(PERIOD * sampling_rate)
    frequency = np.fft.rfftfreq(n_samples, 1 / sampling_rate)
    in_band = (frequency >= LOWEST) & (frequency <= min(HIGHEST, 0.45 * sampling_rate))
    magnitude = np.zeros(frequency.size)
    magnitude[in_band] = 1.0 if kind == "white" else 1 / np.sqrt(frequency[in_band])
    # Raw words, whose stream numpy promises to keep: the same noise in every version.
    words = np.random.PCG64(SEED).random_raw(frequency.size)
    phase = words.astype(np.float64) * (2 * np.pi / 2.0**64)
    samples = np.fft.irfft(magnitude * np.exp(1j * phase), n_samples)
    noise: NDArray[np.float32] = (samples / np.sqrt(np.mean(samples**2))).astype(np.float32)
    noise.flags.writeable = False
    return noise


def amplitude_at(level: float) -> float:
    """Return the root mean square of noise at a level [dB FS], as a share of full scale [1].

    Examples
    --------
    >>> round(amplitude_at(0.0), 4)
    0.7071
    """
    return float(10 ** ((level - SINE_DB) / 20))


class DeviceError(Exception):
    """There is no sound device, or it refuses; says why, and what to do about it."""


def default_device(name: str = "") -> dict[str, Any]:
    """Return what a device can do, as PortAudio tells it.

    Parameters
    ----------
    name : str
        Part of its name; empty for the system's own choice.

    Raises
    ------
    DeviceError
        If there is none, or no PortAudio.
    """
    try:
        import sounddevice
    except OSError as error:
        raise DeviceError(f"{error}; install libportaudio2 (`make install`)") from error
    try:
        return dict(sounddevice.query_devices(name or None, kind="output"))
    except (sounddevice.PortAudioError, ValueError) as error:
        what = f"no sound device like {name!r}" if name else "no sound device"
        remedy = "connect one and choose it with sound.device in the apparatus"
        raise DeviceError(f"there is {what} ({error}); {remedy}") from error


def open_stream(apparatus: Apparatus, fill: Callable[..., None]) -> tuple[dict[str, Any], Any]:
    """Return what the device can do, and a stream on it that runs."""
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
        raise DeviceError(
            f"the sound device {device.get('name')!r} refuses {sound.sampling_rate_Hz:g} Hz ({error}); change "
            "sound.sampling_rate_Hz or sound.device in the apparatus"
        ) from error
    return device, stream


class LoopedNoise:
    """Goes round a period of noise for ever."""

    def __init__(self, period: NDArray[np.float32], n_fade: int) -> None:
        self._period = period
        self._n_fade = max(n_fade, 1)
        self._place = 0
        self._way = self._target = 0

    def fade_in(self) -> None:
        """Let what follows grow to its full level."""
        self._target = self._n_fade

    def fade_out(self) -> None:
        """Let what follows fall silent."""
        self._target = 0

    @property
    def is_full(self) -> bool:
        """Whether the noise is at its full level."""
        return self._way == self._target == self._n_fade

    @property
    def is_silent(self) -> bool:
        """Whether nothing is heard any more."""
        return self._way == self._target == 0

    def fill(self, out: NDArray[np.float32]) -> None:
        """Write what comes next into a block.

        Parameters
        ----------
        out : (n_samples, n_channels) array
            Where it goes; every channel gets the same.
        """
        n = len(out)
        if self.is_silent:
            out.fill(0)
            return
        samples = np.take(self._period, np.arange(self._place, self._place + n), mode="wrap")
        self._place = (self._place + n) % len(self._period)
        if self._way != self._target:
            ahead = np.arange(1, n + 1) * (1 if self._target > self._way else -1)
            way = np.clip(self._way + ahead, 0, self._n_fade)
            self._way = int(way[-1])
            # Along half a sine: neither end has a corner.
            samples = samples * np.sin(np.pi / 2 * way / self._n_fade).astype(np.float32) ** 2
        out[:] = samples[:, np.newaxis]
