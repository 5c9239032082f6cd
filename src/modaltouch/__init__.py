"""From a YAML protocol to the statistics of the paper: a haptics experiment on a vibrating beam.

The stages, in the order in which values flow through them:

``document``   reads YAML with the place of every value
``apparatus``  YAML -> Apparatus: beam, zones, modes, actuator sets, amplifier, generator
``protocol``   YAML -> Protocol: what is presented, asked and repeated
``stimulus``   modal synthesis: wished velocity field -> voltages -> codes -> predicted field
``trial``      Trial (what is asked) and Response (what is answered)
``schedule``   Protocol + participant + seed -> Schedule of Blocks of Trials
``adaptive``   the next level of a threshold run, from the recorded answers
``preflight``  everything that can fail before the participant sits down
``rig``        plays the burst: an AFG3022B over PyVISA, or its simulated twin behind the same driver
``window``     asks the question: a PsychoPy window, or a simulated participant
``masking``    noise, so that the beam is felt and not heard
``console``    the experimenter's view and keys
``observer``   models of a participant, for simulated sessions and for planning
``record``     the append-only session log and its BIDS view
``session``    the one loop
``sitting``    sets a session up and ends it in order, new or resumed
``sensation``  levels calibrated by participant, from the session that found their threshold
``wiring``     puts real or simulated parts behind the session's interfaces
``measurement``, ``identification``, ``calibration``, ``validation``, ``comparison``
               the beam scanned, its modes, its targets corrected, the paper's evidence, the rivals
``analysis``   records -> tables, statistics, figures, report
``planning``   how many participants, by simulating the very protocol
``study``      a shipped protocol in a folder of its own, to begin with
``cli``        the command line

From Python, without the command line:

>>> import modaltouch, tempfile
>>> preflight = modaltouch.examine("demo")                     # every fault in `problems`, the design in `stimulus`
>>> [round(1e3 * speed) for speed in preflight.stimulus.peak_velocity([-0.02, 0.0, 0.02], 0.2)]
[115, 200, 115]
>>> results = tempfile.TemporaryDirectory()
>>> session = modaltouch.simulate_session("demo", "p01", results.name)
>>> session.n_answered
12
>>> analysis = modaltouch.analyse(session.path.parent)          # also of a CSV with one answer a row
>>> int(analysis.counts["n"].sum())
12
>>> results.cleanup()
"""

from importlib import import_module
from typing import Any

_DOORS = {
    "examine": "modaltouch.preflight",
    "simulate_session": "modaltouch.session.simulation",
    "analyse": "modaltouch.analysis.pipeline",
    "read_session": "modaltouch.record.session",
}
"""Where each function lives that the package offers; imported when it is first asked for, since some are heavy."""

__all__ = ["__version__", *_DOORS]


def __getattr__(name: str) -> Any:
    """Return a function of `_DOORS`, or the version, which git may have to be asked for."""
    if name == "__version__":
        return import_module("modaltouch.system.provenance").version()
    if name not in _DOORS:
        raise AttributeError(f"module 'modaltouch' has no attribute {name!r}; it offers {', '.join(__all__)}")
    return getattr(import_module(_DOORS[name]), name)
