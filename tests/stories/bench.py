"""The bench of a story: one folder, in which parts are designed, printed, recorded and handed to the commands.

Every step is a command of its own that reads and writes files of the folder, and is kept with what it said. Only
`printed`, `recorded` and `surface` know the press; the commands of `dlwpredict` are given targets and recordings.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlwpredict.files import read_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.score import score
from tests.bench.generations import without_rim
from tests.press import read_map, write_map

ROOT = Path(__file__).parents[2]
PROGRAM = Path(sys.executable).with_name("dlwpredict")

FINER = 2
"""The press prints the target's pixels as squares of this many pixels a side."""

PIXELS, PITCH_UM, MARGIN_PX = 80, 0.45, 8
SIZE_UM, MARGIN_UM = (PIXELS - 2 * MARGIN_PX) * PITCH_UM, MARGIN_PX * PITCH_UM
"""Side of the parts, and the bare substrate around them."""

PROCESS = {
    "focus_fwhm_xy_um": 0.55, "focus_fwhm_z_um": 1.6, "threshold": 0.47, "crosslink_fwhm_xy_um": 6.5,
    "crosslink_fwhm_z_um": 6.0, "shrinkage_min": 0.74, "shrinkage_max": 0.96,
}  # fmt: skip
"""The press of every story, but for what is concealed."""

NOISE = {"sigma_um": 0.012, "correlation_um": 0.8, "white_um": 0.003}
"""The noise of every recording."""

Pair = tuple[str, str]


class StepError(RuntimeError):
    """A command of a story has failed."""


class Bench:
    """A story's folder and the commands that were run in it.

    Parameters
    ----------
    folder : Path
        Emptied first.
    """

    def __init__(self, folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self.folder = folder
        self.steps: list[dict[str, str]] = []

    # -- commands ---------------------------------------------------------------------------
    def program(self, *words: str) -> None:
        """Run one command of `dlwpredict` in the folder."""
        self._run([str(PROGRAM), *words], "dlwpredict " + shlex.join(words))

    def refused(self, *words: str) -> str:
        """Run a command of `dlwpredict` that is to be refused; return what it complains of, empty if it was not."""
        shown, done = "dlwpredict " + shlex.join(words), _called([str(PROGRAM), *words], self.folder)
        complaint = " ".join(done.stderr.split()) if done.returncode == 1 else ""
        self.steps.append({"command": shown, "said": complaint or done.stdout.strip()})
        return complaint

    def press(self, *words: str) -> None:
        """Run the virtual press or its microscope in the folder."""
        self._run([sys.executable, "-m", "tests.press", *words], "python -m tests.press " + shlex.join(words))

    def _run(self, command: Sequence[str], shown: str) -> None:
        done = _called(command, self.folder)
        if done.returncode:
            raise StepError(f"{self.folder}: {shown}: {done.stderr.strip()}")
        self.steps.append({"command": shown, "said": done.stdout.strip()})

    # -- files ------------------------------------------------------------------------------
    def map(self, name: str) -> HeightMap:
        """Return a height map of the folder."""
        return read_height_map(self.folder / name)

    def yaml(self, name: str) -> dict[str, Any]:
        """Return a YAML or JSON file of the folder."""
        return yaml.safe_load((self.folder / name).read_text(encoding="utf-8"))

    def write(self, name: str, content: Mapping) -> str:
        """Write a YAML file into the folder; return its name."""
        write_text(self.folder / name, yaml.safe_dump(dict(content), sort_keys=False))
        return name

    # -- the workshop -----------------------------------------------------------------------
    def settings(self, name: str, *, effects: Sequence[Mapping] = (), **others: Any) -> str:
        """Write the press's settings with what is concealed; return the file's name."""
        return self.write(name, {"format": "press/1", **PROCESS, **others, "effects": list(effects)})

    def design(self, kind: str, name: str, *, size_um: float = SIZE_UM, **options: float) -> str:
        """Make a target of the usual pixels; return the file's name."""
        margin = (PIXELS * PITCH_UM - size_um) / 2
        words = [w for key, value in options.items() for w in (f"--{key.replace('_', '-')}", f"{value:g}")]
        grid = ["--size-um", f"{size_um:g}", "--pitch-um", f"{PITCH_UM:g}", "--margin-um", f"{margin:g}"]
        self.program("design", kind, *grid, *words, "-o", f"{name}.tif")
        return f"{name}.tif"

    def formula(self, name: str, target: HeightMap) -> str:
        """Write a target that is made elsewhere; return the file's name."""
        write_map(self.folder / f"{name}.tif", target.heights_um, target.dx_um, target.dy_um)
        return f"{name}.tif"

    def printed(self, written: str, press: str, name: str) -> str:
        """Print a map on pixels so many times finer; return the print's file."""
        heights, dx, dy = read_map(self.folder / written)
        fine = written.replace(".tif", "_fine.tif")
        write_map(self.folder / fine, np.kron(heights, np.ones((FINER, FINER))), dx / FINER, dy / FINER, overwrite=True)
        self.press("print", fine, "-p", press, "-o", f"{name}_printed.tif")
        return f"{name}_printed.tif"

    def recorded(self, printed: str, name: str, *, seed: int, **settings: Any) -> str:
        """Record a print; on the target's grid and noisy if not said otherwise. Return the recording's file."""
        rng = np.random.default_rng([seed, 5])
        pose = {"shift_um": rng.normal(0, 0.03, 2).tolist(), "rotation_deg": float(rng.normal(0, 0.02))}
        scope = {**self._grid(printed), "pose": pose, "noise": NOISE, **settings}
        self._measured(printed, name, scope, seed)
        return f"{name}.tif"

    def surface(self, printed: str, name: str) -> str:
        """Return the file of the true surface of a print on the target's grid."""
        self._measured(printed, name, self._grid(printed), 0)
        return f"{name}.tif"

    def _grid(self, printed: str) -> dict[str, Any]:
        heights, dx, dy = read_map(self.folder / printed)
        rows, cols = heights.shape
        return {"pitch_um": [dx * FINER, dy * FINER], "pixels": [cols // FINER, rows // FINER]}

    def _measured(self, printed: str, name: str, scope: Mapping, seed: int) -> None:
        self.write(f"{name}_microscope.yaml", {"format": "microscope/1", **scope})
        self.press("measure", printed, "-p", f"{name}_microscope.yaml", "-o", f"{name}.tif", "--seed", str(seed))

    # -- questions --------------------------------------------------------------------------
    def calibrated(self, name: str, pairs: Sequence[Pair], *options: str) -> dict[str, Any]:
        """Calibrate with some recordings; return the report."""
        self.program("calibrate", *_words(pairs), *options, "-o", f"{name}.yaml", "--report", f"{name}_report.yaml")
        return self.yaml(f"{name}_report.yaml")

    def diagnosed(
        self, name: str, pairs: Sequence[Pair], *options: str, holdout: Sequence[Pair] = ()
    ) -> dict[str, Any]:
        """Diagnose some recordings; return the diagnosis. `NAME_extended.yaml` holds the process with the findings."""
        words = [*_words(pairs), *_words(holdout, "--holdout"), *options]
        self.program("diagnose", *words, "-o", f"{name}.yaml", "--params-out", f"{name}_extended.yaml")
        return self.yaml(f"{name}.yaml")

    def predicted(self, target: str, process: str, name: str) -> str:
        """Predict what the instrument would show of a target; return the file."""
        self.program("predict", target, "-p", process, "--as-measured", "-o", f"{name}.tif")
        return f"{name}.tif"

    def off(self, reference: str, test: str, *, part: str | None = None) -> float:
        """Return the rmse of a map against another inside the part, its rim left out, µm.

        Parameters
        ----------
        reference, test : str
        part : str, optional
            The target that says where the part is; the reference itself if not given.
        """
        inner = np.isnan(without_rim(self.map(part or reference)).heights_um)
        outside = self.map(part or reference).heights_um <= 0
        first = self.map(reference)
        kept = first.with_heights(np.where(inner | outside, np.nan, first.heights_um))
        return score(kept, self.map(test)).rmse_um


def _words(pairs: Sequence[Pair], option: str = "--pair") -> list[str]:
    return [word for pair in pairs for word in (option, *pair)]


def _called(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "NO_COLOR": "1"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
