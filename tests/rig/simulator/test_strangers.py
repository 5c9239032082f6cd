"""Drivers that are independent of this project work with the simulated generator as with a real one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import pyvisa
from pymeasure.adapters import VISAAdapter
from pymeasure.instruments.tektronix import AFG3152C

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator

KEYSIGHT = Apparatus.read(Path(__file__).parents[3] / "protocols" / "apparatus" / "keysight_33522b.yaml")

MODULATIONS = tuple(
    f"SOURce2:{way}:{header}"
    for way in ("AM", "FM", "PM", "PWM")
    for header in ("INTernal:FREQuency", "INTernal:FUNCtion", "INTernal:FUNCtion:EFILe", "SOURce", "STATe")
)
READ_BY_QCODES = [
    "OUTPut:TRIGger:MODE",
    "OUTPut2:IMPedance",
    "OUTPut2:POLarity",
    "OUTPut2:STATe",
    "SOURce2:AM:DEPTh",
    "SOURce2:FM:DEViation",
    "SOURce2:PM:DEViation",
    "SOURce2:PWM:DEViation:DCYCle",
    "SOURce2:BURSt:MODE",
    "SOURce2:BURSt:NCYCles",
    "SOURce2:BURSt:STATe",
    "SOURce2:BURSt:TDELay",
    "SOURce2:COMBine:FEED",
    "SOURce2:FREQuency:CENTer",
    "SOURce2:FREQuency:CONCurrent",
    "SOURce2:FREQuency:CW",
    "SOURce2:FREQuency:MODE",
    "SOURce2:FREQuency:SPAN",
    "SOURce2:FREQuency:STARt",
    "SOURce2:FREQuency:STOP",
    "SOURce2:FSKey:FREQuency",
    "SOURce2:FSKey:INTernal:RATE",
    "SOURce2:FSKey:SOURce",
    "SOURce2:FSKey:STATe",
    "SOURce2:FUNCtion:EFILe",
    "SOURce2:FUNCtion:RAMP:SYMMetry",
    "SOURce2:FUNCtion:SHAPe",
    "SOURce2:PHASe:ADJust",
    "SOURce2:PULSe:DCYCle",
    "SOURce2:PULSe:DELay",
    "SOURce2:PULSe:HOLD",
    "SOURce2:PULSe:PERiod",
    "SOURce2:PULSe:TRANsition:LEADing",
    "SOURce2:PULSe:TRANsition:TRAiling",
    "SOURce2:PULSe:WIDTh",
    "SOURce2:SWEep:HTIMe",
    "SOURce2:SWEep:MODE",
    "SOURce2:SWEep:RTIMe",
    "SOURce2:SWEep:SPACing",
    "SOURce2:SWEep:TIME",
    "SOURce2:VOLTage:CONCurrent:STATe",
    "SOURce2:VOLTage:LEVel:IMMediate:HIGH",
    "SOURce2:VOLTage:LEVel:IMMediate:LOW",
    "SOURce2:VOLTage:LEVel:IMMediate:OFFSet",
    "SOURce2:VOLTage:UNIT",
    "SOURce2:VOLTage:LEVel:IMMediate:AMPLitude",
    "SOURce2:VOLTage:LIMit:HIGH",
    "SOURce2:VOLTage:LIMit:LOW",
    "SOURce3:POWer:LEVel:IMMediate:AMPLitude",
    "SOURce4:POWer:LEVel:IMMediate:AMPLitude",
    "SOURce:ROSCillator:SOURce",
    "TRIGger:SEQuence:SLOPe",
    "TRIGger:SEQuence:SOURce",
    "TRIGger:SEQuence:TIMer",
]
"""What Tektronix/AFG3000.py of qcodes_contrib_drivers 0.24.1 reads on connecting, each with a timeout of 20 s."""

READ_FROM_KEYSIGHT = [
    "SOURce2:FUNCtion",
    "SOURce2:FREQuency:MODE",
    "SOURce2:FREQuency",
    "SOURce2:PHASe",
    "SOURce2:VOLTage:UNIT",
    "SOURce2:VOLTage",
    "SOURce2:VOLTage:OFFSet",
    "OUTPut2",
    "SOURce2:FUNCtion:RAMP:SYMMetry",
    "SOURce2:FUNCtion:PULSE:WIDTh",
    "TRIGger2:SOURce",
    "TRIGger2:SLOPe",
    "TRIGger2:COUNt",
    "TRIGger2:DELay",
    "TRIGger2:TIMer",
    "OUTPut2:POLarity",
    "SOURce2:BURSt:STATe",
    "SOURce2:BURSt:MODE",
    "SOURce2:BURSt:NCYCLes",
    "SOURce2:BURSt:PHASe",
    "SOURce2:BURSt:GATE:POLarity",
    "SOURce2:BURSt:INTernal:PERiod",
    "OUTPut:SYNC",
    "OUTPut:SYNC:SOURce",
    "SOUR2:FUNC:SQU:DCYC",
    "SOUR2:FUNC:PULS:HOLD",
    "SOUR2:FUNC:PULS:PER",
    "SOUR2:FUNC:PULS:DCYC",
    "SOUR2:FUNC:PULS:TRAN",
]
"""Keysight/KeysightAgilent_33XXX.py of QCoDeS 0.58.0, and what PyMeasure's agilent33500.py reads in addition."""

SENT_BY_TM_DEVICES = (
    "*CLS", "*RST", "*OPC?", "*ESR?", "OUTPUT1:STATE?", "OUTPUT1:STATE 0", "OUTPUT1:IMPEDANCE?",
    "SOURCE1:FREQUENCY:FIXED 1000.0", "SOURCE1:FREQUENCY:FIXED?", "SOURCE1:VOLTAGE:OFFSET 0.1",
    "SOURCE1:VOLTAGE:OFFSET?", "OUTPUT1:POLARITY?", "SOURCE1:FUNCTION:RAMP:SYMMETRY?",
    "SOURCE1:FUNCTION:RAMP:SYMMETRY 100.0", "SOURCE1:FUNCTION RAMP", "SOURCE1:FUNCTION?", "SOURCE1:PULSE:DCYCLE 30.0",
    "SOURCE1:PULSE:DCYCLE?", "SOURCE1:VOLTAGE:AMPLITUDE 0.5", "SOURCE1:VOLTAGE:AMPLITUDE?", "OUTPUT1:STATE 1",
    "SOURCE1:BURST:STATE?", "SOURCE2:BURST:STATE?", "SOURCE1:PHASE:INITIATE", ":OUTPut1:STATE 1", "*ESR?",
    "SYSTEM:ERROR?",
)  # fmt: skip
"""Messages of drivers/afgs/afg3kb.py of tm_devices 3.7.0 over a socket to generate functions, clean up and reset."""


@pytest.fixture
def visa(simulator: Simulator) -> Iterator[Any]:
    """Return a PyVISA client of the simulator."""
    resource = pyvisa.ResourceManager("@py").open_resource(simulator.address, timeout=1000)
    yield resource
    resource.close()


@pytest.fixture(params=["VXI-11", "raw socket"])
def stranger(simulator: Simulator, request: pytest.FixtureRequest) -> Iterator[AFG3152C]:
    """Return PyMeasure's driver of the AFG3000 series, connected to the simulator over each of its transports."""
    raw = request.param == "raw socket"
    address = simulator.socket_address if raw else simulator.address
    lines = {"read_termination": "\n", "write_termination": "\n"} if raw else {}
    adapter = VISAAdapter(address, visa_library="@py", timeout=1000, **lines)
    # PyMeasure warns about drivers whose support of SCPI is not known.
    with pytest.warns(FutureWarning, match="not known whether this device support SCPI"):
        instrument = AFG3152C(adapter)
    yield instrument
    adapter.close()


def test_pymeasure_identifies_and_resets(stranger: AFG3152C, simulator: Simulator) -> None:
    """Its common commands of IEEE 488.2; ``*RST`` sets 1 MHz, the default in the maker's manuals."""
    simulator.front_panel("SOUR1:FREQ 20;:OUTP1 ON")
    assert stranger.id.startswith("TEKTRONIX,AFG3022B")
    stranger.reset()
    assert stranger.ch1.frequency == pytest.approx(1e6)
    assert simulator.outputs == (False, False)
    assert int(stranger.complete) == 1


def test_pymeasure_sets_and_reads_a_channel(stranger: AFG3152C, simulator: Simulator) -> None:
    """Shape, unit, amplitude, offset and frequency of either channel read back as set, without an error."""
    for channel, amplitude in ((stranger.ch1, 1.5), (stranger.ch2, 2.5)):
        channel.shape = "sinusoidal"
        channel.unit = "VPP"
        channel.amp_vpp = amplitude
        channel.offset = 0.25
        channel.frequency = 1234.5
        assert channel.shape == "sinusoidal"
        assert channel.unit == "VPP"
        assert channel.amp_vpp == pytest.approx(amplitude)
        assert channel.offset == pytest.approx(0.25)
        assert channel.frequency == pytest.approx(1234.5)
    assert simulator.front_panel("SYST:ERR?") == '0,"No error"'
    assert simulator.afg.channels[2].frequency == 1234.5


def test_pymeasure_switches_outputs(stranger: AFG3152C, simulator: Simulator) -> None:
    """By the command that its `enable` is meant to send, which fails before sending in PyMeasure 0.16."""
    stranger.write("output1:state on")
    stranger.write("output2:state on")
    assert int(stranger.complete) == 1  # over a raw socket a command may be in transit until a query is answered
    assert simulator.outputs == (True, True)
    stranger.write("output2:state off")
    assert int(stranger.complete) == 1
    assert simulator.outputs == (True, False)


def test_pymeasure_sets_a_whole_waveform(stranger: AFG3152C, simulator: Simulator) -> None:
    """Its `waveform` sends five commands with their own units; a ramp of 0.5 V rms is sqrt(3) V peak to peak."""
    stranger.ch1.waveform(shape="RAMP", frequency=500.0, units="VRMS", amplitude=0.5, offset=0.1)
    assert simulator.front_panel("SYST:ERR?") == '0,"No error"'
    assert stranger.ch1.frequency == pytest.approx(500.0)
    assert stranger.ch1.amp_vrms == pytest.approx(0.5, rel=1e-3)
    stranger.ch1.unit = "VPP"
    assert stranger.ch1.amp_vpp == pytest.approx(3**0.5, rel=1e-3)


def test_pymeasure_finds_its_own_error_in_the_queue(stranger: AFG3152C) -> None:
    """Its channel sends SOURce1:OUTPut:IMPedance, which does not exist on an AFG3000: -113, undefined header."""
    stranger.write("source1:output:impedance 50")
    errors = stranger.check_errors()
    assert [int(error[0]) for error in errors] == [-113]
    assert stranger.check_errors() == []


def test_pyvisa_transfers_a_block_in_both_directions(visa: Any) -> None:
    """Its own binary functions: 5000 codes are sent and read back, big-endian."""
    codes = [(37 * index) % 16383 for index in range(5000)]
    visa.write_binary_values("DATA:DATA EMEM,", codes, datatype="H", is_big_endian=True)
    assert visa.query("DATA:POIN? EMEM").strip() == "5000"
    assert visa.query_binary_values("DATA:DATA? EMEM", datatype="H", is_big_endian=True) == codes
    assert visa.query("SYST:ERR?").startswith("0,")


def test_pyvisa_reads_the_status_byte_and_clears(visa: Any) -> None:
    """Serial poll over VXI-11: bit 2 means that the error queue is not empty; device clear discards a pending reply."""
    visa.write("NO:SUCH:HEADER")
    assert visa.read_stb() & 4
    visa.write("*IDN?")
    visa.clear()
    assert visa.query("SYST:ERR?").startswith("-113")


def test_a_short_pyvisa_script_uses_the_simulator(simulator: Simulator) -> None:
    """A script of a few lines in a separate process."""
    script = (
        "import pyvisa\n"
        f"with pyvisa.ResourceManager('@py').open_resource('{simulator.address}') as afg:\n"
        "    afg.write('source2:voltage:level:immediate:amplitude 0.5vpp')\n"
        "    print(afg.query_ascii_values('SOUR2:VOLT?')[0], afg.query('*IDN?').split(',')[1])\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert ran.stdout.split() == ["0.5", "AFG3022B"]


@pytest.mark.parametrize("apparatus_of", ["AFG3022B", "33522B"])
def test_everything_that_qcodes_reads_has_a_reply_and_can_be_set(apparatus_of: str, apparatus: Apparatus) -> None:
    """A driver that reads all settings when it connects gets every reply, and can restore what it has read."""
    headers = READ_FROM_KEYSIGHT if apparatus_of == "33522B" else (*READ_BY_QCODES, *MODULATIONS)
    simulator = Simulator(KEYSIGHT if apparatus_of == "33522B" else apparatus)
    simulator.front_panel("OUTP2 OFF")
    for header in headers:
        reply = simulator.front_panel(f"{header}?")
        assert reply, header
        simulator.front_panel(f"{header} {reply}")
        assert (header, simulator.front_panel("SYST:ERR?").lstrip("+")) == (header, '0,"No error"')


@pytest.mark.parametrize(
    "command",
    [
        "SOUR1:AM:STAT ON",
        "SOUR1:VOLT:CONC ON",
        "SOUR1:FREQ:MODE SWE",
        "SOUR1:PULS:WIDT 1ms",
        "TRIG:SLOP NEG",
        "SOUR1:AM:INT:FUNC:EFIL 'a'",
    ],
)
def test_settings_that_are_not_simulated_are_an_error(simulator: Simulator, command: str) -> None:
    """No modulation, sweep or pulse is simulated: -241, hardware missing, and the default stays."""
    before = simulator.front_panel(f"{command.split()[0]}?")
    simulator.front_panel(command)
    assert simulator.front_panel("SYST:ERR?").startswith('-241,"Hardware missing; not simulated: ')
    assert simulator.front_panel(f"{command.split()[0]}?") == before


def test_high_and_low_level_set_amplitude_and_offset(simulator: Simulator) -> None:
    """Into 50 ohm, 0.2 V and -0.1 V are 0.3 V peak to peak about 0.05 V; high below low is refused."""
    simulator.front_panel("*RST;:SOUR1:VOLT:HIGH 0.2V;LOW -0.1V")
    told = [float(simulator.front_panel(f"SOUR1:VOLT:{name}?")) for name in ("HIGH", "LOW", "AMPL", "OFFS")]
    assert told == pytest.approx([0.2, -0.1, 0.3, 0.05])
    simulator.front_panel("SOUR1:VOLT:HIGH -0.2V")
    assert simulator.front_panel("SYST:ERR?").startswith("-222")


def test_the_maximum_number_of_cycles_is_finite(simulator: Simulator) -> None:
    """`MAX` is a million, both as a setting and as a limit; a fraction is rounded."""
    told = simulator.front_panel("*RST;:SOUR1:BURS:NCYC MAX;NCYC?;NCYC? MIN;NCYC 2.6;NCYC?;NCYC INF;NCYC?")
    assert told == "1.0000E+06;1.0000E+00;3.0000E+00;9.9000E+37"


def test_every_message_of_tm_devices_is_accepted(simulator: Simulator) -> None:
    """Line by line as over a raw socket: each query has one reply, and the error queue is empty."""
    replies = {sent: simulator.front_panel(sent) for sent in SENT_BY_TM_DEVICES}
    assert [sent for sent, reply in replies.items() if bool(reply) != sent.endswith("?")] == []
    assert replies["SOURCE1:FUNCTION:RAMP:SYMMETRY?"] == "5.0000E+01"
    assert replies["SYSTEM:ERROR?"] == '0,"No error"'


def replies(simulator: Simulator, *messages: str) -> list[str]:
    """Return the reply to each message, or the error that it leaves."""
    return [simulator.front_panel(each) or simulator.front_panel("SYST:ERR?").split(",")[0] for each in messages]


def test_the_edit_memory_has_limits_and_a_default(simulator: Simulator) -> None:
    """2 to 131,072 points; `DATA:DEF EMEM` restores 1,000 of them at mid-scale."""
    assert replies(simulator, "DATA:POIN? EMEM,MIN", "DATA:POIN? EMEM,MAX") == ["2", "131072"]
    assert replies(simulator, "DATA:POIN EMEM,64", "DATA:POIN?") == ["0", "64"]
    assert replies(simulator, "DATA:DEF EMEM1", "DATA:POIN?", "DATA:VAL? EMEM,1000") == ["0", "1000", "8191"]
    assert replies(simulator, "FUNC EMEM1", "FUNC?") == ["0", "EMEM"]


@pytest.fixture
def raw(simulator: Simulator) -> Iterator[Any]:
    """Return a PyVISA client of the simulator's raw socket."""
    how = {"read_termination": "\n", "write_termination": "\n", "timeout": 1000}
    resource = pyvisa.ResourceManager("@py").open_resource(simulator.socket_address, **how)
    yield resource
    resource.close()


def test_a_block_over_a_raw_socket_may_contain_line_feeds(raw: Any, simulator: Simulator) -> None:
    """Codes of 2570 are two line feeds, one of 3338 is CR LF: the length delimits the data (IEEE 488.2, 7.7.6)."""
    codes = b"\n\n" * 999 + b"\r\n"
    raw.write_raw(b"DATA:DEF EMEM,1000;:DATA EMEM,#42000" + codes + b"\r\n*IDN?;:DATA:POIN? EMEM\r\n")
    assert raw.read().endswith(";1000")
    assert raw.query("SYST:ERR?") == '0,"No error"'
    raw.write("DATA EMEM,#4x")
    assert raw.query("SYST:ERR?").startswith("-1")
    raw.write_raw(b"DATA? EMEM\n")
    assert raw.read_bytes(6 + len(codes) + 1) == b"#42000" + codes + b"\n"


def test_raw_sockets_and_links_reach_the_same_instrument(raw: Any, visa: Any, simulator: Simulator) -> None:
    """Several messages sent together are answered in order; each connection counts as a link."""
    raw.write_raw(b"SOUR1:FREQ 1234\nSOUR1:FREQ?\nOUTP1?\n")
    assert (float(raw.read()), raw.read()) == (1234.0, "0")
    assert float(visa.query("SOUR1:FREQ?")) == 1234.0
    assert simulator.server.n_links == 2
    simulator.faults.inject("dropped_connection", when="FREQ")
    raw.write("SOUR1:FREQ?")
    with pytest.raises((pyvisa.VisaIOError, ConnectionError)):
        raw.read()
    assert float(visa.query("SOUR1:FREQ?")) == 1234.0
