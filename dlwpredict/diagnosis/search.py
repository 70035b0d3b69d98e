"""The search: linearise, enumerate sets of effects, refit the leading ones; again from the best, until it stays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.candidates import Placed
from dlwpredict.diagnosis.library.process_form import standing
from dlwpredict.diagnosis.library.score import Linearised, Thresholds, thresholds
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.diagnosis.posterior import Sets, Subset
from dlwpredict.diagnosis.starts import behind_widths, beside
from dlwpredict.infer.fitter import Fitter, Start
from dlwpredict.infer.model import Key, effect_of, key_of, lacking, on, switched
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit
from dlwpredict.parameters import ParameterSet

Names = frozenset[str]


@dataclass(eq=False)
class Search:
    """Sets of effects beside a baseline, refitted.

    Parameters
    ----------
    fitter : Fitter
    null : Null
    baseline : Fit
    signatures : dict
        Signatures by the model that they were taken at: they outlive a noise model.
    places : mapping of str to sequence of dict
        Where an effect may sit.
    place_price : dict
        Name to what choosing its place costs, 2 ln L.
    fitted : dict
        Best fits by names of their effects, the baseline's own aside.
    spread : dict
        Name to the standard deviation of scores along what the effect does.
    reduced : set
        Sets and names that reduced models were begun from.
    stood : dict
        Fits of sets, and the share of each name's gain that stands beside the doubts about the process's own form.
    """

    fitter: Fitter
    null: Null
    baseline: Fit
    signatures: dict[Key, Signatures]
    places: Placed = field(default_factory=dict)
    place_price: dict[str, float] = field(default_factory=dict)
    fitted: dict[Names, Fit] = field(default_factory=dict)
    spread: dict[str, float] = field(default_factory=dict)
    stood: dict[Names, tuple[Fit, dict[str, float]]] = field(default_factory=dict)
    reduced: set[tuple[Names, str]] = field(default_factory=set)
    first: Linearised = field(init=False)
    asked: Thresholds = field(init=False)
    screens: dict[Names, Linearised] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.fitted[frozenset()] = self.baseline
        self.first = self.screen(frozenset())
        self.asked = thresholds(self.first, policy.LEVEL_NAMES, policy.LEVEL_NEXT, policy.INFLATED)

    def begin_with(self, earlier: Iterable[Start]) -> None:
        """Refit sets that an earlier search, with another noise model, ended among: its best, and what comes near."""
        self._refit(start for start in earlier if self.names(start.parameters))

    def round(self) -> Names:
        """Refit the leading sets beside the best one; return the names of the best set then.

        Quick fits are enough to find a better set. Where none is, those that come near are brought to convergence, and
        effects are looked for whose place a width has taken.
        """
        before = self.rested()
        known = self.key(before)
        sets = Sets.of(self.screen(before), self.price)
        model = self.fitted[before]
        leading = sets.leading(before, self.width_of_set(before))
        starts = [start for subset in leading for start in self._starts(model, sets, subset)]
        self._refit(start for start in starts if not self.fitter.has(start))
        best = self.rested()
        if self.key(best) == known:
            self._settle(before)
            best = self.rested()
        if self.key(best) == known:
            self._refit(self._behind_widths(model, sets.screen))
            self._settle(before)
            best = self.rested()
        return best

    def _behind_widths(self, model: Fit, screen: Linearised) -> list[Start]:
        """Return starts for effects whose place a width may have taken, of sets that are not converged."""
        starts = behind_widths(model, screen, self.fitter, self.baseline)
        return [start for start in starts if self.fitter.reopened(start)]

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
        return fit.cost + self.price(sum(on(fit.parameters, name) for name in own)) + self._placing(own)

    def _placing(self, names: Names) -> float:
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

    def near(self, best: Names) -> list[Start]:
        """Return where the best fit is, and those that come near it: another noise model might prefer them.

        The quick fit of a first effect may fall short where its law bends; it is near with a share of the gain.
        """
        here, gain = self.fitted[best].cost, self.baseline.cost - self.fitted[best].cost
        limit = here + max(self.width_of_set(best), policy.SHORT * gain if len(best) == 1 else 0.0)
        reduced = [best - {name} for name in sorted(best)]
        others = [names for names in self.fitted if names != best]
        near = [names for names in others if self.fitted[names].cost <= limit or names in reduced]
        starts = [self._start(names) for names in (best, *near)]
        return [start for start in starts if self._on(start) is start]  # others are those of a smaller set

    def _start(self, names: Names) -> Start:
        """Return a set as it was fitted, as a start."""
        fit = self.fitted[names]
        return Start(fit.parameters, settled=self._settled(names))

    def width_of_set(self, names: Names) -> float:
        """Return how far in 2 ln L a refit may stay behind a set and still be looked at."""
        gain = max(self.baseline.cost - self.fitted[names].cost, 0.0)
        return policy.REACH * (policy.WIDTH + policy.FORM_ERROR * gain)

    def promised(self, names: Names) -> float:
        """Return the 2 ln L that the best other set brings, larger or not: as refitted, to first order where it is not.

        Infinite beside a set that no effect is added to any more.
        """
        if len(names) == policy.MOST_EFFECTS:
            return np.inf
        screen, cost = self.screen(names), self.fitted[names].cost
        others = [one for one in Sets.of(screen, self.price).ranked if one.names != names]
        ends = [self.fitted[one.names].cost if one.names in self.fitted else screen.cost - one.gain for one in others]
        gains = [cost - end - self._placing(one.names) for one, end in zip(others, ends, strict=True)]
        return max(gains, default=0.0)

    def key(self, names: Names) -> Key:
        """Return what model the best fit of a set is: the same names by other switches are another."""
        return key_of(self.fitted[names].free)

    def screen(self, names: Names) -> Linearised:
        """Linearise about the best fit of a set, once."""
        if names not in self.screens or self.screens[names].model is not self.fitted[names]:
            self.screens[names] = self.linearised(names)
        return self.screens[names]

    def linearised(self, names: Names) -> Linearised:
        """Linearise about the best fit of a set; signatures are taken there once."""
        model, key = self.fitted[names], self.key(names)
        if key not in self.signatures:
            objective = self.fitter.objective
            for earlier in self.signatures.keys() - {self.key(frozenset())}:
                del self.signatures[earlier]  # they are large, and a model that was left is seldom come back to
            self.signatures[key] = Signatures.of(model, sorted(names), objective.work, self.fitter.workers, self.places)
        screen = Linearised.of(self.signatures[key], model, self.null, self.fitter.objective)
        for k in np.argsort(np.abs(screen.z), kind="stable"):
            self.spread[screen.chosen[k].name] = float(screen.spread[k])
        self.spread |= dict(zip(screen.named, map(float, screen.named_spread), strict=True))
        return screen

    def best(self) -> Names:
        """Return the set of least cost in which every effect gains what noise and numerics hardly ever give it.

        Reduced models that have to be fitted for that are sets as well, and may be the best.
        """
        found: Names = frozenset()
        known: dict[Names, Fit] = {}
        while known != self.fitted:
            known = dict(self.fitted)
            order = sorted(self.fitted, key=lambda names: self.priced(self.fitted[names]))
            found = next(names for names in order if self._admissible(names))
        return found

    def rested(self) -> Names:
        """Return the best set, brought to convergence where only its quick fit was known.

        Each of its names stands beside what the form of the process itself may be wrong by. That is asked of a quick
        fit first, so that a set which does not stand is not brought to convergence.
        """
        best = self.best()
        while best and not (self._settled(best) and self.stood.get(best, (None,))[0] is self.fitted[best]):
            if self._has_stood(best) and not self._settled(best):
                self.converged(best)
            else:
                model = self.fitter.objective.whole(self.fitted[best])
                self.stood[best] = self.fitted[best], standing(model, sorted(best), self.fitter.objective)
            best = self.best()
        return best

    def _has_stood(self, names: Names) -> bool:
        """Tell whether the doubts about the process's own form were asked of a set where it is fitted, or very near."""
        if names not in self.stood:
            return False
        asked, now = self.stood[names][0], self.fitted[names]
        return asked.free.names == now.free.names and asked.cost - now.cost < policy.WIDTH

    def _cannot_stand(self, names: Names) -> bool:
        """Tell whether a set will not stand beside these doubts however far its fit may still go down."""
        if not self._has_stood(names) or any(names - {name} not in self.fitted for name in names):
            return False
        shares, promise, cost = self.stood[names][1], self.fitted[names].promise, self.fitted[names].cost
        gains = {name: self.fitted[names - {name}].cost - cost + promise for name in names}
        return any(shares[name] * gains[name] < self.needed(names, name) for name in names)

    def converged(self, names: Names) -> Fit:
        """Return the fit of a set, brought to convergence where only its quick fit was known."""
        if names:
            self.fitted[names] = self.fitter.best(Start(self.fitted[names].parameters))
        return self.fitted[names]

    def names(self, parameters: ParameterSet) -> Names:
        """Return the names of the effects that the baseline has not."""
        own = {effect.name for effect in self.baseline.parameters.effects}
        return frozenset(effect.name for effect in parameters.effects) - own

    def without(self, names: Names, name: str) -> Fit:
        """Return the reduced model: the best fit of a set without one of its effects.

        It is begun where the set was fitted, whatever other quick fit of it there is: that may be far above its best,
        and the effect would seem to gain what is only missing there.
        """
        start = self._on(Start(lacking(self.fitted[names].parameters, [name]), self.fitted[names]))
        fewer = self.names(start.parameters)
        if (names, name) not in self.reduced and not (fewer in self.fitted and self._settled(fewer)):
            self.reduced.add((names, name))
            if fewer not in self.fitted or self.fitter.reopened(start):
                self._refit([start])
        self._settle(names, [fewer])
        return self.fitted[fewer]

    def _settled(self, names: Names) -> bool:
        """Tell whether the best fit of a set is known, not only a quick one."""
        return self.fitter.settled(self.fitted[names])

    def gain(self, names: Names, name: str) -> float:
        """Return the 2 ln L that an effect of a set brings beside the others."""
        return self.without(names, name).cost - self.fitted[names].cost

    def surely(self, names: Names, name: str) -> float:
        """Return the part of a gain that the process's own form cannot have; all of it of a set not looked at yet."""
        _, shares = self.stood.get(names, (None, {}))
        return shares.get(name, 1.0) * self.gain(names, name)

    def doubted(self, best: Names) -> list[str]:
        """Return the effects, the likeliest first, that would gain enough beside a set were all forms sure.

        Those of the process itself, or that of the strongest effect of the set. And what cannot be told from them.
        """
        more = [names for names in self.fitted if names > best and len(names) == len(best) + 1]
        own = [names for names in more if names in self.stood and not self._admissible(names)]
        own = [names for names in own if all(self.gain(names, one) >= self.needed(names, one) for one in sorted(names))]
        short = [names for names in more if self._lacks_form_error(best, names)]
        least = min((self.fitted[names].cost for names in (*own, *short)), default=-np.inf)
        limit = least + policy.WIDTH + policy.FORM_ERROR * (self.fitted[best].cost - least)
        like = [names for names in more if self.fitted[names].cost <= limit]
        names = sorted({*own, *short, *like}, key=lambda names: self.fitted[names].cost)
        return [name for one in names for name in sorted(one - best)]

    def _lacks_form_error(self, best: Names, names: Names) -> bool:
        """Tell whether one more effect gains what noise hardly ever gives any, but what a form may be wrong by."""
        (name,) = names - best
        gain = self.fitted[best].cost - self.fitted[names].cost
        noise = self.asked.first * self.spread.get(name, 1.0) ** 2
        return bool(best) and noise <= gain < self.needed(names, name)

    def width(self, gain: float, name: str, left: float = 0.0) -> float:
        """Return the temperature of a slot: how many times farther apart than by noise two names must be.

        By as much more as the spread along the effect is larger; by what the form of an effect may be wrong, a share of
        its gain; and by what is left without a name, which may have tipped the balance.
        """
        return self.spread.get(name, 1.0) ** 2 + (policy.FORM_ERROR * gain + left) / policy.WIDTH

    def _admissible(self, names: Names) -> bool:
        """Tell whether every effect of a set gains its own; no reduced model is unknown then, for one may be better."""
        stands = all(self.surely(names, name) >= self.needed(names, name) for name in sorted(names))
        for name in sorted(names):
            if names - {name} not in self.fitted:
                self.without(names, name)
        return stands

    def _starts(self, model: Fit, sets: Sets, subset: Subset) -> list[Start]:
        """Return where the refit of a set begins: what stays of the model, as fitted alone, with what comes in."""
        alone = self.fitted.get(frozenset(subset.kept), model)
        return beside(alone if alone.nuisances else model, sets, subset, self.fitter, self.baseline)

    def _refit(self, starts: Iterable[Start]) -> None:
        """Refit models quickly; the same effects by other switches are another model."""
        models: dict[Key, list[Start]] = defaultdict(list)
        for start in map(self._on, starts):
            models[key_of(self.fitter.free(start.parameters))].append(start)
        fits = list(self.fitter.contest(list(models.values())).values())
        self._keep(fits)
        self._keep(self.fitter.settle([fit for fit in fits if self._may_replace(fit)]))

    def _on(self, start: Start) -> Start:
        """Return a start without the effects that a fit has put to nothing: it is one of the smaller set."""
        named = self.names(start.parameters)
        off = [name for name in sorted(named) if not switched(effect_of(start.parameters, name))]
        return replace(start, parameters=lacking(start.parameters, off)) if off else start

    def _may_replace(self, fit: Fit) -> bool:
        """Tell whether a quick fit by other switches promises to be better than the set as it is known."""
        known = self.fitted[self.names(fit.parameters)]
        other = fit.free.names != known.free.names and not self.fitter.settled(fit)
        return other and self.priced(fit) - fit.promise < self.priced(known)

    def _settle(self, beside: Names, among: Iterable[Names] | None = None) -> None:
        """Bring to convergence what may matter beside a set, of all sets or of some: what is near, or may come near."""
        costs = {names: fit.cost for names, fit in self.fitted.items()}
        hopes = {names: costs[names] - self.fitted[names].promise for names in among or costs}
        near = [names for names, hope in hopes.items() if hope <= self._limit(names, costs, beside)]
        near = [names for names in near if names and not self._settled(names)]
        near = [names for names in near if len(names) <= len(beside) or not self._cannot_stand(names)]
        self._keep(self.fitter.settle([self.fitted[names] for names in near]))

    def _limit(self, names: Names, costs: Mapping[Names, float], beside: Names) -> float:
        """Return the highest cost at which a set matters beside the best one.

        In the place of an effect, one that comes near; as one more, one that may gain half of what it needs.
        """
        size = max(len(beside), 1)
        least = min([self.fitted[beside].cost, *(cost for other, cost in costs.items() if len(other) == size)])
        more = len(names) - size
        if more > 0:
            return least - policy.HALF * (self.price(len(names)) - self.price(size))
        gain = max(self.baseline.cost - least, 0.0)
        return least + policy.REACH * (policy.WIDTH + policy.FORM_ERROR * gain)

    def _keep(self, fits: Iterable[Fit]) -> None:
        """Keep the best fit of every set, by whatever switches of its effects; of equal ones the one that came last.

        A quick fit may be at its lowest place already: brought to convergence it has its derivatives there.
        """
        for fit in fits:
            names = self.names(fit.parameters)
            if names not in self.fitted or self.priced(fit) <= self.priced(self.fitted[names]):
                self.fitted[names] = fit
