"""Times of the rig: queries, uploads, a change of level and a whole session, against bare PyVISA in the same run.

Writes ``results/benchmarks/rig.json``. Promises are ratios to bare PyVISA on the same simulator in the same run. The
driver reaches the simulator as a session does: through the watchdog's process, which holds the VISA session.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bars
import numpy as np
import pyvisa

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.controls import Controls
from modaltouch.rig.generator import Generator
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.watchdog_client import WatchdogClient
from modaltouch.stimulus.burst import Burst

ROOT = Path(__file__).parents[2]
SETUP = "both channels: upload, count, read-back, copy, select, errors"
LEVELS = "two amplitudes set, read back, error queue"
SESSION = "a session of 24 trials, opening to closing"
OFF = "outputs off after the session's process is gone"

QUERY = "query of the error queue"
BY_PYVISA = f"{SETUP}, by PyVISA alone"
THROUGH = "query of the error queue, through the watchdog"

BOUNDS = {
    (SETUP, BY_PYVISA): 2.5,
    (THROUGH, QUERY): 2.5,
    (LEVELS, THROUGH): 2.0,
    (OFF, QUERY): 10.0,
    ("heartbeat", QUERY): 0.01,
}
"""Largest ratio of one median to another from the same run [1]."""


def median_ms(action: Callable[[], object], n: int) -> tuple[float, float]:
    """Return the median and the 95th percentile of the duration of an action [ms]."""
    took = []
    for _ in range(n):
        started = time.perf_counter()
        action()
        took.append((time.perf_counter() - started) * 1e3)
    return statistics.median(took), statistics.quantiles(took, n=20)[-1]


def make_burst(seed: int, n_samples: int = 131_072) -> Burst:
    """Return a burst of random codes, at rest at both ends."""
    codes = np.random.default_rng(seed).integers(0, 16383, (2, n_samples)).astype(np.uint16)
    codes[:, [0, -1]] = 8191
    return Burst(codes, 0.05, 7.0, 0.2, (12.0, 8.0), AFG3022B.converter)


def measure_pyvisa(simulator: Simulator) -> dict[str, tuple[float, float]]:
    """Return the durations of PyVISA alone, without verification except in the set-up."""
    resource: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address)
    resource.chunk_size = 1 << 20
    block = make_burst(0).codes[0].astype(">u2").tobytes()
    command = b"DATA EMEM,#6" + str(len(block)).encode() + block + b"\n"

    def upload() -> None:
        resource.write_raw(command)
        resource.query("*OPC?")

    def write_and_check() -> None:
        resource.write("SOUR1:VOLT 1VPP")
        resource.query("SYST:ERR?")

    def read_back() -> Any:
        return resource.query_binary_values("DATA? EMEM", datatype="H", is_big_endian=True, container=np.ndarray)

    codes = make_burst(0).codes[0]

    def set_up() -> None:
        for channel in (1, 2):
            upload()
            assert int(resource.query("DATA:POIN? EMEM")) == codes.size
            assert np.array_equal(read_back(), codes)
            resource.query(f"DATA:COPY USER{channel},EMEM;*OPC?")
            resource.write(f"SOUR{channel}:FUNC USER{channel}")
            assert resource.query("SYST:ERR?").startswith("0,")

    results = {
        "write, then error queue": median_ms(write_and_check, 200),
        "upload of 131072 points and *OPC?": median_ms(upload, 20),
        "read-back of 131072 points": median_ms(read_back, 20),
        BY_PYVISA: median_ms(set_up, 10),
    }
    resource.close()
    return results


def measure_driver(simulator: Simulator, rig: Generator) -> dict[str, tuple[float, float]]:
    """Return the durations of the driver, including everything that it verifies."""
    bursts = iter([make_burst(seed) for seed in range(1, 11)])
    results = {SETUP: median_ms(lambda: rig.load(next(bursts)), 10)}
    link = rig._connection.controls
    results |= measure_queries(simulator, link)
    burst = make_burst(0)
    rig.load(burst)
    results["loading a record that is there"] = median_ms(lambda: rig.load(burst), 20)
    levels = iter(np.linspace(1, 2, 1000))
    results[LEVELS] = median_ms(lambda: rig._player.set_levels((round(float(next(levels)), 3), 2.0)), 200)

    def trial() -> None:
        rig.fire(0.1)
        rig.stop()

    trial()
    results["fire and stop, everything checked"] = median_ms(trial, 50)
    results["heartbeat"] = median_ms(lambda: [rig.heartbeat() for _ in range(1000)], 20)
    results["heartbeat"] = tuple(value / 1000 for value in results["heartbeat"])  # type: ignore[assignment]
    results["speeds at two zones, another level"] = measure_felt(simulator, rig)
    return results


def measure_queries(simulator: Simulator, link: Controls) -> dict[str, tuple[float, float]]:
    """Return the durations of a query by PyVISA alone and through the watchdog.

    They are taken in turn: the fastest of them, by PyVISA alone, differs by half from minute to minute on one machine.
    """
    resource: Any = pyvisa.ResourceManager("@py").open_resource(simulator.address)
    took: dict[str, list[float]] = {QUERY: [], THROUGH: []}
    for _ in range(200):
        for name, ask in ((QUERY, resource.query), (THROUGH, link.ask)):
            started = time.perf_counter()
            ask("SYST:ERR?")
            took[name].append((time.perf_counter() - started) * 1e3)
    resource.close()
    return {name: (statistics.median(times), statistics.quantiles(times, n=20)[-1]) for name, times in took.items()}


def measure_felt(simulator: Simulator, rig: Generator) -> tuple[float, float]:
    """Return the time to compute the velocity under two fingers at another level."""
    took = []
    for trial in range(24):
        rig.fire((0.08, 0.1, 0.15, 0.2)[trial % 4])
        started = time.perf_counter()
        simulator.felt_velocity(["A", "C"])
        took.append((time.perf_counter() - started) * 1e3)
        rig.stop()
    return statistics.median(took), max(took)


def measure_session(simulator: Simulator, apparatus: Any) -> float:
    """Return the rig time of a session of 24 trials, from opening to closing [ms]."""
    burst = make_burst(0, 125_000)
    started = time.perf_counter()
    with Generator(simulator.address, apparatus) as rig:
        rig.load(burst)
        for trial in range(24):
            rig.fire((0.08, 0.1, 0.15, 0.2)[trial % 4])
            simulator.felt_velocity([("A", "C"), ("B", "D"), ("C", "E")][trial % 3])
            rig.stop()
    return (time.perf_counter() - started) * 1e3


def measure_end(simulator: Simulator) -> tuple[float, float]:
    """Return how long outputs stay on after the session's process is gone and its pipe has ended [ms]."""

    def end() -> float:
        dog = WatchdogClient(simulator.address, AFG3022B.off)
        dog.open()
        dog.arm(free_running=False)
        simulator.front_panel("OUTP1 ON;:OUTP2 ON")
        started = time.perf_counter()
        dog.release(clean=False)
        while any(simulator.outputs):
            time.sleep(1e-4)
        return (time.perf_counter() - started) * 1e3

    took = [end() for _ in range(7)]
    return statistics.median(took), max(took)


def main() -> None:
    """Measure, print a table and the promises, and write them."""
    apparatus = Apparatus.read(ROOT / "protocols" / "apparatus" / "beam_100x6x2.yaml")
    with Simulator(apparatus) as simulator:
        rows = measure_pyvisa(simulator)
        started = time.perf_counter()
        with Generator(simulator.address, apparatus) as rig:
            opened = (time.perf_counter() - started) * 1e3
            rows |= {"opening, identity, settings": (opened, opened)} | measure_driver(simulator, rig)
        session = measure_session(simulator, apparatus)
        rows |= {SESSION: (session, session), OFF: measure_end(simulator)}
    print(f"{'':76} {'median':>9} {'95 %':>9}  [ms]")
    for name, (median, high) in rows.items():
        print(f"{name:76} {median:9.4f} {high:9.4f}")
    table = [{"what": name, "median_ms": median, "p95_ms": high} for name, (median, high) in rows.items()]
    promises = [
        bars.at_most(f"{name}, relative to {peer.replace(name, 'the same')}", rows[name][0] / rows[peer][0], bound)
        for (name, peer), bound in BOUNDS.items()
    ]
    bars.write("rig", {"pyvisa": pyvisa.__version__, "rows": table}, promises)


if __name__ == "__main__":
    main()
