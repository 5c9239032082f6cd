"""Drivers that know nothing of this project, against the simulated generator: what works on the desk works here."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa
from pymeasure.adapters import VISAAdapter
from pymeasure.instruments.tektronix import AFG3152C

from modaltouch.rig.simulator import Simulator


@pytest.fixture
def visa(simulator: Simulator) -> Iterator[Any]:
    """Return PyVISA's own client at the simulator."""
    resource = pyvisa.ResourceManager("@py").open_resource(simulator.address, timeout=1000)
    yield resource
    resource.close()


@pytest.fixture
def stranger(simulator: Simulator) -> Iterator[AFG3152C]:
    """Return PyMeasure's driver of the AFG3000 series at the simulator."""
    adapter = VISAAdapter(simulator.address, visa_library="@py", timeout=1000)
    # PyMeasure warns of every driver whose authors do not know whether it speaks SCPI.
    with pytest.warns(FutureWarning, match="not known whether this device support SCPI"):
        instrument = AFG3152C(adapter)
    yield instrument
    adapter.close()


def test_pymeasure_identifies_and_resets(stranger: AFG3152C, simulator: Simulator) -> None:
    """Its common commands of IEEE 488.2; ``*RST`` brings back 1 MHz, the default in the maker's manuals."""
    simulator.front_panel("SOUR1:FREQ 20;:OUTP1 ON")
    assert stranger.id.startswith("TEKTRONIX,AFG3022B")
    stranger.reset()
    assert stranger.ch1.frequency == pytest.approx(1e6)
    assert simulator.outputs == (False, False)
    assert int(stranger.complete) == 1


def test_pymeasure_sets_and_reads_a_channel(stranger: AFG3152C, simulator: Simulator) -> None:
    """Shape, unit, amplitude, offset and frequency of either channel read back as they were set, without an error."""
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
    """By the command that its `enable` means to send, which fails before it is sent in PyMeasure 0.16."""
    stranger.write("output1:state on")
    stranger.write("output2:state on")
    assert simulator.outputs == (True, True)
    stranger.write("output2:state off")
    assert simulator.outputs == (True, False)


def test_pymeasure_sets_a_whole_waveform(stranger: AFG3152C, simulator: Simulator) -> None:
    """Its `waveform` sends five commands with units of their own; a ramp of 0.5 V rms is sqrt(3) V peak to peak."""
    stranger.ch1.waveform(shape="RAMP", frequency=500.0, units="VRMS", amplitude=0.5, offset=0.1)
    assert simulator.front_panel("SYST:ERR?") == '0,"No error"'
    assert stranger.ch1.frequency == pytest.approx(500.0)
    assert stranger.ch1.amp_vrms == pytest.approx(0.5, rel=1e-3)
    stranger.ch1.unit = "VPP"
    assert stranger.ch1.amp_vpp == pytest.approx(3**0.5, rel=1e-3)


def test_pymeasure_finds_its_own_error_in_the_queue(stranger: AFG3152C) -> None:
    """Its channel asks SOURce1:OUTPut:IMPedance, which no AFG3000 knows: -113, undefined header."""
    stranger.write("source1:output:impedance 50")
    errors = stranger.check_errors()
    assert [int(error[0]) for error in errors] == [-113]
    assert stranger.check_errors() == []


def test_pyvisa_transfers_a_block_both_ways(visa: Any) -> None:
    """Its own binary helpers: 5000 codes go and come back, big-endian."""
    codes = [(37 * index) % 16383 for index in range(5000)]
    visa.write_binary_values("DATA:DATA EMEM,", codes, datatype="H", is_big_endian=True)
    assert visa.query("DATA:POIN? EMEM").strip() == "5000"
    assert visa.query_binary_values("DATA:DATA? EMEM", datatype="H", is_big_endian=True) == codes
    assert visa.query("SYST:ERR?").startswith("0,")


def test_pyvisa_reads_the_status_byte_and_clears(visa: Any) -> None:
    """Serial poll over VXI-11: bit 2 says that the error queue holds something; device clear drops a pending reply."""
    visa.write("NO:SUCH:HEADER")
    assert visa.read_stb() & 4
    visa.write("*IDN?")
    visa.clear()
    assert visa.query("SYST:ERR?").startswith("-113")


def test_pyvisa_shell_finds_the_simulator(simulator: Simulator) -> None:
    """A program of a few lines in a process of its own, as anybody's script would be."""
    script = (
        "import pyvisa\n"
        f"with pyvisa.ResourceManager('@py').open_resource('{simulator.address}') as afg:\n"
        "    afg.write('source2:voltage:level:immediate:amplitude 0.5vpp')\n"
        "    print(afg.query_ascii_values('SOUR2:VOLT?')[0], afg.query('*IDN?').split(',')[1])\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=True)
    assert ran.stdout.split() == ["0.5", "AFG3022B"]
