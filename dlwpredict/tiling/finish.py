"""The second half of a large map: shrink the exposed tiles, then what acts on the surface and in the recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dlwpredict.model.levels import Levels
from dlwpredict.model.states import STAGES, Crosslinked, Dose, Exposed
from dlwpredict.process import run, steps
from dlwpredict.tiling.expose import TileJob
from dlwpredict.tiling.window import Tile


@dataclass(frozen=True, eq=False)
class _Known(Levels):
    """Numerics whose mean cross-linking has been computed already."""

    mean: np.ndarray = field(kw_only=True)

    def column_mean(self, crosslinked: Crosslinked, reference: str) -> np.ndarray:
        """Return the mean that the tiles hold."""
        return self.mean


def finished(
    job: TileJob, others: Iterable[TileJob], halo_px: tuple[int, int], divisor: float, *, as_measured: bool
) -> np.ndarray:
    """Return the printed heights over the tile of a job, or what an instrument would show of them, µm, (rows, cols).

    Parameters
    ----------
    job : TileJob
    others : iterable of TileJob
        All tiles, exposed already.
    halo_px : (int, int)
        How far the effects on surface and recording reach.
    divisor : float
        What the mean of cross-linking is still to be divided by.
    as_measured : bool
    """
    p, canvas = job.parameters, job.canvas
    outer = job.tile.grown(halo_px, canvas.shape)
    surface, mean = _collected(outer, others)
    window = canvas.placed(outer, surface)
    numerics = _Known(mean=mean / divisor)
    state = Crosslinked(
        Exposed(window, Dose(window, (), numerics)), p.paper.crosslink_fwhm_xy_um, p.paper.crosslink_fwhm_z_um
    )
    chain, first = steps(p, numerics, as_measured=as_measured), STAGES.index("height")
    printing = [step for step in chain if STAGES.index(step.stage) >= first and not _sees(step)]
    heights = np.array(run(printing, state).heights_um)
    inside = outer.common(canvas.view)
    if min(inside.shape) > 1:
        seen = run(filter(_sees, chain), canvas.placed(inside, heights[inside.within(outer)]))
        heights[inside.within(outer)] = seen.heights_um
    return heights[job.tile.within(outer)]


def _sees(step: Any) -> bool:
    """Tell whether a step belongs to the instrument, which sees the map without the room around it."""
    return step.stage == "recording"


def _collected(outer: Tile, jobs: Iterable[TileJob]) -> tuple[np.ndarray, np.ndarray]:
    """Return exposed height and mean cross-linking over one tile, from the files of all it touches."""
    surface, mean = np.zeros(outer.shape), np.zeros(outer.shape)
    for job in jobs:
        common = outer.common(job.tile)
        if min(common.shape) > 0:
            with np.load(job.path) as kept:
                surface[common.within(outer)] = kept["surface"][common.within(job.tile)]
                mean[common.within(outer)] = kept["mean"][common.within(job.tile)]
    return surface, mean
