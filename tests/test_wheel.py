"""The wheel in a separate environment: the command works in any folder and reports its commit."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from modaltouch.system import provenance

ROOT = Path(__file__).parents[1]
UV = shutil.which("uv") or Path(sys.prefix).parent / ".uv" / "bin" / "uv"


def build_in(tree, kind, folder):
    """Build a wheel, source distribution or editable wheel of a tree; return its file."""
    command = [sys.executable, "-c", f"from hatchling import build; print(build.build_{kind}({str(folder)!r}))"]
    done = subprocess.run(command, cwd=tree, check=True, capture_output=True, text=True)
    return folder / done.stdout.strip()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of this tree."""
    return build_in(ROOT, "wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def recorded(wheel):
    """Version and commit recorded by the build; the commit is empty outside a repository."""
    with zipfile.ZipFile(wheel) as archive:
        version, _, commit = archive.read("modaltouch/build.txt").decode().strip().partition(" ")
    return version, commit


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory):
    """A fresh environment with the wheel, inside another repository; it uses the dependencies of this one."""
    project = tmp_path_factory.mktemp("theirs")
    folder = project / ".venv"
    subprocess.run([UV, "venv", "--quiet", "--python", sys.executable, folder], check=True)
    words = ["pip", "install", "--quiet", "--offline", "--no-deps", "--python", folder / "bin" / "python", wheel]
    subprocess.run([UV, *words], check=True)
    (site,) = folder.glob("lib/*/site-packages")
    (site / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    git = ["git", "-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false"]
    for words in (["init", "--quiet"], ["commit", "--quiet", "--allow-empty", "--message", "theirs"]):
        subprocess.run([*git, *words], cwd=project, check=True)
    return folder


@pytest.fixture
def run(environment, tmp_path):
    """Run the installed command outside the repository, with an empty home; it must succeed."""

    def run(*words):
        without = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        command = [environment / "bin" / "modaltouch", *map(str, words)]
        done = subprocess.run(
            command, cwd=tmp_path, env={**without, "HOME": str(tmp_path)}, capture_output=True, text=True, timeout=100
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_the_wheel_contains_the_package_and_the_protocols(environment):
    """Modules, templates, decisions; protocols, apparatus, texts, observers, schemas."""
    (package,) = environment.glob("lib/*/site-packages/modaltouch")
    kept = (".j2", ".py", ".md", ".yaml", ".json")
    for source, installed in ((ROOT / "src" / "modaltouch", package), (ROOT / "protocols", package / "protocols")):
        files = {path.relative_to(source) for path in source.rglob("*") if path.suffix in kept}
        assert len(files) > 15
        assert [str(file) for file in files if not (installed / file).is_file()] == []


def test_a_build_records_the_commit_of_its_tree(wheel, recorded):
    """The commit itself is not compared, since someone may commit while the tests run."""
    version, commit = recorded
    assert wheel.name == f"modaltouch-{version}-py3-none-any.whl"
    assert bool(commit) == bool(provenance.commit())
    assert version == provenance.RELEASE or version.startswith(f"{provenance.RELEASE}+g{commit[:12]}")
    assert version.endswith(".dirty") == commit.endswith("+")


def test_a_study_in_any_folder_from_the_first_command_to_the_report(run, recorded, tmp_path):
    """The README's steps for an installed program work; record and report give the commit of the build."""
    version, commit = recorded
    assert run("--version") == f"{version}\n"
    assert run("check", "demo").startswith("Demonstration: 12 trials")
    run("new", "study", "--from", "demo")
    run("check", "study/protocols/demo.yaml")
    run("simulate", "study/protocols/demo.yaml", "-n", "2", "--results", "study/results")
    dataset = tmp_path / "study" / "results" / "simulated" / "demo"
    start = json.loads((dataset / "sub-sim01/ses-1/beh/session.jsonl").read_text(encoding="utf-8").splitlines()[0])
    assert (start["versions"]["modaltouch"], start["commit"]) == recorded
    run("verify", dataset / "sub-sim01" / "ses-1")
    report = json.loads(run("analyse", dataset, "--json"))["files"]["report.html"]
    by = f"modaltouch {version}, commit <code>{commit}</code>" if commit else f"modaltouch {version}"
    assert by in Path(report).read_text(encoding="utf-8")


def test_the_metadata_has_the_version_of_the_program(run, environment):
    """The package manager and `--version` report the same version."""
    ask = "from importlib.metadata import version; print(version('modaltouch'))"
    done = subprocess.run([environment / "bin" / "python", "-I", "-c", ask], check=True, capture_output=True, text=True)
    assert done.stdout == run("--version")


def test_a_wheel_of_the_source_distribution_has_the_same_commit(tmp_path):
    """The unpacked source distribution has no git repository."""
    source = build_in(ROOT, "sdist", tmp_path)
    with tarfile.open(source) as archive:
        archive.extractall(tmp_path / "unpacked", **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    (tree,) = (tmp_path / "unpacked").iterdir()
    wheel = build_in(tree, "wheel", tmp_path)
    assert wheel.name == f"{source.name.removesuffix('.tar.gz')}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        assert archive.read("modaltouch/build.txt") == (tree / "src" / "modaltouch" / "build.txt").read_bytes()


def test_an_editable_build_records_no_commit(tmp_path):
    """The next commit would make it wrong, so git is asked at each start."""
    with zipfile.ZipFile(build_in(ROOT, "editable", tmp_path)) as editable:
        names = editable.namelist()
    assert any(name.endswith(".pth") for name in names)
    assert not any(name.endswith("build.txt") for name in names)
