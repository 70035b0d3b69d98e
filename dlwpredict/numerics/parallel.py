"""The same function over several jobs, at once or one after the other."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import get_context, parent_process
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.process import BaseProcess

Job = TypeVar("Job")
Result = TypeVar("Result")

SHARES = 4
"""Jobs are handed to a process in about so many portions: few, for what they have in common is sent once per portion;
but not one, or the last process keeps the others waiting."""


def each(function: Callable[[Job], Result], jobs: Iterable[Job], threads: int) -> list[Result]:
    """Return the function's results in the order of the jobs.

    With one thread none is started: handing small jobs to another thread costs more than the jobs.

    Examples
    --------
    >>> each(lambda x: x * x, [1, 2, 3], threads=2)
    [1, 4, 9]
    """
    if threads < 2:
        return [function(job) for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, jobs))


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cores_for_workers() -> int:
    """Return how many workers are sensible: as many as cores, and none beside it in a process that is one itself."""
    return 1 if parent_process() else cores()


def begin_worker(on_interrupt: signal.Handlers) -> None:
    """Prepare a worker: what Ctrl-C does to it, and that it ends when the process that started it has ended.

    Left to itself it would wait for jobs for ever after a kill that leaves no time to say so.
    """
    signal.signal(signal.SIGINT, on_interrupt)
    threading.Thread(target=_end_with, args=(parent_process(),), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _load(module: str) -> None:
    import_module(module)


@dataclass(eq=False)
class Workers:
    """Processes that share jobs of tenths of a second and more; they start on entering, and end on leaving.

    Until they are ready this process does the jobs itself.

    Parameters
    ----------
    processes : int
        1 = this one.
    module : str
        What they load before they are ready.

    Examples
    --------
    >>> with Workers() as workers:
    ...     workers.each(pow, [(2, 2), (3, 2)])
    [4, 9]
    """

    processes: int = 1
    module: str = __package__
    _pool: ProcessPoolExecutor | None = field(default=None, init=False)
    _loading: list[Future[None]] = field(default_factory=list, init=False)

    def __enter__(self) -> Workers:
        if self.processes > 1:
            from concurrent.futures import ProcessPoolExecutor  # not above: other commands start sooner without it

            self._pool = ProcessPoolExecutor(
                self.processes, get_context("spawn"), initializer=begin_worker, initargs=(signal.SIG_DFL,)
            )
            self._loading = [self._pool.submit(_load, self.module) for _ in range(self.processes)]
        return self

    def __exit__(self, *failure: object) -> None:
        if self._pool:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None

    def each(self, function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
        """Return the function's results in the order of the jobs; a job is what it is called with.

        The function must be a module's, so that another process finds it by its name. Where the system has ended a
        worker, as it does when memory runs short, the others go too and this process does the jobs itself.
        """
        if self._pool and len(jobs) > 1 and all(future.done() for future in self._loading):
            from concurrent.futures.process import BrokenProcessPool

            portion = -(-len(jobs) // (SHARES * self.processes))
            try:
                return list(self._pool.map(function, *zip(*jobs, strict=True), chunksize=portion))
            except BrokenProcessPool:
                self.__exit__()
        return [function(*job) for job in jobs]


ALONE = Workers()
"""Nobody beside this process."""


def corners(shape: tuple[int, int], side_px: int) -> list[tuple[int, int]]:
    """Return the first row and column of every block of a plane that is worked on block by block."""
    return [(row, col) for row in range(0, shape[0], side_px) for col in range(0, shape[1], side_px)]
