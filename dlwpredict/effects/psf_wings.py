"""PSF wings: the real focus has longer tails than a Gaussian."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dlwpredict.effects.base import FocusEffect
from dlwpredict.model.states import Focus
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class PsfWings(FocusEffect):
    """Focus = (1 − weight) · G(σ) + weight · G(ratio · σ), the same ratio along all axes."""

    name = "psf-wings"
    meaning = "the focus has longer tails than a Gaussian: narrow grooves fill up, edges get a foot"
    frame = "printer"
    source = "Lang 2022 (the Gaussian is a stand-in for the focus); form of the tails is ours"
    confused_with = ("edge-inhibition", "dose-proximity")
    separated_by = "a chirp with periods below 2 µm, and step edges"

    weight: float = declare(0.0, "1", 0.0, 0.5, "share of the focus that lies in the wings", typical=0.1)
    width_ratio: float = declare(3.0, "1", 1.0, 10, "width of the wings over that of the core", fitted=False)

    def reshape(self, part: Focus) -> tuple[Focus, ...]:
        """Return core and wings."""
        wings = replace(
            part,
            weight=part.weight * self.weight,
            fwhm_x_um=part.fwhm_x_um * self.width_ratio,
            fwhm_y_um=part.fwhm_y_um * self.width_ratio,
            fwhm_z_um=part.fwhm_z_um * self.width_ratio,
        )
        return replace(part, weight=part.weight * (1 - self.weight)), wings
