"""A weight that differs from layer to layer, convolved along z over a height map, without voxels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.numerics.normal import ndtr
from dlwpredict.numerics.parallel import each

LAYERS_AT_ONCE = 8
"""A weight is evaluated on so many layers together: what lies between then stays in the cache."""


@dataclass(frozen=True, eq=False)
class Layers:
    """A weight w(x, y, z) known at the heights z_j = (first + j) · step.

    Parameters
    ----------
    step_um : float
    weights : numpy.ndarray, shape (layers, rows, cols)
        Single precision: relative errors of 1e-7 are far below a nanometre. (1, rows, cols) where the weight is the
        same at every height, (layers, 1, 1) where it is the same on the whole plane.
    first : int
        Index of the lowest layer; below it the weight goes on as it is there.
    """

    step_um: float
    weights: np.ndarray
    first: int = 0

    @classmethod
    def of(
        cls,
        weight_at: Callable[[np.ndarray], np.ndarray],
        top_um: float,
        step_um: float,
        threads: int,
        bottom_um: float = 0.0,
    ) -> Layers:
        """Evaluate a weight on all layers from the last one at or below the bottom to the top.

        It is asked with heights of shape (n, 1, 1); what it returns is broadcast to (n, rows, cols), and its shape
        says what it depends on.
        """
        first = int(max(bottom_um, 0) / step_um)
        heights = step_um * np.arange(first, max(int(top_um / step_um), first) + 1)[:, None, None]
        parts = [heights[i : i + LAYERS_AT_ONCE] for i in range(0, len(heights), LAYERS_AT_ONCE)]

        def planes(z_um: np.ndarray) -> np.ndarray:
            weight = np.asarray(weight_at(z_um), dtype=np.float32)
            return weight.reshape((1,) * (3 - weight.ndim) + weight.shape)

        lowest = planes(parts[0])
        if len(lowest) == 1:
            return cls(step_um, lowest)
        return cls(step_um, np.concatenate([lowest, *each(planes, parts[1:], threads)]), first)

    @property
    def faces_um(self) -> np.ndarray:
        """Heights of the layers, µm."""
        return self.step_um * (self.first + np.arange(len(self.weights)))

    @property
    def factors(self) -> tuple[np.ndarray, Layers] | None:
        """The weight as a plane times layers that are the same on the whole plane, None where it is no such product."""
        if len(self.weights) == 1:
            return self.weights[0], nominal(self.step_um)
        return (np.ones((1, 1), np.float32), self) if self.weights.shape[1:] == (1, 1) else None

    def __getitem__(self, part: tuple[slice, ...]) -> Layers:
        """Return the layers over a part of the plane."""
        return self if self.weights.shape[1:] == (1, 1) else replace(self, weights=self.weights[:, *part])

    def at(self, index: int) -> np.ndarray:
        """Return the weight at the height index · step, (rows, cols) or (1, 1); the nearest layer's beyond them."""
        return self.weights[np.clip(index - self.first, 0, len(self.weights) - 1)]

    def padded(self, room: list[tuple[int, int]]) -> Layers:
        """Return the layers on a wider plane, with weight 0 on the room added."""
        if self.weights.shape[1:] == (1, 1) or not np.any(room):
            return self
        return replace(self, weights=np.pad(self.weights, [(0, 0), *room]))


def nominal(step_um: float) -> Layers:
    """Return the weight 1."""
    return Layers(step_um, np.ones((1, 1, 1), np.float32))


_NOTHING, _DEEP_UM = 1e-7, 1e3


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
        Whether the solid continues below the lowest layer, with its weight there.
    reduce : function of planes, optional
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
        reduce: Callable[[np.ndarray], np.ndarray] = lambda planes: planes,
    ) -> None:
        weights, step = layers.weights, layers.step_um
        self.from_glass, self.reduce, self.faces_um = from_glass, reduce, layers.faces_um
        self.heights_um, written = heights_um.astype(np.float32), (heights_um > 0).astype(np.float32)
        self.last = np.clip((heights_um / step).astype(int) - layers.first, 0, len(weights) - 1)
        self.at, under = (_of_each_column(weights, index) for index in (self.last, np.maximum(self.last - 1, 0)))
        beyond = (heights_um - self.faces_um[self.last]) / (2 * step)
        self.top = (written * (self.at + (self.at - under) * np.minimum(beyond, 0.5))).astype(np.float32)
        self.foot = reduce(weights[0] * written)
        if from_glass and len(weights) == 1:
            self.faces_um = self.faces_um - _DEEP_UM  # nothing is left to round: exact where the weight is 1
        self.along = weights[:, 0, 0] if weights.shape[1:] == (1, 1) else None
        if self.along is not None:
            self.highest = np.maximum.accumulate(self.along)[self.last] * written
        else:
            highest, self.solid = weights[0] * written, np.empty((len(weights), *self.foot.shape), np.float32)
            for j, plane in enumerate(weights):
                below = plane * (self.last >= j)
                np.maximum(highest, below, out=highest)
                self.solid[j] = reduce(below)
            self.highest = highest * written

    def convolved(self, z_um: Sequence[float] | np.ndarray, sigma_um: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the weighted solid ⊛ g at heights z, shape (heights, rows, cols), each with its own σ.

        Φ((h − z)/σ) for weights of 1, less Φ(−z/σ) without the glass.
        """
        z, sigma = (np.array(values, dtype=np.float32)[:, None] for values in (z_um, sigma_um))
        up_to = ndtr((self.faces_um.astype(np.float32) - z) / sigma)
        half = np.diff(up_to, axis=1) / 2
        below, above = np.pad(half, ((0, 0), (1, 0))), np.pad(half, ((0, 0), (0, 1)))
        result = ndtr((self.heights_um - z[..., None]) / sigma[..., None])
        result -= np.take(up_to, self.last, axis=1)
        result *= self.top
        result -= np.take(above, self.last, axis=1) * self.at
        result = self.reduce(result) + self._faces(below + above)
        if self.from_glass:
            result += up_to[:, :1, None] * self.foot
        return result

    def _faces(self, share: np.ndarray) -> np.ndarray:
        """Return the sum over the faces in each column (heights, rows, cols), given the share (heights, faces) of each.

        A face has half of the layers below and above it.
        """
        if self.along is not None:
            return self.reduce(np.take(np.cumsum(share * self.along, axis=1), self.last, axis=1))
        near = np.flatnonzero(share.max(axis=0) > _NOTHING)
        span = slice(near[0], near[-1] + 1) if len(near) else slice(0)
        return np.tensordot(share[:, span], self.solid[span], axes=1)


def _of_each_column(weights: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the weight of one layer per column, (rows, cols)."""
    return np.take_along_axis(np.broadcast_to(weights, (len(weights), *index.shape)), index[None], axis=0)[0]
