"""The refits: what every set of effects costs that was fitted so far, and the price that its switches must gain."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.score import Linearised, Thresholds, thresholds
from dlwpredict.diagnosis.library.seams import seams
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.infer.baseline import beside_white
from dlwpredict.infer.fitter import Fitter, Start
from dlwpredict.infer.model import Key, effect_of, key_of, lacking, on, switched
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit
from dlwpredict.parameters import ParameterSet

Names = frozenset[str]


@dataclass(eq=False)
class Refits:
    """Sets of effects beside a baseline, refitted.

    Parameters
    ----------
    fitter : Fitter
    null : Null
    baseline : Fit
    signatures : dict
        Signatures by the model that they were taken at: they outlive a noise model.
    place_price : dict
        Name to what choosing its place costs, 2 ln L.
    fitted : dict
        Best fits by names of their effects, the baseline's own aside.
    spread : dict
        Name to the standard deviation of scores along what the effect does.
    reduced : set
        Sets, each with a smaller one that was begun from it: of an effect that came out off nothing is left.
    """

    fitter: Fitter
    null: Null
    baseline: Fit
    signatures: dict[Key, Signatures]
    place_price: dict[str, float] = field(default_factory=dict)
    fitted: dict[Names, Fit] = field(default_factory=dict)
    spread: dict[str, float] = field(default_factory=dict)
    reduced: set[tuple[Names, Names]] = field(default_factory=set)
    first: Linearised = field(init=False)
    asked: Thresholds = field(init=False)
    screens: dict[Names, Linearised] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.fitted[frozenset()] = self.baseline
        self.first = self.screen(frozenset())
        self.asked = thresholds(self.first, policy.LEVEL_NAMES, policy.LEVEL_NEXT, policy.INFLATED)

    def price(self, switches: int) -> float:
        """Return what so many switches must gain: what noise hardly ever gives them, and what a formula may be wrong.

        Those of all effects together: most have one. The form of the strongest effect is trusted to a share of its
        energy. What it is wrong by is there for any further switch to explain, which must gain more than it can take of
        that.
        """
        return self.asked.first + (switches - 1) * (self.asked.next + self.form_error) if switches else 0.0

    def priced(self, fit: Fit) -> float:
        """Return what a fit costs, with the price of its switches."""
        own = self.names(fit.parameters)
        return fit.cost + self.price(sum(on(fit.parameters, name) for name in own)) + self.placing(own)

    def placing(self, names: Names) -> float:
        """Return what choosing the places of some effects costs."""
        return sum(self.place_price.get(name, 0.0) for name in names)

    @property
    def form_error(self) -> float:
        """2 ln L that another name may take of what the form of the strongest effect is wrong by."""
        singles = [self.baseline.cost - fit.cost for names, fit in self.fitted.items() if len(names) == 1]
        strongest = max(singles, default=float(np.max(self.first.z**2, initial=0.0)))
        return policy.MISTAKEN * policy.FORM_ERROR * max(strongest, 0.0)

    def needed(self, names: Names, name: str) -> float:
        """Return what an effect of a set must gain beside the others: what noise gives along it, and form errors."""
        more = on(self.fitted[names].parameters, name) - (len(names) == 1)
        noise = more * self.asked.next + (self.asked.first if len(names) == 1 else 0.0)
        return noise * self.spread.get(name, 1.0) ** 2 + more * self.form_error + self.place_price.get(name, 0.0)

    def width_of_set(self, names: Names) -> float:
        """Return how far in 2 ln L a refit may stay behind a set and still be looked at."""
        gain = max(self.baseline.cost - self.fitted[names].cost, 0.0)
        return policy.REACH * (policy.WIDTH + policy.FORM_ERROR * gain)

    def key(self, names: Names) -> Key:
        """Return what model the best fit of a set is: the same names by other switches are another."""
        return key_of(self.fitted[names].free)

    def names(self, parameters: ParameterSet) -> Names:
        """Return the names of the effects that the baseline has not."""
        own = {effect.name for effect in self.baseline.parameters.effects}
        return frozenset(effect.name for effect in parameters.effects) - own

    def screen(self, names: Names) -> Linearised:
        """Linearise about the best fit of a set, once."""
        if names not in self.screens or self.screens[names].model is not self.fitted[names]:
            self.screens[names] = self.linearised(names)
        return self.screens[names]

    def linearised(self, names: Names) -> Linearised:
        """Linearise about the best fit of a set; signatures are taken there once.

        And so are places: beside a stronger effect that is not known yet, a seam is looked for where that changes most.
        """
        model, key = self.fitted[names], self.key(names)
        if key not in self.signatures:
            objective = self.fitter.objective
            for earlier in self.signatures.keys() - {self.key(frozenset())}:
                del self.signatures[earlier]  # they are large, and a model that was left is seldom come back to
            places = seams(beside_white(model)).placed
            self.signatures[key] = Signatures.of(model, sorted(names), objective.work, self.fitter.workers, places)
        screen = Linearised.of(self.signatures[key], model, self.null, self.fitter.objective)
        for k in np.argsort(np.abs(screen.z), kind="stable"):
            self.spread[screen.chosen[k].name] = float(screen.spread[k])
        self.spread |= dict(zip(screen.named, map(float, screen.named_spread), strict=True))
        return screen

    def converged(self, names: Names) -> Fit:
        """Return the fit of a set, brought to convergence where only its quick fit was known."""
        if names:
            self.fitted[names] = self.fitter.best(Start(self.fitted[names].parameters))
        return self.fitted[names]

    def polish(self, names: Names) -> None:
        """Bring a set to the accuracy of its own standard deviations: it is what is said in the end."""
        if names:
            self.fitted[names] = self.fitter.polished(self.converged(names))

    def settled(self, names: Names) -> bool:
        """Tell whether the best fit of a set is known, not only a quick one."""
        return self.fitter.settled(self.fitted[names])

    def without(self, names: Names, name: str) -> Fit:
        """Return the reduced model: the best fit of a set without one of its effects.

        It is begun where the set was fitted, whatever other quick fit of it there is: that may be far above its best,
        and the effect would seem to gain what is only missing there.
        """
        start = self.stripped(Start(lacking(self.fitted[names].parameters, [name]), self.fitted[names]))
        fewer = self.names(start.parameters)
        if (names, fewer) not in self.reduced and not (fewer in self.fitted and self.settled(fewer)):
            self.reduced.add((names, fewer))
            if fewer not in self.fitted or self.fitter.reopened(start):
                self.refit([start])
        self.settle(names, [fewer])
        return self.fitted[fewer]

    def gain(self, names: Names, name: str) -> float:
        """Return the 2 ln L that an effect of a set brings beside the others."""
        return self.without(names, name).cost - self.fitted[names].cost

    def refit(self, starts: Iterable[Start]) -> None:
        """Refit models quickly; the same effects by other switches are another model."""
        models: dict[Key, list[Start]] = defaultdict(list)
        for start in map(self.stripped, starts):
            models[key_of(self.fitter.free(start.parameters))].append(start)
        fits = list(self.fitter.contest(list(models.values())).values())
        self.keep(fits)
        fits = self.fitter.nearer(fits, self._limits(fits))
        self.keep(fits)
        self.keep(self.fitter.settle([fit for fit in fits if self._may_replace(fit)]))

    def stripped(self, start: Start) -> Start:
        """Return a start without the effects that a fit has put to nothing: it is one of the smaller set."""
        named = self.names(start.parameters)
        off = [name for name in sorted(named) if not switched(effect_of(start.parameters, name))]
        return replace(start, parameters=lacking(start.parameters, off)) if off else start

    def _may_replace(self, fit: Fit) -> bool:
        """Tell whether a quick fit by other switches promises to be better than the set as it is known."""
        known = self.fitted[self.names(fit.parameters)]
        other = key_of(fit.free) != key_of(known.free) and not self.fitter.settled(fit)
        return other and self.priced(fit) - fit.promise < self.priced(known)

    def _limits(self, fits: Iterable[Fit]) -> list[float]:
        """Return the highest costs at which the sets of some fits matter beside the best one that is known."""
        best = min(self.fitted, key=lambda names: self.priced(self.fitted[names]))
        costs = {names: fit.cost for names, fit in self.fitted.items()}
        return [self._limit(self.names(fit.parameters), costs, best) for fit in fits]

    def settle(self, beside: Names, among: Iterable[Names]) -> None:
        """Bring to convergence those of some sets that may matter beside another: what is near, or may come near."""
        costs = {names: fit.cost for names, fit in self.fitted.items()}
        hopes = {names: costs[names] - self.fitted[names].promise for names in among}
        near = [names for names, hope in hopes.items() if hope <= self._limit(names, costs, beside)]
        near = [names for names in near if names and not self.settled(names)]
        self.keep(self.fitter.settle([self.fitted[names] for names in near]))

    def _limit(self, names: Names, costs: Mapping[Names, float], beside: Names) -> float:
        """Return the highest cost at which a set matters beside the best one.

        As one more effect, one that may gain half of what it needs. With fewer effects, one that says what those left
        out gain: as much as the form of all may be wrong is asked of them. In the place of one, a look-alike, whose
        form is compared with that one's alone. In the place of several it matters only where it may be the best.
        """
        size = len(beside)
        leader = min([beside, *(other for other in costs if len(other) == size)], key=lambda other: costs[other])
        least = costs[leader]
        if len(names) > size:
            return least - policy.HALF * (self.price(len(names)) - self.price(size))
        fewer = names <= leader
        beyond = self.fitted.get(frozenset() if fewer else names & leader, self.baseline)
        gain = max(beyond.cost - least, 0.0)
        reach = policy.REACH if fewer or len(leader - names) <= 1 else policy.REACH / 2
        return least + reach * (policy.WIDTH + policy.FORM_ERROR * gain)

    def keep(self, fits: Iterable[Fit]) -> None:
        """Keep the best fit of every set, by whatever switches of its effects; of equal ones the one that came last.

        A quick fit may be at its lowest place already: brought to convergence it has its derivatives there.
        """
        for fit in fits:
            names = self.names(fit.parameters)
            if names not in self.fitted or self.priced(fit) <= self.priced(self.fitted[names]):
                self.fitted[names] = fit
        self.fitter.explained = self.baseline.cost - min(fit.cost for fit in self.fitted.values())
