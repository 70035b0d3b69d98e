"""What `make demo` made, and where: the summary at its end.

Run as ``python -m tests.bench.demo RUN_DIR`` after the Make rules have filled RUN_DIR.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import yaml

from dlwpredict.files import read_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.score import score
from tests.bench.generations import RIM_UM, without_rim


def line(name: str, text: str, place: Path) -> None:
    """Print one row of the summary."""
    print(f"  {name:13s} {text:64s} {place}")


def off_target(target: HeightMap, print_of: Path) -> str:
    """Say how far a print is from the target, inside its outline."""
    found = score(without_rim(target), read_height_map(print_of), part_only=True)
    return f"{found.rmse_um:.3f} off the target, CC {found.cc:.3f}"


def main(run: Path) -> None:
    """Print what was made of each part."""
    fit = yaml.safe_load((run / "calibration.yaml").read_text())
    parts = sorted((path.parent for path in run.glob("*/score.json")), reverse=True)
    print(f"\nFrom {len(parts)} recordings to corrected parts (rmse in µm, heights from the substrate;")
    print(
        f"prints are compared with the target {RIM_UM:g} µm inside its outline, the new one as the press knows it):\n"
    )
    for part in parts:
        pose = yaml.safe_load((part / "align.yaml").read_text())
        target = read_height_map(part / "target.tif")
        found = json.loads((part / "score.json").read_text())
        pre = yaml.safe_load((part / "precompensation.yaml").read_text())
        left, reached = pre["rmse_um"], pre["reachable"]
        print(part.name.upper())
        angle = f"turned by {pose['rotation_deg']:.2f} ± {pose['uncertainty']['rotation_deg']:.2f}°"
        line("recording", f"{angle}, {100 * pose['missing_fraction']:.0f} % not measured", part / "align.yaml")
        line("print", off_target(target, part / "aligned.tif"), part / "aligned.tif")
        line("prediction", f"{found['rmse_um']:.3f} off the print, CC {found['cc']:.3f}", part / "score.png")
        text = f"predicted {left['before']:.3f} → {left['after']:.3f} off the target"
        line("correction", f"{text} ({reached['rmse_um']:.3f} away from walls)", part / "corrected.tif")
        line(
            "to print",
            f"watertight solid, {(part / 'corrected.stl').stat().st_size / 1e6:.1f} MB",
            part / "corrected.stl",
        )
        line("new print", off_target(target, part / "reprinted.tif"), part / "reprinted.tif")
    rmse = fit["rmse_um"]
    print("PROCESS")
    line(
        "calibration",
        f"prediction error {rmse['before']:.3f} → {rmse['after']:.3f} over both parts",
        run / "process.yaml",
    )
    line("", f"blocks left out {fit['holdout']['rmse_um']:.3f}; intervals and warnings", run / "calibration.yaml")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
