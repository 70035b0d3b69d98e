"""Either side: the whole process if what the data cannot place happens to the print, and if in the measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

from dlwpredict.diagnose.finer import polished
from dlwpredict.diagnose.fit import Fit, placed
from dlwpredict.diagnose.naming import Named
from dlwpredict.diagnose.refit import freed, rested
from dlwpredict.diagnose.words import side_of
from dlwpredict.effects import library
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import Process, Side, Undecided


def undecided(named: Sequence[Named], whole: Fit, workers: Workers = ALONE) -> Undecided | None:
    """Return the effects whose side is open, with the process that the data give if all of them are of one side.

    Everything that is fitted answers to which of two effects stands in a place, the seven as well: a process with one
    effect put where another was is none that the data give. So either is fitted as a whole.

    Parameters
    ----------
    named : sequence of Named
        The strongest first.
    whole : Fit
        The model that has them all, at rest.
    workers : Workers

    Returns
    -------
    Undecided or None
        None where no class has members on both sides.
    """
    either = [item for item in named if side_of(item.names) == "undecided"]
    if not either:
        return None
    fits = [_on(side, either, whole, workers) for side in get_args(Side)]
    processes = [Process(fitted.parameters.paper, fitted.parameters.effects) for fitted in fits]
    return Undecided(tuple(item.effect.name for item in either), *processes)


def _on(side: Side, either: Sequence[Named], whole: Fit, workers: Workers) -> Fit:
    """Return the model with the likeliest effect of this side in every open place, at rest."""
    swaps = {}
    for item in either:
        name = next(name for name in item.names if library()[name].side == side)
        if name != item.effect.name:
            swaps[item.effect.name] = next(other for other in item.alternatives if other.effect.name == name)
    if not swaps:
        return whole
    near = next(iter(swaps.values())).fit
    known = {effect.name: effect for effect in near.parameters.effects}
    known |= {other.effect.name: other.effect for other in swaps.values()}
    effects = tuple(effect for name, effect in known.items() if name not in swaps)
    free = freed(replace(near.parameters, effects=effects), near.free)
    return polished(rested(placed(near.data, free, free.start, near.point), workers), workers)
