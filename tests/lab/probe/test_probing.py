"""The twin's fingers, probed through the driver: results, file and refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from modaltouch.lab import Prober, probe_fingers
from modaltouch.lab.laboratory import open_laboratory
from modaltouch.lab.probe_excitation import BurstRecord, Excitation
from modaltouch.lab.recorded_files import RecordedFiles
from modaltouch.preflight import design, examine
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.placements import FingersFile
from modaltouch.protocol.source import Source
from modaltouch.record import RecordError
from modaltouch.rig import Recording, RigError
from modaltouch.rig.simulator.scope import SimulatedScope
from modaltouch.stimulus import Finger

TRUE = {"mass_g": 0.1, "damping_N_s_per_m": 0.7, "stiffness_N_per_mm": 0.9}
SPEED = 15e-3
EXPECTED = (("right index", "A", -0.04), ("right middle", "C", 0.0))


@pytest.fixture(scope="module")
def protocol(tmp_path_factory):
    """Under the finger with one hand, on a beam with even modes in its table; the twin's fingers are known."""
    folder, yaml = tmp_path_factory.mktemp("probe"), YAML()
    apparatus = yaml.load(Source.find("apparatus", "beam_100x6x2").path.read_text(encoding="utf-8"))
    unlisted = apparatus["twin"].pop("unlisted_modes")
    apparatus["modes"] += [mode for mode in unlisted if mode.get("family") != "torsion"]
    torsion = [mode for mode in unlisted if mode.get("family") == "torsion"]
    plain = {"amplifier": {}, "generator_gain_mismatch": 0.0}
    apparatus["twin"] |= {"unlisted_modes": torsion, "fingers": TRUE, **plain}
    yaml.dump(apparatus, folder / "beam.yaml")
    shipped = Source.find("protocol", "under_the_finger").path
    values = yaml.load(shipped.read_text(encoding="utf-8"))
    values["apparatus"], values["texts"] = "beam.yaml", str(shipped.parent / "texts" / "english.yaml")
    values["conditions"] |= {"finger_conditions": ["one_hand"], "peak_velocities_mm_s": [10, 20]}
    yaml.dump(values, folder / "protocol.yaml")
    return folder / "protocol.yaml"


@pytest.fixture(scope="module")
def written(protocol):
    """Result of the probe on A and C, with its file; the fingers are where they are expected."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("modaltouch.lab.fingers.PLACE_ERROR", 0.0)
        return probe_fingers(protocol, protocol.parent / "mine.yaml", pair="A-C", seed=5)


@pytest.fixture(scope="module")
def prober(protocol):
    """A prober on A and C, with hands off measured, and its bench."""
    fingers = [Finger(place, 8e-5, 0.5, 500.0) for _, _, place in EXPECTED]
    with open_laboratory(Apparatus.read(protocol.with_name("beam.yaml")), seed=5) as bench:
        measuring = Prober(bench, [fingers])
        measuring.hands_off()
        yield bench, measuring


def test_the_twins_fingers_are_found(written):
    """Mass, damping, stiffness and place within four standard deviations of the probe's covariance."""
    file = FingersFile.read(Path(written["file"]))
    deviation = np.sqrt(np.diag(file.probes[0].covariance)).reshape(2, 4)
    for name, spread in zip(("right index", "right middle"), deviation, strict=True):
        off = [np.log(getattr(file.of(name), key) / value) for key, value in TRUE.items()]
        assert np.all(np.abs([*off, file.of(name).offset_mm]) < 4 * spread)
    assert deviation[:, 0].max() < 0.01


def test_the_level_is_predicted_with_its_interval(written):
    """Within 2 % of 20 mm/s by the design from the file, inside an interval of about that width."""
    (placement,) = written["placements"]
    low, high = placement["interval_mm_s"]
    assert low < placement["level_mm_s"] < high
    assert placement["level_mm_s"] == pytest.approx(20, rel=0.02)
    assert high - low < 0.02 * 20
    assert placement["level_percent"] == pytest.approx([5 * low, 5 * high], abs=1e-3)
    assert placement["attainable_mm_s"] > 20


def test_the_uncertainty_of_the_sensitivity_is_stated_separately(written):
    """It is common to all levels, so the intervals exclude it."""
    assert written["sensitivity_uncertainty_percent"] == 1.0


def test_the_twin_reaches_the_level(written, protocol):
    """Its true speed at C under the design from the file is in the interval."""
    file, (inputs, _) = FingersFile.read(Path(written["file"])), examine(protocol).sound
    fingers = file.of("right index").at(-0.04), file.of("right middle").at(0.0)
    stimulus = design(replace(inputs, fingers=fingers))
    with open_laboratory(Apparatus.read(protocol.with_name("beam.yaml")), seed=5) as laboratory:
        laboratory.load(stimulus.burst)
        laboratory.simulator.touch([-0.04, 0.0])
        laboratory.rig.fire(0.02)
        state = laboratory.simulator.true_state(stimulus.timing.focusing_instant, first=True)
        shape = laboratory.simulator.twin.beam.shapes([0.0])[:, 0]
        laboratory.rig.stop()
    level = 1e3 * shape @ np.append(state.velocity, state.unlisted_velocity)
    low, high = written["placements"][0]["interval_mm_s"]
    assert low < level < high


def test_the_file_works_with_check(written, protocol):
    """Each finger at its place; the level at the focus is met."""
    figures = examine(protocol).as_dict(fingers=written["file"])["stimuli"][-1]["touched"]
    assert set(figures) == {"A-C", "B-D", "C-E"}
    own = protocol.with_name("own.yaml")
    own.write_text(protocol.read_text(encoding="utf-8").replace("fingers: typical", f"fingers: {written['file']}"))
    designed = examine(own).as_dict(fingers=written["file"])["stimuli"][-1]["touched"]
    assert designed["A-C"]["zone_at_focus_mm_s"]["C"] == pytest.approx(20, rel=1e-4)


def test_the_file_is_not_overwritten(written, protocol):
    """It may be in use."""
    with pytest.raises(RecordError, match="exists already and is not overwritten; give another file with --out"):
        probe_fingers(protocol, Path(written["file"]))


def test_the_shipped_table_is_refused(tmp_path):
    """It lacks even modes; nothing is opened."""
    with pytest.raises(ValueError, match=r"the table lacks modes 2, 4, .* run `modaltouch identify --modes all`"):
        probe_fingers(Path("under_the_finger"), tmp_path / "fingers.yaml", rig="no rig")


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_wrong_sensitivity_is_refused(protocol, tmp_path, monkeypatch, factor):
    """Set to 0.8 or 1.25 times the listed value, every level would be wrong by as much."""
    measure = SimulatedScope.measure

    def misread(*args):
        recording = measure(*args)
        return replace(recording, velocity=recording.velocity * factor)

    monkeypatch.setattr(SimulatedScope, "measure", misread)
    message = r"the modes move (0\.80|1\.2[45]) times as fast .*sensitivity_mm_s_per_V.*outputs are off"
    with pytest.raises(RigError, match=message):
        probe_fingers(protocol, tmp_path / "mine.yaml", pair="A-C", seed=5)


@pytest.mark.parametrize(
    ("places", "highest", "said"),
    [
        ((), SPEED, r"no finger is detected at -40 mm from mid-beam"),
        ((-0.04,), SPEED, r"no finger is detected at \+0 mm from mid-beam"),
        (
            (-0.04, 0.012),
            SPEED,
            r"the right middle finger lies \+12\.\d mm from the centre of zone C: allowed at most 10 mm",
        ),
        ((-0.02, 0.02), SPEED, r"no combination of mass, damper .* check that each finger lies on its zone"),
        ((-0.04, 0.0), SPEED / 10, r"velocity is overloaded; check that nothing knocks on the beam or touches it but"),
    ],
    ids=["nobody", "one finger", "beside its zone", "another pair", "a knock"],
)
def test_a_placement_that_is_not_as_expected_is_refused(prober, places, highest, said):
    """With its cause, so that it can be measured again."""
    bench, measuring = prober
    bench.simulator.touch(places)
    expected = {name: (zone, Finger(place, 8e-5, 0.5, 500.0)) for name, zone, place in EXPECTED}
    measuring.speed = highest
    with pytest.raises(ValueError, match=said):
        measuring.hands_on(expected)
    assert bench.simulator.outputs == (False, False)


def test_a_range_that_is_too_small_is_widened_once(prober):
    """Fingers unlike the expected ones may let the beam move more than half again as fast."""
    bench, measuring = prober
    bench.simulator.touch((-0.04, 0.0))
    measuring.speed = SPEED / 2
    expected = {name: (zone, Finger(place, 8e-5, 0.5, 500.0)) for name, zone, place in EXPECTED}
    assert measuring.hands_on(expected)["misfit"] < 5


@pytest.mark.parametrize(("range_mm_s", "n_records"), [(12.0, 1), (1e3, 2)])
def test_the_widest_range_is_not_tried_twice(prober, monkeypatch, range_mm_s, n_records):
    """A record takes long if another scope saves it."""
    bench, measuring = prober
    acquisition, asked, record = bench.apparatus.acquisition, list[float](), type(bench).record

    def overloaded(self, position, velocity, wanted):
        asked.append(wanted.velocity_range)
        return replace(record(self, position, velocity, wanted), overloaded=("velocity",))

    monkeypatch.setattr(type(bench), "record", overloaded)
    narrow = acquisition.model_copy(update={"range_mm_s": range_mm_s})
    bench = replace(bench, apparatus=bench.apparatus.model_copy(update={"acquisition": narrow}))
    with pytest.raises(ValueError, match="velocity is overloaded; check that nothing knocks on the beam"):
        measuring._excitation.probe(bench, measuring.laser, SPEED, None)
    assert len(set(asked)) == len(asked) == n_records


def test_a_table_that_hardly_fits_is_named_when_fingers_do_not_fit(prober, monkeypatch):
    """An unlisted amplifier corner of 170 to 200 kHz gives a misfit of nearly 10 with hands off."""
    bench, measuring = prober
    bench.simulator.touch((-0.02, 0.02))
    measuring.speed = SPEED
    monkeypatch.setattr(measuring, "_free", replace(measuring._free, misfit=9.9))
    expected = {name: (zone, Finger(place, 8e-5, 0.5, 500.0)) for name, zone, place in EXPECTED}
    said = r"no combination of mass.*; with hands off the misfit was 9\.9, .* enter the corner of a slow amplifier"
    with pytest.raises(ValueError, match=said):
        measuring.hands_on(expected)


def test_a_level_that_is_not_known_is_refused(protocol, tmp_path, monkeypatch):
    """-11 to 52 mm/s for 20 mm/s were once written as a result."""
    predict = Prober.predict
    monkeypatch.setattr(Prober, "predict", lambda *given: predict(*given) | {"interval_mm_s": [-11.5, 51.8]})
    with pytest.raises(RigError, match="the level under these fingers is known to within 158%: allowed 20%; place the"):
        probe_fingers(protocol, tmp_path / "mine.yaml", pair="A-C", seed=5)
    assert not (tmp_path / "mine.yaml").exists()


def test_an_unknown_pair_is_refused(protocol, tmp_path):
    """With the allowed ones."""
    with pytest.raises(ValueError, match="--pair is 'A-E'; allowed: A-C, B-D, C-E, the zones of under_the_finger"):
        probe_fingers(protocol, tmp_path / "fingers.yaml", pair="A-E")


def test_a_probe_waits_for_files(protocol, tmp_path, monkeypatch):
    """With `record` and no files the wait ends with the missing file's name, and nothing is written."""
    monkeypatch.setattr(RecordedFiles, "slowest", 0.01)
    with pytest.raises(RigError, match=r"no usable record arrived as .*records.0001\.csv or \.npz within 0\.00"):
        probe_fingers(protocol, tmp_path / "fingers.yaml", record=tmp_path / "records")
    assert not (tmp_path / "fingers.yaml").exists()


class FasterScope:
    """Records as a file may hold them: 1.11 times as fast, a third of a sample late, a little less than a period."""

    def __init__(self, scope):
        self.scope, self.slowest = scope, 120.0

    def configure(self, asked):
        rate = asked.sampling_rate / 0.9
        n_samples = int(asked.n_samples / 0.9) - 1
        self.scope.configure(replace(asked, sampling_rate=rate, n_samples=n_samples, start=0.1e-6))

    def measure(self, position, across=0.0):
        return self.scope.measure(position, across)


@pytest.mark.parametrize("other", [lambda scope: scope, FasterScope], ids=["alike", "a file"])
def test_the_stated_noise_is_that_of_the_records(protocol, other):
    """Two records of the untouched beam differ by the stated deviation, at whatever rate and from whatever instant."""
    apparatus = Apparatus.read(protocol.with_name("beam.yaml"))
    fingers = (Finger(-0.04, 8e-5, 0.5, 500.0), Finger(0.0, 8e-5, 0.5, 500.0))
    excitation = Excitation.of(apparatus, apparatus.modal_model(), [fingers], 0.049, SPEED)
    assert np.diff(excitation.bins).min() >= 4
    with open_laboratory(apparatus, repetition="continuous") as laboratory:
        laboratory.load(excitation.burst)
        first, _ = excitation.probe(laboratory, 0.049, SPEED, 250e3)
        _, second = excitation.probe(replace(laboratory, scope=other(laboratory.scope)), 0.049, SPEED, 250e3)
    ratio = np.abs(first.response - second.response) ** 2 / first.deviation**2 / 4
    assert ratio.mean() == pytest.approx(1.0, abs=0.25)


def test_unusable_bursts_are_refused_with_figures():
    """Clipped, or without the silence from which the noise is estimated."""
    stimulus = examine("demo").sound[1]
    burst = BurstRecord(stimulus, 0.02, stimulus.model.natural_frequency)
    timing, rate = stimulus.timing, 1e6
    n = round((timing.duration + 0.3 * (1 / timing.repetition_rate - timing.duration)) * rate)
    seen = Recording(0.049, np.arange(n) / rate, np.full((1, n), 0.2), np.empty((1, 0, n)), rate, ())
    with pytest.raises(ValueError, match=r"lasts 0 ms, but at least 0\.1 are needed: lower repetition_rate_Hz"):
        burst.probe(seen, None)
    with pytest.raises(
        RigError,
        match=r"is clipped at 200 mm/s.*choose a wider range at the vibrometer, and enter it as acquisition.range_mm_s",
    ):
        burst.probe(replace(seen, overloaded=("velocity",)), None)
