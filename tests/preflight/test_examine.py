"""The whole check: limits at the levels that exceed them, and the predictions that a lab reads."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.preflight import Preflight, examine
from modaltouch.preflight.single_design import estimated_duration
from modaltouch.protocol.schedule import Schedule
from modaltouch.protocol.source import InputError
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.rig import instrument_of

Edit = Callable[..., Path]
FILE = "differentiated_stimulation.yaml"
BEAM = "apparatus/beam_100x6x2.yaml"
LEVELS = "[80, 100, 150, 200]"


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The paper's protocol, examined."""
    return examine(Path(__file__).parents[2] / "protocols" / FILE)


def faults(file: Path) -> list[str]:
    """Return the faults that the whole check finds."""
    return [str(problem).replace(str(file.parent) + "/", "") for problem in examine(file).problems]


def test_the_papers_protocol_passes(preflight: Preflight) -> None:
    """It has no problem, 24 trials, 3 practice trials and the four levels of the paper."""
    assert preflight.problems == ()
    values = preflight.as_dict()
    assert values["problems"] == []
    assert (values["n_trials"], values["n_practice_trials"]) == (24, 3)
    assert [stimulus["velocity_mm_s"] for stimulus in values["stimuli"]] == [80, 100, 150, 200]


def test_the_papers_modes_are_selected(preflight: Preflight) -> None:
    """Section III of the paper: modes 1, 3, 5, 7, 11 and 13."""
    assert preflight.as_dict()["stimuli"][0]["selected_modes"] == [1, 3, 5, 7, 11, 13]


def test_predictions_of_the_shipped_stimulus(preflight: Preflight) -> None:
    """184 V for the triangle, 14 mm wide at 80 %, contrast about 1.8 : 1 for (A, C), equal speeds for (B, D)."""
    top = preflight.as_dict()["stimuli"][-1]
    assert top["zone_at_focus_mm_s"]["C"] == pytest.approx(200, rel=1e-4)
    assert top["zone_peak_mm_s"]["C"] == pytest.approx(200, rel=1e-3)
    assert top["peak_drive_V"]["1"] == pytest.approx(184, abs=1)
    assert top["width_80_mm"] == pytest.approx(14, abs=0.2)
    assert top["n_samples"] == 125_000
    assert top["sampling_rate_Hz"] == pytest.approx(2.5e6)
    peak = top["zone_peak_mm_s"]
    assert peak["C"] / peak["A"] == pytest.approx(1.8, abs=0.3)
    assert peak["A"] == pytest.approx(peak["E"], rel=1e-6)
    assert peak["B"] == pytest.approx(peak["D"], rel=1e-6)


def test_the_modal_error_is_that_of_the_listed_modes(preflight: Preflight) -> None:
    """Maximum over modes of |velocity - target| and |w eta|, recomputed from the lists; at most 1e-4 of the level."""
    for stimulus in preflight.as_dict()["stimuli"]:
        misses = [abs(stimulus["achieved_mm_s"][k] - stimulus["target_mm_s"][k]) for k in stimulus["target_mm_s"]]
        misses += [abs(value) for value in stimulus["achieved_displacement_mm_s"].values()]
        assert stimulus["worst_modal_error_mm_s"] == pytest.approx(max(misses), rel=1e-6)
        assert stimulus["worst_modal_error_mm_s"] <= 1e-4 * stimulus["velocity_mm_s"]


def test_zone_speeds_follow_from_the_modes(preflight: Preflight) -> None:
    """Sum over modes of velocity times mode shape at the zone's centre, with textbook mode shapes (mpmath)."""
    import mpmath

    stimulus = preflight.as_dict()["stimuli"][-1]

    def shape(label: int, y: float) -> mpmath.mpf:
        if label == 1:
            return mpmath.mpf(1)

        def bare(x: mpmath.mpf) -> mpmath.mpf:
            return mpmath.cos(root * x) / mpmath.cos(root / 2) + mpmath.cosh(root * x) / mpmath.cosh(root / 2)

        root = mpmath.findroot(lambda x: mpmath.cos(x) - mpmath.sech(x), (2 * label - 3) * mpmath.pi / 2)
        mean_square = mpmath.quad(lambda x: bare(x) ** 2, mpmath.linspace(-0.5, 0.5, 21))
        return bare(mpmath.mpf(y)) / mpmath.sqrt(mean_square)

    for zone, centre in {"A": -0.4, "B": -0.2, "C": 0.0}.items():
        speed = sum(value * shape(int(label), centre) for label, value in stimulus["achieved_mm_s"].items())
        assert stimulus["zone_at_focus_mm_s"][zone] == pytest.approx(float(speed), abs=1e-8)


def test_speeds_at_the_fingers_are_the_peaks_of_their_zones(preflight: Preflight) -> None:
    """In m/s, left and right as in the trial's pair."""
    peaks = preflight.as_dict()["stimuli"][0]["zone_peak_mm_s"]
    trial = Trial(1, 1, Condition("one_hand", "B", "C", 80.0))
    np.testing.assert_allclose(preflight.speeds(trial), [peaks["B"] * 1e-3, peaks["C"] * 1e-3], rtol=1e-12)
    for scheduled in Schedule.draw(preflight.experiment.protocol, "p01", 1).trials:
        assert min(preflight.speeds(scheduled)) > 0


def test_the_paper_law_is_compared_on_request_and_misses(preflight: Preflight) -> None:
    """Erratum 3: started from rest, the paper's mode 1 ends 4.2 % short of its target."""
    assert "comparison" not in preflight.as_dict()
    paper = preflight.as_dict(compare=True)["comparison"][-1]
    assert paper["law"] == "paper"
    assert paper["achieved_mm_s"]["1"] / paper["target_mm_s"]["1"] == pytest.approx(1 - 0.042, abs=0.005)
    assert paper["worst_modal_error_mm_s"] > 1


def test_the_output_is_json_without_nan(preflight: Preflight) -> None:
    """RFC 8259 has no NaN."""
    assert json.loads(json.dumps(preflight.as_dict(compare=True), allow_nan=False))


def test_a_velocity_beyond_the_amplifier_is_refused_with_its_voltage(edit: Edit) -> None:
    """By linearity 400 mm/s needs twice the 184.5 V of 200 mm/s, and 250 V give 271 mm/s."""
    (found,) = faults(edit(FILE, (LEVELS, "[80, 400]")))
    assert found.startswith(
        f"{FILE}:25:30: conditions.peak_velocities_mm_s[1]: given 400 mm/s, which needs 369 V at the beam; "
        "allowed: at most 250 V there (271 mm/s); "
    )


def test_the_highest_allowed_velocity_passes(edit: Edit) -> None:
    """271 mm/s passes."""
    assert faults(edit(FILE, (LEVELS, "[80, 271]"))) == []


def test_a_velocity_above_the_highest_allowed_is_refused(edit: Edit) -> None:
    """272 mm/s needs 250.9 V."""
    assert len(faults(edit(FILE, (LEVELS, "[80, 272]")))) == 1


@pytest.mark.parametrize("level", [80, 263, 268, 271])
def test_levels_that_pass_the_check_pass_the_rig(edit: Edit, level: int) -> None:
    """The rig applies its limits itself; a session must not be the first to find an excess."""
    preflight = examine(edit(FILE, (LEVELS, f"[80.5, {level}]")))
    assert preflight.problems == ()
    apparatus = preflight.experiment.apparatus
    limits = instrument_of(apparatus).limits(apparatus)
    burst = preflight.stimulus.burst
    for velocity in (0.0805, level * 1e-3):
        assert all(value > 0 for value in limits.amplitudes(burst, velocity))


def test_a_level_that_fits_is_not_blamed_for_one_that_does_not(edit: Edit) -> None:
    """250 V reach 271 mm/s: of 271 and 275 only the second is refused, though they share a full scale."""
    (found,) = faults(edit(FILE, (LEVELS, "[80, 271, 275]")))
    assert "conditions.peak_velocities_mm_s[2]: given 275 mm/s, which needs 254 V at the beam" in found


def test_a_lower_amplifier_limit_is_kept(edit: Edit) -> None:
    """The limit is a number of the apparatus file: 100 V reach 108 mm/s."""
    file = edit(FILE)
    edit_beam = file.parent / BEAM
    edit_beam.write_text(edit_beam.read_text().replace("limit_V: 250", "limit_V: 100"))
    found = faults(file)
    assert [each.split(": ")[1] for each in found] == [
        "conditions.peak_velocities_mm_s[2]",
        "conditions.peak_velocities_mm_s[3]",
    ]
    assert all("at most 100 V there (108 mm/s)" in each for each in found)


def test_an_amplifier_of_low_gain_is_limited_by_the_generator(edit: Edit) -> None:
    """20 V peak to peak of the AFG3022B times a gain of 10 gives 100 V at the beam."""
    file = edit(FILE)
    beam = file.parent / BEAM
    beam.write_text(beam.read_text().replace("gain_V_per_V: 25", "gain_V_per_V: 10"))
    found = faults(file)
    assert len(found) == 2
    assert "V peak to peak of output 1; allowed: at most 20 V into an open circuit" in found[0]


def test_a_level_too_small_for_the_generator_is_refused(edit: Edit) -> None:
    """The AFG3022B's smallest amplitude into an open circuit is 20 mV peak to peak."""
    found = faults(edit(FILE, (LEVELS, "[0.1, 200]")))
    assert found
    assert all("allowed: at least 0.02 V, the generator's smallest amplitude" in each for each in found)


@pytest.mark.parametrize(
    ("focus", "levels", "limit", "words"),
    [
        (
            "A",
            "[100, 140]",
            150,
            ("140 mm/s, which moves zone A at 202 mm/s", "150 mm/s anywhere in a zone (104 mm/s)"),
        ),
        (
            "A",
            "[100, 105]",
            150,
            ("105 mm/s, which moves zone A at 151 mm/s", "150 mm/s anywhere in a zone (104 mm/s)"),
        ),
        ("A", "[100, 104]", 150, ()),
        ("C", "[80, 200]", 200, ("200 mm/s, which moves zone A at 223 mm/s", "200 mm/s anywhere in a zone (179 mm/s)")),
        ("C", "[200]", 200, ("200 mm/s, which moves zone A at 223 mm/s", "200 mm/s anywhere in a zone (179 mm/s)")),
        ("C", "[80, 179]", 200, ()),
        ("C", "[80, 200]", 199, ("200 mm/s, above the safety limit of the apparatus", "at most 199 mm/s")),
    ],
)
def test_a_zone_faster_than_the_safety_limit_is_refused(
    edit: Edit, focus: str, levels: str, limit: int, words: tuple[str, ...]
) -> None:
    """The free end in zone A moves faster than centre and focus; the level in the message passes."""
    file = edit(FILE, ("focus: C", f"focus: {focus}"), (LEVELS, levels))
    beam = file.parent / BEAM
    beam.write_text(beam.read_text().replace("velocity_limit_mm_s: 500", f"velocity_limit_mm_s: {limit}"))
    found = faults(file)
    assert len(found) == bool(words)
    assert all(f"]: given {words[0]}; allowed: " in each for each in found)
    assert all(word in each for word in words for each in found)


def test_syntax_faults_do_not_hide_physical_ones(edit: Edit) -> None:
    """An unknown key, a misspelt one, a wrong level and a single answer are reported together with 400 mm/s."""
    file = edit(
        FILE,
        ("conditions:\n", "colour: red\nconditions:\n"),
        ("hand: right ", "hnad: right "),
        (LEVELS, "[x, 400]"),
        ("    left: [left, num_4]\n    both: [up, down, num_8]\n", ""),
    )
    found = faults(file)
    assert len(found) == 5
    assert any("given 400 mm/s, which needs 369 V at the beam" in each for each in found)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (
            "selected_modes: 6",
            "selected_modes: [2]",
            f"{FILE}:14:20: stimulus.selected_modes[0]: given 2, which is not",
        ),
        ("decomposed_modes: 50", "decomposed_modes: 10", f"{FILE}:13:21: stimulus.decomposed_modes: given a stimulus"),
        ("focusing_instant_ms: 25", "focusing_instant_ms: 0.004", f"{FILE}:15:24: stimulus.focusing_instant_ms: given"),
    ],
)
def test_a_refusal_of_the_engine_has_its_place(edit: Edit, old: str, new: str, fault: str) -> None:
    """Lines and columns are counted in the shipped file."""
    found = faults(edit(FILE, (old, new)))
    assert [each[: len(fault)] for each in found] == [fault]


def test_a_mode_without_a_gain_is_reported_in_the_apparatus_file(edit: Edit) -> None:
    """Mode 5, the third of the table, has no gain."""
    file = edit(FILE)
    beam = file.parent / BEAM
    beam.write_text(beam.read_text().replace("{side: 6500}", "{side: 0}"))
    (found,) = faults(file)
    assert found.startswith(f"{BEAM}:29:67: modes[2].gain_mm_s2_per_V: given a stimulus that cannot be made, mode 5")


def test_modes_of_one_set_leave_the_other_channel_silent(edit: Edit) -> None:
    """Modes 1 and 3 have gains on the centre set only; a silent channel is not an amplitude that is too small."""
    preflight = examine(edit(FILE, ("selected_modes: 6", "selected_modes: [1, 3]"), (LEVELS, "[20]")))
    assert preflight.problems == ()
    assert preflight.as_dict()["stimuli"][0]["peak_drive_V"]["2"] == 0


def test_a_faulty_protocol_raises_only_when_used(edit: Edit) -> None:
    """`check --json` prints its faults; its experiment and stimulus raise."""
    preflight = examine(edit(FILE, ("focus: C", "focus: X")))
    values = preflight.as_dict()
    assert (values["protocol"], values["stimuli"]) == ("differentiated_stimulation", [])
    (problem,) = values["problems"]
    assert {"file", "line", "column", "path", "given", "allowed", "message"} <= set(problem)
    with pytest.raises(InputError, match="'X', which is not a zone"):
        _ = preflight.experiment
    with pytest.raises(InputError, match="'X', which is not a zone"):
        _ = preflight.stimulus


def test_a_missing_protocol_is_a_problem(tmp_path: Path) -> None:
    """It raises no exception either, and similar names are suggested."""
    (problem,) = examine(tmp_path / "thresholds.yaml").problems
    assert problem.given == "a file that does not exist"
    assert problem.allowed.startswith("a YAML file that exists and can be read, or one of comparison_2ifc, demo, d")
    assert problem.remedy == "did you mean 'threshold'?"


@pytest.mark.parametrize(("focus", "faster"), [("A", "170"), ("D", "163")])
def test_a_focus_where_the_field_does_not_peak_is_warned_of(edit: Edit, focus: str, faster: str) -> None:
    """Symmetric wiring mirrors every field at mid-beam, so zone C moves faster: 163 mm/s for 150."""
    values = examine(edit(FILE, ("focus: C", f"focus: {focus}"), (LEVELS, "[80, 150]"))).as_dict()
    assert values["stimuli"][-1]["zone_peak_mm_s"]["C"] == pytest.approx(float(faster), abs=0.6)
    told = f"at 150 mm/s the focus {focus} is not where the beam moves fastest: zone {focus} moves at up to 150 mm/s"
    assert any(each.startswith(told) and f"zone C at up to {faster} mm/s" in each for each in values["warnings"])
    assert any("the field misses the target by 106% of its root" in each for each in values["warnings"])


def test_the_papers_focus_is_not_warned_of(preflight: Preflight) -> None:
    """Zone C is the fastest there, and six modes miss the target by 6 %."""
    assert not [each for each in preflight.as_dict()["warnings"] if "fastest" in each or "misses the target" in each]


def test_levels_in_metres_per_second_are_recognised(edit: Edit) -> None:
    """Each is reported once with the level meant: 0.08 m/s is 80 mm/s."""
    found = faults(edit(FILE, (LEVELS, "[0.08, 0.1, 0.15, 0.2]")))
    assert len(found) == 4
    for text, meant in zip(found, (80, 100, 150, 200), strict=True):
        assert text.endswith(f"did you mean {meant} mm/s? Levels are in mm/s, not m/s")


def test_a_field_that_no_level_can_play_is_reported_once_at_the_field(edit: Edit) -> None:
    """A base of 100 m is flat over the beam: one set is almost silent, and no level suits both."""
    (found,) = faults(edit(FILE, ("base_mm: 56", "base_mm: 100000")))
    assert (
        "stimulus.field.base_mm: given 100000 mm on a beam of 100 mm, a field that cannot be played at any level"
        in found
    )
    assert "lower the level" not in found
    assert "raise the level" not in found


def test_a_focusing_instant_in_seconds_is_reported_once(edit: Edit) -> None:
    """25 us are too short at any voltage; the fault is not repeated for each level."""
    (found,) = faults(edit(FILE, ("focusing_instant_ms: 25", "focusing_instant_ms: 0.025")))
    assert "given a field that cannot be played at any level" in found
    assert "or focusing_instant_ms; no other level will do" in found


@pytest.mark.parametrize("delay", [500000, 12500])
def test_a_delay_that_leaves_no_time_to_focus_is_reported_at_the_delay(edit: Edit, delay: int) -> None:
    """The focusing instant is 25 ms; the delay is in line 41 of the apparatus file."""
    file = edit(FILE)
    beam = file.parent / BEAM
    beam.write_text(beam.read_text().replace("delay_us: 0", f"delay_us: {delay}", 1))
    (found,) = faults(file)
    assert found.startswith(f"{BEAM}:41:13: amplifier.delay_us: given {delay} us, more than half the time")


def test_samples_of_unequal_duration_are_warned_of(edit: Edit) -> None:
    """131,072 samples over 50 ms at 250 MHz are held for 95 or 96 clock periods."""
    warnings = examine(edit(FILE, ("n_samples: 125000", "n_samples: 131072"))).as_dict()["warnings"]
    assert any("131072 samples are held 95.37 clocks each" in each for each in warnings)


def test_longer_designs_take_longer(preflight: Preflight) -> None:
    """27 presentations of 0.5 s with pauses of 1.0 s take 40 s; ten times the trials take 5 to 10 times as long."""
    protocol = preflight.experiment.protocol
    once = estimated_duration(protocol)
    schedule = protocol.schedule.model_copy(update={"repetitions": 10})
    tenfold = estimated_duration(protocol.model_copy(update={"schedule": schedule}))
    assert 40 / 60 < once < 15
    assert 5 * once < tenfold < 10 * once


def test_check_loads_neither_screen_nor_instrument_nor_tables() -> None:
    """Importing them takes seconds, and none is needed."""
    code = (
        "import sys; from modaltouch.preflight import examine; examine(sys.argv[1]).as_dict(compare=True); "
        "print([name for name in ('psychopy', 'pyvisa', 'pandas', 'matplotlib', 'scipy', 'statsmodels') "
        "if name in sys.modules])"
    )
    file = str(Path(__file__).parents[2] / "protocols" / FILE)
    done = subprocess.run([sys.executable, "-c", code, file], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


OLD = "answers:\n  given_by"


@pytest.mark.parametrize(
    ("masking", "sound", "fault"),
    [
        (
            "level_dB_FS: -5",
            "",
            "masking.level_dB_FS: given -5 dB FS, at which the peaks of the pink noise pass full scale",
        ),
        ("noise: white, level_dB_FS: -5", "", "the peaks of the white noise pass full scale; allowed: at most -1"),
        (
            "level_dB_SPL: 95",
            "100",
            "given 95 dB SPL, at which the peaks of the pink noise pass full scale; allowed: at m",
        ),
        ("level_dB_SPL: 60", "", "masking.level_dB_SPL: given 60 dB SPL, but the loudspeaker is not calibrated"),
        ("noise: pink", "", "masking: given no level; allowed: one of level_dB_FS and level_dB_SPL"),
        ("level_dB_FS: -20, level_dB_SPL: 60", "100", "masking: given level_dB_FS and level_dB_SPL"),
        ("noise: brown, level_dB_FS: -20", "", "masking.noise: given 'brown'"),
    ],
)
def test_a_masking_noise_that_cannot_be_played_is_a_fault(
    edit: Callable[..., Path], masking: str, sound: str, fault: str
) -> None:
    """It exceeds the crest factor, has no calibration, or has no level or two; the fault has its place."""
    file = edit("differentiated_stimulation.yaml", (OLD, f"masking: {{{masking}}}\n{OLD}"))
    if sound:
        edit("apparatus/beam_100x6x2.yaml", ("\nsafety:", f"\nsound: {{full_scale_dB_SPL: {sound}}}\nsafety:"))
    (problem,) = examine(file).problems
    assert fault in str(problem)
    assert "differentiated_stimulation.yaml:" in str(problem)


@pytest.mark.parametrize(
    ("masking", "sound", "warning"),
    [
        ("level_dB_FS: -20", "", "its level at the ear is unknown"),
        ("level_dB_SPL: 85", "100", "above 80 dB it may harm hearing"),
        ("level_dB_SPL: 70", "100", ""),
    ],
)
def test_masking_noise_of_unknown_or_harmful_level_is_warned_of(
    edit: Callable[..., Path], masking: str, sound: str, warning: str
) -> None:
    """An unknown level and a loud one give a warning; a calibrated 70 dB SPL does not."""
    file = edit("differentiated_stimulation.yaml", (OLD, f"masking: {{{masking}}}\n{OLD}"))
    if sound:
        edit("apparatus/beam_100x6x2.yaml", ("\nsafety:", f"\nsound: {{full_scale_dB_SPL: {sound}}}\nsafety:"))
    preflight = examine(file)
    assert preflight.problems == ()
    said = [each for each in preflight.as_dict()["warnings"] if "masking noise" in each]
    assert len(said) == bool(warning)
    assert all(warning in each for each in said)


def test_catch_trials_are_counted_and_warned_of_without_an_answer_none(edit: Edit) -> None:
    """Three in each of two blocks make 30 trials; without the answer none they measure only guessing."""
    file = edit(FILE, ("  practice_trials: 3", "  catch_trials: 3\n  practice_trials: 3"))
    values = examine(file).as_dict()
    assert (values["n_trials"], values["n_catch_trials"]) == (30, 6)
    assert [each for each in values["warnings"] if "no answer none" in each]
    with_none = examine(file.with_name("with_catch_trials.yaml")).as_dict()
    assert with_none["n_catch_trials"] == 6
    assert not [each for each in with_none["warnings"] if "no answer none" in each]
    path = file.with_name("magnitude.yaml")
    path.write_text(path.read_text("utf-8").replace("schedule:\n", "schedule:\n  catch_trials: 2\n"), "utf-8")
    rated = examine(path).as_dict()
    assert rated["n_catch_trials"] == 2
    assert not [each for each in rated["warnings"] if "no answer none" in each], "a scale has no answer none"


@pytest.mark.parametrize(
    ("others", "told"),
    [
        ("weaker: [left], none: [down]", "answers at random, but none where it feels nothing"),
        ("weaker: [down]", "answers at random, whatever it feels"),
        ("none: [down]", ""),
    ],
)
def test_check_explains_how_answers_without_fingers_are_simulated(edit: Edit, others: str, told: str) -> None:
    """The simulated participant has a threshold: with an answer none, it is not at random below it."""
    file = edit("with_catch_trials.yaml")
    text = file.read_text(encoding="utf-8")
    file.write_text(f"{text[: text.index('  keys:')]}  keys: {{stronger: [up], {others}}}\n", encoding="utf-8")
    words = file.parent / "texts" / "english.yaml"
    labels = "\nanswers:\n  stronger: Stronger\n  weaker: Weaker\n"
    words.write_text(words.read_text(encoding="utf-8").replace("\nanswers:\n", labels), encoding="utf-8")
    warnings = examine(file).as_dict()["warnings"]
    said = [each for each in warnings if "names a finger" in each]
    assert len(said) == bool(told)
    assert all(told in each for each in said)
    # The question of a yes-no task is known; that of other answers is not.
    assert any("else write answers.question" in each for each in warnings) is ("none" not in others)


def test_the_steady_error_of_a_free_release_is_reported(edit: Edit, preflight: Preflight) -> None:
    """Braked, the first and all later bursts are exact; free, a residue of 0.007 mm/s reaches the next."""
    braked = preflight.as_dict()["stimuli"][-1]
    assert braked["worst_modal_error_steady_mm_s"] == pytest.approx(braked["worst_modal_error_mm_s"], rel=1e-6)
    free = examine(edit(FILE, ("release: braked ", "release: free "))).as_dict()["stimuli"][-1]
    assert free["worst_modal_error_mm_s"] < 1e-4
    assert 5e-3 < free["worst_modal_error_steady_mm_s"] < 1e-2


def test_too_loud_a_noise_is_reported_once_for_all_stimuli(edit: Callable[..., Path]) -> None:
    """All stimuli share the noise and its key."""
    own = "stimuli: {heard: {masked: false}, usual: {}}\nmasking: {level_dB_FS: 30}\n\nconditions:\n"
    (found,) = examine(edit("demo.yaml", ("conditions:\n", own))).problems
    assert (found.path, found.given.split(",")[0]) == ("masking.level_dB_FS", "30 dB FS")


def test_a_protocol_with_a_line_missing_is_still_described(edit: Edit) -> None:
    """It is described as far as it is valid: `check --json` never ends in a traceback."""
    file = edit("demo.yaml")
    lines = file.read_text("utf-8").splitlines(keepends=True)
    for place, line in enumerate(lines):
        if line.strip() and not line.startswith("#"):
            file.write_text("".join([*lines[:place], *lines[place + 1 :]]), "utf-8")
            values = examine(file).as_dict()
            assert values["problems"] or values["n_trials"], line
