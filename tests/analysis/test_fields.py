"""The field of a report is the one that the record keeps; of a record that keeps none it is predicted again."""

from pathlib import Path

import pytest

import modaltouch
from modaltouch.analysis.optional_figures import draw_fields
from modaltouch.preflight import examine
from modaltouch.record import Session

FORMAT_1 = Path(__file__).parents[1] / "record" / "format_1" / "simulated"


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Start record of a session of today's format."""
    return modaltouch.simulate_session("demo", "p01", tmp_path_factory.mktemp("results")).start


def curves(figure):
    """The lines of the left picture by their labels."""
    return {line.get_label(): list(line.get_ydata()) for line in figure.axes[0].lines}


def test_a_session_keeps_its_field_and_the_report_draws_that(monkeypatch, start):
    """201 points from end to end of the beam; nothing is designed for them."""
    monkeypatch.setattr(
        "modaltouch.analysis.optional_figures._predict_again", lambda start: pytest.fail("was designed again")
    )
    (kept,) = start["stimulus"]["fields"]
    assert kept == examine("demo").fields[0]
    drawn = curves(draw_fields(start))
    assert drawn == {"target": kept["target_mm_s"], "predicted": kept["predicted_mm_s"]}
    assert len(drawn["predicted"]) == 201
    assert max(drawn["predicted"]) == pytest.approx(kept["velocity_mm_s"], rel=0.01)


def test_a_record_without_a_field_shows_the_same(start):
    """Those of former versions: everything that the field follows from is in their texts."""
    former = start | {"stimulus": {name: start["stimulus"][name] for name in start["stimulus"].keys() - {"fields"}}}
    assert curves(draw_fields(former)) == curves(draw_fields(start))


@pytest.mark.parametrize(("stimulus", "is_drawn"), [("sharp", True), ("blunt", True), ("", False), ("other", False)])
def test_each_of_several_stimuli_has_its_field(stimulus, is_drawn):
    """And nothing is drawn of one that the record does not know."""
    start = Session.find(FORMAT_1 / "two_fields").start
    assert (draw_fields(start, stimulus) is not None) is is_drawn


def test_a_table_without_a_record_has_no_field():
    """A CSV says nothing of a stimulus."""
    assert draw_fields({}) is None


def test_a_protocol_that_this_version_cannot_read_leaves_the_field_out(start):
    """Only where the record keeps none."""
    unread = start["sources"] | {"protocol": start["sources"]["protocol"] | {"text": "protocol: 3"}}
    assert draw_fields(start | {"sources": unread}) is not None
    assert draw_fields(start | {"sources": unread, "stimulus": {}}) is None
