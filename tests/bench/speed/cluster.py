"""A Dask scheduler and its workers on loopback, and a batch on them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dlwpredict import designs
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

PROGRAM = [sys.executable, "-c", "from dlwpredict.cli import main; main()"]
STRUCTURES = 200
MANIFEST = "format: dlwpredict-batch/1\nstructures: targets/*.tif\ncommands: ['{command}']\n"
PREDICT = "predict {target} -o out/{name}.tif"


def dask(kind: str, *words: str) -> subprocess.Popen:
    """Start a part of a cluster as a process of its own."""
    program = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
    return subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """Start a scheduler and workers of one thread each; yield its address and the workers."""
    note = folder / "scheduler.json"
    note.unlink(missing_ok=True)
    started = [dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(note))]
    try:
        wait_for(lambda: note.exists() and note.read_text().endswith("}"))  # it is there before it is written
        place = ("--scheduler-file", str(note), "--nthreads", "1", "--no-nanny", "--local-directory", str(folder / "w"))
        started += [dask("worker", *place) for _ in range(workers)]
        yield json.loads(note.read_text())["address"], started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


def wait_for(condition: Callable[[], bool], seconds: float = 60) -> None:
    """Wait until something is so.

    Raises
    ------
    TimeoutError
        It never was.
    """
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {seconds:g} s")
        time.sleep(0.05)


def structures(folder: Path, count: int, command: str, size_um: float = 20.0) -> None:
    """Write targets of this size on pixels of a quarter of a micrometre, and the manifest of a batch."""
    (folder / "targets").mkdir(parents=True)
    for seed in range(count):
        part = designs.air(size_um=size_um, pitch_um=0.25, margin_um=2, seed=seed)
        write_height_map(folder / f"targets/t{seed:03d}.tif", part)
    (folder / "m.yaml").write_text(MANIFEST.format(command=command))


def seconds(workers: int, command: str, size_um: float) -> float:
    """Return how long a batch of 200 structures takes from the first results on; starting is not counted."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        structures(folder, STRUCTURES, command, size_um)
        with cluster(folder, workers) as (scheduler, _):
            running = _batch(folder, scheduler)
            wait_for(lambda: _results(folder) >= 2 * workers or running.poll() is not None)
            started, before = time.monotonic(), _results(folder)
            if running.wait():
                raise RuntimeError(f"batch: ended with {running.returncode}")
            return (time.monotonic() - started) * STRUCTURES / (STRUCTURES - before)


def survived() -> tuple[int, float]:
    """Kill one of two workers half way; return how many of 200 results are there, and their largest error, µm."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        structures(folder, STRUCTURES, PREDICT)
        with cluster(folder, 2) as (scheduler, (first, _)):
            running = _batch(folder, scheduler)
            wait_for(lambda: _results(folder) >= STRUCTURES // 2 or running.poll() is not None, 600)
            first.send_signal(signal.SIGKILL)
            if running.wait():
                raise RuntimeError(f"batch: ended with {running.returncode}")
        errors = []
        for path in sorted((folder / "out").glob("*.tif")):
            expected = predict(read_height_map(folder / "targets" / path.name), ParameterSet()).heights_um
            errors.append(np.abs(read_height_map(path).heights_um - expected).max())
        return len(errors), float(max(errors))


def _batch(folder: Path, scheduler: str) -> subprocess.Popen:
    words = [*PROGRAM, "batch", str(folder / "m.yaml"), "--scheduler", scheduler]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL)


def _results(folder: Path) -> int:
    return len(list(folder.glob("out/*.tif")))
