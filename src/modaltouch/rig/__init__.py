"""Plays the burst: the generator over PyVISA, and its simulated twin behind the same driver.

A session opens the driver at an address; the simulator is one more address::

    with start_simulator(apparatus) as simulator, open_rig(simulator.address, apparatus, log=log) as rig:
        rig.load(burst)
        rig.fire(velocity)
        speeds = simulator.felt_velocity(["A", "C"])

What measures the beam (`acquisition`) is an instrument of its own: ``simulator.scope()``, or `picoscope`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from modaltouch.system import lazily

if TYPE_CHECKING:
    from modaltouch.rig.acquisition import Acquisition, Recording, Scope
    from modaltouch.rig.checklist import check_rig
    from modaltouch.rig.interface import Bursts, Firing, Rig, RigError, StimulusLost, is_simulated
    from modaltouch.rig.latency import CommandLatency, measure_latency
    from modaltouch.rig.opening import open_rig, same_process, start_simulator
    from modaltouch.rig.picoscope import PicoScope
    from modaltouch.rig.player import Repetition
    from modaltouch.rig.settings import (
        LOWEST_AMPLITUDE,
        MAX_POINTS,
        Limits,
        amplitudes,
        continuous_codes,
        highest_level,
        level_setting,
        record_peaks,
    )
    from modaltouch.rig.simulator import Simulator, serve
    from modaltouch.rig.simulator.timeline import Playback
    from modaltouch.rig.simulator.twin import Twin
    from modaltouch.rig.visa import find_instruments
else:
    __getattr__ = lazily(
        __name__,
        {
            "opening": "open_rig same_process start_simulator",
            "acquisition": "Acquisition Recording Scope",
            "checklist": "check_rig",
            "interface": "Bursts Firing Rig RigError StimulusLost is_simulated",
            "latency": "CommandLatency measure_latency",
            "picoscope": "PicoScope",
            "player": "Repetition",
            "settings": (
                "LOWEST_AMPLITUDE Limits MAX_POINTS amplitudes "
                "continuous_codes highest_level level_setting record_peaks"
            ),
            "simulator": "Simulator serve",
            "simulator.timeline": "Playback",
            "simulator.twin": "Twin",
            "visa": "find_instruments",
        },
    )

__all__ = [
    "Acquisition",
    "Bursts",
    "CommandLatency",
    "Firing",
    "LOWEST_AMPLITUDE",
    "Limits",
    "MAX_POINTS",
    "PicoScope",
    "Playback",
    "Recording",
    "Repetition",
    "Rig",
    "RigError",
    "Scope",
    "Simulator",
    "StimulusLost",
    "Twin",
    "amplitudes",
    "check_rig",
    "continuous_codes",
    "find_instruments",
    "highest_level",
    "is_simulated",
    "level_setting",
    "measure_latency",
    "open_rig",
    "record_peaks",
    "same_process",
    "serve",
    "start_simulator",
]
