"""The twin's list of the bursts that it played: one line each, in a file that other programs read meanwhile."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvisa

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.system.clock import VirtualClock

SETTINGS = "SOUR{n}:FUNC USER1;FREQ 20;:SOUR{n}:BURS:STAT ON;NCYC 1;:OUTP{n}:IMP INF;:SOUR{n}:VOLT {n}VPP;:OUTP{n} ON"


def arm(simulator: Simulator, playback: Playback) -> None:
    """Switch on bursts of 50 ms, 1 and 2 Vpp, that wait for triggers."""
    simulator.afg.user[1] = playback.record
    for command in ("TRIG:SOUR EXT", SETTINGS.format(n=1), SETTINGS.format(n=2)):
        simulator.front_panel(command)
    simulator.afg.clock.sleep(0.01)


def lines_of(file: Path) -> list[dict[str, Any]]:
    """Return the lines written so far."""
    return [json.loads(line) for line in file.read_text().splitlines()]


@contextlib.contextmanager
def twin(file: Path) -> Iterator[int]:
    """Run a twin in a separate process; yield its port."""
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--played", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline().partition(",")[2].partition(":")[0])
        finally:
            process.terminate()


def visa(port: int) -> Any:
    """Return a VISA resource at a port."""
    return pyvisa.ResourceManager("@py").open_resource(f"TCPIP::127.0.0.1,{port}::inst0::INSTR")


def prepare(instrument: Any) -> None:
    """Switch on bursts of 50 ms that wait for triggers."""
    instrument.write("DATA:DEF EMEM,1000;:DATA:DATA:LINE EMEM,100,8191,500,9000;:DATA:COPY USER1;:TRIG:SOUR EXT")
    for n in (1, 2):
        instrument.write(SETTINGS.format(n=n))
    # The relays take 4 ms of the twin's own time, and the timer's last burst 50 ms.
    time.sleep(0.1)


def test_a_line_describes_what_reached_the_beam(
    apparatus: Apparatus, playback: Callable[..., Playback], tmp_path: Path
) -> None:
    """A whole burst, one cut in its middle, one with a tripped amplifier; no line for a trigger with outputs off."""
    file, clock, burst = tmp_path / "played", VirtualClock(50.0), playback()
    with Simulator(apparatus, clock=clock, played=file) as simulator:
        arm(simulator, burst)
        simulator.front_panel("*TRG")
        whole = simulator.felt_velocity(list(apparatus.zones)) * 1e3
        clock.sleep(0.1)
        simulator.front_panel("*TRG")
        clock.sleep(0.015)
        simulator.front_panel("ABOR")
        simulator.twin.tripped = True  # a line that is computed later is still that of a burst before
        simulator.front_panel("*TRG")
        clock.sleep(0.1)
        simulator.afg.settle()
        simulator.twin.tripped = False
        simulator.front_panel("OUTP1 OFF;:OUTP2 OFF")
        clock.sleep(0.1)
        simulator.front_panel("*TRG")
        clock.sleep(0.1)
    lines = lines_of(file)
    assert [line["whole"] for line in lines] == [True, False, True]
    assert [line["amplitude_Vpp"] for line in lines] == [[1.0, 2.0]] * 3
    peaks = np.array([list(line["zone_peak_mm_s"].values()) for line in lines])
    assert list(lines[0]["zone_peak_mm_s"]) == list(apparatus.zones)
    assert peaks[0] == pytest.approx(whole, abs=1e-4)
    assert (peaks[1] > 0).all()
    assert (peaks[2] == 0).all()
    assert lines[0]["end_s"] - lines[0]["start_s"] == pytest.approx(0.05)
    assert {line["link"] for line in lines} == {0}


def test_the_peak_of_a_cut_burst_is_that_of_the_part_played(
    apparatus: Apparatus, playback: Callable[..., Playback], tmp_path: Path
) -> None:
    """A record at rest in its second half is unaffected by the cut; one at rest in its first half loses everything."""
    file, clock = tmp_path / "played", VirtualClock(50.0)
    half = playback().record[::2]
    codes = np.frombuffer(playback().record, ">u2")[::2]
    rest = np.full(codes.size, 8191, ">u2")
    assert len(half) == codes.nbytes
    with Simulator(apparatus, clock=clock, played=file) as simulator:
        for record in (np.concatenate([codes, rest]), np.concatenate([rest, codes])):
            for cut in (False, True):
                simulator.front_panel("OUTP1 OFF;:OUTP2 OFF")
                arm(simulator, Playback(record.astype(">u2").tobytes(), 1.0, 0.0, 0.05, math.inf, 8191))
                simulator.front_panel("*TRG")
                clock.sleep(0.0252)
                if cut:
                    simulator.front_panel("ABOR")
                clock.sleep(0.1)
    begun, begun_cut, late, late_cut = (line["zone_peak_mm_s"]["C"] for line in lines_of(file))
    assert begun_cut == pytest.approx(begun, rel=1e-3)
    assert late == pytest.approx(begun, rel=1e-3)
    assert late_cut < 1e-3 * late


def test_a_burst_that_plays_when_the_twin_ends_is_listed(
    apparatus: Apparatus, playback: Callable[..., Playback], tmp_path: Path
) -> None:
    """Its end is the twin's, and it is not whole."""
    clock = VirtualClock(50.0)
    with Simulator(apparatus, clock=clock, played=tmp_path / "played") as simulator:
        arm(simulator, playback())
        simulator.front_panel("*TRG")
        clock.sleep(0.02)
    (line,) = lines_of(tmp_path / "played")
    assert (line["end_s"], line["whole"]) == (pytest.approx(clock.now()), False)


def test_a_full_disk_is_reported(
    apparatus: Apparatus, playback: Callable[..., Playback], capsys: pytest.CaptureFixture[str]
) -> None:
    """The twin continues without its list."""
    clock = VirtualClock(50.0)
    with Simulator(apparatus, clock=clock, played=Path("/dev/full")) as simulator:
        arm(simulator, playback())
        simulator.front_panel("*TRG")
        clock.sleep(0.1)
    assert capsys.readouterr().err.startswith("/dev/full: No space left on device; no burst is listed from here on")


def test_links_are_distinguished(apparatus: Apparatus, playback: Callable[..., Playback], tmp_path: Path) -> None:
    """By message and by VXI-11's trigger, over two links; 0 is the front panel, null the timer."""
    clock = VirtualClock(50.0)
    with Simulator(apparatus, clock=clock, played=tmp_path / "played") as simulator:
        arm(simulator, playback())
        port = simulator.address.partition(",")[2].partition(":")[0]
        links = [visa(int(port)), visa(int(port))]
        steps: Sequence[Callable[[], object]] = (
            lambda: links[0].write("TRIG:SEQ:IMM"),
            lambda: links[1].write("*TRG"),
            lambda: links[1].assert_trigger(),
            lambda: simulator.front_panel("*TRG"),
            lambda: simulator.front_panel("TRIG:TIM 0.09;SOUR TIM"),
        )
        for step in steps:
            step()
            clock.sleep(0.16)
        for link in links:
            link.close()
    lines = lines_of(tmp_path / "played")
    assert [line["link"] for line in lines[:5]] == [1, 2, 2, 0, None]


def test_velocities_are_not_recomputed_while_the_period_jitters(
    apparatus: Apparatus, playback: Callable[..., Playback], rng: np.random.Generator
) -> None:
    """One computation for fifty triggers, including the first, which has no period yet."""
    clock = VirtualClock(50.0)
    with Simulator(apparatus, clock=clock) as simulator:
        arm(simulator, playback())
        periods, felt = set(), []
        for _ in range(50):
            simulator.front_panel("*TRG")
            felt.append(float(simulator.felt_velocity(["C"])[0]))
            periods.add(simulator.playbacks[0].period)  # type: ignore[union-attr]
            clock.sleep(1 / 7 + rng.normal(0, 1e-3))
        assert simulator.twin.peaks.cache_info().misses == 1
        assert len(periods) > 3
        assert set(felt) == {felt[0]}


def test_another_process_reads_each_burst_when_it_ends(tmp_path: Path) -> None:
    """While the twin runs; by the machine's clock the burst starts between sending and acknowledgement, plus 0.3 ms."""
    file = tmp_path / "played"
    with twin(file) as port:
        instrument = visa(port)
        prepare(instrument)
        for n in range(3):
            n_before = len(lines_of(file))
            sent = time.monotonic()
            instrument.write("TRIG:SEQ:IMM")
            taken = time.monotonic()
            while len(lines_of(file)) == n_before:
                assert time.monotonic() - sent < 20, f"no line of burst {n}"
            line = lines_of(file)[-1]
            assert sent + 1e-4 <= line["start_s"] <= taken + 3e-4
            assert line["whole"] is True
            assert line["end_s"] < time.monotonic()
        instrument.close()


def test_the_twin_does_not_start_if_its_list_cannot_be_written(tmp_path: Path) -> None:
    """A message with the file and the remedy, status 2, no address."""
    ended = subprocess.run(
        [sys.executable, "-m", "modaltouch", "rig", "simulate", "--played", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[3],
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert " ".join(ended.stderr.split()) == (
        f"{tmp_path}: given a file that cannot be written (Is a directory); allowed: a file in a folder you may "
        "write to; give another one with --played"
    )
