"""The simulated AFG3022B command by command, against the list in the project's notes on the instrument."""

from __future__ import annotations

import math

import numpy as np
import pytest

from modaltouch.rig.simulator.afg import afg_twin
from modaltouch.rig.simulator.common import Behaviour
from modaltouch.system.clock import VirtualClock

NO_ERROR = '0,"No error"'


class Bench:
    """An instrument without a transport."""

    def __init__(self, behaviour: Behaviour | None = None) -> None:
        self.clock = VirtualClock(100.0)
        self.afg, self.afg.table = afg_twin("AFG3022B", behaviour, clock=self.clock)

    def ask(self, message: str | bytes) -> str:
        """Return the replies to a message."""
        data = message if isinstance(message, bytes) else message.encode()
        return self.afg.execute(data).data.decode("latin1").rstrip("\n")

    def error(self, message: str | bytes) -> int:
        """Return the number of the error caused by a message, 0 for none."""
        self.ask(message)
        return int(self.ask("SYST:ERR?").partition(",")[0])

    def upload(self, codes: list[int], user: int = 1) -> None:
        """Store a record."""
        self.afg.run(block(codes), 0)
        self.ask(f"DATA:COPY USER{user},EMEM")


def block(codes: list[int]) -> bytes:
    """Return the command that sends a record."""
    data = b"".join(code.to_bytes(2, "big") for code in codes)
    length = str(len(data))
    return f"DATA EMEM,#{len(length)}{length}".encode() + data


@pytest.fixture
def bench() -> Bench:
    """Return an instrument that has just been switched on."""
    return Bench()


TRANSCRIPT = [
    ("*IDN?", "TEKTRONIX,AFG3022B,SIMULATED,SCPI:99.0 FV:3.2.2"),
    ("*OPC?", "1"),
    ("*TST?", "0"),
    ("*OPT?", "0"),
    ("*ESE 36;*ESE?", "36"),
    ("*SRE 255;*SRE?", "255"),
    ("*CLS;*ESR?", "0"),
    ("*OPC;*ESR?", "1"),
    ("*WAI;*STB?", "0"),
    ("SYST:ERR?", NO_ERROR),
    ("SYSTem:ERRor:NEXT?", NO_ERROR),
    ("SYST:VERS?", "1999.0"),
    ("DATA:DEF EMEM,1000;:DATA:POIN? EMEM", "1000"),
    ("TRACE:POINTS?", "1000"),
    ("DATA:DATA:VAL? EMEM,1", "8191"),
    ("DATA:DATA:VAL EMEM,7,16382;:DATA:VAL? EMEMory,7", "16382"),
    ("DATA:DATA:LINE EMEM,10,8000,12,8100;:DATA:VAL? EMEM,11", "8050"),
    ("DATA:CAT?", '"EMEM"'),
    ("DATA:COPY USER3,EMEM;:DATA:CAT?", '"USER3","EMEM"'),
    ("DATA:LOCK:STAT USER3,ON;:DATA:LOCK:STAT? USER3", "1"),
    ("DATA:LOCK USER3,0;LOCK? USER3", "0"),
    ("DATA:DEL:NAME USER3;:DATA:CAT?", '"EMEM"'),
    ("DATA:COPY USER;:SOUR1:FUNC USER;FUNC?", "USER1"),
    ("SOUR2:FUNC:SHAP USER1;SHAP?", "USER1"),
    ("FUNC SQU;FUNC?", "SQU"),
    ("SOUR1:FREQ 20;FREQ?", "2.00000000000E+01"),
    ("SOUR1:FUNC SIN;FREQ? MAX", "2.50000000000E+07"),
    ("SOUR1:FREQ:FIX 2kHz;FIX?", "2.00000000000E+03"),
    ("FREQ:CW? MIN", "1.00000000000E-03"),
    ("SOUR1:FREQ:CONC OFF;CONC?", "0"),
    ("OUTP1:IMP?", "5.0000E+01"),
    ("OUTP1:IMP INF;IMP?", "9.9000E+37"),
    ("OUTP2:IMP 1KOHM;IMP?", "1.0000E+03"),
    ("SOUR1:VOLT?", "2.0000E+00"),
    ("SOUR1:VOLT 1.5VPP;VOLT?", "1.5000E+00"),
    ("SOUR1:VOLT:LEV:IMM:AMPL 150MVPP;AMPL?", "1.5000E-01"),
    ("VOLT? MAX", "2.0000E+01"),
    ("VOLT? MIN", "2.0000E-02"),
    ("SOUR1:VOLT:OFFS -0.5V;OFFS?", "-5.0000E-01"),
    ("SOUR1:VOLT:OFFS 0;:SOUR1:VOLT:LIM:HIGH? MAX", "1.0000E+01"),
    ("SOUR1:VOLT:LIM:HIGH 4;HIGH?", "4.0000E+00"),
    ("SOUR1:VOLT:LIM:LOW -4;LOW?", "-4.0000E+00"),
    ("SOUR1:VOLT:UNIT?", "VPP"),
    ("SOUR1:VOLT:UNIT VRMS;UNIT?", "VRMS"),
    ("SOUR1:VOLT:UNIT VPP;UNIT?", "VPP"),
    ("SOUR1:VOLT:CONC:STAT 0;STAT?", "0"),
    ("SOUR1:PHAS 90DEG;PHAS?", "1.5708E+00"),
    ("SOUR1:PHAS:INIT;:SYST:ERR?", NO_ERROR),
    ("OUTP1:POL INV;POL?", "INV"),
    ("OUTP1:POL NORMAL;POL?", "NORM"),
    ("OUTP1 ON;:OUTP1?;:OUTP2:STAT?", "1;0"),
    ("OUTP:TRIG:MODE SYNC;MODE?", "SYNC"),
    ("SOUR1:FREQ 20;:SOUR1:BURS:STAT ON;STAT?", "1"),
    ("SOUR1:BURS:MODE GAT;MODE?", "GAT"),
    ("SOUR1:BURS:MODE TRIG;MODE?", "TRIG"),
    ("SOUR1:BURS:NCYC 1;NCYC?", "1.0000E+00"),
    ("SOUR1:BURS:NCYC INF;NCYC?", "9.9000E+37"),
    ("SOUR1:BURS:TDEL 5MS;TDEL?", "5.0000E-03"),
    ("SOUR:ROSC:SOUR EXT;SOUR?", "EXT"),
    ("TRIG:SOUR EXT;SOUR?", "EXT"),
    ("TRIG:SEQ:SOUR TIMER;SOUR?", "TIM"),
    ("TRIG:TIM 142.857143MS;TIM?", "1.42857143E-01"),
    ("TRIG:TIM? MAX", "5.00000000E+02"),
    ("*TRG;:TRIG:SEQ:IMM;:TRIG;:ABOR;:SYST:ERR?", NO_ERROR),
    ("*RST;:OUTP1:IMP?;:TRIG:SOUR?;:SOUR1:BURS:STAT?", "5.0000E+01;TIM;0"),
    ("DATA:CAT?", '"USER1","EMEM"'),
]


def test_transcript_of_the_command_list(bench: Bench) -> None:
    """A session with every command of the notes, in order, without an error."""
    for message, reply in TRANSCRIPT:
        assert (message, bench.ask(message)) == (message, reply)
        assert bench.ask("SYST:ERR?") == NO_ERROR


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("NONSENSE", -113),
        ("SOUR3:FREQ 1", -114),
        ("SOUR1:FREQ", -109),
        ("SOUR1:FREQ 1,2", -108),
        ("SOUR1:FREQ 30MHZ", -222),
        ("SOUR1:FREQ 1V", -131),
        ("SOUR1:FREQ fast", -104),
        ("SOUR1:VOLT 10.1VPP", -222),
        ("SOUR1:VOLT 9MVPP", -222),
        ("SOUR1:FUNC USER4", -224),
        ("SOUR1:FUNC USER5", -224),
        ("SOUR1:FUNC TRAPEZE", -224),
        ("TRIG:SOUR BUS", -224),
        ("TRIG:TIM 501", -222),
        ("*TRG", -211),
        ("DATA:COPY USER5,EMEM", -224),
        ("DATA:COPY EMEM,USER2", -224),
        ("DATA:POIN? USER1", -224),
        ("DATA EMEM,12", -104),
        (block([16383, 8191]), -222),
        (block([8191]), -161),
        (b"DATA EMEM,#13abc", -161),
        (b"DATA USER1,#14abcd", -224),
        ("*ESE 256", -222),
        ("OUTP1 MAYBE", -104),
        ("SOUR1:BURS:NCYC 2000000", -222),
    ],
)
def test_mistakes_cause_standard_errors(bench: Bench, message: str | bytes, code: int) -> None:
    """Numbers of SCPI-99, volume 2, 21.8; ranges of the notes (NI's tables for the AFG3022B)."""
    assert bench.error(message) == code


def test_the_longest_record_has_131072_points(bench: Bench) -> None:
    """NI: 131072 points on the AFG3022B."""
    assert bench.error(block([8191] * 131_072)) == 0
    assert bench.error(block([8191] * 131_073)) == -223


def test_the_event_status_register_has_a_bit_per_error_class(bench: Bench) -> None:
    """IEEE 488.2, 11.5.1: command error 32, execution error 16, power on 128; reading clears it."""
    assert bench.ask("*ESR?") == "128"
    bench.ask("NONSENSE")
    assert bench.ask("*ESR?") == "32"
    bench.ask("SOUR1:VOLT 99VPP")
    assert bench.ask("*ESR?") == "16"
    assert bench.ask("*ESR?") == "0"


def test_the_error_queue_is_first_in_first_out_and_overflows() -> None:
    """SCPI-99, 21.8.1: the last entry of a full queue is -350."""
    bench = Bench(Behaviour(queue_depth=3))
    for message in ("NONSENSE", "SOUR1:VOLT 99VPP", "NONSENSE", "NONSENSE"):
        bench.ask(message)
    replies = [bench.ask("SYST:ERR?")[:4] for _ in range(4)]
    assert replies == ["-113", "-222", "-350", '0,"N']


def test_memories_survive_reset_and_power_failure(bench: Bench) -> None:
    """USER memories are non-volatile; everything else is not (notes: power-cut question)."""
    bench.upload([8191, 9000, 8191, 8191], user=4)
    bench.ask("OUTP1 ON;:SOUR1:FREQ 20")
    bench.ask("*RST")
    bench.afg.power_on()
    assert bench.ask("DATA:CAT?;:OUTP1?") == '"USER4","EMEM";0'
    assert bench.ask("DATA:COPY EMEM,USER4;:DATA:POIN? EMEM;:DATA:VAL? EMEM,2") == "4;9000"


def test_the_load_setting_only_rescales_the_numbers(bench: Bench) -> None:
    """The output is always 50 ohm: 1 Vpp set for 50 ohm reads 2 Vpp once the load is set to open."""
    bench.ask("SOUR1:VOLT 1VPP")
    assert bench.ask("OUTP1:IMP INF;:SOUR1:VOLT?") == "2.0000E+00"
    assert bench.ask("OUTP1:IMP 50;:SOUR1:VOLT?") == "1.0000E+00"


@pytest.mark.parametrize(("violation", "code", "level"), [("error", -222, "2.0000E+00"), ("clip", 0, "4.0000E+00")])
def test_a_level_beyond_the_limit_is_refused_or_clipped(violation: str, code: int, level: str) -> None:
    """Both answers to an open question of the notes: amplitude / 2 + offset beyond VOLTage:LIMit."""
    bench = Bench(Behaviour(limit_violation=violation))  # type: ignore[arg-type]
    bench.ask("OUTP1:IMP INF;:SOUR1:VOLT 2VPP;:SOUR1:VOLT:LIM:HIGH 2;LOW -2")
    assert bench.error("SOUR1:VOLT 6VPP") == code
    assert bench.ask("SOUR1:VOLT?") == level


def test_amplitude_has_four_digits_or_steps_of_0_1_millivolt(bench: Bench) -> None:
    """Amplitude step 0.1 mVpp or 4 digits (notes)."""
    bench.ask("OUTP1:IMP INF")
    assert bench.ask("SOUR1:VOLT 1.23456VPP;VOLT?") == "1.2350E+00"
    assert bench.ask("SOUR1:VOLT 0.123456VPP;VOLT?") == "1.2350E-01"
    assert bench.ask("SOUR1:VOLT 0.0234567VPP;VOLT?") == "2.3500E-02"


def test_an_output_plays_only_when_everything_is_set(bench: Bench) -> None:
    """On, with a record and the timer: one burst per period; off or without a record nothing."""
    bench.upload([8191, 9000, 8000, 8191])
    bench.ask("SOUR1:FUNC USER1;FREQ 20;:SOUR1:BURS:STAT ON;NCYC 1;:TRIG:TIM 0.142857;:OUTP1:IMP INF;:SOUR1:VOLT 3VPP")
    assert bench.afg.playback(1) is None
    bench.ask("OUTP1 ON")
    playback = bench.afg.playback(1)
    assert playback is not None
    assert (playback.amplitude, playback.offset, playback.duration, playback.period) == (3, 0, 0.05, 0.142857)
    assert bench.afg.playback(2) is None
    bench.ask("SOUR1:BURS:STAT OFF")
    assert bench.afg.playback(1).period == 0.05  # type: ignore[union-attr]
    bench.ask("SOUR1:FUNC SIN")
    assert bench.afg.playback(1) is None


def test_forced_triggers_count_until_the_outputs_are_off(bench: Bench) -> None:
    """With EXT and no wire *TRG is the only trigger, for both channels; the period is the latest interval."""
    bench.upload([8191, 9000, 8000, 8191])
    for n in (1, 2):
        bench.ask(f"SOUR{n}:FUNC USER1;FREQ 20;:SOUR{n}:BURS:STAT ON;NCYC 1;:OUTP{n} ON")
    bench.ask("TRIG:SOUR EXT")
    assert bench.afg.playback(1) is None
    bench.ask("*TRG")
    for n in (1, 2):
        playback = bench.afg.playback(n)
        assert playback is not None
        assert math.isinf(playback.period)
    bench.clock.sleep(0.2002)
    bench.ask("TRIG:SEQ:IMM")
    bench.clock.sleep(0.15)
    bench.ask("TRIG")
    assert bench.afg.playback(2).period == 0.15  # type: ignore[union-attr]
    bench.ask("ABOR")
    assert bench.afg.playback(1) is None
    bench.ask("*TRG")
    assert bench.afg.playback(1) is not None
    bench.ask("OUTP1 OFF;:OUTP1 ON")
    assert bench.afg.playback(1) is None


def test_an_output_rests_at_the_first_point(bench: Bench) -> None:
    """The notes' first open question: as far as is known, not at the last point nor at the offset."""
    bench.upload([8000, 9000, 8500])
    bench.ask("SOUR1:FUNC USER1;:OUTP1 ON")
    assert bench.afg.playback(1).idle_code == 8000  # type: ignore[union-attr]


def test_a_timer_tick_during_a_burst_is_lost(bench: Bench) -> None:
    """A timer of 30 ms with bursts of 50 ms: every second tick counts, so that bursts are played every 60 ms."""
    bench.upload([8191, 9000, 8191])
    bench.ask("SOUR1:FUNC USER1;FREQ 20;:SOUR1:BURS:NCYC 1;STAT ON;:OUTP1 ON;:TRIG:TIM 30MS")
    assert bench.afg.playback(1).period == pytest.approx(0.06)  # type: ignore[union-attr]


def test_the_edit_memory_is_played(bench: Bench) -> None:
    """EMEM is a waveform like the USER memories."""
    bench.ask("DATA:DEF EMEM,1000;:DATA:DATA:LINE EMEM,1,0,1000,9990;:SOUR2:FUNC EMEM;:OUTP2 ON")
    sent = bench.afg.playback(2)
    assert sent is not None
    assert np.frombuffer(sent.record, ">u2").tolist() == list(range(0, 10_000, 10))


@pytest.mark.parametrize("setting", ["BURS:NCYC 3", "BURS:NCYC INF", "BURS:TDEL 5MS", "BURS:MODE GAT", "PHAS 90DEG"])
def test_a_burst_that_is_not_simulated_plays_nothing(
    bench: Bench, setting: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Only single cycles that follow their trigger at once; a warning says so, and its end restores them."""
    bench.upload([8191, 9000, 8191])
    bench.ask("SOUR1:FUNC USER1;:SOUR1:BURS:NCYC 1;:SOUR1:BURS:STAT ON;:OUTP1 ON;:TRIG:SOUR EXT;*TRG")
    assert bench.afg.playback(1) is not None
    assert bench.error(f"SOUR1:{setting}") == 0
    assert bench.afg.playback(1) is None
    assert bench.error("*TRG") == 0
    assert caplog.text.count("not simulated") == 1
    assert bench.afg.playback(1) is None
    bench.ask("SOUR1:BURS:NCYC 1;TDEL 0;MODE TRIG;:SOUR1:PHAS 0;*TRG")
    assert bench.afg.playback(1) is not None


def test_a_locked_memory_is_not_overwritten(bench: Bench) -> None:
    """DATA:LOCK protects a memory against copies and deletion."""
    bench.upload([8191, 9000])
    bench.ask("DATA:LOCK USER1,ON")
    assert bench.error("DATA:COPY USER1,EMEM") == -221
    assert bench.error("DATA:DEL USER1") == -221
