"""Predict a large map tile by tile: on disk, in bounded memory, going on where an interrupted run stopped."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import dlwpredict
from dlwpredict.batch.workers import work
from dlwpredict.errors import InputError
from dlwpredict.files.parameters_yaml import parameters_as_dict
from dlwpredict.files.provenance import sha256
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.exposed_surface import DOSE_LAYER_UM
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import check_target, room_px
from dlwpredict.tiling.expose import Canvas, TileJob, expose
from dlwpredict.tiling.finish import finished
from dlwpredict.tiling.reach import check_tileable, finish_reach_um, halo_um
from dlwpredict.tiling.window import Tile, tiles

WHOLE_PX = 6_000_000
"""A map of more pixels is cut into tiles unless the user says otherwise: the whole takes some 200 bytes per pixel."""

WINDOW_BYTES = 3.0e9
"""What the window of one tile, halo included, may take."""

BYTES_PER_PX = 220
"""What a pixel of a window takes."""

BYTES_PER_LAYER = {"intensity": 6, "factor": 15}
"""What it takes in addition for each layer of 0.2 µm under effects on the local dose, and on the local threshold."""

SMALLEST_TILE_PX, TILE_PX = 256, 2048
"""Sides of tiles: the halo of smaller ones costs too much, that of larger ones hardly less."""

Progress = Callable[[int, int], None]
"""Called with the number of tiles done and of all."""


@dataclass(frozen=True)
class Large:
    """A large target, its process, and how it is cut.

    Parameters
    ----------
    canvas : Canvas
    parameters : ParameterSet
    tile_px : int
        Largest side of a tile.
    as_measured : bool
    threads : int
        Of one tile.
    scheduler : str, optional
        As in `batch.workers.work`.
    on_tile : callable
    """

    canvas: Canvas
    parameters: ParameterSet
    tile_px: int
    as_measured: bool = False
    threads: int = 1
    scheduler: str | None = None
    on_tile: Progress = field(default=lambda done, count: None, repr=False)

    def key(self) -> str:
        """Return what tells apart the tiles of one prediction from those of any other."""
        known = {
            "target": sha256(self.canvas.path),
            "parameters": {**parameters_as_dict(self.parameters), "provenance": None},
            "tile_px": self.tile_px,
            "version": dlwpredict.__version__,
        }
        return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()

    def predict(self, folder: Path, printed: np.ndarray) -> None:
        """Predict every tile and fill in the printed heights, µm.

        Parameters
        ----------
        folder : Path
            Keeps the tiles until the map is whole; what an equal run has left there is used.
        printed : numpy.ndarray, shape (rows, cols)
            To be filled; on disk, say.

        Raises
        ------
        InputError
            The process cannot be cut into tiles, or a tile failed.
        """
        check_tileable(self.parameters, as_measured=self.as_measured)
        opened(folder, self.key())
        canvas, halo = self.canvas, halo_px(self.canvas, halo_um(self.parameters))
        by_maximum = self.parameters.readings.crosslink_reference == "structure_maximum"
        curved = any(step.stage == "crosslink" and not step.off for step in self.parameters.effects)
        jobs = [
            TileJob(canvas, self.parameters, tile, halo, folder, None if by_maximum else 1.0, self.threads)
            for tile in tiles(canvas.shape, self.tile_px)
        ]
        count = len(jobs) * (2 + (by_maximum and curved))
        maximum = self._exposed(jobs, 0, count)
        if by_maximum and curved:
            first = len(jobs)
            normal = folder / "normalised"
            normal.mkdir(exist_ok=True)
            jobs = [replace(job, folder=normal, maximum=maximum) for job in jobs]
            self._exposed(jobs, first, count)
        divisor = maximum if by_maximum and not curved else 1.0
        rim = halo_px(canvas, finish_reach_um(self.parameters, as_measured=self.as_measured))
        for number, job in enumerate(jobs, 1):
            heights = finished(job, jobs, rim, divisor, as_measured=self.as_measured)
            place(printed, heights, job.tile, canvas.room_px)
            self.on_tile(count - len(jobs) + number, count)

    def _exposed(self, jobs: list[TileJob], before: int, count: int) -> float:
        """Let the engine expose all tiles; return the largest cross-linking of all."""
        maxima = []
        for _, outcome in work(expose, jobs, scheduler=self.scheduler):
            if isinstance(outcome, Exception):
                raise outcome
            maxima.append(outcome)
            self.on_tile(before + len(maxima), count)
        return max(maxima) or 1.0


def halo_px(canvas: Canvas, reach_um: tuple[float, float]) -> tuple[int, int]:
    """Return rows and columns of a halo that is wide enough for a reach along y and x."""
    along_y, along_x = reach_um
    return int(np.ceil(along_y / canvas.dy_um)) + 2, int(np.ceil(along_x / canvas.dx_um)) + 2


def place(printed: np.ndarray, heights_um: np.ndarray, tile: Tile, room_px: tuple[int, int]) -> None:
    """Fill in the heights of a tile of the canvas, without the room around the map."""
    (down, across), (rows, cols) = room_px, printed.shape
    inside = Tile(down, down + rows, across, across + cols)
    common = tile.common(inside)
    if min(common.shape) > 0:
        printed[common.within(inside)] = heights_um[common.within(tile)]


def opened(folder: Path, key: str) -> None:
    """Make the folder of the tiles; one that belongs to another prediction is emptied."""
    note = folder / "key"
    if folder.exists() and not (note.exists() and note.read_text(encoding="utf-8") == key):
        shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    note.write_text(key, encoding="utf-8")


def canvas_of(
    path: Path, heights_um: np.ndarray, dx_um: float, dy_um: float, parameters: ParameterSet
) -> tuple[Canvas, float]:
    """Return the canvas of a large target and its highest point, µm, after a look at all its heights.

    Raises
    ------
    InputError
        NaN, infinite or negative heights, or nothing written.
    """
    low, high, missing = np.inf, -np.inf, 0
    for first in range(0, heights_um.shape[0], 256):
        band = np.asarray(heights_um[first : first + 256])
        missing += int(np.isnan(band).sum())
        low, high = np.fmin(low, np.fmin.reduce(band, axis=None)), np.fmax(high, np.fmax.reduce(band, axis=None))
    grid = HeightMap(np.array([[low, high], [high, np.nan if missing else high]]), dx_um, dy_um)
    if missing:
        raise InputError(f"{missing} points without a height", key="heights", allowed="a target must be complete")
    check_target(grid)
    return Canvas(path, heights_um.shape, dx_um, dy_um, room_px(grid, parameters)), float(high)


def tile_side_px(canvas: Canvas, parameters: ParameterSet, highest_um: float) -> int:
    """Return the side of the largest tile whose window stays within `WINDOW_BYTES`, at most `TILE_PX`.

    Raises
    ------
    InputError
        An effect reaches so far that even the smallest tile would take more.
    """
    layers = highest_um / DOSE_LAYER_UM + 10
    on = [effect for effect in parameters.effects if not effect.off]
    layered = sum(cost for what, cost in BYTES_PER_LAYER.items() if any(hasattr(effect, what) for effect in on))
    points = WINDOW_BYTES / (BYTES_PER_PX + layered * layers)
    # (side + 2 a)(side + 2 b) = points
    reach = halo_um(parameters)
    a, b = halo_px(canvas, reach)
    side = int(np.sqrt((a - b) ** 2 + points) - (a + b))
    if side < SMALLEST_TILE_PX:
        raise InputError(
            f"reaches {max(reach):.4g} µm around each point",
            key="effects",
            allowed="too much memory in tiles: a coarser pitch, or --tile-px by hand",
        )
    return min(side, TILE_PX)
