"""A report draws the field that the record keeps."""

import pytest

import modaltouch
from modaltouch.analysis.figures import draw_fields
from modaltouch.preflight import examine


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Start record of a session in the current format."""
    return modaltouch.simulate_session("demo", "p01", tmp_path_factory.mktemp("results")).start


def curves(figure):
    """The lines of the left plot by label."""
    return {line.get_label(): list(line.get_ydata()) for line in figure.axes[0].lines}


def test_a_session_keeps_its_field_and_the_report_draws_that(start):
    """It has 201 points over the length of the beam."""
    (kept,) = start["stimulus"]["fields"]
    assert kept == examine("demo").fields[0]
    drawn = curves(draw_fields(start))
    assert drawn == {"target": kept["target_mm_s"], "predicted": kept["predicted_mm_s"]}
    assert len(drawn["predicted"]) == 201
    assert max(drawn["predicted"]) == pytest.approx(kept["velocity_mm_s"], rel=0.01)


def test_each_of_several_stimuli_has_its_field(tmp_path):
    """Nothing is drawn for a stimulus that the record does not contain."""
    start = modaltouch.simulate_session("two_fields", "p01", tmp_path).start
    drawn = {name: draw_fields(start, name) is not None for name in ("sharp", "blunt", "", "other")}
    assert drawn == {"sharp": True, "blunt": True, "": False, "other": False}


def test_a_table_without_a_record_has_no_field():
    """A CSV has no stimulus."""
    assert draw_fields({}) is None
