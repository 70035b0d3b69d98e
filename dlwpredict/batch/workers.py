"""The engine: one function over many jobs, in this process, in local processes, or on a Dask cluster.

Results are files, written whole by the jobs themselves; what comes back is small. So a worker that dies takes with it
only the job it was at, and that job is given to another one.
"""

from __future__ import annotations

import signal
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from typing import Any, TypeVar

from dlwpredict.errors import InputError
from dlwpredict.numerics.parallel import Workers

Job = TypeVar("Job")
Result = TypeVar("Result")

DEATHS = 2
"""A job is given up after this many local workers have died of it."""

CONNECT_SECONDS = 10
DIED = "the worker died, out of memory?"


def work(
    function: Callable[[Job], Result], jobs: Sequence[Job], *, processes: int = 1, scheduler: str | None = None
) -> Iterator[tuple[Job, Result | Exception]]:
    """Yield every job with its result, or with the exception it ended in, as they come.

    Parameters
    ----------
    function : callable
        Of a module, so that another process finds it by its name; may be called again for a job whose worker died.
    jobs : sequence
        Small objects that can be pickled.
    processes : int
        Local processes; 1 = this one.
    scheduler : str, optional
        Address of a Dask scheduler; its workers do the work. They must see the same files.

    Raises
    ------
    InputError
        No scheduler answers, or the package `distributed` is missing.

    Examples
    --------
    >>> list(work(abs, [-1, 2]))
    [(-1, 1), (2, 2)]
    """
    if scheduler is not None:
        return _on_cluster(function, jobs, scheduler)
    if processes == 1 or len(jobs) == 1:
        return ((job, _outcome(function, job)) for job in jobs)
    return _in_processes(function, jobs, min(processes, len(jobs)))


def _outcome(function: Callable[[Job], Result], job: Job) -> Result | Exception:
    try:
        return function(job)
    except Exception as error:
        return error


def _in_processes(
    function: Callable[[Job], Result], jobs: Sequence[Job], count: int
) -> Iterator[tuple[Job, Result | Exception]]:
    """Give the job of a worker that died to another one; on Ctrl-C workers finish their jobs, and get no more."""
    todo, died = deque(range(len(jobs))), Counter[int]()
    with Workers(count, function.__module__, signal.SIG_IGN) as workers:
        for k, future in workers.ended(function, [(job,) for job in jobs], todo):
            error = future.exception()
            if not isinstance(error, BrokenExecutor):
                yield jobs[k], error if isinstance(error, Exception) else future.result()
            elif died[k] + 1 < DEATHS:
                died[k] += 1
                todo.appendleft(k)
            else:
                yield jobs[k], InputError(DIED)


def _on_cluster(
    function: Callable[[Job], Result], jobs: Sequence[Job], scheduler: str
) -> Iterator[tuple[Job, Result | Exception]]:
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as as_they_come
    except ImportError:
        raise InputError(
            "needs the package distributed",
            key="--scheduler",
            allowed="pip install '.[cluster]' in this program's folder",
        ) from None
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"no scheduler answers at {scheduler} ({reason})",
            key="--scheduler",
            allowed="an address as tcp://host:8786",
        ) from None
    return _gathered(client, function, jobs, as_they_come, KilledWorker)


def _gathered(
    client: Any, function: Callable[[Job], Result], jobs: Sequence[Job], as_they_come: Any, killed: type[Exception]
) -> Iterator[tuple[Job, Result | Exception]]:
    """Yield from the cluster; the scheduler itself gives the job of a dead worker to another one."""
    with client:
        waiting = {client.submit(function, job, pure=False): job for job in jobs}
        for done in as_they_come(list(waiting)):
            job = waiting.pop(done)
            try:
                yield job, done.result()
            except killed:
                yield job, InputError(DIED)
            except Exception as error:
                yield job, error
