"""Jobs in turn, each in a process of its own: time, processor time and peak memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any


def job(*words: object) -> list[str]:
    """Return the command line of a job."""
    return [sys.executable, "-m", "tests.bench.speed.jobs", *map(str, words)]


def alternate(commands: Mapping[str, Sequence[str]], repeats: int) -> dict[str, dict[str, Any]]:
    """Run all commands in turn, over and over; return the medians by name.

    Jobs time themselves. Of any other command, the whole process is timed.
    """
    found: dict[str, list[dict]] = {name: [] for name in commands}
    for _ in range(repeats):
        for name, words in commands.items():
            found[name].append(once(words))
    return {name: {"repeats": repeats, **_medians(runs)} for name, runs in found.items()}


def once(words: Sequence[str]) -> dict[str, Any]:
    """Run a command; raise if it fails."""
    started = time.perf_counter()
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    )
    said = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.stdout.close()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"failed: {words}")
    if said.startswith("{"):
        return json.loads(said)
    return {
        "wall_s": time.perf_counter() - started,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_mb": used.ru_maxrss / 1024,
    }


def _medians(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {
        key: median(run[key] for run in runs) if isinstance(value, (int, float)) else value
        for key, value in runs[0].items()
    }
