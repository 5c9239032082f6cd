"""Implausible measurements that a calibration refuses, each with its cause and remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.lab.calibration import CalibrationLoop
from modaltouch.lab.calibration.file import corrected_inputs
from modaltouch.lab.calibration.plausibility import mark_of
from modaltouch.preflight import Preflight
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TrueAmplifier, UnlistedMode, Vibrometer
from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, Recording


class Spoilt:
    """A bench whose recordings are altered."""

    def __init__(self, bench, change: Callable[[Recording], Recording]) -> None:
        self.load, self.progress = bench.load, bench.progress
        self._bench = bench
        self._change = change

    def record(self, position: float, velocity: float, acquisition: Acquisition) -> Recording:
        return self._change(self._bench.record(position, velocity, acquisition))


def changed(**factors: float) -> Callable[[Recording], Recording]:
    """Return a function that multiplies velocity or drive."""

    def change(recording: Recording) -> Recording:
        return replace(recording, **{name: getattr(recording, name) * factor for name, factor in factors.items()})

    return change


def exchanged(recording: Recording) -> Recording:
    """Exchange the drives."""
    return replace(recording, drive=recording.drive[:, ::-1])


def humming(size: float) -> Callable[[Recording], Recording]:
    """Return a function that adds 50 Hz and multiples to the velocity, with random phases per record [m/s]."""
    rng = np.random.default_rng(0)

    def change(recording: Recording) -> Recording:
        turns = 2 * np.pi * (50 * recording.time + rng.random((len(recording.velocity), 1)))
        tones = sum(np.cos(order * turns) / order for order in (1, 2, 3, 5))
        return replace(recording, velocity=recording.velocity + size * tones)

    return change


def whistling(size: float, *, locked: bool) -> Callable[[Recording], Recording]:
    """Return a function that adds a tone of 13.7 kHz, with one phase for all records or random phases [m/s]."""
    rng = np.random.default_rng(0)

    def change(recording: Recording) -> Recording:
        phase = 0.0 if locked else 2 * np.pi * rng.random((len(recording.velocity), 1))
        tone = size * np.cos(2 * np.pi * 13.7e3 * recording.time + phase)
        return replace(recording, velocity=recording.velocity + tone)

    return change


def inverted_at(place: float) -> Callable[[Recording], Recording]:
    """Return a function that inverts the velocity at one position."""

    def change(recording: Recording) -> Recording:
        sign = -1.0 if np.isclose(recording.position, place) else 1.0
        return replace(recording, velocity=sign * recording.velocity)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed(velocity=0.0), r"mode 1 at 229 Hz is not seen: it rises above the noise by 0\.0 standard errors"),
        (changed(velocity=-1.0), r"every mode moves against the sign of its listed gain"),
        (
            changed(velocity=1.3),
            r"the modes move 1\.[23]\d times as fast .* allowed 0\.85 to 1\.15; .*sensitivity_mm_s_per_V",
        ),
        (humming(1e-4), r"holds a tone near 5\d Hz that does not decay .* mains hum"),
        (humming(2e-2), r"differs from burst to burst: .* mains hum nor another disturbance"),
        (
            whistling(1e-3, locked=True),
            r"holds a tone near 1370\d Hz that does not decay .* above, a disturbance, such as a f",
        ),
        (whistling(3e-2, locked=False), r"differs from burst to burst: .* mains hum nor another disturbance"),
        (
            inverted_at(-0.002),
            r"at -2 mm the modes move -\d\.\d\d times as fast as the other points predict: .* its sign",
        ),
        (exchanged, r"the drive measured for each output is that of another: the probes are exchanged"),
        (changed(drive=0.1), r"the drive measured at the beam is 0\.10 times what output 1 commands: allowed 0\.67"),
        (changed(drive=-1.0), r"is -\d\.\d\d times what output 1 .* the probe is at its output and not inverted"),
        (changed(drive=0.0), r"the drive measured at the beam is 0\.00 times what output 1 commands"),
    ],
    ids=[
        "dead vibrometer",
        "inverted vibrometer",
        "wrong sensitivity",
        "hum",
        "strong hum",
        "tone in step with the bursts",
        "tone",
        "a point inverted",
        "exchanged probes",
        "wrong probe",
        "inverted probe",
        "no drive",
    ],
)
def test_faults_of_a_rig_are_reported(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable, change: Callable, message: str
) -> None:
    """Before anything is corrected."""
    bench = Spoilt(make_bench(shipped_apparatus, 1), change)
    with pytest.raises(RigError, match=message):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


def test_a_disturbed_drive_is_reported(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """The drive probe picks up a disturbance."""

    def hum(recording: Recording) -> Recording:
        drive = recording.drive + 20 * np.sin(2 * np.pi * 31e3 * recording.time)
        return replace(recording, drive=drive)

    bench = Spoilt(make_bench(shipped_apparatus, 1), hum)
    with pytest.raises(RigError, match=r"\d+% of the drive measured at the beam is not the commanded drive"):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


def test_a_late_vibrometer_is_reported(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """With 45 us the records would begin before its signal."""
    late = shipped_apparatus.twin.model_copy(update={"vibrometer": Vibrometer(delay_us=45.0)})
    bench = make_bench(shipped_apparatus.model_copy(update={"twin": late}), 1)
    with pytest.raises(RigError, match=r"the vibrometer is 4\d us late"):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


def test_a_tripped_amplifier_is_reported(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """Nothing reaches the beam."""
    bench = make_bench(shipped_apparatus, 1)
    bench.twin.tripped = True
    with pytest.raises(RigError, match="check that the amplifier is on"):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


def test_another_beam_is_reported(preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable) -> None:
    """Every natural frequency is 7 % higher than listed."""
    higher = tuple(
        mode.model_copy(update={"natural_frequency_Hz": 1.07 * mode.natural_frequency_Hz})
        for mode in shipped_apparatus.modes
    )
    bench = make_bench(shipped_apparatus.model_copy(update={"modes": higher}), 1)
    with pytest.raises(RigError, match=r"mode \d+ .*; the outputs are off"):
        CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run()


def test_a_wrong_gain_next_to_a_mode_that_is_not_listed_is_no_drift(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """Two resonances share the gain: one that is three times the listed gain does not come from them."""
    near = UnlistedMode(
        family="torsion", label=1, natural_frequency_Hz=7350, damping_ratio=0.012, gain_mm_s2_per_V={"side": 900}
    )
    others = [mode for mode in shipped_apparatus.twin.unlisted_modes if (mode.family, mode.label) != ("torsion", 1)]
    twin = shipped_apparatus.twin.model_copy(update={"unlisted_modes": (*others, near)})
    bench = make_bench(shipped_apparatus.model_copy(update={"twin": twin}), 1)
    modes = tuple(
        mode.model_copy(update={"gain_mm_s2_per_V": mode.gain_mm_s2_per_V | {"side": 2100.0}})
        if mode.label == 5
        else mode
        for mode in shipped_apparatus.modes
    )
    listed = shipped_apparatus.model_copy(update={"modes": modes})
    with pytest.raises(RigError, match="the gain of mode 5 by output 2 is 6.* but 2100 is listed: allowed 0.4 to 2.5"):
        CalibrationLoop(bench, listed, replace(preflight.inputs, apparatus=listed)).run()


def test_too_small_a_range_is_reported(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """A vibrometer set to 100 mm/s cannot measure 200 mm/s."""
    small = shipped_apparatus.model_copy(
        update={"acquisition": shipped_apparatus.acquisition.model_copy(update={"range_mm_s": 100.0})}
    )
    bench = make_bench(small, 1)
    with pytest.raises(
        RigError,
        match=r"velocity is overloaded at .* in the widest range, with up to .*; the outputs are off; choose a wider",
    ):
        CalibrationLoop(bench, small, preflight.inputs).run()


def test_a_sensitivity_error_of_half_a_percent_is_within_the_interval(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable
) -> None:
    """The error of 0.29 mm/s in a mode of 59 mm/s is within the stated interval, and the limits hold.

    By default a vibrometer's sensitivity is known to 1 %, as in data sheets.
    """
    assert shipped_apparatus.acquisition.sensitivity_uncertainty_percent == 1.0
    bench = make_bench(shipped_apparatus, 1)
    outcome = CalibrationLoop(Spoilt(bench, changed(velocity=0.995)), shipped_apparatus, preflight.inputs).run()
    correction = replace(outcome.correction, corrections=())
    played = design_to_fit(corrected_inputs(preflight.inputs, outcome.refined, correction), release="free")
    true = bench.true_state(played.burst, played.target_field.velocity, played.timing.focusing_instant)
    state, (*_, level) = outcome.best.state, outcome.levels
    off = np.abs(state.velocity - true.velocity)
    assert off.max() > 0.28e-3
    assert (off > state.half_width).any()
    assert (off <= state.true_half_width[0]).all()
    assert 0.01 < level.true_half_width / level.at_focus < 0.011
    assert level.at_focus == pytest.approx(0.2, rel=2e-3)
    assert mark_of(outcome, preflight.experiment.protocol)["missed"] == []


def test_a_long_amplifier_delay_is_corrected(
    preflight: Preflight, shipped_apparatus: Apparatus, make_bench: Callable, judge: Callable
) -> None:
    """A delay of 60 us, longer than the usual margin, is found and allowed for."""
    slow = shipped_apparatus.twin.model_copy(update={"amplifier": TrueAmplifier(bandwidth_kHz=100.0, delay_us=60.0)})
    bench = make_bench(shipped_apparatus.model_copy(update={"twin": slow}), 1)
    velocity, displacement, _ = judge(bench, CalibrationLoop(bench, shipped_apparatus, preflight.inputs).run())
    assert max(velocity, displacement) < 0.3e-3
