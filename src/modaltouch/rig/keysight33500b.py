"""The two-channel models of the Keysight 33500B series: 33522B and 33512B.

Specifications and commands are from Keysight's data sheet and operating and service guide. Properties found in neither
are marked *unverified*; the driver has not been tested on a real instrument.

To verify a record, the instrument writes it to a file, which is read back and compared code by code. If the file cannot
be read, the record is verified only by four statistics computed by the instrument (points, average, peak to peak, crest
factor), to the digits that it returns. These reveal missing parts and a wrong byte order, scale or record, but neither
a single wrong code that changes none of them nor reordered codes. The log then contains the event `record_figures`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.instrument import Commands, Instrument, Setting
from modaltouch.rig.interface import LinkError, Unconfirmed
from modaltouch.stimulus import Converter

if TYPE_CHECKING:
    from modaltouch.rig.controls import Controls

ZERO = 32767
"""The driver's code for 0 V; its codes start at 0, whereas those of the instrument run from -32767 to 32767."""

FILE = r'"INT:\MODALTOUCH.ARB"'
"""File on the instrument for reading back a record; deleted afterwards."""

FIGURES = ("POIN", "AVER", "PTP", "CFAC")


@dataclass(frozen=True)
class ChannelMemories:
    """Records in one memory per channel, under names derived from their content.

    The memories cannot be locked; a record selected at the front panel is recognised by its name. Names are never
    reused for other codes, since overwriting a record is an error and single records cannot be deleted.

    Attributes
    ----------
    n_memories : int
        Number of records of maximum length that fit into the memory of a channel.
    """

    n_memories: int

    def store(self, controls: Controls, records: Sequence[tuple[int, NDArray[np.uint16]]]) -> list[str]:
        """Store records in the memories of their channels, verify them, and return their names."""
        # Names must begin with a letter and have at most twelve characters.
        names = ["MT" + hashlib.sha256(codes.tobytes()).hexdigest()[:10].upper() for _, codes in records]
        for channel in dict.fromkeys(channel for channel, _ in records):
            wanted = {name: codes for name, (each, codes) in zip(names, records, strict=True) if each == channel}
            if all(controls.stored.get(f"{channel}:{name}") for name in wanted):
                continue
            event = "record_found"
            if not self._holds(controls, channel, wanted):
                event = "record_sent"
                controls.upload_twice(f"{channel}:{','.join(wanted)}", partial(self._upload, controls, channel, wanted))
            for name, codes in wanted.items():
                digest = hashlib.sha256(codes.astype(">u2").tobytes()).hexdigest()
                controls.stored[f"{channel}:{name}"] = digest
                controls.log(event, memory=f"{channel}:{name}", sha256=digest, n_points=codes.size)
        return names

    def _holds(self, controls: Controls, channel: int, wanted: dict[str, NDArray[np.uint16]]) -> bool:
        """Test whether the memory of a channel already holds all records."""
        held = controls.ask(f"SOUR{channel}:DATA:VOL:CAT?").upper()
        try:
            return all(f'"{name}"' in held and _verified(controls, channel, name, wanted[name]) for name in wanted)
        except Unconfirmed:
            return False

    def _upload(self, controls: Controls, channel: int, wanted: dict[str, NDArray[np.uint16]]) -> None:
        for known in [memory for memory in controls.stored if memory.startswith(f"{channel}:")]:
            del controls.stored[known]
        # Names in use are rejected (error 786), even if the record under that name is corrupt.
        controls.complete(f"SOUR{channel}:DATA:VOL:CLE")
        controls.apply([Setting("FORM:BORD", "NORM", replies=("NORM", "NORMAL"))])
        for name, codes in wanted.items():
            block = (codes.astype(int) - ZERO).astype(">i2").tobytes()
            controls.send_block(f"SOUR{channel}:DATA:ARB:DAC {name}", block)
            controls.complete()
            if not _verified(controls, channel, name, codes):
                raise Unconfirmed(
                    f"{name} of output {channel} does not hold the record that was sent, after two uploads"
                )


def _verified(controls: Controls, channel: int, name: str, codes: NDArray[np.uint16]) -> bool:
    """Verify a stored record by its statistics and, if it can be read back, by every code."""
    replies = [controls.ask(f"SOUR{channel}:DATA:ATTR:{figure}? {name}") for figure in FIGURES]
    if not all(_agrees(*each) for each in zip(replies, figures(codes), strict=True)):
        return False
    for _ in range(2):
        try:
            read = _read_back(controls, channel, name)
        except LinkError:
            controls.revive()
            continue
        if read is not None:
            return bool(np.array_equal(read, codes))
    controls.log("record_figures", memory=f"{channel}:{name}", figures=replies, why="its file cannot be read back")
    return True


def figures(codes: NDArray[np.uint16]) -> tuple[float, ...]:
    """Return points, average, peak to peak and crest factor of a record scaled to the range -1 to 1."""
    values = (codes.astype(float) - ZERO) / ZERO
    rms = float(np.sqrt(np.mean(values**2)))
    return float(values.size), float(values.mean()), float(np.ptp(values)), float(np.abs(values).max() / (rms or 1.0))


def _agrees(reply: str, figure: float) -> bool:
    """Test whether a reply agrees with a statistic to one unit of its last digit."""
    mantissa, _, exponent = reply.upper().partition("E")
    decimals = len(mantissa.partition(".")[2])
    try:
        return abs(float(reply) - figure) <= 1.001 * 10.0 ** (int(exponent or 0) - decimals) * (decimals > 0) + 1e-9
    except (ValueError, OverflowError):
        return False


def _read_back(controls: Controls, channel: int, name: str) -> NDArray[np.int_] | None:
    """Return the codes of a record from the file written by the instrument; None if there is no such file."""
    # Unverified: that the file contains the selected record, and the format of its header.
    controls.apply([Setting(f"SOUR{channel}:FUNC:ARB", f'"{name}"', replies=(f'"{name}"', name))])
    try:
        controls.complete(f"MMEM:STOR:DATA{channel} {FILE}")
    except Unconfirmed:
        return None
    content = controls.ask_block(f"MMEM:UPL? {FILE}")
    controls.complete(f"MMEM:DEL {FILE}")
    try:
        head, _, body = content.decode("ascii").partition("Data:")
        # Files of any data type other than codes cannot be used.
        points = np.array(body.split(), dtype=int) if '"short"' in head.lower() else None
    except (ValueError, OverflowError) as error:
        raise LinkError(f"the file of {name} cannot be read ({error})") from error
    return None if points is None else points + ZERO


def _level(name: str) -> Setting:
    return Setting("SOUR{channel}:VOLT", name, "VPP")


_SELECTED = (
    Setting("SOUR{channel}:FUNC:ARB", '"{memory}"', replies=('"{memory}"', "{memory}")),
    Setting("SOUR{channel}:FUNC", "ARB"),
    Setting("SOUR{channel}:FUNC:ARB:ADV", "SRAT", replies=("SRAT", "SRATE")),
    # Each sample is held until the next, as assumed when the stimulus is computed.
    Setting("SOUR{channel}:FUNC:ARB:FILT", "OFF"),
    Setting("SOUR{channel}:FUNC:ARB:SRAT", "sampling_rate", tolerance=1e-6),
)
"""Settings to play a record sample by sample; the record is selected first, since its file may contain settings."""

KEYSIGHT_33500B = Instrument(
    models=("33522B", "33512B"),
    converter=Converter(
        mid_code=ZERO,
        # Four records fit into the 1,048,576 points of a channel without the option MEM.
        max_points=262_144,
        # Upper bound without a filter; below it, the sample rate is arbitrary (Trueform). Unverified: its resolution.
        clock_rate=62.5e6,
        amplitude_digits=4,
        amplitude_decimals=4,
        # For "Sinc", which ranges from -0.217 to 1, the guide allows 6.087 V of 10; a user's 33522B played values from
        # 0 to 1 at 0.9 Vpp as 0 to 0.9 V. `modaltouch rig check` tests the instrument itself (question 14).
        of_record=True,
        any_rate=True,
    ),
    channels=(1, 2),
    lowest_amplitude=2e-3,
    quiet_amplitude=0.1,
    highest_output=10.0,
    commands=Commands(
        output=Setting("OUTP{channel}", "ON"),
        level=_level("amplitude"),
        quiet=(
            Setting("OUTP{channel}:LOAD", "INF"),
            Setting("OUTP{channel}:POL", "NORM", replies=("NORM", "NORMAL")),
            Setting("SOUR{channel}:VOLT:UNIT", "VPP"),
            Setting("SOUR{channel}:VOLT:OFFS", 0.0, "V"),
            _level("quiet_amplitude"),
            Setting("SOUR{channel}:VOLT:LIM:HIGH", "highest", "V"),
            Setting("SOUR{channel}:VOLT:LIM:LOW", "lowest", "V"),
            Setting("SOUR{channel}:VOLT:LIM:STAT", "ON"),
        ),
        burst=_SELECTED,
        continuous=(*_SELECTED, Setting("SOUR{channel}:BURS:STAT", "OFF")),
        triggered=(
            Setting("SOUR{channel}:BURS:MODE", "TRIG", replies=("TRIG", "TRIGGERED")),
            Setting("SOUR{channel}:BURS:NCYC", 1.0),
            # 0 degrees is the first point of a record, where the output rests between bursts.
            Setting("SOUR{channel}:BURS:PHAS", 0.0),
            Setting("TRIG{channel}:DEL", 0.0),
            Setting("SOUR{channel}:BURS:STAT", "ON"),
        ),
        stopped=Setting("TRIG{channel}:SOUR", "BUS"),
        wired=Setting("TRIG{channel}:SOUR", "EXT", replies=("EXT", "EXTERNAL")),
        # One command for both channels; unverified: the skew between them (`modaltouch rig check`, question 10).
        trigger="*TRG",
        align="FUNC:ARB:SYNC",
        # The connector is also the trigger input: an external trigger source switches its pulses off.
        pulses=(Setting("OUTP:TRIG", "ON"),),
        # No timer: each channel has a separate one, and no command is known to start them together.
    ),
    records=ChannelMemories(n_memories=4),
    # The questions on the trigger timer and on copying from the edit memory apply to the AFG3022B only.
    questions=(0, 6, 7, 10, 13, 14),
)
