"""A sound device, as PortAudio knows it: which there is, and a stream on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modaltouch.apparatus import Sound


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


def open_stream(sound: Sound, fill: Callable[..., None]) -> tuple[dict[str, Any], Any]:
    """Return what the device can do, and a stream on it that runs.

    Parameters
    ----------
    sound : Sound
        Which device, at which rate.
    fill : callable
        Hands over the next samples, as sounddevice calls it.

    Raises
    ------
    DeviceError
        If there is no such device, or it refuses.
    """
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
