"""What `make demo` made, and where: the story at its end.

Run as ``python -m tests.bench.demo RUN_DIR SEVEN_DIR`` after the Make rules have filled both: SEVEN_DIR holds the
prints that were corrected by the seven parameters alone.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from dlwpredict.files import read_height_map
from dlwpredict.metrology.score import score
from dlwpredict.metrology.walls import near_walls_or_rim


def off_um(target: Path, print_of: Path) -> float:
    """Return how far a print is from the target away from walls and rim, µm rms, as the report has it."""
    part = read_height_map(target)
    left_out = (part.heights_um == 0) | near_walls_or_rim(part)
    return score(part, read_height_map(print_of), left_out=left_out).rmse_um


def missing(diagnosis: Path) -> str:
    """Say what a diagnosis has found, how probable it is, on which side, and how much it explains."""
    said = yaml.safe_load(diagnosis.read_text())
    found = [
        f"{' or '.join(one['effects'])} ({one['side']} side, probability {likely(one['probability'])})"
        for one in said["findings"]
    ]
    share = said["remainder"]["explained_share"]
    rest = f"; the rest, {100 * (1 - share):.0f} %, has no name" if said["verdict"] == "unexplained" else ""
    return (", ".join(found) or "nothing beyond noise") + rest


def likely(probability: float) -> str:
    """Say a probability.

    Examples
    --------
    >>> likely(0.9314), likely(1.0)
    ('93 %', '> 99.9 %')
    """
    return "> 99.9 %" if probability > 0.999 else f"{100 * probability:.0f} %"


def story(run: Path, by_seven: Path) -> list[str]:
    """Return the five lines."""
    parts = sorted((path.parent for path in run.glob("*/score.json")), reverse=True)
    name = ", ".join(part.name.upper() for part in parts)
    first = [off_um(part / "target.tif", part / "aligned.tif") for part in parts]
    seven = [off_um(part / "target.tif", by_seven / part.name / "reprinted.tif") for part in parts]
    last = [off_um(part / "target.tif", part / "reprinted.tif") for part in parts]

    def listed(values: Sequence[float]) -> str:
        return ", ".join(f"{value:.3f}" for value in values)

    times = ", ".join(f"{a / b:.0f}" for a, b in zip(first, last, strict=True))
    solids = ", ".join(str(part / "corrected.stl") for part in parts)
    return [
        f"print          {listed(first)} µm off the target ({name}; rms, away from walls and rim)",
        f"seven alone    {listed(seven)} µm off, when corrected by what calibrate learned ({run / 'process.yaml'})",
        f"missing        {missing(run / 'diagnosis.yaml')} ({run / 'diagnosis.html'})",
        f"corrected      {listed(last)} µm off, {times} times better, when corrected by what diagnose found",
        f"to print       {solids}; all of it: {run / 'report.html'}",
    ]


if __name__ == "__main__":
    print("\n" + "\n".join(f"  {line}" for line in story(*map(Path, sys.argv[1:]))))
