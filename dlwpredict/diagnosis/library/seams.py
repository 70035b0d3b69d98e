"""Where a seam may be: the places that explain most of what a fit leaves, one across x and one across y.

A block behind a seam is changed as all of the part would be, so that what stands behind any seam is a sum over pixel
lines: all places are looked at in one pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnosis.library.candidates import NOWHERE, Placed
from dlwpredict.effects.stitching import Stitching, across
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.objective import Fit
from dlwpredict.infer.whitened import gradient

ANGLES_DEG = (0.0, 90.0)
"""Directions across the seams that are looked for: printers move their stage along its axes."""

FINER = 4
"""Places are looked at this many times closer than pixels: one that a seam cuts counts with the part behind it."""

RIM_UM = 3.0
"""A seam nearer to the end of the written part is none that could be told from the part's edge."""

Interval = tuple[int, float, float]


@dataclass(frozen=True)
class Seams:
    """Places of a seam worth trying, and what their choice costs.

    Parameters
    ----------
    settings : tuple of dict
        Place and direction, as parameters of `stitching`; none where no part is wide enough.
    tried : int
        Places that were looked at, a pixel apart.
    """

    settings: tuple[dict[str, float], ...]
    tried: int

    @property
    def price(self) -> float:
        """2 ln L that a seam must gain besides: every place was as likely beforehand."""
        return 2 * float(np.log(max(self.tried, 1)))

    @property
    def placed(self) -> Placed:
        """The places of `stitching`; those of a part too small for any are its own default."""
        return {Stitching.name: self.settings} if self.settings else NOWHERE


def seams(fit: Fit) -> Seams:
    """Find the best places of a seam beside everything that a fit may move, its noise taken as white.

    A seam may raise the block behind it, displace it along x or y, or be a ridge of its own (a strip that was exposed
    twice). At every place the gain is that of all four together.

    Parameters
    ----------
    fit : Fit
        With derivatives, on recordings whose whitening is that of white noise.
    """
    changes = [
        _of_all(item.recording.target, np.nan_to_num(one.heights_um))
        for item, one in zip(fit.data, fit.traces, strict=True)
    ]
    columns = fit.seen_in_all(changes)
    residual, strip_um = fit.beside(fit.residual), Stitching().width_um
    blocks: tuple[Interval, ...] = ((0, 0.0, np.inf), (1, 0.0, np.inf), (2, 0.0, np.inf), (0, -strip_um, strip_um))
    settings, tried = [], 0
    for angle_deg in ANGLES_DEG:
        places = _places(fit, angle_deg)
        if not len(places):
            continue
        raw, gram = np.zeros((len(places), len(blocks))), np.zeros((len(places), len(blocks), len(blocks)))
        common = np.zeros((len(places), len(blocks), fit.tangents.shape[1]))
        for k, item in enumerate(fit.data):
            grid, own = item.recording.target, fit.rows.of(k)
            along = across(grid, angle_deg, 0.0)[item.recording.used]
            change, above = columns[own], fit.nuisances.above[k]
            beyond = _Beyond(along, change, np.column_stack([residual[own], fit.tangents[own], above, change]))
            summed = np.stack([beyond.sums(places, one, None) for one in blocks], axis=1)
            first, last = 1 + common.shape[2], 1 + common.shape[2] + above.shape[1]
            raw, common = raw + summed[:, :, 0], common + summed[:, :, 1:first]
            gram -= np.einsum("sik,sjk->sij", summed[:, :, first:last], summed[:, :, first:last])
            for i, one in enumerate(blocks):
                for j, other in enumerate(blocks):
                    gram[:, i, j] += beyond.sums(places, one, other)[:, last + other[0]]
        gram -= np.einsum("sik,sjk->sij", common, common)
        gains = [float(r @ np.linalg.pinv(g, rcond=1e-6, hermitian=True) @ r) for r, g in zip(raw, gram, strict=True)]
        settings.append({"seam_um": float(places[int(np.argmax(gains))]), "angle_deg": angle_deg})
        tried += len(places) // FINER
    return Seams(tuple(settings), tried)


def _of_all(target: HeightMap, printed_um: np.ndarray) -> np.ndarray:
    """Return what raising all of a part by 1 µm, and displacing it along x and y, changes; shape (3, rows, cols).

    As much higher as the print is of what was to be written there: enough to find a place.
    """
    written = target.heights_um > 0
    share = np.divide(printed_um, target.heights_um, out=np.zeros(target.shape), where=written)
    right, down = gradient(printed_um, target.dx_um, 1), gradient(printed_um, target.dy_um, 0)
    return np.stack([np.clip(share, 0, 1), -right, down])


def _places(fit: Fit, angle_deg: float) -> np.ndarray:
    """Return places that some part lies on both sides of, µm from the maps' centres."""
    targets = [item.recording.target for item in fit.data]
    ends = [_ends(target, angle_deg) for target in targets]
    low, high = min(a for a, _ in ends) + RIM_UM, max(b for _, b in ends) - RIM_UM
    pitch = max(max(target.dx_um, target.dy_um) for target in targets)
    return np.arange(low, high, pitch / FINER) if high > low else np.zeros(0)


def _ends(target: HeightMap, angle_deg: float) -> tuple[float, float]:
    written = across(target, angle_deg, 0.0)[target.heights_um > 0]
    return float(written.min()), float(written.max())


class _Beyond:
    """Sums of products over all points behind a place, for every place at once.

    Parameters
    ----------
    along : numpy.ndarray, shape (points,)
        Where the points lie, µm across the seam.
    first : numpy.ndarray, shape (points, columns)
    second : numpy.ndarray, shape (points, others)
    """

    def __init__(self, along: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
        lines, line = np.unique(np.round(along, 6), return_inverse=True)
        half = np.diff(lines).min(initial=1.0) / 2
        self.edges = np.concatenate([lines[:1] - half, (lines[1:] + lines[:-1]) / 2, lines[-1:] + half])
        sums = np.stack([_of_lines(line, column[:, None] * second) for column in first.T])
        behind = np.flip(np.cumsum(np.flip(sums, 1), axis=1), 1)
        self.behind = np.concatenate([behind, np.zeros_like(behind[:, :1])], axis=1)

    def sums(self, places: np.ndarray, one: Interval, other: Interval | None) -> np.ndarray:
        """Return the sums over the points in one interval about each place, and in another; (places, others)."""
        low, high = max(one[1], other[1] if other else -np.inf), min(one[2], other[2] if other else np.inf)
        found: np.ndarray = self._behind(one[0], places + low) - self._behind(one[0], places + max(low, high))
        return found

    def _behind(self, column: int, places: np.ndarray) -> np.ndarray:
        """Return the sums over what lies behind places; a line that a place cuts counts with the part behind it."""
        at = np.interp(places, self.edges, np.arange(len(self.edges)))
        first = np.minimum(at.astype(int), len(self.edges) - 2)
        share, sums = (at - first)[:, None], self.behind[column]
        found: np.ndarray = (1 - share) * sums[first] + share * sums[first + 1]
        return found


def _of_lines(line: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Return the sums of products (points, columns) over the points of each line, shape (lines, columns)."""
    return np.stack([np.bincount(line, column) for column in products.T], axis=1)
