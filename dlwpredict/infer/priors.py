"""What is known of parameters and nuisances before anything is measured: each carries its own prior.

Priors are normal, of the value or of its logarithm. In the objective a prior is one more row, (mean − value)/sd.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dlwpredict.effects import library
from dlwpredict.infer.free import Free
from dlwpredict.parameters import Paper, declarations

FREE = np.inf
"""Standard deviation of a nuisance of which nothing is known."""

CERTIFIED = 2e-3
"""What the certificate of an instrument's pixel pitch leaves open."""

NUISANCES: dict[str, float] = {
    "offset": FREE,
    "tilt_x": FREE,
    "tilt_y": FREE,
    "shift_x": 1.0,  # µm: no recording has a place of its own, and an alignment lays a lag on its mean
    "shift_y": 1.0,
    "rotation": float(np.deg2rad(0.1)),  # rad that an alignment leaves
    "scale_x": CERTIFIED,
    "scale_y": CERTIFIED,
    "shear": 2e-3,
}
"""Standard deviations of a recording's nuisances about 0. Offset and tilts are µm at half the map's size."""

LEVELLING = ("offset", "tilt_x", "tilt_y")
LATERAL = ("shift_x", "shift_y", "rotation", "scale_x", "scale_y", "shear")
SHIFTS = ("shift_x", "shift_y")
SCALES = ("scale_x", "scale_y")

WIDTH_SD = 0.4
"""Standard deviation of the logarithm of the paper's FWHMs about the paper's values. Without it a missing dome or edge
drives the axial FWHM of the focus to 10 µm, where signatures are no longer those of the process."""

LENGTH_SD = float(np.log(2.0))
"""The same of an effect's lengths about their defaults: they are known to a factor of two or so."""

CENTRE_SD_UM = 15.0
"""Standard deviation of the centre of a printer's or an instrument's field."""


@dataclass(frozen=True)
class Prior:
    """A normal prior of a value, or of its logarithm.

    Parameters
    ----------
    mean, sd : float
    logarithm : bool

    Examples
    --------
    >>> Prior(2.0, 0.5, logarithm=True).row(2 * np.exp(0.5))
    (-1.0, 0.6065306597126334)
    """

    mean: float
    sd: float
    logarithm: bool = False

    def row(self, value: float) -> tuple[float, float]:
        """Return (mean − value)/sd and minus its derivative by the value."""
        if self.logarithm:
            return float(np.log(self.mean / value) / self.sd), float(1 / (value * self.sd))
        return (self.mean - value) / self.sd, 1 / self.sd

    def sd_at(self, value: float) -> float:
        """Return the standard deviation of the value itself, about this one."""
        return self.sd * value if self.logarithm else self.sd


def _of_shape(kind: Any, name: str, default: float) -> Prior | None:
    """Return the prior of a parameter of an effect; None where only its range is known."""
    declared = declarations(kind)[name][1]
    if name in kind.switches() or not declared.fitted:
        return None
    if name.startswith("centre_"):
        return Prior(default, CENTRE_SD_UM)
    return Prior(default, LENGTH_SD, logarithm=True) if declared.unit == "µm" and declared.low > 0 else None


def _declared() -> dict[str, Prior]:
    """Return the priors of all parameters that have one, by flat name."""
    known = {
        name: Prior(default, WIDTH_SD, logarithm=True)
        for name, (default, _) in declarations(Paper).items()
        if "fwhm" in name
    }
    for effect, kind in library().items():
        for name, (default, _) in declarations(kind).items():
            if (prior := _of_shape(kind, name, default)) is not None:
                known[f"{effect}.{name}"] = prior
    return known


PARAMETERS = _declared()
"""Priors of parameters, by flat name; every one has a row of its own in every fit."""

PLACE = {name: row for row, name in enumerate(PARAMETERS)}


def rows(free: Free, vector: np.ndarray, known: Mapping[str, Prior]) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the parameters' priors: residuals (priors,), derivatives (priors, free parameters).

    What is not free has no say.

    Parameters
    ----------
    free : Free
    vector : numpy.ndarray, shape (free parameters,)
    known : mapping of str to Prior
        Those that apply, by name; none for a bare fit.
    """
    residual, derivative = np.zeros(len(PLACE)), np.zeros((len(PLACE), len(free.names)))
    for k, name in enumerate(free.names):
        if name in known:
            residual[PLACE[name]], derivative[PLACE[name], k] = known[name].row(vector[k])
    return residual, derivative


def bounded(names: Sequence[str]) -> list[int]:
    """Return the places of those nuisances that have a prior."""
    return [k for k, name in enumerate(names) if np.isfinite(NUISANCES[name])]
