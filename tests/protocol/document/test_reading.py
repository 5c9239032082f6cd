"""Trees to values: allowed values in words, and all faults at once."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field

from modaltouch.protocol.reading import read
from modaltouch.protocol.section import Count, Positive, Section, Text
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import Source
from modaltouch.protocol.wording import describe, suggest_number


class Inner(Section):
    """A section of a file."""

    speed_mm_s: Positive
    law: Literal["exact", "paper"] = "exact"
    levels_V: tuple[Positive, ...] = (1.0,)  # noqa: N815
    flag: bool = Field(strict=True, default=True)


class File(Section):
    """A file."""

    name: Text
    n_things: Count = 3
    inner: Inner
    limit_V: Positive | None = None  # noqa: N815
    pairs: tuple[tuple[Text, Text], ...] = ()


GOOD = "name: a\ninner:\n  speed_mm_s: 5\n"


def faults(text: str) -> list[str]:
    """Return the faults of a text."""
    return [str(problem) for problem in read(Source(Path("x"), text), File).problems]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (GOOD + "  n_things: 1\n", "flag; it belongs to the top of the file, not indented"),
        (GOOD + "law: paper\n", "pairs; it belongs to the section inner"),
        (GOOD + "  sped: 1\n", "x:4:3: inner.sped: given 'sped', which is not a key here; allowed: speed_mm_s, law"),
        (GOOD + "  speed_cm_s: 1\n", "did you mean 'speed_mm_s'?"),
        ("name: a\ninner: {}\n", "x:2:1: inner.speed_mm_s: given nothing; allowed: a number [mm/s] above 0; add the"),
        ("inner: {speed_mm_s: 1}\n", "x:1:1: name: given nothing; allowed: text; add the missing key `name`"),
        (GOOD.replace("5", "80 mm/s"), "x:3:15: inner.speed_mm_s: given '80 mm/s'; allowed: a number [mm/s] above 0;"),
        (GOOD.replace("5", "80 mm/s"), "write only the number: 80; the unit is part of the key"),
        (
            GOOD.replace("5", "0.08 m/s"),
            "given '0.08 m/s'; allowed: a number [mm/s] above 0; write the number in mm/s, ",
        ),
        (GOOD.replace("5", "0,5"), "write only the number: 0.5"),
        (
            GOOD + "  <<: {law: paper}\n",
            "x:4:3: inner.<<: given '<<', which is not a key here; allowed: speed_mm_s, law",
        ),
        (GOOD + "  <<: {law: paper}\n", "; YAML 1.2 has no merge keys: write out the keys that it would bring"),
        (GOOD.replace("5", "5e"), "x:3:15: inner.speed_mm_s: given '5e'"),
        (GOOD.replace("5", ".nan"), "x:3:15: inner.speed_mm_s: given .nan, which is not finite"),
        (GOOD.replace("5", "-.inf"), "x:3:15: inner.speed_mm_s: given -.inf, which is not finite"),
        (GOOD.replace("5", "1e999"), "x:3:15: inner.speed_mm_s: given 1e999, which is not finite"),
        (GOOD.replace("5", "true"), "x:3:15: inner.speed_mm_s: given true; allowed: a number [mm/s] above 0"),
        (GOOD.replace("5", "0"), "x:3:15: inner.speed_mm_s: given 0; allowed: a number [mm/s] above 0"),
        (GOOD.replace("5", "~"), "x:3:15: inner.speed_mm_s: given nothing; allowed: a number [mm/s] above 0"),
        (GOOD.replace("5", "9" * 5000), "9..., which is not finite; allowed: a number [mm/s] above 0"),
        (GOOD.replace("5", "[5]"), "x:3:15: inner.speed_mm_s: given a list of 1"),
        (GOOD + "  law: exakt\n", "x:4:8: inner.law: given 'exakt'; allowed: exact, paper; did you mean 'exact'?"),
        (GOOD + "  levels_V: [1, x]\n", "x:4:17: inner.levels_V[1]: given 'x'; allowed: a number [V] above 0"),
        (GOOD + "  levels_V: 5\n", "x:4:13: inner.levels_V: given 5; allowed: a list, each a number [V] above 0"),
        (GOOD + "  flag: yes\n", "x:4:9: inner.flag: given 'yes'; allowed: true or false"),
        (GOOD + "n_things: 2.0\n", "x:4:11: n_things: given 2.0; allowed: a whole number of at least 1; write 2"),
        (GOOD.replace("a\n", "1\n", 1), "x:1:7: name: given 1, which is not text; allowed: text; write it in quotes"),
        (GOOD + "limit_V: none\n", "x:4:10: limit_V: given 'none'; allowed: a number [V] above 0 or null"),
        (GOOD + "pairs: [[a]]\n", "x:4:9: pairs[0]: given a list of 1; allowed: a list of exactly 2, each text"),
        (GOOD + "pairs: [[a, b, c]]\n", "x:4:9: pairs[0]: given a list of 3; allowed: a list of exactly 2, each text"),
        ("name: a\ninner: 5\n", "x:2:8: inner: given 5; allowed: a mapping with the keys speed_mm_s, law"),
    ],
)
def test_each_fault_has_position_value_allowed_values_and_remedy(text: str, fault: str) -> None:
    """Lines and columns counted by hand."""
    (found,) = faults(text)
    assert fault in found


@pytest.mark.parametrize(("written", "number"), [("0,5", "0.5"), ("'5'", "5")])
def test_a_number_without_a_unit_is_told_nothing_of_units(written: str, number: str) -> None:
    """A decimal comma, and quotes; the unit is no part of the fault."""
    (found,) = faults(GOOD.replace("5", written))
    assert found.endswith(f"; write only the number: {number}")


def test_all_faults_come_at_once() -> None:
    """Four lines with a fault each."""
    text = "name: 1\nn_things: 0\nmore: 1\ninner:\n  speed_mm_s: x\n  law: 5\n"
    assert sorted(found.split(":")[1] for found in faults(text)) == ["1", "2", "3", "5", "6"]


def test_valid_values_are_available_despite_other_faults() -> None:
    """Only invalid values are missing; absent keys have their defaults."""
    text = "nam: x\nn_things: 0\ninner:\n  speed_mm_s: 7\n  levels_V: [1, -1, 3]\n"
    reading = read(Source(Path("x"), text), File)
    assert reading.value is None
    assert reading.sound("inner", "speed_mm_s") == 7
    assert reading.items("inner", "levels_V") == [(0, 1), (2, 3)]
    assert reading.sound("inner", "law") == "exact"
    assert reading.sound("n_things") is None
    assert reading.sound("name") is None
    assert reading.sound("inner", "nothing") is None
    assert reading.sound("inner") is None


def test_an_unreadable_text_has_no_valid_values() -> None:
    """Not even defaults are returned."""
    reading = read(Source(Path("x"), "a: [\n"), File)
    assert reading.sound("n_things") is None
    assert reading.items("inner", "levels_V") == []


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (("n_things",), "a whole number of at least 1"),
        (("limit_V",), "a number [V] above 0 or null"),
        (("inner", "flag"), "true or false"),
        (("inner", "law"), "exact, paper"),
        (("pairs", 0, 1), "text"),
        (("nowhere", "at", "all"), ""),
    ],
)
def test_allowed_values_are_described_in_words(path: tuple[str | int, ...], words: str) -> None:
    """The types of the model above, in plain English."""
    assert describe(File, path) == words


def test_nested_unions_of_types_are_described() -> None:
    """An optional key may itself be a number or a list."""
    number_or_list = describe(Protocol, ("stimulus", "selected_modes"))
    assert number_or_list.startswith("a whole number of at least 1 or a list of at least 1")
    assert describe(Protocol, ("stimuli", "fast", "selected_modes")) == f"{number_or_list} or null"


@pytest.mark.parametrize(
    ("word", "number"),
    [("80 mm/s", "80"), ("80mm/s", "80"), ("-1.5e3 V", "-1.5e3"), ("0,5", "0.5"), ("mm", ""), ("", "")],
)
def test_the_number_in_front_of_a_unit_is_found(word: str, number: str) -> None:
    """The suggestion is the number without its unit."""
    assert suggest_number(word)[0] == number


@pytest.mark.parametrize("word", ["1_000", "1:20", "1/3", "2026-01-01", "８０"])
def test_ambiguous_numbers_are_not_suggested(word: str) -> None:
    """Suggesting 1 for 1_000 would change the experiment."""
    assert suggest_number(word) == ("", "")
