"""Bursts of several cycles and bursts with a trigger delay are played as set."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.scope import drive_voltage, motions_of
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import MOST_SAMPLES, Twin
from modaltouch.system.clock import VirtualClock

Play = Callable[..., Playback]


def course(twin: Twin, sent: list[Playback | None], time: np.ndarray) -> np.ndarray:
    """Return the velocity of the beam's middle over time [m/s]."""
    motions = motions_of(twin, sent, 0.011, offset=0.0, bandwidth=None, touched=(), span=(time[0], time[-1]))
    return np.sum([motion.at(time) for motion in motions], axis=0)


def test_cycles_follow_each_other_without_a_gap(twin: Twin, playback: Play) -> None:
    """Three cycles of 25 ms give the same states as one record of 75 ms that contains them in sequence."""
    cycle = replace(playback(), duration=0.025, n_cycles=3)
    whole = replace(playback(), duration=0.075, record=cycle.record * 3)
    for instant in (0.01, 0.03, 0.0749, 0.1):
        got, expected = (twin.true_state([sent, None], instant) for sent in (cycle, whole))
        np.testing.assert_allclose(got.velocity, expected.velocity, rtol=1e-9)
    assert twin.felt([cycle, None], [0.0]) == pytest.approx(twin.felt([whole, None], [0.0]))


def test_several_cycles_build_up_a_resonance(twin: Twin, playback: Play) -> None:
    """Sine at the first resonance: the envelope is 1 - e^(-a t), and the last peak is at n - 1/4 cycles."""
    time = np.arange(1000) / 1000
    sine = np.round(8191 + 8191 * np.sin(2 * np.pi * time)).astype(">u2").tobytes()
    beam = twin.beam.table
    first = beam.label.index(1)
    hertz, damping = beam.angular_frequency[first] / (2 * np.pi), beam.damping_ratio[first]
    one = replace(playback(), record=sine, duration=1 / hertz, n_cycles=1, period=math.inf)
    peaks = []
    for n in (1, 5):
        sent = [replace(one, n_cycles=n), None]
        instants = (n - 0.5 + np.linspace(0, 0.5, 200)) / hertz
        peaks.append(max(abs(twin.true_state(sent, t, first=True).velocity[first]) for t in instants))
    envelope = [1 - math.exp(-2 * math.pi * damping * (n - 0.25)) for n in (1, 5)]
    assert peaks[1] / peaks[0] == pytest.approx(envelope[1] / envelope[0], rel=0.02)


def test_triggers_during_a_burst_of_many_cycles_are_lost(twin: Twin, playback: Play) -> None:
    """Five cycles of 50 ms after a delay of 40 ms, a trigger every 1/7 s: every third counts (290 of 428.6 ms)."""
    (held,) = twin.held_of([replace(playback(), n_cycles=5, delay=0.04), None])
    assert held.period == pytest.approx(3 / 7)
    assert held.duration == pytest.approx(0.25)


def test_a_million_cycles_need_bounded_memory(twin: Twin, playback: Play) -> None:
    """MOST_SAMPLES points at most; triggers are lost for the duration of all cycles."""
    (held,) = twin.held_of([replace(playback(), n_cycles=1_000_000), None])
    assert held.voltage.shape[1] <= MOST_SAMPLES
    assert held.period == pytest.approx(50_000, rel=1e-4)


def test_a_delay_only_shifts_the_burst(twin: Twin, playback: Play) -> None:
    """Everything is 10 ms later, around the whole period: true states, motion and drive, with the same peaks."""
    now, later = playback(), replace(playback(), delay=0.01)
    instants = np.linspace(0.0101, 0.14, 50)
    np.testing.assert_allclose(course(twin, [later, None], instants), course(twin, [now, None], instants - 0.01))
    early = np.array([0.002, 0.009])
    np.testing.assert_allclose(course(twin, [later, None], early), course(twin, [now, None], early - 0.01 + 1 / 7))
    for instant in (0.012, 0.03, 0.1):
        got, expected = twin.true_state([later, None], instant), twin.true_state([now, None], instant - 0.01)
        np.testing.assert_allclose(got.velocity, expected.velocity, rtol=1e-9)
    assert not twin.true_state([later, None], 0.005, first=True).velocity.any()
    drives = drive_voltage(twin, [later, None], 0), drive_voltage(twin, [now, None], 0)
    assert drives[0] is not None
    assert drives[1] is not None
    np.testing.assert_allclose(drives[0].at(instants), drives[1].at(instants - 0.01))
    assert twin.felt([later, None], [0.0]) == pytest.approx(twin.felt([now, None], [0.0]))


def test_channels_with_different_delays_are_added_in_time(twin: Twin, playback: Play) -> None:
    """The second channel is 3 ms late: the peak is that of the sum over time, within 0.3 %, not the sum of peaks."""
    sent = [playback(), replace(playback(), delay=0.003)]
    fine = np.abs(course(twin, sent, np.arange(0, 0.2, 0.5e-6))).max()
    assert twin.felt(sent, [0.011])[0] == pytest.approx(fine, rel=3e-3)
    assert twin.felt([sent[0], None], [0.011])[0] + twin.felt([None, sent[1]], [0.011])[0] > 1.01 * fine


def test_the_instrument_plays_the_cycles_and_delay_that_are_set(simulator: Simulator) -> None:
    """With INFinity cycles the record repeats continuously, and the delay does not apply."""
    simulator.front_panel("DATA:COPY USER1;:SOUR1:FUNC USER1;:SOUR1:FREQ 20;:SOUR1:BURS:STAT ON;:OUTP1 ON")
    simulator.front_panel("SOUR1:BURS:NCYC 3;:SOUR1:BURS:TDEL 5MS;:TRIG:TIM 0.2")
    sent = simulator.playbacks[0]
    assert sent is not None
    assert (sent.duration, sent.period, sent.n_cycles, sent.delay) == (0.05, 0.2, 3, 0.005)
    simulator.front_panel("SOUR1:BURS:NCYC INF")
    sent = simulator.playbacks[0]
    assert sent is not None
    assert (sent.duration, sent.period, sent.n_cycles, sent.delay) == (0.05, 0.05, 1, 0)


def test_edit_memory_and_phase_are_played(simulator: Simulator) -> None:
    """EMEM is a waveform like the USER memories; a phase of 90 degrees starts a quarter into the record."""
    simulator.front_panel("DATA:DEF EMEM,1000;:DATA:DATA:LINE EMEM,1,0,1000,9990;:SOUR2:FUNC EMEM;:OUTP2 ON")
    sent = simulator.playbacks[1]
    assert sent is not None
    straight = np.frombuffer(sent.record, ">u2")
    assert straight.tolist() == list(range(0, 10_000, 10))
    simulator.front_panel("SOUR2:PHAS 90DEG")
    sent = simulator.playbacks[1]
    assert sent is not None
    np.testing.assert_array_equal(np.frombuffer(sent.record, ">u2"), np.roll(straight, -250))


def test_a_trigger_during_a_delayed_burst_is_lost(apparatus: Apparatus) -> None:
    """*TRG: 10 ms of delay and three cycles of 50 ms; a trigger 159 ms later is lost, the next one counts."""
    clock = VirtualClock(100.0)
    with Simulator(apparatus, clock=clock) as simulator:
        simulator.front_panel("DATA:COPY USER1;:SOUR1:FUNC USER1;:SOUR1:FREQ 20;:SOUR1:BURS:STAT ON;:OUTP1 ON")
        simulator.front_panel("SOUR1:BURS:NCYC 3;:SOUR1:BURS:TDEL 10MS;:TRIG:SOUR EXT")
        assert simulator.playbacks[0] is None
        simulator.front_panel("*TRG")
        for wait in (0.159, 0.041):
            assert math.isinf(simulator.playbacks[0].period)  # type: ignore[union-attr]
            clock.sleep(wait)
            simulator.front_panel("*TRG")
        assert simulator.playbacks[0].period == pytest.approx(0.2)  # type: ignore[union-attr]
