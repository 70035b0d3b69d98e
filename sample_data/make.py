"""Make the sample data: two targets, printed by the virtual press and recorded by its microscope.

Run as ``python -m sample_data.make`` from the repository's root; `make sample-data` does. The files are the same bytes
each time. What the recordings are spoilt with is in configs/press.yaml and configs/microscope.yaml.
"""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile

from dlwpredict import designs
from dlwpredict.files import write_height_map
from tests.press import Pose, Recording, load_microscope, load_press, measure, print_part

HERE = Path(__file__).parent
CONFIGS = HERE.parent / "configs"

PARTS = {
    "cin": (
        designs.cin(size_um=50.0, pitch_um=0.4, margin_um=6.0),
        Pose((2.3, -1.6), rotation_deg=3.4, tilt_mrad=(2.1, -3.3), offset_um=4.2),
        75.0,
    ),
    "air": (
        designs.air(size_um=40.0, pitch_um=0.4, margin_um=6.0, seed=1),
        Pose((-3.1, 0.8), rotation_deg=-5.2, tilt_mrad=(-1.4, 2.6), offset_um=2.7),
        65.0,
    ),
}
"""Target, how it lay under the microscope, and the side of the field in view, µm."""


def recorded(name: str, seed: int) -> Recording:
    """Print a part and record it."""
    target, pose, field_um = PARTS[name]
    printed = print_part(target.heights_um, target.dx_um, target.dy_um, load_press(CONFIGS / "press.yaml"))
    microscope = replace(load_microscope(CONFIGS / "microscope.yaml"), pose=pose, field_um=(field_um, field_um))
    return measure(printed, target.dx_um, target.dy_um, microscope, seed=seed)


def write_plain_tiff(path: Path, heights_um: np.ndarray) -> None:
    """Write heights in µm as some instruments do: float32, no pitch, NaN where nothing was measured."""
    tifffile.imwrite(path, np.float32(heights_um), metadata=None, software=False)


def write_metres(path: Path, heights_um: np.ndarray) -> None:
    """Write heights in metres as some instruments do: tabs, CR LF, five digits, BAD where nothing was measured."""
    rows = ("\t".join("BAD" if np.isnan(z) else f"{1e-6 * z:.4e}" for z in row) + "\r\n" for row in heights_um)
    path.write_bytes(gzip.compress("".join(rows).encode(), mtime=0))


def main() -> None:
    """Write targets and recordings next to this file."""
    for name, (target, *_) in PARTS.items():
        write_height_map(HERE / f"{name}_target.tif", target)
    write_metres(HERE / "cin_recording.txt.gz", recorded("cin", seed=1).heights)
    write_plain_tiff(HERE / "air_recording.tif", recorded("air", seed=2).heights)


if __name__ == "__main__":
    main()
