"""What `make demo` made, and where: the summary at its end.

Run as ``python -m tests.bench.demo RUN_DIR`` after the Make rules have filled RUN_DIR.
"""

from __future__ import annotations

import sys
from pathlib import Path

import yaml

from dlwpredict.files import read_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.score import score
from tests.bench.generations import RIM_UM, without_rim


def line(name: str, text: str, place: Path) -> None:
    """Print one row of the summary."""
    print(f"  {name:12s} {text:46s} {place}")


def compared(reference: HeightMap, test: Path) -> str:
    """Say how far a map is from another, away from the outline."""
    found = score(reference, read_height_map(test), part_only=True)
    return f"rmse {found.rmse_um:.3f}, CC {found.cc:.3f}"


def show(part: Path) -> None:
    """Print what was made of one part."""
    pose = yaml.safe_load((part / "align.yaml").read_text())
    left = yaml.safe_load((part / "precompensation.yaml").read_text())["rmse_um"]
    target = without_rim(read_height_map(part / "target.tif"))
    print(f"\n{part.name.upper()}")
    angle = f"turned by {pose['rotation_deg']:.2f} ± {pose['uncertainty']['rotation_deg']:.2f}°"
    line("recording", f"{angle}, {100 * pose['missing_fraction']:.0f} % not measured", part / "aligned.tif")
    line("print", f"to target: {compared(target, part / 'aligned.tif')}", part / "recording.tif")
    predicted = target.with_heights(read_height_map(part / "predicted.tif").heights_um * (target.heights_um > 0))
    line("prediction", f"to print: {compared(predicted, part / 'aligned.tif')}", part / "score.png")
    line("correction", f"predicted rmse {left['before']:.3f} → {left['after']:.3f}", part / "corrected.stl")
    line("new print", f"to target: {compared(target, part / 'reprinted.tif')}", part / "reprinted.tif")


def main(run: Path) -> None:
    """Print what was made of each part, and the process that both share."""
    fit = yaml.safe_load((run / "calibration.yaml").read_text())
    rmse = fit["rmse_um"]
    print(f"\nFrom recordings to corrected parts; heights in µm from the substrate, {RIM_UM:g} µm inside the outline")
    for part in sorted((path.parent for path in run.glob("*/score.json")), reverse=True):
        show(part)
    print("\nPROCESS, learned from both recordings")
    line("parameters", f"prediction rmse {rmse['before']:.3f} → {rmse['after']:.3f}", run / "process.yaml")
    line("", f"left-out blocks {fit['holdout']['rmse_um']:.3f}; warnings", run / "calibration.yaml")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
