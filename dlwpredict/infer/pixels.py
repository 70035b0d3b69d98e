"""Pixels: on which a recording is worked, and what finer ones would change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.objective import Work
from dlwpredict.infer.recording import Recording
from dlwpredict.infer.trace import trace
from dlwpredict.infer.whitened import Whitened
from dlwpredict.model.levels import Levels
from dlwpredict.parameters import ParameterSet, declarations
from dlwpredict.process import run
from dlwpredict.smoothing import FWHM_PER_SIGMA, block_mean

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
    found = [
        default
        for kind in library().values()
        for name, (default, declared) in declarations(kind).items()
        if declared.unit == "µm" and declared.low > 0 and name not in kind.switches()
    ]
    return min(found)


def discretisation_um(
    recording: Recording, parameters: ParameterSet, predicted_um: np.ndarray, work: Work | None = None
) -> np.ndarray:
    """Return what the prediction changes on pixels of half the size, µm, shape (rows, cols).

    Two honest discretisations of the same physics differ by this much. The print has no pixels, the recording has: its
    effects act on the recording's own.

    Parameters
    ----------
    recording : Recording
    parameters : ParameterSet
    predicted_um : numpy.ndarray, shape (rows, cols)
        The prediction on the recording's own pixels.
    work : Work, optional
        Counts it: four times the pixels.
    """
    target = recording.target
    fine = HeightMap(np.kron(target.heights_um, np.ones((2, 2))), target.dx_um / 2, target.dy_um / 2)
    seen = [effect for effect in parameters.effects if effect.stage == "recording"]
    written = tuple(effect for effect in parameters.effects if effect.stage != "recording")
    printed = trace(fine, replace(parameters, effects=written), Levels())
    if work:
        work.predictions += 4 * printed.work
    shown = run(seen, target.with_heights(block_mean(printed.heights_um, (2, 2)))).heights_um
    return np.nan_to_num(shown - predicted_um)


def discretised(
    data: Sequence[Whitened], parameters: ParameterSet, predicted_um: Sequence[np.ndarray], work: Work
) -> tuple[Whitened, ...]:
    """Return recordings with the change on finer pixels of a process, where pixels are a nuisance.

    The work is counted in predictions of all recordings.
    """
    own, place = Work(), place_of(parameters)
    found = []
    for item, predicted in zip(data, predicted_um, strict=True):
        if "pixels" in item.nuisances:
            change = discretisation_um(item.recording, parameters, predicted, own)
            item = replace(item, discretisation_um=change, discretised=place)
        found.append(item)
    work.predictions += own.predictions / len(data)
    return tuple(found)


def place_of(parameters: ParameterSet) -> tuple[tuple[str, ...], float]:
    """Return what the change hangs on most: the effects of a process, and the logarithm of its focus's width."""
    return tuple(e.name for e in parameters.effects), float(np.log(parameters.paper.exposure_fwhm_xy_um))
