"""`modaltouch new`: every command of the new study works as printed, and nothing is overwritten or half made."""

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.cli.new import write_study
from modaltouch.protocol.source import InputError, Source

pytestmark = pytest.mark.usefixtures("undrawn")


def run(*words):
    """Run ``modaltouch`` in this process and return the result."""
    done = CliRunner().invoke(app, list(map(str, words)))
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def commands_of(study):
    """Return the commands of a study's README with one participant and simulated answers."""
    lines = re.findall(r"^\| `modaltouch (.*?)` \|", (study / "README.md").read_text("utf-8"), flags=re.MULTILINE)
    for line in lines:
        words = shlex.split(line.replace("-n 10", "-n 1"))
        if words[0] == "run":
            words += ["--rig", "simulated", "--answers", "simulated"]
        if words[0] in ("verify", "analyse"):
            words[1] = re.sub("^results/(simulated/)?", "results/simulated/", words[1])
        yield tuple(words)


@pytest.mark.parametrize("template", Source.shipped("protocol"))
def test_every_shipped_protocol_makes_a_study_whose_next_step_works(tmp_path, template):
    """The printed command works, also if the folder's name has a space."""
    printed = run("new", tmp_path / "my study", "--from", template).stdout
    (following,) = re.findall(r"^Next: modaltouch (.*)$", printed, flags=re.MULTILINE)
    assert shlex.split(following)[1].endswith(f"my study/protocols/{template}.yaml")
    assert run(*shlex.split(following)).exit_code == 0
    commands = [words[0] for words in commands_of(tmp_path / "my study")]
    assert sorted(set(commands)) == ["analyse", "check", "run", "simulate", "verify"]


@pytest.mark.parametrize("template", ["demo", "sensation_levels", "two_fields"])
def test_the_commands_of_a_study_work_in_order(tmp_path, monkeypatch, template):
    """One protocol alone, one that needs another first, and one with several stimuli, each analysed separately."""
    write_study(tmp_path / "study", template)
    monkeypatch.chdir(tmp_path / "study")
    for words in dict.fromkeys(commands_of(Path())):
        done = run(*words)
        assert done.exit_code == 0, f"{words}\n{done.output}"


def test_a_study_is_used_from_any_folder(tmp_path):
    """Check, simulate, analyse and verify take protocol and results by their paths."""
    made = json.loads(run("new", "study", "--from", "demo", "--json").stdout)
    assert made["protocol"] == str(Path("study/protocols/demo.yaml"))
    assert all(Path(file).is_file() for file in made["files"])
    assert run("check", made["protocol"]).exit_code == 0
    assert run("simulate", made["protocol"], "-n", "1", "--results", "study/results").exit_code == 0
    dataset = "study/results/simulated/demo"
    assert run("analyse", dataset).exit_code == 0
    assert run("verify", f"{dataset}/sub-sim01/ses-1").exit_code == 0


def test_a_study_is_a_copy_in_the_shipped_layout(tmp_path):
    """Files are copied byte by byte; instruments, languages and schemas are where protocol and editors expect them."""
    source = Source.shipped("protocol")["differentiated_stimulation"].parent
    write_study(tmp_path / "study", "differentiated_stimulation")
    copied = sorted(file for file in (tmp_path / "study" / "protocols").rglob("*") if file.is_file())
    names = [file.relative_to(tmp_path / "study" / "protocols").as_posix() for file in copied]
    others = (file for kind in ("apparatus", "schema", "texts") for file in (source / kind).iterdir())
    own = sorted(["differentiated_stimulation.yaml", *(file.relative_to(source).as_posix() for file in others)])
    assert names == own
    assert {"texts/french.yaml", "schema/protocol.json", "apparatus/keysight_33522b.yaml"} < set(names)
    assert [file.read_bytes() for file in copied] == [(source / name).read_bytes() for name in names]


def test_a_study_that_needs_thresholds_contains_their_protocol(tmp_path):
    """The threshold session comes first in the README."""
    write_study(tmp_path / "study", "sensation_levels")
    readme = (tmp_path / "study" / "README.md").read_text(encoding="utf-8")
    assert readme.index("run protocols/threshold.yaml") < readme.index("run protocols/sensation_levels.yaml")
    assert (tmp_path / "study" / "protocols" / "threshold.yaml").is_file()


def test_results_are_private_and_kept_out_of_version_control(tmp_path):
    """The results folder has mode 0700 and a .gitignore, as sessions create it."""
    write_study(tmp_path / "study", "demo")
    assert (tmp_path / "study" / "results" / ".gitignore").read_text(encoding="utf-8") == "*\n!.gitignore\n"
    assert (tmp_path / "study" / "results").stat().st_mode & 0o777 == 0o700


def test_a_study_can_be_created_in_an_empty_folder(tmp_path):
    """It may be the current folder."""
    assert run("new", ".").exit_code == 0
    assert run("check", "protocols/differentiated_stimulation.yaml").exit_code == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["taken"], "taken: given a folder that holds notes.txt; allowed: a folder that is new or empty"),
        (["taken/notes.txt"], "taken/notes.txt: given a folder that cannot be written (Not a directory)"),
        (["taken/notes.txt/study"], "given a folder that cannot be written (Not a directory); allowed: one that you"),
        (
            ["study", "--from", "treshold"],
            "--from: given 'treshold', which is not a shipped protocol; allowed: comparison_2ifc, demo, ",
        ),
    ],
)
def test_an_invalid_study_is_refused_with_a_message(tmp_path, words, said):
    """Exit status 2, and no file is changed."""
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    done = run("new", *words)
    assert done.exit_code == 2
    assert said in done.stderr.replace("\\", "/")
    refused = run("new", *words, "--json")
    assert refused.exit_code == 2
    assert json.loads(refused.stdout)["problems"][0]["allowed"]
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "taken" / "notes.txt").read_text() == "mine"


def test_a_file_created_meanwhile_is_not_overwritten(tmp_path, monkeypatch):
    """A file that another program writes at the same moment stays."""
    made = Path.mkdir

    def interfere(self, *args, **how):
        made(self, *args, **how)
        if self.name == "texts":
            (self / "english.yaml").write_text("theirs")

    monkeypatch.setattr(Path, "mkdir", interfere)
    with pytest.raises(InputError, match=r"cannot be written \(File exists\)"):
        write_study(tmp_path / "study", "demo")
    (texts,) = (tmp_path / "study").rglob("texts/english.yaml")
    assert texts.read_text() == "theirs"
