"""``calibrate``: one process for several recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from dlwpredict import calibration
from dlwpredict.calibration import Calibration
from dlwpredict.infer.free import choose
from dlwpredict.metrology.walls import WALL_PX
from dlwpredict.pairing import Pairs, ready
from dlwpredict.parameters import ParameterSet


def calibrate(
    pairs: Pairs,
    start: ParameterSet | None = None,
    *,
    fix: Sequence[str] = (),
    free: Sequence[str] = (),
    wall_px: int = WALL_PX,
    seed: int = 0,
    **settings: Any,
) -> Calibration:
    """Fit one process to recordings.

    Parameters
    ----------
    pairs : sequence of (target, recording)
        The recording on the target's grid: a `HeightMap`, or what `align` has returned.
    start : ParameterSet, optional
        Where the fit begins. Default: the paper's.
    fix, free : sequence of str
        Parameters that are not fitted; if any are freed, only these are.
    wall_px : int
        Points so near to a wall do not count.
    seed : int
    **settings
        Of `dlwpredict.calibration.calibrate`: ``method`` ("fast", or "simplex", the paper's), ``robust``, ``priors``,
        ``profile``, ``work`` (shown every place that is looked at).

    Returns
    -------
    Calibration
        ``parameters`` with 95 % intervals, ``warnings``.
    """
    start = start or ParameterSet()
    moving = choose(start, fix=fix, free=free)
    recordings = [pair.recording for pair in ready(pairs, start, wall_px=wall_px, large_px=math.inf)]
    return calibration.calibrate(recordings, moving, seed=seed, **settings)
