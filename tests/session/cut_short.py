"""Run ``modaltouch`` in this process and interrupt it according to a plan; for `runpy.run_path`.

The plan (`PLAN`, set among this module's globals) has the command's ``words``, the file ``witness`` that gets a byte
for every answer confirmed to the participant, whether the rules of ``windows`` apply, and ``cut``, one of

- ``{}``: no interruption from inside
- ``{"stimulus": k, "signal": s}``: signal s while the k-th stimulus plays
- ``{"call": k, "torn": f}``: SIGKILL at the k-th call that changes a file; with a fraction f above 0, at a write of
  which that fraction has reached the disk, as after a power cut
- ``{"raise_after_s": t}``: an unexpected exception after t seconds
- ``{"largest_file": n}``: the kernel refuses files longer than n bytes
- ``{"clock_back_s": s}``: the wall clock goes back by that much at every reading
"""

import os
import resource
import signal
import stat
from datetime import timedelta
from importlib import import_module

from quickly import hasten
from windows_rules import windows_rules

import modaltouch.record.log
from modaltouch.__main__ import main
from modaltouch.window.simulated import SimulatedParticipant


def witness(path):
    """Note outside this process that the participant saw an answer confirmed."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    confirm = SimulatedParticipant.confirm

    def confirmed(self, response):
        os_write(descriptor, b".")
        confirm(self, response)

    SimulatedParticipant.confirm = confirmed


def cut_at_stimulus(number, signal_number):
    """Send a signal to this process while the n-th stimulus plays."""
    ask, asked = SimulatedParticipant.ask, 0

    def ask_or_die(self, *arguments, **options):
        nonlocal asked
        asked += 1
        if asked == number:
            os.kill(os.getpid(), signal_number)
        return ask(self, *arguments, **options)

    SimulatedParticipant.ask = ask_or_die


def die():
    """End without any cleanup, as in a power cut."""
    os.kill(os.getpid(), signal.SIGKILL)


def cut_at_call(number, torn):
    """Die at the n-th call that changes a file."""
    calls = 0

    def counted(name):
        function = getattr(os, name)

        def call(*arguments, **options):
            nonlocal calls
            if name == "write" and not stat.S_ISREG(os.fstat(arguments[0]).st_mode):
                return function(*arguments, **options)
            calls += 1
            if calls == number:
                if torn and name == "write":
                    descriptor, data = arguments
                    function(descriptor, data[: max(1, int(len(data) * torn))])
                die()
            return function(*arguments, **options)

        setattr(os, name, call)

    for name in ("write", "fsync", "replace", "rename", "link", "unlink"):
        counted(name)


def raise_after(seconds):
    """Raise in the main thread after some time."""

    def handler(number, frame):
        raise RuntimeError("out of nowhere")

    signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, seconds)


def turn_clock_back(seconds):
    """Make the wall clock run backwards."""
    real, readings = modaltouch.record.log.datetime, 0

    class Backwards(real):
        @classmethod
        def now(cls, tz=None):
            nonlocal readings
            readings += 1
            return real.now(tz) - timedelta(seconds=seconds * readings)

    modaltouch.record.log.datetime = Backwards


def cut_short(plan):
    """Arrange the interruption of the plan and run the command."""
    hasten()
    if plan.get("windows"):
        import_module("pyvisa_py")  # imported by those rules it would look for Windows itself
        by_rules = windows_rules()
        by_rules.__enter__()  # until the end of this process
    witness(plan["witness"])
    cut = plan["cut"]
    if "stimulus" in cut:
        cut_at_stimulus(cut["stimulus"], cut["signal"])
    if "call" in cut:
        cut_at_call(cut["call"], cut["torn"])
    if "raise_after_s" in cut:
        raise_after(cut["raise_after_s"])
    if "largest_file" in cut:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        for descriptor in (1, 2):  # what is said may go to a file, too, which is no disk that fills up
            os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
        resource.setrlimit(resource.RLIMIT_FSIZE, (cut["largest_file"], resource.RLIM_INFINITY))
    if "clock_back_s" in cut:
        turn_clock_back(cut["clock_back_s"])
    main([str(word) for word in plan["words"]])


os_write = os.write
if "PLAN" in globals():  # given by run_path; there is none where this file is only looked at
    cut_short(PLAN)  # noqa: F821
