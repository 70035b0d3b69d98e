"""A batch on a real Dask cluster on loopback: a scheduler and two workers, one of them killed half way."""

import importlib.util
import json
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs dlwpredict[cluster]"),
]
PROGRAM = [sys.executable, "-c", "from dlwpredict.cli import main; main()"]
COUNT = 12


def dask(kind, *words):
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@contextmanager
def cluster(folder, workers=2):
    """Start a scheduler and workers; yield its address and the workers."""
    note = folder / "scheduler.json"
    started = [dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(note))]
    try:
        wait_for(note.exists)
        place = ("--scheduler-file", str(note), "--nthreads", "1", "--no-nanny", "--local-directory", str(folder / "w"))
        started += [dask("worker", *place) for _ in range(workers)]
        yield address(note), started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


def address(note):
    return json.loads(note.read_text())["address"]


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "targets").mkdir()
    for seed in range(COUNT):
        target = designs.air(size_um=20, pitch_um=0.25, margin_um=2, seed=seed)
        write_height_map(tmp_path / f"targets/t{seed:02d}.tif", target)
    (tmp_path / "m.yaml").write_text(
        "format: dlwpredict-batch/1\nstructures: targets/*.tif\ncommands: ['predict {target} -o out/{name}.tif']\n"
    )
    return tmp_path


def check_results(folder):
    for target in sorted((folder / "targets").glob("*.tif")):
        expected = predict(read_height_map(target), ParameterSet()).heights_um
        np.testing.assert_allclose(read_height_map(folder / "out" / target.name).heights_um, expected, atol=1e-5)


def test_a_killed_worker_loses_nothing(folder):
    with cluster(folder) as (scheduler, (first, _)):
        command = [*PROGRAM, "batch", str(folder / "m.yaml"), "--scheduler", scheduler]
        running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        wait_for(lambda: len(list(folder.glob("out/*.tif"))) >= COUNT // 3 or running.poll() is not None)
        assert running.poll() is None, "the batch ended before a worker could be killed"
        first.send_signal(signal.SIGKILL)
        said, errors = running.communicate(timeout=120)
        assert running.returncode == 0, errors
        done, before, failed = map(int, re.search(r"(\d+) done, (\d+) finished before, (\d+) failed", said).groups())
        # Killed between its last file and its word to the scheduler, a worker leaves a job that is done already.
        assert (done + before, failed) == (COUNT, 0) and before <= 1, said
        check_results(folder)
        again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
        assert f"{COUNT} finished before" in again.stdout


def test_tiles_of_one_map_go_through_the_same_engine(folder):
    target = folder / "targets/t00.tif"
    with cluster(folder) as (scheduler, _):
        words = ["predict", str(target), "-o", str(folder / "p.tif"), "--tile-px", "64", "--scheduler", scheduler]
        subprocess.run([*PROGRAM, *words], check=True, timeout=120)
    expected = predict(read_height_map(target), ParameterSet()).heights_um
    np.testing.assert_allclose(read_height_map(folder / "p.tif").heights_um, expected, atol=1e-4)


def test_no_scheduler_is_said_in_one_line(folder):
    command = [*PROGRAM, "batch", str(folder / "m.yaml"), "--scheduler", "tcp://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert done.stderr.startswith("error: --scheduler: no scheduler answers at tcp://127.0.0.1:9")
    assert done.stderr.count("\n") == 1
