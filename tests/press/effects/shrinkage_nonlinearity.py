"""Curvature of the shrinkage law: kappa = kappa_min + (kappa_max - kappa_min) u^exponent."""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect


@effect("shrinkage-nonlinearity")
@dataclass(frozen=True)
class ShrinkageNonlinearity(PrintEffect):
    """Exponent without unit, off at 1."""

    exponent: float = 1.0

    def curing(self, share):
        return share if self.exponent == 1 else np.maximum(share, 0) ** np.float32(self.exponent)
