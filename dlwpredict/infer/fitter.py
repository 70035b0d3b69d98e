"""`best(model)`: the lowest place of the objective for a set of free parameters, whatever it takes to find it.

All starts are inside, and so is the care: who asks for the best fit of a model gets it, and gets the same one again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import Free
from dlwpredict.infer.model import Key, key_of, moving
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.pixels import discretised, place_of
from dlwpredict.infer.priors import WIDTH_SD
from dlwpredict.infer.stored import MAPS, recorded, restored
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import Paper, ParameterSet, declarations

QUICK_STEPS = 5
"""Steps of a quick fit, which has derivatives of its parent."""

LOOK, FOLLOWED = 8, 1.05
"""Steps of a descent from the paper's seven before it is given up where it costs more than so many times the other."""

RIM = 1.0
"""The change on finer pixels is taken anew where a fit has moved it by more than this energy, in units of the noise."""

REPIXELLED = 2
"""Times at most that it is."""

FOCUS_MOVED = 0.03
"""Relative change of a lateral focus width below which that cannot be: the change goes with the square of the width."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where a fit may begin.

    Parameters
    ----------
    parameters : ParameterSet
        Values of all that moves.
    parent : Fit or None
        A fit near by, whose derivatives are taken over in a quick fit.
    """

    parameters: ParameterSet
    parent: Fit | None = None


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
        Records of best fits by model, as an interrupted run has left them; new ones are added.
    known : dict
        Best fits by model.
    quick : dict
        Quick fits by model, of models that were not worth more.
    """

    objective: Objective
    like: Free
    workers: Workers = ALONE
    stored: dict[str, Any] = field(default_factory=dict)
    known: dict[Key, Fit] = field(default_factory=dict)
    quick: dict[Key, Fit] = field(default_factory=dict)

    def free(self, parameters: ParameterSet) -> Free:
        """Return what moves in a model."""
        return moving(parameters, self.like)

    def has(self, start: Start) -> bool:
        """Tell whether a model has been fitted already."""
        key = key_of(self.free(start.parameters))
        return key in self.known or key in self.quick

    def best(self, *starts: Start) -> Fit:
        """Return the best fit of a model; all starts are of the same model."""
        key = key_of(self.free(starts[0].parameters))
        if key not in self.known:
            self._converge({key: starts})
        return self.known[key]

    def contest(
        self,
        models: Sequence[Sequence[Start]],
        promised: Mapping[Key, float],
        limit: Callable[[Key, Mapping[Key, float]], float],
    ) -> dict[Key, Fit]:
        """Fit several models; only those that may matter are fitted with full care.

        A model matters where its quick fit, or what it promises to first order, does not cost more than its limit.

        Parameters
        ----------
        models : sequence of sequence of Start
        promised : mapping of model to float
            Cost to first order.
        limit : function of a model and the costs of all quick fits
            The highest cost at which the model matters.

        Returns
        -------
        dict
            Model to its best fit, or to its quick one.
        """
        starts = {key_of(self.free(own[0].parameters)): own for own in models}
        kept = {key: own for key, own in starts.items() if key not in self.known and " ".join(key) in self.stored}
        self._converge(kept)
        unknown = {key: own for key, own in starts.items() if key not in self.known and key not in self.quick}
        jobs = [(self._alone(), self.like, tuple(own)) for own in unknown.values()]
        for key, (found, spent) in zip(unknown, self.workers.each(_quick, jobs), strict=True):
            quick = self._shared(found)
            self.quick[key] = replace(quick, traces=tuple(one.bare for one in quick.traces))
            self.objective.work.predictions += spent
        costs = {key: (self.known.get(key) or self.quick[key]).cost for key in starts}
        hoped = {key: min(cost, promised.get(key, np.inf)) for key, cost in costs.items() if key not in self.known}
        self._converge({key: starts[key] for key, cost in hoped.items() if cost <= limit(key, costs)})
        return {key: self.known.get(key) or self.quick[key] for key in starts}

    def _converge(self, models: Mapping[Key, Sequence[Start]]) -> None:
        """Bring models to convergence; what an interrupted run has left is taken up as it was."""
        maps = self.stored.setdefault(MAPS, {})
        taken = [key for key in models if " ".join(key) in self.stored]
        others = [key for key in models if key not in taken]
        again = [(self._alone(), self.like, self.stored[" ".join(key)], maps) for key in taken]
        jobs = [(self._alone(), self.like, tuple(models[key]), self.quick.get(key)) for key in others]
        found = [*self.workers.each(restored, again), *self.workers.each(_best, jobs)]
        for key, (fit, spent) in zip([*taken, *others], found, strict=True):
            self.known[key] = self._shared(fit)
            self.objective.work.predictions += spent
            if key in others:
                self.stored[" ".join(key)] = recorded(self.known[key], maps)

    def _alone(self) -> Objective:
        """Return the objective with work of its own, so that it can be counted in another process."""
        work = self.objective.work
        return replace(self.objective, work=replace(work, predictions=0.0) if self.workers is ALONE else Work())

    def _shared(self, found: Fit) -> Fit:
        """Return a fit that another process has made with the recordings of this one, in place of copies of its own."""
        pairs = zip(self.objective.data, found.data, strict=True)
        moved = ("shift_um", "discretisation_um", "discretised")
        own = [replace(a, **{name: getattr(b, name) for name in moved}) for a, b in pairs]
        return replace(found, data=tuple(own))


def _quick(objective: Objective, like: Free, starts: Sequence[Start]) -> tuple[Fit, float]:
    """Return the lowest of the quick fits from all starts, and the work that it took."""
    found = []
    for start in starts:
        begun = _begun(objective, start, like)
        found.append(descend(objective, begun, secant=True, steps=QUICK_STEPS))
    return min(found, key=lambda one: one.cost), objective.work.predictions


def _begun(objective: Objective, start: Start, like: Free) -> Fit:
    """Return a start with derivatives, its parent's where it has one."""
    free = moving(start.parameters, like)
    return objective.differentiated(objective.at(free, free.start, start.parent), start.parent)


def _best(objective: Objective, like: Free, starts: Sequence[Start], begun: Fit | None) -> tuple[Fit, float]:
    """Return the lowest of the converged fits, and the work that it took.

    A quick fit is converged with derivatives of its own. Focus, threshold, cross-linking and κ act together: a model
    may have its lowest place in another valley than a smaller one. Where a width came out far from its prior, the
    descent is repeated from the paper's seven.
    """
    first = begun if begun is not None else _quick(objective, like, starts)[0]
    found = _converged(objective, first, like)
    if (other := _from_paper(found)) is not None:
        again = objective.differentiated(repixelled(objective, objective.at(found.free, other, found)))
        again = descend(objective, again, steps=LOOK)
        if again.cost < FOLLOWED * found.cost:
            found = min(found, _converged(objective, again, like), key=lambda one: one.cost)
    return found, objective.work.predictions


def _converged(objective: Objective, fit: Fit, like: Free, *, fresh: bool = False) -> Fit:
    """Descend with derivatives taken anew, past the ends of ranges that nature does not end, on pixels of its own."""
    found = descend(objective, fit if fresh else objective.differentiated(fit))
    found = _elsewhere(objective, found, like)
    for _ in range(REPIXELLED):
        again = repixelled(objective, found)
        if again is found:
            break
        found = descend(objective, again)
    return found


def _elsewhere(objective: Objective, found: Fit, like: Free) -> Fit:
    """Go on from the other end where an effect has come to the end of a range that nature does not end."""
    effects = tuple(effect.elsewhere() for effect in found.parameters.effects)
    if effects == found.parameters.effects:
        return found
    free = moving(replace(found.parameters, effects=effects), like)
    other = objective.differentiated(objective.at(free, free.start, found))
    return min(found, descend(objective, other), key=lambda one: one.cost)


def _from_paper(found: Fit) -> np.ndarray | None:
    """Return another place to begin, where a width came out far from its prior; else None.

    The seven stand at the paper's values there, and effects have at least their typical size: a width goes far because
    it answers to what an effect does, and an effect that it has taken the place of comes out small.
    """
    seven = {name: default for name, (default, _) in declarations(Paper).items() if name in found.free.names}
    values = dict(zip(found.free.names, found.vector, strict=True))
    if all(abs(np.log(values[name] / seven[name])) < WIDTH_SD for name in seven if "fwhm" in name):
        return None
    values |= seven
    for effect in found.parameters.effects:
        for switch, typical in effect.switches().items():
            name, off = f"{effect.name}.{switch}", declarations(effect)[switch][0]
            if name in values and abs(values[name] - off) < abs(typical - off):
                values[name] = off + abs(typical - off) * (np.sign(values[name] - off) or np.sign(typical - off))
    return found.free.allowed(np.array(list(values.values())))


def repixelled(objective: Objective, found: Fit) -> Fit:
    """Return the fit with the change on finer pixels taken where it is; the fit itself where that is no other.

    What a finer grid changes hangs on the focus width, and the width on what the grid is held to change: taken far
    from where a fit ends, one wrong holds the other.
    """
    here = place_of(found.parameters)
    items = [item for item in found.data if "pixels" in item.nuisances]
    if all(item.discretised[0] == here[0] and abs(item.discretised[1] - here[1]) < FOCUS_MOVED for item in items):
        return found
    shown = [one.heights_um for one in found.traces]
    data = discretised(found.data, found.parameters, shown, objective.work)
    moved = [b.white(b.discretisation_um - a.discretisation_um) for a, b in zip(found.data, data, strict=True)]
    if sum(float(one @ one) for one in moved) < RIM:
        return found
    now = objective.at(found.free, found.vector, replace(found, data=data))
    return replace(now, jacobian=found.jacobian)
