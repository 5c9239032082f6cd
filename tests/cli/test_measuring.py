"""Who moves the vibrometer: asked on standard error, and Ctrl-C is heard at once."""

from __future__ import annotations

import re
import signal

import pytest
import typer

from modaltouch.cli.lab import bars


def test_person_is_asked_for_each_position(monkeypatch, capsys):
    """Expected: millimetres from mid-beam with their sign, on standard error; the bars go on afterwards."""
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


def test_interrupting_while_aiming_ends_it(monkeypatch):
    """A handler that only notes the signal would leave the prompt waiting; it is back afterwards."""
    monkeypatch.setattr("builtins.input", lambda: signal.raise_signal(signal.SIGINT))
    noting = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        with bars() as showing, pytest.raises(KeyboardInterrupt):
            showing.aim(0.0, 0.0)
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, noting)


def test_nobody_there_is_said(monkeypatch):
    """Standard input is closed: bad input with a remedy, not an endless wait."""

    def closed():
        raise EOFError

    monkeypatch.setattr("builtins.input", closed)
    with bars() as showing, pytest.raises(typer.BadParameter, match="someone must aim the vibrometer"):
        showing.aim(0.0, 0.0)


def test_a_spot_moved_by_hand_is_asked_for_once_a_place(monkeypatch, capsys):
    """The same place twice in a row: one question."""
    monkeypatch.setattr("builtins.input", lambda: "")
    with bars() as showing:
        for position in (0.01, 0.01, -0.01, 0.01):
            showing.aim(position, 0.0)
    assert re.findall(r"at ([+-][\d.]+) mm", capsys.readouterr().err) == ["+10.00", "-10.00", "+10.00"]
