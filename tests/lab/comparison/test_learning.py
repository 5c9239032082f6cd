"""Data given to the methods: responses recorded by the scope, and the modes identified from them."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from modaltouch.cli import BAD_INPUT, app
from modaltouch.lab import comparison as command
from modaltouch.lab.contest import for_rivals, identified_model, learn, without_mismatch
from modaltouch.lab.focusing_methods import TrainingData, design_all
from modaltouch.lab.identification.joint_fit import identify
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.rig.simulator.twin import Twin

DELAY = 4.6e-6
NOISE = 2e-6


@pytest.fixture(scope="module")
def recorded(known):
    """Return responses of the table as recorded at 27 points: with noise and a vibrometer delay."""
    some = known.responses
    points = np.round(np.linspace(0, some.position.size - 1, 27)).astype(int)
    rng = np.random.default_rng(8)
    response = some.response[:, points] * np.exp(-2j * np.pi * some.frequency * DELAY)
    response = response + NOISE * (rng.normal(size=response.shape) + 1j * rng.normal(size=response.shape))
    power = np.abs(response) ** 2
    coherence = power / (power + 2 * 2 * NOISE**2)
    every = FrequencyResponses(some.frequency, response, some.position[points], ("centre", "side"), coherence, 2)
    return every.between(120.0, 95e3)


def test_learning_measures_the_true_responses(preflight):
    """At mid-beam and at every resonance of the table: the true beam's velocity per volt.

    Within 4 %, and four times the noise of two records.
    """
    recorded = learn(preflight, n_points=3, n_records=2)
    assert recorded.bandwidth == preflight.experiment.apparatus.acquisition.vibrometer_bandwidth_kHz * 1e3
    assert recorded.positions == pytest.approx([-0.05, 0.0, 0.05])
    twin = Twin(without_mismatch(preflight.experiment.apparatus), 1)
    system, table = twin.beam.equations(replace(twin.amplifier, bandwidth=None, delay=0.0)), twin.beam.table
    output = twin.beam.shapes([0.0])[:, 0] @ system.velocity
    for frequency, gain in zip(table.natural_frequency, table.modal_gain, strict=True):
        bin_ = int(np.abs(recorded.frequency - frequency).argmin())
        channel = int(np.abs(gain).argmax())
        # Real outputs of complex states: each state and its conjugate.
        turn = 2j * np.pi * recorded.frequency[bin_]
        states = 0.5 * output * system.input_gain[:, channel] / (turn - system.exponent)
        mirrored = 0.5 * np.conj(output * system.input_gain[:, channel]) / (turn - np.conj(system.exponent))
        true = abs(complex((states + mirrored).sum()))
        vibrometer = abs(1 + 1j * frequency / 250e3)
        assert abs(recorded.response[channel, 1, bin_]) * vibrometer == pytest.approx(true, rel=0.04, abs=2e-4), (
            frequency
        )


def test_laws_and_rivals_learn_from_the_same_recordings(preflight, known, recorded):
    """The identified modes agree with the table within 1 %, and the rivals' responses are corrected for the delay."""
    apparatus = preflight.experiment.apparatus
    found = identify(recorded, 0.1)
    model = identified_model(found, apparatus)
    table = apparatus.modal_model()
    assert model.natural_frequency == pytest.approx(table.natural_frequency, rel=1e-3)
    assert model.damping_ratio == pytest.approx(table.damping_ratio, rel=0.02)
    largest = np.abs(table.modal_gain).max(axis=1)
    assert (np.abs(model.modal_gain - table.modal_gain).max(axis=1) < 0.02 * largest).all()
    rivals = for_rivals(recorded, found.delay.value, apparatus)
    middle = int(np.abs(rivals.position).argmin())
    for frequency, gain in zip(table.natural_frequency[:-2], table.modal_gain[:-2], strict=True):
        bin_ = int(np.abs(rivals.frequency - frequency).argmin())
        own = rivals.response[int(np.abs(gain).argmax()), middle, bin_]
        assert abs(own.imag) < 0.25 * abs(own.real), f"{frequency} Hz is not real at resonance"
    every = design_all(replace(known, model=model, responses=rivals))
    assert [each.method.key for each in every][:2] == ["exact", "paper"]
    assert all(0 < each.peak_voltage <= 250 * (1 + 1e-9) for each in every)


def test_the_listed_low_pass_is_taken_out_for_the_rivals(preflight, recorded):
    """A first-order one of 250 kHz, 6 % and 20 degrees at the highest mode: divided out, nothing of it is left."""
    apparatus, corner = preflight.experiment.apparatus, 250e3
    passed = recorded.response / (1 + 1j * recorded.frequency / corner)
    filtered = replace(recorded, response=passed, bandwidth=corner)
    expected = for_rivals(recorded, DELAY, apparatus).response
    np.testing.assert_allclose(for_rivals(filtered, DELAY, apparatus).response, expected, rtol=1e-12)


def test_a_mode_that_was_not_found_ends_the_comparison(recorded, monkeypatch, tmp_path):
    """With the table's values in its place, which are the true beam's, the laws would know what no rival can."""
    monkeypatch.setattr(command, "learn", lambda *_, **__: recorded.between(120.0, 20e3))
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["compare", "differentiated_stimulation", "--beams", "1", "--out", str(out)])
    assert result.exit_code == BAD_INPUT
    assert "mode 17 was not found" in result.stderr
    assert not out.exists()


def test_steps_end_at_the_focusing_instant(known):
    """Rivals hold voltages for several samples; the last step ends at the focusing instant for any count."""
    odd = replace(known, timing=replace(known.timing, focusing_instant=0.0249996))
    assert isinstance(odd, TrainingData)
    before = odd.timing.samples_until(odd.timing.focusing_instant)[0]
    steps = np.zeros((2, odd.n_before))
    steps[:, -1] = 1.0
    # Of any drive that moves the focus: its last step.
    voltage = odd.to_level(steps)
    last = np.flatnonzero(voltage[1])
    assert last[-1] == before - 1
    assert last.size == odd.stride
