"""What noise alone looks like in whitened space, the noise model's own uncertainty included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlwpredict.infer.objective import Fit
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.sandwich import sandwich
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.estimate import NoiseEstimate
from dlwpredict.numerics.parallel import ALONE, Workers

DRAWS = 200
"""Maps of noise of every recording."""

COHERENT_UM = 4e-4
"""Standard deviation of the part that two honest computations of the same physics differ by along any one signature,
root mean square over the map. An average over ten thousand pixels would see it; no effect is named for it. (Voxels of
a quarter of the focus against finer ones, and against this program's levels: 0.1 to 0.6 nm beside what a fit moves.)"""


@dataclass(frozen=True, eq=False)
class Null:
    """Draws of noise.

    Parameters
    ----------
    draws : numpy.ndarray, shape (rows, draws)
        Noise maps of every recording, drawn with noise models that the data allow, whitened with the estimated one.
    """

    draws: np.ndarray

    @classmethod
    def of(
        cls,
        data: Sequence[Whitened],
        rows: Rows,
        noises: Sequence[NoiseEstimate],
        seed: int,
        *,
        draws: int = DRAWS,
        workers: Workers = ALONE,
    ) -> Null:
        """Draw the null."""
        jobs = [(item, noise, (seed, k), draws) for k, (item, noise) in enumerate(zip(data, noises, strict=True))]
        return cls(rows.stack(workers.each(_drawn, jobs)))

    def along(self, columns: np.ndarray) -> np.ndarray:
        """Return the null's components along orthonormal or unit columns, shape (columns, draws)."""
        return columns.T.astype(np.float32) @ self.draws

    def beside(self, fitted: Fit) -> np.ndarray:
        """Return the draws without what a fit may move, shape (rows, draws)."""
        return fitted.beside(self.draws)

    def spread(self, fitted: Fit, unit: np.ndarray) -> np.ndarray:
        """Return the standard deviation of noise and numerical differences along columns of length 1 (or 0)."""
        return np.hypot(self.along(unit).std(axis=1), numerical(fitted, unit))

    def shown(self, fitted: Fit, unit: np.ndarray) -> np.ndarray:
        """Return the variance along columns of length 1: the noise's, or the residual's own where that is larger."""
        return np.maximum(self.along(unit).var(axis=1), sandwich(fitted, unit))


def numerical(fitted: Fit, unit: np.ndarray) -> np.ndarray:
    """Return the component that numerical differences give along whitened columns of length 1 (or 0: none).

    A difference c·m of the shape m of a column, its rows of data d unwhitened, has the component c·|d|² along it.
    """
    parts = fitted.rows.split(unit)
    square = sum(np.sum(item.whitener.solve(part) ** 2, axis=0) for item, part in zip(fitted.data, parts, strict=True))
    height_um, own = np.sqrt(square / fitted.rows.data), np.sum(unit[: fitted.rows.data] ** 2, axis=0)
    return np.divide(COHERENT_UM * own, height_um, out=np.zeros_like(height_um), where=height_um > 0)


def _drawn(item: Whitened, noise: NoiseEstimate, seed: Sequence[int], draws: int) -> np.ndarray:
    rng, used = np.random.default_rng(seed), item.recording.used
    maps = np.stack([noise.draw(rng).simulate(used.shape, rng, item.slope)[used] for _ in range(draws)], axis=1)
    return (item.whitener @ maps).astype(np.float32)
