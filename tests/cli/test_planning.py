"""``modaltouch power`` and ``fit`` as a user runs them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from modaltouch.cli import app, planning
from modaltouch.planning import power as planning_power
from modaltouch.planning.experiments import Job, Study, run_job

pytestmark = pytest.mark.usefixtures("undrawn")

ROOT = Path(__file__).parents[2]
PROTOCOL = ROOT / "protocols" / "differentiated_stimulation.yaml"
DEMO = ROOT / "protocols" / "demo.yaml"
TWO_FIELDS = ROOT / "protocols" / "two_fields.yaml"


def run(*words: object) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


def test_power_json_is_one_complete_object(tmp_path: Path) -> None:
    """It has power with its interval, widths, smallest p, figure and seed; progress goes to standard error."""
    done = run(
        "power", PROTOCOL, "--participants", "6:10:2", "--reps", "1,2", "--observer", "near_miss",
        "--experiments", 40, "--seed", 3, "--out", tmp_path / "plan", "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    values = json.loads(done.stdout)
    assert values["complete"]
    assert values["seed"] == 3
    assert {(row["n_participants"], row["n_repetitions"]) for row in values["power"]} == {
        (n, r) for n in (6, 8, 10) for r in (1, 2)
    }
    assert {row["question"] for row in values["power"]} == {"a1", "a2", "b", "c", "d"}
    floors = {(row["family"], row["n_repetitions"]): row["least_participants"] for row in values["floors"]}
    assert floors["a2", 1] == 8
    assert all(row["power"] == 0 for row in values["power"] if row["family"] == "a2" and row["n_participants"] == 6)
    assert all(Path(file).exists() for file in values["files"].values())
    assert "power.svg" in values["files"]
    assert "experiments" in done.stderr


def test_power_text_gives_the_floor_and_the_number_needed() -> None:
    """The terminal output alone gives the smallest group that can be significant and the number needed."""
    done = run("power", PROTOCOL, "-n", "6,8", "--experiments", 10, "--questions", "a2,d")
    assert done.exit_code == 0, done.stderr
    assert "never significant with fewer than 8 participants" in done.stdout
    assert "Participants for a power of 0.8" in done.stdout
    assert "never" in done.stdout


def test_power_fits_a_terminal_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """All families side by side would be truncated; scopes are written out."""
    monkeypatch.setenv("COLUMNS", "80")
    done = run("power", PROTOCOL, "-n", "8:12:4", "--experiments", 4)
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "…" not in done.stdout
    assert "two hands, A and C" in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--participants", "40:6"], "given --participants '40:6'"),
        (["--participants", "six"], "whole numbers from 1 to 1000"),
        (["--reps", "0"], "given --reps '0'"),
        (["--questions", "z"], "a1, a2, a2 mean, b"),
        (["--observer", "papr"], "did you mean 'paper'?"),
        (["--participants", "1000", "--reps", "100"], "400000 answers to each pair"),
    ],
)
def test_bad_options_exit_with_status_2_and_no_traceback(words: list[str], said: str) -> None:
    """The message gives the value and the allowed ones."""
    done = run("power", PROTOCOL, *words)
    assert done.exit_code == 2
    assert "Traceback" not in done.stderr
    # rich draws a box around a usage error and breaks its lines.
    flat = " ".join(done.stderr.replace("│", " ").split())
    assert said in flat


def test_ctrl_c_keeps_finished_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exit status 130; the two finished jobs are in the JSON and in the files."""
    ran: list[Job] = []

    def interrupted_in_the_second(study: Study, job: Job) -> object:
        ran.append(job)
        if len(ran) == 2:
            signal.raise_signal(signal.SIGINT)
        return run_job(study, job)

    monkeypatch.setattr(planning_power, "run_job", interrupted_in_the_second)
    done = run("power", DEMO, "-n", "8:20", "--experiments", 20, "--out", tmp_path / "plan", "--json")
    assert done.exit_code == 130
    values = json.loads(done.stdout)
    assert not values["complete"]
    assert {row["n_participants"] for row in values["power"]} == {8, 9}
    assert {row["n_experiments"] for row in values["power"]} == {20}
    assert json.loads((tmp_path / "plan" / "power.json").read_text())["power"] == values["power"]
    assert "interrupted; kept: 20 to 20 of 20 experiments for 2 of 13 sizes" in done.stderr


def test_each_stimulus_is_planned_separately(tmp_path: Path) -> None:
    """Each has its tables in its own folder, in one JSON object; a blunt field has less power than a sharp one."""
    words = ("-n", "10", "--experiments", 60, "--questions", "a2", "--out", tmp_path / "plan", "--json")
    done = run("power", TWO_FIELDS, *words)
    assert done.exit_code == 0, done.stderr
    values = json.loads(done.stdout)
    assert values["complete"]
    assert [each["stimulus"] for each in values["stimuli"]] == ["sharp", "blunt"]
    sharp, blunt = (each["power"][0]["power"] for each in values["stimuli"])
    assert sharp > 0.9 > blunt
    for each in values["stimuli"]:
        assert json.loads((tmp_path / "plan" / each["stimulus"] / "power.json").read_text())["power"] == each["power"]
    said = " ".join(run("power", TWO_FIELDS, "-n", 8, "--experiments", 20, "--questions", "a2").stdout.split())
    assert "the tests of blunt alone, as by `analyse --stimulus blunt`" in said


def test_ctrl_c_keeps_finished_stimuli(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exit status 130 in the second of two: the first is complete, the second as far as computed."""
    ran: list[Job] = []

    def interrupted_in_the_third(study: Study, job: Job) -> object:
        ran.append(job)
        if len(ran) == 3:
            signal.raise_signal(signal.SIGINT)
        return run_job(study, job)

    monkeypatch.setattr(planning_power, "run_job", interrupted_in_the_third)
    done = run("power", TWO_FIELDS, "-n", "8,9", "--experiments", 20, "--json")
    assert done.exit_code == 130
    values = json.loads(done.stdout)
    assert not values["complete"]
    assert [(each["stimulus"], each["complete"]) for each in values["stimuli"]] == [("sharp", True), ("blunt", False)]
    assert {row["n_participants"] for row in values["stimuli"][1]["power"]} == {8}
    assert "for 1 of 2 sizes of two_fields, stimulus blunt" in done.stderr


def test_planning_loads_neither_window_nor_instrument() -> None:
    """Planning loads no psychopy, PyVISA, statsmodels or matplotlib."""
    program = (
        "import sys\nfrom modaltouch.__main__ import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        "sys.stderr.write('MODULES ' + ' '.join(sys.modules))\n"
    )
    command = [sys.executable, "-c", program, "power", str(PROTOCOL), "-n", "8", "--experiments", "2", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=ROOT, check=False)
    loaded = set(done.stderr.split("MODULES ")[1].split())
    assert not loaded & {"psychopy", "pyvisa", "pyglet", "statsmodels", "scipy.signal", "scipy.optimize", "matplotlib"}


def test_an_observer_fitted_to_a_pilot_is_used_for_planning(tmp_path: Path) -> None:
    """An observer file fitted to simulated sessions of one observer is accepted by `power`."""
    assert run("simulate", DEMO, "-n", 2, "--observer", "envelope", "--results", tmp_path / "r").exit_code == 0
    log = next((tmp_path / "r").rglob("session.jsonl")).read_text(encoding="utf-8").splitlines()[0]
    assert json.loads(log)["observer"]["front_end"] == "envelope"
    fitted = run("fit", DEMO, tmp_path / "r", "--out", tmp_path / "fitted.yaml", "--json")
    assert fitted.exit_code == 0, fitted.stderr
    assert json.loads(fitted.stdout)["n_participants"] == 2
    again = run("fit", DEMO, tmp_path / "r", "--out", tmp_path / "fitted.yaml")
    assert again.exit_code == 4
    assert "not overwritten" in again.stderr
    planned = run("power", DEMO, "--observer", tmp_path / "fitted.yaml", "-n", 8, "--experiments", 5, "--json")
    assert json.loads(planned.stdout)["observer"]["name"] == "fitted"


def test_temporary_sessions_are_simulated_in_memory_if_there_is_room(tmp_path: Path, monkeypatch) -> None:
    """Flushing each answer to disk takes most of the time of a preregistration; 1e9 sessions do not fit in memory."""
    monkeypatch.setattr(planning, "_IN_MEMORY", tmp_path)
    assert planning._scratch(1) == tmp_path and planning._scratch(10**9) is None
    monkeypatch.setattr(planning, "_IN_MEMORY", tmp_path / "none")
    assert planning._scratch(1) is None


def test_an_interrupted_preregistration_offers_no_session_to_resume(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The folder of its simulated sessions has been deleted by then."""
    from modaltouch import session

    def cut_short(*_: object, **__: object) -> None:
        error = KeyboardInterrupt()
        error.add_note("continue with `modaltouch resume /tmp/gone`")
        raise error

    monkeypatch.setattr(session, "simulate_session", cut_short)
    done = run("prereg", "magnitude", "-n", 2, "--experiments", 1, "--out", tmp_path / "prereg.md")
    assert done.exit_code == 130 and "interrupted" in done.stderr
    assert "resume" not in done.stderr
