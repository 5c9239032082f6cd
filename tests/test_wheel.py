"""The wheel holds all that the program needs besides its dependencies."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling import build

import modaltouch

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder that a wheel built of this tree becomes."""
    folder = tmp_path_factory.mktemp("wheel")
    before = Path.cwd()
    os.chdir(ROOT)
    try:
        name = build.build_wheel(str(folder))
    finally:
        os.chdir(before)
    with zipfile.ZipFile(folder / name) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


def run(installed, folder, *words):
    """Run ``modaltouch`` from the wheel, away from the repository, with an empty home."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "HOME": str(folder)}
    command = [sys.executable, "-m", "modaltouch", *map(str, words)]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=100, check=False
    )


def test_the_wheel_has_a_command_and_its_data(installed):
    """Entry point, protocols, schemas, texts, observers, templates."""
    (entry,) = installed.glob("*.dist-info/entry_points.txt")
    assert "modaltouch = modaltouch.__main__:main" in entry.read_text()
    package = installed / "modaltouch"
    for name in ("protocols/demo.yaml", "protocols/texts/french.yaml", "protocols/schema/protocol.json"):
        assert (package / name).is_file(), name
    sources = {path.relative_to(ROOT / "src") for path in (ROOT / "src").rglob("*") if path.suffix in (".j2", ".py")}
    assert all((installed / path).is_file() for path in sources)


def test_the_installed_program_checks_and_runs_a_session(installed, tmp_path):
    """Without the repository: the packaged protocol passes, a simulated session is recorded and analysed."""
    protocol = installed / "modaltouch" / "protocols" / "demo.yaml"
    assert run(installed, tmp_path, "--version").stdout == f"{modaltouch.__version__}\n"
    checked = run(installed, tmp_path, "check", protocol)
    assert checked.returncode == 0, checked.stderr
    simulated = run(installed, tmp_path, "simulate", protocol, "-n", "2")
    assert simulated.returncode == 0, simulated.stderr
    analysed = run(installed, tmp_path, "analyse", tmp_path / "results")
    assert analysed.returncode == 0, analysed.stderr
    assert list(tmp_path.rglob("report.html"))
