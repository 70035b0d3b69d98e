"""Astigmatism: the focus is wider along one lateral direction than along the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects.base import FocusEffect
from dlwpredict.model.states import Focus
from dlwpredict.parameters import declare


@dataclass(frozen=True)
class Astigmatism(FocusEffect):
    """FWHM · e^(+q) along the first principal axis, · e^(−q) along the second, turned by an angle from x."""

    name = "astigmatism"
    meaning = "the focus is wider along one lateral direction: fine ridges along x and y print differently high"
    frame = "printer"
    source = "aberrations of real foci (Hering 2016, cited in Lang 2022); form is ours"
    confused_with = ("instrument-blur", "galvo-lag")
    separated_by = "the sample turned by 90° under the microscope (does the effect turn with it?), seen on a chirp"
    isotropic = False

    log_ratio: float = declare(
        0.0, "1", -0.5, 0.5, "q, natural logarithm of the widening along the first axis", typical=0.15
    )
    angle_deg: float = declare(0.0, "°", 0, 90, "direction of the first axis, counter-clockwise from x")

    def elsewhere(self) -> Astigmatism:
        """Exchange the axes where the angle is at an end of its range."""
        ends = 0.0, 90.0
        if self.angle_deg not in ends:
            return self
        return replace(self, log_ratio=-self.log_ratio, angle_deg=sum(ends) - self.angle_deg)

    def reshape(self, part: Focus) -> tuple[Focus, ...]:
        """Return the stretched focus; the paper's is round, so its own angle does not matter."""
        wider = float(np.exp(self.log_ratio))
        return (
            replace(
                part,
                fwhm_x_um=part.fwhm_x_um * wider,
                fwhm_y_um=part.fwhm_y_um / wider,
                angle_deg=self.angle_deg,
            ),
        )
