"""``precompensate``: what to write so that the print has the target's heights."""

from __future__ import annotations

from typing import Any

from dlwpredict.correction.limits import Limits
from dlwpredict.correction.precompensate import Precompensation, correct
from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import check_target


def precompensate(
    target: HeightMap,
    parameters: ParameterSet | None = None,
    *,
    maximum_um: float | None = None,
    limits: Limits | None = None,
    continued: bool = False,
    most_predictions: int = 10,
    **settings: Any,
) -> Precompensation:
    """Find what to write so that the print has the target's heights.

    Parameters
    ----------
    target : HeightMap
    parameters : ParameterSet, optional
        Default: the paper's. Effects of the instrument are not corrected.
    maximum_um : float, optional
        Highest height that may be written. Default: twice the target's.
    limits : correction.precompensate.Limits, optional
        All that may be written, slices and slopes too. Default: by `maximum_um` and the slicing of the parameters.
    continued : bool
        The part goes on beyond its map as its mirror image, instead of ending there.
    most_predictions : int
    **settings
        Of `correction.precompensate.precompensate`: ``tolerance``, ``memory`` (0: the paper's loop), ``on_step``.

    Returns
    -------
    Precompensation
        ``corrected``, what to write; ``predicted``, its print; ``reachable``, where the print answers.

    Raises
    ------
    InputError
        The side of an effect is open: say ``parameters.decided("print")`` or ``"measurement"``.
    """
    known = parameters or ParameterSet()
    if known.undecided:
        named = ", ".join(known.undecided.effects)
        allowed = 'allowed: parameters.decided("print") or ("measurement")'
        raise InputError(f"print or measurement is open for {named}", key="undecided", allowed=allowed)
    check_target(target)
    limits = limits or Limits.about(target, maximum_um, slicing_um=known.writing.slicing_um)
    return correct(target, known, limits, continued=continued, most_predictions=most_predictions, **settings)
