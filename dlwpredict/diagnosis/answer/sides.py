"""Either side: the whole process if what the data cannot place happens to the print, and if in the measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import get_args

from dlwpredict.diagnosis.answer.words import side_of
from dlwpredict.diagnosis.classes import Member, Named
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.effects import library
from dlwpredict.infer.fitter import Fitter, Start
from dlwpredict.infer.model import joined, lacking
from dlwpredict.infer.objective import Fit
from dlwpredict.parameters import ParameterSet, Process, Side, Undecided


def extended(diagnosis: Diagnosis, profiled: Mapping[str, tuple[float, float]] | None = None) -> ParameterSet:
    """Return the process with the effects found; where a side is open, with the process on either.

    Parameters
    ----------
    diagnosis : Diagnosis
    profiled : mapping, optional
        Intervals of the fit; without them the answer is wanted now, and nothing is fitted any more.
    """
    fitted, now = diagnosis.extended.fit, profiled is None
    either = undecided(diagnosis.named, fitted, diagnosis.fitter, refit=not now)
    ends = diagnosis.intervals(fitted).as_dict() if profiled is None else dict(profiled)
    return replace(fitted.parameters, undecided=either, intervals=ends)


def undecided(named: Sequence[Named], whole: Fit, fitter: Fitter, *, refit: bool = True) -> Undecided | None:
    """Return the effects whose side is open, with the process that the data give if all of them are of one side.

    Everything that is fitted answers to which of two effects stands in a place, the seven as well: a process with one
    effect put where another was is none that the data give. So either is fitted as a whole.

    Parameters
    ----------
    named : sequence of Named
        The strongest first.
    whole : Fit
        The model that has them all.
    fitter : Fitter
    refit : bool
        Where several places are open at once; else, for an answer that is wanted now, their effects stand as each was
        fitted beside the others.

    Returns
    -------
    Undecided or None
        None where no class has members on both sides.
    """
    either = [item for item in named if side_of(item.names) == "undecided"]
    if not either:
        return None
    by_side = [_on(side, either, whole, fitter, refit=refit) for side in get_args(Side)]
    processes = [Process(parameters.paper, parameters.effects) for parameters in by_side]
    return Undecided(tuple(item.effect.name for item in either), *processes)


def _on(side: Side, either: Sequence[Named], whole: Fit, fitter: Fitter, *, refit: bool) -> ParameterSet:
    """Return the process with the likeliest effect of this side in every open place."""
    swaps: dict[str, Member] = {}
    for item in either:
        likeliest = next(member for member in item.members if library()[member.effect.name].side == side)
        if likeliest.effect.name != item.effect.name:
            swaps[item.effect.name] = likeliest
    if len(swaps) < 2:
        return next((member.fit for member in swaps.values()), whole).parameters
    members = {member.effect.name: member.effect for member in swaps.values()}
    start = joined(lacking(whole.parameters, list(swaps)), list(members.values()), fitter.like)
    return fitter.best(Start(start, whole)).parameters if refit else start
