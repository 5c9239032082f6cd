"""The records in the instrument's memories are sent once, verified, recognised and locked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst


def test_memories_contain_the_codes(loaded: Generator, simulator: Simulator, burst: Burst) -> None:
    """USER1 and USER2 contain the burst's codes, two bytes each, big-endian."""
    for number, codes in enumerate(burst.codes, start=1):
        assert simulator.afg.user[number] == codes.astype(">u2").tobytes()


def test_a_record_already_in_memory_is_not_sent_again(
    open_generator: Callable[..., Generator], burst: Burst, heard: Any
) -> None:
    """A second session reads the memories back, finds the records correct and sends none."""
    with open_generator() as first:
        first.load(burst)
    assert len(heard.of("record_sent")) == 2
    heard.clear()
    open_generator().load(burst)
    assert heard.of("record_sent") == []
    assert len(heard.of("record_found")) == 2


def test_a_record_with_one_wrong_code_is_sent_again(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst, heard: Any
) -> None:
    """A memory that differs in a single code is overwritten with the right record."""
    with open_generator() as first:
        first.load(burst)
    simulator.front_panel("DATA:COPY EMEM,USER2;:DATA:DATA:VAL EMEM,1000,8192;:DATA:COPY USER2,EMEM")
    heard.clear()
    open_generator().load(burst)
    assert [facts["memory"] for facts in heard.of("record_sent")] == ["USER2"]
    assert simulator.afg.user[2] == burst.codes[1].astype(">u2").tobytes()


def test_two_bursts_share_the_memories(
    loaded: Generator, simulator: Simulator, burst: Burst, make: Callable[..., Burst], heard: Any
) -> None:
    """After another burst has been loaded, loading the first one again plays the first one's records."""
    other = make(seed=1)
    loaded.load(other)
    loaded.load(burst)
    loaded.fire(0.1)
    for channel, codes in zip(simulator.afg.channels.values(), burst.codes, strict=True):
        assert simulator.afg.user[int(channel.function[4:])] == codes.astype(">u2").tobytes()


def test_bursts_alternate_without_an_upload(
    generator: Generator, simulator: Simulator, burst: Burst, make: Callable[..., Burst], heard: Any
) -> None:
    """Two bursts of four records fill the memories; firing them in any order sends only settings."""
    other = replace(make(seed=1), repetition_rate=5.0, amplitude=(6.0, 3.0))
    generator.load(burst, other)
    assert len(heard.of("record_sent")) == 4
    heard.clear()
    for which in (0, 1, 1, 0):
        chosen = (burst, other)[which]
        firing = generator.fire(0.1, which=which)
        assert firing.started
        assert firing.commanded_amplitude == tuple(a / 2 for a in chosen.amplitude)
        for channel, codes in zip(simulator.afg.channels.values(), chosen.codes, strict=True):
            assert simulator.afg.user[int(channel.function[4:])] == codes.astype(">u2").tobytes()
        assert generator._player.period == pytest.approx(1 / chosen.repetition_rate)
        generator.stop()
        assert generator.firing is not None
        assert generator.firing.confirmed
    assert heard.of("record_sent") == []
    with pytest.raises(RigError, match="burst 2 was asked for: 0 to 1 are loaded"):
        generator.fire(0.1, which=2)


def test_records_that_exceed_the_memories_are_loaded_before_firing(
    generator: Generator, simulator: Simulator, make: Callable[..., Burst], heard: Any
) -> None:
    """Six different records do not fit into four memories; three bursts that share one channel's record do."""
    bursts = [make(seed=seed) for seed in (1, 2, 3)]
    generator.load(*bursts)
    assert len(heard.of("record_sent")) == 2
    for which in (2, 0, 0, 1):
        assert generator.fire(0.1, which=which).started
        for channel, codes in zip(simulator.afg.channels.values(), bursts[which].codes, strict=True):
            assert simulator.afg.user[int(channel.function[4:])] == codes.astype(">u2").tobytes()
        generator.stop()
        assert generator.firing is not None
        assert generator.firing.confirmed
    assert len(heard.of("record_sent")) == 2 + 3 * 2  # the third fire has what the second loaded
    shared = [replace(each, codes=np.stack([each.codes[0], bursts[0].codes[1]])) for each in bursts]
    generator.load(*shared)
    assert generator.fire(0.1, which=2).started


def test_the_log_contains_every_exchange_but_no_record(generator: Generator, burst: Burst, heard: Any) -> None:
    """Commands are logged with reply and time, a record by its length and hash."""
    generator.load(burst)
    exchanges = heard.of("scpi")
    assert all(facts["seconds"] >= 0 for facts in exchanges)
    assert max(len(str(facts)) for facts in exchanges) < 1000
    uploads = [facts["sent"] for facts in exchanges if facts["sent"].startswith("DATA:DATA EMEM,")]
    assert len(uploads) == 2
    assert all(f"<{2 * burst.codes.shape[1]} bytes, blake2b " in sent for sent in uploads)


def test_memories_are_locked_while_a_session_uses_them(
    loaded: Generator, simulator: Simulator, burst: Burst, open_generator: Callable[..., Generator]
) -> None:
    """The front panel cannot overwrite a record (-221) until the driver is closed."""
    loaded.fire(0.1)
    assert simulator.front_panel("*CLS;:DATA:COPY USER1,EMEM;:SYST:ERR?").startswith("-221")
    assert simulator.afg.user[1] == burst.codes[0].astype(">u2").tobytes()
    loaded.stop()
    assert loaded.firing is not None
    assert loaded.firing.confirmed
    loaded.close()
    assert simulator.front_panel("*CLS;:DATA:COPY USER1,EMEM;:SYST:ERR?").startswith("0,")


@pytest.mark.parametrize("n_points", [1000, 125_000])
def test_a_stimulus_is_not_confirmed_if_another_program_stores_a_record(
    loaded: Generator, simulator: Simulator, burst: Burst, n_points: int
) -> None:
    """It unlocks the memory, stores through the edit memory and locks it; the right record is then sent again."""
    loaded.fire(0.1)
    simulator.front_panel(f"DATA:LOCK USER1,OFF;:DATA:DEF EMEM,{n_points};:DATA:COPY USER1,EMEM;:DATA:LOCK USER1,ON")
    loaded.stop()
    assert loaded.firing is not None
    assert not loaded.firing.confirmed
    assert f"DATA:POIN EMEM reads {n_points}, " in loaded.firing.reason
    assert simulator.afg.user[1] == burst.codes[0].astype(">u2").tobytes()
    loaded.fire(0.1)
    loaded.stop()
    assert loaded.firing.confirmed


def test_each_burst_marks_the_edit_memory_differently(
    generator: Generator, simulator: Simulator, burst: Burst, make: Callable[..., Burst]
) -> None:
    """A second session of this program is detected too: its records differ, and so does its mark."""
    marks = set()
    for each in (burst, make(seed=1), make(seed=2)):
        generator.load(each)
        marks.add(len(simulator.afg.edit) // 2)
    assert len(marks) == 3
    assert all(n % 2 == 0 and n < 65_536 for n in marks)


def test_continuous_codes_are_the_burst_followed_by_rest(burst: Burst) -> None:
    """Point n of 131072 is at (n + 1/2) / (7 Hz * 131072): the burst's sample at that instant, otherwise 0 V."""
    codes = AFG3022B.continuous_codes(burst)
    n_points = 131_072
    assert codes.shape == (2, n_points)
    middles = (2 * np.arange(45_875) + 1) / (14 * n_points)
    samples = (middles / (0.05 / burst.codes.shape[1])).astype(int)
    np.testing.assert_array_equal(codes[:, :45_875], burst.codes[:, samples])
    assert (codes[:, 45_875:] == 8191).all()


@pytest.mark.parametrize("message", ["DATA:DATA EMEM,", "DATA:COPY USER1,EMEM"])
def test_an_error_during_upload_is_logged(
    generator: Generator, simulator: Simulator, burst: Burst, heard: Any, message: str
) -> None:
    """The upload is repeated and succeeds; the instrument's error is the reason."""
    simulator.faults.inject("scpi_error", when=message, value=-222)
    generator.load(burst)
    (said,) = heard.of("upload_repeated")
    assert said["memory"] == "USER1"
    assert "the generator reports -222," in said["reason"]
