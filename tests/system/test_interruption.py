"""Signals are noted when they come and acted upon at the next safe moment."""

import os
import signal

import pytest

from modaltouch.system.operating_system import Interrupted, Interruption


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_interrupts_at_the_next_check(name):
    """Nothing is raised inside the handler; `check` raises with the signal's name."""
    with Interruption() as interruption:
        interruption.check()
        os.kill(os.getpid(), getattr(signal, name))
        assert interruption.pending == name
        with pytest.raises(Interrupted, match=name):
            interruption.check()


def test_the_second_ctrl_c_does_not_wait():
    """For the case that the program hangs between two checks."""
    with Interruption():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(Interrupted, match="SIGINT"):
            os.kill(os.getpid(), signal.SIGINT)


def test_no_library_can_swallow_an_interruption():
    """``except Exception`` does not catch it."""
    assert not issubclass(Interrupted, Exception)


def test_the_handlers_of_before_come_back():
    """After the session the program answers signals as it did."""
    before = signal.getsignal(signal.SIGTERM)
    with Interruption():
        assert signal.getsignal(signal.SIGTERM) != before
    assert signal.getsignal(signal.SIGTERM) == before
