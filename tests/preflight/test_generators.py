"""The limits of a generator come from its own data, whichever model the apparatus has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from modaltouch.preflight import examine

FILE = "differentiated_stimulation.yaml"
AFG, KEYSIGHT = "apparatus/beam_100x6x2.yaml", "apparatus/keysight_33522b.yaml"
Edit = Callable[..., Path]


def faults(file: Path) -> list[str]:
    """Return the faults of a protocol and its files."""
    return [str(problem).replace(str(file.parent) + "/", "") for problem in examine(file).problems]


@pytest.mark.parametrize(
    ("apparatus", "most", "model"), [(AFG, 131_072, "AFG3022B"), (KEYSIGHT, 262_144, "33522B")], ids=["afg", "keysight"]
)
def test_the_number_of_samples_is_limited_by_the_record(edit: Edit, apparatus: str, most: int, model: str) -> None:
    """Two more samples than its longest record are refused, with the model in the message."""
    (found,) = faults(edit(FILE, (AFG, apparatus), ("n_samples: 125000", f"n_samples: {most + 2}")))
    told = f"stimulus.n_samples: given {most + 2}; allowed: at most {most}, the points of a record of the {model}"
    assert told in found


@pytest.mark.parametrize(("apparatus", "clock", "most"), [(AFG, 250, 75_000), (KEYSIGHT, 62.5, 18_750)])
def test_the_sampling_rate_is_limited_by_the_clock(edit: Edit, apparatus: str, clock: float, most: int) -> None:
    """125,000 samples in 0.3 ms need 417 MHz."""
    changes = ("duration_ms: 50", "duration_ms: 0.3"), ("focusing_instant_ms: 25", "focusing_instant_ms: 0.15")
    (found,) = faults(edit(FILE, (AFG, apparatus), *changes))
    assert (
        f"in 0.3 ms, which is 4.167e+08 Hz; allowed: at most {most} samples, at the generator's {clock:g} MHz" in found
    )


def test_a_timer_that_the_channels_do_not_share_is_refused(edit: Edit) -> None:
    """The fault is at the key of the apparatus file that sets it."""
    file = edit(FILE, (AFG, KEYSIGHT))
    beam = file.parent / KEYSIGHT
    text = beam.read_text(encoding="utf-8")
    beam.write_text(text.replace("  load: high", "  repetition: timer\n  load: high"), encoding="utf-8")
    (found,) = faults(file)
    told = "generator.repetition: given timer, which the channels of a 33522B do not share; allowed: single"
    assert told in found


def test_samples_jitter_only_on_a_fixed_clock(edit: Edit) -> None:
    """131,072 in 50 ms divide no clock evenly: edges of the AFG3022B jitter, those of the 33522B do not."""
    samples = "n_samples: 125000", "n_samples: 131072"
    assert any("edges jitter" in each for each in examine(edit(FILE, samples)).as_dict()["warnings"])
    examined = examine(edit(FILE, (AFG, KEYSIGHT)))
    assert not any("edges jitter" in each for each in examined.as_dict()["warnings"])
    assert examined.designed is not None
    assert examined.designed.timing.clock_error is None


def test_a_generator_without_a_driver_is_warned_of(edit: Edit) -> None:
    """A series is not a model: `run` would drive it like the first generator of the list."""
    file = edit(FILE, (AFG, KEYSIGHT))
    assert not any("there is no driver" in said for said in examine(file).as_dict()["warnings"])
    beam = file.parent / KEYSIGHT
    beam.write_text(beam.read_text(encoding="utf-8").replace("model: 33522B", "model: 33500B"), encoding="utf-8")
    told = "there is no driver for the generator 33500B: that of the AFG3022B will be used"
    assert any(told in said for said in examine(file).as_dict()["warnings"])
