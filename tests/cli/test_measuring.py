"""Aiming the vibrometer by hand: prompts on standard error, and Ctrl-C takes effect immediately."""

from __future__ import annotations

import re
import signal

import pytest
import typer

from modaltouch.cli.lab import bars


def test_each_position_is_prompted_for(monkeypatch, capsys):
    """Prompts give signed millimetres from mid-beam on standard error; the progress bars resume afterwards."""
    monkeypatch.setattr("builtins.input", lambda: "")
    with bars() as showing:
        showing.show("field", 1, 2)
        showing.aim(-0.0125, 0.0)
        showing.aim(-0.0125, 0.0025)
        showing.show("field", 2, 2)
    out, err = capsys.readouterr()
    assert out == ""
    assert "-12.50 mm from mid-beam, then" in err
    assert "-12.50 mm from mid-beam, +2.50 mm across from the mid-line, then" in err
    assert "2/2" in err


def test_interrupting_while_aiming_ends_the_prompt(monkeypatch):
    """A handler that only notes the signal would leave the prompt waiting; it is restored afterwards."""
    monkeypatch.setattr("builtins.input", lambda: signal.raise_signal(signal.SIGINT))
    noting = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        with bars() as showing, pytest.raises(KeyboardInterrupt):
            showing.aim(0.0, 0.0)
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, noting)


def test_a_closed_standard_input_is_reported(monkeypatch):
    """Closed standard input is bad input with a remedy, not an endless wait."""

    def closed():
        raise EOFError

    monkeypatch.setattr("builtins.input", closed)
    with bars() as showing, pytest.raises(typer.BadParameter, match="someone must aim the vibrometer"):
        showing.aim(0.0, 0.0)


def test_a_position_is_prompted_for_once(monkeypatch, capsys):
    """The same position twice in a row gives one prompt."""
    monkeypatch.setattr("builtins.input", lambda: "")
    with bars() as showing:
        for position in (0.01, 0.01, -0.01, 0.01):
            showing.aim(position, 0.0)
    assert re.findall(r"at ([+-][\d.]+) mm", capsys.readouterr().err) == ["+10.00", "-10.00", "+10.00"]
