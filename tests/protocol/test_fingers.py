"""Files of fingers: contents, faults with positions, and how a protocol refers to them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.protocol import Experiment, Findings, InputError, Sources
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.placements import FingersFile
from modaltouch.protocol.schedule import Schedule
from modaltouch.protocol.trial import Condition

Edit = Callable[..., Path]
FILE, BEAM = "differentiated_stimulation.yaml", "apparatus/beam_100x6x2.yaml"
FOCUS = "  focus: C  "
LIGHT = "{mass_g: 0.1, damping_N_s_per_m: 0.5}"
ALL_THREE = f"""\
fingers:
  left:
    index: {{mass_g: 0.2, damping_N_s_per_m: 1, stiffness_N_per_mm: 2}}
  right:
    index: {LIGHT}
    middle: {{mass_g: 0.3, damping_N_s_per_m: 0, contact_width_mm: 8}}
"""


@pytest.fixture
def named(edit: Edit) -> Callable[..., Findings]:
    """Return a function that reads the paper's protocol with a value of `stimulus.fingers`, and files beside it."""

    def read(word: str, *changes: tuple[str, str], **files: str) -> Findings:
        protocol = edit(FILE, (FOCUS, f"  fingers: {word}\n{FOCUS}"), *changes)
        for name, text in files.items():
            (protocol.parent / f"{name}.yaml").write_text(text, encoding="utf-8")
        return Findings.read(protocol)

    return read


def said(findings: Findings) -> list[str]:
    """Return the faults, with file names relative to the protocol."""
    assert findings.protocol is not None
    folder = str(findings.protocol.source.path.parent) + "/"
    return [str(problem).replace(folder, "") for problem in findings.problems]


def test_the_typical_finger_has_sources_and_a_spread() -> None:
    """0.08 g, 0.5 N s/m and 0.5 N/mm for every finger."""
    typical = FingersFile.read("typical")
    finger = typical.of("left index")
    assert finger is not None
    assert finger is typical.of("right middle")
    assert (finger.mass_g, finger.damping_N_s_per_m, finger.stiffness_N_per_mm) == (0.08, 0.5, 0.5)
    assert len(typical.sources) == 4
    assert min(typical.spread.mass, typical.spread.damping, typical.spread.stiffness) >= 0.5


def test_fingers_are_converted_to_si_units(tmp_path: Path) -> None:
    """The file has grams, newtons per millimetre, millimetres and milliseconds."""
    file = tmp_path / "mine.yaml"
    maxwell = "[{stiffness_N_per_mm: 0.4, relaxation_ms: 70}, {stiffness_N_per_mm: 3, relaxation_ms: 0.02}]"
    values = "mass_g: 0.15, damping_N_s_per_m: 0.7, stiffness_N_per_mm: 0.5, contact_width_mm: 12"
    file.write_text(f"fingers: {{{values}, maxwell: {maxwell}}}\n", encoding="utf-8")
    section = FingersFile.read(file).of("right index")
    assert section is not None
    finger = section.at(-0.04)
    found = [finger.position, finger.mass, finger.damping, finger.stiffness, finger.width, *np.ravel(finger.maxwell)]
    assert found == pytest.approx([-0.04, 1.5e-4, 0.7, 500, 0.012, 400, 0.07, 3000, 2e-5], rel=1e-12)


def test_fingers_by_hand_follow_the_condition(named: Callable[..., Findings]) -> None:
    """On the right hand the index is left of the middle finger; two index fingers are another placement."""
    findings = named("mine.yaml", mine=ALL_THREE)
    assert findings.problems == ()
    assert findings.placements is not None
    placed = findings.placements.all()
    masses = {name: [(f.position, round(f.mass * 1e3, 12)) for f in laid] for name, laid in placed.items()}
    assert masses == {
        "A-C": [(-0.04, 0.1), (0.0, 0.3)],
        "B-D": [(-0.02, 0.1), (0.02, 0.3)],
        "C-E": [(0.0, 0.1), (0.04, 0.3)],
        "A-C left index, right index": [(-0.04, 0.2), (0.0, 0.1)],
        "B-D left index, right index": [(-0.02, 0.2), (0.02, 0.1)],
        "C-E left index, right index": [(0.0, 0.2), (0.04, 0.1)],
    }
    assert [finger.width for finger in placed["A-C"]] == [0.01, 0.008]
    assert findings.placement(Condition("one_hand", "A", "C", 80.0)) == "A-C"
    assert findings.placement(Condition("two_hands", "A", "C", 80.0)) == "A-C left index, right index"


def test_a_turned_beam_has_its_zones_under_other_fingers(named: Callable[..., Findings]) -> None:
    """Zone C is then on the participant's left, under the index finger, and A under the middle finger."""
    turn = ("  hand: right", "  placements: [normal, mirrored]\n  hand: right")
    findings = named("mine.yaml", turn, mine=ALL_THREE)
    assert findings.placements is not None
    placed = findings.placements.all()
    masses = {name: [round(f.mass * 1e3, 12) for f in laid] for name, laid in placed.items() if name.startswith("A-C")}
    assert masses == {
        "A-C": [0.1, 0.3],
        "A-C right middle, right index": [0.3, 0.1],
        "A-C left index, right index": [0.2, 0.1],
        "A-C right index, left index": [0.1, 0.2],
    }
    turned = Condition("one_hand", "C", "A", 80.0, placement="mirrored")
    assert findings.placement(turned) == "A-C right middle, right index"
    for trial in Schedule.draw(findings.experiment().protocol, "p01", 1).trials:
        assert findings.placement(trial.condition) in placed


def test_identical_fingers_have_one_placement_per_pair(named: Callable[..., Findings]) -> None:
    """For either hand and either orientation."""
    findings = named("typical")
    assert findings.placements is not None
    assert list(findings.placements.all()) == ["A-C", "B-D", "C-E"]
    for condition in (Condition("two_hands", "A", "C", 80.0), Condition("one_hand", "C", "A", 80.0, "mirrored")):
        assert findings.placement(condition) == "A-C"


def test_missing_fingers_are_reported(named: Callable[..., Findings]) -> None:
    """At the file that lacks them; the left middle finger is not needed."""
    findings = named("mine.yaml", mine=f"fingers:\n  right:\n    index: {LIGHT}\n")
    assert said(findings) == [
        "mine.yaml:1:1: fingers: given no left index finger; allowed: every finger that touches the beam; "
        "add the left index",
        "mine.yaml:1:1: fingers: given no right middle finger; allowed: every finger that touches the beam; "
        "add the right middle",
    ]


def test_swapped_placements_need_the_other_hand(named: Callable[..., Findings]) -> None:
    """Its middle finger is on the beam in half of the trials."""
    swap = ("  hand: right", "  placements: [normal, swapped]\n  hand: right")
    (problem,) = said(named("mine.yaml", swap, mine=ALL_THREE))
    assert "given no left middle finger" in problem


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        (
            "fingers: {mass_g: -1, damping_N_s_per_m: .nan, stiffness_N_per_mm: soft}\n",
            [
                "1:19: fingers.mass_g: given -1; allowed: a number [g] of at least 0",
                "1:42: fingers.damping_N_s_per_m: given .nan, which is not finite; allowed: a number [N s/m] of at "
                "least 0",
                "1:68: fingers.stiffness_N_per_mm: given 'soft'; allowed: a number [N/mm] of at least 0",
            ],
        ),
        (
            "fingers: {mas_g: 1, damping_N_s_per_m: 1}\nspread: {mass: 4}\ncolour: red\n",
            [
                "1:11: fingers.mas_g: given 'mas_g', which is not a key here; allowed: mass_g, damping_N_s_per_m, "
                "stiffness_N_per_mm, contact_width_mm, maxwell, second_mass, offset_mm, left, right; did you mean "
                "'mass_g'?",
                "2:16: spread.mass: given 4; allowed: a number of at least 0, at most 3",
                "3:1: colour: given 'colour', which is not a key here; allowed: description, sources, fingers, spread, "
                "placement_spread, trial_spread, probes",
            ],
        ),
        (
            f"fingers:\n  right:\n    index: {{mass_g: 0.1}}\n    midle: {LIGHT}\n",
            [
                "3:5: fingers.right.index.damping_N_s_per_m: given nothing; allowed: a number [N s/m] of at least 0; "
                "add the missing key `damping_N_s_per_m`",
                "4:5: fingers.right.midle: given 'midle', which is not a key here; allowed: index, middle, ring, "
                "little, thumb; did you mean 'middle'?",
            ],
        ),
        (
            "fingers: {mass_g: 0.1, damping_N_s_per_m: 0.5, contact_width_mm: 0,\n"
            "  maxwell: [{stiffness_N_per_mm: 0, relaxation_ms: 1}, {stiffness_N_per_mm: 1}]}\n",
            [
                "1:66: fingers.contact_width_mm: given 0; allowed: a number [mm] above 0, at most 40",
                "2:34: fingers.maxwell[0].stiffness_N_per_mm: given 0; allowed: a number [N/mm] above 0",
                "2:56: fingers.maxwell[1].relaxation_ms: given nothing; allowed: a number [ms] above 0; add the "
                "missing key `relaxation_ms`",
            ],
        ),
        (
            "fingers: 3\n",
            [
                "1:10: fingers: given 3; allowed: a mapping with the keys mass_g, damping_N_s_per_m, "
                "stiffness_N_per_mm, contact_width_mm, maxwell, second_mass, offset_mm or a mapping with the keys "
                "left, right"
            ],
        ),
    ],
    ids=["numbers", "keys", "hands", "maxwell", "neither"],
)
def test_every_fault_of_a_file_has_its_position(tmp_path: Path, text: str, faults: list[str]) -> None:
    """For one finger for all, and for fingers by hand."""
    file = tmp_path / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="mine.yaml") as caught:
        FingersFile.read(file)
    assert sorted(str(problem) for problem in caught.value.problems) == sorted(f"{file}:{fault}" for fault in faults)


def test_without_fingers_the_beam_is_untouched(named: Callable[..., Findings], shipped: Path) -> None:
    """With `none`, or without the key."""
    for findings in (named("none"), Findings.read(shipped / FILE)):
        assert findings.problems == ()
        assert findings.fingers is None
        assert findings.placements is None
        assert findings.placement(Condition("one_hand", "A", "C", 80.0)) == ""
        assert "fingers" not in findings.experiment().sources.as_dict()


def test_an_unknown_name_is_refused_at_its_key(named: Callable[..., Findings]) -> None:
    """With the allowed values and a suggestion."""
    findings = named("typicl")
    assert findings.protocol is not None
    beside = findings.protocol.source.path.parent / "typicl"
    assert [str(problem) for problem in findings.problems] == [
        f"{beside.parent / FILE}:11:12: stimulus.fingers: given 'typicl', a file that does not exist ({beside}); "
        "allowed: none, measured, a YAML file that exists and can be read, or one of typical; did you mean 'typical'?"
    ]


def test_a_file_takes_precedence_over_a_shipped_name(named: Callable[..., Findings], edit: Edit) -> None:
    """Paths are tried first."""
    findings = named("typical")
    assert findings.fingers is not None
    assert findings.fingers.value == FingersFile.read("typical")
    assert findings.protocol is not None
    own = findings.protocol.source.path.with_name("typical")
    own.write_text(f"fingers: {LIGHT}\n", encoding="utf-8")
    found = Findings.read(findings.protocol.source.path).fingers
    assert found is not None
    assert found.source.path == own
    finger = None if found.value is None else found.value.of("left index")
    assert finger is not None
    assert finger.mass_g == 0.1


def test_faults_of_a_named_file_are_reported_in_that_file(named: Callable[..., Findings]) -> None:
    """Not at the key in the protocol."""
    assert said(named("mine.yaml", mine="fingers: {mass_g: heavy, damping_N_s_per_m: 1}\n")) == [
        "mine.yaml:1:19: fingers.mass_g: given 'heavy'; allowed: a number [g] of at least 0"
    ]


def test_an_invalid_encoding_is_reported_at_its_byte(named: Callable[..., Findings]) -> None:
    """Not at the key that names the file."""
    findings = named("mine.yaml", mine="")
    assert findings.protocol is not None
    protocol = findings.protocol.source.path
    protocol.with_name("mine.yaml").write_bytes(b"fingers:\n  mass_g: \xff\n")
    (problem,) = said(Findings.read(protocol))
    assert problem.startswith("mine.yaml:2:11: given byte 0xff, which is not UTF-8")


def test_the_papers_law_does_not_support_fingers(named: Callable[..., Findings]) -> None:
    """Equations (6) and (7) drive each mode separately."""
    (problem,) = said(named("typical", ("  law: exact ", "  law: paper ")))
    assert problem == (
        f"{FILE}:11:12: stimulus.fingers: given typical, which the paper's law does not support; allowed: none, or the "
        "law exact; leave it out"
    )


def test_a_calibration_cannot_be_combined_with_fingers(named: Callable[..., Findings], tmp_path: Path) -> None:
    """Its corrections hold for the untouched beam that was measured."""
    findings = named("typical")
    assert findings.protocol is not None
    calibration = tmp_path / "calibration.yaml"
    calibration.write_text("calibration: 1\n", encoding="utf-8")
    problems = said(Findings.read(findings.protocol.source.path, calibration))
    assert (
        f"{FILE}:11:12: stimulus.fingers: given typical, with a calibration, which is for the untouched beam; "
        "allowed: none; leave one of them out"
    ) in problems


def test_other_fingers_may_replace_those_of_the_protocol(named: Callable[..., Findings], tmp_path: Path) -> None:
    """As with `check --fingers`; a faulty file raises all its faults."""
    findings = named("typical")
    other = tmp_path / "heavy.yaml"
    other.write_text("fingers: {mass_g: 0.3, damping_N_s_per_m: 2}\n", encoding="utf-8")
    placements = findings.under(str(other)).placements
    assert placements is not None
    assert {round(finger.mass * 1e3, 12) for laid in placements.all().values() for finger in laid} == {0.3}
    other.write_text(f"fingers: {{right: {{index: {LIGHT}}}}}\n", encoding="utf-8")
    with pytest.raises(InputError, match="no left index finger"):
        findings.under(str(other))
    with pytest.raises(InputError, match="or one of typical"):
        findings.under("nobody")


def test_the_record_keeps_the_file_of_fingers(named: Callable[..., Findings]) -> None:
    """They are restored without the file."""
    findings = named("mine.yaml", mine=ALL_THREE)
    kept = findings.experiment().sources.as_dict()
    assert kept["fingers"]["text"] == ALL_THREE
    assert findings.fingers is not None
    findings.fingers.source.path.write_text("fingers: nothing\n", encoding="utf-8")
    sources = Sources.from_dict(kept)
    restored = Findings.restored(sources)
    assert restored.problems == ()
    assert restored.fingers is not None
    assert restored.fingers.value == findings.fingers.value
    assert restored.experiment().sources.as_dict() == kept
    assert isinstance(restored.experiment(), Experiment)


def test_the_record_has_no_path_of_shipped_fingers(named: Callable[..., Findings], shipped: Path) -> None:
    """A published record must not contain the path of the installation."""
    kept = named("typical").experiment().sources.as_dict()["fingers"]
    assert kept["path"] == "typical.yaml"
    assert kept["text"] == (shipped / "fingers" / "typical.yaml").read_text(encoding="utf-8")


def test_drawn_fingers_have_the_spread_of_the_file(tmp_path: Path) -> None:
    """Logarithms have its standard deviations; without a spread all fingers are identical."""
    typical = FingersFile.read("typical")
    finger = typical.of("right index")
    assert finger is not None
    rng = np.random.default_rng(1)
    drawn = [typical.spread.drawn(finger, rng) for _ in range(2000)]
    logs = np.log([[each.mass_g, each.damping_N_s_per_m, each.stiffness_N_per_mm] for each in drawn])
    np.testing.assert_allclose(logs.mean(axis=0), np.log([0.08, 0.5, 0.5]), atol=4 * 0.8 / 2000**0.5)
    np.testing.assert_allclose(logs.std(axis=0), 0.8, rtol=0.06)
    file = tmp_path / "alike.yaml"
    file.write_text(f"fingers: {LIGHT}\n", encoding="utf-8")
    alike = FingersFile.read(file)
    same = alike.of("right index")
    assert same is not None
    assert alike.spread.drawn(same, rng) == same


def test_the_mass_of_the_beam_defaults_to_aluminium(edit: Edit) -> None:
    """2700 kg/m^3 x 100 mm x 6 mm x 2 mm = 3.24 g, without patches."""
    stated = Apparatus.read(edit(BEAM))
    assert stated.beam.mass == pytest.approx(3.3e-3, rel=1e-12)
    assert stated.modal_model().mass == stated.beam.mass
    plain = Apparatus.read(edit(BEAM, ("  mass_g: 3.3  ", "  mass_g: null  ")))
    assert plain.beam.mass == pytest.approx(3.24e-3, rel=1e-12)


def test_the_mass_does_not_invalidate_a_calibration(edit: Edit) -> None:
    """Measurements of the untouched beam do not depend on it, but on the length."""
    before = Apparatus.read(edit(BEAM)).measured_hash
    assert Apparatus.read(edit(BEAM, ("  mass_g: 3.3  ", "  mass_g: 4.1  "))).measured_hash == before
    assert Apparatus.read(edit(BEAM, ("  mass_g: 4.1  ", "  mass_g: null  "))).measured_hash == before
    assert Apparatus.read(edit(BEAM, ("  length_mm: 100", "  length_mm: 101"))).measured_hash != before
