"""Which rows of the stacked residual belong to whom.

Rows of data come first, recording after recording; below them stand one row for every prior of a recording's nuisances,
again recording after recording; last the priors of parameters, one row for each name in `priors.PARAMETERS` whether it
is free or not, so that fits of different models have the same rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Rows:
    """The layout of the rows.

    Parameters
    ----------
    points : tuple of int
        Points of every recording.
    nuisances : tuple of int
        Priors of every recording's nuisances.
    parameters : int
        Priors of parameters.

    Examples
    --------
    >>> rows = Rows((4, 6), (1, 2), 3)
    >>> rows.of(1), rows.nuisance_priors(0), rows.parameter_priors, rows.total
    (slice(4, 10, None), slice(10, 11, None), slice(13, 16, None), 16)
    """

    points: tuple[int, ...]
    nuisances: tuple[int, ...]
    parameters: int

    @cached_property
    def _ends(self) -> np.ndarray:
        return np.cumsum([0, *self.points, *self.nuisances, self.parameters])

    @property
    def recordings(self) -> int:
        """Number of recordings."""
        return len(self.points)

    @property
    def data(self) -> int:
        """Rows of data."""
        return int(self._ends[self.recordings])

    @property
    def total(self) -> int:
        """All rows."""
        return int(self._ends[-1])

    def of(self, k: int) -> slice:
        """Rows of the points of recording k."""
        return slice(int(self._ends[k]), int(self._ends[k + 1]))

    def nuisance_priors(self, k: int) -> slice:
        """Rows of the priors of the nuisances of recording k."""
        return self.of(self.recordings + k)

    @property
    def parameter_priors(self) -> slice:
        """Rows of the priors of parameters."""
        return self.of(2 * self.recordings)

    def stack(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Stack the recordings' rows (points, ...), zeros in all rows of priors."""
        rows = np.concatenate(parts)
        return np.concatenate([rows, np.zeros((self.total - self.data, *rows.shape[1:]), rows.dtype)])

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Return the rows of data of every recording."""
        return [values[self.of(k)] for k in range(self.recordings)]
