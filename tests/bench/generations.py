"""The table of `make generations`: the paper's Table 1 with the virtual press beside it.

Run as ``python -m tests.bench.generations RUN_DIR cin|air|lens-array`` after the Make rules have filled RUN_DIR/gK/.
Scored against the original target: the recording as aligned, and the true surface that the press knows. A rim of 2 µm
inside the outline is left out, as the paper crops its recordings; each generation's `score.json` has the whole part.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

from dlwpredict.files import read_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.score import Score, score

RIM_UM = 2.0

FIGURES = {
    "CC": "cc",
    "rmse / µm": "rmse_um",
    "α_z": "alpha_z",
    "l_z / µm": "l_z_um",
    "Sa / µm": "sa_um",
    "Sq / µm": "sq_um",
}

PAPER = {
    "cin": {"CC": (1.0, 0.270, 0.686, 0.848), "rmse / µm": (0.0, 4.044, 0.715, 0.332)},
    "air": {
        "CC": (1.0, 0.476, 0.762, 0.830),
        "rmse / µm": (0.0, 3.490, 1.270, 0.477),
        "α_z": (1.0, 0.772, 0.793, 0.924),
        "l_z / µm": (0.0, 0.196, 0.036, 0.036),
        "Sa / µm": (0.615, 0.570, 0.506, 0.581),
        "Sq / µm": (0.710, 0.741, 0.596, 0.695),
    },
}
"""Table 1 of Lang et al. 2022: target, calibration structure, 1st and 2nd generation."""


def without_rim(target: HeightMap) -> HeightMap:
    """Return the target without its rim (NaN there), so that only the inside is scored."""
    padded = np.pad(target.heights_um > 0, 1)
    depth = ndimage.distance_transform_edt(padded, sampling=(target.dy_um, target.dx_um))[1:-1, 1:-1]
    return target.with_heights(np.where((depth > 0) & (depth <= RIM_UM), np.nan, target.heights_um))


def scores(run: Path, name: str) -> list[Score]:
    """Return target against target, then every generation's map of this name against the target."""
    target = read_height_map(run / "target.tif")
    inner = without_rim(target)
    maps = [read_height_map(run / f"g{k}" / name) for k in range(len(list(run.glob("g*/score.json"))))]
    return [score(inner, test, part_only=True) for test in (target, *maps)]


def row(label: str, source: str, values: list[float]) -> str:
    """Return one line of the table."""
    return f"{label:10s} {source:15s}" + "".join(f"{value:12.3f}" for value in values)


def paper_gains(target: str) -> list[float]:
    """Return by how many times the paper's generations are better than its calibration structure."""
    errors = PAPER[target]["rmse / µm"]
    return [errors[1] / error for error in errors[2:]]


def main(run: Path, target: str) -> None:
    """Print the table and what the correction gained."""
    measured, true = scores(run, "aligned.tif"), scores(run, "printed.tif")
    heads = ["target", "calibration", *(f"gen. {k}" for k in range(1, len(measured) - 1))]
    print(f"\n{target.upper()}, {RIM_UM:g} µm inside the outline" + " " * 2 + "against the original target")
    print(" " * 26 + "".join(f"{head:>12s}" for head in heads))
    for label, key in FIGURES.items():
        if label in PAPER.get(target, {}):
            print(row(label, "paper", list(PAPER[target][label][: len(heads)])))
        print(row(label, "here, measured", [getattr(s, key) for s in measured]))
        print(row(label, "here, surface", [getattr(s, key) for s in true]))
    gains = [measured[1].rmse_um / s.rmse_um for s in measured[2:]]
    print("rmse smaller by a factor of " + ", ".join(f"{g:.1f}" for g in gains), end="")
    if target in PAPER:
        print(" (paper: " + ", ".join(f"{g:.1f}" for g in paper_gains(target)) + ")", end="")
    print(f"; all files: {run}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
