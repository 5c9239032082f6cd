"""How a working process begins; imported before NumPy, whose threads it limits."""

from __future__ import annotations

import os
import signal

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def begin_worker() -> None:
    """Leave signals to the parent and use one thread.

    Ctrl-C reaches every process of a terminal, but the parent alone decides what to keep; and processes that
    share the cores must not each start as many threads as there are cores.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in _THREADS:
        os.environ[name] = "1"
