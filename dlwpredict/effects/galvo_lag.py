"""Galvo lag: the mirrors follow their command late, and everything trails along the fast axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dlwpredict.effects.base import FocusEffect
from dlwpredict.model.states import Focus
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class GalvoLag(FocusEffect):
    """Every layer is smeared along the writing direction by k(s) = e^(−s/ℓ)/ℓ, s > 0, ℓ = speed · delay.

    The kernel acts on the layers (on the exposure), so that their sum is k ∗ h while walls stay walls: k ∗ h itself,
    taken as a target, would cover the substrate behind each part with an endless thin film.
    """

    name = "galvo-lag"
    meaning = "the scan mirrors follow late: structures trail along the lines (y)"
    frame = "printer"
    source = "NanoWrite/GWL command documents (galvo acceleration); WinetraubLab/myOCT #139, #152 (constant delay)"
    confused_with = ("misregistration", "slope-error")
    separated_by = "the same part printed turned by 90° or with reversed lines, or a series of scan speeds"
    isotropic = False

    lag_um: float = declare(0.0, "µm", 0.0, 3.0, "mean shift along the lines, scan speed times delay", typical=0.3)
    direction: float = declare(1.0, "1", -1, 1, "writing direction, +1 towards +y, -1 towards -y", fitted=False)

    def reshape(self, part: Focus) -> tuple[Focus, ...]:
        """Return the same Gaussian with a tail along the writing direction."""
        return (replace(part, lag_y_um=part.lag_y_um + self.direction * self.lag_um),)
