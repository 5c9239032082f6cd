"""The command line as a user meets it: messages, exit statuses, one JSON object, never a traceback."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
import typer

from modaltouch.__main__ import main

REPOSITORY = Path(__file__).parents[2]
PROTOCOL = REPOSITORY / "protocols" / "differentiated_stimulation.yaml"
COMMANDS = ("demo", "new", "check", "run", "resume", "simulate", "analyse", "power", "fit", "verify", "doctor")


@pytest.fixture(autouse=True)
def _here(monkeypatch):
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr(sys, "argv", ["modaltouch"])


def run_in_a_process(*words):
    """Run ``python -m modaltouch`` in a separate process."""
    command = [sys.executable, "-m", "modaltouch", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=REPOSITORY)


def run(*words):
    """Run the command in this process; any exception but an exit would be a traceback and is raised."""
    said, complained = io.StringIO(), io.StringIO()
    with redirect_stdout(said), redirect_stderr(complained), pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    return subprocess.CompletedProcess(words, left.value.code or 0, said.getvalue(), complained.getvalue())


def loaded_modules(*words):
    """Return the modules that a command leaves loaded."""
    program = (
        "import sys, json\n"
        "from modaltouch.__main__ import main\n"
        "try:\n    main(sys.argv[1:])\n"
        "except SystemExit:\n    pass\n"
        "sys.stderr.write('MODULES ' + json.dumps(sorted(sys.modules)))\n"
    )
    command = [sys.executable, "-c", program, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=REPOSITORY)
    return set(json.loads(done.stderr.split("MODULES ")[1]))


@pytest.fixture(scope="module")
def checked():
    """The output of ``check --json`` for the paper's protocol."""
    done = run_in_a_process("check", PROTOCOL, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_help_lists_every_command_and_loads_nothing_heavy():
    """``--help`` imports neither psychopy nor numpy nor pandas."""
    done = run_in_a_process("--help")
    assert done.returncode == 0
    for command in (*COMMANDS, "rig"):
        assert command in done.stdout
    assert not loaded_modules("--help") & {"psychopy", "numpy", "pandas", "pyvisa", "pydantic", "matplotlib"}


def test_ctrl_c_while_the_program_loads_gives_no_traceback(tmp_path):
    """Loading takes some tenths of a second, in which the user may press Ctrl-C."""
    program = (
        "import sys, runpy; sys.path.insert(0, sys.argv.pop(1)); "
        "runpy.run_module('modaltouch.__main__', run_name='__main__')"
    )
    for module, said in (("typer", "interrupted; nothing was begun\n"), ("numpy", "interrupted; nothing was driven\n")):
        (tmp_path / module).mkdir()
        (tmp_path / module / f"{module}.py").write_text("raise KeyboardInterrupt\n")
        words = [sys.executable, "-c", program, tmp_path / module, "simulate", "demo"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=150)
        assert (done.returncode, done.stderr) == (130, said)


def test_a_closed_terminal_does_not_change_the_exit_status(monkeypatch):
    """An interrupted session exits with 130 even if its message can no longer be written."""
    import typer

    from modaltouch.cli import INTERRUPTED, leave

    class Gone:
        def write(self, words):
            raise OSError(5, "Input/output error")

        flush = isatty = lambda self: False

    monkeypatch.setattr(sys, "stderr", Gone())
    with pytest.raises(typer.Exit) as left:
        leave(INTERRUPTED, "ended by SIGHUP")
    assert left.value.exit_code == INTERRUPTED


@pytest.mark.parametrize(
    "words",
    [
        ["verify", "{}/p/simulated/demo/sub-p01/ses-1"],
        ["doctor", "{}/p/simulated/demo/sub-p01/ses-1"],
        ["resume", "{}/p/simulated/demo/sub-p01/ses-1"],
        ["analyse", "{}/p/simulated"],
    ],
)
def test_the_sessions_of_another_user_are_refused(monkeypatch, tmp_path, words):
    """Session folders are readable by their owner only: even looking up a file in them is denied."""
    from typer.testing import CliRunner

    from modaltouch.cli import app

    look = os.stat

    def forbid(path, *args, **kwargs):
        if str(path).startswith(f"{tmp_path}/p/"):
            raise PermissionError(13, "Permission denied", str(path))
        return look(path, *args, **kwargs)

    monkeypatch.setattr(os, "stat", forbid)
    done = CliRunner().invoke(app, [word.format(tmp_path) for word in words])
    assert done.exit_code == 2, done.exception
    assert f"{tmp_path}/p/simulated" in done.output
    assert "not accessible to this user (Permission denied); only its owner can read a session's files" in done.output


@pytest.mark.parametrize("title", ["Grip [/x] test", "Grip [red] and [b]", "[/]", "Grip :a: and :b:"])
def test_brackets_and_colons_in_a_title_are_not_markup(tmp_path, title):
    """Any title is printed completely and does not end the program."""
    shutil.copytree("protocols", tmp_path / "protocols")
    protocol = tmp_path / "protocols" / "demo.yaml"
    text = re.sub(r"(?m)^title:.*$", f'title: "{title}"', protocol.read_text(encoding="utf-8"))
    protocol.write_text(text, encoding="utf-8")
    done = run("check", str(protocol))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{title}: 12 trials")


def test_a_narrow_terminal_truncates_no_number(monkeypatch):
    """Without its exponent 3.7e-06 would read 3.7; each voltage has its channel, and no column is truncated."""
    monkeypatch.setenv("COLUMNS", "40")
    done = run("check", "protocols/demo.yaml")
    assert "3.7e-06" in done.stdout
    assert "74, 12" in done.stdout
    assert all(words in done.stdout for words in ("CH1", "CH2"))
    assert "\N{HORIZONTAL ELLIPSIS}" not in done.stdout


def test_the_version_is_printed_without_a_command():
    """One line gives the release and any deviation from it; no heavy module is loaded."""
    from modaltouch.system.provenance import RELEASE

    done = run("--version")
    assert done.returncode == 0
    assert re.fullmatch(rf"{re.escape(RELEASE)}(\+g[0-9a-f]{{12}}(\.dirty)?)?\n", done.stdout)
    assert not loaded_modules("--version") & {"psychopy", "numpy", "pandas", "pyvisa", "pydantic", "matplotlib"}


def test_check_loads_neither_window_nor_instrument():
    """``check`` never imports psychopy (3.7 s), nor pandas, PyVISA or matplotlib."""
    loaded = loaded_modules("check", PROTOCOL, "--json")
    assert not loaded & {"psychopy", "pandas", "pyvisa", "matplotlib", "scipy.signal", "statsmodels"}


def test_analyse_loads_neither_window_nor_instrument(tmp_path):
    """The analysis runs without an instrument or a screen."""
    rows = ["participant,finger_condition,zone_left,zone_right,velocity_mm_s,response"]
    rows += [f"p{n},one_hand,A,C,80,right" for n in range(3)]
    (tmp_path / "answers.csv").write_text("\n".join(rows) + "\n")
    loaded = loaded_modules("analyse", tmp_path / "answers.csv", "--out", tmp_path / "out", "--json")
    assert "pandas" in loaded
    assert not loaded & {"psychopy", "pyvisa", "pyglet"}
    assert (tmp_path / "out" / "report.html").exists()


def test_check_json_has_the_documented_keys(checked):
    """``check --json`` reports trials, duration, problems and every stimulus."""
    assert checked["n_trials"] == 24
    assert checked["estimated_duration_min"] > 0
    assert checked["problems"] == []
    assert [stimulus["velocity_mm_s"] for stimulus in checked["stimuli"]] == [80, 100, 150, 200]
    for stimulus in checked["stimuli"]:
        assert stimulus["focus"] == "C"
        assert stimulus["law"] == "exact"
        assert stimulus["selected_modes"] == [1, 3, 5, 7, 11, 13]
        assert set(stimulus["peak_drive_V"]) == {"1", "2"}
        assert stimulus["n_samples"] == 125_000
        assert stimulus["sampling_rate_Hz"] == 2.5e6
        labels = {"1", "3", "5", "7", "9", "11", "13", "15", "17"}
        assert set(stimulus["target_mm_s"]) == set(stimulus["achieved_mm_s"]) == labels
        assert set(stimulus["zone_at_focus_mm_s"]) == set(stimulus["zone_peak_mm_s"]) == set("ABCDE")
        assert stimulus["zone_at_focus_mm_s"]["C"] == pytest.approx(stimulus["velocity_mm_s"], rel=1e-3)


def test_the_standard_is_labelled_in_the_table_of_levels(monkeypatch):
    """Levels rise from row to row; the standard is presented in every trial, but is not a comparison level."""
    monkeypatch.setenv("COLUMNS", "120")
    rows = re.findall(r"(?m)^│ +(\d+)( \(standard\))? │", run_in_a_process("check", "comparison_2ifc").stdout)
    assert rows == [(str(level), " (standard)" * (level == 100)) for level in (70, 80, 90, 100, 110, 125, 140)]


def test_the_modal_error_covers_every_difference_between_target_and_achieved(checked):
    """Worst modal error = max over modes of |velocity - target| and |w eta|."""
    for stimulus in checked["stimuli"]:
        differences = [abs(stimulus["target_mm_s"][k] - stimulus["achieved_mm_s"][k]) for k in stimulus["target_mm_s"]]
        assert max(differences) <= stimulus["worst_modal_error_mm_s"] * (1 + 1e-9)


def test_all_faults_are_reported_together_with_their_place(tmp_path):
    """Exit status 2, one line per fault with file, line and column, and no traceback."""
    text = PROTOCOL.read_text()
    for name in ("apparatus", "texts"):
        text = text.replace(f"{name}: {name}/", f"{name}: {PROTOCOL.parent / name}/")
    text = (
        text.replace("[C, E]]", "[C, F], [A, C]]")
        .replace("150, 200]", "150, 900]")
        .replace("hand: right", "hnad: right")
    )
    broken = tmp_path / "broken.yaml"
    broken.write_text(text)
    done = run("check", broken)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith(f"{broken}:")]
    assert len(lines) >= 4
    for words in ("'F'", "900", "hnad"):
        assert any(words in line for line in lines), f"{words} is not reported in {lines}"
    done = run("check", broken, "--json")
    assert done.returncode == 2
    problems = json.loads(done.stdout)["problems"]
    assert len(problems) == len(lines)
    assert {"file", "line", "column", "path", "given", "allowed", "message"} <= set(problems[0])


def test_simulated_answers_refuse_a_file_of_personal_data(tmp_path):
    """Without the refusal the file would be ignored, and a refused consent would not stop the session."""
    given = ("--people", tmp_path / "people.yaml", "--results", tmp_path)
    done = run("run", PROTOCOL, "-p", "p01", "--rig", "simulated", "--answers", "simulated", "--yes", *given)
    assert done.returncode == 2
    assert "whose answers are drawn" in " ".join(done.stderr.replace("\N{BOX DRAWINGS LIGHT VERTICAL}", " ").split())
    assert not list(tmp_path.iterdir())


def test_a_window_without_a_display_gives_a_remedy(tmp_path, monkeypatch):
    """Exit status 3 before anything is recorded: the session can be started again."""
    monkeypatch.delenv("DISPLAY", raising=False)
    done = run_in_a_process("run", "protocols/demo.yaml", "-p", "p01", "--rig", "simulated", "--results", tmp_path)
    assert done.returncode == 3
    assert "display" in done.stderr
    assert list(tmp_path.rglob("session.jsonl")) == []


@pytest.mark.parametrize(("given", "threads"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, 2)])
def test_blas_uses_one_thread_unless_set_otherwise(given: dict[str, str], threads: int) -> None:
    """Further threads only busy-wait and take the processor from window and watchdog."""
    ask = "import modaltouch.__main__, numpy, threadpoolctl; print(threadpoolctl.threadpool_info()[0]['num_threads'])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    found = subprocess.run(
        [sys.executable, "-c", ask], env=environment | given, check=True, capture_output=True, text=True
    )
    assert int(found.stdout) == min(threads, os.cpu_count() or 1)


def test_values_are_read_as_typer_reads_them():
    """Words, paths and lists of them without its library of types; what it does not give is left to it."""
    from modaltouch.cli import app, get_command

    group = get_command(app)
    with group.make_context("modaltouch", ["doctor"]) as context:
        for name, word in (("analyse", "a/b"), ("new", "nothing"), ("verify", "c"), ("simulate", "7")):
            command = group.get_command(context, name)
            for each in command.get_params(context):
                value = [word, "d"] if each.nargs != 1 or each.multiple else word
                for given in (value, None, each.default):
                    assert outcome(each, context, given, ours=True) == outcome(each, context, given, ours=False)


def outcome(parameter, context, given, *, ours):
    """Return what a value is parsed as, by us or by typer alone, or the message of the refusal."""
    reader = parameter.get_runtime_param() if ours else type(parameter).get_runtime_param(parameter)
    try:
        return reader.coerce(given, param=parameter, ctx=context)
    except typer.BadParameter:
        return "refused"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("run demo --seed 1.5", "'--seed': given 1.5; allowed: a whole number, 0 or more"),
        ("power demo --target 2", "'--target': given 2; allowed: a number from 0.01 to 0.999"),
        ("identify --leave-out end", "'--leave-out': given end; allowed: a number"),
        ("demo --theme blue", "'--theme': given blue; allowed: dark, light"),
        ("study r\udce9sultats", r"'results': given 'r\udce9sultats'; allowed: names in UTF-8; rename it"),
    ],
)
def test_a_bad_option_value_is_reported_with_the_allowed_values(words, told):
    """Typer gives neither the value nor the allowed whole numbers, and a record cannot hold a name in Latin-1."""
    done = run(*words.split())
    assert (done.returncode, told) == (2, done.stderr.rstrip().rpartition("Invalid value for ")[2])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a disk that is always full is one of Linux's devices")
@pytest.mark.parametrize("buffered", [True, False])
def test_unwritable_output_gives_a_message_and_no_traceback(buffered):
    """A full disk gives a message, a closed pipe as of `head` none; both buffered and unbuffered."""
    command = [sys.executable, *([] if buffered else ["-u"]), "-m", "modaltouch", "--help"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment, cwd=REPOSITORY)
    assert done.returncode == 1
    assert done.stderr.startswith("the output cannot be written (No space left on device)")
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, env=environment, cwd=REPOSITORY)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_the_descriptor_of_a_closed_stream_is_not_reused(monkeypatch):
    """Without standard error, a session ended at its first progress line; the record could take descriptor 2."""
    monkeypatch.setattr(sys, "stderr", None)
    with pytest.raises(SystemExit):
        main(["--version"])
    with sys.stderr as nowhere:
        assert nowhere.write("a warning of a library")
