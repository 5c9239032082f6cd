"""A simulated Keysight 33522B (or 33512B), after its operating and service guide: state and SCPI commands.

An amplitude is that of the record, from its lowest to its highest code, as implied by the guide's figure for "Sinc" and
measured by users. Not modelled: filters (a record not played with FILTer OFF moves nothing), modulation, sweeps,
sequences, pulses and ramps, bursts of several cycles, gated or delayed bursts and those with a phase (nothing moves),
amplitudes in VRMS and DBM, triggering one of two channels in burst mode.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator import common, scpi
from modaltouch.rig.simulator.common import SOURCE_IMPEDANCE, Behaviour, GeneratorState, OutputChannel
from modaltouch.rig.simulator.scpi import Argument, Arguments, Command, CommandTable, ScpiError, one
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.stimulus import Converter

HIGHEST_CODE = 32767
CONVERTER = Converter(HIGHEST_CODE, 1 << 22, 62.5e6, 4, 6, of_record=True, any_rate=True)
"""Converter of the twin, independent of that of the driver; its limit on points is higher."""

MEMORY, FEWEST = 1 << 20, 8  # points of a channel's memory without options, and of the shortest record
BUILT_IN = r"INT:\BUILTIN\EXP_RISE.ARB"
LOWEST, HIGHEST = 2e-3, 20.0  # range of the amplitude into an open circuit [V peak to peak]
NUMBER = "{:+.15E}"
SHAPES = ("SINusoid", "SQUare", "TRIangle", "RAMP", "PULSe", "PRBS", "NOISe", "ARB", "DC")
Codes = NDArray[np.int16]


@dataclass
class TrueformChannel(OutputChannel):
    """Settings of one output, including its trigger source."""

    amplitude: float = 0.2
    limited: bool = False
    function: str = "SIN"
    frequency: float = 1e3
    rate: float = 40e3
    filter: str = "STEP"
    advance: str = "SRAT"
    name: str = BUILT_IN
    record: Codes | None = field(default=None, compare=False)
    burst_period: float = 10e-3
    source: str = "IMM"
    timer: float = 1.0

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value of the waveform, as fractions of the converter's range [1]."""
        if self.function != "ARB" or self.record is None:
            return -1.0, 1.0
        return float(self.record.min()) / HIGHEST_CODE, float(self.record.max()) / HIGHEST_CODE

    @property
    def span(self) -> float:
        """Fraction of the converter's range used by the waveform [1]."""
        return (self.ends[1] - self.ends[0]) / 2 or 1.0

    @property
    def cycle(self) -> float:
        """Length of one cycle [s]."""
        if self.function != "ARB":
            return 1 / self.frequency
        return (1 if self.record is None else self.record.size) / self.rate

    @property
    def room(self) -> float:
        """Highest amplitude within the enabled voltage limits, or otherwise within the range of an output [V]."""
        edges = (self.limit_low, self.limit_high) if self.limited else (-HIGHEST / 2, HIGHEST / 2)
        sides = zip((-1, 1), edges, self.ends, strict=True)
        shares = [(edge - self.offset) / end for side, edge, end in sides if side * end > 0]
        return min(shares, default=1.0) * 2 * self.span


@dataclass
class Trueform(GeneratorState[TrueformChannel]):
    """A generator with a memory for each channel."""

    files: dict[str, bytes] = field(default_factory=dict, init=False)

    def forget(self) -> None:
        """Clear the records; files are kept."""
        self.volatile: dict[int, dict[str, Codes]] = {1: {}, 2: {}}

    def reset(self) -> None:
        """Reset as ``*RST`` does; records, status and errors are kept."""
        self.channels = {1: TrueformChannel(), 2: TrueformChannel()}
        self.byte_order, self.trigger_output = "NORM", False

    def next_error(self) -> str:
        """Remove the oldest error and return it, its number with a sign."""
        error = super().next_error()
        return error if error.startswith("-") else f"+{error}"

    @property
    def waiting(self) -> TrueformChannel:
        """The first channel in burst mode; the other plays only if it has the same trigger source."""
        return next((each for each in self.channels.values() if each.burst), self.channels[1])

    def tick(self) -> float | None:
        """Return the time between triggers from timer or burst period [s]; None if bursts wait for triggers."""
        return {"TIM": self.waiting.timer, "IMM": self.waiting.burst_period}.get(self.waiting.source)

    @property
    def takes_external_trigger(self) -> bool:
        """Whether pulses at the trigger input start bursts."""
        return self.waiting.source == "EXT"

    @property
    def shows_bursts(self) -> bool:
        """Whether the trigger output is on, which shares its connector with the trigger input."""
        return self.trigger_output and not self.takes_external_trigger

    def trigger(self, number: int = 0) -> None:
        """Trigger the channels that wait for ``*TRG``, or a single channel with any trigger source."""
        if not number and self.waiting.source != "BUS":
            raise ScpiError(-211, "no channel in burst waits for the bus")
        if number and any(channel.burst for each, channel in self.channels.items() if each != number):
            raise ScpiError(-241, "not simulated: a trigger of one of two channels in burst")
        super().trigger()

    def sent(self, channel: TrueformChannel) -> Playback | None:
        """Return a single burst of a channel, or its record repeated without a trigger; None if it plays no record."""
        is_plain = (channel.function, channel.filter, channel.advance) == ("ARB", "OFF", "SRAT")
        starts = channel.is_simulated and channel.source == self.waiting.source
        if not is_plain or channel.record is None or (channel.burst and not starts):
            return None
        codes = (channel.record.astype(int) + HIGHEST_CODE).astype(">u2")
        sign = -1.0 if channel.polarity == "INV" else 1.0
        level = sign * channel.amplitude / channel.span, sign * channel.offset
        period = math.inf if channel.burst else channel.cycle
        return Playback(codes.tobytes(), *level, channel.cycle, period, int(codes[0]), converter=CONVERTER)

    def change(self, number: int, **settings: Any) -> None:
        """Change amplitude, offset or limits, into an open circuit [V]; reject outputs beyond the limits."""
        changed = replace(self.channels[number], **settings)
        if changed.amplitude > changed.room + 1e-9:
            if "amplitude" not in settings or self.behaviour.limit_violation == "error":
                raise ScpiError(-221, f"level and limits of output {number}")
            changed = replace(changed, amplitude=max(changed.room, LOWEST))
        self.channels[number] = changed

    def write(self, number: int, arguments: Arguments, scale: float) -> None:
        """Store a record, given as a block or as numbers, under a new name."""
        scpi.exactly(arguments[:2], 2)
        name, points = str(arguments[0]).upper(), arguments[1:]
        if len(points) == 1 and isinstance(points[0], bytes):
            kind = (">" if self.byte_order == "NORM" else "<") + ("i2" if scale == 1 else "f4")
            if len(points[0]) % int(kind[2]):
                raise ScpiError(-161, f"{len(points[0])} bytes")
            values = np.frombuffer(points[0], kind).astype(float)
        else:
            values = np.array([scpi.read_number(each, units={}, minimum=-1e6, maximum=1e6) for each in points])
        if not re.fullmatch(r"[A-Z]\w{,11}", name, re.ASCII) or values.size < FEWEST:
            raise ScpiError(-220, f"{name[:20]} of {values.size} points")
        if not (np.abs(values * scale) <= HIGHEST_CODE).all():
            raise ScpiError(-222, "a point beyond the converter's range")
        if name in self.volatile[number]:
            raise ScpiError(786, "Specified arb waveform already exists")
        if values.size > self.free(number):
            raise ScpiError(-225, f"{name[:40]} of {values.size} points")
        self.volatile[number][name] = np.round(values * scale).astype(np.int16)

    def free(self, number: int) -> int:
        """Return the number of free points in a channel's memory."""
        return MEMORY - sum(codes.size for codes in self.volatile[number].values())

    def find(self, number: int, arguments: Arguments) -> Codes:
        """Return a record by name; without a name, the selected record."""
        codes = self.volatile[number].get(str(one(arguments)).upper() if arguments else self.channels[number].name)
        if codes is None:
            raise ScpiError(785, "Specified arb waveform does not exist")
        return codes

    def select(self, number: int, name: Argument) -> None:
        """Select a record; the amplitude is kept, or reduced to the highest possible for this record."""
        channel = self.channels[number]
        channel.record = None if str(name).upper() == BUILT_IN else self.find(number, (name,))
        channel.name, channel.amplitude = str(name).upper(), min(channel.amplitude, HIGHEST * channel.span)

    def clear(self, number: int) -> None:
        """Clear the memory of a channel and select the built-in record."""
        self.volatile[number] = {}
        self.select(number, BUILT_IN)


def keysight_twin(model: str, behaviour: Behaviour | None, **hardware: Any) -> tuple[Trueform, CommandTable]:
    """Return the state of a simulated instrument, and its command table."""
    state = Trueform(behaviour or Behaviour(queue_depth=20), **hardware)
    state.identity = f"Agilent Technologies,{model},SIMULATED,4.00-1.19-2.00-58-00"
    groups = (_waveform, _data, _levels, _triggers)
    return state, common.command_table(state, groups, "KEYSIGHT_33500B", NUMBER)


def _waveform(state: Trueform) -> dict[str, Command]:
    return {
        "[SOURce#]:FUNCtion": common.keyword(state, "function", SHAPES),
        "[SOURce#]:FUNCtion:ARBitrary": Command(
            set=lambda n, a: state.select(n, one(a)), get=common.get_of(state, lambda channel: f'"{channel.name}"')
        ),
        "[SOURce#]:FUNCtion:ARBitrary:SRATe": common.number(state, "rate", {"": 1.0}, 1e-6, 62.5e6, NUMBER),
        "[SOURce#]:FUNCtion:ARBitrary:FILTer": common.keyword(state, "filter", ("NORMal", "STEP", "OFF")),
        "[SOURce#]:FUNCtion:ARBitrary:ADVance": common.keyword(state, "advance", ("TRIGger", "SRATe")),
        "[SOURce#]:FUNCtion:ARBitrary:SYNChronize": Command(set=common.bare(lambda _: state.align())),
        "[SOURce#]:FREQuency": common.number(state, "frequency", {"HZ": 1.0}, 1e-6, 30e6, NUMBER),
        "[SOURce#]:PHASe:SYNChronize": Command(set=common.bare(lambda _: state.align())),
    }


def _data(state: Trueform) -> dict[str, Command]:
    def attribute(read: Any) -> Command:
        return Command(get=lambda n, a: read(state.find(n, a).astype(float) / HIGHEST_CODE))

    def store(n: int, arguments: Arguments) -> None:
        channel, codes = state.channels[n], state.find(n, ())
        head = f'File Format:1.10\nChannel Count:1\nSample Rate:{channel.rate:f}\nData Type:"short"\n'
        body = f"Data Points:{codes.size}\nData:\n" + "\n".join(map(str, codes.tolist())) + "\n"
        state.files[str(one(arguments)).upper()] = (head + body).encode()

    def upload(n: int, arguments: Arguments) -> bytes:
        content = state.files.get(str(one(arguments)).upper(), b"")
        if not content:
            raise ScpiError(-256, str(arguments[0])[:40])
        return f"#{len(str(len(content)))}{len(content)}".encode() + content

    return {
        "[SOURce#]:DATA:ARBitrary:DAC": Command(set=lambda n, a: state.write(n, a, 1)),
        "[SOURce#]:DATA:ARBitrary": Command(set=lambda n, a: state.write(n, a, HIGHEST_CODE)),
        "[SOURce#]:DATA:VOLatile:CATalog": Command(
            get=common.bare(lambda n: ",".join(f'"{name}"' for name in (BUILT_IN, *state.volatile[n])))
        ),
        "[SOURce#]:DATA:VOLatile:CLEar": Command(set=common.bare(state.clear)),
        "[SOURce#]:DATA:VOLatile:FREE": Command(get=common.bare(lambda n: f"{state.free(n):+d}")),
        "[SOURce#]:DATA:ATTRibute:POINts": attribute(lambda values: f"{values.size:+d}"),
        "[SOURce#]:DATA:ATTRibute:AVERage": attribute(lambda values: f"{values.mean():+.4f}"),
        "[SOURce#]:DATA:ATTRibute:PTPeak": attribute(lambda values: f"{np.ptp(values):+.4f}"),
        "[SOURce#]:DATA:ATTRibute:CFACtor": attribute(lambda v: f"{abs(v).max() / ((v**2).mean() ** 0.5 or 1):+.4f}"),
        "MMEMory:STORe:DATA#": Command(set=store),
        "MMEMory:UPLoad": Command(get=upload),
        "MMEMory:DELete": Command(set=lambda n, a: state.files.pop(str(one(a)).upper(), None) and None),
        "FORMat:BORDer": common.keyword(state, "byte_order", ("NORMal", "SWAPped")),
    }


def _levels(state: Trueform) -> dict[str, Command]:
    def level(name: str, low: float, high: float) -> Command:
        def most_of(channel: TrueformChannel) -> float:
            return high * (channel.span if name == "amplitude" else 1.0)

        def change(n: int, arguments: Arguments) -> None:
            channel, most = state.channels[n], most_of(state.channels[n])
            value = scpi.read_number(one(arguments), {"V": 1.0, "VPP": 1.0}, -1e38, 1e38) / channel.load_factor
            state.change(n, **{name: float(f"{min(max(value, low), most):.4g}")})
            if not low - 1e-9 <= value <= most + 1e-9 and abs(value) < 1e38:
                # A value out of range is clipped and reported, unless it stands for MIN or MAX.
                raise ScpiError(-222, "value clipped to limit")

        def get(n: int, arguments: Arguments) -> str:
            value = scpi.asked(arguments, getattr(state.channels[n], name), low, most_of(state.channels[n]))
            return NUMBER.format(value * state.channels[n].load_factor)

        return Command(set=change, get=get)

    return {
        "[SOURce#]:VOLTage": level("amplitude", LOWEST, HIGHEST),
        "[SOURce#]:VOLTage:OFFSet": level("offset", -10, 10),
        "[SOURce#]:VOLTage:HIGH": common.edge(state, 1, LOWEST, NUMBER),
        "[SOURce#]:VOLTage:LOW": common.edge(state, -1, LOWEST, NUMBER),
        "[SOURce#]:VOLTage:LIMit:HIGH": level("limit_high", -10, 10),
        "[SOURce#]:VOLTage:LIMit:LOW": level("limit_low", -10, 10),
        "[SOURce#]:VOLTage:LIMit:STATe": Command(
            set=lambda n, a: state.change(n, limited=scpi.read_boolean(one(a))),
            get=common.get_of(state, lambda channel: scpi.flag(channel.limited)),
        ),
        "OUTPut#": common.switch(state, "output"),
        "OUTPut#:LOAD": common.number(state, "load", {"OHM": 1.0}, 1, 10e3, NUMBER, SOURCE_IMPEDANCE, endless=True),
        "OUTPut#:POLarity": common.keyword(state, "polarity", ("NORMal", "INVerted")),
    }


def _triggers(state: Trueform) -> dict[str, Command]:
    shown = common.bare(lambda _: scpi.flag(state.shows_bursts))
    return {
        "[SOURce#]:BURSt:STATe": common.switch(state, "burst"),
        "[SOURce#]:BURSt:MODE": common.keyword(state, "burst_mode", ("TRIGgered", "GATed")),
        "[SOURce#]:BURSt:NCYCles": common.number(state, "n_cycles", {}, 1, 1e8, NUMBER, endless=True),
        "[SOURce#]:BURSt:PHASe": common.number(state, "phase", {"DEG": 1.0}, -360, 360, NUMBER),
        "[SOURce#]:BURSt:INTernal:PERiod": common.number(state, "burst_period", {"S": 1.0}, 1e-6, 8000, NUMBER),
        "TRIGger#:SOURce": common.keyword(state, "source", ("IMMediate", "EXTernal", "TIMer", "BUS")),
        "TRIGger#:TIMer": common.number(state, "timer", {"S": 1.0}, 1e-6, 8000, NUMBER),
        "TRIGger#:DELay": common.number(state, "delay", {"S": 1.0}, 0, 1000, NUMBER),
        "TRIGger#[:IMMediate]": Command(set=common.bare(state.trigger)),
        "OUTPut:TRIGger": replace(common.switch(state, "trigger_output"), get=shown),
        "DISPlay:TEXT[:CLEar]": Command(set=lambda n, a: None),
    }
