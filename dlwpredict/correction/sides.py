"""Print or measurement: what each choice comes to where the data cannot place an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np

from dlwpredict.correction.precompensate import Precompensation
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet, Side
from dlwpredict.process import predict


@dataclass(frozen=True)
class Stake:
    """What it means to correct for one side, over the part.

    Parameters
    ----------
    side, other : {"print", "measurement"}
    rmse_um, wrong_um : float
        Root mean square error of the print if the choice is right, and if it is not.
    apart_um, apart_rms_um : float
        How far the two corrected targets lie from each other: largest, and root mean square.
    """

    side: Side
    other: Side
    rmse_um: float
    wrong_um: float
    apart_um: float
    apart_rms_um: float


def stakes(
    target: HeightMap, parameters: ParameterSet, correct: Callable[[HeightMap, ParameterSet], Precompensation]
) -> list[Stake]:
    """Correct for either side of what is undecided, and predict each print as if the other were true."""
    sides: tuple[Side, Side] = get_args(Side)
    processes = {side: parameters.decided(side) for side in sides}
    corrected = {side: correct(target, process) for side, process in processes.items()}
    footprint = target.heights_um > 0

    def stake(side: Side, other: Side) -> Stake:
        written = corrected[side].corrected
        apart_um = (written.heights_um - corrected[other].corrected.heights_um)[footprint]
        wrong_um = (target.heights_um - predict(written, processes[other]).heights_um)[footprint]
        right_um = corrected[side].error_um[footprint]
        return Stake(side, other, _rms(right_um), _rms(wrong_um), float(np.abs(apart_um).max()), _rms(apart_um))

    return [stake(*sides), stake(*sides[::-1])]


def _rms(values_um: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values_um**2)))
