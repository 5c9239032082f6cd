"""Full scales on the generator's amplitude grid, and rounding to codes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.keysight33500b import KEYSIGHT_33500B
from modaltouch.stimulus.burst import Burst, Timing

AFG = AFG3022B.converter
SHIPPED_SHARES = (0.4, 0.5, 0.75, 1.0)


@given(least=st.floats(0.05, 20.0))
def test_shipped_levels_always_find_a_common_grid(least):
    """Some amplitude within 5 % has all of 80 : 100 : 150 : 200 on its grid of four digits.

    Tested from 50 mV, where the lowest level still reaches the generator's smallest amplitude, 20 mV.
    """
    amplitude = AFG.full_scale(least, SHIPPED_SHARES)
    assert least * (1 - 1e-12) <= amplitude <= 1.051 * least + 2e-4
    for share in SHIPPED_SHARES:
        assert AFG.round_amplitude(amplitude * share) == pytest.approx(amplitude * share, rel=1e-9)


@given(least=st.floats(0.02, 20.0), share=st.floats(0.05, 1.0))
@example(least=9.921875, share=0.772456531187997)
def test_any_level_is_met_within_the_grid(least, share):
    """For any level, the amplitude is off by at most half a step of four digits or of 0.1 mV."""
    amplitude = AFG.full_scale(least, (share, 1.0))
    assert least * (1 - 1e-12) <= amplitude <= max(1.05 * least, least + 1e-4, 1.001 * least) * (1 + 1e-12)
    miss = abs(AFG.round_amplitude(amplitude * share) - amplitude * share)
    assert miss <= max(5.1e-4 * amplitude * share, 5.1e-5)


def test_silent_channel_has_no_amplitude():
    """Its full scale is zero."""
    assert AFG.full_scale(0.0, SHIPPED_SHARES) == 0.0


def test_codes_are_the_nearest_and_mid_scale_at_both_ends():
    """Uniform rounding to signed 14 bits about 8191; a silent channel stays at mid-scale."""
    voltage = np.array([[0.0, 1.0, -1.0, 0.49 / 8191, 0.51 / 8191, 0.5], [0.0] * 6])
    codes = AFG.unsigned(AFG.round_to_codes(voltage, np.array([1 / 8191, 0.0])))
    assert codes[0].tolist() == [8191, 16382, 0, 8191, 8192, AFG.mid_code]
    assert (codes[1] == AFG.mid_code).all()
    assert AFG.signed(codes)[0, 1:3].tolist() == [8191.0, -8191.0]


def test_amplitude_of_a_record_is_a_part_of_the_full_scale():
    """Codes from -1/4 to 1 use 5/8 of the range (Keysight); the AFG3022B's amplitude is always the full scale."""
    codes = np.array([[32767, 65534, 24575], [32767, 32767, 32767]], dtype=np.uint16)
    record = KEYSIGHT_33500B.converter
    assert record.shares(codes) == pytest.approx([0.625, 1.0], rel=1e-4)
    assert AFG.shares(codes).tolist() == [1.0, 1.0]
    assert record.amplitudes_at((16.0, 3.0), 0.1, 0.2, np.array([0.625, 1.0])) == (5.0, 1.5)


def test_a_burst_reproduces_the_voltages_it_was_made_from():
    """Within half a code at the reference level and, in proportion, at half of it."""
    voltage = np.array([[0.0, 33.3, -12.5, 0.0], [0.0] * 4])
    burst = Burst.holding(voltage, 25.0, 0.2, AFG, 4e-6, 20.0)
    assert burst.amplitude == (2.664, 0.0)
    assert burst.commanded(25.0) == pytest.approx(voltage, abs=33.3 / 8191 / 2)
    assert burst.commanded(25.0, 0.1) == pytest.approx(voltage / 2, abs=33.3 / 8191 / 4)


def test_voltage_beyond_the_full_scale_is_refused():
    """It is never clipped."""
    with pytest.raises(ValueError, match=r"channel 1 peaks at 2 V, beyond its full scale of 1 V"):
        AFG.round_to_codes(np.array([[0.0, 2.0, 0.0]]), np.array([1 / 8191]))


def test_every_channel_needs_its_unit():
    """A missing unit is an error, so no channel stays unrounded."""
    with pytest.raises(ValueError, match="shorter"):
        AFG.round_to_codes(np.zeros((2, 5)), np.array([1 / 8191]))


def test_a_clock_that_does_not_fit_begins_samples_late():
    """Seven samples on 20 clocks: sample n begins at the first edge at or after 20 n / 7; 21 clocks fit exactly."""
    rate = AFG.clock_rate
    timing = Timing(AFG, n_samples=7, duration=20 / rate, focusing_instant=10 / rate)
    expected = [np.ceil(20 * n / 7) - 20 * n / 7 for n in range(8)]
    assert timing.clock_error * rate == pytest.approx(expected, abs=1e-9)
    assert replace(timing, duration=21 / rate).clock_error is None


def test_the_ends_of_a_record_are_known(shipped):
    """The generator holds one of them between bursts; the larger is given relative to half of full scale."""
    codes = shipped.burst.codes.copy()
    assert shipped.burst.ends == (0.0, 0.0)
    codes[0, 0], codes[1, -1] = AFG.mid_code + 1000, AFG.mid_code - 2000
    assert replace(shipped.burst, codes=codes).ends == pytest.approx((1000 / 8191, 2000 / 8191))
