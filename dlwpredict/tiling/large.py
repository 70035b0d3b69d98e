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
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import check_target, room_px
from dlwpredict.tiling.expose import Canvas, TileJob, expose
from dlwpredict.tiling.finish import finished
from dlwpredict.tiling.reach import check_tileable, finish_reach_um, halo_um
from dlwpredict.tiling.window import Tile, tiles

WHOLE_PX = 6_000_000
"""A map of more pixels is cut into tiles unless the user says otherwise: the whole takes some 200 bytes per pixel."""

WINDOW_BYTES = 2.0e9
"""What the window of one tile, halo included, may take."""

BYTES_PER_PX, BYTES_PER_LAYER = 250, 16
"""What a pixel of a window takes, and in addition each layer of 0.2 µm where the dose differs from place to place."""

SMALLEST_TILE_PX = 256

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
    threads: int = 2
    scheduler: str | None = None
    on_tile: Progress = field(default=lambda done, count: None, repr=False)

    def halo_px(self, reach_um: float) -> tuple[int, int]:
        """Return rows and columns of a halo this wide."""
        return tuple(int(np.ceil(reach_um / pitch)) + 2 for pitch in (self.canvas.dy_um, self.canvas.dx_um))

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
        halo = self.halo_px(halo_um(self.parameters))
        canvas, own = self.canvas, self.parameters.readings.crosslink_reference == "structure_maximum"
        curved = any(step.stage == "crosslink" and not step.off for step in self.parameters.effects)
        jobs = [
            TileJob(canvas, self.parameters, tile, halo, folder, None if own else 1.0, self.threads)
            for tile in tiles(canvas.shape, self.tile_px)
        ]
        count = len(jobs) * (2 + (own and curved))
        maximum = self._exposed(jobs, 0, count)
        if own and curved:
            first = len(jobs)
            normal = folder / "normalised"
            normal.mkdir(exist_ok=True)
            jobs = [replace(job, folder=normal, maximum=maximum) for job in jobs]
            self._exposed(jobs, first, count)
        divisor = maximum if own and not curved else 1.0
        rim = self.halo_px(finish_reach_um(self.parameters, as_measured=self.as_measured))
        for number, job in enumerate(jobs, 1):
            heights = finished(job, jobs, rim, divisor, as_measured=self.as_measured)
            place(printed, heights, job.tile, canvas.room_px)
            self.on_tile(count - len(jobs) + number, count)

    def _exposed(self, jobs: list[TileJob], before: int, count: int) -> float:
        """Let the engine expose all tiles; return the largest cross-linking of all."""
        maxima = []
        for _, found in work(expose, jobs, scheduler=self.scheduler):
            if isinstance(found, Exception):
                raise found
            maxima.append(found)
            self.on_tile(before + len(maxima), count)
        return max(maxima) or 1.0


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
    grid = HeightMap([[low, high], [high, np.nan if missing else high]], dx_um, dy_um)
    if missing:
        raise InputError(f"{missing} points without a height", key="heights", allowed="a target must be complete")
    check_target(grid)
    return Canvas(path, heights_um.shape, dx_um, dy_um, tuple(room_px(grid, parameters))), float(high)


def tile_side_px(canvas: Canvas, parameters: ParameterSet, highest_um: float) -> int:
    """Return the side of the largest tile whose window stays within `WINDOW_BYTES`.

    Raises
    ------
    InputError
        An effect reaches so far that even the smallest tile would take more.
    """
    reach = halo_um(parameters)
    layered = any(e.stage == "dose" and not e.off for e in parameters.effects)
    per_px = BYTES_PER_PX + layered * BYTES_PER_LAYER * (highest_um / 0.2 + 10)
    halo = [2 * (reach / pitch + 3) for pitch in (canvas.dy_um, canvas.dx_um)]
    room = WINDOW_BYTES / per_px
    # (side + a)(side + b) = room
    half = (halo[0] + halo[1]) / 2
    side = int(np.sqrt(max(half**2 - halo[0] * halo[1] + room, 0)) - half)
    if side < SMALLEST_TILE_PX:
        raise InputError(
            f"reaches {reach:.4g} µm around each point", key="effects", allowed="too far for tiles: --tile-px by hand"
        )
    return side
