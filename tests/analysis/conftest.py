"""Synthetic answers for the tests of the analysis; no real participant gave any of them."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

Row = dict[str, Any]
COLUMNS = ("participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response")
LEVELS = (80, 100, 150, 200)
PAIRS = (("A", "C"), ("B", "D"), ("C", "E"))
CONDITIONS = ("one_hand", "two_hands")


def answers_like_the_paper(n: int = 10) -> list[Row]:
    """Return a synthetic set modelled on the text of section V; (B, D) and all of test 2 are invented."""
    rows = []
    for condition in CONDITIONS:
        for i in range(n):
            for level in LEVELS:
                one = condition == "one_hand"
                ac = "both" if (one and i == 3 and level == 150) or (not one and i == 5 and level == 80) else "right"
                bd = "left" if i < 2 or (one and i == 2 and level >= 150) else "both"
                bd = "right" if one and i == 7 and level == 80 else bd
                ce = "both" if one and i == 6 and level in (80, 100) else "left"
                for (left, right), response in zip(PAIRS, (ac, bd, ce), strict=True):
                    rows.append(
                        dict(zip(COLUMNS, (f"p{i + 1:02d}", condition, left, right, level, response), strict=False))
                    )
    return rows


def constant_answers(n: int = 10, response: str = "both") -> list[Row]:
    """Return a synthetic set in which every participant always gives the same answer."""
    return [{**row, "response": response} for row in answers_like_the_paper(n)]


def random_answers(n: int, seed: int, repetitions: int = 1) -> list[Row]:
    """Return a synthetic set of random answers."""
    rng = np.random.default_rng(seed)
    return [
        {**row, "response": str(rng.choice(["left", "both", "right"])), "repetition": r + 1}
        for row in answers_like_the_paper(n)
        for r in range(repetitions)
    ]


def tidy(rows: list[Row]) -> pd.DataFrame:
    """Return rows as the tidy table that the analysis uses."""
    frame = pd.DataFrame(rows)
    frame["velocity_mm_s"] = frame["velocity_mm_s"].astype(float)
    frame["n"] = frame.get("n", pd.Series(1, index=frame.index))
    return frame


@pytest.fixture
def paper_rows() -> list[Row]:
    """Synthetic answers modelled on the paper's text."""
    return answers_like_the_paper()


@pytest.fixture(scope="session")
def paper_csv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The synthetic answers modelled on the paper's text, as a CSV file."""
    path = tmp_path_factory.mktemp("data") / "answers.csv"
    rows = [",".join(map(str, row.values())) for row in answers_like_the_paper()]
    path.write_text("\n".join([",".join(COLUMNS), *rows]) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def paper_frame() -> pd.DataFrame:
    """The synthetic answers modelled on the paper's text, as a tidy table."""
    return tidy(answers_like_the_paper())


@pytest.fixture
def build() -> dict[str, Callable[..., Any]]:
    """Functions that make synthetic answers: paper, constant, random, tidy."""
    return {
        "paper": answers_like_the_paper,
        "constant": constant_answers,
        "random": random_answers,
        "tidy": tidy,
    }


@pytest.fixture
def write_csv(tmp_path: Path) -> Callable[..., Path]:
    """Write rows to a CSV file and return its path."""

    def write(rows: list[Row], name: str = "answers.csv", separator: str = ",") -> Path:
        path = tmp_path / name
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), delimiter=separator, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        return path

    return write
