"""One tile: expose, threshold and cross-link a window, keep its inner part in a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dlwpredict.errors import ResultError
from dlwpredict.files.atomic import replacing
from dlwpredict.files.mapped_tiff import mapped
from dlwpredict.model.levels import Levels
from dlwpredict.model.states import STAGES, Crosslinked
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import run, steps
from dlwpredict.tiling.reach import coarse_px
from dlwpredict.tiling.window import Tile, Window


@dataclass(frozen=True)
class Canvas:
    """A large target with room of empty resin around it, on disk.

    Parameters
    ----------
    path : Path
        The target's TIFF, or its heights as .npy.
    target_shape : (int, int)
    dx_um, dy_um : float
    room_px : (int, int)
        Rows and columns of room on every side.
    """

    path: Path
    target_shape: tuple[int, int]
    dx_um: float
    dy_um: float
    room_px: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns with the room."""
        (rows, cols), (above, beside) = self.target_shape, self.room_px
        return rows + 2 * above, cols + 2 * beside

    @property
    def view(self) -> Tile:
        """Where the target lies on the canvas."""
        (down, across), (rows, cols) = self.room_px, self.target_shape
        return Tile(down, down + rows, across, across + cols)

    def heights(self) -> np.ndarray:
        """Return the target's heights, µm, on disk."""
        if self.path.suffix == ".npy":
            return np.load(self.path, mmap_mode="r")
        source = mapped(self.path)
        if source is None or source.heights_um.shape != self.target_shape:
            raise ResultError("changed while it was predicted", where=self.path)
        return source.heights_um

    def window(self, tile: Tile) -> Window:
        """Read one tile of the canvas."""
        common = tile.common(self.view)
        heights = np.zeros(tile.shape)
        heights[common.within(tile)] = self.heights()[common.within(self.view)]
        return self.placed(tile, heights)

    def placed(self, tile: Tile, heights_um: np.ndarray) -> Window:
        """Return heights over one tile as a window into the canvas."""
        return tile.window(heights_um, self.dx_um, self.dy_um, self.shape)


@dataclass(frozen=True)
class TileJob:
    """What a worker needs to know to compute one tile.

    Parameters
    ----------
    canvas : Canvas
    parameters : ParameterSet
    tile : Tile
    halo_px : (int, int)
    folder : Path
        Where the result is kept.
    maximum : float, optional
        What cross-linking is divided by before any curve is applied to it. None where that is not known yet: then no
        curve is applied, and the largest in this window is found.
    threads : int
    """

    canvas: Canvas
    parameters: ParameterSet
    tile: Tile
    halo_px: tuple[int, int]
    folder: Path
    maximum: float | None = None
    threads: int = 1

    @property
    def path(self) -> Path:
        """The file of the result."""
        return self.folder / f"{self.tile.first_row}-{self.tile.first_col}.npz"


@dataclass(frozen=True, eq=False)
class Exposure:
    """A tile after exposure and cross-linking.

    Parameters
    ----------
    surface_um, mean : numpy.ndarray, shape (rows, cols), single precision
        Exposed height, and the mean of cross-linking over it.
    maximum : float
        Largest cross-linking in the tile's window, not above that of the whole structure; 0 in an empty one.
    """

    surface_um: np.ndarray
    mean: np.ndarray
    maximum: float


def expose(job: TileJob) -> float:
    """Compute one tile unless its file is there already, and return its maximum of cross-linking."""
    if job.path.exists():
        with np.load(job.path) as kept:
            return float(kept["maximum"])
    exposure = exposure_of(job)
    with replacing(job.path) as temporary, temporary.open("wb") as file:
        np.savez(file, surface=exposure.surface_um, mean=exposure.mean, maximum=exposure.maximum)
    return exposure.maximum


def exposure_of(job: TileJob) -> Exposure:
    """Compute one tile."""
    grid_px = coarse_px(job.parameters, job.canvas.dx_um, job.canvas.dy_um)
    outer = job.tile.grown(job.halo_px, job.canvas.shape, grid_px)
    inner = job.tile.within(outer)
    target = job.canvas.window(outer)
    if not target.heights_um.any():
        empty = np.zeros(job.tile.shape, np.float32)
        return Exposure(empty, empty, 0.0)
    numerics = Levels(job.threads)
    last = STAGES.index("crosslink")
    chain = [step for step in steps(job.parameters, numerics) if STAGES.index(step.stage) <= last]
    state: Crosslinked = run(chain, target)
    if job.maximum is None:
        state = replace(state, curves=())
    elif state.curves:
        state = replace(state, curves=(lambda m_cl: m_cl / job.maximum, *state.curves))
    mean = numerics.column_mean(state, "bulk")
    surface = state.exposed.surface.heights_um
    maximum = _largest(numerics, state, mean) if job.maximum is None else job.maximum
    return Exposure(surface[inner].astype(np.float32), mean[inner].astype(np.float32), maximum)


def _largest(numerics: Levels, state: Crosslinked, mean: np.ndarray) -> float:
    """Return the largest cross-linking in a window: by how much its own normalisation enlarges the mean.

    At its cut edges a window lacks its neighbours, which only lowers cross-linking there: over all windows the largest
    is that of the whole structure.
    """
    normalised = numerics.column_mean(state, "structure_maximum")
    place = np.unravel_index(np.argmax(normalised), normalised.shape)
    return float(mean[place] / normalised[place]) if normalised[place] > 0 else 0.0
