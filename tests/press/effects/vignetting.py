"""Vignetting: the focus is weaker away from the field centre.

literal: D = 1 - strength rho^2, rho the distance to the centre / 50 um.
pupil:   a Gaussian beam (1/e amplitude radius `fill` times the pupil's) walks over the pupil in proportion to rho;
         D = (amplitude that passes)^2 relative to the centre, with D = 1 - strength at rho = 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from tests.press.effect import PrintEffect, effect

WEAKEST = 0.05


@effect("vignetting")
@dataclass(frozen=True)
class Vignetting(PrintEffect):
    """Strength without unit at 50 um; centre in um."""

    models = ("literal", "pupil")
    strength: float = 0.0
    centre_x_um: float = 0.0
    centre_y_um: float = 0.0
    conversion: float | None = None
    model: str = "literal"
    fill: float = 0.8

    def dose(self, scene):
        radius = scene.grid.radius(self.centre_x_um, self.centre_y_um)
        if self.model == "pupil" and self.strength > 0:
            return through_pupil(radius, self.strength, self.fill)[None]
        return np.maximum(1 - self.strength * radius**2, WEAKEST)[None]


def passed(walk, fill, count=161):
    """Return the focal intensity, relative to the centre, of a beam that has walked `walk` pupil radii."""
    u = np.linspace(-1, 1, count)
    pupil = np.clip((1 - np.hypot(u[None, :], u[:, None])) * count / 2 + 0.5, 0, 1)
    amplitude = [np.exp(-((u[None, :] - off) ** 2 + u[:, None] ** 2) / fill**2) for off in (walk, 0.0)]
    return float(((amplitude[0] * pupil).sum() / (amplitude[1] * pupil).sum()) ** 2)


def through_pupil(radius, strength, fill):
    """Return D at a radius in units of 50 um."""
    walk = brentq(lambda value: passed(value, fill) - (1 - min(strength, 0.9)), 0, 3)
    nodes = np.linspace(0, max(radius.max(), 1e-6), 60)
    return np.maximum(np.interp(radius, nodes, [passed(walk * node, fill) for node in nodes]), WEAKEST)
