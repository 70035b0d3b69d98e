"""A batch on a real Dask cluster on loopback: a scheduler and two workers, one of them killed half way."""

import importlib.util
import re
import signal
import subprocess

import numpy as np
import pytest

from dlwpredict.files import read_height_map
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict
from tests.bench.speed.cluster import PREDICT, PROGRAM, cluster, structures, wait_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs dlwpredict[cluster]"),
]
COUNT = 12


@pytest.fixture
def folder(tmp_path):
    structures(tmp_path, COUNT, PREDICT)
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
    target = folder / "targets/t000.tif"
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
