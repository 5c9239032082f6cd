"""The Tektronix AFG3022B: specifications and commands from the data sheet and programmer manual."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.instrument import Commands, Instrument, Setting
from modaltouch.rig.interface import LinkError, Unconfirmed
from modaltouch.stimulus import Converter

if TYPE_CHECKING:
    from modaltouch.rig.controls import Controls

N_SPOTS = 64


@dataclass(frozen=True)
class EditMemory:
    """Records in numbered memories shared by all channels, stored via an edit memory and read back in full.

    If blocks cannot be read back, the number of points and a sample of them are compared.
    """

    n_memories: int

    def store(self, controls: Controls, records: Sequence[tuple[int, NDArray[np.uint16]]]) -> list[str]:
        """Store and verify records that are not yet stored; return the numbers of their memories."""
        used: list[str] = []
        for channel, codes in records:
            used.append(self._store(controls, codes, str(channel), used))
        return used

    def _store(self, controls: Controls, codes: NDArray[np.uint16], wanted: str, in_use: Sequence[str]) -> str:
        """Return the memory of a record; if not yet stored, store it in the preferred memory, or another if in use."""
        digest = hashlib.sha256(codes.astype(">u2").tobytes()).hexdigest()
        known = [memory for memory, held in controls.stored.items() if held == digest]
        if known:
            return known[0]
        if wanted in in_use:
            memories = (str(number) for number in range(self.n_memories, 0, -1))
            wanted = next(memory for memory in memories if memory not in in_use)
        if wanted not in controls.stored and self._holds(controls, wanted, codes):
            controls.log("record_found", memory=f"USER{wanted}", sha256=digest, n_points=codes.size)
        else:
            self._upload(controls, wanted, codes)
            controls.log("record_sent", memory=f"USER{wanted}", sha256=digest, n_points=codes.size)
        controls.stored[wanted] = digest
        return wanted

    def _holds(self, controls: Controls, memory: str, codes: NDArray[np.uint16]) -> bool:
        if f"USER{memory}" not in controls.ask("DATA:CAT?"):
            return False
        try:
            return self._read_back(controls, memory) == codes.astype(">u2").tobytes()
        except Unconfirmed:
            return False
        except LinkError:
            controls.revive()
            return False

    def _upload(self, controls: Controls, memory: str, codes: NDArray[np.uint16]) -> None:
        controls.stored.pop(memory, None)
        controls.apply([LOCKED.filled(memory=memory).off])
        controls.upload_twice(f"USER{memory}", lambda: self._upload_once(controls, memory, codes))

    def _upload_once(self, controls: Controls, memory: str, codes: NDArray[np.uint16]) -> None:
        controls.send_block("DATA:DATA EMEM", codes.astype(">u2").tobytes())
        (n_points,) = controls.complete("", "DATA:POIN? EMEM")
        if n_points != str(codes.size):
            raise Unconfirmed(f"{codes.size} points were sent, but the generator counts {n_points}")
        controls.complete(f"DATA:COPY USER{memory},EMEM")
        if not self._verified(controls, memory, codes):
            raise Unconfirmed(f"USER{memory} does not hold the record that was sent, after two uploads")

    def _verified(self, controls: Controls, memory: str, codes: NDArray[np.uint16]) -> bool:
        """Verify a memory by reading it back; by a sample of points if blocks cannot be read."""
        for _ in range(2):
            try:
                return self._read_back(controls, memory) == codes.astype(">u2").tobytes()
            except LinkError:
                controls.revive()
        return self._spots_agree(controls, memory, codes)

    def _read_back(self, controls: Controls, memory: str) -> bytes:
        controls.complete(f"DATA:COPY EMEM,USER{memory}")
        return controls.ask_block("DATA:DATA? EMEM")

    def _spots_agree(self, controls: Controls, memory: str, codes: NDArray[np.uint16]) -> bool:
        """Test whether a memory agrees with a record in length, largest points and evenly spaced points."""
        # If the copies to be read back were lost, the edit memory would still hold what was sent.
        controls.complete(f"DATA:COPY EMEM,USER{memory}")
        controls.log("record_spot_check", n_spots=N_SPOTS, why="its blocks cannot be read back")
        if controls.ask("DATA:POIN? EMEM") != str(codes.size):
            return False
        strongest = np.argsort(np.abs(codes.astype(int) - int(np.median(codes))))[-N_SPOTS // 2 :]
        spread = np.linspace(0, codes.size - 1, N_SPOTS // 2).astype(int)
        return all(controls.ask(f"DATA:DATA:VAL? EMEM,{at + 1}") == str(codes[at]) for at in {*strongest, *spread})


LOCKED = Setting("DATA:LOCK:STAT", "ON", of="USER{memory}")
"""Protects a memory from being overwritten, even at the front panel."""

AFG3022B = Instrument(
    # The successor has the same commands and limits.
    models=("AFG3022B", "AFG3022C"),
    converter=Converter(mid_code=8191, max_points=131_072, clock_rate=250e6, amplitude_digits=4, amplitude_decimals=4),
    channels=(1, 2),
    lowest_amplitude=20e-3,
    # Above every minimum amplitude stated for these instruments.
    quiet_amplitude=0.1,
    highest_output=10.0,
    commands=Commands(
        output=Setting("OUTP{channel}", "ON"),
        level=Setting("SOUR{channel}:VOLT", "amplitude", "VPP"),
        quiet=(
            Setting("OUTP{channel}:IMP", "INF"),
            Setting("OUTP{channel}:POL", "NORM", replies=("NORM", "NORMAL")),
            Setting("SOUR{channel}:VOLT:UNIT", "VPP"),
            Setting("SOUR{channel}:VOLT:OFFS", 0.0, "V"),
            Setting("SOUR{channel}:VOLT", "quiet_amplitude", "VPP"),
            Setting("SOUR{channel}:VOLT:LIM:HIGH", "highest", "V"),
            Setting("SOUR{channel}:VOLT:LIM:LOW", "lowest", "V"),
        ),
        burst=(
            Setting("SOUR{channel}:FREQ", "burst_rate", "HZ", tolerance=1e-6),
            Setting("SOUR{channel}:FUNC", "USER{memory}"),
        ),
        triggered=(
            Setting("SOUR{channel}:BURS:MODE", "TRIG", replies=("TRIG", "TRIGGERED")),
            Setting("SOUR{channel}:BURS:NCYC", 1.0),
            Setting("SOUR{channel}:BURS:TDEL", 0.0, "S"),
            Setting("SOUR{channel}:PHAS", 0.0, "RAD"),
            Setting("SOUR{channel}:BURS:STAT", "ON"),
        ),
        continuous=(
            Setting("SOUR{channel}:FREQ", "repetition_rate", "HZ", tolerance=1e-6),
            Setting("SOUR{channel}:FUNC", "USER{memory}"),
            Setting("SOUR{channel}:PHAS", 0.0, "RAD"),
            Setting("SOUR{channel}:BURS:STAT", "OFF"),
        ),
        # Nothing is connected to the trigger input unless stated in the apparatus file.
        stopped=Setting("TRIG:SOUR", "EXT", replies=("EXT", "EXTERNAL")),
        wired=Setting("TRIG:SOUR", "EXT", replies=("EXT", "EXTERNAL")),
        trigger="TRIG:SEQ:IMM",
        align="SOUR1:PHAS:INIT",
        # The instrument may round the period to as few as four digits.
        timer=Setting("TRIG:TIM", "period", "S", tolerance=5e-4),
        armed=Setting("TRIG:SOUR", "TIM", replies=("TIM", "TIMER")),
        locks=(LOCKED,),
        # The number of points of the edit memory, which is not played.
        marks=(Setting("DATA:POIN", "mark", of="EMEM", tolerance=0.0),),
    ),
    records=EditMemory(n_memories=4),
    questions=(0, 2, 3, 6, 7, 10, 13),
)
