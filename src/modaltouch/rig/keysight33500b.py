"""The Keysight 33500B series: 33522B and 33512B, the models with two channels.

Figures and commands are those of Keysight's data sheet and operating and service guide. What stands in neither, or was
not to be had, is marked *unverified*; no real one has been met.

A record is verified by reading it back as the file that the instrument writes of it, code by code. Where no such file
can be read, what is left are the four figures that the instrument computes of a record (points, average, peak to peak,
crest factor), to the digits it tells. They notice a lost part, another byte order, scale or record; a single wrong code
passes as long as it moves no figure, and so does another order of the same codes. The log then says `record_figures`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.instrument import Commands, Desk, Instrument, Setting, upload_twice
from modaltouch.rig.interface import LinkError, Unconfirmed
from modaltouch.rig.link import block_bounds
from modaltouch.stimulus import Converter

ZERO = 32767
"""Of the driver's codes, which count from 0; those of the instrument run from -32767 to 32767."""

FILE = r'"INT:\MODALTOUCH.ARB"'
"""Where the instrument writes a record to be read back; taken away afterwards."""

FIGURES = ("POIN", "AVER", "PTP", "CFAC")


@dataclass(frozen=True)
class ChannelMemories:
    """Records in a memory to each channel, under names made of their content.

    A name is never used again for other codes: to write over one is an error, and single ones cannot be taken away.

    Attributes
    ----------
    n_memories : int
        Records that fit into a channel's memory, at their longest.
    """

    n_memories: int

    def store(self, desk: Desk, records: Sequence[tuple[int, NDArray[np.uint16]]]) -> list[str]:
        """Have records in the memories of their channels, verified, and return their names."""
        # A letter first, twelve at most.
        names = ["MT" + hashlib.sha256(codes.tobytes()).hexdigest()[:10].upper() for _, codes in records]
        for channel in dict.fromkeys(channel for channel, _ in records):
            wanted = {name: codes for name, (each, codes) in zip(names, records, strict=True) if each == channel}
            if all(desk.stored.get(f"{channel}:{name}") for name in wanted):
                continue
            event = "record_found"
            if not self._holds(desk, channel, wanted):
                event = "record_sent"
                upload_twice(desk, f"{channel}:{','.join(wanted)}", partial(self._upload, desk, channel, wanted))
            for name, codes in wanted.items():
                digest = hashlib.sha256(codes.astype(">u2").tobytes()).hexdigest()
                desk.stored[f"{channel}:{name}"] = digest
                desk.log(event, memory=f"{channel}:{name}", sha256=digest, n_points=codes.size)
        return names

    def locks(self, memories: Sequence[str]) -> list[Setting]:
        """Return nothing: names cannot be locked; what is selected at the front panel shows in its name."""
        return []

    def _holds(self, desk: Desk, channel: int, wanted: dict[str, NDArray[np.uint16]]) -> bool:
        """Return whether a channel's memory holds all records already."""
        held = desk.ask(f"SOUR{channel}:DATA:VOL:CAT?").upper()
        try:
            return all(f'"{name}"' in held and _verified(desk, channel, name, wanted[name]) for name in wanted)
        except Unconfirmed:
            return False

    def _upload(self, desk: Desk, channel: int, wanted: dict[str, NDArray[np.uint16]]) -> None:
        for known in [memory for memory in desk.stored if memory.startswith(f"{channel}:")]:
            del desk.stored[known]
        # Names in use are refused (error 786), and a record that a fault has spoiled bears its name.
        clear = f"SOUR{channel}:DATA:VOL:CLE"
        desk.complete(clear, f":{clear};*OPC?")
        desk.apply([Setting("FORM:BORD", "NORM", replies=("NORM", "NORMAL"))])
        for name, codes in wanted.items():
            block = (codes.astype(int) - ZERO).astype(">i2").tobytes()
            desk.send_block(f"SOUR{channel}:DATA:ARB:DAC {name}", block)
            desk.complete("the upload", "*OPC?")
            if not _verified(desk, channel, name, codes):
                raise Unconfirmed(
                    f"{name} of output {channel} does not hold the record that was sent, after two uploads"
                )


def _verified(desk: Desk, channel: int, name: str, codes: NDArray[np.uint16]) -> bool:
    """Return whether a record is there as it should be, by its figures and, where it can be read, by every code."""
    told = [desk.ask(f"SOUR{channel}:DATA:ATTR:{figure}? {name}") for figure in FIGURES]
    if not all(_agrees(*each) for each in zip(told, figures(codes), strict=True)):
        return False
    for _ in range(2):
        try:
            read = _read_back(desk, channel, name)
        except LinkError:
            desk.revive()
            continue
        if read is not None:
            return bool(np.array_equal(read, codes))
    desk.log("record_figures", memory=f"{channel}:{name}", figures=told, why="its file cannot be read back")
    return True


def figures(codes: NDArray[np.uint16]) -> tuple[float, ...]:
    """Return points, average, peak to peak and crest factor of a record, as parts of the converter's range."""
    values = (codes.astype(float) - ZERO) / ZERO
    rms = float(np.sqrt(np.mean(values**2)))
    return float(values.size), float(values.mean()), float(np.ptp(values)), float(np.abs(values).max() / (rms or 1.0))


def _agrees(reply: str, figure: float) -> bool:
    """Return whether a reply is a figure, to one of the last digit that it tells."""
    mantissa, _, exponent = reply.upper().partition("E")
    decimals = len(mantissa.partition(".")[2])
    try:
        return abs(float(reply) - figure) <= 1.001 * 10.0 ** (int(exponent or 0) - decimals) * (decimals > 0) + 1e-9
    except ValueError:
        return False


def _read_back(desk: Desk, channel: int, name: str) -> NDArray[np.uint16] | None:
    """Return the codes of a record from the file that the instrument writes of it; None if there is none to read."""
    # Unverified: that the file is of the record which is selected, and its head as read below.
    desk.apply([Setting(f"SOUR{channel}:FUNC:ARB", f'"{name}"', replies=(f'"{name}"', name))])
    store = f"MMEM:STOR:DATA{channel} {FILE}"
    try:
        desk.complete(store, f":{store};*OPC?")
    except Unconfirmed:
        return None
    content = desk.ask_raw(f"MMEM:UPL? {FILE}")
    desk.complete("MMEM:DEL", f":MMEM:DEL {FILE};*OPC?")
    try:
        start, end = block_bounds(content)
        head, _, body = content[start:end].decode("ascii").partition("Data:")
        # Of another data type than codes it is of no use here.
        points = np.array(body.split(), dtype=int) if '"short"' in head.lower() else None
    except ValueError as error:
        raise LinkError(f"the file of {name} cannot be read ({error})") from error
    return None if points is None else (points + ZERO).astype(np.uint16)


def _level(name: str) -> Setting:
    return Setting("SOUR{channel}:VOLT", name, "VPP")


_SELECTED = (
    Setting("SOUR{channel}:FUNC:ARB", '"{memory}"', replies=('"{memory}"', "{memory}")),
    Setting("SOUR{channel}:FUNC", "ARB"),
    Setting("SOUR{channel}:FUNC:ARB:ADV", "SRAT", replies=("SRAT", "SRATE")),
    # Each sample is held until the next, as the stimulus is computed for.
    Setting("SOUR{channel}:FUNC:ARB:FILT", "OFF"),
    Setting("SOUR{channel}:FUNC:ARB:SRAT", "sampling_rate", tolerance=1e-6),
)
"""What makes a channel play a record sample by sample; what of it a file of the record may bring along is set again."""

_BURST = (
    Setting("SOUR{channel}:BURS:MODE", "TRIG", replies=("TRIG", "TRIGGERED")),
    Setting("SOUR{channel}:BURS:NCYC", 1.0),
    # Of a record, 0 degrees is its first point; there the output rests between bursts.
    Setting("SOUR{channel}:BURS:PHAS", 0.0),
    Setting("TRIG{channel}:DEL", 0.0),
    Setting("SOUR{channel}:BURS:STAT", "ON"),
)

KEYSIGHT_33500B = Instrument(
    models=("33522B", "33512B"),
    converter=Converter(
        mid_code=ZERO,
        # Four records fit into the 1,048,576 points that a channel has without the option MEM.
        max_points=262_144,
        # Without a filter; the rate of samples is free below (Trueform). Unverified: how finely.
        clock_rate=62.5e6,
        amplitude_digits=4,
        amplitude_decimals=4,
        # Of "Sinc", which goes from -0.217 to 1, the guide allows 6.087 V of 10; a user's 33522B played values from 0
        # to 1 at 0.9 Vpp as 0 to 0.9 V. `modaltouch rig check` asks the instrument itself (question 14).
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
        burst=(*_SELECTED, *_BURST),
        continuous=(*_SELECTED, Setting("SOUR{channel}:BURS:STAT", "OFF")),
        stopped=Setting("TRIG{channel}:SOUR", "BUS"),
        wired=Setting("TRIG{channel}:SOUR", "EXT", replies=("EXT", "EXTERNAL")),
        # One for both channels; unverified: how far apart they then begin (`modaltouch rig check`, question 10).
        triggers=("*TRG",),
        align="FUNC:ARB:SYNC",
        # Each channel has a timer of its own, and nothing is known to start them together.
    ),
    records=ChannelMemories(n_memories=4),
    # Those about the trigger timer and the copy from the edit memory are an AFG3022B's.
    questions=(0, 1, 6, 7, 8, 10, 12, 13, 14),
)
