"""A weight that differs from layer to layer, convolved along z over a height map, without voxels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dlwpredict.parallel import each
from dlwpredict.smoothing import ndtr

_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Layers:
    """A weight w(x, y, z) known at the heights z_j = j · step.

    Parameters
    ----------
    step_um : float
    weights : numpy.ndarray, shape (layers, rows, cols)
        Single precision: relative errors of 1e-7 are far below a nanometre.
    """

    step_um: float
    weights: np.ndarray

    @classmethod
    def of(cls, weight_at: Callable[[float], np.ndarray], top_um: float, step_um: float, threads: int) -> Layers:
        """Evaluate a weight on all layers from 0 to the top."""
        heights = step_um * np.arange(int(top_um / step_um) + 1)
        planes = each(lambda z: np.asarray(weight_at(z), dtype=np.float32), heights, threads)
        return cls(step_um, np.stack(planes))

    def __getitem__(self, part: tuple[slice, slice]) -> Layers:
        """Return the layers over a part of the plane."""
        return Layers(self.step_um, self.weights[:, *part])

    def every(self, step_um: float) -> Layers:
        """Return the weights at other heights, linear in between."""
        place = np.arange(int(self.step_um * (len(self.weights) - 1) / step_um) + 1) * step_um / self.step_um
        below = np.minimum(place.astype(int), len(self.weights) - 2)
        share = (place - below).astype(np.float32)[:, None, None]
        return Layers(step_um, (1 - share) * self.weights[below] + share * self.weights[below + 1])

    def padded(self, room: list[tuple[int, int]]) -> Layers:
        """Return the layers on a wider plane, with weight 0 on the room added."""
        return Layers(self.step_um, np.pad(self.weights, [(0, 0), *room]))


class Columns:
    """The solid under a height map, each layer of it with its weight.

    ∫ w(x, y, z′) [z′ < h] g(z − z′) dz′ with a Gaussian g. Whole layers count with the mean of w at their two faces.
    The last one, cut by the surface, counts with w continued from the two faces below it: what lies above h was
    never written, and w there means nothing. Whole layers may be reduced to a coarser plane beforehand.

    Parameters
    ----------
    layers : Layers
    heights_um : numpy.ndarray, shape (rows, cols)
    from_glass : bool
        Whether the solid continues below z = 0, with its weight at 0.
    reduce : function of a plane, optional
        Linear reduction of the result.

    Attributes
    ----------
    highest : numpy.ndarray, shape (rows, cols)
        Largest weight in each column, 0 where it is empty.
    """

    def __init__(
        self,
        layers: Layers,
        heights_um: np.ndarray,
        *,
        from_glass: bool,
        reduce: Callable[[np.ndarray], np.ndarray] = lambda plane: plane,
    ) -> None:
        weights, step = layers.weights, layers.step_um
        self.heights_um, self.from_glass, self.reduce = heights_um, from_glass, reduce
        self.faces_um = step * np.arange(len(weights))
        self.last = np.clip((heights_um / step).astype(int), 0, len(weights) - 1)
        written = heights_um > 0
        whole = [
            reduce(np.where(heights_um >= z, (below + above) / 2, 0))
            for z, below, above in zip(self.faces_um[1:], weights[:-1], weights[1:], strict=True)
        ]
        self.foot = reduce(np.where(written, weights[0], 0))
        self.whole = np.stack(whole) if whole else np.zeros((0, *self.foot.shape), np.float32)
        at = np.take_along_axis(weights, self.last[None], axis=0)[0]
        under = np.take_along_axis(weights, np.maximum(self.last - 1, 0)[None], axis=0)[0]
        beyond = (heights_um - self.faces_um[self.last]) / (2 * step)
        highest = np.maximum.accumulate(weights, axis=0)
        self.highest = np.where(written, np.take_along_axis(highest, self.last[None], axis=0)[0], 0)
        self.top = np.where(written, at + (at - under) * np.minimum(beyond, 0.5), 0)

    def convolved(self, z_um: float, sigma_um: float) -> np.ndarray:
        """Return the weighted solid ⊛ g at height z; Φ((h − z)/σ) for weights of 1, less Φ(−z/σ) without the glass."""
        up_to = ndtr((self.faces_um - z_um) / sigma_um)
        share = np.diff(up_to)
        near = np.flatnonzero(share > _NOTHING)
        rest = ndtr((self.heights_um - z_um) / sigma_um) - up_to[self.last]
        result = self.reduce(self.top * rest)
        if len(near):
            span = slice(near[0], near[-1] + 1)
            # one pass over few planes: quicker than a matrix product, and it leaves the other cores alone
            result = result + np.einsum("k,kij->ij", share[span].astype(self.whole.dtype), self.whole[span])
        return result + up_to[0] * self.foot if self.from_glass else result
