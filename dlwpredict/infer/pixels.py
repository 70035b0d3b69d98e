"""Pixels: on which a recording is worked."""

from __future__ import annotations

import numpy as np

from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import ParameterSet, declarations

LOST = 0.2
"""Share of the information about the finest structure of a print that working pixels may lose."""

PER_LENGTH = 3.0
"""Working pixels to the shortest length at which an effect of the library is looked for."""


def working_factor(target: HeightMap, parameters: ParameterSet, pitch_um: float | None = None) -> int:
    """Return how many native pixels along each axis make a working one.

    A print holds nothing finer than the focus, of standard deviation σ. A mean over p keeps sinc²(kp/2) ≈ 1 − k²p²/12
    of the energy of a wave k. The derivatives of an edge by the focus's width have ⟨k²⟩ = 1/σ², so that under white
    noise p²/(12σ²) of what is known of them is lost; where the noise is correlated, less. The widest pixels that lose
    no more than `LOST` are taken, unless an effect of the library has a shorter length of its own.

    Parameters
    ----------
    target : HeightMap
    parameters : ParameterSet
        Its focus is the one that is expected.
    pitch_um : float, optional
        Asked for by the user.

    Examples
    --------
    >>> afm = HeightMap(np.ones((9, 9)), 0.1, 0.1)
    >>> working_factor(afm, ParameterSet()), working_factor(afm, ParameterSet(), 0.2)
    (3, 2)
    """
    native = max(target.dx_um, target.dy_um)
    if pitch_um is not None:
        return max(round(pitch_um / native), 1)
    sigma = parameters.paper.exposure_fwhm_xy_um / FWHM_PER_SIGMA
    return max(int(min(sigma * np.sqrt(12 * LOST), shortest_um() / PER_LENGTH) / native + 1e-9), 1)


def shortest_um() -> float:
    """Return the shortest default of a length of the library's effects, µm."""
    lengths = [
        default
        for kind in library().values()
        for name, (default, declared) in declarations(kind).items()
        if declared.unit == "µm" and declared.low > 0 and name not in kind.switches()
    ]
    return min(lengths)
