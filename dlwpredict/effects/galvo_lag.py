"""Galvo lag: the mirrors follow their command late, and everything trails along the fast axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects.base import FocusEffect
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Dose, Focus
from dlwpredict.numerics.trailing import lag
from dlwpredict.parameters import declare


def trailing(written: HeightMap, lag_um: float) -> np.ndarray:
    """Return k ∗ h along y, µm, 0 where k ∗ (h > 0) is below ½: the part moves, and walls stay walls.

    k ∗ h alone would cover the substrate behind each part with an endless thin film.
    """
    # rows run downwards, y upwards
    heights, part = lag(np.stack([written.heights_um, written.heights_um > 0]), -lag_um / written.dy_um, axis=-2)
    return np.where(part >= 0.5, np.maximum(heights, 0), 0)


@dataclass(frozen=True)
class GalvoLag(FocusEffect):
    """What is written trails along the writing direction by k(s) = e^(−s/ℓ)/ℓ, s > 0, ℓ = speed · delay.

    Layer by layer it is the dose of every layer that trails: the kernel belongs to the focus. Where the printer follows
    the relief along each line, the heights themselves do, h → k ∗ h. `height_share` of ℓ is the latter's.
    """

    name = "galvo-lag"
    meaning = "the scan mirrors follow late: structures trail along the lines (y)"
    frame = "printer"
    source = "NanoWrite/GWL command documents (galvo acceleration); WinetraubLab/myOCT #139, #152 (constant delay)"
    confused_with = ("misregistration", "slope-error", "line-length-error")
    separated_by = "the same part printed turned by 90° or with reversed lines, or a series of scan speeds"
    isotropic = False

    lag_um: float = declare(0.0, "µm", 0.0, 3.0, "mean shift along the lines, scan speed times delay", typical=0.3)
    height_share: float = declare(0.0, "1", 0.0, 1.0, "share of the lag that is the heights', not the dose's")
    direction: float = declare(1.0, "1", -1, 1, "writing direction, +1 towards +y, -1 towards -y", fitted=False)

    def act(self, state: Dose) -> Dose:
        """Return the dose of what is written late, from a focus that is late."""
        length = self.height_share * self.direction * self.lag_um
        written = state.written.with_heights(trailing(state.written, length)) if length else state.written
        return replace(super().act(state), written=written)

    def reshape(self, part: Focus) -> tuple[Focus, ...]:
        """Return the same Gaussian with a tail along the writing direction."""
        length = (1 - self.height_share) * self.direction * self.lag_um
        return (replace(part, lag_y_um=part.lag_y_um + length),)
