"""Two programs with one generator: the second is refused with a message, and the first is not affected."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError, StimulusLost
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.common import Behaviour
from modaltouch.rig.visa import VisaSession
from modaltouch.stimulus.burst import Burst

REFUSED = 3
"""Exit status of a command after a rig error."""


@pytest.fixture(params=["admits many sessions", "admits one session"])
def instrument(request: Any, apparatus: Apparatus) -> Iterator[Simulator]:
    """Return an instrument on the network, or one with a single session as over USB."""
    many = request.param == "admits many sessions"
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=16 if many else 1)) as simulator:
        yield simulator


def test_a_second_run_is_refused_without_affecting_the_first(
    instrument: Simulator, apparatus: Apparatus, burst: Burst
) -> None:
    """In separate processes: exit status 3 and a message with the remedy; the stimulus stays confirmed."""
    with Generator(instrument.address, apparatus) as first:
        first.load(burst)
        first.fire(0.1)
        command = [sys.executable, "-m", "modaltouch", "rig", "check", instrument.address, "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as second:
            while second.poll() is None:
                try:
                    first.heartbeat()
                except StimulusLost:  # a machine that was too busy for a trigger, not the second program
                    first.stop()
                    first.fire(0.1)
                time.sleep(5e-3)
            out, err = second.communicate()
        assert second.returncode == REFUSED
        assert "is in use" in json.dumps(json.loads(out))
        assert "Traceback" not in err
        assert instrument.outputs == (True, True)
        first.stop()
        assert first.firing is not None
        # The number played is unknown if the machine was too busy for a trigger.
        assert first.firing.bursts.played or first.firing.bursts.dropped


def test_two_drivers_never_share_an_instrument(instrument: Simulator, apparatus: Apparatus, burst: Burst) -> None:
    """Each with its own watchdog: refused while the first is open, accepted as soon as it has closed."""
    with Generator(instrument.address, apparatus) as first:
        first.load(burst)
        with pytest.raises(RigError, match="is in use: .*it was left as it is; close the other program"):
            Generator(instrument.address, apparatus)
        assert first.fire(0.1).started
    with Generator(instrument.address, apparatus) as second:
        second.load(burst)
        assert second.fire(0.1).started


@pytest.mark.parametrize("serial", ["C012345", "SIMULATED", "0"])
def test_an_instrument_in_use_is_recognised_by_its_serial_number(
    simulator: Simulator, apparatus: Apparatus, burst: Burst, serial: str
) -> None:
    """A VXI-11 generator may also be reached by a raw socket; without a serial number it cannot be recognised."""
    simulator.afg.identity = f"TEKTRONIX,AFG3022B,{serial},SCPI:99.0 FV:3.2.2"
    other = f"TCPIP::127.0.0.1::{simulator.server.port}::SOCKET"
    with Generator(simulator.address, apparatus) as first:
        first.load(burst)
        if serial == "C012345":
            with pytest.raises(RigError, match="is in use: another program on this machine .*it was left as it is"):
                Generator(other, apparatus)
            assert first.fire(0.1).started
        else:
            Generator(other, apparatus).close()
    with Generator(other, apparatus) as second:
        assert second.identity == simulator.afg.identity


def test_opening_waits_for_a_session_that_is_about_to_end(
    simulator: Simulator, apparatus: Apparatus, burst: Burst
) -> None:
    """`modaltouch resume` right after a kill: the old watchdog is switching off, for less than a second."""
    dying = VisaSession(simulator.address)
    dying.open()
    threading.Timer(0.4, dying.release).start()
    with Generator(simulator.address, apparatus) as rig:
        rig.load(burst)
        assert rig.fire(0.1).started


def test_the_driver_takes_no_lock_of_the_instrument(simulator: Simulator, apparatus: Apparatus, burst: Burst) -> None:
    """A VXI-11 lock of its own dead link could not be released."""
    with Generator(simulator.address, apparatus) as rig:
        rig.load(burst)
        rig.fire(0.1)
        stranger: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address)
        stranger.write("OUTP1 OFF;:OUTP2 OFF")
        stranger.close()
        assert simulator.outputs == (False, False)


def test_a_change_by_another_computer_is_detected(simulator: Simulator, apparatus: Apparatus, burst: Burst) -> None:
    """A setting changed by a script elsewhere is read back at the end: the trial is not confirmed."""
    with Generator(simulator.address, apparatus) as rig:
        rig.load(burst)
        assert rig.fire(0.1).started
        stranger: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address)
        stranger.write("SOUR1:VOLT 1VPP")
        stranger.close()
        rig.stop()
        assert rig.firing is not None
        assert not rig.firing.confirmed
        assert "SOUR1:VOLT reads" in rig.firing.reason
