"""The Tektronix AFG3022B: its figures and its commands, by Tektronix' data sheet and programmer manual."""

from __future__ import annotations

from modaltouch.rig.instrument import Commands, Instrument, Setting
from modaltouch.stimulus import Converter

AFG3022B = Instrument(
    # The successor takes the same commands within the same limits.
    models=("AFG3022B", "AFG3022C"),
    converter=Converter(mid_code=8191, max_points=131_072, clock_rate=250e6, amplitude_digits=4, amplitude_decimals=4),
    channels=(1, 2),
    memories=(1, 2, 3, 4),
    lowest_amplitude=20e-3,
    # Above every minimum that is told of these instruments.
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
        # Of the timer the instrument may keep as few as four digits.
        timer=Setting("TRIG:TIM", "period", "S", tolerance=5e-4),
        armed=Setting("TRIG:SOUR", "TIM", replies=("TIM", "TIMER")),
        stopped=Setting("TRIG:SOUR", "EXT", replies=("EXT", "EXTERNAL")),
        locked=Setting("DATA:LOCK:STAT", "ON", of="USER{memory}"),
        triggers=("TRIG:SEQ:IMM", "*TRG"),
        align="SOUR1:PHAS:INIT",
        memory="USER{memory}",
        upload="DATA:DATA EMEM",
        count="DATA:POIN? EMEM",
        read="DATA:DATA? EMEM",
        point="DATA:DATA:VAL? EMEM,{place}",
        store="DATA:COPY USER{memory},EMEM",
        recall="DATA:COPY EMEM,USER{memory}",
        catalogue="DATA:CAT?",
    ),
)
