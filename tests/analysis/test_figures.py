from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.transforms import Bbox

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.crossed import zone_table
from modaltouch.analysis.figures import draw_bars, draw_counts
from modaltouch.analysis.report import NOTHING, OTHER_COLOURS, TIED, ZONE_COLOURS, participant_strips
from modaltouch.protocol import AnswerList
from modaltouch.report.page import FAINT, INK, PAIR_COLOURS, render


def bars(figure):
    """Return the heights and colours of the bars of a figure, from left to right."""
    found = [patch for axes in figure.axes for patch in axes.patches]
    return [patch.get_height() for patch in found], [to_hex(patch.get_facecolor()) for patch in found]


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour (Rec. 709 weights on linear values)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


@pytest.fixture
def table(paper_frame):
    """Fig. 10's table of the synthetic set."""
    return zone_table(count_answers(paper_frame), "one_hand")


def test_every_bar_is_as_high_as_its_count(table) -> None:
    """Nine answers times four levels, in the table's order."""
    heights, _ = bars(draw_counts(table, "one_hand"))
    assert heights == table.to_numpy().ravel().tolist()


def test_pairs_have_the_papers_colours(table) -> None:
    """Section V: dark blue (A, C), light blue (B, D), yellow (C, E)."""
    _, colours = bars(draw_counts(table, "one_hand"))
    assert [colours[0], colours[12], colours[24]] == list(PAIR_COLOURS[:3])


def test_the_three_colours_differ_in_greyscale() -> None:
    """In a print without colour, neighbours have a luminance contrast of at least 1.3."""
    dark, light, yellow = sorted(luminance(colour) for colour in PAIR_COLOURS[:3])
    assert (light + 0.05) / (dark + 0.05) > 3
    assert (yellow + 0.05) / (light + 0.05) > 1.3


def test_error_bars_are_clopper_pearson(table) -> None:
    """10 of 10 gives 6.9150 (10 x 0.025^(1/10)) to 10."""
    axes = draw_counts(table, "one_hand").axes[0]
    low, high = axes.collections[0].get_segments()[0][:, 1]
    assert (low, high) == pytest.approx((10 * 0.025**0.1, 10))


def test_repetitions_do_not_narrow_the_bars(build) -> None:
    """Two answers each of five participants give the width of five answers, scaled to ten."""
    frame = build["tidy"]([{**row, "repetition": r} for row in build["constant"](5, "left") for r in (1, 2)])
    table = zone_table(count_answers(frame), "one_hand")
    axes = draw_counts(table, "one_hand", 5).axes[0]
    segments = [segment[:, 1] for collection in axes.collections for segment in collection.get_segments()]
    full = next(segment for segment in segments if segment[1] == pytest.approx(10))
    assert full[0] == pytest.approx(10 * 0.025 ** (1 / 5))


def test_the_axis_runs_from_none_to_all(table) -> None:
    """The y axis runs from 0 to N, and its label gives N."""
    axes = draw_counts(table, "one_hand").axes[0]
    assert axes.get_ylim()[0] == 0
    assert 10 <= axes.get_ylim()[1] <= 10.5
    assert "out of 10" in axes.get_ylabel()


def test_every_answer_and_level_is_written_out(table) -> None:
    """Text labels supplement colour: three pairs, nine answers, four levels under each."""
    words = [text.get_text() for text in draw_counts(table, "one_hand").axes[0].texts]
    assert [word for word in words if "&" in word] == ["C & A", "B & D", "C & E"]
    assert words.count("150") == 9
    assert "(B, D)" in words


def test_five_pairs_of_seven_levels_fit_in_two_rows(build) -> None:
    """A design with more pairs and levels than the paper's is laid out in two rows."""
    rows = [
        {"participant": f"p{i}", "finger_condition": "one_hand", "zone_left": left, "zone_right": right,
         "velocity_mm_s": level, "response": "left"}
        for i in range(3) for left, right in ("AC", "BD", "CE", "AE", "BE") for level in range(50, 400, 50)
    ]  # fmt: skip
    figure = draw_counts(zone_table(count_answers(build["tidy"](rows)), "one_hand"), "one_hand")
    assert len(figure.axes) == 2
    assert len(bars(figure)[0]) == 5 * 3 * 7


def test_strips_show_every_answer_as_a_letter(paper_frame) -> None:
    """240 cells each have the letter of their zone, or &."""
    strips = participant_strips(count_answers(paper_frame))
    letters = [
        kind.letter
        for rows in strips["rows"].values() for pairs in rows.values() for cells in pairs for kind in cells
    ]  # fmt: skip
    assert (len(letters), letters.count("D")) == (240, 1)
    assert set(letters) <= set("ABCDE&")
    assert [kind.name for kind in strips["legend"]] == ["dominant zone", "both", "other zone"]


LONG = ("clearly_stronger_on_the_left", *(f"stronger_under_finger_{n}_of_6" for n in range(2, 7)), "I" * 30)


def answers_of(build, names, n_pairs, levels):
    """Return counts in which seven participants give the answers of a list in rotation."""
    rows = [
        {"participant": f"p{i}", "finger_condition": fingers, "zone_left": left, "zone_right": right,
         "velocity_mm_s": level, "response": names[(i + place) % len(names)]}
        for i in range(7) for fingers in ("one_hand", "two_hands") for left, right in ("AC", "BD", "CE")[:n_pairs]
        for place, level in enumerate(levels)
    ]  # fmt: skip
    return count_answers(build["tidy"](rows), offered=AnswerList.of({"keys": names}))


def cut_or_overlapping(figure, texts):
    """Return the texts that leave the figure or overlap another one."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = {text: text.get_window_extent() for text in texts if text.get_text() and text.get_visible()}
    page = figure.bbox
    cut = [t for t, b in boxes.items() if b.x0 < 0 or b.y0 < 0 or b.x1 > page.x1 or b.y1 > page.y1]
    pairs = [(a, b) for a, b in combinations(boxes, 2) if Bbox.intersection(boxes[a], boxes[b]) is not None]
    return [t.get_text() for t in cut], [(a.get_text(), b.get_text()) for a, b in pairs]


@pytest.mark.parametrize("levels", [(100,), (80, 100, 150, 200)], ids=len)
@pytest.mark.parametrize("n_pairs", [1, 3])
@pytest.mark.parametrize("names", [LONG, LONG[:2], tuple("abcdefg")], ids=["long", "two", "short"])
def test_answer_names_are_legible_below_their_bars(build, names, n_pairs, levels) -> None:
    """Two or seven answers of up to 30 letters: all are drawn, none is cut off or overlaps another."""
    answers = answers_of(build, names, n_pairs, levels)
    figure = draw_counts(zone_table(answers, "one_hand"), "one_hand")
    texts = [text for axes in figure.axes for text in (*axes.texts, axes.xaxis.label)]
    assert cut_or_overlapping(figure, [*texts, figure._suptitle]) == ([], [])
    written = " " + "".join(text.get_text().replace("\n", "") + " " for text in texts)
    assert all(written.count(f" {name} ") == n_pairs for name in names)


def test_strips_distinguish_seven_answers(build) -> None:
    """There are seven colours, sufficiently different, and seven letters."""
    legend = participant_strips(answers_of(build, LONG, 3, (80, 100, 150, 200)))["legend"]
    assert len({kind.letter for kind in legend}) == 7
    colours = [np.array(to_rgb(kind.colour)) for kind in legend]
    assert min(float(np.abs(a - b).max()) for a, b in combinations(colours, 2)) > 0.05


def test_letters_have_enough_contrast_on_every_colour() -> None:
    """WCAG 2.2, success criterion 1.4.3: a contrast of at least 4.5, also of faint text on white."""
    under = [*ZONE_COLOURS, *OTHER_COLOURS, TIED, NOTHING]
    pairs = [(INK, colour) for colour in under] + [(FAINT, "#ffffff")]
    assert min((luminance(b) + 0.05) / (luminance(a) + 0.05) for a, b in pairs) >= 4.5


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_a_figure_has_reproducible_bytes(paper_frame, kind) -> None:
    """It has no date and no random identifier."""
    table = zone_table(count_answers(paper_frame), "one_hand")
    assert render(draw_counts(table, "one_hand"), kind) == render(draw_counts(table, "one_hand"), kind)


def test_error_bars_depend_on_the_answers_of_their_cell(table) -> None:
    """Of ten participants seven answered one level and none another: 1 of 7 gives 0.36 to 57.87 %, none no bar."""
    table = table.copy()
    table.loc["A-C", 80.0] = [1, 0, 6]
    table.loc["A-C", 100.0] = [0, 0, 0]
    with np.errstate(all="raise"):
        segments = draw_counts(table, "one_hand", n_participants=10).axes[0].collections[0].get_segments()
    assert segments[0][:, 1] == pytest.approx([7 * 0.003610, 7 * 0.578723], abs=1e-4)
    assert segments[1][:, 1].tolist() == [0, 0]


def test_only_the_papers_design_has_the_papers_figure_numbers(build) -> None:
    """Other levels are another experiment, whose figure is not Fig. 10 of the paper."""
    frame = build["tidy"](build["paper"](3))
    captions = [picture.caption for picture in draw_bars(count_answers(frame))]
    assert [caption[:8] for caption in captions] == ["Fig. 10.", "Fig. 11."]
    others = draw_bars(count_answers(frame[frame["velocity_mm_s"] > 80]))
    assert all(picture.caption.startswith("Answers: ") for picture in others)
