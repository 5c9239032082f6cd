"""What a spoilt measurement is told: the fault, where it is, and what to do; a mark where the result is kept."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import spoilt
from scipy.signal import fftconvolve

from modaltouch.lab.identification.causes import check_gains, probable_cause
from modaltouch.lab.identification.files import ResponseFormat, read_responses
from modaltouch.lab.identification.joint_fit import axis_error, identify
from modaltouch.lab.identification.responses import FrequencyResponses, Place
from modaltouch.lab.identification.shapes import in_two_units
from modaltouch.lab.identification.verdict import check_modes, misfit_verdict, warnings
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator.true_beam import TrueBeam, true_beam
from modaltouch.stimulus import mode_shapes


def measured(beam: TrueBeam, **fault: float) -> FrequencyResponses:
    """Return responses with the noise of a good measurement, about the lower modes."""
    return spoilt.measured(*spoilt.response_of(beam, **fault), seed=0).between(1200, 9400)


@pytest.fixture(scope="module")
def clean(beam: TrueBeam) -> FrequencyResponses:
    """Return responses without a fault."""
    return spoilt.measured(*spoilt.response_of(beam), seed=0)


def test_clean_responses_bear_no_mark(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Nothing is left but noise, nothing is warned of, and the misfit's verdict says so."""
    found = identify(clean, 0.1)
    check_modes(found, spoilt.LABELS)
    check_gains(found, apparatus)
    assert warnings(found) == []
    assert misfit_verdict(found).startswith("misfit 0.9") or misfit_verdict(found).startswith("misfit 1")
    assert "the noise alone" in misfit_verdict(found)


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "inverted"), (9.81, r"9\.\d+ times too large"), (0.0, "zero")])
def test_odd_point_is_named_and_may_be_left_out(clean: FrequencyResponses, factor: float, said: str) -> None:
    """The point at -35 mm by its factor, with the option that leaves it out; without it the others are fitted."""
    response = clean.response.copy()
    response[:, 3] *= factor
    odd = replace(clean, response=response)
    with pytest.raises(ValueError, match=rf"the response at -35 mm is {said} compared with.* --leave-out -35$"):
        identify(odd, 0.1, most=0)
    mended = odd.without([-0.035])
    assert mended.n_points == 20
    assert mended.marks == ("the responses at -35 mm were left out",)
    with pytest.raises(ValueError, match="--leave-out 1 is not a measured position; allowed: -50, -45"):
        odd.without([0.001])


@pytest.mark.parametrize("factor", [9.80665, 1e-3])
def test_several_points_in_another_unit_are_named_together(clean: FrequencyResponses, factor: float) -> None:
    """Not the worst of them alone, which would leave the others wrong."""
    response, some = clean.response.copy(), [2, 3, 9, 20]
    response[:, some] *= factor
    larger = some if factor > 1 else sorted({*range(21)} - {*some})
    named = ", ".join(f"{5 * point - 50} mm" for point in larger)
    with pytest.raises(
        ValueError, match=rf"the responses at {named} are about .* check whether all points have the sam"
    ):
        check_modes(identify(replace(clean, response=response), 0.1, most=0), spoilt.LABELS)


@pytest.mark.parametrize("n_points", [1, 2, 3, 4])
def test_few_points_are_not_said_to_have_two_units(n_points: int) -> None:
    """Of three points one is alone: it may just as well be odd."""
    places = [Place(x) for x in np.linspace(-0.05, 0.05, n_points)]
    shapes = np.ones((3, n_points))
    shapes[:, : n_points // 2] = 100.0
    assert bool(in_two_units(shapes, places, 0.1)) == (n_points == 4)


@pytest.mark.parametrize("fault", ["elsewhere", "exchanged", "too small"])
def test_gains_own_up_to_points_that_lie_elsewhere(beam: TrueBeam, clean: FrequencyResponses, fault: str) -> None:
    """0.3 mm off, exchanged with a neighbour, or 0.85 times: off by up to 2 %, and within twice the half-width."""
    responses, rng = clean, np.random.default_rng(1)
    if fault == "elsewhere":
        assert clean.positions is not None
        places = clean.positions + np.clip(3e-4 * rng.standard_normal(21), -5e-4, 5e-4)
        responses = replace(clean, positions=places).without([places[0], places[-1]])
    elif fault == "exchanged":
        responses = replace(clean, response=clean.response[:, [*range(9), 10, 9, *range(11, 21)]])
    else:
        responses = replace(clean, response=clean.response * np.where(np.arange(21) == 6, 0.85, 1.0)[:, None])
    assert not spoilt.is_wrong(identify(responses, 0.1), beam)


def test_one_set_that_is_inverted_at_a_point_is_named(clean: FrequencyResponses) -> None:
    """Turned for the side set alone: the set stands beside the position."""
    response = clean.response.copy()
    response[1, 17] *= -1
    with pytest.raises(ValueError, match="the response to side at 35 mm is inverted"):
        identify(replace(clean, response=response), 0.1, most=0)


def test_nonlinear_beam_is_marked_and_then_refused(beam: TrueBeam) -> None:
    """Modes that fall by a third and by three half-widths at their peak: marked, refused; by their own shapes."""
    found = identify(measured(beam, softening=0.1), 0.1)
    assert any("most probable cause is nonlinearity: drive at half the voltage" in said for said in warnings(found))
    found = identify(measured(beam, softening=3.0), 0.1)
    with pytest.raises(ValueError, match=r"(?s)the residual is .*, at most 10% is allowed.*nonlinearity"):
        check_modes(found, (3, 5))


def test_beam_that_drifts_in_a_scan_is_marked(beam: TrueBeam) -> None:
    """By half a thousandth from end to end, what is left grows along the beam; by two, modes are fitted by two each."""
    found = identify(spoilt.measured(*spoilt.response_of(beam, drift=5e-4), seed=1), 0.1)
    assert any("drift: let the beam warm up" in said for said in warnings(found))
    found = identify(measured(beam, drift=2e-3), 0.1)
    assert any("like a single mode that moved: the most probable cause is drift" in said for said in warnings(found))


def test_bending_beside_torsion_is_no_mode_that_moved(clean: FrequencyResponses) -> None:
    """Mode 10 and the third torsion mode lie within one width; here a wrong digit leaves a residual elsewhere."""
    response = clean.response.copy()
    response[0, 4, int(np.abs(clean.frequency - 2554).argmin())] *= 10
    found = identify(replace(clean, response=response), 0.1)
    ten, torsion = found.by_label[10], min(found.modes, key=lambda each: abs(each.natural_frequency.value - 26900))
    assert torsion.label is None
    assert torsion.natural_frequency.value - ten.natural_frequency.value < 2 * 26200 * ten.damping_ratio.value
    assert warnings(found)
    assert not any("within one width" in said for said in warnings(found))


def test_gains_between_two_units_are_named(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """In g for m/s^2, differentiated once too often, and one output behind a probe of 10 : 1."""
    turn = 2 * np.pi * clean.frequency
    small = identify(replace(clean, response=clean.response / 9.80665), 0.1, most=0)
    with pytest.raises(
        ValueError, match=r"the gains of centre and side are 0\.10. times those of beam_100x6x2: an acceleration in g"
    ):
        check_gains(small, apparatus)
    steep = identify(replace(clean, response=clean.response * turn), 0.1, most=0)
    with pytest.raises(
        ValueError, match=r"the gains of .* are .* times 2 pi f times those of .*: the motion is not the quantity"
    ):
        check_gains(steep, apparatus)
    probed = identify(replace(clean, response=clean.response * np.array([1.0, 10.0])[:, None, None]), 0.1, most=0)
    with pytest.raises(ValueError, match=r"the gains of side are (9|10).* times those of .* or a 10 : 1 probe"):
        check_gains(probed, apparatus)


def test_thousandfold_gains_are_named_by_a_rough_table(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Velocities in mm/s for m/s, where the listed gains are 30 % off either way."""
    modes = []
    for k, mode in enumerate(apparatus.modes):
        gains = {name: value * 1.3 ** (-1) ** k for name, value in mode.gain_mm_s2_per_V.items()}
        modes.append(mode.model_copy(update={"gain_mm_s2_per_V": gains}))
    found = identify(replace(clean, response=clean.response * 1e3), 0.1, most=0)
    with pytest.raises(ValueError, match="times those of beam_100x6x2: a prefix, milli or kilo, was missed"):
        check_gains(found, apparatus.model_copy(update={"modes": tuple(modes)}))


def test_angular_frequencies_are_named(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """An axis in rad/s: all natural frequencies are 2 pi times the listed ones."""
    found = identify(replace(clean, frequency=clean.frequency * 2 * np.pi, bandwidth=None), 0.1, most=0)
    with pytest.raises(ValueError, match=r"the natural frequencies are 6\.28 times those of .*: angular frequencies"):
        check_gains(found, apparatus)


def test_points_exchanged_are_no_lack_of_drive(clean: FrequencyResponses) -> None:
    """Two points far apart exchanged: resonances that stand out have no mode's shape, and more drive would not help."""
    order = [*range(21)]
    order[3], order[12] = 12, 3
    found = identify(replace(clean, response=clean.response[:, order]), 0.1)
    with pytest.raises(
        ValueError, match=r"(?s)no resonance has its mode shape\n.* is not that of a mode: check the pos"
    ) as refusal:
        check_modes(found, spoilt.LABELS)
    assert "drive harder" not in str(refusal.value)


def test_modes_split_by_drift_are_no_exchanged_points(apparatus: Apparatus) -> None:
    """Case 322 of `make spoilt`: torsion of no mode's shape stands out, but each missing mode is two resonances."""
    assert spoilt.outcome("drift", 322, apparatus)["right"]


def test_low_coherence_over_the_band_is_said(beam: TrueBeam) -> None:
    """Median of 0.2 where every peak is still seen."""
    found = identify(spoilt.measured(*spoilt.response_of(beam), seed=0, noise=50.0), 0.1, most=0)
    assert any("the median coherence over the band is 0." in said and "below 0.5" in said for said in warnings(found))


@pytest.mark.parametrize("seed", [2, 3])
def test_random_excitation_of_few_averages_is_no_nonlinearity(tmp_path: Path, seed: int) -> None:
    """Leakage makes a noise that peaks as the responses do: three modes out of four Hann windows of a random drive."""
    rng, rate = np.random.default_rng(seed), 11e3
    time, places = np.arange(45_000) / rate, np.linspace(-0.0495, 0.0495, 9)
    own, ratio = 2 * np.pi * np.array([271.4, 753.3, 1439.3]), np.array([0.0227, 0.0139, 0.0097])
    swings = np.exp(-np.outer(ratio * own, time)) * np.cos(np.outer(own * np.sqrt(1 - ratio**2), time))
    impulse = (np.array([-0.4, -4.5, -11.2]) * mode_shapes((3, 4, 5), places, 0.1).T) @ swings / rate
    drive = np.broadcast_to(rng.standard_normal(time.size), impulse.shape)
    motion = fftconvolve(drive, impulse, axes=1)[:, : time.size]
    motion = motion + 1e-3 * motion.max() * rng.standard_normal(motion.shape)
    arrays = {"time": time, "drive": drive[None], "motion": motion[None], "positions": places}
    np.savez(tmp_path / "a.npz", **arrays, sets=["centre"], quantity="velocity")
    found = identify(read_responses([tmp_path / "a.npz"], ResponseFormat(n_averages=4)), 0.1)
    check_modes(found, (3, 4, 5))
    assert [found.by_label[k].natural_frequency.value for k in (3, 4, 5)] == pytest.approx(own / 2 / np.pi, rel=1e-3)


def test_resonances_beside_each_other_explain_only_a_mode_that_belongs_there(clean: FrequencyResponses) -> None:
    """A resonance beside mode 5, which is found: no drift explains that mode 13, above the band, is missing."""
    found = identify(clean.between(1200, 15000), 0.1)
    sound = next(mode for mode in found.modes if mode.label == 5)
    at = found.modes.index(sound)
    found = replace(found, modes=(*found.modes[:at], replace(sound, label=None), *found.modes[at:]))
    with pytest.raises(ValueError, match=r"^mode 13 was not found: .* or name with --modes those to be found$"):
        check_modes(found, (3, 5, 13))
    below = [mode for mode in found.modes if mode.natural_frequency.value < 8000]
    found = replace(found, modes=tuple(replace(mode, label=None) if mode is sound else mode for mode in below))
    with pytest.raises(ValueError, match=r"(?s)^mode 5 was not found: .*like a single mode that moved"):
        check_modes(found, (3, 5))


def test_values_far_from_the_listed_ones_are_told(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Volts at the generator, a set turned, a wrong sampling rate: the table may be wrong, so they are marked."""
    found = identify(clean, 0.1)
    assert check_gains(found, apparatus, spoilt.LABELS) == []
    for factor, said in (
        (25.0, r"2\d\.\d for every mode by centre.*check units"),
        (-1.0, r"-[01]\S* for every mode by centre"),
    ):
        told = check_gains(identify(replace(clean, response=clean.response * factor), 0.1), apparatus, spoilt.LABELS)
        assert len(told) == 1
        assert re.search(f"gains, times those listed: .*{said}", told[0])
    (told,) = check_gains(identify(replace(clean, frequency=clean.frequency * 1.1), 0.1), apparatus, spoilt.LABELS)
    assert told.startswith("natural frequencies, times those listed: 1.1 for mode 1")


@pytest.mark.parametrize("factor", [0.5, 1.4, 2.0])
def test_a_set_of_another_scale_is_marked(clean: FrequencyResponses, apparatus: Apparatus, factor: float) -> None:
    """A probe or a gain set for one output: no beam changes the gains of all its modes alike."""
    found = identify(replace(clean, response=clean.response * np.array([1.0, factor])[:, None, None]), 0.1, most=0)
    (mark,) = check_gains(found, apparatus, spoilt.LABELS)
    value = re.fullmatch(r"gains, times those listed: (\S+) for every mode by side; check units, .*", mark)
    assert value is not None
    assert float(value[1]) == pytest.approx(factor, rel=0.06)


@pytest.mark.parametrize(("n_bins", "said"), [(0, ""), (1, "too high"), (-2, "too low")])
def test_an_axis_that_is_a_bin_off_is_marked(clean: FrequencyResponses, n_bins: int, said: str) -> None:
    """Resonances may lie anywhere, but 0 Hz may not: what lies off resonance tells 3.8 Hz."""
    moved = replace(clean, frequency=clean.frequency + n_bins * clean.spacing)
    mark = axis_error(identify(moved, 0.1))
    assert mark == "" if not said else f"are at least one bin, 3.815 Hz, {said}, judging by the values off res" in mark


def test_the_set_whose_axis_is_a_bin_off_is_named(clean: FrequencyResponses) -> None:
    """One file exported from 0 Hz on, the other from the first bin on: no nonlinearity."""
    both = replace(clean, response=np.stack([clean.response[0, :, 1:], clean.response[1, :, :-1]]), coherence=None)
    found = identify(replace(both, frequency=clean.frequency[1:]).between(50, 12e3), 0.1)
    mark = axis_error(found)
    assert re.search("at least one bin, 3.815 Hz, off for (centre|side), judging by the other sets: check where", mark)


def test_exchanged_sets_are_no_error_of_units(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Both sets under each other's name: the gains of centre are a tenth, as those of a probe of 10 : 1 would be."""
    found = identify(replace(clean, response=clean.response[::-1]), 0.1, most=0)
    with pytest.raises(ValueError, match="the sets are exchanged: the files hold the gains of side under the name cen"):
        check_gains(found, apparatus)


def test_a_wrong_unit_is_no_exchange_of_sets(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Each set moves the other's modes by a tenth: times g, these are the other's gains, but its own are tenfold."""
    found = identify(replace(clean, response=9.80665 * clean.response), 0.1, most=0)
    with pytest.raises(ValueError, match="times those of .*an acceleration in g was taken for m/s.2"):
        check_gains(found, apparatus)


@pytest.mark.parametrize(("drift", "said"), [(1.004, "drift between the sets"), (1.008, "drift, also between sets")])
def test_sets_that_drifted(clean: FrequencyResponses, beam: TrueBeam, drift: float, said: str) -> None:
    """Two resonances of one shape, each fitted well: no noise is left, yet the gains are wrong."""
    later = replace(beam.table, natural_frequency=beam.table.natural_frequency * drift)
    response = clean.response.copy()
    response[1] = spoilt.measured(*spoilt.response_of(replace(beam, table=later)), seed=0).response[1]
    told = warnings(identify(replace(clean, response=response), 0.1))
    assert any(f"like a single mode that moved: the most probable cause is {said}" in each for each in told)


def test_sets_with_other_times_are_named(clean: FrequencyResponses) -> None:
    """A trigger that is late for one set is no nonlinearity."""
    late = clean.response * np.exp(-2j * np.pi * clean.frequency * np.array([0, 5e-5])[:, None, None])
    with pytest.raises(ValueError, match=r"differs between the sets \(centre 0 ms, side 0.05\d* ms\): .* trigger"):
        identify(replace(clean, response=late), 0.1)


def test_exchanged_parts_are_not_called_conjugated(clean: FrequencyResponses) -> None:
    """`--conjugated` would not help: the responses would then be imaginary."""
    with pytest.raises(ValueError, match="real and imaginary parts are exchanged; export them again"):
        identify(replace(clean, response=clean.response.imag + 1j * clean.response.real), 0.1)


def test_hum_of_the_mains_is_named(clean: FrequencyResponses) -> None:
    """Lines at multiples of 50 Hz that a fit leaves are no noise that averaging removes."""
    rng, response = np.random.default_rng(0), clean.response.copy()
    at = [int(np.abs(clean.frequency - line).argmin()) for line in range(50, 4000, 50)]
    turned = np.exp(2j * np.pi * rng.random((2, 21, len(at))))
    response[:, :, at] += 3 * np.median(np.abs(response)) * turned
    with pytest.raises(ValueError, match="most probable cause is mains hum: .* multiples of 50 Hz"):
        check_modes(identify(replace(clean, response=response), 0.1), spoilt.LABELS)


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "-1 times"), (9.81, "9.81 times")])
def test_measurement_that_repeats_nothing_is_refused(clean: FrequencyResponses, factor: float, said: str) -> None:
    """Turned, or in other units: its mean with the first would be that of no beam."""
    other = replace(clean, response=clean.response * factor)
    with pytest.raises(ValueError, match=rf"measurement 2 does not repeat the first: .* {said}; check positions"):
        FrequencyResponses.of_repeats([clean, other])


def test_positions_of_another_scale_or_origin_are_told(clean: FrequencyResponses) -> None:
    """Nodes show where the points lie: 5 % too close to mid-beam, or all 1 mm off; the gains would be 5 % off."""
    assert clean.positions is not None
    inner = replace(clean, response=clean.response[:, 1:-1], positions=clean.positions[1:-1], coherence=None)
    inner = inner.between(100, 20e3)
    for positions, said in (
        (inner.positions / 1.05, r"lie 1\.0[45]\d times as far from mid-beam, so the gains are wrong"),
        (inner.positions - 2e-3, r"lie \+2 mm away, so the gains are wrong"),
    ):
        (told,) = warnings(identify(replace(inner, positions=positions), 0.1))
        assert re.search(said, told)


def test_points_in_other_units_are_named(clean: FrequencyResponses) -> None:
    """A third of the points in mm/s: no noise, which averaging would remove."""
    factor = np.where(np.arange(21) % 3 == 0, 1e3, 1.0)
    found = identify(replace(clean, response=clean.response * factor[:, None], coherence=None), 0.1)
    with pytest.raises(ValueError, match=r"at -50 mm, -35 mm, -20 mm.* are about .* times as large.* same units"):
        check_modes(found, spoilt.LABELS)


def test_wrong_digit_is_named_by_its_value(clean: FrequencyResponses) -> None:
    """Ten times at one bin of one point: neither noise nor a missing mode."""
    response = clean.response.copy()
    response[0, 4, int(np.abs(clean.frequency - 2554).argmin())] *= 10
    (told,) = warnings(identify(replace(clean, response=response), 0.1))
    assert re.search(r"in one value, the response to centre at -30 mm at 255\d\.\d+ Hz: look for a wrong digit", told)


def test_points_read_too_high_in_all_modes_are_told(clean: FrequencyResponses) -> None:
    """One half of the scan 5 % higher, after a change of range: no shape of a mode is like that in every mode."""
    factor = np.where(np.arange(21) < 10, 1.0, 1.05)
    found = identify(replace(clean, response=clean.response * factor[:, None]), 0.1)
    check_modes(found, spoilt.LABELS)
    (told,) = warnings(found)
    assert re.search(r"the points differ by 2\.\d% \(rms\) in all modes alike", told)


@pytest.mark.parametrize("fault", ["conjugated", "late"])
def test_a_point_without_the_modes_of_the_others_is_not_called_inverted(clean: FrequencyResponses, fault: str) -> None:
    """Its phase rises, or it is 50 us late: no factor makes it fit, unlike a sensor that is turned or scaled."""
    response = clean.response.copy()
    late = np.exp(-2j * np.pi * clean.frequency * 50e-6)
    response[:, 7] = response[:, 7].conj() if fault == "conjugated" else response[:, 7] * late
    with pytest.raises(
        ValueError, match=r"of the response at -15 mm is not in the modes .* trigger and the sign of its"
    ):
        identify(replace(clean, response=response), 0.1)


def test_responses_of_which_half_are_conjugated_are_refused(apparatus: Apparatus) -> None:
    """No pole is left within the band for all of them; there was an error of an index instead of a message."""
    frequency, response = spoilt.response_of(true_beam(apparatus, 1798679648))
    response[:, 10:] = response[:, 10:].conj()
    with pytest.raises(ValueError, match="with one sign of the phase|gain and sign of the phase"):
        check_modes(identify(spoilt.measured(frequency, response, 2), 0.1), spoilt.LABELS)


def test_a_point_of_another_beam_is_no_drift(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """One file of another specimen: two close resonances, but the residual is at one point."""
    response = clean.response.copy()
    response[:, 1] = spoilt.response_of(true_beam(apparatus, 7))[1][:, 1]
    told = warnings(identify(replace(clean, response=response), 0.1))
    assert "most of the residual is at -45 mm: check that it is of the same beam" in " ".join(told)
    assert "drift" not in " ".join(told)


def test_a_tone_at_a_resonance_is_no_noise(clean: FrequencyResponses, beam: TrueBeam) -> None:
    """A fan at one frequency, as high as the resonance of mode 3: averaging does not remove it."""
    rng, response = np.random.default_rng(0), clean.response.copy()
    own = beam.table.natural_frequency[beam.table.label.index(3)]
    at = int(np.abs(clean.frequency - own).argmin())
    response[:, :, at] += np.abs(response[:, :, at]).max() * np.exp(2j * np.pi * rng.random((2, 21)))
    with pytest.raises(ValueError, match=r"at one frequency, 255\d\.\d+ Hz: look for a disturbance, such"):
        check_modes(identify(replace(clean, response=response), 0.1), spoilt.LABELS)


@pytest.mark.parametrize("points", [[5], [1, 3, 15], [2, 3, 9, 10, 12, 14, 15, 17]])
def test_points_of_another_beam_are_no_drift(beam: TrueBeam, points: list[int]) -> None:
    """Another specimen of 1 % higher natural frequencies: each point has one of two close resonances alone."""
    higher = replace(beam, table=replace(beam.table, natural_frequency=beam.table.natural_frequency * 1.01))
    frequency, response = spoilt.response_of(beam)
    response[:, points] = spoilt.response_of(higher)[1][:, points]
    found = identify(spoilt.measured(frequency, response, seed=0), 0.1)
    told = " ".join(warnings(found))
    named = ", ".join(f"{5 * point - 50} mm" for point in points)
    assert re.search(rf"the responses at {named} have resonances of their own, (0\.9|1)\S*% higher than those of", told)
    assert "drift" not in told


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("mass", r"the mass of a sensor that is moved: about 0\.00\d+ of the beam's; measure without contact"),
        ("phase", "a phase that differs between the points: keep filters, range"),
        ("late", "a trigger that is late at some points: start all records"),
        ("filter", "a filter that is not listed: give the bandwidth of the vibrometer"),
    ],
)
def test_a_pattern_over_points_and_modes_names_its_cause(
    clean: FrequencyResponses, beam: TrueBeam, fault: str, said: str
) -> None:
    """The fault to first order: no drift of the beam, no nonlinearity, and nothing that averaging would remove."""
    frequency, response, every_other = clean.frequency, clean.response, np.arange(21)[:, None] % 2
    omega = 2 * np.pi * frequency
    if fault == "mass":
        # A mass m at the point of the response divides it by 1 + i w m Y, with the mobility Y there.
        own, ratio = (2 * np.pi * beam.natural_frequency, beam.damping_ratio)
        square = beam.shapes(np.linspace(-0.05, 0.05, 21), 0.0) ** 2
        swing = 1j * omega / (own[:, None] ** 2 - omega**2 + 2j * (ratio * own)[:, None] * omega)
        response = response / (1 + 0.001j * omega * (square.T @ swing))
    elif fault == "phase":
        response = response * np.exp(0.2j * every_other)
    elif fault == "late":
        response = response * np.exp(-5e-7j * omega * every_other)
    else:
        response = response / (1 + 1j * frequency / 20e3) ** 2
    found = identify(replace(clean, frequency=frequency, response=response, coherence=None), 0.1)
    assert re.search(f"the most probable cause is {said}", probable_cause(found))


@pytest.mark.parametrize("noise", [20, 60, 200])
def test_a_point_out_of_focus_is_noisy_and_not_strange(clean: FrequencyResponses, noise: int) -> None:
    """Its response is that of the same beam, under noise: it may stay, and the mark says what to do."""
    rng, response = np.random.default_rng(5), clean.response.copy()
    scatter = rng.standard_normal((2, response.shape[-1])) + 1j * rng.standard_normal((2, response.shape[-1]))
    response[:, 6] += noise * 0.02 * np.median(np.abs(response)) * scatter
    told = " ".join(warnings(identify(replace(clean, response=response, coherence=None), 0.1)))
    assert "most of the residual is at -20 mm: its neighbouring bins differ like noise; check focus" in told
    assert "another beam" not in told
