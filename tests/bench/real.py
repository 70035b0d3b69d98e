"""The table of `make real`: what alignment and prediction reached on every real print.

Run as ``python -m tests.bench.real RUN_DIR`` after the Make rules have filled RUN_DIR/FIELD/.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import yaml
from scipy import ndimage

from dlwpredict.files import read_height_map

BLUR_PX = 3.0


def blurred_cc(folder: Path) -> float:
    """Return the correlation of target and aligned recording, both blurred; points not measured are left out."""
    target, aligned = (read_height_map(folder / name) for name in ("target.tif", "aligned.tif"))
    known = aligned.measured

    def smooth(heights: np.ndarray) -> np.ndarray:
        weight = ndimage.gaussian_filter(known.astype(float), BLUR_PX)
        return ndimage.gaussian_filter(np.where(known, heights, 0.0), BLUR_PX)[known] / weight[known]

    return float(np.corrcoef(smooth(target.heights_um), smooth(aligned.heights_um))[0, 1])


def main(run: Path) -> None:
    """Print the table, worst correlation last."""
    print(
        f"{'field':8s} {'CC blurred':>10s} {'CC':>6s} {'rot °':>7s} {'±':>6s} {'scale x':>8s} {'scale y':>8s} "
        f"{'mapping':8s} {'predicted: CC':>14s} {'rmse nm':>8s} {'offset-free nm':>15s}"
    )
    reached = []
    for folder in sorted(path.parent for path in run.glob("*/score.json")):
        pose = yaml.safe_load((folder / "align.yaml").read_text())
        score = json.loads((folder / "score.json").read_text())
        reached.append(blurred_cc(folder))
        print(
            f"{folder.name:8s} {reached[-1]:10.3f} {pose['cc']:6.3f} {pose['rotation_deg']:7.3f} "
            f"{pose['uncertainty']['rotation_deg']:6.3f} {pose['scale'][0]:8.4f} {pose['scale'][1]:8.4f} "
            f"{pose['distortion']:8s} {score['cc']:14.3f} {1e3 * score['rmse_um']:8.1f} "
            f"{1e3 * score['rmse_offset_free_um']:15.1f}"
        )
    print(f"{len(reached)} fields; lowest blurred correlation {min(reached):.3f} (wanted: at least 0.93)")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
