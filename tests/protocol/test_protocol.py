"""The protocol file: contents, and all its faults and those of the files that it names, at once."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import Findings, Sources
from modaltouch.protocol.questions import KEY_NAMES, AskedSection
from modaltouch.protocol.source import InputError

Edit = Callable[..., Path]
FILE = "differentiated_stimulation.yaml"
BEAM = "apparatus/beam_100x6x2.yaml"
LEVELS = "[80, 100, 150, 200]"
PAIRS = "[[A, C], [B, D], [C, E]]"


def faults(file: Path) -> list[str]:
    """Return the faults of a protocol and its files."""
    return [str(problem).replace(str(file.parent) + "/", "") for problem in Findings.read(file).problems]


def test_the_shipped_protocol_is_the_papers_experiment(shipped: Path) -> None:
    """Section V-B of the paper: pairs, speeds, 7 Hz, one hand and two hands."""
    experiment = Findings.read(shipped / FILE).experiment()
    conditions = experiment.protocol.conditions
    assert conditions.zone_pairs == (("A", "C"), ("B", "D"), ("C", "E"))
    assert conditions.peak_velocities_mm_s == (80, 100, 150, 200)
    assert conditions.finger_conditions == ("one_hand", "two_hands")
    assert experiment.protocol.stimulus.repetition_rate_Hz == 7
    assert experiment.protocol.n_trials == 24
    assert experiment.apparatus.apparatus == "beam_100x6x2"
    assert experiment.texts.language == "English"


def test_every_shipped_protocol_is_valid(shipped: Path) -> None:
    """No shipped protocol has a problem."""
    for file in sorted(shipped.glob("*.yaml")):
        assert faults(file) == []


def test_the_least_allowed_sample_count_is_accepted(edit: Edit) -> None:
    """2.5 samples per cycle of 87,855 Hz in 50 ms are 10,981.9, and counts are even."""
    assert faults(edit(FILE, ("n_samples: 125000", "n_samples: 10982"))) == []


def test_an_experiment_is_restored_from_its_record_alone(edit: Edit) -> None:
    """Without its files."""
    file = edit(FILE)
    experiment = Findings.read(file).experiment()
    kept = experiment.sources.as_dict()
    for name in (FILE, BEAM, "texts/english.yaml"):
        (file.parent / name).unlink()
    assert Findings.restored(Sources.from_dict(kept)).experiment() == experiment


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (PAIRS, "[[A, C], [B, F]]", f"{FILE}:24:28: conditions.zone_pairs[1][1]: given 'F', which is not a zone of"),
        (PAIRS, "[[A, C], [B, F]]", "this beam; allowed: A, B, C, D, E"),
        (PAIRS, "[[A, C], [a, D]]", "given 'a', which is not a zone of this beam; allowed: A, B, C, D, E; did you"),
        (
            PAIRS,
            "[[A, C], [A, C]]",
            f"{FILE}:24:24: conditions.zone_pairs[1]: given [A, C], the same pair as zone_pairs[0]",
        ),
        (PAIRS, "[[C, A]]", f"{FILE}:24:16: conditions.zone_pairs[0]: given [C, A], whose left zone C lies right of A"),
        (PAIRS, "[[C, C]]", "conditions.zone_pairs[0]: given [C, C], the same zone for both fingers"),
        (PAIRS, "[[A, B, C]]", "given a list of 3; allowed: a list of exactly 2, each the name of a zone of the beam"),
        (PAIRS, "[A, C]", "conditions.zone_pairs[1]: given 'C'; allowed: a list of exactly 2"),
        (PAIRS, "[]", "conditions.zone_pairs: given an empty list; allowed: a list of at least 1 and at most 100"),
        (LEVELS, "[]", f"{FILE}:25:25: conditions.peak_velocities_mm_s: given an empty list; allowed: a list of at"),
        (LEVELS, "[80, 80.0]", "conditions.peak_velocities_mm_s[1]: given 80, the same peak velocity as peak_vel"),
        (
            LEVELS,
            "[80, .nan]",
            "conditions.peak_velocities_mm_s[1]: given .nan, which is not finite; allowed: a number",
        ),
        (LEVELS, "[-80]", "conditions.peak_velocities_mm_s[0]: given -80; allowed: a number [mm/s] above 0"),
        (LEVELS, "[80 mm/s]", "write only the number: 80"),
        (LEVELS, "[true]", "conditions.peak_velocities_mm_s[0]: given true; allowed: a number [mm/s] above 0"),
        (LEVELS, "[501]", "given 501 mm/s, above the safety limit of the apparatus; allowed: at most 500 mm/s"),
        (LEVELS, str(list(range(10, 111))), "given a list of 101; allowed: a list of at least 1 and at most 100"),
        (
            LEVELS,
            "80",
            "conditions.peak_velocities_mm_s: given 80; allowed: a list of at least 1 and at most 100, each",
        ),
        (
            "[one_hand, two_hands]",
            "[one_hand, one_hand]",
            "given one_hand, the same finger condition as finger_conditions[0]",
        ),
        (
            "[one_hand, two_hands]",
            "[three_hands]",
            "given 'three_hands', which is not a finger condition here; allowed",
        ),
        ("[one_hand, two_hands]", "[]", "conditions.finger_conditions: given an empty list"),
        ("focus: C", "focus: X", "stimulus.focus: given 'X', which is not a zone of this beam; allowed: A, B, C, D, E"),
        ("focusing_instant_ms: 25", "focusing_instant_ms: 50", "given 50 ms, outside the burst of 50 ms"),
        ("focusing_instant_ms: 25", "focusing_instant_ms: 1e-5", "before the second sample; allowed: at least 0.0004"),
        (
            "duration_ms: 50",
            "duration_ms: 150",
            "given 150 ms at 7 bursts per second; allowed: at most 135.714 ms",
        ),
        (
            "n_samples: 125000",
            "n_samples: 524290",
            "given 524290; allowed: a whole number of at least 2, at most 524288",
        ),
        ("n_samples: 125000", "n_samples: 124999", "stimulus.n_samples: given 124999; allowed: a whole number"),
        ("n_samples: 125000", "n_samples: 8000", "too few for the mode of 87855 Hz; allowed: at least 10982"),
        ("n_samples: 125000", "n_samples: 10980", "given 10980 samples in 50 ms, too few for the mode of 87855 Hz"),
        ("selected_modes: 6", "selected_modes: 10", "given 10, more than the 9 modelled modes; allowed: 1 to 9"),
        ("selected_modes: 6", "selected_modes: [1, 2]", "given 2, which is not a modelled mode; allowed: 1, 3, 5, 7"),
        ("selected_modes: 6", "selected_modes: [1, 1]", "given 1, the same mode as selected_modes[0]"),
        ("selected_modes: 6", "selected_modes: []", "stimulus.selected_modes: given an empty list"),
        (
            "selected_modes: 6",
            "selected_modes: six",
            "stimulus.selected_modes: given 'six'; allowed: a whole number of",
        ),
        ("protocol: differentiated_stimulation", "protocol: Simulated", "which is reserved in the results tree"),
        ("protocol: differentiated_stimulation", "protocol: nul", "which is a device on Windows"),
        ("protocol: differentiated_stimulation", "protocol: COM4", "which is a device on Windows"),
        ("protocol: differentiated_stimulation", "protocol: analysis", "which is reserved in the results tree"),
        ("protocol: differentiated_stimulation", "protocol: Derivatives", "which is reserved in the results tree"),
        ("  law: exact", "  law: exact\n  law: exact", f"{FILE}:11:3: stimulus.law: given `law` a second time"),
        (
            "protocol: differentiated_stimulation",
            "protocol: a/b",
            "protocol: given 'a/b', which is not a plain file name",
        ),
        ("protocol: differentiated_stimulation", "protocol: 5", "protocol: given 5, which is not text; allowed: text"),
        (
            "max_same_pair_running: 2",
            "max_same_pair_running: 0",
            "given 0; allowed: a whole number of at least 1 or null",
        ),
        ("repetitions: 1", "repetitions: 1000", "given 1000, which gives 24000 trials; allowed: at most 10000 trials"),
        ("repetitions: 1", "order: by_pair", "given 2 with the order by_pair; allowed: null, or order: shuffled"),
        ("left: [left, num_4]", "left: [escape]", "given 'escape', which pauses the session"),
        ("left: [left, num_4]", "left: [leeft]", "given 'leeft', which is not the name of a key"),
        (
            "left: [left, num_4]",
            "left: [return]",
            "given 'return', which is not the name of a key; allowed: left, right, up",
        ),
        ("left: [left, num_4]", "left: [up]", "answers.keys.both[0]: given 'up', which already means left"),
        ("left: [left, num_4]", "left: []", "answers.keys.left: given an empty list"),
        ("    left: [left, num_4]\n    both: [up, down, num_8]\n", "", "answers.keys: given 1 answer; allowed: 2 to 7"),
        (
            "    left: [left",
            "    lift: [left",
            "answers.keys.lift: given no text `answers.lift` in english.yaml, which this needs; allowed: a text there; "
            "did you mean 'left'? Else add it",
        ),
        (
            "texts/english.yaml",
            "texts/klingon.yaml",
            f"{FILE}:7:8: texts: given 'texts/klingon.yaml', a file that does",
        ),
        ("apparatus/beam_100x6x2.yaml", "apparatus", f"{FILE}:6:12: apparatus: given 'apparatus', a folder or device"),
        (
            "hand: right ",
            "hnad: right ",
            f"{FILE}:23:3: conditions.hnad: given 'hnad', which is not a key here; allowed",
        ),
        (
            "\nanswers:",
            "\nmasking: {level_dBFS: -30}\n\nanswers:",
            "not a key here; allowed: noise, level_dB_FS, level_dB_S",
        ),
        (
            "left: [left, num_4]",
            "left: [é]",
            "given 'é', which is not the name of a key; allowed: left, right, up, down, space",
        ),
        ("peak_velocities_mm_s", "peak_velocities_cm_s", "did you mean 'peak_velocities_mm_s'?"),
        ("\nconditions:", "\nconditoins:", "given 'conditoins', which is not a key here"),
    ],
)
def test_each_fault_has_position_given_and_allowed_values(edit: Edit, old: str, new: str, fault: str) -> None:
    """Lines and columns of the shipped file."""
    found = faults(edit(FILE, (old, new)))
    assert any(fault in each for each in found), found


def test_a_list_with_one_faulty_item_has_one_fault(edit: Edit) -> None:
    """A key written as a bare digit is not reported as an empty list as well."""
    (found,) = faults(edit(FILE, ("left: [left, num_4]", "left: [1]")))
    assert found.endswith("answers.keys.left[0]: given 1, which is not text; allowed: text; write it in quotes")


def test_one_pair_cannot_keep_a_limit_on_runs(edit: Edit) -> None:
    """Four levels of a single pair come four times running in every order."""
    (found,) = examine(edit(FILE, (PAIRS, "[[A, C]]"))).problems
    told = "given 2, but 4 of the 4 trials of a block have the same pair; allowed: at least 4, or null for no limit"
    assert (found.path, told in found.message) == ("schedule.max_same_pair_running", True)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            [("pause_s: 1.5", "ways: {two_hands: free_hand}")],
            "answers.ways.two_hands: given free_hand in two_hands, but both hands are on the beam; allowed: lifting, ",
        ),
        ([("schedule:", "interval: {standard: {velocity_mm_s: 0}}\nschedule:"), ("given_by: participant",
          "intervals: {left: 1}")], "interval: given 'interval', which is not a key here"),
    ],
)  # fmt: skip
def test_one_fault_is_reported_once(edit: Edit, changes: list[tuple[str, str]], fault: str) -> None:
    """Without its consequences."""
    (found,) = faults(edit(FILE, *changes))
    assert fault in found


def test_faults_of_all_files_are_reported_in_order(edit: Edit) -> None:
    """Faults in protocol, apparatus and texts, sorted by file, line and column."""
    edit(BEAM, ("gain_V_per_V: 25", "gain_V_per_V: x"))
    edit("texts/english.yaml", ("language: English", "language: ''"))
    file = edit(FILE, ("repetitions: 1", "repetitions: 0"), ("[C, E]", "[C, F]"), ("law: exact", "law: exakt"))
    with pytest.raises(InputError) as caught:
        Findings.read(file).experiment()
    places = [(Path(problem.file).name, problem.path) for problem in caught.value.problems]
    assert places == [
        ("beam_100x6x2.yaml", "amplifier.gain_V_per_V"),
        (FILE, "stimulus.law"),
        (FILE, "conditions.zone_pairs[2][1]"),
        (FILE, "schedule.repetitions"),
        ("english.yaml", "language"),
    ]


def test_a_wrong_entry_does_not_hide_another_fault(edit: Edit) -> None:
    """Each entry of a list is checked separately, in structure and against the apparatus."""
    found = faults(edit(FILE, (LEVELS, "[x, 600]"), (PAIRS, "[7, [A, F], [D, B]]")))
    assert len(found) == 5
    assert any("600 mm/s, above the safety limit" in each for each in found)
    assert any("'F', which is not a zone" in each for each in found)
    assert any("whose left zone D lies right of B" in each for each in found)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("trial_of: ", "trial_of: '{numbr} of {total}' #", "trial_of: given {numbr}, {total} in"),
        ("goodbye: ", "#goodbye: ", "goodbye: given nothing; allowed: text; add the missing key `goodbye`"),
        ("question: ", "question: 'Where {' #", "question: given 'Where {'"),
    ],
)
def test_a_text_that_would_fail_on_screen_is_a_fault(edit: Edit, old: str, new: str, fault: str) -> None:
    """Placeholders are checked against those that the window fills in."""
    file = edit(FILE)
    texts = file.parent / "texts" / "english.yaml"
    lines = texts.read_text(encoding="utf-8").splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith(old))
    # A text may run over several indented lines; its key's line and they go.
    rest = lines[start + 1 :]
    while rest and (rest[0].startswith(" ") or not rest[0]):
        rest.pop(0)
    value = [new] if new.endswith("#") else []
    texts.write_text("\n".join([*lines[:start], *value, *rest]) + "\n", encoding="utf-8")
    found = faults(file)
    assert len(found) == 1
    assert fault in found[0]


def test_key_names_are_those_of_the_window() -> None:
    """Pyglet's key symbols, as written by the window."""
    from modaltouch.window.screen import canonical_key

    pyglet_keys = {canonical_key(name) for name in _pyglet_key_names()}
    assert pyglet_keys == KEY_NAMES
    assert all(canonical_key(alias) == name for alias, name in AskedSection.KEY_ALIASES.items())


def _pyglet_key_names() -> list[str]:
    """Return pyglet's key symbols; its file is loaded alone, since the package needs a display."""
    package = importlib.util.find_spec("pyglet")
    assert package is not None
    assert package.origin is not None
    path = Path(package.origin).parent / "window" / "key.py"
    spec = importlib.util.spec_from_file_location("pyglet_key_names", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return list(module._key_names.values())


NONE = ("    right: [right, num_6]", "    right: [right, num_6]\n    none: [n]")


@pytest.mark.parametrize("language", ["english", "french"])
def test_the_answer_none_needs_its_label(edit: Edit, language: str) -> None:
    """A language file without it is reported by the check."""
    file = edit(FILE, NONE, ("texts/english.yaml", f"texts/{language}.yaml"))
    assert faults(file) == []
    texts = file.parent / "texts" / f"{language}.yaml"
    texts.write_text(re.sub(r"(?m)^none: .*\n", "", texts.read_text(encoding="utf-8")), encoding="utf-8")
    (found,) = faults(file)
    assert f"answers.keys.none: given no text `none` in {language}.yaml, which this needs" in found


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            [("practice_trials: 3", "catch_trials: 13\n  practice_trials: 3")],
            "catch_trials: given 13, but only 12 trials of",
        ),
        ([("practice_trials: 3", "catch_trials: -1\n  practice_trials: 3")], "catch_trials: given -1"),
        (
            [("    right: [right, num_6]", "    right: [right, num_6]\n    none: [left]")],
            "'left', which already means left",
        ),
    ],
)
def test_too_many_catch_trials_and_shared_keys_are_faults(
    edit: Edit, changes: list[tuple[str, str]], fault: str
) -> None:
    """A catch trial follows a driven one, so there are at most as many; a key gives one answer."""
    (found,) = faults(edit(FILE, *changes))
    assert fault in found


@pytest.mark.parametrize(
    ("keys", "place", "words"),
    [
        (
            "none: [f12]",
            "answers.keys.none[0]",
            "'f12', which already switches the outputs off (`answers.emergency_keys`)",
        ),
        ("none: [n, f12]", "answers.keys.none[1]", "a key with no other meaning; choose another"),
        (
            "none: [n]\n  continue_keys: [f12]",
            "answers.continue_keys[0]",
            "'f12', which switches the outputs off (`answers.emergency_keys`)",
        ),
        (
            "none: [f12]\n  emergency_keys: [f12]",
            "answers.keys.none[0]",
            "'f12', which already switches the outputs off",
        ),
        ("none: [f12]\n  emergency_keys: [q]", "answers.emergency_keys[0]", "'q', which ends a session that is paused"),
        ("none: [f12]\n  emergency_keys: [f11]", "", ""),
    ],
)
def test_an_emergency_key_with_another_meaning_is_a_fault(edit: Edit, keys: str, place: str, words: str) -> None:
    """The problem is at the line that was written, not at the default F12."""
    file = edit(FILE, ("    right: [right, num_6]", f"    right: [right, num_6]\n    {keys}"))
    found = faults(file)
    assert len(found) == bool(place)
    if place:
        key = place.partition("[")[0].rpartition(".")[2]
        lines = file.read_text(encoding="utf-8").splitlines()
        line = next(n for n, text in enumerate(lines, 1) if text.strip().startswith(f"{key}: ["))
        assert f" {place}: " in found[0]
        assert words in found[0]
        assert f":{line}:" in found[0]


def test_a_short_pause_becomes_the_time_that_hands_need(edit: Edit) -> None:
    """Where a hand that rests on the beam presses the key, and only there."""
    file = edit("differentiated_stimulation.yaml", ("pause_s: 1.5", "pause_s: 1.0"))
    answers = Findings.read(file).experiment().protocol.answers
    assert (answers.pause("one_hand"), answers.pause("two_hands")) == (1.0, 1.5)


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        (FILE, "  zone_pairs:", "  zone_pair:", "zone_pair: given 'zone_pair', which is not a key here"),
        ("comparison_2ifc.yaml", "second: 2}", "second: 3}", "answers.intervals.second: given 3, but a trial has 2"),
    ],
)
def test_what_follows_from_a_fault_is_not_reported(edit: Edit, name: str, old: str, new: str, said: str) -> None:
    """Neither that there are no zones, nor that no answer names the second interval."""
    (found,) = faults(edit(name, (old, new)))
    assert said in found


def test_a_misspelt_section_is_reported_once(edit: Edit) -> None:
    """Not also as a missing section."""
    (said,) = faults(edit(FILE, ("\nconditions:", "\ncondition:")))
    assert "condition: given 'condition', which is not a key here" in said
    assert said.endswith("did you mean 'conditions'?")
