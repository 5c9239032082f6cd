"""Corrupted files give problems with positions or a valid experiment; never another exception or a hang."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from modaltouch.preflight import examine
from modaltouch.protocol import Findings

SHIPPED = Path(__file__).parents[2] / "protocols"
PROTOCOL, BEAM, TEXTS = "differentiated_stimulation.yaml", "apparatus/beam_100x6x2.yaml", "texts/english.yaml"
TEXT = {name: (SHIPPED / name).read_text(encoding="utf-8") for name in (PROTOCOL, BEAM, TEXTS)}

_WORDS = """
-1 0 1e400 .nan .inf -.inf 1e308 1e-308 true ~ [] {} [1,2] '' "x" *a &a !!int | 5e F A [[A,C]] 131072 2 1e12 1e-9
1000 null {a:b} 99999999999999999999999 one_hand gaussian box free paper latin_square [5,7] [17] 0.5 0.001 50_ohm
"""
WORDS = st.sampled_from(_WORDS.split()) | st.sampled_from(
    ["80 mm/s", "\t", "\n- x\n", "a: b", ":", "[", "]", "{", "}", "#", "\n", "  "]
)


@st.composite
def spoilt(draw: st.DrawFn, name: str) -> str:
    """Return a shipped file with one to three words, lines or characters changed, doubled or removed."""
    text = TEXT[name]
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["word", "word", "scale", "insert", "cut", "double line", "lose line"]))
        lines = text.split("\n")
        number = draw(st.integers(0, len(lines) - 1))
        place = draw(st.integers(0, len(text)))
        if kind in ("word", "scale"):
            found = list(re.finditer(r"-?\d+(\.\d+)?" if kind == "scale" else r"-?\d+(\.\d+)?|\b[A-Za-z_]+\b", text))
            if found:
                match = found[draw(st.integers(0, len(found) - 1))]
                factor = 10 ** draw(st.floats(-4, 4))
                new = f"{float(match.group()) * factor:.4g}" if kind == "scale" else draw(WORDS)
                text = text[: match.start()] + new + text[match.end() :]
        elif kind == "insert":
            text = text[:place] + draw(WORDS | st.characters()) + text[place:]
        elif kind == "cut":
            text = text[:place] + text[place + draw(st.integers(1, 30)) :]
        else:
            lines[number : number + 1] = [lines[number]] * 2 if kind == "double line" else []
            text = "\n".join(lines)
    return text


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the shipped files."""
    copy = tmp_path_factory.mktemp("fuzz") / "protocols"
    shutil.copytree(SHIPPED, copy)
    return copy


def spoil(folder: Path, name: str, text: str) -> Path:
    """Write the corrupted file among valid ones and return the protocol's path."""
    for other, sound in TEXT.items():
        (folder / other).write_bytes((text if other == name else sound).encode("utf-8", errors="replace"))
    return folder / PROTOCOL


@pytest.mark.hypothesis
@pytest.mark.parametrize("name", [PROTOCOL, BEAM, TEXTS])
def test_reading_gives_problems_or_an_experiment(folder: Path, name: str) -> None:
    """Each problem has a position and a message of moderate length."""

    @settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
    @given(spoilt(name))
    def check(text: str) -> None:
        file = spoil(folder, name, text)
        findings = Findings.read(file)
        if not findings.problems:
            assert findings.experiment().protocol.n_trials > 0
        for problem in findings.problems:
            assert problem.line >= 1
            assert problem.column >= 1
            assert len(str(problem)) < 1500

    check()


@pytest.mark.hypothesis
@pytest.mark.parametrize("name", [PROTOCOL, BEAM])
def test_the_check_gives_problems_or_predictions(folder: Path, name: str) -> None:
    """The output is always valid JSON."""

    @settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
    @given(spoilt(name))
    def check(text: str) -> None:
        values = examine(spoil(folder, name, text)).as_dict()
        assert json.dumps(values, allow_nan=False)
        assert bool(values["problems"]) != bool(values["stimuli"])

    check()


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(content=st.binary(max_size=300))
def test_arbitrary_bytes_give_problems(folder: Path, content: bytes) -> None:
    """The file was never YAML."""
    file = folder / "bytes.yaml"
    file.write_bytes(content)
    assert Findings.read(file).problems
