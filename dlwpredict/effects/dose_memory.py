"""Dose memory: the lines just written leave resin that reacts more easily to the next ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.effects.plane import occupied
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.trailing import trailing_mean
from dlwpredict.parameters import declare


def written_before(on: np.ndarray, dx_um: float, length_um: float, direction: float) -> np.ndarray:
    """Return the one-sided exponential mean of the layer along the hatch direction, 0–1, same shape.

    m(x) = (1/L) ∫₀^∞ e^(−s/L) occ(x − s) ds: oxygen used up, radicals and heat left by the neighbouring lines of the
    same layer. Far inside a wide part m = 1 (a plateau after about 3 L). Waller & von Freymann, Polymers 8, 297 (2016).

    Parameters
    ----------
    on : numpy.ndarray, shape (..., rows, cols)
        1 where this layer is written.
    dx_um, length_um : float
        Pitch, and memory length L, µm.
    direction : float
        +1: the hatch runs towards +x.
    """
    step = int(direction)
    return trailing_mean(on[..., ::step], length_um / dx_um, axis=-1)[..., ::step]


@dataclass(frozen=True)
class DoseMemory(DoseEffect):
    """D = 1 + gain · (what was written just before, along the hatch)."""

    name = "dose-memory"
    meaning = "lines written just before raise the dose of the next ones: a ramp along the hatch (x)"
    frame = "printer"
    source = "Waller & von Freymann, Polymers 8, 297 (2016), proximity in space and time"
    confused_with = ("substrate-tilt", "field-curvature", "line-end-pileup")
    separated_by = "the same part printed with the hatch mirrored or turned by 90°, or a gap-and-resume structure"
    isotropic = False

    gain: float = declare(0.0, "1", 0.0, 0.5, "additional intensity after a long way of writing", typical=0.1)
    length_um: float = declare(8.0, "µm", 0.5, 50, "distance over which the memory fades")
    direction: float = declare(1.0, "1", -1, 1, "hatch direction, +1 towards +x, -1 towards -x", fitted=False)

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D while the layer at height z is written."""
        on = occupied(written, z_um)
        return 1 + self.gain * written_before(on, written.dx_um, self.length_um, self.direction)
