"""However a session ends, the outputs are off, and the watchdog knows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst


def test_exception_inside_the_session_leaves_outputs_off(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst
) -> None:
    """Any way out of the with statement switches off."""

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
    """The second close does nothing; the watchdog is let go once, cleanly."""
    loaded.fire(0.1)
    loaded.close()
    loaded.close()
    assert simulator.outputs == (False, False)
    assert guard.told[-1] == "clean"
    assert guard.told.count("clean") == 1


def test_watchdog_is_armed_before_the_outputs_go_on(loaded: Generator, guard: Any, heard: Any) -> None:
    """The watchdog knows first; it is relieved once the outputs are confirmed off."""
    loaded.fire(0.1)
    assert guard.told[-1] == "arm"
    loaded.stop()
    assert guard.told[-1] == "disarm"


def test_interrupt_in_the_midst_of_starting_leaves_outputs_off(loaded: Generator, simulator: Simulator) -> None:
    """Ctrl-C right after the outputs went on: not swallowed, and they are off before it passes on."""
    controls = loaded._connection.controls
    outputs_on = controls.outputs_on

    def on_and_interrupt() -> None:
        outputs_on()
        assert simulator.outputs == (True, True)
        raise KeyboardInterrupt

    controls.outputs_on = on_and_interrupt
    with pytest.raises(KeyboardInterrupt):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_watchdog_that_cannot_be_armed_leaves_outputs_off(loaded: Generator, simulator: Simulator, guard: Any) -> None:
    """No output without a watchdog."""

    def refuse(*, free_running: bool) -> None:
        raise RigError("the watchdog process does not run")

    guard.arm = refuse
    with pytest.raises(RigError, match="watchdog process does not run"):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_close_with_a_log_that_fails_switches_off_and_leaves_the_watchdog(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst, guard: Any
) -> None:
    """A full disk under the log: close raises nothing, the outputs are off, and the watchdog makes sure."""
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
