"""From scores to a model: refit the survivors together with everything else, add what convinces, drop what does not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from dlwpredict.diagnose.candidates import Candidate
from dlwpredict.diagnose.competitor import SINGLE, Beside, Forms
from dlwpredict.diagnose.evidence import WIDTHS, width_rows
from dlwpredict.diagnose.finer import on_own_pixels
from dlwpredict.diagnose.fit import ITERATIONS, Fit, sharing
from dlwpredict.diagnose.library import Library
from dlwpredict.diagnose.refit import done_by, effect_of, from_typical, kept_promise, refit, rested, scouted, without
from dlwpredict.diagnose.screen import Null, Screen
from dlwpredict.effects.base import Effect
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import declarations

MOST_EFFECTS = 3
"""Effects that one diagnosis names at most."""

LEVEL = 0.025
"""Family-wise probability at which noise alone would name an effect; as much is left to the free forms."""

SHORTLIST = 6
"""Effects that are refitted per round."""

RIVALS = 2
"""Of these the best are brought to rest, on pixels of their own, before one is taken."""

INDISTINCT = 9.0
"""An effect may as well be another while that one, refitted in its place, is not this far behind in 2 ln L, in units of
the score's own variance; one that is as far ahead takes its place."""

UNLIKELY = 0.05
"""A focus that the prior of its widths makes less probable than this is taken to have been moved by something else."""

HIDDEN = 5.0
"""Standard deviations that a typical size of an effect stands out before calibration has answered to it, and does not
afterwards: the answer hides it, as a wider focus hides a blur."""

START_SHARE = 0.5
"""Refits start at this share of the linear strength: the full one may overshoot where the law is not linear."""


@dataclass(frozen=True, eq=False)
class Search:
    """The search for the effects that a baseline lacks.

    Parameters
    ----------
    baseline : Fit
    library : Library
    null : Null
    tell : function of str
        Told what was tried.
    workers : Workers
    others : sequence of Fit
        The baseline in higher valleys.
    """

    baseline: Fit
    library: Library
    null: Null
    tell: Callable[[str], None] = lambda text: None
    workers: Workers = ALONE
    others: Sequence[Fit] = ()
    screened: dict[Fit, Screen] = field(default_factory=dict, repr=False)
    tried: dict[Fit, dict[str, Fit]] = field(default_factory=dict, repr=False)
    rested: set[Fit] = field(default_factory=set, repr=False)
    rests: dict[tuple[Fit, str], Fit] = field(default_factory=dict, repr=False)
    places: dict[tuple[Fit, str], dict[str, Fit]] = field(default_factory=dict, repr=False)

    def screen(self, model: Fit) -> Screen:
        """Score every candidate beside a model."""
        if model not in self.screened:
            self.screened[model] = self.library.screen(model, self.null)
        return self.screened[model]

    def select(self, start: Fit | None = None) -> Fit:
        """Grow the model effect by effect while noise cannot explain the next one; then try others in their places.

        The first effect is chosen while the others are missing, and may be the one that best stands in for all of them.
        So the model tries to do without each, and to replace it (sequential replacement; Miller, Subset Selection in
        Regression, 2002).

        Parameters
        ----------
        start : Fit, optional
            A model with effects to begin with, on the same data.

        Returns
        -------
        Fit
            With the named effects among its parameters; the baseline itself where there are none.
        """
        model = self._backward(self._grown(start or self.baseline))
        for _ in range(MOST_EFFECTS):
            other = self._exchanged(model)
            if other is model:
                break
            model = self._backward(self._grown(other))
        return model

    def more(self, model: Fit) -> bool:
        """Tell whether some effect scores beside a model as noise hardly ever makes one."""
        scores = self.screen(model)
        return scores.p_value(np.abs(scores.z).max()) <= LEVEL

    def _grown(self, model: Fit) -> Fit:
        """Add effects, one by one, while noise cannot explain the next one."""
        while len(self.added(model)) < MOST_EFFECTS:
            if not self.more(model) and not self.hidden(model):
                break
            tried = self._from_every_valley() if model is self.baseline else self.refits(model)
            for name in _ordered(tried)[:RIVALS]:
                tried[name] = self.at_rest(tried[name])
            convincing = [grown for grown in tried.values() if self.convinces(grown, model)]
            if not convincing:
                break
            model = min(convincing, key=_weighed)
        return model

    def _from_every_valley(self) -> dict[str, Fit]:
        """Return, by name, the likeliest of the refits that begin at the baseline or in a higher valley of it.

        A quick refit reaches what lies near; the valley of what is missing need not be that of the lowest baseline.
        """
        return _likelier(*(self.refits(one) for one in (self.baseline, *self.others)))

    def _exchanged(self, model: Fit) -> Fit:
        """Return the likeliest model with another effect in the place of one, or the model itself."""
        here = _weighed(model)
        found = {model: here}
        for effect in self.added(model):
            rest, tried = self.rest(model, effect.name), self.instead(model, effect)
            ahead = INDISTINCT * self.spread(rest, effect.name) ** 2
            for name in _ordered(tried)[:RIVALS]:
                if _weighed(tried[name]) < here + ahead:
                    tried[name] = self.at_rest(tried[name])
            found |= {one: _weighed(one) + ahead for one in tried.values() if self.convinces(one, rest)}
        return min(found, key=found.__getitem__)

    def at_rest(self, found: Fit) -> Fit:
        """Bring a refit to rest, on pixels of its own."""
        if found not in self.rested:
            found = on_own_pixels(rested(found, self.workers), self.workers)
            self.rested.add(found)
        return found

    def convinces(self, grown: Fit, model: Fit) -> bool:
        """Tell whether the last effect gains enough, with a strength whose 95 % interval leaves out its off value.

        The limit is that of one strength; whatever else it moves must bring its own 2 (Akaike 1974).
        """
        name, shapes = grown.parameters.effects[-1].name, len(grown.free.names) - len(model.free.names) - 1
        gain = model.chi2 - grown.chi2 - 2 * shapes
        return gain > self._least(model, name) and self._stands(grown, name)

    def _stands(self, grown: Fit, name: str) -> bool:
        """Tell whether the 95 % interval of any strength of an effect leaves out its off value."""
        effect, sd = effect_of(grown, name), self.null.deviations(grown)
        for switch in effect.switches():
            k = grown.free.index(f"{name}.{switch}")
            if k is not None and abs(grown.point.vector[k] - declarations(effect)[switch][0]) > 1.96 * sd[k]:
                return True
        return False

    def idle(self, model: Fit) -> str:
        """Return an effect of a model that nothing says is there, now that all else is at rest; "" if all are."""
        return next((effect.name for effect in self.added(model) if not self._stands(model, effect.name)), "")

    def _suffices(self, grown: Fit) -> bool:
        """Tell whether one effect explains all that there is beside the baseline, by scores and by free forms."""
        if not self.convinces(grown, self.baseline) or self.more(grown):
            return False
        return Beside.of(grown, Forms.of(self.baseline).columns, self.null).energy().p_value >= SINGLE

    def _least(self, model: Fit, name: str) -> float:
        """Return the gain in 2 ln L that an effect must bring: what noise and numerics together hardly ever give."""
        return (self.screen(model).threshold(LEVEL) * self.spread(model, name)) ** 2

    def spread(self, model: Fit, name: str) -> float:
        """Return the standard deviation of an effect's best score beside a model, 1 for exactly known white noise."""
        scores = self.screen(model)
        return float(scores.spread[self.library.best(scores, name)])

    def rest(self, model: Fit, name: str) -> Fit:
        """Return the model without one of the effects that it was given, at rest: else its gain is not all its own."""
        if len(self.added(model)) < 2:
            return self.baseline
        if (model, name) not in self.rests:
            self.rests[model, name] = self.at_rest(without(model, name))
        return self.rests[model, name]

    def instead(self, model: Fit, effect: Effect) -> dict[str, Fit]:
        """Refit in an effect's place what scores best there, and what it is declared to be confused with."""
        if (model, effect.name) not in self.places:
            tried = self.refits(self.rest(model, effect.name), model.chi2)
            others = self._in_place(model, effect, set(tried) | self._look_alikes(effect))
            likelier = _likelier(tried, others)
            self.places[model, effect.name] = {name: one for name, one in likelier.items() if name != effect.name}
        return self.places[model, effect.name]

    def _in_place(self, model: Fit, effect: Effect, names: Set[str]) -> dict[str, Fit]:
        """Refit others in an effect's place from where the model is, as strong as does most nearly what it did there.

        Without the effect all else moves far away to make up for it, and another one need not find the way back.
        """
        columns = self.library.columns - model.nuisances @ (model.nuisances.T @ self.library.columns)
        sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        along = columns.T @ done_by(model, effect.name) / sizes
        allowed = np.where((self.library.signs == 0) | (np.sign(along) == self.library.signs), np.abs(along), 0.0)
        present = {one.name for one in model.parameters.effects}
        jobs = {}
        for k in np.argsort(-allowed):
            one = self.library.chosen[k]
            if one.name in names - present and allowed[k] > 0:
                jobs.setdefault(one.name, (model, one, along[k] / sizes[k], ITERATIONS, effect.name))
        found = self._each(refit, jobs)
        self._told(self.rest(model, effect.name), found, f"in place of {effect.name}")
        return found

    def added(self, model: Fit) -> list[Effect]:
        """Return the effects that a model has and the baseline has not."""
        known = {effect.name for effect in self.baseline.parameters.effects}
        return [effect for effect in model.parameters.effects if effect.name not in known]

    def refits(self, model: Fit, goal: float | None = None) -> dict[str, Fit]:
        """Refit the effects that score best, each from its best shape, together with all that the model has.

        Where the best of them does not explain all that the baseline lacks, the others are tried as well. A quick refit
        that does not bring what the score has promised is done with more care, if that goes half way to the best one.

        Parameters
        ----------
        model : Fit
        goal : float, optional
            −2 ln L of the best, where that is known already and need not be searched.
        """
        if model not in self.tried:
            scores = self.screen(model)
            chosen = self._shortlist(scores)
            starts = {name: (model, self.library.chosen[k], START_SHARE * scores.amplitude[k])
                      for name, k in chosen.items()}  # fmt: skip
            quick = self._each(refit, starts)
            tried = dict(quick)
            if goal is None and model is self.baseline and self.more(model):
                tried |= self._others(tried)
            if goal is not None or not self._restored(model, tried):
                tried |= self._each(from_typical, self._absorbed(model, tried))
            if goal is None:
                goal = min(found.chi2 for found in tried.values())
            bars = {name: model.chi2 - (scores.z[k] * scores.spread[k]) ** 2 for name, k in chosen.items()}
            half = (goal + model.chi2) / 2
            broken = [name for name, bar in bars.items() if bar < min(half, tried[name].chi2)]
            tried |= self._each(kept_promise, {name: (*starts[name], quick[name], bars[name]) for name in broken})
            self._told(model, tried)
            self.tried[model] = tried
        return self.tried[model]

    def _each(self, work: Callable[..., Fit], jobs: Mapping[str, tuple]) -> dict[str, Fit]:
        """Let the workers make a fit for every name; jobs begin with the model that it grows from."""
        found = self.workers.each(work, list(jobs.values()))
        return {name: sharing(one, jobs[name][0].data) for name, one in zip(jobs, found, strict=True)}

    def _shortlist(self, scores: Screen) -> dict[str, int]:
        """Return the effects that score at least half the best score, each with its best candidate."""
        strength, chosen = np.abs(scores.z), {}
        order = np.argsort(-strength)
        for k in order:
            if strength[k] >= max(0.5 * strength[order[0]], 1e-9) and len(chosen) < SHORTLIST:
                chosen.setdefault(self.library.chosen[k].name, int(k))
        return chosen

    def hidden(self, model: Fit) -> list[int]:
        """Return the candidates, one per effect, that calibration may have answered to with a focus that is none."""
        if model is not self.baseline or not _strange(model):
            return []
        scores = self.screen(model)
        whole = np.linalg.norm(self.library.columns, axis=0) / scores.spread
        absorbed = np.flatnonzero((whole >= HIDDEN) & (scores.visible < HIDDEN))
        return sorted({self.library.best(scores, self.library.chosen[k].name) for k in absorbed})

    def _absorbed(self, model: Fit, tried: Mapping[str, Fit]) -> dict[str, tuple[Fit, Candidate, float]]:
        """Return the hidden effects that were not tried, with where their refits start."""
        chosen = [(self.library.chosen[k], float(self.library.signs[k])) for k in self.hidden(model)]
        return {one.name: (model, one, sign) for one, sign in chosen if one.name not in tried}

    def _restored(self, model: Fit, tried: Mapping[str, Fit]) -> bool:
        """Tell whether the best refit convinces, and has a likely focus: what calibration had answered to is found."""
        best = min(tried.values(), key=_weighed, default=model)
        return best is not model and not _strange(best) and self.convinces(best, model)

    def _others(self, tried: dict[str, Fit]) -> dict[str, Fit]:
        """Bring the best refit beside the baseline to rest; where it does not suffice, try the rest of the library.

        What tangents take nearly whole, as a shift takes a lag, shows only where it bends.
        """
        first = _ordered(tried)[0]
        best = self.at_rest(tried[first])
        if self._suffices(best):
            return {first: best}
        others = {candidate.name for candidate in self.library.chosen} - set(tried)
        found = {first: best} | self._scouts(self.baseline, others, best.chi2)
        first = _ordered(found)[0]
        return found | {first: self.at_rest(found[first])}

    def _told(self, model: Fit, tried: Mapping[str, Fit], what: str = "refits") -> None:
        self.tell(f"{what}: " + ", ".join(f"{name} {model.chi2 - found.chi2:.0f}" for name, found in tried.items()))

    def _look_alikes(self, effect: Effect) -> set[str]:
        """Return the names of what is declared to be confused with an effect."""
        return {
            candidate.name
            for candidate in self.library.chosen
            if candidate.name in effect.confused_with or effect.name in candidate.effect.confused_with
        }

    def _scouts(self, model: Fit, names: Set[str], best: float) -> dict[str, Fit]:
        """Refit effects from their typical size, those only that soon come half way to the best −2 ln L."""
        scores, ordered = self.screen(model), sorted(names)
        chosen = [self.library.best(scores, name) for name in ordered]
        bar = (best + model.chi2) / 2
        jobs = [(model, self.library.chosen[k], float(self.library.signs[k]), bar) for k in chosen]
        tried = dict(zip(ordered, self.workers.each(scouted, jobs), strict=True))
        found = {name: sharing(one, model.data) for name, one in tried.items() if one is not None}
        self._told(model, found)
        return found

    def _backward(self, model: Fit) -> Fit:
        """Drop effects that the later ones have made unnecessary."""
        for effect in self.added(model):
            if len(self.added(model)) < 2:
                break
            fewer = self.rest(model, effect.name)
            if fewer.chi2 - model.chi2 < self._least(fewer, effect.name):
                model = fewer
        return model


def _strange(model: Fit) -> bool:
    """Tell whether a focus is unlikely by the prior of its widths."""
    rows = dict(zip(WIDTHS, width_rows(model.parameters, model.free.names)[0], strict=True))
    focus = [row for name, row in rows.items() if name.startswith("exposure") and name in model.free.names]
    return stats.chi2.sf(np.sum(np.square(focus)), max(len(focus), 1)) < UNLIKELY


def _weighed(found: Fit) -> float:
    """Return −2 ln L, and 2 for everything that is free (Akaike 1974)."""
    return found.chi2 + 2 * len(found.free.names)


def _likelier(*tried: Mapping[str, Fit]) -> dict[str, Fit]:
    """Return all names, each with the likeliest of its refits."""
    names = dict.fromkeys(name for some in tried for name in some)
    return {name: min((some[name] for some in tried if name in some), key=_weighed) for name in names}


def _ordered(tried: Mapping[str, Fit]) -> list[str]:
    """Return names, the likeliest first."""
    return sorted(tried, key=lambda name: _weighed(tried[name]))
