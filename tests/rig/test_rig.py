"""The public interface of the package."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import Generator, Simulator
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.simulator import LocalClient
from modaltouch.rig.simulator.faults import Kind
from modaltouch.stimulus.burst import Burst
from modaltouch.system import VirtualClock

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"


def test_the_package_connects_driver_and_simulator_by_address(
    apparatus: Apparatus, burst: Burst, heard: Any, guard: Any
) -> None:
    """A session needs only the simulator's address."""
    with (
        Simulator(apparatus) as simulator,
        Generator(simulator.address, apparatus, log=heard, start_guard=guard) as rig,
    ):
        rig.load(burst)
        assert rig.fire(0.1).started
        assert rig.address == simulator.address
        assert rig.identity.startswith("TEKTRONIX,AFG3022B,")
        assert simulator.felt_velocity(["C"]) > 0


def loaded_modules(code: str) -> set[str]:
    """Return the top-level modules that are loaded in a new interpreter after running code."""
    code += "; import sys; print(*{name.partition('.')[0] for name in sys.modules})"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(result.stdout.split())


def test_importing_the_package_loads_no_heavy_library() -> None:
    """`modaltouch --help` loads neither PyVISA nor NumPy, and neither does the watchdog."""
    heavy = {"pyvisa", "pyvisa_py", "pandas", "scipy", "numpy", "pydantic"}
    assert not loaded_modules("import modaltouch.rig, modaltouch.rig.watchdog_process") & heavy


def test_the_interface_does_not_load_pyvisa() -> None:
    """The session imports the interface; PyVISA is loaded with the instrument."""
    assert "pyvisa" not in loaded_modules("import modaltouch.rig.interface")


def test_the_simulator_runs_in_a_separate_process(burst: Burst, apparatus: Apparatus, heard: Any, guard: Any) -> None:
    """Its first line is its address; SIGTERM ends it with status 0."""
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--port", "0", "--apparatus", str(APPARATUS)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        with Generator(address, apparatus, log=heard, start_guard=guard) as rig:
            rig.load(burst)
            assert rig.fire(0.1).started
        process.terminate()
        assert process.wait(10) == 0


def test_the_simulator_reports_an_invalid_apparatus_file(tmp_path: Path) -> None:
    """Exit status 2 and the key at fault, no traceback."""
    faulty = tmp_path / "faulty.yaml"
    faulty.write_text("apparatus: x\nbeem: 1\n")
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--apparatus", str(faulty)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert "beem" in result.stderr
    assert "Traceback" not in result.stderr


def test_only_a_twin_in_virtual_time_replaces_the_watchdog_process() -> None:
    """The twin provides the replacement; in real time the watchdog process is always used."""
    apparatus = Apparatus.read(APPARATUS)
    with Simulator(apparatus) as simulator:
        assert "start_guard" not in simulator.driver_options
    with Simulator(apparatus, clock=VirtualClock(0.0)) as simulator:
        guard = simulator.driver_options["start_guard"]("simulated", AFG3022B.off)
        assert isinstance(guard, LocalClient)


@pytest.mark.parametrize(
    ("kind", "reason"),
    [("dropped_connection", "the instrument closed the connection"), ("lost_reply", "no reply within 1 s")],
)
def test_driver_in_the_process_of_the_twin_meets_its_faults(
    apparatus: Apparatus, burst: Burst, heard: Any, kind: Kind, reason: str
) -> None:
    """Without a network, too, a fault closes the session; the outputs are read back off over a new one."""
    with Simulator(apparatus, clock=VirtualClock(0.0)) as simulator:
        with Generator(apparatus=apparatus, log=heard, **simulator.driver_options) as rig:
            rig.load(burst)
            assert rig.fire(0.1).started
            assert simulator.felt_velocity(["C"]) > 0
            simulator.faults.inject(kind, when="OUTP1")
            rig.stop()
            assert not any(simulator.outputs)
        (lost,) = heard.of("connection_lost")
        assert reason in lost["reason"]
        assert len(heard.of("reconnected")) == 1
        assert "server" not in vars(simulator)


def test_a_power_cycle_ends_the_connection_within_a_process(apparatus: Apparatus, burst: Burst, heard: Any) -> None:
    """As over a network: no burst is triggered on the reset generator, and the stimulus is not confirmed."""
    clock = VirtualClock(0.0)
    with (
        Simulator(apparatus, clock=clock) as simulator,
        Generator(apparatus=apparatus, log=heard, **simulator.driver_options) as rig,
    ):
        rig.load(burst)
        assert rig.fire(0.1).started
        clock.sleep(0.5)
        simulator.power_cycle()
        clock.sleep(0.5)
        rig.stop()
        assert rig.firing is not None
        assert not rig.firing.confirmed
        assert "the instrument closed the connection" in rig.firing.reason
