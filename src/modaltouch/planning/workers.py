"""Jobs shared among the processes of this machine or of a dask cluster, through joblib."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import takewhile
from typing import Any

from modaltouch import __version__
from modaltouch.planning.experiments import Job, Study, Tallies, run_job

_CONNECTS = "10s"
"""How long a cluster may take to answer."""


class ClusterError(Exception):
    """There is no dask cluster, or none that would give the same figures."""


def run_shared(
    study: Study, jobs: Sequence[Job], told_to_stop: Callable[[], bool], n_processes: int, dask: str | None
) -> Iterator[tuple[Job, Tallies]]:
    """Yield what each job found, as they come in.

    Parameters
    ----------
    study : Study
        What is simulated.
    jobs : sequence of Job
        The jobs.
    told_to_stop : callable
        Asked before each job; where it answers yes, only those in hand are finished.
    n_processes : int
        Processes of this machine.
    dask : str or None
        Address of the scheduler of a cluster; None for this machine.

    Raises
    ------
    ClusterError
        If there is no cluster at the address, or it runs another version.
    """
    import joblib

    with _cluster(dask) if dask is not None else _processes(n_processes):
        # A few in hand for each process: thousands would be slow to watch and slow to give up.
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="2 * n_jobs")
        yield from parallel(joblib.delayed(_run)(study, job) for job in takewhile(lambda _: not told_to_stop(), jobs))


def _run(study: Study, job: Job) -> tuple[Job, Tallies]:
    return job, run_job(study, job)


@contextmanager
def _processes(n_processes: int) -> Iterator[None]:
    import joblib

    with joblib.parallel_config("loky", n_jobs=n_processes, inner_max_num_threads=1, initializer=ignore_interrupts):
        yield


def ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent: it reaches every process of a terminal, but the parent decides what to keep."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _cluster(address: str) -> Iterator[None]:
    """Have a cluster do what joblib shares.

    Raises
    ------
    ClusterError
        If there is none at the address, or it runs another version.
    """
    import joblib

    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            "--dask needs the package distributed, which is not installed: install modaltouch[cluster]"
        ) from None
    try:
        client: Any = Client(address, timeout=_CONNECTS)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"no dask scheduler answers at {address!r} ({error}): start one with `dask scheduler`"
        ) from error
    with client:
        _refuse_strangers(client, address)
        with joblib.parallel_config("dask", wait_for_workers_timeout=10):
            yield


def _refuse_strangers(client: Any, address: str) -> None:
    try:
        versions = client.run(_version)
    except ImportError as error:
        raise ClusterError(f"a worker of {address!r} lacks modaltouch ({error}): install it there") from error
    if not versions:
        raise ClusterError(f"the dask scheduler at {address!r} has no workers: start some with `dask worker {address}`")
    for worker, found in versions.items():
        if found != __version__:
            raise ClusterError(
                f"the worker {worker} runs modaltouch {found}, here is {__version__}: install the same version there, "
                "so that the figures are the same"
            )


def _version() -> str:
    return __version__
