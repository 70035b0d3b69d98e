"""Shrinkage nonlinearity: shrinkage does not follow cross-linking in a straight line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import CurveEffect
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class ShrinkageNonlinearity(CurveEffect):
    """κ = κ_min + (κ_max − κ_min) · u^exponent, u the normalised cross-linking of Eq. 3 (0–1)."""

    name = "shrinkage-nonlinearity"
    meaning = "shrinkage is not a straight line of cross-linking: low, thin and outer parts deviate together"
    frame = "sample"
    source = "conversion against power is curved: J. Opt. Microsyst. 2(3), 033501; Jiang et al. 2014"
    confused_with = ("z-linearity", "z-drift")
    separated_by = "features of 2 to 20 µm height in one fit, or a power series"

    exponent: float = declare(
        1.0, "1", 0.3, 3.0, "exponent of the normalised cross-linking; 1 = straight line", typical=1.5
    )

    def curve(self, crosslinking: np.ndarray) -> np.ndarray:
        """Return u^exponent."""
        return crosslinking**self.exponent
