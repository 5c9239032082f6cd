"""Two programs at one generator: the second is refused and told so, the first goes on as if nothing were."""

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

from modaltouch.apparatus import Apparatus
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.behaviour import Behaviour
from modaltouch.stimulus.burst import Burst

REFUSED = 3
"""Exit status of a command whose rig failed."""


@pytest.fixture(params=["admits many sessions", "admits one session"])
def instrument(request: Any, apparatus: Apparatus) -> Iterator[Simulator]:
    """Return an instrument on the network, or one as on USB."""
    many = request.param == "admits many sessions"
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=16 if many else 1)) as simulator:
        yield simulator


def test_second_run_is_refused_and_leaves_the_first_alone(
    instrument: Simulator, apparatus: Apparatus, burst: Burst
) -> None:
    """Processes of their own: exit status 3 and a message that says what to do; the stimulus stays confirmed."""
    with Generator(instrument.address, apparatus) as first:
        first.load(burst)
        firing = first.fire(0.1)
        command = [sys.executable, "-m", "modaltouch", "rig", "check", instrument.address, "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as second:
            while second.poll() is None:
                first.heartbeat()
                time.sleep(5e-3)
            out, err = second.communicate()
        assert second.returncode == REFUSED
        assert "is in use" in json.dumps(json.loads(out))
        assert "Traceback" not in err
        assert instrument.outputs == (True, True)
        first.stop()
        assert first.firing == firing
        assert firing.confirmed


def test_two_drivers_in_two_processes_never_share(instrument: Simulator, apparatus: Apparatus, burst: Burst) -> None:
    """Each behind a watchdog of its own: refused while the first has it, taken as soon as that has let go."""
    with Generator(instrument.address, apparatus) as first:
        first.load(burst)
        with pytest.raises(RigError, match="is in use: .*it was left as it is; end the other program"):
            Generator(instrument.address, apparatus)
        assert first.fire(0.1).confirmed
    with Generator(instrument.address, apparatus) as second:
        second.load(burst)
        assert second.fire(0.1).confirmed


def test_lock_that_a_dying_session_leaves_is_waited_for(
    simulator: Simulator, apparatus: Apparatus, burst: Burst, patience: Patience
) -> None:
    """`modaltouch resume` right after a kill: the old watchdog is switching off, for less than a second."""
    other = pyvisa.ResourceManager("@py").open_resource(simulator.address)
    other.lock_excl()
    threading.Timer(0.4, other.close).start()
    with Generator(simulator.address, apparatus, patience=patience) as rig:
        rig.load(burst)
        assert rig.fire(0.1).confirmed


def test_no_word_of_another_gets_in(simulator: Simulator, apparatus: Apparatus) -> None:
    """A script that somebody left running: its settings are refused with VXI-11 error 11, the panel is not."""
    stranger: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address)
    panel: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address.replace("inst0", "panel0"))
    with Generator(simulator.address, apparatus):
        with pytest.raises(pyvisa.VisaIOError):
            stranger.write("OUTP1 ON")
        assert simulator.outputs == (False, False)
        panel.write("OUTP1 ON")
        assert panel.query("OUTP1?").strip() == "1"
        assert simulator.outputs == (True, False)
    assert stranger.query("OUTP1?").strip() == "0"
    stranger.close()
    panel.close()


def test_interface_without_locks_is_used_all_the_same(
    simulator: Simulator, apparatus: Apparatus, burst: Burst, heard: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GPIB, or an instrument that refuses locks (VXI-11 error 8): the log says so, and read-back keeps watch."""
    monkeypatch.setattr("modaltouch.rig.simulator.links.Links._take_lock", lambda links, parameters, own: b"\0\0\0\x08")
    with Generator(simulator.address, apparatus, log=heard) as rig:
        assert heard.of("link")[0]["others"] == "not locked: VI_ERROR_NSUP_OPER"
        rig.load(burst)
        assert rig.fire(0.1).confirmed
        stranger: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address)
        stranger.write("SOUR1:VOLT 1VPP")
        stranger.close()
        rig.stop()
        assert rig.firing is not None
        assert not rig.firing.confirmed
