"""The search: linearise, enumerate sets of effects, refit the leading ones; again from the best, until it stays.

What is best is what costs least, beside what the form of the process itself may be wrong by, among the sets whose
effects may all stand: each gains what it needs, by more than such an error may have of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.process_form import Standing, standing
from dlwpredict.diagnosis.library.score import Linearised
from dlwpredict.diagnosis.posterior import Sets, Subset
from dlwpredict.diagnosis.refits import Names, Refits
from dlwpredict.diagnosis.starts import behind_widths, beside
from dlwpredict.infer.fitter import Start
from dlwpredict.infer.model import key_of
from dlwpredict.infer.objective import Fit


@dataclass(eq=False)
class Search(Refits):
    """Refits that are gone on with until the best set stays.

    Parameters
    ----------
    stood : dict
        Fits of sets, and how they stand beside the doubts about the process's own form.
    """

    stood: dict[Names, tuple[Fit, Standing]] = field(default_factory=dict)

    def begin_with(self, earlier: Iterable[Start]) -> None:
        """Refit sets that an earlier search, with another noise model, ended among: its best, and what comes near."""
        self.refit(start for start in earlier if self.names(start.parameters))

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
        self.refit(start for start in starts if not self.fitter.has(start))
        best = self.rested()
        if self.key(best) == known:
            self._settle_beside(before)
            best = self.rested()
        if self.key(best) == known:
            self.refit(self._behind_widths(model, sets.screen))
            self._settle_beside(before)
            best = self.rested()
        return best

    def _starts(self, model: Fit, sets: Sets, subset: Subset) -> list[Start]:
        """Return where the refit of a set begins: what stays of the model, as fitted alone, with what comes in."""
        alone = self.fitted.get(frozenset(subset.kept), model)
        return beside(alone if alone.nuisances else model, sets, subset, self.fitter, self.baseline)

    def _behind_widths(self, model: Fit, screen: Linearised) -> list[Start]:
        """Return starts for effects whose place a width may have taken, of sets that are not converged."""
        starts = behind_widths(model, screen, self.fitter, self.baseline)
        return [start for start in starts if self.fitter.reopened(start)]

    def _settle_beside(self, best: Names) -> None:
        """Bring to convergence what may matter beside a set, but for larger ones that will not stand."""
        self.settle(best, [one for one in self.fitted if len(one) <= len(best) or not self._cannot_stand(one)])

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
        return [start for start in starts if self.stripped(start) is start]  # others are those of a smaller set

    def _start(self, names: Names) -> Start:
        """Return a set as it was fitted, as a start."""
        fit = self.fitted[names]
        return Start(fit.parameters, settled=self.settled(names))

    def promised(self, names: Names) -> float:
        """Return the 2 ln L that the best other set brings, larger or not: as refitted, to first order where it is not.

        Infinite beside a set that no effect is added to any more.
        """
        if len(names) == policy.MOST_EFFECTS:
            return np.inf
        screen, cost = self.screen(names), self.fitted[names].cost
        others = [one for one in Sets.of(screen, self.price).ranked if one.names != names]
        ends = [self.fitted[one.names].cost if one.names in self.fitted else screen.cost - one.gain for one in others]
        gains = [cost - end - self.placing(one.names) for one, end in zip(others, ends, strict=True)]
        return max(gains, default=0.0)

    def best(self) -> Names:
        """Return the set of least cost beside the doubts in which every effect gains what it needs to stand.

        Reduced models that have to be fitted for that are sets as well, and may be the best.
        """
        found: Names = frozenset()
        known: dict[Names, Fit] = {}
        while known != self.fitted:
            known = dict(self.fitted)
            order = sorted(self.fitted, key=self.beside_doubts)
            found = next(names for names in order if self._admissible(names))
        return found

    def rested(self) -> Names:
        """Return the best set, brought to convergence where only its quick fit was known.

        How it stands beside the doubts about the form of the process is asked of a quick fit first, so that a set which
        does not stand, or costs more than another beside them, is not brought to convergence.
        """
        best = self.best()
        while best and not (self.settled(best) and self._has_stood(best)):
            if self._has_stood(best):
                self.converged(best)
            else:
                self.standing(frozenset())
                self.standing(best)
            best = self.best()
        return best

    def standing(self, names: Names) -> Standing:
        """Return how a set stands beside the doubts about the process's own form, asked once where it is fitted.

        Or very near: to first order the lowest place, of which it tells, is the same from there.
        """
        if not self._has_stood(names):
            model = self.fitter.objective.whole(self.fitted[names])
            self.stood[names] = self.fitted[names], standing(model, sorted(names), self.fitter.objective)
        return self.stood[names][1]

    def beside_doubts(self, names: Names) -> float:
        """Return what a set costs, with the price of its switches, beside the doubts about the process's own form.

        They explain of what a set leaves hardly more than of what any part of it leaves. So a set that they were not
        asked of costs no less than this, and the best one costs least once it was asked itself.
        """
        asked = [names] if names in self.stood else [one for one in self.stood if one < names]
        return self.priced(self.fitted[names]) - min((self.stood[one][1].doubted for one in asked), default=0.0)

    def _admissible(self, names: Names) -> bool:
        """Tell whether every effect of a set gains its own; no reduced model is unknown then, for one may be better."""
        stands = all(self.surely(names, name) >= self.needed(names, name) for name in sorted(names))
        for name in sorted(names):
            if names - {name} not in self.fitted:
                self.without(names, name)
        return stands

    def surely(self, names: Names, name: str) -> float:
        """Return the part of a gain that the process's own form cannot have; all of it of a set not looked at yet."""
        share = self.stood[names][1].shares[name] if names in self.stood else 1.0
        return share * self.gain(names, name)

    def excused(self, best: Names, rival: Names) -> float:
        """Return how much of what a rival costs more than a set the process's own form may have made."""
        return self.standing(best).excuses(self.standing(rival))

    def _has_stood(self, names: Names) -> bool:
        """Tell whether the doubts about the process's own form were asked of a set where it is fitted, or very near."""
        if names not in self.stood:
            return False
        asked, now = self.stood[names][0], self.fitted[names]
        return key_of(asked.free) == key_of(now.free) and asked.cost - now.cost < policy.WIDTH

    def _cannot_stand(self, names: Names) -> bool:
        """Tell whether a set will not stand beside these doubts however far its fit may still go down."""
        if not self._has_stood(names) or any(names - {name} not in self.fitted for name in names):
            return False
        shares, promise, cost = self.stood[names][1].shares, self.fitted[names].promise, self.fitted[names].cost
        gains = {name: self.fitted[names - {name}].cost - cost + promise for name in names}
        return any(shares[name] * gains[name] < self.needed(names, name) for name in names)

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
