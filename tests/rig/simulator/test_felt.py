"""What fingers feel on the simulated beam: closed forms, linearity, and nothing computed that nobody asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import Twin


def test_sine_at_a_resonance_reaches_the_closed_form(with_twin: Callable[..., Apparatus], apparatus: Apparatus) -> None:
    """Steady state at resonance: speed = G V / (2 xi w) per modal shape (erratum 1); mode 1 alone, 2 s of sine."""
    mode = next(mode for mode in apparatus.modes if mode.label == 1)
    alone = with_twin(apparatus).model_copy(update={"modes": (mode,)})
    twin = Twin(alone, seed=1)
    n, cycles = 100_000, 458
    duration = cycles / 229.0
    wave = np.round(8191 + 8191 * np.sin(2 * np.pi * cycles * np.arange(n) / n)).astype(">u2").tobytes()
    sine = Playback(wave, 2.0, 0.0, duration, duration, 8191)
    volts = 1.0 * apparatus.amplifier.gain_V_per_V
    expected = 114e-3 * volts / (2 * 0.0437 * 2 * np.pi * 229)
    assert twin.felt([sine, None], [0.0])[0] == pytest.approx(expected, rel=2e-3)


def test_speed_is_linear_and_computed_once(playback: Callable[..., Playback], twin: Twin) -> None:
    """Another level of the same records is a scale factor: no second computation."""
    one = twin.felt([playback(2.0), playback(1.0)], [0.0, -0.04])
    two = twin.felt([playback(4.0), playback(2.0)], [0.0, -0.04])
    assert two == pytest.approx(2 * one, rel=1e-12)
    assert twin.peaks.cache_info().misses == 1
    twin.felt([playback(4.0), playback(1.0)], [0.0])
    assert twin.peaks.cache_info().misses == 2


def test_only_the_places_asked_for_are_computed(playback: Callable[..., Playback], twin: Twin) -> None:
    """A new place of the same setting is computed, a known one is not."""
    twin.felt([playback(), None], [0.0])
    twin.felt([playback(), None], [0.0])
    assert twin.peaks.cache_info().misses == 1
    twin.felt([playback(), None], [0.0, 0.02])
    assert twin.peaks.cache_info().misses == 2


def test_nothing_is_computed_while_nobody_measures(simulator: Simulator) -> None:
    """An idle simulator computes nothing, and so does a question about a beam at rest."""
    simulator.felt_velocity(["A", "B", "C"])
    assert simulator.twin.peaks.cache_info().misses == 0


def test_amplifier_saturates(playback: Callable[..., Playback], twin: Twin, apparatus: Apparatus) -> None:
    """20 Vpp at a gain of 25 are 250 V: more amplitude than that adds no volt at the beam."""
    (held,) = twin.held_of([playback(40.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(apparatus.amplifier.limit_V)
    at_limit = twin.felt([playback(20.0), None], [0.0])[0]
    beyond = twin.felt([playback(40.0), None], [0.0])[0]
    assert at_limit < beyond < 2 * at_limit


def test_amplifier_pole_slows_the_fast_modes(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """A first-order pole at the drive's own frequency leaves 1/sqrt(2) of it, within 2 %."""
    hertz = 2553.0
    mode = next(mode for mode in apparatus.modes if mode.label == 3)
    alone = with_twin(apparatus).model_copy(update={"modes": (mode,)})
    slow = alone.model_copy(
        update={"amplifier": apparatus.amplifier.model_copy(update={"bandwidth_kHz": hertz * 1e-3})}
    )
    drive = playback(4.0, n=50_000, hertz=hertz)
    ratio = Twin(slow, 1).felt([drive, None], [0.0]) / Twin(alone, 1).felt([drive, None], [0.0])
    assert ratio[0] == pytest.approx(1 / np.sqrt(2), rel=0.02)


def test_constant_level_moves_nothing(playback: Callable[..., Playback], twin: Twin) -> None:
    """An offset, or an idle level that the record does not leave, is a constant volt: no velocity."""
    flat = replace(playback(), record=(8500).to_bytes(2, "big") * 100, idle_code=8500, offset=1.0)
    assert twin.felt([flat, None], [0.0])[0] == pytest.approx(0, abs=1e-15)


def test_first_point_off_zero_kicks_the_beam(playback: Callable[..., Playback], twin: Twin) -> None:
    """Where the output rests at the offset, a record that begins elsewhere starts with a step."""
    step = replace(playback(), record=(8500).to_bytes(2, "big") * 100, idle_code=8191)
    assert twin.felt([step, None], [0.0])[0] > 1e-4


def test_unequal_rates_add_their_peaks(playback: Callable[..., Playback], twin: Twin) -> None:
    """Channels of different period slide past each other: the peaks meet."""
    left, right = playback(), replace(playback(), period=0.2)
    together = twin.felt([left, right], [0.0])[0]
    alone = twin.felt([left, None], [0.0])[0] + twin.felt([None, right], [0.0])[0]
    assert together == pytest.approx(alone)


def test_tripped_amplifier_moves_nothing(playback: Callable[..., Playback], twin: Twin) -> None:
    """Its output is cut."""
    twin.tripped = True
    assert twin.felt([playback(), playback()], [0.0]).tolist() == [0.0]


def test_zone_is_felt_at_its_centre(playback: Callable[..., Playback], simulator: Simulator) -> None:
    """A zone's name and its centre in metres are one place; another name is refused with the names there are."""
    simulator.afg.user[1] = playback().record
    simulator.front_panel("SOUR1:FUNC USER1;FREQ 20;:OUTP1 ON")
    assert simulator.felt_velocity(["A"]) == simulator.felt_velocity([-0.04])
    with pytest.raises(ValueError, match="'F' is not a zone of this beam: name one of A, B, C, D, E"):
        simulator.felt_velocity(["F"])
