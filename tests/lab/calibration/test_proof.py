"""Acceptance of a calibration: limits, the cause of each limit that is missed, and the mark."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.lab import calibration as command
from modaltouch.lab.calibration import CalibrationLoop
from modaltouch.lab.calibration.file import CalibrationResult
from modaltouch.lab.calibration.plant import VibrometerDelay, peak_shortfall
from modaltouch.lab.calibration.plausibility import mark_of, refuse_wrong_drive
from modaltouch.preflight import Preflight
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TrueAmplifier
from modaltouch.protocol.calibration import check_mark, examine_calibration
from modaltouch.protocol.sections import CalibrationLimits, Protocol
from modaltouch.protocol.source import Source
from modaltouch.rig.interface import RigError


@pytest.fixture(scope="module")
def outcome(preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable) -> CalibrationResult:
    """The calibration of the shipped twin."""
    return CalibrationLoop(make_bench(shipped_apparatus, 1), shipped_apparatus, preflight.inputs).run()


def spoilt(apparatus: Apparatus, **twin: Any) -> Apparatus:
    """Return an apparatus whose twin departs from a linear, constant rig."""
    amplifier = apparatus.twin.amplifier.model_copy(update={"limit_V": twin.pop("limit_V", None)})
    vibrometer = apparatus.twin.vibrometer.model_copy(update={"dropouts_Hz": twin.pop("dropouts_Hz", 0.0)})
    changed = {**twin, "amplifier": amplifier, "vibrometer": vibrometer}
    return apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update=changed)})


def limited(protocol: Protocol, **limits: float) -> Protocol:
    """Return a protocol with other limits."""
    section = protocol.calibration.model_copy(update={"limits": CalibrationLimits(**limits)})
    return protocol.model_copy(update={"calibration": section})


def test_a_calibration_within_its_limits_has_no_mark(preflight: Preflight, outcome: CalibrationResult) -> None:
    """The shipped twin keeps the default limits of 0.3 mm/s and 1 %, including its uncertainty."""
    assert mark_of(outcome, preflight.experiment.protocol) == {"missed": [], "causes": []}


@pytest.mark.parametrize(
    ("limits", "missed"),
    [
        ({"velocity_mm_s": 0.02}, {"velocity_mm_s"}),
        ({"displacement_mm_s": 0.02}, {"displacement_mm_s", "frequencies_mm_s"}),
        ({"level_percent": 0.01}, {"level_percent"}),
    ],
)
def test_each_limit_of_the_protocol_counts(
    preflight: Preflight, outcome: CalibrationResult, limits: dict[str, float], missed: set[str]
) -> None:
    """A limit below the uncertainty is missed, and the mark has the allowed value."""
    mark = mark_of(outcome, limited(preflight.experiment.protocol, **limits))
    assert {each["limit"] for each in mark["missed"]} == missed
    assert all(each["reached"] > each["allowed"] in limits.values() for each in mark["missed"])
    assert mark["causes"]


def test_nan_misses_every_limit(preflight: Preflight, outcome: CalibrationResult) -> None:
    """A failed fit proves nothing."""
    state = replace(outcome.best.state, velocity=np.full_like(outcome.target, np.nan))
    failed = replace(outcome, best=replace(outcome.best, state=state))
    (first, *_) = mark_of(failed, preflight.experiment.protocol)["missed"]
    assert (first["limit"], first["reached"]) == ("velocity_mm_s", 1e9)


def test_a_change_of_the_sensors_reading_is_reported(preflight: Preflight, outcome: CalibrationResult) -> None:
    """3 % from the second iteration on: the loop would scale the targets, and every level would be 3 % off."""
    first, second, *others = outcome.turns
    assert abs(outcome.reading_change) < 0.002
    read = replace(second, state=replace(second.state, velocity=1.03 * second.state.velocity))
    mark = mark_of(replace(outcome, turns=(first, read, *others)), preflight.experiment.protocol)
    assert [each["limit"] for each in mark["missed"]] == ["reading_percent"]
    assert "all speeds are 1.03" in mark["causes"][0]
    assert "range, angle or focus changed" in mark["causes"][0]


@pytest.mark.parametrize(
    ("departures", "missed", "cause"),
    [
        (
            {"limit_V": 150.0},
            "drive_percent",
            "the amplifier saturates: output 1 is commanded to give 1.. V,.*; lower the highest",
        ),
        (
            {"softening": 0.002},
            "displacement_mm_s",
            "the natural frequencies change with the amplitude: that of mode 1 by -",
        ),
    ],
    ids=["saturation", "softening"],
)
def test_causes_of_missed_limits_are_reported(
    preflight: Preflight,
    shipped_apparatus: Apparatus,
    make_bench: Callable,
    departures: dict[str, float],
    missed: str,
    cause: str,
) -> None:
    """A departure of the twin misses a limit and has one cause with its remedy."""
    bench = make_bench(spoilt(shipped_apparatus, **departures), 0)
    mark = mark_of(CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run(), preflight.experiment.protocol)
    assert missed in {each["limit"] for each in mark["missed"]}
    assert re.match(cause, "".join(mark["causes"]))


@pytest.mark.parametrize(
    ("spot", "factor", "cause"),
    [
        (0.0, 1.05, r"at the focus the beam moves 1\.05 times as fast as the other points predict: the spot"),
        (24.0, 1.05, "the points along the beam disagree: the sensor is loose, its spot is in the wrong place"),
    ],
)
def test_a_wrong_reading_at_one_point_is_reported(
    preflight: Preflight,
    shipped_apparatus: Apparatus,
    make_bench: Callable,
    monkeypatch: pytest.MonkeyPatch,
    spot: float,
    factor: float,
    cause: str,
) -> None:
    """At the focus it would change every level; the interval must contain the truth."""
    bench = make_bench(shipped_apparatus, 1)
    record = bench.record

    def misread(position: float, *rest: Any) -> Any:
        taken = record(position, *rest)
        return replace(taken, velocity=taken.velocity * factor) if abs(position * 1e3 - spot) < 0.01 else taken

    monkeypatch.setattr(bench, "record", misread)
    outcome = CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()
    mark = mark_of(outcome, preflight.experiment.protocol)
    assert re.match(cause, "".join(mark["causes"]))
    for level in outcome.levels:
        true = level.at_focus / (factor if spot == 0 else 1)
        assert abs(level.at_focus - true) <= 1.1 * level.true_half_width


@pytest.mark.parametrize(
    ("spot", "late", "cause"),
    [
        (-24.0, 2e-6, "the points along the beam disagree: .* or a record is late"),
        (0.0, 10e-6, "at the focus the records leave .* uncertain, .* or the records are late"),
    ],
)
def test_late_records_at_one_point_are_not_called_drift(
    preflight: Preflight,
    shipped_apparatus: Apparatus,
    make_bench: Callable,
    monkeypatch: pytest.MonkeyPatch,
    spot: float,
    late: float,
    cause: str,
) -> None:
    """A delay at one point resembles a change of frequency."""
    bench = make_bench(shipped_apparatus, 1)
    record = bench.record

    def delayed(position: float, *rest: Any) -> Any:
        taken = record(position, *rest)
        velocity = np.roll(taken.velocity, round(late * taken.sampling_rate), axis=-1)
        return replace(taken, velocity=velocity) if abs(position * 1e3 - spot) < 0.01 else taken

    monkeypatch.setattr(bench, "record", delayed)
    mark = mark_of(CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run(), preflight.experiment.protocol)
    assert mark["missed"]
    assert re.match(cause, "".join(mark["causes"]))


@pytest.mark.parametrize("late", [-0.3e-6, 0.3e-6])
def test_a_trigger_that_moved_since_the_identification_is_refused(
    preflight: Preflight,
    shipped_apparatus: Apparatus,
    make_bench: Callable,
    monkeypatch: pytest.MonkeyPatch,
    late: float,
) -> None:
    """0.3 us, as with a scope that the drive triggers, leave an error of 0.5 mm/s that no decay reveals."""
    bench = make_bench(shipped_apparatus, 1)
    record = bench.record

    def delayed(position: float, level: float, asked: Any) -> Any:
        # Two records identify amplifier and clock, and eight the modes by each output.
        shift = late if bench.n_records >= 18 else 0.0
        taken = record(position, level, replace(asked, start=asked.start + shift))
        return replace(taken, time=taken.time - shift)

    monkeypatch.setattr(bench, "record", delayed)
    with pytest.raises(
        RigError, match=rf"trigger moved by {re.escape(f'{late * 1e6:+.1f}')}\d us since .*trigger output"
    ):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


def test_an_output_that_is_not_driven_is_neither_exchanged_nor_late() -> None:
    """At it, the scope measures noise alone."""
    predicted = np.stack([np.zeros(4000), 100 * np.sin(np.arange(4000) / 50)])
    noise = np.random.default_rng(0).standard_normal(predicted.shape)
    refuse_wrong_drive(predicted, predicted + noise, 4e-7)


def test_one_bad_record_is_not_called_hysteresis(preflight: Preflight, outcome: CalibrationResult) -> None:
    """Hysteresis keeps the mode shapes; a wrong reading at one point does not."""
    half = outcome.halfway.state
    off = replace(half, velocity=half.velocity * 1.05, disagreement=half.spread + 1e-3)
    mark = mark_of(replace(outcome, halfway=replace(outcome.halfway, state=off)), preflight.experiment.protocol)
    assert mark["causes"][0].startswith("the points along the beam disagree")


def test_drift_is_reported_and_the_best_iteration_kept(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """With 3e-5 per record the last iteration is worse than the one before."""
    bench = make_bench(spoilt(shipped_apparatus, frequency_drift=-3e-5), 0)
    outcome = CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()
    assert outcome.best is min(outcome.turns, key=lambda turn: turn.worst) is not outcome.turns[-1]
    mark = mark_of(outcome, preflight.experiment.protocol)
    assert "frequencies_mm_s" in {each["limit"] for each in mark["missed"]}
    assert re.match(r"the beam drifts: .* mode 1 changed by -0\.001.*steady temperature", "".join(mark["causes"]))


def test_a_rig_as_listed_keeps_its_stimulus(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """Where the first correction follows noise, none is made."""
    exact = dict.fromkeys(("natural_frequency_mismatch", "damping_ratio_mismatch", "gain_mismatch"), 0.0)
    twin = shipped_apparatus.twin.model_copy(
        update={**exact, "generator_gain_mismatch": 0.0, "amplifier": TrueAmplifier()}
    )
    rig = shipped_apparatus.model_copy(update={"twin": twin})
    outcome = CalibrationLoop(make_bench(rig, 2), rig, preflight.inputs).run()
    assert outcome.best is outcome.turns[0]
    assert outcome.refined is rig
    assert np.abs(outcome.correction.velocity - outcome.target).max() < 1e-8


def test_other_causes_are_distinguished_by_the_states(preflight: Preflight, outcome: CalibrationResult) -> None:
    """Nonlinearity, noise and disagreeing points, each simulated in the same calibration."""
    state, protocol = outcome.best.state, preflight.experiment.protocol

    def cause(**changed: Any) -> str:
        best = replace(outcome.best, state=replace(state, **changed))
        turned = replace(outcome, best=best, turns=(*outcome.turns[:-1], best))
        return "".join(mark_of(turned, protocol)["causes"])

    half = replace(outcome.halfway.state, velocity=outcome.halfway.state.velocity * 1.05)
    tilted = replace(outcome, halfway=replace(outcome.halfway, state=half))
    assert mark_of(tilted, protocol)["causes"][0].startswith("the beam is not linear")
    far = state.velocity + 1e-3
    assert cause(spread=state.spread + 1e-4, velocity=far).startswith("the velocity is noisy: the uncertainty is 0.")
    assert cause(disagreement=state.spread + 1e-3, velocity=far).startswith("the points along the beam disagree")
    assert cause(velocity=far).startswith("the records do not show the cause")


@pytest.mark.parametrize(
    ("departures", "message"),
    [
        ({"dropouts_Hz": 20.0}, r"the velocity has gaps or shocks: 0\.\d+% of its samples .*; check that the sensor"),
        (
            {"limit_V": 60.0},
            r"the amplifier saturates: the .* peaks of output 1 are \d\d% below the predicted 1\d\d V",
        ),
        (
            {"hysteresis": 0.4},
            r"at half the level the speed of the modes differs by -\d\.\d% from half: .* hysteresis; bring",
        ),
        ({"frequency_drift": 5e-4}, r"moved by \d+% of its half bandwidth between two mea.* steady temperature"),
        ({"frequency_drift": -1e-4}, r"moved by \d+% of its half bandwidth between two mea.* steady temperature"),
    ],
    ids=["loose sensor", "strong saturation", "strong hysteresis", "drift between probes", "drift after them"],
)
def test_unidentifiable_rigs_are_refused(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable, departures: dict[str, float], message: str
) -> None:
    """With the right cause: drift is not blamed on wiring. Decays that fit no more would have too small an interval."""
    with pytest.raises(RigError, match=message):
        CalibrationLoop(
            make_bench(spoilt(shipped_apparatus, **departures), 0), shipped_apparatus, preflight.inputs
        ).run()


@pytest.mark.parametrize(
    ("departures", "seed", "message"),
    [
        (
            {"limit_V": 30.0},
            323,
            r"the amplifier saturates: the .* peaks of output 1 are \d\d% below the predicted 1\d\d V, allo.* 10%",
        ),
        (
            {"frequency_drift": 1e-4},
            322,
            r"mode 3 near 25\d\d Hz looks like two resonances; the outputs are off; the beam drifts",
        ),
    ],
    ids=["saturated probes", "drift during a probe"],
)
def test_gains_that_differ_have_other_causes_than_wiring(
    preflight: Preflight,
    shipped_apparatus: Apparatus,
    make_bench: Callable,
    departures: dict[str, float],
    seed: int,
    message: str,
) -> None:
    """An amplifier that clips the probes, and a beam that drifts during one, halve the gain of a mode."""
    bench = make_bench(spoilt(shipped_apparatus, **departures), seed)
    with pytest.raises(RigError, match=message):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


@pytest.mark.parametrize("accept", [False, True])
def test_a_calibration_beyond_its_limits_is_written_only_with_accept(
    accept: bool, outcome: CalibrationResult, edit: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the message has limit, cause and remedy; with --accept the file has a mark."""
    limits = "calibration: {limits: {velocity_mm_s: 0.02}}\n\nschedule:"
    protocol = edit("differentiated_stimulation.yaml", ("\nschedule:", f"\n{limits}"))
    monkeypatch.setattr(command, "calibrate_each", lambda *_: {"": outcome})
    out = tmp_path / "c.yaml"
    if not accept:
        with pytest.raises(RigError, match=r"velocity_mm_s 0\.\d+ at 200 mm/s \(allowed 0\.02\).*nothing is.*--accept"):
            command.calibrate(protocol, out, accept=accept)
        assert not out.exists()
        return
    command.calibrate(protocol, out, accept=accept)
    reading = examine_calibration(Source.load(out))
    assert reading.problems == ()
    (problem,) = check_mark(reading)
    assert problem.path == "missed"
    assert problem.line > 1
    assert "--with-marked-calibration" in problem.remedy


def test_a_lack_of_voltage_is_not_called_hysteresis(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """A beam that moves a tenth less per volt needs more voltage than the limit, which is reported."""
    amplifier = shipped_apparatus.amplifier.model_copy(update={"limit_V": 195.0})
    weaker = shipped_apparatus.twin.amplifier.model_copy(update={"gain_V_per_V": 0.9 * amplifier.gain_V_per_V})
    rig = shipped_apparatus.model_copy(
        update={"amplifier": amplifier, "twin": shipped_apparatus.twin.model_copy(update={"amplifier": weaker})}
    )
    modes = tuple(
        mode.model_copy(update={"gain_mm_s2_per_V": {k: 0.9 * v for k, v in mode.gain_mm_s2_per_V.items()}})
        for mode in rig.modes
    )
    bench = make_bench(rig.model_copy(update={"modes": modes}), 0)
    with pytest.raises(RigError, match=r"200 mm/s needs \d+ V at the beam on this rig: allowed at most 195 V"):
        CalibrationLoop(bench, rig, preflight.inputs).run()


def test_clipped_peaks_are_distinguished_from_a_gain() -> None:
    """A drive of 1.1 times the prediction lacks no peaks; one clipped at 90 % of its peak does."""
    time = np.linspace(0, 1, 5000)
    wave = np.stack([np.sin(40 * time) * time, 0.1 * time])
    assert peak_shortfall(wave, 1.1 * wave) == pytest.approx([0, 0], abs=1e-12)
    lacking = peak_shortfall(wave, np.clip(wave, -0.9 * np.abs(wave).max(), 0.9 * np.abs(wave).max()))
    assert 0.02 < lacking[0] < 0.1
    assert lacking[1] == 0


def test_an_uncertain_lag_makes_high_modes_uncertain() -> None:
    """Delay and lag exchanged by 0.1 us: the phase is the same, but a mode at 88 kHz changes by some per cent."""
    covariance = 1e-14 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    lag = VibrometerDelay(4e-6, 0.64e-6, 0.0, covariance)
    pole = 2j * np.pi * np.array([229.0, 87855.0])
    low, high = lag.spread(pole)
    other = VibrometerDelay(3.9e-6, 0.74e-6, 0.0)
    assert high == pytest.approx(np.abs(lag.response(pole) / other.response(pole) - 1)[1], rel=0.1)
    assert 0.01 < high < 0.04
    assert low < 1e-6
