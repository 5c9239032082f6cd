"""IEEE 488.2 messages and SCPI headers: what is accepted, and the standard errors for everything else."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.rig.simulator.scpi import (
    Command,
    CommandTable,
    MessageUnit,
    ScpiError,
    read_boolean,
    read_choice,
    read_message,
    read_number,
)

VOLTS = {"V": 1.0, "VPP": 1.0}


def units(message: bytes) -> list[MessageUnit]:
    """Return the units of a message."""
    return list(read_message(message))


def test_a_compound_message_is_split_into_units() -> None:
    """Semicolons separate, white space and the newline are ignored (IEEE 488.2, 7.3)."""
    assert units(b" sour1:volt 1.5 VPP ;:OUTP2? ;*OPC?\n") == [
        ("sour1:volt", False, ("1.5 VPP",)),
        (":OUTP2", True, ()),
        ("*OPC", True, ()),
    ]


@given(st.binary(max_size=300))
def test_a_definite_length_block_may_contain_any_bytes(content: bytes) -> None:
    """A block's bytes are counted, not parsed: newlines, semicolons and quotes are data (IEEE 488.2, 7.7.6)."""
    length = str(len(content)).encode()
    message = b"DATA EMEM,#" + str(len(length)).encode() + length + content + b";*CLS\n"
    assert units(message) == [("DATA", False, ("EMEM", content)), ("*CLS", False, ())]


@given(st.text(st.characters(codec="latin1", exclude_characters="\"';,\n#"), max_size=20))
def test_quoted_strings_are_kept_unchanged(text: str) -> None:
    """Semicolons and commas within quotes do not separate."""
    quoted = f'A "{text};,x",2'.encode("latin1")
    assert units(quoted)[0][2] == (f"{text};,x", "2")


@given(st.binary(max_size=60))
def test_any_bytes_give_units_or_a_standard_error(message: bytes) -> None:
    """The parser raises nothing but command errors (fuzz test)."""
    try:
        units(message)
    except ScpiError as error:
        assert -200 < error.code <= -100  # noqa: PT017


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (b"DATA EMEM,#3100ab", -161),
        (b"DATA EMEM,#2x4abcd", -161),
        (b"VOLT 1,", -109),
        (b"VOLT!", -102),
        (b"?", -102),
        (b"\xff", -101),
        (b'A "open', -151),
        (b"VOLT #", -102),
    ],
)
def test_a_malformed_message_causes_its_standard_error(message: bytes, code: int) -> None:
    """Numbers of SCPI-99, volume 2, 21.8.9."""
    with pytest.raises(ScpiError, match=str(code)):
        units(message)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.5", 1.5),
        ("+15E-1", 1.5),
        (".5", 0.5),
        ("2.", 2.0),
        ("1500 mVPP", 1.5),
        ("1500MV", 1.5),
        ("0.0015kV", 1.5),
        ("MIN", 0.02),
        ("maximum", 20.0),
        ("DEF", 2.0),
        ("1.5 e 0", 1.5),
    ],
)
def test_a_number_is_read_with_its_unit(text: str, value: float) -> None:
    """Suffix multipliers of IEEE 488.2, 7.7.3; MINimum, MAXimum, DEFault of SCPI-99, 7.2.1."""
    assert read_number(text, units=VOLTS, minimum=0.02, maximum=20, default=2) == pytest.approx(value)


def test_m_means_mega_with_hertz_and_ohm() -> None:
    """MHZ and MOHM are mega, by IEEE 488.2's exception; MV is milli."""
    assert read_number("2MHZ", units={"HZ": 1.0}, minimum=0, maximum=1e9) == 2e6
    assert read_number("2MOHM", units={"OHM": 1.0}, minimum=0, maximum=1e9) == 2e6


@pytest.mark.parametrize(
    ("text", "code"), [("abc", -104), ("1.5 HZ", -131), ("25", -222), ("0.01", -222), ("1e400", -222), ("nan", -104)]
)
def test_an_invalid_number_causes_its_standard_error(text: str, code: int) -> None:
    """-104 no number, -131 foreign unit, -222 out of range."""
    with pytest.raises(ScpiError, match=str(code)):
        read_number(text, units=VOLTS, minimum=0.02, maximum=20)


@pytest.mark.parametrize(("text", "value"), [("ON", True), ("off", False), ("1", True), ("0", False), ("0.4", False)])
def test_a_boolean_is_a_keyword_or_a_rounded_number(text: str, value: bool) -> None:
    """SCPI-99, 7.3: numbers are rounded, nonzero is true."""
    assert read_boolean(text) is value


def test_a_choice_has_a_short_and_a_long_form() -> None:
    """TIM and TIMer are equivalent, TIME is an error."""
    assert read_choice("tim", ("TIMer", "EXTernal")) == "TIM"
    assert read_choice("EXTERNAL", ("TIMer", "EXTernal")) == "EXT"
    with pytest.raises(ScpiError, match="-224"):
        read_choice("TIME", ("TIMer", "EXTernal"))


@pytest.fixture
def told() -> list[tuple[int, tuple[object, ...]]]:
    """Return the calls of the table's commands."""
    return []


@pytest.fixture
def table(told: list[tuple[int, tuple[object, ...]]]) -> CommandTable:
    """Return a table of two commands."""

    def refuse(channel: int, arguments: tuple[object, ...]) -> str:
        raise ScpiError(-222)

    level = Command(set=lambda c, a: told.append((c, a)), get=lambda c, a: f"{c}")
    return CommandTable(
        {
            "[SOURce#]:VOLTage[:LEVel][:IMMediate][:AMPLitude]": level,
            "[SOURce#]:VOLTage[:LEVel][:IMMediate]:OFFSet": Command(get=lambda c, a: "offset"),
            "TRACe|DATA[:DATA]": Command(get=refuse),
            "*IDN": Command(get=lambda c, a: "me"),
        },
        n_channels=2,
    )


def run(table: CommandTable, message: bytes) -> tuple[list[bytes], list[int]]:
    """Return replies and error numbers of a message."""
    errors: list[int] = []
    return table.run(message, fail=lambda error: errors.append(error.code)), errors


@pytest.mark.parametrize(
    "header",
    ["SOUR2:VOLT", ":source2:voltage", "SOURCE2:VOLT:LEV:IMM:AMPL", "sour2:volt:level:ampl", ":Sour2:Volt:Immediate"],
)
def test_a_header_is_accepted_in_every_form(table: CommandTable, header: str) -> None:
    """Short and long forms, upper and lower case, optional nodes (SCPI-99, volume 1, 6)."""
    assert run(table, f"{header}?".encode()) == ([b"2"], [])


@pytest.mark.parametrize("header", ["VOLT", "SOUR:VOLT", "SOUR1:VOLT", ":VOLT:AMPL"])
def test_the_default_channel_is_1(table: CommandTable, header: str) -> None:
    """An omitted suffix is 1."""
    assert run(table, f"{header}?".encode()) == ([b"1"], [])


@pytest.mark.parametrize(
    ("header", "code"),
    [("SOURC1:VOLT", -113), ("VOLTA", -113), ("SOUR3:VOLT", -114), ("SOUR0:VOLT", -114), ("*WHO", -113)],
)
def test_an_unknown_header_causes_its_standard_error(table: CommandTable, header: str, code: int) -> None:
    """-113 undefined header, -114 suffix out of range; SOURC is neither the short nor the long form."""
    assert run(table, f"{header}?".encode()) == ([], [code])


def test_a_missing_form_of_a_header_is_undefined(table: CommandTable) -> None:
    """A header that exists only as a query is undefined as a command."""
    assert run(table, b"SOUR1:VOLT:OFFS 1") == ([], [-113])


def test_a_header_is_relative_to_the_previous_one(table: CommandTable) -> None:
    """After SOUR2:VOLT:AMPL the header OFFS means SOUR2:VOLT:OFFS; a common command has no effect on it (6.2.4)."""
    assert run(table, b"SOUR2:VOLT:AMPL?;*IDN?;OFFS?") == ([b"2", b"me", b"offset"], [])
    assert run(table, b"SOUR2:VOLT:AMPL?;:OFFS?") == ([b"2"], [-113])


def test_a_command_error_skips_the_rest_of_a_message(table: CommandTable) -> None:
    """After -113 the rest of the message is skipped; after the execution error -222 it is carried out."""
    assert run(table, b"*IDN?;NONSENSE;*IDN?") == ([b"me"], [-113])
    assert run(table, b"*IDN?;:DATA?;*IDN?") == ([b"me", b"me"], [-222])
