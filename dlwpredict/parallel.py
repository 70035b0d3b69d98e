"""The same function over several jobs, at once or one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


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
