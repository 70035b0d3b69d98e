"""Whether recordings lie where their alignment says: what registration came out as, and what an alignment leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from dlwpredict.effects import library
from dlwpredict.infer.objective import Fit
from dlwpredict.infer.priors import LATERAL
from dlwpredict.parameters import declarations

PARAMETERS = {
    "shift_x": ("shift_x_um", 1.0),
    "shift_y": ("shift_y_um", 1.0),
    "rotation": ("rotation_deg", float(np.rad2deg(1))),
    "scale_x": ("scale_x", 1.0),
    "scale_y": ("scale_y", 1.0),
    "shear": ("shear_mrad", 1e3),
}
"""Of every lateral nuisance: the parameter of `misregistration` that it is, and how much of that is one of it."""


@dataclass(frozen=True)
class Registration:
    """How a recording lies on its target, in the terms of the effect `misregistration`.

    Parameters
    ----------
    pair : int
    moved : dict
        Lateral nuisance to what it came out as: shifts in µm, rotation and shear in rad, scales as shares.
    left_open : dict
        Nuisance to the standard deviation of what the alignment leaves of it.
    """

    pair: int
    moved: dict[str, float]
    left_open: dict[str, float]

    @property
    def far(self) -> dict[str, float]:
        """Every nuisance in standard deviations of what an alignment leaves of it."""
        return {name: abs(value) / self.left_open[name] for name, value in self.moved.items()}

    @property
    def p_value(self) -> float:
        """Probability that an alignment leaves any of them so far: two-sided, normal, for all that are free."""
        return float(min(len(self.moved) * special.erfc(max(self.far.values()) / np.sqrt(2)), 1.0))

    @property
    def settings(self) -> dict[str, float]:
        """The parameters of `misregistration` that would move a recording so, in its units."""
        declared = declarations(library()["misregistration"])
        some = [(*PARAMETERS[name], value) for name, value in self.moved.items()]
        return {name: declared[name][0] + per_one * value for name, per_one, value in some}

    @property
    def farthest(self) -> str:
        """The nuisance that lies farthest."""
        return max(self.far, key=lambda name: self.far[name])


def registrations(fit: Fit) -> list[Registration]:
    """Return how the recordings of a fit lie; those whose place is taken at its word are not among them."""
    found = []
    for pair, (item, left) in enumerate(zip(fit.data, fit.coefficients, strict=True)):
        values = dict(zip(item.nuisances, item.known() + left, strict=True))
        moved = {name: float(values[name]) for name in LATERAL if name in values}
        left_open = dict(zip(item.nuisances, item.recording.left_open.tolist(), strict=True))
        found += [Registration(pair, moved, left_open)] if moved else []
    return found


def chance_of(some: Sequence[Registration]) -> tuple[Registration, float]:
    """Return the one of several that is least likely, and the probability that alignments leave any one of them so."""
    worst = min(some, key=lambda one: one.p_value)
    return worst, min(len(some) * worst.p_value, 1.0)
