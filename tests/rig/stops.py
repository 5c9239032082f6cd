"""Seeded kills and cuts while bursts play, judged by the twin's report of what it played.

``python tests/rig/stops.py --cases 1000 --out results/benchmarks/stops.json``
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cable import Cable

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"

HARDWARE_ENDS = 0.25
"""The last burst ends within this time after a fault [s]: a period until the pending trigger, and its burst."""

HEALED_AFTER = 10.0
"""How long a link is dead before it works again [s]."""

THAW = 0.02
"""Within this time after thawing, an instrument plays a trigger that it had accepted: it cannot be revoked [s]."""

WATCHED = 2.0
"""How long the beam is monitored after a kill, or after a link works again [s]."""

KINDS = (
    "both killed",
    "both stopped",
    "group killed",
    "session killed",
    "session stopped",
    "watchdog killed",
    "cable pulled",
    "half-open link",
    "mute link",
    "instrument frozen",
)

SITTING = """
import os, sys, time
import numpy as np
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig import Generator
from modaltouch.rig.interface import RigError, StimulusLost
from modaltouch.stimulus.burst import Burst

def sit(address):
    codes = np.full((2, 1000), 8191, dtype=np.uint16)
    codes[:, 500] = 12000
    with Generator(address, apparatus, log=lambda event, **facts: None) as rig:
        rig.load(Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0), AFG3022B.converter))
        rig.fire(0.1)
        print(rig._connection.guard._process.pid, flush=True)
        while True:
            try:
                rig.heartbeat()
            except StimulusLost:
                rig.stop()
                print(rig.firing.confirmed, rig.firing.reason, flush=True)
                return
            time.sleep(1e-3)

apparatus = Apparatus.read(sys.argv[1])
for line in sys.stdin:
    output, address = line.split()
    pid = os.fork()
    if pid == 0:
        os.setsid()
        null = os.open(output, os.O_WRONLY | os.O_CREAT)
        os.dup2(null, 1)
        os.dup2(null, 2)
        try:
            sit(address)
        except RigError as error:
            print(error, flush=True)
        os._exit(0)
    print(pid, flush=True)
"""
"""Runs sessions, each in a process forked after all imports."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one fault.

    Attributes
    ----------
    kind : str
        The kind of fault.
    seed : int
        The seed for its instant.
    last_end_s : float
        End of the last burst relative to the fault [s]; negative if it ended before.
    n_after_healing : int
        Bursts that began after the dead link had healed, or more than `THAW` after an instrument had thawed.
    n_confirmed : int
        Stimuli that were confirmed in spite of the fault.
    """

    kind: str
    seed: int
    last_end_s: float
    n_after_healing: int
    n_confirmed: int

    @property
    def is_safe(self) -> bool:
        """Whether the beam stopped by itself and stayed still."""
        return self.last_end_s <= HARDWARE_ENDS and not self.n_after_healing and not self.n_confirmed


class Bench:
    """A twin in a separate process, and a process from which sessions are forked.

    Parameters
    ----------
    folder : Path
        Folder for the output of both.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._numbers = itertools.count()
        self.played = folder / "played.jsonl"
        command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--played", str(self.played)]
        command += ["--apparatus", str(APPARATUS)]
        self.twin = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.twin.stdout is not None
        self.port = int(self.twin.stdout.readline().split(",")[1].split(":")[0])
        command = [sys.executable, "-c", SITTING, str(APPARATUS)]
        self._host = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def close(self) -> None:
        """End both processes."""
        for process in (self.twin, self._host):
            process.kill()
            process.wait()

    def run(self, kind: str, seed: int) -> Outcome:
        """Inject a fault during a stimulus, at an instant drawn from the seed, and return the outcome."""
        rng = random.Random(f"{kind} {seed}")
        with Cable(self.port) as cable:
            said = self._folder / f"said_{next(self._numbers)}.txt"
            session = self._start(cable.address, said)
            watchdog = int(_wait_for_line(said))
            try:
                time.sleep(rng.uniform(0.0, 0.6))
                fault = time.monotonic()
                healed = self._meet(kind, cable, session, watchdog, rng)
                time.sleep(WATCHED)
                return self._judge(kind, seed, fault, healed, said)
            finally:
                for pid in (session, watchdog):
                    with contextlib.suppress(OSError):
                        os.kill(pid, signal.SIGKILL)

    def _start(self, address: str, said: Path) -> int:
        assert self._host.stdin is not None
        assert self._host.stdout is not None
        self._host.stdin.write(f"{said} {address}\n")
        self._host.stdin.flush()
        return int(self._host.stdout.readline())

    def _meet(self, kind: str, cable: Cable, session: int, watchdog: int, rng: random.Random) -> float:
        """Inject the fault, and return the time at which the dead link or process works again."""
        victims = {
            "both killed": (signal.SIGKILL, session, watchdog),
            "both stopped": (signal.SIGSTOP, session, watchdog),
            "group killed": (signal.SIGKILL, session, watchdog),
            "session killed": (signal.SIGKILL, session),
            "session stopped": (signal.SIGSTOP, session),
            "watchdog killed": (signal.SIGKILL, watchdog),
        }.get(kind)
        if victims is not None:
            number, *pids = victims
            rng.shuffle(pids)
            for pid in pids:
                kill = os.killpg if kind == "group killed" else os.kill
                # The watchdog of a session that was killed first may already have ended.
                with contextlib.suppress(ProcessLookupError):
                    kill(pid, number)
                time.sleep(rng.uniform(0.0, 5e-3))
            return float("inf")
        if kind == "instrument frozen":
            os.kill(self.twin.pid, signal.SIGSTOP)
        else:
            cable.cut(
                "from" if kind == "mute link" else "both",
                new=kind != "half-open link",
            )
        time.sleep(HEALED_AFTER)
        healed = time.monotonic()
        if kind == "instrument frozen":
            os.kill(self.twin.pid, signal.SIGCONT)
        else:
            cable.heal()
        return healed

    def _judge(self, kind: str, seed: int, fault: float, healed: float, said: Path) -> Outcome:
        bursts = [json.loads(line) for line in self.played.read_text(encoding="utf-8").splitlines()]
        last = max((each["end_s"] for each in bursts if each["start_s"] < healed), default=fault)
        since = healed + (THAW if kind == "instrument frozen" else 0.0)
        after = sum(each["start_s"] >= since for each in bursts)
        confirmed = sum(line.startswith("True") for line in said.read_text(encoding="utf-8").splitlines())
        return Outcome(kind, seed, round(last - fault, 4), after, confirmed)


def _wait_for_line(path: Path, patience: float = 60.0) -> str:
    deadline = time.monotonic() + patience
    while not (path.exists() and path.read_text(encoding="utf-8").endswith("\n")):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{path} stays empty")
        time.sleep(2e-3)
    return path.read_text(encoding="utf-8").splitlines()[0]


def run_cases(n_cases: int, folder: Path, n_benches: int) -> list[Outcome]:
    """Return the outcomes of seeded faults, with the kinds in rotation, on several benches at the same time."""
    benches: list[Bench] = []
    own = threading.local()
    lock = threading.Lock()

    def run(number: int) -> Outcome:
        if not hasattr(own, "bench"):
            with lock:
                place = folder / f"bench_{len(benches)}"
                place.mkdir(parents=True)
                own.bench = Bench(place)
                benches.append(own.bench)
        outcome: Outcome = own.bench.run(KINDS[number % len(KINDS)], number)
        return outcome

    try:
        with ThreadPoolExecutor(n_benches) as pool:
            return list(pool.map(run, range(n_cases)))
    finally:
        for bench in benches:
            bench.close()


def summarise(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return the outcomes by kind."""
    by_kind: dict[str, list[Outcome]] = collections.defaultdict(list)
    for each in outcomes:
        by_kind[each.kind].append(each)
    return {
        kind: {
            "n": len(own),
            "n_safe": sum(each.is_safe for each in own),
            "latest_end_s": max(each.last_end_s for each in own),
            "n_after_healing": sum(each.n_after_healing for each in own),
            "n_confirmed": sum(each.n_confirmed for each in own),
        }
        for kind, own in by_kind.items()
    }


def main() -> int:
    """Run the faults and write the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--benches", type=int, default=6)
    parser.add_argument("--folder", type=Path, default=Path("build/stops"))
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    outcomes = run_cases(options.cases, options.folder / str(os.getpid()), options.benches)
    kinds = summarise(outcomes)
    result = {"n": len(outcomes), "n_safe": sum(each.is_safe for each in outcomes), "kinds": kinds}
    text = json.dumps(result, indent=2)
    print(text)
    for each in outcomes:
        if not each.is_safe:
            print(json.dumps(asdict(each)))
    if options.out is not None:
        options.out.write_text(text + "\n", encoding="utf-8")
    return 0 if result["n_safe"] == result["n"] else 1


if __name__ == "__main__":
    sys.exit(main())
