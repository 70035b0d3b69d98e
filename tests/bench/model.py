"""Fast numerics against voxels refined towards zero slice: agreement, time and peak memory of both.

Run as ``python -m tests.bench.model``. Agreement: the mean over voxels of 9, 10 and 11 nm, whose
roundings to whole slices (2.9 nm rms each, the same all over a flat top) partly cancel.
Time and memory: each method alone in a process of its own, on 0.1 µm pixels and, for the voxels, 0.1 µm slices.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time

import numpy as np
from scipy import ndimage

from dlwpredict import designs
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.model.voxels import Voxels
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

PROCESSES = {
    "paper's defaults": Paper(),
    "long focus": Paper(0.41, 2.15, 0.45, 5.0, 5.0, 0.72, 0.95),
    "high threshold": Paper(0.7, 1.3, 0.58, 4.4, 8.0, 0.65, 0.9),
}
SLICES_UM = (0.009, 0.010, 0.011)
RIM_UM = 0.5


def targets(pitch_um: float) -> dict[str, HeightMap]:
    """Return the four structures of the comparison, small enough for fine voxels."""
    small = {"pitch_um": pitch_um, "margin_um": 3.0}
    return {
        "cin": designs.cin(size_um=30, **small),
        "air": designs.air(size_um=30, seed=1, **small),
        "stairs": designs.stairs(size_um=40, feature_um=5, **small),
        "posts": designs.posts(size_um=40, **small),
    }


def agreement() -> None:
    """Print the rms difference inside the parts and with their rims."""
    print(f"fast against voxels, mean of {' '.join(f'{1e3 * s:g}' for s in SLICES_UM)} nm slices")
    print(f"{'structure':10s} {'process':18s} {'inside nm':>10s} {'with rim nm':>12s} {'bias nm':>8s} {'max nm':>8s}")
    for name, target in targets(0.25).items():
        step = ndimage.morphological_gradient(target.heights_um, size=3) > 1.0
        near_step = ndimage.binary_dilation(step, iterations=round(RIM_UM / target.dx_um))
        part = target.heights_um > 0
        for label, paper in PROCESSES.items():
            process = ParameterSet(paper=paper)
            fast = predict(target, process, numerics=Levels()).heights_um
            voxel = np.mean([predict(target, process, numerics=Voxels(s)).heights_um for s in SLICES_UM], axis=0)
            difference = 1e3 * (voxel - fast)
            inside, rim = difference[part & ~near_step], difference[part | near_step]
            print(
                f"{name:10s} {label:18s} {np.sqrt(np.mean(inside**2)):10.2f} {np.sqrt(np.mean(rim**2)):12.2f} "
                f"{inside.mean():8.2f} {np.abs(inside).max():8.2f}",
                flush=True,
            )


def cost(method: str) -> None:
    """Print time and peak memory of one method on a 100 µm part at 0.1 µm pitch (this process only)."""
    target = designs.air(size_um=100, pitch_um=0.1, margin_um=4.0, seed=1)
    numerics = Levels() if method == "fast" else Voxels(0.1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    predict(target, ParameterSet(), numerics=numerics)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"{method:6s} {target.shape[1]} x {target.shape[0]} px: {seconds:8.2f} s, peak memory {peak / 1024:6.0f} MB "
          f"({(peak - before) / 1024:.0f} MB above start)", flush=True)  # fmt: skip


if __name__ == "__main__":
    if len(sys.argv) > 1:
        cost(sys.argv[1])
    else:
        for method in ("fast", "voxel", "fast", "voxel", "fast"):
            subprocess.run([sys.executable, "-m", "tests.bench.model", method], check=True)
        agreement()
