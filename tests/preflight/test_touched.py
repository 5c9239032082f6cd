"""`check` with fingers on the beam, against an independent coupled model driven with the exported voltages."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from ruamel.yaml import YAML
from scipy.integrate import simpson
from scipy.linalg import expm
from scipy.optimize import brentq
from typer.testing import CliRunner, Result

from modaltouch.cli import app
from modaltouch.preflight import Preflight, examine
from modaltouch.preflight.single_design import errors_of_gains, zone_points
from modaltouch.protocol import InputError

Edit = Callable[..., Path]
FloatArray = NDArray[np.float64]
PAPER = "differentiated_stimulation"
PROTOCOLS = Path(__file__).parents[2] / "protocols"
BEAM = PROTOCOLS / "apparatus" / "beam_100x6x2.yaml"
ZONE = {"A": -0.04, "B": -0.02, "C": 0.0, "D": 0.02, "E": 0.04}
PAIRS = ("A-C", "B-D", "C-E")
FOCUS, LIMIT = 0.025, 250.0

ONE = {
    "light": {"mass_g": 0.08, "damping_N_s_per_m": 0.45, "stiffness_N_per_mm": 0.8},
    "heavy": {"mass_g": 0.3, "damping_N_s_per_m": 2, "stiffness_N_per_mm": 2},
    "overdamped": {"mass_g": 0.15, "damping_N_s_per_m": 30, "contact_width_mm": 14},
    "relaxing": {
        "mass_g": 0.1,
        "damping_N_s_per_m": 0.5,
        "maxwell": [{"stiffness_N_per_mm": 0.8, "relaxation_ms": 1}, {"stiffness_N_per_mm": 3, "relaxation_ms": 0.02}],
    },
}
"""Fingers of which all are alike."""

BY_HAND = {
    "left": {"index": {"mass_g": 0.2, "damping_N_s_per_m": 1, "stiffness_N_per_mm": 2}},
    "right": {
        "index": {"mass_g": 0.1, "damping_N_s_per_m": 0.5, "stiffness_N_per_mm": 0.3},
        "middle": {"mass_g": 0.3, "damping_N_s_per_m": 0.2, "contact_width_mm": 8},
    },
}


def run(*words: object) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


def checked(*words: object) -> dict[str, Any]:
    """Return what ``check --json`` prints."""
    done = run("check", *words, "--json")
    assert done.exit_code == 0, done.stderr
    values: dict[str, Any] = json.loads(done.stdout)
    return values


def written(folder: Path, fingers: dict[str, Any]) -> Path:
    """Write a file of fingers and return its path."""
    file = folder / "mine.yaml"
    file.write_text(f"fingers: {json.dumps(fingers)}\n", encoding="utf-8")  # JSON is valid YAML
    return file


def shape(label: int, x: FloatArray) -> FloatArray:
    """Shape of a symmetric mode of a free-free beam of 100 mm, with unit mean square."""
    if label == 1:
        return np.ones_like(x)
    middle = (2 * label - 3) * np.pi / 2
    root = brentq(lambda r: np.cos(r) - 1 / np.cosh(r), middle - 0.1, middle + 0.1, xtol=1e-14)
    y = root * x / 0.1
    return np.asarray(np.cos(y) / np.cos(root / 2) + np.cosh(y) / np.cosh(root / 2))


@dataclass
class Response:
    """Modal velocities at the start of each sample, the sample at the focus, and the force on each finger."""

    velocity: FloatArray
    at_focus: int
    force: list[FloatArray]


class CoupledBeam:
    """The shipped beam under fingers, from its file: M eta'' + C eta' + K eta + Maxwell terms = G v."""

    def __init__(self, fingers: list[tuple[float, dict[str, Any]]]) -> None:
        values = YAML(typ="safe").load(PROTOCOLS / "apparatus" / "beam_100x6x2.yaml")
        modes, mass = values["modes"], values["beam"]["mass_g"] * 1e-3
        self.labels = [mode["label"] for mode in modes]
        w = 2 * np.pi * np.array([mode["natural_frequency_Hz"] for mode in modes])
        ratio = np.array([mode["damping_ratio"] for mode in modes])
        self.gain = np.array(
            [[mode["gain_mm_s2_per_V"].get(name, 0) * 1e-3 for name in ("centre", "side")] for mode in modes]
        )
        n = w.size
        inertia, damping, spring = np.eye(n), np.diag(2 * ratio * w), np.diag(w**2)
        self.terms: list[tuple[FloatArray, float]] = []
        self.fingers: list[tuple[FloatArray, dict[str, Any], list[int]]] = []
        for centre, each in fingers:
            half = each.get("contact_width_mm", 10) * 0.5e-3
            x = np.linspace(max(centre - half, -0.05), min(centre + half, 0.05), 801)
            at = np.array([shape(label, x) for label in self.labels])
            spread = simpson(at[:, None] * at[None], x=x, axis=2) / (x[-1] - x[0]) / mass
            inertia = inertia + each["mass_g"] * 1e-3 * spread
            damping = damping + each["damping_N_s_per_m"] * spread
            spring = spring + each.get("stiffness_N_per_mm", 0) * 1e3 * spread
            places = []
            for term in each.get("maxwell", ()):
                places.append(len(self.terms))
                self.terms.append((term["stiffness_N_per_mm"] * 1e3 * spread, term["relaxation_ms"] * 1e-3))
            self.fingers.append((simpson(at, x=x, axis=1) / (x[-1] - x[0]), each, places))
        size = n * (2 + len(self.terms))
        self.matrix, self.force, self.n = np.zeros((size, size)), np.zeros((size, 2)), n
        push = np.linalg.inv(inertia)
        self.matrix[:n, n : 2 * n] = np.eye(n)
        self.matrix[n : 2 * n, :n], self.matrix[n : 2 * n, n : 2 * n] = -push @ spring, -push @ damping
        for place, (stiffness, time) in enumerate(self.terms):
            own = slice((2 + place) * n, (3 + place) * n)
            self.matrix[n : 2 * n, own] = -push @ stiffness
            self.matrix[own, n : 2 * n], self.matrix[own, own] = np.eye(n), -np.eye(n) / time
        self.force[n : 2 * n] = push @ self.gain

    def driven(self, time: FloatArray, voltage: FloatArray) -> Response:
        """Integrate exactly from sample to sample, each held until the next."""
        hold, (n, size) = time[1] - time[0], (self.n, len(self.matrix))
        whole = np.zeros((size + 2, size + 2))
        whole[:size, :size], whole[:size, size:] = self.matrix, self.force
        grown = expm(whole * hold)
        decay, push = grown[:size, :size], grown[:size, size:]
        states = self._stepped(decay, push, voltage)
        moved, velocity = states[:n], states[n : 2 * n]
        sped = (self.matrix @ states + self.force @ voltage)[n : 2 * n]
        forces = []
        for mean, each, places in self.fingers:
            force = each["mass_g"] * 1e-3 * (mean @ sped) + each["damping_N_s_per_m"] * (mean @ velocity)
            force += each.get("stiffness_N_per_mm", 0) * 1e3 * (mean @ moved)
            for place, term in zip(places, each.get("maxwell", ()), strict=True):
                force += term["stiffness_N_per_mm"] * 1e3 * (mean @ states[(2 + place) * n : (3 + place) * n])
            forces.append(force)
        return Response(velocity, round((FOCUS - time[0]) / hold), forces)

    @staticmethod
    def _stepped(decay: FloatArray, push: FloatArray, voltage: FloatArray, block: int = 250) -> FloatArray:
        """States at the start of each sample: many blocks in parallel, from the states at their starts."""
        blocks = voltage.reshape(2, -1, block)
        ends = np.zeros((len(decay), blocks.shape[1]))
        for step in range(block):
            ends = decay @ ends + push @ blocks[:, :, step]
        over, starts = np.linalg.matrix_power(decay, block), np.zeros_like(ends)
        for place in range(1, blocks.shape[1]):
            starts[:, place] = over @ starts[:, place - 1] + ends[:, place - 1]
        states = np.empty((len(decay), *blocks.shape[1:]))
        for step in range(block):
            states[:, :, step] = starts
            starts = decay @ starts + push @ blocks[:, :, step]
        return states.reshape(len(decay), -1)

    def speeds(self, response: Response) -> tuple[dict[str, float], dict[str, float]]:
        """Velocity at the focusing instant and peak speed at the centre of each zone [mm/s]."""
        shapes = np.array([shape(label, np.array(list(ZONE.values()))) for label in self.labels])
        history = shapes.T @ response.velocity * 1e3
        at_focus, peak = history[:, response.at_focus], np.abs(history).max(axis=1)
        return dict(zip(ZONE, at_focus, strict=True)), dict(zip(ZONE, peak, strict=True))


def assert_agrees(found: dict[str, Any], beam: CoupledBeam, drive: tuple[FloatArray, FloatArray], level: float) -> None:
    """Compare all figures of a placement within 0.5 % of the level, or of the figure."""
    response = beam.driven(*drive)
    at_focus, peak = beam.speeds(response)
    assert found["zone_at_focus_mm_s"] == pytest.approx(at_focus, rel=0, abs=5e-3 * level)
    assert found["zone_peak_mm_s"] == pytest.approx(peak, rel=5e-3)
    assert found["attainable_mm_s"] == pytest.approx(at_focus["C"] * LIMIT / np.abs(drive[1]).max(), rel=5e-3)
    assert found["pull_N"] == pytest.approx(max(np.abs(force).max() for force in response.force), rel=5e-3)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Times and voltages of the demonstration and of the paper's protocol, at 200 mm/s."""
    found = {}
    for name in ("demo", PAPER):
        file = tmp_path_factory.mktemp("drive") / "drive.npz"
        checked(name, "--export", file)
        with np.load(file) as arrays:
            found[name] = arrays["time_s"], arrays["voltage_V"]
    return found


@pytest.fixture(scope="module")
def under_fingers(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that writes the paper's protocol for typical fingers with given levels."""

    def write(levels: str) -> Path:
        text = (PROTOCOLS / f"{PAPER}.yaml").read_text(encoding="utf-8")
        for old, new in (
            ("  focus: C  ", "  fingers: typical\n  focus: C  "),
            ("[80, 100, 150, 200]", levels),
            ("apparatus: apparatus/", f"apparatus: {PROTOCOLS}/apparatus/"),
            ("texts: texts/", f"texts: {PROTOCOLS}/texts/"),
        ):
            assert text.count(old) == 1
            text = text.replace(old, new)
        file = tmp_path_factory.mktemp("protocol") / "designed.yaml"
        file.write_text(text, encoding="utf-8")
        return file

    return write


@pytest.fixture(scope="module")
def designed(under_fingers: Callable[[str], Path]) -> Preflight:
    """The paper's protocol for typical fingers at attainable levels."""
    return examine(under_fingers("[40, 60, 80, 100]")).require()


@pytest.mark.parametrize("kind", ONE)
def test_levels_under_equal_fingers_agree_with_the_independent_model(
    tmp_path: Path, exported: dict[str, tuple[FloatArray, FloatArray]], kind: str
) -> None:
    """All pairs of the paper's protocol are compared, at its lowest and highest level."""
    time, voltage = exported[PAPER]
    rows = checked(PAPER, "--fingers", written(tmp_path, ONE[kind]))["stimuli"]
    assert [row["velocity_mm_s"] for row in rows] == [80, 100, 150, 200]
    beams = {
        pair: CoupledBeam([(ZONE[zone], ONE[kind]) for zone in pair.split("-")])
        for pair in (PAIRS if kind == "light" else PAIRS[:2])
    }
    for row in rows:
        assert list(row["touched"]) == list(PAIRS)
        assert row["touched"]["C-E"]["pull_N"] == pytest.approx(row["touched"]["A-C"]["pull_N"], rel=1e-9)
    for row in (rows[0], rows[-1]):
        level = row["velocity_mm_s"]
        for pair, beam in beams.items():
            assert_agrees(row["touched"][pair], beam, (time, voltage * level / 200), level)


def test_individual_fingers_have_a_row_for_each_placement(
    tmp_path: Path, exported: dict[str, tuple[FloatArray, FloatArray]]
) -> None:
    """Index and middle finger of one hand, then both index fingers, each with its own parameters."""
    left, index, middle = BY_HAND["left"]["index"], BY_HAND["right"]["index"], BY_HAND["right"]["middle"]
    rows = checked("demo", "--fingers", written(tmp_path, BY_HAND))["stimuli"]
    expected = dict.fromkeys(PAIRS, (index, middle))
    expected |= {f"{pair} left index, right index": (left, index) for pair in PAIRS}
    for row in rows:
        assert set(row["touched"]) == set(expected)
    for place, fingers in expected.items():
        zones = place.split(" ")[0].split("-")
        beam = CoupledBeam([(ZONE[zone], finger) for zone, finger in zip(zones, fingers, strict=True)])
        assert_agrees(rows[-1]["touched"][place], beam, exported["demo"], 200)


def test_an_untouched_beam_is_reported_as_untouched() -> None:
    """The effect of typical fingers on the highest level is given, and omitted with `--fingers none`."""
    assert "touched" not in checked("demo")["stimuli"][0]
    plain = " ".join(run("check", "demo").stdout.split())
    found = checked("demo", "--fingers", "typical")["stimuli"][-1]["touched"]
    said = ", ".join(f"{found[pair]['zone_at_focus_mm_s']['C']:.0f} ({pair})" for pair in PAIRS)
    assert f"untouched beam: with typical fingers the level at C would be {said} mm/s instead of 200" in plain
    alone = run("check", "demo", "--fingers", "none")
    assert alone.exit_code == 0
    assert "untouched beam" not in alone.stdout
    assert "fingers" not in alone.stdout


def test_the_table_shows_every_level_under_every_pair() -> None:
    """A wide terminal has one row each, and the pulling force is explained."""
    done = CliRunner().invoke(app, ["check", "demo", "--fingers", "typical"], env={"COLUMNS": "160"})
    found = checked("demo", "--fingers", "typical")["stimuli"]
    lines = [[cell.strip() for cell in line.strip("│").split("│")] for line in done.stdout.splitlines()]
    rows = {(row[0], row[1]): row[2:] for row in lines if len(row) == 10 and row[1] in PAIRS}
    assert set(rows) == {(level, pair) for level in ("80", "200") for pair in PAIRS}
    for row in found:
        for pair, each in row["touched"].items():
            peaks = [f"{speed:.0f}" for speed in each["zone_peak_mm_s"].values()]
            others = [f"{each['zone_at_focus_mm_s']['C']:.0f}", f"{each['attainable_mm_s']:.0f}"]
            assert rows[f"{row['velocity_mm_s']:g}", pair] == [*peaks, *others, f"{each['pull_N']:.2f}"]
    assert "a finger that presses with less force lifts off" in " ".join(done.stdout.split())


def test_the_export_has_the_voltages_of_the_highest_level(
    exported: dict[str, tuple[FloatArray, FloatArray]],
) -> None:
    """125,000 samples of 0.4 us from 0; their peaks are those that check prints."""
    time, voltage = exported[PAPER]
    assert (time.shape, voltage.shape) == ((125_000,), (2, 125_000))
    assert time[0] == 0
    np.testing.assert_allclose(np.diff(time), 4e-7, rtol=1e-6)
    peaks = checked(PAPER)["stimuli"][-1]["peak_drive_V"]
    assert np.abs(voltage).max(axis=1) == pytest.approx([peaks["1"], peaks["2"]], rel=1e-12)


def test_exported_samples_start_on_the_generators_clock(under_fingers: Callable[[str], Path], tmp_path: Path) -> None:
    """131,072 samples in 50 ms are held for 95 or 96 clock periods of 4 ns (tm_devices: 250 MS/s)."""
    protocol = under_fingers("[40]")
    protocol.write_text(protocol.read_text("utf-8").replace("n_samples: 125000", "n_samples: 131072"), "utf-8")
    checked(protocol, "--export", tmp_path / "drive.npz")
    with np.load(tmp_path / "drive.npz") as arrays:
        clocks = np.diff(arrays["time_s"]) / 4e-9
    assert set(np.round(clocks)) == {95, 96}
    np.testing.assert_allclose(clocks, np.round(clocks), atol=1e-3)


def test_several_designs_are_exported_under_their_names(tmp_path: Path) -> None:
    """Each of two stimuli has its voltages; those of the first are also in `voltage_V`."""
    checked("two_fields", "--export", tmp_path / "drive.npz")
    with np.load(tmp_path / "drive.npz") as arrays:
        assert set(arrays) == {"time_s", "voltage_V", "voltage_V_sharp", "voltage_V_blunt"}
        assert (arrays["voltage_V"] == arrays["voltage_V_sharp"]).all()
        assert (arrays["voltage_V"] != arrays["voltage_V_blunt"]).any()


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--export", "drive.csv"), 2, "given --export drive.csv; allowed: a file whose name ends with .npz"),
        (
            ("--export", "nowhere/drive.npz"),
            4,
            "nowhere/drive.npz: cannot be written (No such file or directory); give",
        ),
        (("--fingers", "nobody"), 2, "given a file that does not exist; allowed: a YAML file"),
    ],
)
def test_invalid_export_and_finger_files_are_refused(words: tuple[str, str], status: int, said: str) -> None:
    """Each has its exit status, and the message gives the value and what is allowed."""
    done = run("check", "demo", *words)
    assert done.exit_code == status
    assert said in " ".join(done.stderr.replace("│", " ").split())


def test_a_faulty_file_of_fingers_is_reported_with_its_place(tmp_path: Path) -> None:
    """`--json` gives file, line and key."""
    file = written(tmp_path, {"mass_g": -1, "damping_N_s_per_m": 0.5})
    done = run("check", "demo", "--fingers", file, "--json")
    assert done.exit_code == 2
    (problem,) = json.loads(done.stdout)["problems"]
    assert (problem["file"], problem["line"], problem["path"]) == (str(file), 1, "fingers.mass_g")


def test_a_design_for_fingers_reaches_its_level(designed: Preflight) -> None:
    """At C, under the fingers of every pair, within 1e-6."""
    rows = designed.as_dict()["stimuli"]
    assert [row["velocity_mm_s"] for row in rows] == [40, 60, 80, 100]
    for row in rows:
        assert list(row["touched"]) == list(PAIRS)
        for pair in PAIRS:
            at_focus = row["touched"][pair]["zone_at_focus_mm_s"]["C"]
            assert at_focus == pytest.approx(row["velocity_mm_s"], rel=1e-6), pair


def test_the_independent_model_confirms_a_design_for_fingers(
    under_fingers: Callable[[str], Path], tmp_path: Path, designed: Preflight
) -> None:
    """It is driven with the voltages of each placement, under the fingers of the shipped file."""
    done = run("check", under_fingers("[40, 60, 80, 100]"), "--export", tmp_path / "drive.npz")
    assert done.exit_code == 0, done.stderr
    assert "untouched beam" not in done.stdout
    typical = YAML(typ="safe").load(PROTOCOLS / "fingers" / "typical.yaml")["fingers"]
    found = designed.as_dict()["stimuli"][-1]["touched"]
    with np.load(tmp_path / "drive.npz") as arrays:
        assert set(arrays) == {"time_s", "voltage_V", *(f"voltage_V_{pair}" for pair in PAIRS)}
        for pair in PAIRS:
            drive = arrays["time_s"], arrays[f"voltage_V_{pair}"]
            beam = CoupledBeam([(ZONE[zone], typical) for zone in pair.split("-")])
            assert_agrees(found[pair], beam, drive, 100)
            assert beam.speeds(beam.driven(*drive))[0]["C"] == pytest.approx(100, rel=1e-5)
        assert (arrays["voltage_V_A-C"] == arrays["voltage_V_C-E"]).all()
        assert (arrays["voltage_V_A-C"] != arrays["voltage_V_B-D"]).any()


def test_mirror_images_share_their_codes(designed: Preflight) -> None:
    """Symmetric modes do not distinguish (A, C) from (C, E): two records on two outputs serve both."""
    hashes = designed.content_hashes
    assert list(hashes) == list(PAIRS)
    assert hashes["A-C"] == hashes["C-E"] != hashes["B-D"]


def test_other_fingers_miss_the_level_of_a_design_for_typical_ones(
    under_fingers: Callable[[str], Path], tmp_path: Path
) -> None:
    """Heavy fingers on the drive for typical ones miss it; `none` shows no fingers."""
    file = under_fingers("[40, 60, 80, 100]")
    row = checked(file, "--fingers", written(tmp_path, ONE["heavy"]))["stimuli"][-1]
    assert row["touched"]["A-C"]["zone_at_focus_mm_s"]["C"] < 80
    assert "touched" not in checked(file, "--fingers", "none")["stimuli"][-1]


def test_an_unattainable_level_under_fingers_is_refused_with_the_highest(
    under_fingers: Callable[[str], Path],
) -> None:
    """Every pair beyond its limit is reported with its highest attainable level, which passes."""
    problems = examine(under_fingers("[40, 60, 80, 200]")).problems
    assert len(problems) == len(PAIRS)
    highest = {}
    for problem, pair in zip(sorted(problems, key=lambda each: each.given[-3:]), PAIRS, strict=True):
        assert problem.path == "conditions.peak_velocities_mm_s[3]"
        assert problem.given.startswith("200 mm/s, which needs ")
        assert problem.given.endswith(f"V at the beam under fingers at {pair}")
        assert problem.allowed.startswith("at most 250 V there (")
        highest[pair] = int(problem.allowed.split("(")[1].split(" ")[0])
    assert highest["A-C"] == highest["C-E"] < highest["B-D"] < 200
    assert examine(under_fingers(f"[40, 60, 80, {highest['A-C']}]")).problems == ()
    (first, second) = examine(under_fingers(f"[40, 60, 80, {highest['A-C'] + 1}]")).problems
    assert {first.given[-3:], second.given[-3:]} == {"A-C", "C-E"}


def test_placements_may_have_more_records_than_the_generator_has_memories(edit: Edit) -> None:
    """Six placements with different fingers on two outputs: each is loaded when the fingers are placed."""
    changes = ("  focus: C  ", "  fingers: mine.yaml\n  focus: C  "), ("[80, 100, 150, 200]", "[20, 40]")
    protocol = edit(f"{PAPER}.yaml", *changes)
    written(protocol.parent, BY_HAND)
    preflight = examine(protocol).require()
    assert len({codes.tobytes() for burst in preflight.bursts for codes in burst.codes}) == 12


def test_measurements_of_the_untouched_beam_refuse_a_design_for_fingers(designed: Preflight) -> None:
    """A calibration with that design would be of another beam."""
    with pytest.raises(InputError, match=r"stimulus.fingers: given fingers, but this measures the untouched beam"):
        designed.of_untouched_beam()
    assert designed.as_dict(compare=True)["comparison"] == []


def limited(edit: Edit, limit: float, *changes: tuple[str, str]) -> Path:
    """Return the paper's design under typical fingers at up to 100 mm/s, with another velocity limit."""
    designed = ("  focus: C  ", "  fingers: typical\n  focus: C  "), ("[80, 100, 150, 200]", "[40, 100]")
    file = edit(f"{PAPER}.yaml", *designed)
    beam = file.parent / "apparatus" / "beam_100x6x2.yaml"
    text = beam.read_text(encoding="utf-8")
    for old, new in (("velocity_limit_mm_s: 500", f"velocity_limit_mm_s: {limit:g}"), *changes):
        assert text.count(old) == 1
        text = text.replace(old, new)
    beam.write_text(text, encoding="utf-8")
    return file


def test_lifting_a_finger_must_not_exceed_the_velocity_limit(edit: Edit) -> None:
    """At 100 mm/s the beam moves at up to 114 mm/s within a zone under both fingers, and at 139 without any."""
    file = limited(edit, 145)
    assert examine(file).problems == ()
    beam = file.parent / "apparatus" / "beam_100x6x2.yaml"
    beam.write_text(beam.read_text(encoding="utf-8").replace("limit_mm_s: 145", "limit_mm_s: 130"), encoding="utf-8")
    problems = examine(file).problems
    assert {problem.path for problem in problems} == {"conditions.peak_velocities_mm_s[1]"}
    assert all("once all fingers are taken away" in problem.given for problem in problems)
    assert all("at most 130 mm/s anywhere in a zone" in problem.allowed for problem in problems)


MODE_13 = "label: 13, natural_frequency_Hz: 58303, damping_ratio: 0.0101, gain_mm_s2_per_V: {centre: -41448}"


def with_intervals(share: float) -> tuple[tuple[str, str], ...]:
    """Return changes to the beam's file: intervals of the given share of each gain, both ways."""
    table = re.findall(r"(label: \d+, .*? gain_mm_s2_per_V: \{(\w+): (-?\d+)\})", BEAM.read_text(encoding="utf-8"))
    ends = ((line, name, *sorted((float(gain) * (1 - share), float(gain) * (1 + share)))) for line, name, gain in table)
    return tuple(
        (line, f"{line}, intervals_95: {{gain_mm_s2_per_V: {{{name}: [{low}, {high}]}}}}")
        for line, name, low, high in ends
    )


def test_the_limit_holds_for_all_gains_within_their_intervals(edit: Edit) -> None:
    """Gains are known to 5 %: no model drawn within moves faster, in any zone, than the speed that is checked."""
    file = limited(edit, 500, *with_intervals(0.05))
    preflight = examine(file).require()
    stimulus, points = preflight.stimulus, zone_points(preflight.inputs).ravel()
    played, unit = stimulus.touched(()), stimulus.volts_per_code(0.1)
    speed, error = played.peak_velocity(points, unit), errors_of_gains(preflight.inputs, stimulus, 100.0)
    assert 0.03 * speed.max() < error.max() < 0.12 * speed.max()
    rng = np.random.default_rng(3)
    for _ in range(20):
        factor = 1 + 0.05 * rng.choice([-1, 1], played.model.modal_gain.shape)
        drawn = replace(played, model=replace(played.model, modal_gain=played.model.modal_gain * factor))
        assert (drawn.peak_velocity(points, unit) <= speed + error + 1e-9).all()
    beam = file.parent / "apparatus" / "beam_100x6x2.yaml"
    beam.write_text(beam.read_text(encoding="utf-8").replace("limit_mm_s: 500", "limit_mm_s: 140"), encoding="utf-8")
    problems = examine(file).problems
    assert problems
    assert all("mm/s of it by the intervals of the gains" in each.given for each in problems)


def test_a_set_that_hardly_moves_a_mode_does_not_limit_the_level(edit: Edit) -> None:
    """A gain of 3 known to 300, beside one of 41448, must not count as a beam a hundred times as fast."""
    interval = "intervals_95: {gain_mm_s2_per_V: {centre: [-41448, -41448], side: [-297, 303]}}"
    known = MODE_13.replace("-41448}", "-41448, side: 3}")
    assert examine(limited(edit, 145, (MODE_13, f"{known}, {interval}"))).problems == ()


def test_priority_level_reaches_any_level_and_is_labelled(edit: Edit) -> None:
    """It reaches the paper's 200 mm/s at 250 V, where the whole field allows 114; a warning states the cost."""
    preflight = examine(edit(f"{PAPER}.yaml", ("  focus: C  ", "  fingers: typical\n  priority: level\n  focus: C  ")))
    values = preflight.require().as_dict()
    assert max(values["stimuli"][-1]["peak_drive_V"].values()) <= 250
    for found in values["stimuli"][-1]["touched"].values():
        assert found["zone_at_focus_mm_s"]["C"] == pytest.approx(200, rel=1e-6)
    (said,) = (warning for warning in values["warnings"] if warning.startswith("priority level"))
    assert "do not compare it with sessions that have priority field" in said


@pytest.mark.parametrize(("key", "value"), [("law", "paper"), ("design", "norm_4")])
def test_priority_level_is_refused_with_other_laws(edit: Edit, key: str, value: str) -> None:
    """The fault is at the key `stimulus.priority`."""
    changes = [("  focus: C  ", "  priority: level\n  focus: C  ")]
    changes += [("law: exact  ", "law: paper  ")] if key == "law" else [("  release:", "  design: norm_4\n  release:")]
    (problem,) = examine(edit(f"{PAPER}.yaml", *changes)).problems
    assert problem.path == "stimulus.priority"
    assert problem.given == f"level, with the {key} {value}"


def test_the_attainable_level_is_zero_if_no_voltage_reaches_it(tmp_path: Path) -> None:
    """A kilogram on the focus moves opposite to the untouched beam's drive, which no higher voltage reverses."""
    fingers = written(tmp_path, {"mass_g": 1000, "damping_N_s_per_m": 1, "stiffness_N_per_mm": 1})
    touched = checked(PAPER, "--fingers", fingers)["stimuli"][-1]["touched"]["A-C"]
    assert touched["zone_at_focus_mm_s"]["C"] < 0
    assert touched["attainable_mm_s"] == 0
