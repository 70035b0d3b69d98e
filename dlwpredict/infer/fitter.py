"""`best(model)`: the lowest place of the objective for a set of free parameters, whatever it takes to find it.

All starts are inside, and so is the care: who asks for the best fit of a model gets it, and gets the same one again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from dlwpredict.infer.descend import GAIN, descend, promised, tolerance
from dlwpredict.infer.free import Free
from dlwpredict.infer.model import Key, key_of, moving
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.priors import WIDTH_SD
from dlwpredict.infer.stored import recorded, restored
from dlwpredict.infer.straight import bending, straight
from dlwpredict.numerics.parallel import ALONE, Workers
from dlwpredict.parameters import Paper, ParameterSet, declarations

QUICK_STEPS, RENEWED, QUICK_GAIN = 5, 2, 6.0
"""Steps of a quick fit with the same derivatives, at first those of its parent; and how often they are taken anew where
that may matter, while its next step promises more than this in the objective, about what two models must be apart by to
be told apart, and more than the tolerance of a descent."""

HOPED = 2.0
"""A fit that was given up may come down by so many times what its tangent promises: 126 quick ones of a spent proof
came down by 1.2 times as much in the median, by 2.4 times or less in nine of ten, and this leaves out none that
mattered."""

LOOK = 8
"""Steps of a descent from the paper's seven before it is given up where it will not come below the other, ..."""

SAME_VALLEY = 0.5
"""... or is on the way to the same place: the tangent there leaves less than this share of what residuals differ by."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where a fit may begin.

    Parameters
    ----------
    parameters : ParameterSet
        Values of all that moves.
    parent : Fit or None
        A fit near by, whose derivatives are taken over in a quick fit.
    settled : bool
        It is the best fit beside another noise model: no other valley is looked for.
    """

    parameters: ParameterSet
    parent: Fit | None = None
    settled: bool = False

    @property
    def held(self) -> bool:
        """Whether the model has all effects of its parent."""
        if self.parent is None:
            return False
        return {one.name for one in self.parent.parameters.effects} <= {one.name for one in self.parameters.effects}


@dataclass(eq=False)
class Fitter:
    """Best fits of models, each found once.

    Parameters
    ----------
    objective : Objective
    like : Free
        What moves in a model with the effects of its own; in others, which of the seven.
    workers : Workers
        Who share fits that can be made at once.
    stored : dict
        Records of fits, as an interrupted run has left them; new ones are added.
    known : dict
        Best fits by model.
    quick : dict
        Quick fits by model.
    opened : Counter
        How often each quick fit was given up for another start: the next one has a record of its own.
    explained : float
        2 ln L that the best model so far has beyond the baseline.
    """

    objective: Objective
    like: Free
    workers: Workers = ALONE
    stored: dict[str, Any] = field(default_factory=dict)
    known: dict[Key, Fit] = field(default_factory=dict)
    quick: dict[Key, Fit] = field(default_factory=dict)
    opened: Counter[Key] = field(default_factory=Counter)
    explained: float = 0.0

    def free(self, parameters: ParameterSet) -> Free:
        """Return what moves in a model."""
        return moving(parameters, self.like)

    def has(self, start: Start) -> bool:
        """Tell whether the best fit of a model has been found: not by a quick one above a parent that it holds."""
        key = key_of(self.free(start.parameters))
        limit = start.parent.cost + QUICK_GAIN if start.parent is not None and start.held else np.inf
        return key in self.known or (key in self.quick and self.quick[key].cost <= limit)

    def settled(self, fit: Fit) -> bool:
        """Tell whether the best fit of a model is known, not only a quick one."""
        return key_of(fit.free) in self.known

    def reopened(self, start: Start) -> bool:
        """Forget the quick fit of a model; tell whether another start may be tried: not where it is converged."""
        key = key_of(self.free(start.parameters))
        if key in self.known:
            return False
        self.opened[key] += self.quick.pop(key, None) is not None
        return True

    def best(self, *starts: Start) -> Fit:
        """Return the best fit of a model; all starts are of the same model."""
        key = key_of(self.free(starts[0].parameters))
        if key not in self.known:
            self._converge({key: starts})
        return self.known[key]

    def contest(self, models: Sequence[Sequence[Start]]) -> dict[Key, Fit]:
        """Fit several models quickly; return each with its best fit, where that is known, or its quick one.

        A model costs no more than one that it holds: a quick fit above the parent of a start is given up for that.

        Parameters
        ----------
        models : sequence of sequence of Start
        """
        starts = {key_of(self.free(own[0].parameters)): own for own in models}
        unknown = [key for key, own in starts.items() if not all(map(self.has, own))]
        self.opened.update(key for key in unknown if self.quick.pop(key, None) is not None)
        for key, quick in self._carried_out(_quick, {key: (tuple(starts[key]),) for key in unknown}).items():
            self.quick[key] = quick.light
        return {key: self.known.get(key) or self.quick[key] for key in starts}

    def nearer(self, fits: Sequence[Fit], limits: Sequence[float]) -> list[Fit]:
        """Go on with quick fits by derivatives of their own, where they may come below a limit of the objective each.

        What is far from its parent is no worse for that, then.
        """
        objective = self._alone()
        jobs = {key_of(fit.free): (fit, limit) for fit, limit in zip(fits, limits, strict=True)}
        near = {key: job for key, job in jobs.items() if key not in self.known and _may_reach(objective, *job)}
        for key, found in self._carried_out(_nearer, near).items():
            self.quick[key] = found.light
        return [self.known.get(key) or self.quick[key] for key in jobs]

    def settle(self, fits: Sequence[Fit]) -> list[Fit]:
        """Return the best fits of models that have been fitted quickly."""
        models = {key_of(fit.free): (Start(fit.parameters),) for fit in fits}
        self.quick |= {key_of(fit.free): fit for fit in fits}
        self._converge({key: own for key, own in models.items() if key not in self.known})
        return [self.known[key_of(fit.free)] for fit in fits]

    def polished(self, fit: Fit) -> Fit:
        """Return a converged fit to the accuracy of its own standard deviations, whatever others explain."""
        if promised(fit) < tolerance(self.objective, fit, GAIN):
            return fit
        key = key_of(fit.free)
        self.known |= self._carried_out(_polished, {key: (fit,)})
        return self.known[key]

    def _converge(self, models: Mapping[Key, Sequence[Start]]) -> None:
        """Bring models to convergence."""
        self.known |= self._carried_out(_best, {key: (tuple(own), self.quick.get(key)) for key, own in models.items()})

    def _carried_out(self, fit: Callable[..., tuple[Fit, float]], models: Mapping[Key, tuple]) -> dict[Key, Fit]:
        """Fit models; what an interrupted run has left is taken up as it was."""
        name = fit.__name__.lstrip("_")
        record = {key: " ".join((name, *key, *["again"] * self.opened[key])) for key in models}
        taken = [key for key in models if record[key] in self.stored]
        others = [key for key in models if key not in taken]
        again = [(self._alone(), self.like, self.stored[record[key]]) for key in taken]
        jobs = [(self._alone(), self.like, *models[key]) for key in others]
        ends = [*self.workers.each(restored, again), *self.workers.each(fit, jobs)]
        fits = {}
        for key, (end, spent) in zip([*taken, *others], ends, strict=True):
            fits[key] = self._shared(end)
            self.objective.work.predictions += spent
            self.stored[record[key]] = recorded(end)
        return fits

    def _alone(self) -> Objective:
        """Return the objective with work of its own, so that it can be counted in another process."""
        work = replace(self.objective.work, predictions=0.0) if self.workers is ALONE else Work()
        return replace(self.objective, work=work, explained=self.explained)

    def _shared(self, found: Fit) -> Fit:
        """Return a fit that another process has made with the recordings of this one, in place of copies of its own."""
        pairs = zip(self.objective.data, found.data, strict=True)
        return replace(found, data=tuple(replace(own, place=other.place) for own, other in pairs))


def _quick(objective: Objective, like: Free, starts: Sequence[Start]) -> tuple[Fit, float]:
    """Return the lowest of the quick fits from all starts, and the work that it took.

    A model costs no more than one that it holds. Where all quick fits do, the parent's derivatives have misled them:
    what is new in the first start is put beside the parent as it was, with derivatives of its own.
    """
    found = [_hurried(objective, _begun(objective, start, like)) for start in starts]
    best, parent = min(found, key=lambda one: one.cost), starts[0].parent
    if parent is not None and starts[0].held and best.cost > parent.cost:
        known = dict(zip(parent.free.names, parent.vector, strict=True))
        values = zip(best.free.names, best.free.values(starts[0].parameters), strict=True)
        vector = best.free.allowed(np.array([known.get(name, value) for name, value in values]))
        begun = objective.differentiated(objective.at(best.free, vector, parent))
        best = min(best, _hurried(objective, begun), key=lambda one: one.cost)
    return replace(best, promise=promised(best)), objective.work.predictions


def _nearer(objective: Objective, _: Free, fit: Fit, limit: float) -> tuple[Fit, float]:
    """Return where a quick fit leads with derivatives taken anew, and again while it may come below a limit."""
    for _time in range(RENEWED):
        fit = _hurried(objective, objective.differentiated(objective.at(fit.free, fit.vector, fit)))
        fit = replace(fit, promise=promised(fit))
        if not _may_reach(objective, fit, limit):
            break
    return fit, objective.work.predictions


def _may_reach(objective: Objective, fit: Fit, limit: float) -> bool:
    """Tell whether a quick fit promises anything, and may come below a limit of the objective."""
    return fit.promise >= tolerance(objective, fit, QUICK_GAIN) and fit.cost - HOPED * fit.promise <= limit


def _hurried(objective: Objective, begun: Fit) -> Fit:
    """Return where a few steps lead with the derivatives that a fit has, past ends of ranges as well."""
    go = partial(descend, objective, secant=True, steps=QUICK_STEPS, gain=QUICK_GAIN)
    return _elsewhere(objective, go(begun), go)


def _begun(objective: Objective, start: Start, like: Free) -> Fit:
    """Return a start with derivatives, its parent's where it has one that has them."""
    free, parent = moving(start.parameters, like), start.parent
    begun = objective.at(free, free.start, parent)
    return objective.differentiated(begun, parent if parent and parent.nuisances else None)


def _best(objective: Objective, like: Free, starts: Sequence[Start], begun: Fit | None) -> tuple[Fit, float]:
    """Return the lowest of the converged fits, and the work that it took.

    A quick fit is converged with derivatives of its own; a start that has none to take over needs no quick fit. Focus,
    threshold, cross-linking and κ act together: a model may have its lowest place in another valley than a smaller
    one. Where a width came out far from its prior, the descent is repeated from the paper's seven.
    """
    if begun is None and (len(starts) > 1 or starts[0].parent):
        begun = _quick(objective, like, starts)[0]
    free = begun.free if begun else moving(starts[0].parameters, like)
    first = objective.at(free, begun.vector if begun else free.start, begun)
    found = _converged(objective, first)
    other = None if any(start.settled for start in starts) else from_paper(found.free, found.vector)
    if other is not None:
        again = objective.differentiated(objective.at(found.free, other, found))
        again = descend(objective, again, secant=True, steps=LOOK)
        if _may_be_lower(objective, replace(again, promise=promised(again)), found):
            found = min(found, _converged(objective, again), key=lambda one: one.cost)
    return found, objective.work.predictions


def _may_be_lower(objective: Objective, other: Fit, found: Fit) -> bool:
    """Tell whether a descent may end lower than a converged fit: begun lower, or on the way to there."""
    return other.cost < found.cost or (_may_reach(objective, other, found.cost) and not _leads_to(found, other))


def _leads_to(found: Fit, other: Fit) -> bool:
    """Tell whether another place, no lower, is in the valley of a converged fit: to first order its residual follows.

    Behind a ridge it does not, however near in cost.
    """
    free = found.free
    along = bending(free, found.vector) @ (straight(free, other.vector) - straight(free, found.vector))
    differs = other.residual - found.residual
    unsaid = differs + found.nuisances.beside(found.jacobian @ along)
    return float(unsaid @ unsaid) < SAME_VALLEY * float(differs @ differs)


def _converged(objective: Objective, fit: Fit) -> Fit:
    """Descend with derivatives taken anew, past the ends of ranges that nature does not end."""
    go = partial(descend, objective)
    return _elsewhere(objective, go(objective.differentiated(fit)), go)


def _polished(objective: Objective, _: Free, fit: Fit) -> tuple[Fit, float]:
    """Go on from a converged fit with what a descent asks of a model alone."""
    return descend(replace(objective, explained=0.0), fit), objective.work.predictions


def _elsewhere(objective: Objective, found: Fit, go: Callable[[Fit], Fit]) -> Fit:
    """Go on from the other end where an effect has come to the end of a range that nature does not end."""
    effects = tuple(effect.elsewhere() for effect in found.parameters.effects)
    if effects == found.parameters.effects:
        return found
    free = replace(found.free, base=replace(found.parameters, effects=effects))  # a switch at 0 moves on
    other = objective.differentiated(objective.at(free, free.start, found))
    return min(found, go(other), key=lambda one: one.cost)


def far_widths(free: Free, vector: np.ndarray) -> dict[str, float]:
    """Return by how much every FWHM that came out far from its prior would have to move to be the paper's, µm."""
    usual = {name: default for name, (default, _) in declarations(Paper).items() if "fwhm" in name}
    values = {name: value for name, value in zip(free.names, vector, strict=True) if name in usual}
    return {n: usual[n] - v for n, v in values.items() if abs(np.log(v / usual[n])) >= WIDTH_SD}


def from_paper(free: Free, vector: np.ndarray) -> np.ndarray | None:
    """Return another place to begin, where a width came out far from its prior; else None.

    The seven stand at the paper's values there, and effects have at least their typical size: a width goes far because
    it answers to what an effect does, and an effect that it has taken the place of comes out small.
    """
    if not far_widths(free, vector):
        return None
    values = dict(zip(free.names, vector, strict=True))
    values |= {name: default for name, (default, _) in declarations(Paper).items() if name in free.names}
    for effect in free.base.effects:
        for switch, typical in effect.switches().items():
            name, off = f"{effect.name}.{switch}", declarations(effect)[switch][0]
            if name in values and abs(values[name] - off) < abs(typical - off):
                values[name] = off + abs(typical - off) * (np.sign(values[name] - off) or np.sign(typical - off))
    return free.allowed(np.array(list(values.values())))
