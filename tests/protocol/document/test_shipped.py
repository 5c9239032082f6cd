"""Shipped files are found by name."""

from __future__ import annotations

from pathlib import Path

import pytest

import modaltouch
from modaltouch.cli import SHIPPED_APPARATUS
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.source import InputError, Source


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", Source.shipped("protocol"))
def test_every_shipped_protocol_is_valid_by_name_in_any_folder(name: str) -> None:
    """From Python as well as on the command line."""
    preflight = modaltouch.examine(name).require()
    assert preflight.experiment.protocol.protocol == name


def test_a_session_is_simulated_by_name_in_any_folder() -> None:
    """The record is written below the current folder."""
    session = modaltouch.simulate_session("demo", "p01")
    assert session.n_answered == 12
    assert Path("results/simulated/demo/sub-p01/ses-1").is_dir()


def test_the_default_apparatus_is_found_in_any_folder() -> None:
    """It is a name, not a path in the repository."""
    assert Apparatus.read(SHIPPED_APPARATUS).apparatus == "beam_100x6x2"


def test_an_existing_file_takes_precedence_over_a_name(tmp_path: Path) -> None:
    """A folder does not, since results may be in a folder named after a protocol."""
    Path("demo").mkdir()
    assert Source.find("protocol", "demo").path == Source.shipped("protocol")["demo"]
    Path("threshold").write_text("protocol: mine\n", encoding="utf-8")
    assert Source.find("protocol", "threshold").path == Path("threshold")
    (problem, *_) = modaltouch.examine("threshold").problems
    assert problem.file == "threshold"


@pytest.mark.parametrize("name", ["protocols/demo.yaml", "demo.yaml", "Demo", "demos"])
def test_unknown_names_are_refused_with_the_known_ones(name: str) -> None:
    """Also a path of the repository, given elsewhere."""
    names = "or one of comparison_2ifc, demo, .*differentiated_stimulation, .*, with_catch_trials; did you mean 'demo'?"
    with pytest.raises(InputError, match=f"^{name}:1:1: given a file that does not exist; .*, {names}"):
        Source.find("protocol", name)
    with pytest.raises(InputError, match="or one of beam_100x6x2, keysight_33522b; check its name"):
        Apparatus.read("plate")
