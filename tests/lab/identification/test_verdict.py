"""Verdicts on faulty measurements: the fault, its place and the remedy, or a mark in the result."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import spoilt
from scipy.signal import butter, fftconvolve, freqs

from modaltouch.lab.identification.command import check_gains
from modaltouch.lab.identification.files import ResponseFormat, read_responses
from modaltouch.lab.identification.joint_fit import axis_error, identify
from modaltouch.lab.identification.responses import FrequencyResponses, Place
from modaltouch.lab.identification.shapes import in_two_units
from modaltouch.lab.identification.verdict import _hum, check_modes, misfit_verdict, probable_cause, warnings
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator.true_beam import TrueBeam, true_beam
from modaltouch.stimulus import mode_shapes


def measured(beam: TrueBeam, **fault: float) -> FrequencyResponses:
    """Return responses of the lower modes with the noise of a good measurement."""
    return spoilt.measured(*spoilt.response_of(beam, **fault), seed=0).between(1200, 9400)


@pytest.fixture(scope="module")
def clean(beam: TrueBeam) -> FrequencyResponses:
    """Return responses without a fault."""
    return spoilt.measured(*spoilt.response_of(beam), seed=0)


def test_clean_responses_have_no_mark(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Only noise remains, without warnings, and the misfit's verdict says so."""
    found = identify(clean, 0.1)
    check_modes(found, spoilt.LABELS)
    check_gains(found, apparatus)
    assert warnings(found) == []
    assert misfit_verdict(found).startswith("misfit 0.9") or misfit_verdict(found).startswith("misfit 1")
    assert "the noise alone" in misfit_verdict(found)


def test_the_noise_of_an_accelerometer_is_no_misfit(beam: TrueBeam) -> None:
    """A single record has no coherence, and its white noise of acceleration falls with frequency as a velocity."""
    frequency, response = spoilt.response_of(beam)
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
    response = response + 0.02 * np.median(np.abs(response)) * noise * 300 / frequency
    places = np.linspace(-0.05, 0.05, spoilt.N_POINTS)
    found = identify(FrequencyResponses(frequency, response, places, ("centre", "side"), bandwidth=250e3), 0.1)
    check_modes(found, spoilt.LABELS)
    assert warnings(found) == []


@pytest.mark.parametrize(("factor", "message"), [(-1.0, "inverted"), (9.81, r"9\.\d+ times too large"), (0.0, "zero")])
def test_an_odd_point_is_reported_and_may_be_excluded(clean: FrequencyResponses, factor: float, message: str) -> None:
    """The point at -35 mm with its factor and the option; without it the others are fitted."""
    response = clean.response.copy()
    response[:, 3] *= factor
    odd = replace(clean, response=response)
    with pytest.raises(ValueError, match=rf"the response at -35 mm is {message} compared with.* --leave-out -35$"):
        identify(odd, 0.1, most=0)
    mended = odd.without([-0.035])
    assert mended.n_points == 20
    assert mended.marks == ("the responses at -35 mm were left out",)
    with pytest.raises(ValueError, match="--leave-out 1 is not a measured position; allowed: -50, -45"):
        odd.without([0.001])


@pytest.mark.parametrize("factor", [9.80665, 1e-3])
def test_several_points_in_another_unit_are_reported_together(clean: FrequencyResponses, factor: float) -> None:
    """Excluding only the worst would leave the others wrong."""
    response, some = clean.response.copy(), [2, 3, 9, 20]
    response[:, some] *= factor
    larger = some if factor > 1 else sorted({*range(21)} - {*some})
    named = ", ".join(f"{5 * point - 50} mm" for point in larger)
    with pytest.raises(
        ValueError, match=rf"the responses at {named} are about .* check whether all points have the sam"
    ):
        check_modes(identify(replace(clean, response=response), 0.1, most=0), spoilt.LABELS)


@pytest.mark.parametrize("n_points", [1, 2, 3, 4])
def test_few_points_are_not_reported_as_two_units(n_points: int) -> None:
    """One of three points may just as well be odd."""
    places = [Place(x) for x in np.linspace(-0.05, 0.05, n_points)]
    shapes = np.ones((3, n_points))
    shapes[:, : n_points // 2] = 100.0
    assert bool(in_two_units(shapes, places, 0.1)) == (n_points == 4)


@pytest.mark.parametrize("fault", ["elsewhere", "exchanged", "too small"])
def test_gains_have_wide_intervals_if_points_are_misplaced(
    beam: TrueBeam, clean: FrequencyResponses, fault: str
) -> None:
    """Misplaced by 0.3 mm, exchanged, or scaled by 0.85: errors of up to 2 % within twice the half-width."""
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


def test_one_set_inverted_at_a_point_is_reported(clean: FrequencyResponses) -> None:
    """With the set and the position."""
    response = clean.response.copy()
    response[1, 17] *= -1
    with pytest.raises(ValueError, match="the response to side at 35 mm is inverted"):
        identify(replace(clean, response=response), 0.1, most=0)


def test_a_nonlinear_beam_is_marked_or_refused(beam: TrueBeam) -> None:
    """Modes that fall by 0.1 or three half-bandwidths at their peak."""
    found = identify(measured(beam, softening=0.1), 0.1)
    assert any("most probable cause is nonlinearity: drive at half the voltage" in mark for mark in warnings(found))
    found = identify(measured(beam, softening=3.0), 0.1)
    with pytest.raises(ValueError, match=r"(?s)the residual is .*, at most 10% is allowed.*nonlinearity"):
        check_modes(found, (3, 5))


def test_a_beam_that_drifts_in_a_scan_is_marked(beam: TrueBeam) -> None:
    """Half a thousandth leaves a residual that grows along the beam; two thousandths split modes."""
    found = identify(spoilt.measured(*spoilt.response_of(beam, drift=5e-4), seed=1), 0.1)
    assert any("drift: let the beam warm up" in mark for mark in warnings(found))
    found = identify(measured(beam, drift=2e-3), 0.1)
    assert any("like a single mode that moved: the most probable cause is drift" in mark for mark in warnings(found))


def test_bending_beside_torsion_is_not_called_drift(clean: FrequencyResponses) -> None:
    """Mode 10 and the third torsion mode lie within one width; the residual of a wrong digit is elsewhere."""
    response = clean.response.copy()
    response[0, 4, int(np.abs(clean.frequency - 2554).argmin())] *= 10
    found = identify(replace(clean, response=response), 0.1)
    ten, torsion = found.by_label[10], min(found.modes, key=lambda each: abs(each.natural_frequency.value - 26900))
    assert torsion.label is None
    assert torsion.natural_frequency.value - ten.natural_frequency.value < 2 * 26200 * ten.damping_ratio.value
    assert warnings(found)
    assert not any("within one width" in mark for mark in warnings(found))


def test_wrong_units_of_the_gains_are_reported(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Accelerations in g, one differentiation too many, and one output with a 10 : 1 probe."""
    turn = 2 * np.pi * clean.frequency
    small = identify(replace(clean, response=clean.response / 9.80665), 0.1, most=0)
    with pytest.raises(
        ValueError, match=r"the gains of centre and side are 0\.10. times those of beam_100x6x2: an acceleration in g"
    ):
        check_gains(small, apparatus)
    steep = identify(replace(clean, response=clean.response * turn), 0.1)
    with pytest.raises(
        ValueError, match=r"the gains of .* are .* times 2 pi f times those of .*: the motion is not the quantity"
    ):
        check_gains(steep, apparatus)
    probed = identify(replace(clean, response=clean.response * np.array([1.0, 10.0])[:, None, None]), 0.1, most=0)
    with pytest.raises(ValueError, match=r"the gains of side are (9|10).* times those of .* or a 10 : 1 probe"):
        check_gains(probed, apparatus)


def test_thousandfold_gains_are_reported_with_a_rough_table(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Velocities in mm/s taken for m/s, although the listed gains are 30 % off."""
    modes = []
    for k, mode in enumerate(apparatus.modes):
        gains = {name: value * 1.3 ** (-1) ** k for name, value in mode.gain_mm_s2_per_V.items()}
        modes.append(mode.model_copy(update={"gain_mm_s2_per_V": gains}))
    found = identify(replace(clean, response=clean.response * 1e3), 0.1, most=0)
    with pytest.raises(ValueError, match="times those of beam_100x6x2: a prefix, milli or kilo, was missed"):
        check_gains(found, apparatus.model_copy(update={"modes": tuple(modes)}))


def test_angular_frequencies_are_reported(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """With an axis in rad/s all natural frequencies are 2 pi times the listed ones."""
    found = identify(replace(clean, frequency=clean.frequency * 2 * np.pi, bandwidth=None), 0.1, most=0)
    with pytest.raises(ValueError, match=r"the natural frequencies are 6\.28 times those of .*: angular frequencies"):
        check_gains(found, apparatus)


def test_exchanged_points_are_told_among_the_remedies(clean: FrequencyResponses) -> None:
    """Two distant points exchanged: clear resonances without a mode's shape."""
    order = [*range(21)]
    order[3], order[12] = 12, 3
    found = identify(replace(clean, response=clean.response[:, order]), 0.1)
    with pytest.raises(
        ValueError, match=r"no resonance has its mode shape; .* check positions and signs of the points, or name"
    ):
        check_modes(found, spoilt.LABELS)


def test_modes_split_by_drift_are_not_called_exchanged_points(apparatus: Apparatus) -> None:
    """Cases 322 and 33 of `make spoilt`: each missing mode is two resonances, and torsion takes the labels left."""
    assert spoilt.outcome("drift", 322, apparatus)["right"]
    assert spoilt.outcome("drift", 33, apparatus)["right"]


def test_low_coherence_over_the_band_is_reported(beam: TrueBeam) -> None:
    """A median of 0.2, although every peak is visible."""
    found = identify(spoilt.measured(*spoilt.response_of(beam), seed=0, noise=50.0), 0.1, most=0)
    assert any("the median coherence over the band is 0." in mark and "below 0.5" in mark for mark in warnings(found))


def test_few_averages_are_not_called_nonlinearity(tmp_path: Path) -> None:
    """The noise of leakage peaks with the responses: four Hann windows of a random drive."""
    rng, rate = np.random.default_rng(2), 11e3
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


def test_drift_explains_only_missing_modes_nearby(clean: FrequencyResponses) -> None:
    """A split of mode 5 does not explain that mode 13, above the band, is missing."""
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


def test_values_far_from_the_listed_ones_are_marked(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """The table may be wrong, so they are not refused: generator volts, an inverted set, a wrong sampling rate."""
    assert check_gains(identify(clean, 0.1, most=0), apparatus, spoilt.LABELS) == []
    for factor, message in (
        (25.0, r"2\d\.\d for every mode by centre.*check units"),
        (-1.0, r"-[01]\S* for every mode by centre"),
    ):
        other = identify(replace(clean, response=clean.response * factor), 0.1, most=0)
        (mark,) = check_gains(other, apparatus, spoilt.LABELS)
        assert re.search(f"gains, times those listed: .*{message}", mark)
    other = identify(replace(clean, frequency=clean.frequency * 1.1), 0.1, most=0)
    (mark,) = check_gains(other, apparatus, spoilt.LABELS)
    assert mark.startswith("natural frequencies, times those listed: 1.1 for mode 1")


@pytest.mark.parametrize("factor", [0.5, 1.4])
def test_a_set_of_another_scale_is_marked(clean: FrequencyResponses, apparatus: Apparatus, factor: float) -> None:
    """A probe or gain set for one output: no beam changes the gains of all modes alike."""
    found = identify(replace(clean, response=clean.response * np.array([1.0, factor])[:, None, None]), 0.1, most=0)
    (mark,) = check_gains(found, apparatus, spoilt.LABELS)
    value = re.fullmatch(r"gains, times those listed: (\S+) for every mode by side; check units, .*", mark)
    assert value is not None
    assert float(value[1]) == pytest.approx(factor, rel=0.06)


@pytest.mark.parametrize("has_coherence", [True, False])
@pytest.mark.parametrize(("n_bins", "message"), [(0, ""), (1, "too high"), (-2, "too low")])
def test_an_axis_that_is_a_bin_off_is_marked(
    clean: FrequencyResponses, n_bins: int, message: str, has_coherence: bool
) -> None:
    """Found to 3.8 Hz from the values off resonance, since 0 Hz is fixed."""
    moved = replace(clean, frequency=clean.frequency + n_bins * clean.spacing)
    moved = moved if has_coherence else replace(moved, coherence=None, n_averages=1)
    mark = axis_error(identify(moved, 0.1))
    assert (
        mark == ""
        if not message
        else f"are at least one bin, 3.815 Hz, {message}, judging by the values off res" in mark
    )


def test_one_set_that_is_a_bin_off_is_named(beam: TrueBeam) -> None:
    """The axis of one actuator set is a bin too high, which a beam that drifted between the sets resembles."""
    frequency, response = spoilt.response_of(beam)
    response[1] = np.roll(response[1], 1, axis=-1)
    found = identify(spoilt.measured(frequency, response, seed=0).between(100, 9400), 0.1)
    assert re.search("of side .* higher than others|of centre .* lower than others", axis_error(found))


def test_exchanged_sets_are_not_called_wrong_units(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """The gains of centre are then a tenth, as with a 10 : 1 probe."""
    found = identify(replace(clean, response=clean.response[::-1]), 0.1, most=0)
    with pytest.raises(ValueError, match="the sets are exchanged: the files hold the gains of side under the name cen"):
        check_gains(found, apparatus)


def test_a_wrong_unit_is_not_called_exchanged_sets(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Each set moves the other's modes by a tenth; times g, these resemble the other's gains."""
    found = identify(replace(clean, response=9.80665 * clean.response), 0.1, most=0)
    with pytest.raises(ValueError, match="times those of .*an acceleration in g was taken for m/s.2"):
        check_gains(found, apparatus)


@pytest.mark.parametrize("drift", [1.004, 1.008])
def test_drift_between_sets_is_reported(clean: FrequencyResponses, beam: TrueBeam, drift: float) -> None:
    """Two well-fitted resonances of one shape: only noise remains, but the gains are wrong."""
    later = replace(beam.table, natural_frequency=beam.table.natural_frequency * drift)
    response = clean.response.copy()
    response[1] = spoilt.measured(*spoilt.response_of(replace(beam, table=later)), seed=0).response[1]
    marks = warnings(identify(replace(clean, response=response), 0.1))
    assert any("like a single mode that moved: the most probable cause is drift" in each for each in marks)


@pytest.mark.parametrize(("highest", "delay", "named"), [(33e3, 50e-6, r"0\.0[45]"), (6e3, 100e-6, r"0\.(09|10)")])
def test_sets_with_different_delays_are_reported(
    clean: FrequencyResponses, highest: float, delay: float, named: str
) -> None:
    """A late trigger for one set is not a nonlinearity, even if it is late by half a cycle over the band."""
    some = clean.between(50, highest)
    late = some.response * np.exp(-2j * np.pi * some.frequency * np.array([0, delay])[:, None, None])
    with pytest.raises(ValueError, match=rf"differs between the sets \(centre 0 ms, side {named}\d* ms\): .* trigger"):
        identify(replace(some, response=late), 0.1)


def test_exchanged_real_and_imaginary_parts_are_reported(clean: FrequencyResponses) -> None:
    """`--conjugated` would not help."""
    with pytest.raises(ValueError, match="real and imaginary parts are exchanged; export them again"):
        identify(replace(clean, response=clean.response.imag + 1j * clean.response.real), 0.1)


def test_mains_hum_is_reported(clean: FrequencyResponses) -> None:
    """Residual lines at multiples of 50 Hz, which averaging does not remove."""
    rng, response = np.random.default_rng(0), clean.response.copy()
    at = [int(np.abs(clean.frequency - line).argmin()) for line in range(50, 4000, 50)]
    turned = np.exp(2j * np.pi * rng.random((2, 21, len(at))))
    response[:, :, at] += 3 * np.median(np.abs(response)) * turned
    with pytest.raises(ValueError, match="most probable cause is mains hum: .* multiples of 50 Hz"):
        check_modes(identify(replace(clean, response=response), 0.1), spoilt.LABELS)


def test_noise_alone_is_not_called_hum(beam: TrueBeam) -> None:
    """Far below the noise, the excess at multiples of 50 Hz is chance."""
    found = identify(spoilt.measured(*spoilt.response_of(beam), seed=0, noise=60.0).between(1200, 9400), 0.1)
    assert _hum(found) == ""
    assert not re.search("drift|nonlinearity|phase", " ".join(warnings(found)))


@pytest.mark.parametrize(("factor", "message"), [(-1.0, "-1 times"), (9.81, "9.81 times")])
def test_a_measurement_that_does_not_repeat_the_first_is_refused(
    clean: FrequencyResponses, factor: float, message: str
) -> None:
    """Inverted or in other units, their mean would be meaningless."""
    other = replace(clean, response=clean.response * factor)
    with pytest.raises(ValueError, match=rf"measurement 2 does not repeat the first: .* {message}; check positions"):
        FrequencyResponses.of_repeats([clean, other])


def test_a_mirrored_scan_is_reported(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """All antisymmetric modes change sign; neither wiring nor sensor does that."""
    extra = [{"label": label, "natural_frequency_Hz": own, "damping_ratio": 0.02, "gain_mm_s2_per_V": {"side": gain}}
             for label, own, gain in ((2, 310, -5), (4, 4550, 80), (6, 9800, -300), (8, 17300, 400))]  # fmt: skip
    modes = (*apparatus.modes, *(type(apparatus.modes[0]).model_validate(each) for each in extra))
    listed = apparatus.model_copy(update={"modes": modes})
    found = identify(replace(clean, response=clean.response[:, ::-1]), 0.1, most=0)
    (told,) = check_gains(found, listed)
    assert "the gains of all antisymmetric modes have the opposite sign" in told
    assert check_gains(identify(clean, 0.1, most=0), listed) == []


def test_positions_of_wrong_scale_or_origin_are_marked(clean: FrequencyResponses) -> None:
    """Nodes show it: 5 % too close to mid-beam, or all shifted; the gains would be 5 % off."""
    assert clean.positions is not None
    inner = replace(clean, response=clean.response[:, 1:-1], positions=clean.positions[1:-1], coherence=None)
    inner = inner.between(100, 20e3)
    for positions, message in (
        (inner.positions / 1.05, r"lie 1\.0[45]\d times as far from mid-beam, so the gains are wrong"),
        (inner.positions - 2e-3, r"lie \+2 mm away, so the gains are wrong"),
    ):
        (mark,) = warnings(identify(replace(inner, positions=positions), 0.1))
        assert re.search(message, mark)


def test_a_wrong_digit_is_reported_with_its_value(clean: FrequencyResponses) -> None:
    """Ten times too large in one bin of one point: neither noise nor a missing mode."""
    response = clean.response.copy()
    response[0, 4, int(np.abs(clean.frequency - 2554).argmin())] *= 10
    (mark,) = warnings(identify(replace(clean, response=response), 0.1))
    assert re.search(r"in one value, the response to centre at -30 mm at 255\d\.\d+ Hz: look for a wrong digit", mark)


def test_points_too_high_in_all_modes_are_marked(clean: FrequencyResponses) -> None:
    """Half of the scan reads 5 % high after a change of range, which no mode shape explains."""
    factor = np.where(np.arange(21) < 10, 1.0, 1.05)
    found = identify(replace(clean, response=clean.response * factor[:, None]), 0.1)
    check_modes(found, spoilt.LABELS)
    (mark,) = warnings(found)
    assert re.search(r"the points differ by 2\.\d% \(rms\) in all modes alike", mark)


@pytest.mark.parametrize("fault", ["conjugated", "late"])
def test_a_point_without_the_modes_of_the_others_is_not_called_inverted(clean: FrequencyResponses, fault: str) -> None:
    """A conjugated or late response is not the modes times a factor."""
    response = clean.response.copy()
    late = np.exp(-2j * np.pi * clean.frequency * 50e-6)
    response[:, 7] = response[:, 7].conj() if fault == "conjugated" else response[:, 7] * late
    said = {
        "conjugated": r"of the response at -15 mm is not in the modes .* trigger of the .* the sign of its",
        "late": r"the delay .* differs between the points \(-15 mm 0.05\d* ms\): start all records",
    }
    with pytest.raises(ValueError, match=said[fault]):
        identify(replace(clean, response=response), 0.1)


def test_half_conjugated_responses_are_refused(apparatus: Apparatus) -> None:
    """With a message instead of an index error, since no common pole remains in the band."""
    frequency, response = spoilt.response_of(true_beam(apparatus, 1798679648))
    response[:, 10:] = response[:, 10:].conj()
    with pytest.raises(ValueError, match="with one sign of the phase|gain and sign of the phase"):
        check_modes(identify(spoilt.measured(frequency, response, 2), 0.1), spoilt.LABELS)


def test_a_point_of_another_beam_is_not_called_drift(clean: FrequencyResponses, apparatus: Apparatus) -> None:
    """Two close resonances, but the residual is at one point."""
    response = clean.response.copy()
    response[:, 1] = spoilt.response_of(true_beam(apparatus, 7))[1][:, 1]
    marks = warnings(identify(replace(clean, response=response), 0.1))
    assert "most of the residual is at -45 mm: check that it is of the same beam" in " ".join(marks)
    assert "drift" not in " ".join(marks)


def test_a_point_of_a_beam_almost_alike_is_named(beam: TrueBeam) -> None:
    """Its lowest mode is one width away: the two resonances are not one that drifted, since one is at one point."""
    frequency, response = spoilt.response_of(beam)
    lower = SimpleNamespace(
        natural_frequency=0.96 * beam.natural_frequency,
        damping_ratio=beam.damping_ratio,
        modal_gain=beam.modal_gain,
        shapes=beam.shapes,
    )
    _, other = spoilt.response_of(lower)
    response[:, 6] = other[:, 6]
    found = identify(spoilt.measured(frequency, response, seed=0).between(100, 9400), 0.1)
    said = " ".join(warnings(found))
    assert "only the point at -20 mm shows the resonance at" in said
    assert "drift" not in said


def test_a_tone_at_a_resonance_is_not_called_noise(clean: FrequencyResponses, beam: TrueBeam) -> None:
    """As high as the resonance of mode 3; averaging does not remove it."""
    rng, response = np.random.default_rng(0), clean.response.copy()
    own = beam.table.natural_frequency[beam.table.label.index(3)]
    at = int(np.abs(clean.frequency - own).argmin())
    response[:, :, at] += np.abs(response[:, :, at]).max() * np.exp(2j * np.pi * rng.random((2, 21)))
    with pytest.raises(ValueError, match=r"at one frequency, 255\d\.\d+ Hz: look for a disturbance, such"):
        check_modes(identify(replace(clean, response=response), 0.1), spoilt.LABELS)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (
            "phase",
            "a phase that differs between points or sets: start all records at their excitation",
        ),
        (
            "late",
            "a phase that differs between points or sets: start all records at their excitation",
        ),
        ("high-pass", "a filter or window that is not listed: give the bandwidth of the vibrometer"),
        ("window", "a filter or window that is not listed: give the bandwidth of the vibrometer"),
        ("filter", "a filter or window that is not listed: give the bandwidth of the vibrometer"),
    ],
)
def test_the_pattern_of_the_residual_gives_its_cause(clean: FrequencyResponses, fault: str, message: str) -> None:
    """Over points and modes, to first order in the fault: not drift, nonlinearity or noise."""
    frequency, response, every_other = clean.frequency, clean.response, np.arange(21)[:, None] % 2
    omega = 2 * np.pi * frequency
    if fault == "phase":
        response = response * np.exp(0.2j * every_other)
    elif fault == "late":
        response = response * np.exp(-5e-7j * omega * every_other)
    elif fault == "high-pass":
        response = response / (1 - 20j / frequency)
    elif fault == "window":
        # Both records were multiplied by exp(-300 t).
        response = response * (1 - 300j / omega)
    else:
        response = response / (1 + 1j * frequency / 20e3) ** 2
    found = identify(replace(clean, frequency=frequency, response=response, coherence=None), 0.1)
    assert re.search(f"the most probable cause is {message}", probable_cause(found))


def test_a_filter_is_not_called_a_delay_between_the_sets(make: Callable[..., FrequencyResponses]) -> None:
    """A Butterworth low-pass of 4th order at 30 kHz delays by another amount at each frequency, but all sets alike."""
    responses = make(0, n_points=21)
    low_pass = freqs(*butter(4, 2 * np.pi * 30e3, analog=True), 2 * np.pi * responses.frequency)[1]
    assert replace(responses, response=responses.response * low_pass).aligned().offset < 30e-6


@pytest.mark.parametrize("noise", [20, 200])
def test_a_point_out_of_focus_is_reported(clean: FrequencyResponses, noise: int) -> None:
    """It may stay; the mark has the remedy."""
    rng, response = np.random.default_rng(5), clean.response.copy()
    scatter = rng.standard_normal((2, response.shape[-1])) + 1j * rng.standard_normal((2, response.shape[-1]))
    response[:, 6] += noise * 0.02 * np.median(np.abs(response)) * scatter
    marks = " ".join(warnings(identify(replace(clean, response=response, coherence=None), 0.1)))
    assert "most of the residual is at -20 mm: check that it is of the same beam, the fastening, focus and tr" in marks
