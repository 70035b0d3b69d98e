"""A batch killed at random moments, workers and all, and begun again: as if nothing had happened."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from dlwpredict import designs
from dlwpredict.files import write_height_map
from tests.crash.checks import snapshot

BATCH = [sys.executable, "-c", "from dlwpredict.cli import main; main()", "batch", "m.yaml", "--jobs", "2"]
STRUCTURES = 8
MANIFEST = """\
format: dlwpredict-batch/1
structures: targets/*.tif
commands:
  - predict {target} -o out/{name}.tif
  - export-stl out/{name}.tif -o out/{name}.stl
"""


def batch(folder: Path) -> None:
    """Write the targets and the manifest of a small batch."""
    (folder / "targets").mkdir(parents=True)
    for seed in range(STRUCTURES):
        part = designs.air(size_um=24, pitch_um=0.25, margin_um=2, seed=seed)
        write_height_map(folder / f"targets/t{seed}.tif", part)
    (folder / "m.yaml").write_text(MANIFEST)


def resumed(root: Path, kills: int, seed: int) -> Counter:
    """Kill the batch, look at what is there, let the same command go on, and compare with an undisturbed one.

    Returns
    -------
    Counter
        How many kills came in time, and how many results were there, whole, at that moment.

    Raises
    ------
    AssertionError
        A broken result, or another end than the undisturbed one's.
    """
    batch(root / "source")
    shutil.copytree(root / "source", root / "whole")
    started = time.perf_counter()
    subprocess.run(BATCH, cwd=root / "whole", check=True, capture_output=True)
    takes, whole = time.perf_counter() - started, snapshot(root / "whole")
    rng, found = np.random.default_rng(seed), Counter()
    while found["killed"] < kills:
        folder = root / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(root / "source", folder)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        running = subprocess.Popen(BATCH, cwd=folder, start_new_session=True, **quiet)
        time.sleep(rng.uniform(0.3 * takes, takes))
        found["killed" if running.poll() is None else "came to its end"] += 1
        if running.poll() is None:
            os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        for name, content in snapshot(folder).items():
            if name.startswith("out/") and not Path(name).name.startswith(".dlwpredict-"):
                assert content == whole[name], f"{name} is broken: {len(content)} bytes"
                found["results there"] += 1
        again = subprocess.run(BATCH, cwd=folder, capture_output=True, text=True)
        assert again.returncode == 0, again.stderr
        assert snapshot(folder) == whole
    return found
