"""Demonstrations whose processes are stopped and continued at seeded moments.

``python tests/session/stalls.py --demos 20 --out results/benchmarks/stalls.json``
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from modaltouch.record.chain import read_chain

STOPPED = 0.8
"""How long a process is stopped [s]."""

EVERY = (2.0, 4.0)
"""From one stop to the next [s]."""

VICTIMS = (("session",), ("watchdog",), ("session", "watchdog"))
"""Who is stopped, chosen anew each time."""


@dataclass(frozen=True)
class Outcome:
    """What came of one demonstration.

    Attributes
    ----------
    seed : int
        Of the stops.
    status : int or None
        Its exit status; None where it did not end.
    seconds : float
        How long it took.
    n_stops : int
        How often it was stopped.
    n_answered : int
        Presentations that were confirmed.
    n_stalled, n_faults : int
        Presentations that were not confirmed: because of a stall, and held against the instrument.
    verified : bool
        Whether `modaltouch verify` finds the record sound.
    said : str
        Its last words.
    """

    seed: int
    status: int | None
    seconds: float
    n_stops: int
    n_answered: int
    n_stalled: int
    n_faults: int
    verified: bool
    said: str

    @property
    def is_well(self) -> bool:
        """Whether it ended as an undisturbed demonstration does."""
        return self.status == 0 and self.verified


def run_stopped(
    words: Sequence[str], seed: int, log: Path, *, display: str | None = None, longest: float = 900.0
) -> Outcome:
    """Run ``modaltouch`` with some words, its processes stopped at moments of a seed's.

    Parameters
    ----------
    words : sequence of str
        Of a session with a robot.
    seed : int
        Of moments and victims.
    log : Path
        Where the session is recorded.
    display : str, optional
        Where its window is opened; without one, it starts its own.
    longest : float
        After this long it is killed [s].
    """
    rng = random.Random(seed)
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    environment |= {"DISPLAY": display} if display else {}
    command = [sys.executable, "-m", "modaltouch", *words]
    began, n_stops = time.monotonic(), 0
    with tempfile.TemporaryFile("w+") as words_said:
        # A session of its own, so that no shell takes a stopped process for a job of its own.
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=words_said, start_new_session=True
        )
        try:
            while (status := _wait(process, rng.uniform(*EVERY))) is None and time.monotonic() < began + longest:
                _stop(process.pid, rng.choice(VICTIMS))
                n_stops += 1
        finally:
            # Its virtual display with it; the watchdog ends by itself.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        words_said.seek(0)
        said = words_said.read().strip().splitlines()[-1:]
    verified = subprocess.run([*command[:3], "verify", str(log.parent)], capture_output=True, check=False)
    events = read_chain(log).events if log.exists() else ()
    ended = [event["confirmed"] for event in events if event["event"] in ("trial", "unconfirmed", "trial_cut")]
    failed = [firing for firing in ended if not firing["confirmed"]]
    return Outcome(
        seed=seed,
        status=status,
        seconds=round(time.monotonic() - began, 1),
        n_stops=n_stops,
        n_answered=len(ended) - len(failed),
        n_stalled=sum(firing["stalled"] for firing in failed),
        n_faults=sum(not firing["stalled"] for firing in failed),
        verified=verified.returncode == 0,
        said="".join(said),
    )


def _wait(process: subprocess.Popen[bytes], seconds: float) -> int | None:
    """Return the exit status, or None if the process still runs."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        return process.wait(seconds)
    return None


def _stop(session: int, victims: Sequence[str]) -> None:
    """Stop a session, its watchdog, or both for a while."""
    pids = [session] * ("session" in victims) + _watchdogs(session) * ("watchdog" in victims)
    for number, seconds in ((signal.SIGSTOP, STOPPED), (signal.SIGCONT, 0.0)):
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
        time.sleep(seconds)


def _watchdogs(session: int) -> list[int]:
    """Return the watchdog processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == session and b"modaltouch.rig.watchdog_process" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return found


def main() -> int:
    """Run the demonstrations and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--demos", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("build/stalls"))
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    outcomes = []
    for seed in range(options.first_seed, options.first_seed + options.demos):
        results = options.folder / str(os.getpid()) / str(seed)
        log = results / "simulated/demo/sub-demo/ses-1/beh/session.jsonl"
        outcomes.append(run_stopped(["demo", "--results", str(results)], seed, log))
        print(json.dumps(asdict(outcomes[-1])), flush=True)
    counts = ("n_stops", "n_answered", "n_stalled", "n_faults")
    result = {
        "n_demos": len(outcomes),
        "n_well": sum(each.is_well for each in outcomes),
        **{name: sum(getattr(each, name) for each in outcomes) for name in counts},
        "seconds_longest": max(each.seconds for each in outcomes),
    }
    text = json.dumps(result, indent=2)
    print(text)
    if options.out is not None:
        options.out.write_text(text + "\n", encoding="utf-8")
    return 0 if result["n_well"] == result["n_demos"] else 1


if __name__ == "__main__":
    sys.exit(main())
