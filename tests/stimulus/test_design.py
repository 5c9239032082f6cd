"""The stimulus of the shipped beam, as the other packages use it."""

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import TargetField


def test_shipped_field_selects_the_modes_of_the_paper(shipped):
    """Section II-B of the paper: modes 1, 3, 5, 7, 11 and 13 were selected."""
    assert shipped.selected == (1, 3, 5, 7, 11, 13)


def test_target_adds_up_to_the_level_at_the_centre(shipped):
    """Definition of the level: the velocity at the centre of the focus at the focusing instant."""
    assert shipped.target @ shipped.model.shapes([0.0])[:, 0] == pytest.approx(0.2, rel=1e-14)


def test_shipped_field_is_fourteen_millimetres_wide_at_80_per_cent(shipped):
    """14 mm at 80 %, the paper's "roughly 1.5 cm"."""
    assert shipped.projection.width(0.8) == pytest.approx(14e-3, abs=0.1e-3)
    assert 0.025 < shipped.projection.width(0.5) < 0.035


def test_rounded_codes_meet_every_modal_target_at_every_level(shipped):
    """Within 1e-4 of the peak at all four levels, including the rounding of the amplitude."""
    for level in shipped.levels:
        assert shipped.worst_modal_error(level) < 1e-4 * level


def test_paper_law_misses_what_the_exact_law_meets(shipped, shipped_paper):
    """Erratum 3: starting from rest, mode 1 falls short by exp(-2 a t_F) = 4.3 % under the paper's law."""
    reached, _ = shipped_paper.achieved(0.2)
    a = 0.0437 * 2 * np.pi * 229
    assert reached[0] / shipped_paper.target[0] - 1 == pytest.approx(-np.exp(-2 * a * 0.025), abs=2e-3)
    assert shipped_paper.worst_modal_error(0.2) > 100 * shipped.worst_modal_error(0.2)


def test_speed_at_the_focus_does_not_overshoot(shipped):
    """The highest speed at the focus over the whole burst lies within 1 % of the level."""
    for level in shipped.levels:
        assert shipped.peak_velocity([0.0], level)[0] == pytest.approx(level, rel=0.01)


def test_burst_begins_and_ends_at_rest(shipped, shipped_paper):
    """The generator idles at the first or the last code; both are mid-scale."""
    for stimulus in (shipped, shipped_paper):
        assert (stimulus.burst.codes[:, [0, -1]] == 8191).all()
        assert stimulus.burst.codes.min() >= 0
        assert stimulus.burst.codes.max() <= 16382


def test_all_levels_lie_on_the_amplitude_grid(shipped):
    """With four digits of amplitude, the ratios 80 : 100 : 150 : 200 are exact."""
    for level in shipped.levels:
        exact = np.asarray(shipped.burst.amplitude) * (level / 0.2)
        assert shipped.burst.amplitude_for(level) == pytest.approx(exact, rel=1e-12)


def test_every_level_shares_one_record(shipped):
    """Everything downstream is linear in the level: achieved velocities only scale."""
    low, _ = shipped.achieved(0.1)
    high, _ = shipped.achieved(0.2)
    assert low == pytest.approx(high / 2, rel=1e-12)


def test_braked_burst_repeats_exactly(design):
    """With `braked` every later burst is as exact as the first, with `free` it is not."""
    braked, free = design(), design(release="free")
    later = {s.release: np.abs(s.achieved(0.2, steady=True)[0] - s.achieved(0.2)[0]).max() for s in (braked, free)}
    assert later["braked"] < 1e-9 * 0.2
    assert 1e-6 < later["free"] < 1e-5


def test_zones_mirror_under_symmetric_modes(shipped, zones):
    """All selected modes are symmetric: A and E, B and D move alike."""
    speed = shipped.peak_velocity(zones, 0.2)
    assert speed[:2] == pytest.approx(speed[:2:-1], rel=1e-9)


def test_load_of_50_ohm_doubles_the_open_circuit_amplitude(design):
    """The generator's 50 ohm halve its open-circuit voltage into 50 ohm; the volts at the beam stay."""
    open_circuit, matched = design(), design(load_factor=0.5)
    assert matched.burst.amplitude[0] == pytest.approx(2 * open_circuit.burst.amplitude[0], rel=0.05)
    assert matched.achieved(0.2)[0] == pytest.approx(open_circuit.achieved(0.2)[0], abs=1e-5)


def test_pole_and_delay_of_the_amplifier_are_compensated(design):
    """An unmodelled 100 kHz pole costs 3 mm/s; a modelled one costs nothing."""
    amplifier = Amplifier(gain=25.0, limit=250.0, bandwidth=100e3, delay=4.6e-6)
    assert design(amplifier=amplifier).worst_modal_error(0.2) < 1e-4 * 0.2


@pytest.mark.parametrize(
    ("target_field", "message"),
    [
        (TargetField(centre=0.06), r"centred at 60 mm, off the beam, which spans -50 to 50 mm"),
        (TargetField(n_decomposed=10), r"mode 11 is modelled, but the field is decomposed on 10 modes only"),
        (
            TargetField(centre=0.02, base=1e-12),
            r"has a projection of \S+e-11 on .* which is not above zero within rounding",
        ),
        (
            TargetField(shape="box", base=0.05, selection=(7,)),
            r"a projection of -0\.\d+ on the modes 7, which is not above",
        ),
    ],
)
def test_target_fields_beyond_the_model_are_refused(model, target_field, message):
    """Value, bound and remedy."""
    with pytest.raises(ValueError, match=message):
        design_stimulus(model, target_field, Timing(AFG3022B.converter), Amplifier(gain=25.0, limit=250.0))


def test_a_mode_without_gain_is_refused_only_if_selected(model, design):
    """A mode with zero gain cannot be controlled; if it is not selected, it stays at rest."""
    gain = model.modal_gain.copy()
    gain[4] = 0.0
    assert design(replace(model, modal_gain=gain)).worst_modal_error(0.2) < 1e-4 * 0.2
    gain[2] = 0.0
    with pytest.raises(ValueError, match=r"mode 5 is asked for, but its gain is 0 m/s\^2 per V on every"):
        design(replace(model, modal_gain=gain))


def test_mode_above_half_the_sampling_rate_is_refused(design):
    """2 x 87.855 kHz x 50 ms = 8785.5 samples are too few."""
    with pytest.raises(ValueError, match=r"mode 17 at 87855 Hz .* use more than 8786 samples"):
        design(timing=Timing(AFG3022B.converter, n_samples=8000))


def test_fewer_samples_than_conditions_are_refused(design):
    """Nine modes have 18 conditions, ten of them on channel 2 alone; the first and last samples are not free."""
    timing = Timing(AFG3022B.converter, n_samples=125_000, focusing_instant=11 * 4e-7)
    with pytest.raises(ValueError, match=r"11 samples are fewer than 18 conditions .* at least 12"):
        _ = design(timing=timing).voltage
