"""Work that is shared gives what one process alone gives."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import wait
from pathlib import Path

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.diagnosis.answer.content import content_of
from dlwpredict.diagnosis.run import Course, diagnose
from dlwpredict.effects import library
from dlwpredict.infer.recording import prepare
from dlwpredict.numerics.parallel import Workers, each
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict


@pytest.fixture(scope="module")
def workers():
    with Workers(2, diagnose.__module__) as those:
        wait(those._loading)
        yield those


@pytest.mark.slow
def test_results_come_in_the_order_of_the_jobs(workers):
    jobs = [(k, 2) for k in range(40)]
    assert workers.each(pow, jobs) == [k**2 for k in range(40)] == each(lambda k: k**2, range(40), threads=2)


def test_a_failing_job_fails_here_and_ends_nobody(workers):
    with pytest.raises(ZeroDivisionError):
        workers.each(divmod, [(1, 1), (1, 0)])
    assert workers.each(divmod, [(7, 2), (9, 2)]) == [(3, 1), (4, 1)]


def test_jobs_are_done_here_before_workers_are_ready_and_after_they_have_gone():
    with Workers(2) as those:
        assert those.each(lambda k: k + 1, [(1,), (2,)]) == [2, 3]  # a lambda could not be sent
    assert those.each(lambda k: k + 1, [(1,), (2,)]) == [2, 3]


@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_where_a_worker_has_been_killed_the_jobs_are_done_here():
    with Workers(2) as those:
        wait(those._loading)
        os.kill(next(iter(those._pools[0]._processes)), signal.SIGKILL)
        assert those.each(pow, [(k, 2) for k in range(8)]) == [k**2 for k in range(8)]
        assert those.each(pow, [(k, 3) for k in range(8)]) == [k**3 for k in range(8)]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_a_worker_that_is_killed_at_work_is_replaced_by_this_process():
    with Workers(2) as those:
        wait(those._loading)
        jobs = [(os.getpid(), k) for k in range(8)]
        assert those.each(ended_elsewhere, jobs) == list(range(8))


def ended_elsewhere(process: int, number: int) -> int:
    """Return the number; in any other process, end as by a system that is short of memory."""
    if os.getpid() != process:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


SLEEPER = """
import time
from concurrent.futures import wait
from dlwpredict.numerics.parallel import Workers

if __name__ == "__main__":
    with Workers(2) as those:
        wait(those._loading)
        print(*(pid for pool in those._pools for pid in pool._processes), flush=True)
        time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_workers_end_with_a_killed_process(tmp_path):
    script = tmp_path / "main.py"
    script.write_text(SLEEPER)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as process:
        pids = [int(word) for word in process.stdout.readline().split()]
        process.kill()
    assert len(pids) == 2
    ends = time.monotonic() + 10
    while any(map(alive, pids)) and time.monotonic() < ends:
        time.sleep(0.05)
    assert not any(map(alive, pids))


def alive(pid: int) -> bool:
    """Tell whether a process runs; one that has ended and that nobody has asked about does not."""
    try:
        os.kill(pid, 0)
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return not Path("/proc/self").exists()  # where there is no such file system, the signal was the answer
    except ProcessLookupError:
        return False


@pytest.mark.slow
@pytest.mark.long
def test_a_diagnosis_is_that_of_one_process(workers):
    """Down to the last figure: what is found must not hang on how many cores a machine has."""
    target = designs.cin(size_um=20, pitch_um=0.5, margin_um=2)
    dried = ParameterSet(effects=(library()["edge-drying"](depth_um=0.5),))
    noise = np.random.default_rng(4).normal(0, 0.004, target.shape)
    pair = prepare(target, target.with_heights(predict(target, dried).heights_um + noise))
    alone, shared = (diagnose([pair], ParameterSet(), course=Course(workers=those)) for those in (Workers(), workers))
    assert content_of(shared) == content_of(alone)
    assert alone.named
    models = shared.baseline.fit, shared.extended.fit, *(one.reduced for one in shared.named)
    assert len({id(model.data[0].whitener) for model in models}) == 1  # no copies, or eight recordings fill the memory
