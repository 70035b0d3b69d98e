"""Columns: lines along y that differ from one another as a whole, which no smooth form follows.

Offsets of rows are the instrument's, which scans along x; the lines of a print run along y. What lies along y is in the
noise, so that no name is given for it, but it is no noise: either the print has it, or the instrument scanned that way.
Repeats tell: what differs between them is not the print's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlwpredict.noise.estimate import NoiseEstimate


@dataclass(frozen=True)
class Columns:
    """The columns of the recording that has them most surely.

    Parameters
    ----------
    pair : int
    size_um : float
        Standard deviation from one to the next, µm.
    excess : float
        Gain in 2 ln L, of all recordings that have them.
    p_value : float
        Probability that noise alone has as strong ones in any recording.
    """

    kind: ClassVar[str] = "columns"

    pair: int
    size_um: float
    excess: float
    p_value: float

    @property
    def where(self) -> str:
        """In words: everywhere, but line by line."""
        return "from one line along y to the next"

    @classmethod
    def of(cls, noises: Sequence[NoiseEstimate]) -> Columns:
        """Collect them from the noise of every recording that has no repeats."""
        asked = {k: noise.columns for k, noise in enumerate(noises) if noise.source == "residual"}
        if not asked:
            return cls(0, 0.0, 0.0, 1.0)
        pair = min(asked, key=lambda k: asked[k].p_value)
        best = min(asked[pair].p_value, 1 - 1e-12)
        excess = sum(unevenness.gain for unevenness in asked.values() if unevenness.found)
        return cls(pair, asked[pair].size, excess, float(-np.expm1(len(asked) * np.log1p(-best))))
