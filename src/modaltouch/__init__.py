"""From a YAML protocol to the statistics of the paper: a haptics experiment on a vibrating beam.

The packages, in the order in which data flow through them:

``system``
    clocks, locks, signals, and which build this is
``stimulus``
    modal synthesis: target field -> voltages -> codes -> predicted field
``protocol``
    YAML -> Protocol and Apparatus, with the location of every error; Protocol + participant + seed -> Schedule
``rig``
    plays the burst: a generator over PyVISA, or its simulated twin behind the same driver
``window``
    asks the question: a PsychoPy window, or a simulated participant; masking noise
``preflight``
    everything that can fail before the participant sits down
``record``
    the append-only session log, its verification and its BIDS view
``report``
    figures, pages and files in one style
``analysis``
    records -> tables, statistics, figures, report
``planning``
    observers; power and sample size by simulating the protocol
``session``
    the session loop, its set-up, its console, its verification
``lab``
    identification, calibration, validation and comparison of a beam
``cli``
    the command line

From Python, without the command line:

>>> import modaltouch, tempfile
>>> preflight = modaltouch.examine("demo")                     # errors in `problems`, the design in `stimulus`
>>> [round(1e3 * speed) for speed in preflight.stimulus.peak_velocity([-0.02, 0.0, 0.02], 0.2)]
[115, 200, 115]
>>> results = tempfile.TemporaryDirectory()
>>> session = modaltouch.simulate_session("demo", "p01", results.name)
>>> session.n_answered
12
>>> modaltouch.read_session(session.path).complete             # any record; `trials` holds every trial
True
>>> analysis = modaltouch.analyse(session.path.parent)          # also of a CSV with one answer per row
>>> int(analysis.counts["n"].sum())
12
>>> results.cleanup()
"""

from importlib import import_module
from typing import Any

_DOORS = {
    "examine": "modaltouch.preflight",
    "simulate_session": "modaltouch.session.wiring",
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
