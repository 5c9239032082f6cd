"""Velocities under the fingers on the simulated beam: closed forms, linearity, and no unnecessary computation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.timeline import Playback
from modaltouch.rig.simulator.twin import Twin


def test_a_sine_at_resonance_agrees_with_the_closed_form(
    with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """Steady state at resonance: velocity = G V / (2 xi w) per modal shape (erratum 1); mode 1 alone, 2 s of sine."""
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


def test_velocity_is_linear_and_computed_once(playback: Callable[..., Playback], twin: Twin) -> None:
    """Another level of the same records is only a scale factor: no second computation."""
    one = twin.felt([playback(2.0), playback(1.0)], [0.0, -0.04])
    two = twin.felt([playback(4.0), playback(2.0)], [0.0, -0.04])
    assert two == pytest.approx(2 * one, rel=1e-12)
    assert twin.peaks.cache_info().misses == 1
    twin.felt([playback(4.0), playback(1.0)], [0.0])
    assert twin.peaks.cache_info().misses == 2


def test_only_requested_positions_are_computed(playback: Callable[..., Playback], twin: Twin) -> None:
    """A new position with the same settings is computed, a known one is not."""
    twin.felt([playback(), None], [0.0])
    twin.felt([playback(), None], [0.0])
    assert twin.peaks.cache_info().misses == 1
    twin.felt([playback(), None], [0.0, 0.02])
    assert twin.peaks.cache_info().misses == 2


def test_nothing_is_computed_for_a_beam_at_rest(simulator: Simulator) -> None:
    """Neither by an idle simulator nor by a query for the velocity of a beam at rest."""
    simulator.felt_velocity(["A", "B", "C"])
    assert simulator.twin.peaks.cache_info().misses == 0


def test_the_amplifier_saturates(playback: Callable[..., Playback], twin: Twin, apparatus: Apparatus) -> None:
    """20 Vpp at a gain of 25 are 250 V: a higher amplitude does not raise the voltage at the beam."""
    (held,) = twin.held_of([playback(40.0), None])
    assert np.abs(held.voltage[0]).max() == pytest.approx(apparatus.amplifier.limit_V)
    at_limit = twin.felt([playback(20.0), None], [0.0])[0]
    beyond = twin.felt([playback(40.0), None], [0.0])[0]
    assert at_limit < beyond < 2 * at_limit


def test_the_amplifiers_pole_attenuates_the_drive(
    playback: Callable[..., Playback], with_twin: Callable[..., Apparatus], apparatus: Apparatus
) -> None:
    """A first-order pole at the frequency of the drive reduces the velocity to 1/sqrt(2), within 2 %."""
    hertz = 2553.0
    mode = next(mode for mode in apparatus.modes if mode.label == 3)
    alone = with_twin(apparatus).model_copy(update={"modes": (mode,)})
    slow = alone.model_copy(
        update={"amplifier": apparatus.amplifier.model_copy(update={"bandwidth_kHz": hertz * 1e-3})}
    )
    drive = playback(4.0, n=50_000, hertz=hertz)
    ratio = Twin(slow, 1).felt([drive, None], [0.0]) / Twin(alone, 1).felt([drive, None], [0.0])
    assert ratio[0] == pytest.approx(1 / np.sqrt(2), rel=0.02)


def test_a_constant_voltage_causes_no_velocity(playback: Callable[..., Playback], twin: Twin) -> None:
    """An offset, or an idle level equal to the whole record, is a constant voltage."""
    flat = replace(playback(), record=(8500).to_bytes(2, "big") * 100, idle_code=8500, offset=1.0)
    assert twin.felt([flat, None], [0.0])[0] == pytest.approx(0, abs=1e-15)


def test_a_first_point_off_zero_excites_the_beam(playback: Callable[..., Playback], twin: Twin) -> None:
    """If the output rests at the offset, a record that begins at another code starts with a step."""
    step = replace(playback(), record=(8500).to_bytes(2, "big") * 100, idle_code=8191)
    assert twin.felt([step, None], [0.0])[0] > 1e-4


def test_peaks_are_added_at_unequal_rates(playback: Callable[..., Playback], twin: Twin) -> None:
    """Channels with different periods drift relative to each other, so that their peaks coincide at some time."""
    left, right = playback(), replace(playback(), period=0.2)
    together = twin.felt([left, right], [0.0])[0]
    alone = twin.felt([left, None], [0.0])[0] + twin.felt([None, right], [0.0])[0]
    assert together == pytest.approx(alone)


def test_a_tripped_amplifier_moves_nothing(playback: Callable[..., Playback], simulator: Simulator) -> None:
    """The amplifier's output is off."""
    simulator.afg.user[1] = playback().record
    simulator.front_panel("SOUR1:FUNC USER1;FREQ 20;:OUTP1 ON")
    assert simulator.felt_velocity([0.0]) > 0
    simulator.twin.tripped = True
    assert simulator.felt_velocity([0.0]).tolist() == [0.0]


def test_a_zone_stands_for_its_centre(playback: Callable[..., Playback], simulator: Simulator) -> None:
    """A zone's name and its centre in metres give the same velocity; an unknown name is refused with the known ones."""
    simulator.afg.user[1] = playback().record
    simulator.front_panel("SOUR1:FUNC USER1;FREQ 20;:OUTP1 ON")
    assert simulator.felt_velocity(["A"]) == simulator.felt_velocity([-0.04])
    with pytest.raises(ValueError, match="'F' is not a zone of this beam: name one of A, B, C, D, E"):
        simulator.felt_velocity(["F"])
