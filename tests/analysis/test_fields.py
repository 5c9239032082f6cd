"""A report draws the field that the record keeps; for a record without one the field is predicted again."""

from pathlib import Path

import pytest

import modaltouch
from modaltouch.analysis.optional_figures import draw_fields
from modaltouch.preflight import examine
from modaltouch.record import Session

FORMAT_1 = Path(__file__).parents[1] / "record" / "format_1" / "simulated"


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Start record of a session in the current format."""
    return modaltouch.simulate_session("demo", "p01", tmp_path_factory.mktemp("results")).start


def curves(figure):
    """The lines of the left plot by label."""
    return {line.get_label(): list(line.get_ydata()) for line in figure.axes[0].lines}


def test_a_session_keeps_its_field_and_the_report_draws_that(monkeypatch, start):
    """It has 201 points over the length of the beam, and no stimulus is designed for it."""
    monkeypatch.setattr(
        "modaltouch.analysis.optional_figures._predict_again", lambda start: pytest.fail("was designed again")
    )
    (kept,) = start["stimulus"]["fields"]
    assert kept == examine("demo").fields[0]
    drawn = curves(draw_fields(start))
    assert drawn == {"target": kept["target_mm_s"], "predicted": kept["predicted_mm_s"]}
    assert len(drawn["predicted"]) == 201
    assert max(drawn["predicted"]) == pytest.approx(kept["velocity_mm_s"], rel=0.01)


def test_a_record_without_a_field_gives_the_same_curves(start):
    """Records of earlier versions keep the texts of all files from which the field follows."""
    former = start | {"stimulus": {name: start["stimulus"][name] for name in start["stimulus"].keys() - {"fields"}}}
    assert curves(draw_fields(former)) == curves(draw_fields(start))


@pytest.mark.parametrize(("stimulus", "is_drawn"), [("sharp", True), ("blunt", True), ("", False), ("other", False)])
def test_each_of_several_stimuli_has_its_field(stimulus, is_drawn):
    """Nothing is drawn for a stimulus that the record does not contain."""
    start = Session.find(FORMAT_1 / "two_fields").start
    assert (draw_fields(start, stimulus) is not None) is is_drawn


def test_a_table_without_a_record_has_no_field():
    """A CSV has no stimulus."""
    assert draw_fields({}) is None


def test_a_protocol_that_this_version_cannot_read_leaves_the_field_out(start):
    """It is left out only if the record keeps no field."""
    unread = start["sources"] | {"protocol": start["sources"]["protocol"] | {"text": "protocol: 3"}}
    assert draw_fields(start | {"sources": unread}) is not None
    assert draw_fields(start | {"sources": unread, "stimulus": {}}) is None
