"""Every command's own door: a damaged file goes in where a user would give it, everything else is whole.

A command ends with exit code 0, or with 1, one line that names a file, and no output.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from dlwpredict.cli.app import app
from dlwpredict.files import write_height_map
from dlwpredict.heightmap import HeightMap
from tests.fuzz.readers import PARAMETERS, F, Reader, readers

MAP = "MAP"
"""Stands for the damaged file."""

CALLS = {
    "predict": ("predict", MAP, "-o", "out.tif"),
    "predict by tiles": ("predict", MAP, "-o", "out.tif", "--tile-px", "64"),
    "precompensate": ("precompensate", MAP, "-o", "out.tif", "--predictions", "2"),
    "export-stl": ("export-stl", MAP, "-o", "out.stl"),
    "convert": ("convert", MAP, "out.tif"),
    "score, recording": ("score", "good.tif", MAP, "-o", "out.json"),
    "score, target": ("score", MAP, "good.tif", "-o", "out.json"),
    "align, recording": ("align", MAP, "good.tif", "-o", "out.tif"),
    "align, target": ("align", "good.tif", MAP, "-o", "out.tif"),
    "calibrate": ("calibrate", "--pair", "good.tif", MAP, "-o", "out.yaml"),
    "diagnose": ("diagnose", "--pair", "good.tif", MAP, "-o", "out.yaml"),
    "predict, parameters": ("predict", "good.tif", "-p", MAP, "-o", "out.tif"),
    "diagnose, parameters": ("diagnose", "--pair", "good.tif", "good.tif", "-p", MAP, "-o", "out.yaml"),
}


def doors() -> list[Reader]:
    """Return a reader for every place where a command is given a file."""
    known = readers()
    maps = {ending: seeds for one in known if one.name != "parameters" for ending, seeds in one.seeds.items() if seeds}
    maps |= {".tif": maps[".tif"] * 4}
    found = []
    for name, words in CALLS.items():
        seeds = {".yaml": PARAMETERS} if "parameters" in name else maps
        endings = tuple(seeds) if len(seeds) == 1 else (*seeds, *[".tif"] * len(seeds))
        found.append(Reader(name, endings, _asked(words), seeds))
    return found


def _asked(words: tuple[str, ...]):
    def read(path: Path, rng: np.random.Generator | None) -> None:
        folder = path.parent / "door"
        folder.mkdir(exist_ok=True)
        good = folder / "good.tif"
        if not good.exists():
            write_height_map(good, HeightMap(F, 0.5, 0.5))
        before = set(folder.iterdir())
        given = [str(path) if word == MAP else str(folder / word) if "." in word else word for word in words]
        try:
            _judged(CliRunner().invoke(app, given), set(folder.iterdir()) - before, (str(path), str(folder)))
        finally:
            for made in set(folder.iterdir()) - before:
                shutil.rmtree(made) if made.is_dir() else made.unlink()

    return read


def _judged(result, made: set[Path], files: tuple[str, ...]) -> None:
    """Raise what is wrong with how a command has ended."""
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    said = [line for line in result.stderr.splitlines() if not line.startswith("warning: ")]
    if result.exit_code:
        assert result.exit_code == 1, f"exit code {result.exit_code}: {result.stderr[-300:]}"
        assert len(said) == 1 and said[0].startswith("error: "), f"said {result.stderr[-300:]!r}"
        assert any(name in said[0] for name in files), f"no file named: {said[0][:300]!r}"
        assert not made, f"left {sorted(one.name for one in made)}"
