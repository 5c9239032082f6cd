"""The generator's controls, each used and at once read back; knows commands, not sessions or safety."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.instrument import Instrument, Setting
from modaltouch.rig.link import Link, LinkError, Log, split_reply

NO_ERROR, UNDEFINED_HEADER = 0, -113
QUERIES_PER_MESSAGE = 12
MOST_ERRORS = 64
N_SPOTS = 64


class Unconfirmed(Exception):  # noqa: N818
    """The instrument answered, but not that it does what was asked.

    Attributes
    ----------
    read_back : tuple of str
        What the settings read instead, where they were read.
    """

    def __init__(self, reason: str, read_back: tuple[str, ...] = ()) -> None:
        super().__init__(reason)
        self.read_back = read_back


class Controls:
    """Sets, reads back and uploads over one link; raises LinkError or Unconfirmed where that is not confirmed.

    Parameters
    ----------
    link : Link
        An open session.
    instrument : Instrument
        At its other end.
    revive : callable
        Opens the session anew after a failed exchange, to the same instrument, outputs off.
    log : callable
        Takes events.
    copy_timeout : float
        Longest wait for an upload, a copy between memories or ``*OPC?`` [s].
    """

    def __init__(
        self, link: Link, instrument: Instrument, *, revive: Callable[[], object], log: Log, copy_timeout: float
    ) -> None:
        self._link = link
        self._instrument = instrument
        self._table = instrument.commands
        self._revive = revive
        self._log = log
        self._copy_timeout = copy_timeout
        self._stored: dict[int, str] = {}

    def identify(self) -> str:
        """Return the reply to ``*IDN?``."""
        return self._link.ask("*IDN?")

    def clear_errors(self) -> None:
        """Empty the error queue, whatever was left in it; the log keeps it."""
        self._link.ask("*CLS;*OPC?")

    def reset(self) -> None:
        """Restore the defaults, outputs off; memories stay, but are to be read before they are trusted."""
        self._stored.clear()
        self._link.ask("*RST;*OPC?", timeout=self._copy_timeout)
        self._refuse_errors("*RST", self.pending_errors())

    def outputs_off(self) -> tuple[tuple[bool, ...], tuple[str, ...]]:
        """Switch both outputs off, confirm it, and return which were on and which errors were reported."""
        outputs = [self._table.output.filled(channel=channel) for channel in self._instrument.channels]
        asked = ";".join(f":{output.query}" for output in outputs)
        off = ";".join(f":{output.off.command}" for output in outputs)
        replies = split_reply(self._link.ask(f"{asked};{off};{asked};:SYST:ERR?"))
        n = len(outputs)
        if len(replies) != 2 * n + 1 or any(reply != "0" for reply in replies[n : 2 * n]):
            raise Unconfirmed(f"asked whether its outputs are off, the generator says {replies[n : 2 * n]}")
        errors: list[str] = []
        if _error_number(replies[-1]) != NO_ERROR:
            errors = [replies[-1], *self.pending_errors()]
        return tuple(reply != "0" for reply in replies[:n]), tuple(errors)

    def trigger_command(self) -> str:
        """Return what triggers a burst here: the first of the table's commands that is not undefined.

        To be called with the outputs off: what it tries is a trigger.
        """
        *first, last = self._table.triggers
        for command in first:
            reply = self._link.ask(f":{command};:SYST:ERR?")
            if _error_number(reply) == NO_ERROR:
                return command
            self.clear_errors()
            if _error_number(reply) != UNDEFINED_HEADER:
                return command
        return last

    def outputs_on(self) -> None:
        """Switch both outputs on in one message."""
        self.apply([self._table.output.filled(channel=channel) for channel in self._instrument.channels])

    def apply(self, settings: Sequence[Setting]) -> tuple[str, ...]:
        """Make settings in one message, read each back, read the error queue, and return what was read back."""
        commands = ";:".join(setting.command for setting in settings)
        queries = ";:".join(setting.query for setting in settings)
        replies = split_reply(self._link.ask(f":{commands};:{queries};:SYST:ERR?"))
        if len(replies) != len(settings) + 1:
            raise Unconfirmed(f"to '{commands}' the generator answers {replies}")
        read_back = tuple(replies[:-1])
        self._refuse_errors(commands, replies[-1:], read_back)
        wrong = _differences(settings, replies)
        if wrong:
            raise Unconfirmed("; ".join(wrong), read_back)
        return read_back

    def apply_each(self, settings: Iterable[Setting]) -> None:
        """Make settings one by one."""
        for setting in settings:
            self.apply([setting])

    def differences(self, settings: Sequence[Setting]) -> list[str]:
        """Return which settings no longer read as they were made."""
        wrong = []
        for start in range(0, len(settings), QUERIES_PER_MESSAGE):
            part = settings[start : start + QUERIES_PER_MESSAGE]
            replies = split_reply(self._link.ask(":" + ";:".join(setting.query for setting in part)))
            if len(replies) != len(part):
                raise Unconfirmed(f"{len(part)} settings were asked for, {len(replies)} came: {replies}")
            wrong += _differences(part, replies)
        return wrong

    def command(self, command: str) -> None:
        """Send a command that has nothing to read back, and read the error queue."""
        self._refuse_errors(command, [self._link.ask(f":{command};:SYST:ERR?")])

    def store(self, codes: NDArray[np.uint16], wanted: int, in_use: Sequence[int]) -> int:
        """Have a record in a memory, verified, and return the memory's number.

        A record that is there already, remembered from this session or read back, is not sent again.

        Parameters
        ----------
        codes : (n_samples,) array of uint16
            Codes of the record.
        wanted : int
            Memory to take if the record is nowhere.
        in_use : sequence of int
            Memories that must not be overwritten.

        Raises
        ------
        Unconfirmed
            If the record does not read back as sent, twice.
        """
        block = codes.astype(">u2").tobytes()
        digest = hashlib.sha256(block).hexdigest()
        known = [slot for slot, held in self._stored.items() if held == digest]
        if known:
            return known[0]
        if wanted in in_use:
            wanted = next(slot for slot in reversed(self._instrument.memories) if slot not in in_use)
        if wanted not in self._stored and self._holds(wanted, codes):
            self._log("record_found", memory=self._name(wanted), sha256=digest, n_points=codes.size)
        else:
            self._upload(wanted, codes, block)
            self._log("record_sent", memory=self._name(wanted), sha256=digest, n_points=codes.size)
        self._stored[wanted] = digest
        return wanted

    def _holds(self, slot: int, codes: NDArray[np.uint16]) -> bool:
        """Return whether a memory holds a record already."""
        if self._name(slot) not in self._link.ask(self._table.catalogue):
            return False
        try:
            return bool(np.array_equal(self._read_back(slot), codes))
        except Unconfirmed:
            return False
        except LinkError:
            self._revive()
            return False

    def _upload(self, slot: int, codes: NDArray[np.uint16], block: bytes) -> None:
        most = self._instrument.converter.max_points
        if not 2 <= codes.size <= most:
            raise Unconfirmed(f"a record of {codes.size} points: the generator holds 2 to {most}")
        self._stored.pop(slot, None)
        self.apply([self._table.locked.filled(memory=slot).off])
        try:
            self._upload_once(slot, codes, block)
        except Unconfirmed as error:
            self._log("upload_repeated", memory=self._name(slot), reason=str(error))
            self._upload_once(slot, codes, block)

    def _upload_once(self, slot: int, codes: NDArray[np.uint16], block: bytes) -> None:
        self._link.send_block(self._table.upload, block, timeout=self._copy_timeout)
        (n_points,) = self._complete("the upload", "*OPC?", self._table.count)
        if n_points != str(codes.size):
            raise Unconfirmed(f"{codes.size} points were sent, the generator counts {n_points}")
        self._copy(self._table.store, slot)
        if not self._verified(slot, codes):
            raise Unconfirmed(f"{self._name(slot)} does not hold the record that was sent, after two uploads")

    def _verified(self, slot: int, codes: NDArray[np.uint16]) -> bool:
        """Return whether a memory reads back right; by samples of it where whole blocks cannot be read."""
        for _ in range(2):
            try:
                return bool(np.array_equal(self._read_back(slot), codes))
            except LinkError:
                self._revive()
        return self._spots_agree(codes)

    def _read_back(self, slot: int) -> NDArray[np.uint16]:
        self._copy(self._table.recall, slot)
        return self._link.read_codes(self._table.read, timeout=self._copy_timeout)

    def _spots_agree(self, codes: NDArray[np.uint16]) -> bool:
        """Return whether count and a spread of single points agree with a record in the edit memory."""
        self._log("record_spot_check", n_spots=N_SPOTS, why="its blocks cannot be read back")
        if self._link.ask(self._table.count) != str(codes.size):
            return False
        strongest = np.argsort(np.abs(codes.astype(int) - int(np.median(codes))))[-N_SPOTS // 2 :]
        spread = np.linspace(0, codes.size - 1, N_SPOTS // 2).astype(int)
        return all(
            self._link.ask(self._table.point.format(place=at + 1)) == str(codes[at]) for at in {*strongest, *spread}
        )

    def _name(self, slot: int) -> str:
        return self._table.memory.format(memory=slot)

    def _copy(self, command: str, slot: int) -> None:
        command = command.format(memory=slot)
        self._complete(command, f":{command};*OPC?")

    def _complete(self, what: str, message: str, *queries: str) -> list[str]:
        """Wait in one message until all is done, read the error queue, and return the replies to further queries."""
        whole = ";:".join([message, "SYST:ERR?", *queries])
        replies = split_reply(self._link.ask(whole, timeout=self._copy_timeout))
        if len(replies) != len(queries) + 2:
            raise Unconfirmed(f"to '{what}' the generator answers {replies}")
        if _error_number(replies[1]) != NO_ERROR:
            self._log("instrument_errors", errors=replies[1:2])
        self._refuse_errors(what, replies[1:2])
        return replies[2:]

    def pending_errors(self) -> list[str]:
        """Empty the error queue and return what was in it."""
        errors = []
        for _ in range(MOST_ERRORS):
            reply = self._link.ask("SYST:ERR?")
            if _error_number(reply) == NO_ERROR:
                break
            errors.append(reply)
        if errors:
            self._log("instrument_errors", errors=errors)
        return errors

    def _refuse_errors(self, what: str, replies: Sequence[str], read_back: tuple[str, ...] = ()) -> None:
        errors = [reply for reply in replies if _error_number(reply) != NO_ERROR]
        if errors:
            errors += self.pending_errors()
            reported = ", ".join(dict.fromkeys(errors))
            raise Unconfirmed(f"to '{what[:80]}' the generator reports {reported}", read_back)


def _differences(settings: Sequence[Setting], replies: Sequence[str]) -> list[str]:
    return [
        f"{setting.query.replace('?', '')} reads {reply}, {setting.value}{setting.unit} was set"
        for setting, reply in zip(settings, replies, strict=False)
        if not setting.confirmed_by(reply)
    ]


def _error_number(reply: str) -> int:
    """Return the number of an error-queue entry; what is no entry counts as a device error."""
    try:
        return int(reply.partition(",")[0])
    except ValueError:
        return -300
