"""Lists of answers: order on the screen, meanings, and faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from modaltouch.protocol import AnswerList, Findings, InputError

Edit = Callable[..., Path]

FILE = "demo.yaml"
BOTH = "    both: [up, down, num_8]\n"


def test_the_papers_answers_are_on_the_side_of_their_fingers() -> None:
    """Whatever their order in the file; "felt nowhere" is below them."""
    answers = AnswerList.of({"keys": ["none", "right", "both", "left"]})
    assert answers.names == ("left", "both", "right", "none")
    assert [answer.is_below for answer in answers] == [False, False, False, True]
    assert answers.ranked.names == ("left", "right", "both", "none")
    assert AnswerList.of({}).names == ("left", "both", "right")


def test_two_answers_are_side_by_side():
    """A separate button would attract answers to the other; `below` or a third answer overrides this."""
    two = AnswerList.of({"keys": ["felt", "none"]})
    assert [(each.name, each.is_below) for each in two] == [("felt", False), ("none", False)]
    assert [each.is_below for each in AnswerList.of({"keys": ["felt", "none"], "below": ["none"]})] == [False, True]
    assert [each.is_below for each in AnswerList.of({"keys": ["left", "right", "none"]})] == [False, False, True]


def test_other_answers_keep_the_order_of_the_file() -> None:
    """Unless all of a row name fingers; those listed under `below` are below."""
    grades = AnswerList.of({"keys": ["stronger", "unsure", "weaker"], "below": ["unsure"]})
    assert grades.names == ("stronger", "weaker", "unsure")
    assert not grades.compares
    fingers = {"rechts": ["right"], "links": ["left"], "beide": ["right", "left"]}
    german = AnswerList.of({"keys": ["rechts", "links", "beide"], "fingers": fingers})
    assert german.names == ("links", "beide", "rechts")
    assert german.compares
    both = german.naming("left", "right")
    assert both is not None and both.name == "beide"
    assert (german.named("rechts").fingers, german.named("time_out").fingers) == (("right",), None)


def test_words_of_a_table_give_its_answer_list() -> None:
    """If all are answers of the paper, the list is the paper's, including unused answers."""
    assert AnswerList.of_words(("left",)).names == ("left", "both", "right")
    assert AnswerList.of_words(("none",)).names == ("left", "both", "right", "none")
    assert AnswerList.of_words(("more", "less")).names == ("more", "less")


def test_the_record_of_the_papers_answers_is_unchanged(shipped) -> None:
    """It has no key for options that are not given."""
    written = Findings.read(shipped / FILE).experiment().protocol.answers.model_dump(mode="json")
    assert not {"fingers", "below"} & set(written)
    assert written["keys"]["left"] == ["left", "num_4"]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("    left: [left, num_4]\n" + BOTH, "", "answers.keys: given 1 answer; allowed: 2 to 7 answers"),
        (BOTH, "    time_out: [up]\n", "answers.keys.time_out: given time_out, which is recorded when no answer comes"),
        (
            "  keys:\n",
            "  fingers: {links: [left]}\n  keys:\n",
            "answers.fingers.links: given 'links', which has no keys",
        ),
        (BOTH, "    C: [up]\n", "answers.keys.C: given C, which is a zone, and tables label answers by zone"),
        (BOTH, "    n: [up]\n", "answers.keys.n: given n, which is also a column of the table of counts"),
        (
            "  keys:\n",
            "  fingers: {both: [left, left]}\n  keys:\n",
            "answers.fingers.both: given [left, left]; allowed: each finger once",
        ),
        (
            "  keys:\n",
            "  fingers: {left: [right]}\n  keys:\n",
            "answers.fingers.left: given [right] for 'left'; allowed: [left], which that name stands for",
        ),
        ("  keys:\n", "  below: [bath]\n  keys:\n", "answers.below[0]: given 'bath', which has no keys"),
        (
            "  keys:\n",
            "  below: [both, both]\n  keys:\n",
            "demo.yaml:38:17: answers.below[1]: given both, the same answer as below[0]; allowed: each answer once",
        ),
        (
            BOTH,
            "    rechts: [up]\n",
            "answers.keys.rechts: given no text `answers.rechts` in english.yaml, which this needs",
        ),
        (
            BOTH,
            "    very strong: [up]\n",
            "given 'very strong' as a key; allowed: a word of letters, digits, _ and -; write 'very_strong'",
        ),
        (
            BOTH,
            "    very strong: [up]\n",
            "given no text `answers.very_strong` in english.yaml, which this needs; allowed: a text there; add it",
        ),
    ],
)
def test_faults_of_a_list_have_their_position(edit: Edit, old: str, new: str, fault: str) -> None:
    """At least two answers are needed, each with keys and a label."""
    with pytest.raises(InputError) as caught:
        Findings.read(edit(FILE, (old, new))).experiment()
    assert any(fault in str(problem) for problem in caught.value.problems), caught.value.problems


@pytest.mark.parametrize("label", ["Unter\u00adschiedlicheres", "ทั้งสองนิ้วรู้สึกเหมือน", "ทั้งสองนิ้ว\u200bรู้สึกเท่ากัน"])
def test_vowel_signs_and_places_to_break_make_no_word_too_long(edit: Edit, label: str) -> None:
    """Of the 23 characters of the second, 15 are letters; by UAX 29 the others belong to the letter before."""
    assert label_texts(edit, label).experiment().texts.label("rechts") == label


@pytest.mark.parametrize(
    ("label", "fault"),
    [
        ("' '", "answers.rechts: given an empty text; allowed: at least one word"),
        (
            "The right one I should say - beyond doubt",
            "answers.rechts: given 41 letters on a button; allowed: at most 40",
        ),
        (
            "Unterschiedlicheres",
            "answers.rechts: given a word of 19 letters on a button; allowed: at most 17 with 3 answers in a row; "
            "shorten it, or write a soft hyphen (U+00AD) or zero-width space (U+200B) where it may break",
        ),
        ("ทั้งสองนิ้วรู้สึกเหมือนกันมาก", "answers.rechts: given a word of 20 letters on a button; allowed: at most 17"),
        ("'Press {key}'", "answers.rechts: given {key} in 'Press {key}'; allowed: no words in braces"),
    ],
)
def test_unusable_labels_are_refused(edit: Edit, label: str, fault: str) -> None:
    """Empty ones, ones too long for a common size, and ones with braces."""
    with pytest.raises(InputError) as caught:
        label_texts(edit, label).experiment()
    assert any(fault in str(problem) for problem in caught.value.problems), caught.value.problems


def label_texts(edit: Edit, label: str) -> Findings:
    """Return a protocol whose answer `rechts` has a label."""
    file = edit(FILE, (BOTH, "    rechts: [up]\n"))
    texts = file.parent / "texts" / "english.yaml"
    words = texts.read_text(encoding="utf-8").replace("\nanswers:\n", f"\nanswers:\n  rechts: {label}\n")
    texts.write_text(words, encoding="utf-8")
    return Findings.read(file)


def test_two_answers_for_one_finger_are_refused(edit: Edit) -> None:
    """Counts would be ambiguous."""
    change = ("  keys:\n", "  fingers: {links: [left]}\n  keys:\n    links: [l]\n")
    with pytest.raises(InputError, match="names the same fingers as"):
        Findings.read(edit(FILE, change)).experiment()


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            [("practice_trials: 1", "practice_trials: 1\n  practice_feedback: true")],
            "schedule.practice_feedback: given true",
        ),
        (
            [("practice_trials: 1", "practice_trials: 1\n  practice_criterion: 0.5")],
            "schedule.practice_criterion: given 0.5",
        ),
    ],
)
def test_practice_cannot_be_judged_without_finger_answers(edit: Edit, changes, fault: str) -> None:
    """The right answer follows from the speeds under the fingers."""
    keys = ("    left: [left, num_4]\n" + BOTH + "    right: [right, num_6]\n", "    more: [up]\n    less: [down]\n")
    with pytest.raises(InputError, match=f"{fault}, but no answer names a finger or an interval"):
        Findings.read(edit(FILE, keys, *changes)).experiment()


def test_a_turned_beam_needs_answers_for_both_sides(edit: Edit) -> None:
    """Left on a turned beam is the right zone, which needs an answer, too."""
    changes = [
        ("    right: [right, num_6]\n", ""),
        ("  hand: right", "  placements: [normal, mirrored]\n  hand: right"),
    ]
    with pytest.raises(InputError, match="a turned beam, but 'left' has no counterpart on the other side"):
        Findings.read(edit(FILE, *changes)).experiment()


def test_focus_named_needs_an_answer_for_each_finger(edit: Edit) -> None:
    """Otherwise the adaptive rule is refused."""
    text = (edit("threshold.yaml")).read_text(encoding="utf-8")
    keys = text[text.index("    left:") :]
    with pytest.raises(InputError, match="focus_named, but the answers do not name each finger alone"):
        Findings.read(edit("threshold.yaml", (keys, "    more: [up]\n    less: [down]\n"))).experiment()


@pytest.mark.parametrize("section", ["form:", "  then:"])
def test_no_answer_of_a_further_question_is_called_like_a_time_out(edit: Edit, section: str) -> None:
    """It would be read as a missing answer, and the others counted as all there are."""
    question = "{sure: {question: Sure?, keys: {time_out: [up], sure: [down]}}}"
    lines = [f"{section} {question}", "answers:"] if section == "form:" else ["answers:", f"{section} {question}"]
    changes = ("\nanswers:\n", "\n{}\n{}\n".format(*lines))
    fault = "time_out, which is recorded when no answer comes in time; allowed: any other name"
    with pytest.raises(InputError, match=f"sure.keys.time_out: given {fault}"):
        Findings.read(edit(FILE, changes)).experiment()


@pytest.mark.parametrize(
    "line",
    [
        "instructions: ''",
        "form: {tired: {question: ' ', scale: {kind: vas}}}",
        "people: {sex: {kind: choice, question: Sex?, choices: ['', female]}}",
        "people: {age: {kind: number, question: ''}}",
    ],
)
def test_what_the_participant_reads_is_not_empty(edit: Edit, line: str) -> None:
    """The screen would show nothing, or the question of the texts in place of the one that was left blank."""
    with pytest.raises(InputError, match="given an empty text; allowed: at least one word; write what the participant"):
        Findings.read(edit(FILE, ("\nanswers:\n", f"\n{line}\nanswers:\n"))).experiment()


def test_an_empty_question_of_a_record_is_that_of_the_texts(edit: Edit) -> None:
    """It was allowed once, and asked so; a new file may not have it."""
    experiment = Findings.read(edit(FILE)).experiment()
    text = experiment.sources.protocol.text.replace("\nanswers:\n", "\nanswers:\n  question: ''\n")
    sources = replace(experiment.sources, protocol=replace(experiment.sources.protocol, text=text))
    assert Findings.restored(sources).experiment().texts.question == experiment.texts.question
