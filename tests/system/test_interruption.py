"""Signals are noted when they arrive and take effect at the next safe point."""

import os
import signal

import pytest

from modaltouch.system.operating_system import Interrupted, Interruption


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_interrupts_at_the_next_check(name):
    """The handler raises nothing; `check` raises with the signal's name."""
    with Interruption() as interruption:
        interruption.check()
        os.kill(os.getpid(), getattr(signal, name))
        assert interruption.pending == name
        with pytest.raises(Interrupted, match=name):
            interruption.check()


def test_the_second_ctrl_c_interrupts_immediately():
    """It works even if the program hangs between two checks."""
    with Interruption():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(Interrupted, match="SIGINT"):
            os.kill(os.getpid(), signal.SIGINT)


def test_no_library_can_swallow_an_interruption():
    """``except Exception`` does not catch it."""
    assert not issubclass(Interrupted, Exception)


def test_the_previous_handlers_are_restored():
    """After the session, signals have their previous handlers."""
    before = signal.getsignal(signal.SIGTERM)
    with Interruption():
        assert signal.getsignal(signal.SIGTERM) != before
    assert signal.getsignal(signal.SIGTERM) == before
