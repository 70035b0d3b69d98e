"""The same function over several jobs, at once or one after the other."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
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


def _begin_worker(on_interrupt: signal.Handlers) -> None:
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


def _done(function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
    return [function(*job) for job in jobs]


@dataclass(eq=False)
class Workers:
    """Processes that share jobs of tenths of a second and more; they start on entering, and end on leaving.

    Each is a pool of its own, so that it is known which job a process died of.

    Parameters
    ----------
    processes : int
        1 = this one.
    module : str
        What they load before they are ready.
    on_interrupt : signal.Handlers
        Whether Ctrl-C ends them too, or leaves them to finish their jobs.

    Examples
    --------
    >>> with Workers() as workers:
    ...     workers.each(pow, [(2, 2), (3, 2)])
    [4, 9]
    """

    processes: int = 1
    module: str = __package__
    on_interrupt: signal.Handlers = signal.SIG_DFL
    _pools: list[ProcessPoolExecutor] = field(default_factory=list, init=False)
    _loading: list[Future[None]] = field(default_factory=list, init=False)

    def __enter__(self) -> Workers:
        for _ in range(self.processes if self.processes > 1 else 0):
            self._start()
        return self

    def __exit__(self, *failure: object) -> None:
        for pool in self._pools:
            pool.shutdown(wait=False, cancel_futures=True)
        self._pools.clear()

    def _start(self) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor  # not above: other commands start sooner without it

        pool = ProcessPoolExecutor(1, get_context("spawn"), initializer=_begin_worker, initargs=(self.on_interrupt,))
        self._pools.append(pool)
        self._loading.append(pool.submit(_load, self.module))
        return pool

    def each(self, function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
        """Return the function's results in the order of the jobs; a job is what it is called with.

        Until the workers are ready this process does the jobs itself. Where the system has ended a worker, as it does
        when memory runs short, the others go too and this process does the jobs.
        """
        if self._pools and len(jobs) > 1 and all(future.done() for future in self._loading):
            size = -(-len(jobs) // (SHARES * self.processes))
            portions = [(function, jobs[first : first + size]) for first in range(0, len(jobs), size)]
            try:
                done = {k: future.result() for k, future in self.ended(_done, portions, deque(range(len(portions))))}
                return [result for k in range(len(portions)) for result in done[k]]
            except BrokenExecutor:
                self.__exit__()
        return _done(function, jobs)

    def ended(
        self, function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]], todo: deque[int]
    ) -> Iterator[tuple[int, Future[Result]]]:
        """Yield the numbers of jobs, with their futures, as they come to an end.

        The function must be a module's, so that another process finds it by its name. Where a worker died of a job, the
        future holds a `BrokenExecutor`; the worker is replaced, and a number that was put back is done again.

        Parameters
        ----------
        function : callable
        jobs : sequence of tuple
            What it is called with.
        todo : deque of int
            Numbers of the jobs to be done, in order.
        """
        idle, running = list(self._pools), dict[Future[Result], tuple[Any, int]]()
        while todo or running:
            while todo and idle:
                pool, k = idle.pop(), todo.popleft()
                running[_sent(pool, function, jobs[k])] = pool, k
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                pool, k = running.pop(future)
                yield k, future
                if isinstance(future.exception(), BrokenExecutor):
                    self._pools.remove(pool)
                    pool = self._start()
                idle.append(pool)


def _sent(pool: ProcessPoolExecutor, function: Callable[..., Result], job: tuple[Any, ...]) -> Future[Result]:
    """Give a worker a job; one that has died meanwhile fails at it."""
    try:
        return pool.submit(function, *job)
    except BrokenExecutor as error:
        failed: Future[Result] = Future()
        failed.set_exception(error)
        return failed


def end_workers() -> None:
    """End the worker processes of this one: what they were doing is not wanted any more."""
    for worker in active_children():
        worker.terminate()


def cpu_s() -> float:
    """Return the processor time of this process and its workers, s; of those that run, where the system lists them."""
    spent = time.process_time() + sum(os.times()[2:4])
    for worker in active_children():
        try:
            stat = Path(f"/proc/{worker.pid}/stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        spent += sum(map(int, stat.rpartition(") ")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")
    return spent


ALONE = Workers()
"""Nobody beside this process."""


def corners(shape: tuple[int, int], side_px: int) -> list[tuple[int, int]]:
    """Return the first row and column of every block of a plane that is worked on block by block."""
    return [(row, col) for row in range(0, shape[0], side_px) for col in range(0, shape[1], side_px)]
