"""Pixels: on which a recording is worked."""

from __future__ import annotations

import numpy as np

from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import ParameterSet, declarations

FINE, COARSE = (0.2, 3.0), (0.5, 2.0)
"""Share of the information about the finest structure of a print that working pixels may lose, and how many of them
there are to the shortest length at which an effect of the library is looked for: as a rule, and of a large map."""

LARGE = 40_000
"""Points of a large map: it tells more of all that is wider, and the time that an answer takes grows with them."""


def working_factor(
    target: HeightMap, parameters: ParameterSet, pitch_um: float | None = None, large_px: float = LARGE
) -> int:
    """Return how many native pixels along each axis make a working one.

    A print holds nothing finer than the focus, of standard deviation σ. A mean over p keeps sinc²(kp/2) ≈ 1 − k²p²/12
    of the energy of a wave k. The derivatives of an edge by the focus's width have ⟨k²⟩ = 1/σ², so that under white
    noise p²/(12σ²) of what is known of them is lost; where the noise is correlated, less. The widest pixels that lose
    no more than a fifth are taken, unless an effect of the library has a shorter length of its own. Where these are
    still too many, wider ones are, that lose no more than half.

    Parameters
    ----------
    target : HeightMap
    parameters : ParameterSet
        Its focus is the one that is expected.
    pitch_um : float, optional
        Asked for by the user.
    large_px : float
        Pixels that are too many; inf where none are.

    Examples
    --------
    >>> afm, wide = (HeightMap(np.ones((n, n)), 0.1, 0.1) for n in (512, 1000))
    >>> own = ParameterSet()
    >>> working_factor(afm, own), working_factor(wide, own), working_factor(afm, own, 0.2)
    (3, 5, 2)
    """
    native = max(target.dx_um, target.dy_um)
    if pitch_um is not None:
        return max(round(pitch_um / native), 1)
    sigma = parameters.paper.exposure_fwhm_xy_um / FWHM_PER_SIGMA
    finest, widest = (
        max(int(min(sigma * np.sqrt(12 * lost), shortest_um() / per_length) / native + 1e-9), 1)
        for lost, per_length in (FINE, COARSE)
    )
    return int(np.clip(np.ceil(np.sqrt(target.heights_um.size / large_px)), finest, widest))


def shortest_um() -> float:
    """Return the shortest default of a length of the library's effects, µm."""
    lengths = [
        default
        for kind in library().values()
        for name, (default, declared) in declarations(kind).items()
        if declared.unit == "µm" and declared.low > 0 and name not in kind.switches()
    ]
    return min(lengths)
