"""What lies beyond the map: empty resin; or more of the same part, where the map is cut out of a larger one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import ParameterSet

REACH_SIGMAS = 3.0
"""Standard deviations of focus and cross-linking together over which the part goes on: 0.1 % lie beyond."""


def touches_edge(target: HeightMap) -> bool:
    """Tell whether anything is written in the outermost rows or columns.

    Examples
    --------
    >>> touches_edge(HeightMap([[0, 0, 0], [0, 1, 0], [0, 0, 0]], 1, 1)), touches_edge(HeightMap([[0, 1]] * 2, 1, 1))
    (False, True)
    """
    h = target.heights_um
    return bool(max(h[0].max(), h[-1].max(), h[:, 0].max(), h[:, -1].max()) > 0)


def doubt_of_edges(target: HeightMap) -> list[str]:
    """Return a warning where a part touches the edge of its map: nobody has said what lies beyond."""
    if not touches_edge(target):
        return []
    return [
        "the part touches the edge of the map and is taken to end there: add a margin, or say --surround continued "
        "if it goes on, --surround empty if not"
    ]


@dataclass(frozen=True, eq=False)
class Continued:
    """A map that goes on beyond its edges as its mirror image, as far as focus and cross-linking reach.

    Parameters
    ----------
    whole : HeightMap
    room : tuple of int
        Rows and columns that were added on each side.
    """

    whole: HeightMap
    room: tuple[int, int]

    @classmethod
    def of(cls, target: HeightMap, parameters: ParameterSet, *, continued: bool = True) -> Continued:
        """Continue a target, or leave it as it is.

        Examples
        --------
        >>> Continued.of(HeightMap([[1.0, 2.0], [3.0, 4.0]], 5.0, 9.0), ParameterSet()).whole.heights_um[:, 0].tolist()
        [2.0, 2.0, 4.0, 4.0]
        """
        if not continued:
            return cls(target, (0, 0))
        paper = parameters.paper
        reach = REACH_SIGMAS * np.hypot(paper.exposure_fwhm_xy_um, paper.crosslink_fwhm_xy_um) / FWHM_PER_SIGMA
        room = int(np.ceil(reach / target.dy_um)), int(np.ceil(reach / target.dx_um))
        return cls(target.with_heights(np.pad(target.heights_um, [(r, r) for r in room], mode="symmetric")), room)

    def in_view(self, shown: HeightMap) -> HeightMap:
        """Return the part of a map of the whole that the target covers."""
        return shown.with_heights(self.cut(shown.heights_um))

    def cut(self, values: np.ndarray) -> np.ndarray:
        """Return values of the whole (rows, cols) where the target is."""
        rows, cols = (slice(r, n - r) for r, n in zip(self.room, values.shape, strict=True))
        return values[rows, cols]
