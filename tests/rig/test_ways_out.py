"""However a session ends, the outputs are off, and the watchdog is informed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from modaltouch.rig.generator import Generator
from modaltouch.rig.instrument import Setting
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst


def test_an_exception_in_a_session_leaves_outputs_off(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst
) -> None:
    """Every exit from the with statement switches the outputs off."""

    class SomethingElse(BaseException):
        pass

    def sit() -> None:
        with open_generator() as rig:
            rig.load(burst)
            rig.fire(0.1)
            raise SomethingElse

    with pytest.raises(SomethingElse):
        sit()
    assert simulator.outputs == (False, False)


def test_close_is_final_and_can_be_repeated(loaded: Generator, simulator: Simulator, guard: Any) -> None:
    """The second close does nothing; the watchdog is released once, cleanly."""
    loaded.fire(0.1)
    loaded.close()
    loaded.close()
    assert simulator.outputs == (False, False)
    assert guard.told[-1] == "clean"
    assert guard.told.count("clean") == 1


def test_the_watchdog_is_armed_during_a_stimulus(loaded: Generator, guard: Any, heard: Any) -> None:
    """It is armed after the start and disarmed after the stop."""
    loaded.fire(0.1)
    assert guard.told[-1] == "arm"
    loaded.stop()
    assert guard.told[-1] == "disarm"


def test_an_interrupt_while_starting_leaves_outputs_off(loaded: Generator, simulator: Simulator) -> None:
    """Ctrl-C right after the outputs went on: it propagates after they have been switched off."""
    controls = loaded._connection.controls
    apply = controls.apply

    def on_and_interrupt(settings: Sequence[Setting]) -> tuple[str, ...]:
        read_back = apply(settings)
        if simulator.outputs == (True, True):
            raise KeyboardInterrupt
        return read_back

    controls.apply = on_and_interrupt
    with pytest.raises(KeyboardInterrupt):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_outputs_stay_off_if_the_watchdog_cannot_be_armed(loaded: Generator, simulator: Simulator, guard: Any) -> None:
    """The error propagates, and no output is switched on."""

    def refuse(*, free_running: bool) -> None:
        raise RigError("the watchdog process does not run")

    guard.arm = refuse
    with pytest.raises(RigError, match="watchdog process does not run"):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_close_with_a_failing_log_leaves_outputs_off(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst, guard: Any
) -> None:
    """Disk full while logging: close raises nothing, the outputs are off, and the watchdog keeps watching."""
    full = False

    def log(event: str, **facts: Any) -> None:
        if full:
            raise OSError(28, "No space left on device")

    rig = open_generator(log=log)
    rig.load(burst)
    rig.fire(0.1)
    full = True
    rig.close()
    assert simulator.outputs == (False, False)
    assert guard.told[-1] == "left watching"
