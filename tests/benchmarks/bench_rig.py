"""How long the rig takes: queries, uploads, a change of level, a whole session, beside bare PyVISA in the same run.

Writes ``results/benchmarks/rig.json``. The reference column holds the figures of the planning experiments, taken
with throwaway code over VXI-11 on another day; bare PyVISA on the same simulator is what this machine gives now.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyvisa

from modaltouch.apparatus import read_apparatus
from modaltouch.rig.generator import Generator
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst

ROOT = Path(__file__).parents[2]
REFERENCE_MS = {
    "query of the error queue": 0.37,
    "write, then error queue": 0.51,
    "upload of 131072 points and *OPC?": 3.5,
    "upload, count, read-back, copy, select: both channels": 20.1,
    "two amplitudes set, read back, error queue": 1.41,
}


def median_ms(action: Callable[[], object], n: int) -> tuple[float, float]:
    """Return the median and the 95th percentile of an action's time [ms]."""
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
    return Burst(codes, 0.05, 7.0, 0.2, (12.0, 8.0))


def measure_pyvisa(simulator: Simulator) -> dict[str, tuple[float, float]]:
    """Return what PyVISA alone takes."""
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

    def read_back() -> None:
        resource.query_binary_values("DATA? EMEM", datatype="H", is_big_endian=True, container=np.ndarray)

    results = {
        "query of the error queue": median_ms(lambda: resource.query("SYST:ERR?"), 200),
        "write, then error queue": median_ms(write_and_check, 200),
        "upload of 131072 points and *OPC?": median_ms(upload, 20),
        "read-back of 131072 points": median_ms(read_back, 20),
    }
    resource.close()
    return results


def measure_driver(simulator: Simulator, rig: Generator) -> dict[str, tuple[float, float]]:
    """Return what the driver takes, with everything that it verifies."""
    bursts = iter([make_burst(seed) for seed in range(1, 11)])
    results = {"upload, count, read-back, copy, select: both channels": median_ms(lambda: rig.load(next(bursts)), 10)}
    burst = make_burst(0)
    rig.load(burst)
    results["loading a record that is there"] = median_ms(lambda: rig.load(burst), 20)
    levels = iter(np.linspace(1, 2, 1000))
    results["two amplitudes set, read back, error queue"] = median_ms(
        lambda: rig.set_levels((round(float(next(levels)), 3), 2.0)), 200
    )

    def trial() -> None:
        rig.fire(0.1)
        rig.stop()

    trial()
    results["fire and stop, everything checked"] = median_ms(trial, 50)
    results["heartbeat"] = median_ms(lambda: [rig.heartbeat() for _ in range(1000)], 20)
    results["heartbeat"] = tuple(value / 1000 for value in results["heartbeat"])  # type: ignore[assignment]
    results["speeds at two zones, another level"] = measure_felt(simulator, rig)
    return results


def measure_felt(simulator: Simulator, rig: Generator) -> tuple[float, float]:
    """Return what it takes to know what two fingers feel at another level."""
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


def main() -> None:
    """Measure, print a table, and write it down."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks" / "rig.json")
    out = parser.parse_args().out
    apparatus = read_apparatus(ROOT / "protocols" / "apparatus" / "beam_100x6x2.yaml")
    with Simulator(apparatus) as simulator:
        rows = measure_pyvisa(simulator)
        started = time.perf_counter()
        with Generator(simulator.address, apparatus) as rig:
            opened = (time.perf_counter() - started) * 1e3
            rows |= {"opening, identity, settings": (opened, opened)} | measure_driver(simulator, rig)
        session = measure_session(simulator, apparatus)
        rows["a session of 24 trials, opening to closing"] = (session, session)
    print(f"{'':58} {'median':>9} {'95 %':>9} {'planned':>9}  [ms]")
    for name, (median, high) in rows.items():
        planned = REFERENCE_MS.get(name)
        print(f"{name:58} {median:9.4f} {high:9.4f} {planned if planned is not None else '':>9}")
    table = [
        {"what": name, "median_ms": median, "p95_ms": high, "planned_ms": REFERENCE_MS.get(name)}
        for name, (median, high) in rows.items()
    ]
    out.parent.mkdir(parents=True, exist_ok=True)
    machine = {"python": platform.python_version(), "system": platform.system(), "pyvisa": pyvisa.__version__}
    out.write_text(json.dumps({"machine": machine, "rows": table}, indent=2) + "\n")


if __name__ == "__main__":
    main()
