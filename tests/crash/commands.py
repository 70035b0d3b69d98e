"""Every command that writes, with all of its outputs, small enough to be run hundreds of times."""

import json
from pathlib import Path

import numpy as np

from dlwpredict import designs
from dlwpredict.cli.commands import NAMES
from dlwpredict.files import write_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.pages.records import read_record
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

PRINTED = ParameterSet(paper=Paper(shrinkage_min=0.74, shrinkage_max=0.96))
PAIR = ("--pair", "target.tif", "aligned.tif")
KAPPAS = ("--free", "shrinkage_min", "--free", "shrinkage_max")

COMMANDS: dict[str, tuple[str, ...]] = {
    "design": ("design", "f", "-o", "f.tif", "--pitch-um", "0.1"),
    "convert": ("convert", "large.tif", "large.csv"),
    "align": ("align", "recording.tif", "target.tif", "-o", "again.tif", "--report", "align.yaml"),
    "predict": ("predict", "target.tif", "-o", "predicted.tif"),
    "score": ("score", "target.tif", "aligned.tif", "--json", "score.json", "--plot", "score.png"),
    "calibrate": ("calibrate", *PAIR, *KAPPAS, "-o", "process.yaml", "--report", "process.json"),
    "diagnose": (
        *("diagnose", *PAIR, "-o", "diagnosis.yaml", "--params-out", "extended.yaml"),
        *("--report", "diagnosis.html", "--no-advice"),
    ),
    "precompensate": (
        *("precompensate", "target.tif", "-o", "corrected.tif"),
        *("--report", "pre.yaml", "--unreachable", "missing.tif"),
    ),
    "export-stl": ("export-stl", "target.tif", "-o", "part.stl"),
}
BETWEEN = {
    "diagnose": {
        "diagnosis.yaml": lambda path: read_record(path)[0] == "diagnosis",
        "diagnosis.resume.json": lambda path: "stored" in json.loads(path.read_text()),
    }
}
"""Outputs that are written again and again while the work goes on, and what tells a whole one."""

WRITE_NOTHING = {"effects", "verify"}
OTHERS = {"batch", "report", "init"}
"""Covered by tests of their own."""


def commands() -> set[str]:
    """Return the names of all commands of the program."""
    return set(NAMES)


def inputs(folder: Path) -> None:
    """Write the inputs of all commands."""
    rng = np.random.default_rng(0)
    target = designs.air(size_um=18.0, pitch_um=0.5, margin_um=3.0)
    printed = predict(target, PRINTED)
    noisy = printed.with_heights(printed.heights_um + rng.normal(scale=0.01, size=target.shape))
    write_height_map(folder / "target.tif", target)
    write_height_map(folder / "aligned.tif", noisy)
    wide = np.pad(noisy.heights_um, 6) + 3.0
    write_height_map(folder / "recording.tif", HeightMap(wide, 0.5, 0.5))
    write_height_map(folder / "large.tif", HeightMap(rng.random((500, 500)), 0.5, 0.5))
