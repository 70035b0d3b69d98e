"""Attempts: what is refitted beside a model, in the place of one of its effects, and with how much care."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field

import numpy as np

from dlwpredict.diagnose.candidates import Candidate
from dlwpredict.diagnose.finer import on_own_pixels
from dlwpredict.diagnose.fit import ITERATIONS, Fit, sharing
from dlwpredict.diagnose.judge import Judge, strange, weighed
from dlwpredict.diagnose.library import Library
from dlwpredict.diagnose.refit import done_by, from_typical, kept_promise, refit, rested, scouted, without
from dlwpredict.diagnose.screen import Screen
from dlwpredict.effects.base import Effect
from dlwpredict.parallel import ALONE, Workers

SHORTLIST = 6
"""Effects that are refitted per round."""

START_SHARE = 0.5
"""Refits start at this share of the linear strength: the full one may overshoot where the law is not linear."""


@dataclass(frozen=True, eq=False)
class Attempts:
    """Refits of effects that a baseline may lack, each made once.

    Parameters
    ----------
    judge : Judge
    tell : function of str
        Told what was tried.
    workers : Workers
    others : sequence of Fit
        The baseline in higher valleys.
    """

    judge: Judge
    tell: Callable[[str], None] = lambda text: None
    workers: Workers = ALONE
    others: Sequence[Fit] = ()
    tried: dict[Fit, dict[str, Fit]] = field(default_factory=dict, repr=False)
    rested: set[Fit] = field(default_factory=set, repr=False)
    rests: dict[tuple[Fit, str], Fit] = field(default_factory=dict, repr=False)
    places: dict[tuple[Fit, str], dict[str, Fit]] = field(default_factory=dict, repr=False)

    @property
    def library(self) -> Library:
        """All effects that the baseline may lack."""
        return self.judge.library

    def at_rest(self, found: Fit) -> Fit:
        """Bring a refit to rest, on pixels of its own."""
        if found not in self.rested:
            found = on_own_pixels(rested(found, self.workers), self.workers)
            self.rested.add(found)
        return found

    def rest(self, model: Fit, name: str) -> Fit:
        """Return the model without one of the effects that it was given, at rest: else its gain is not all its own."""
        if len(self.judge.added(model)) < 2:
            return self.judge.baseline
        if (model, name) not in self.rests:
            self.rests[model, name] = self.at_rest(without(model, name))
        return self.rests[model, name]

    def from_every_valley(self) -> dict[str, Fit]:
        """Return, by name, the likeliest of the refits that begin at the baseline or in a higher valley of it.

        A quick refit reaches what lies near; the valley of what is missing need not be that of the lowest baseline.
        """
        return _likelier(*(self.refits(one) for one in (self.judge.baseline, *self.others)))

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
            scores = self.judge.screen(model)
            chosen = self._shortlist(scores)
            starts = {name: (model, self.library.chosen[k], START_SHARE * scores.amplitude[k])
                      for name, k in chosen.items()}  # fmt: skip
            quick = self._each(refit, starts)
            tried = dict(quick)
            if goal is None and model is self.judge.baseline and self.judge.more(model):
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

    def instead(self, model: Fit, effect: Effect) -> dict[str, Fit]:
        """Refit in an effect's place what scores best there, and what it is declared to be confused with."""
        if (model, effect.name) not in self.places:
            tried = self.refits(self.rest(model, effect.name), model.chi2)
            others = self.in_place(model, effect, set(tried) | self._look_alikes(effect))
            likelier = _likelier(tried, others)
            self.places[model, effect.name] = {name: one for name, one in likelier.items() if name != effect.name}
        return self.places[model, effect.name]

    def in_place(self, model: Fit, effect: Effect, names: Set[str]) -> dict[str, Fit]:
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

    def _shortlist(self, scores: Screen) -> dict[str, int]:
        """Return the effects that score at least half the best score, each with its best candidate."""
        strength, chosen = np.abs(scores.z), {}
        order = np.argsort(-strength)
        for k in order:
            if strength[k] >= max(0.5 * strength[order[0]], 1e-9) and len(chosen) < SHORTLIST:
                chosen.setdefault(self.library.chosen[k].name, int(k))
        return chosen

    def _absorbed(self, model: Fit, tried: Mapping[str, Fit]) -> dict[str, tuple[Fit, Candidate, float]]:
        """Return the hidden effects that were not tried, with where their refits start."""
        chosen = [(self.library.chosen[k], float(self.library.signs[k])) for k in self.judge.hidden(model)]
        return {one.name: (model, one, sign) for one, sign in chosen if one.name not in tried}

    def _restored(self, model: Fit, tried: Mapping[str, Fit]) -> bool:
        """Tell whether the best refit convinces, and has a likely focus: what calibration had answered to is found."""
        best = min(tried.values(), key=weighed, default=model)
        return best is not model and not strange(best) and self.judge.convinces(best, model)

    def _others(self, tried: dict[str, Fit]) -> dict[str, Fit]:
        """Bring the best refit beside the baseline to rest; where it does not suffice, try the rest of the library.

        What tangents take nearly whole, as a shift takes a lag, shows only where it bends.
        """
        first = ordered(tried)[0]
        best = self.at_rest(tried[first])
        if self.judge.suffices(best):
            return {first: best}
        others = {candidate.name for candidate in self.library.chosen} - set(tried)
        found = {first: best} | self._scouts(self.judge.baseline, others, best.chi2)
        first = ordered(found)[0]
        return found | {first: self.at_rest(found[first])}

    def _scouts(self, model: Fit, names: Set[str], best: float) -> dict[str, Fit]:
        """Refit effects from their typical size, those only that soon come half way to the best −2 ln L."""
        scores, every = self.judge.screen(model), sorted(names)
        chosen = [self.library.best(scores, name) for name in every]
        bar = (best + model.chi2) / 2
        jobs = [(model, self.library.chosen[k], float(self.library.signs[k]), bar) for k in chosen]
        tried = dict(zip(every, self.workers.each(scouted, jobs), strict=True))
        found = {name: sharing(one, model.data) for name, one in tried.items() if one is not None}
        self._told(model, found)
        return found

    def _look_alikes(self, effect: Effect) -> set[str]:
        """Return the names of what is declared to be confused with an effect."""
        return {
            candidate.name
            for candidate in self.library.chosen
            if candidate.name in effect.confused_with or effect.name in candidate.effect.confused_with
        }

    def _each(self, work: Callable[..., Fit], jobs: Mapping[str, tuple]) -> dict[str, Fit]:
        """Let the workers make a fit for every name; jobs begin with the model that it grows from."""
        found = self.workers.each(work, list(jobs.values()))
        return {name: sharing(one, jobs[name][0].data) for name, one in zip(jobs, found, strict=True)}

    def _told(self, model: Fit, tried: Mapping[str, Fit], what: str = "refits") -> None:
        self.tell(f"{what}: " + ", ".join(f"{name} {model.chi2 - found.chi2:.0f}" for name, found in tried.items()))


def _likelier(*tried: Mapping[str, Fit]) -> dict[str, Fit]:
    """Return all names, each with the likeliest of its refits."""
    names = dict.fromkeys(name for some in tried for name in some)
    return {name: min((some[name] for some in tried if name in some), key=weighed) for name in names}


def ordered(tried: Mapping[str, Fit]) -> list[str]:
    """Return names, the likeliest first."""
    return sorted(tried, key=lambda name: weighed(tried[name]))
