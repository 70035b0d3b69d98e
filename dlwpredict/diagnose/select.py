"""From scores to a model: refit the survivors together with everything else, add what convinces, drop what does not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dlwpredict.diagnose.around import Around
from dlwpredict.diagnose.candidates import Candidate, matters
from dlwpredict.diagnose.evidence import Whitened, prior_rows, stack
from dlwpredict.diagnose.fit import ITERATIONS, Fit, fit
from dlwpredict.diagnose.screen import Null, Screen, screen
from dlwpredict.effects.base import Effect
from dlwpredict.flat import Free, choose
from dlwpredict.parameters import ParameterSet, declarations

MOST_EFFECTS = 3
"""Effects that one diagnosis names at most."""

LEVEL = 0.025
"""Family-wise probability at which noise alone would name an effect; as much is left to the free forms."""

SHORTLIST = 6
"""Effects that are refitted per round."""

RIVALS = 2
"""Of these the best are brought to rest before one is taken."""

START_SHARE = 0.5
"""Refits start at this share of the linear strength: the full one may overshoot where the law is not linear."""

INDISTINCT = 9.0
"""Two effects stay in one class while the refitted runner-up is not this far behind in 2 ln L, in units of the score's
own variance ..."""

FORM_ERROR = 20**-0.5
"""... nor by the energy of this share of the signature, a twentieth: beside one that explains the rest, a strength has
20 times the variance that it has alone, and no formula is trusted further than that."""

SCOUT = 2
"""Steps of a refit that only looks whether an effect deserves a whole one."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """An effect that would do nearly as well in another one's place.

    Parameters
    ----------
    effect : Effect
        As fitted.
    loss : float
        2 ln L that the model loses with it.
    fit : Fit
        The model with it.
    """

    effect: Effect
    loss: float
    fit: Fit


@dataclass(frozen=True, eq=False)
class Named:
    """An effect in the model, and those that would do nearly as well in its place.

    Parameters
    ----------
    effect : Effect
        As fitted.
    gain : float
        2 ln L that it brings beside the others.
    p_value : float
        Family-wise.
    fit, rest : Fit
        The model with it and without.
    alternatives : tuple of Alternative
        The likeliest first.
    """

    effect: Effect
    gain: float
    p_value: float
    fit: Fit
    rest: Fit
    alternatives: tuple[Alternative, ...] = ()

    @property
    def names(self) -> list[str]:
        """The whole class, most likely first."""
        losses = {self.effect.name: 0.0} | {other.effect.name: other.loss for other in self.alternatives}
        return sorted(losses, key=losses.__getitem__)


@dataclass(frozen=True, eq=False)
class Library:
    """All candidates with their whitened signatures at the baseline.

    Parameters
    ----------
    chosen : list of Candidate
    columns : numpy.ndarray, shape (rows, candidates)
        Whitened change per typical size.
    """

    chosen: list[Candidate]
    columns: np.ndarray

    @classmethod
    def of(cls, around: Around, data: Sequence[Whitened]) -> Library:
        """Whiten the signatures."""
        below = prior_rows(len(data))
        white = [
            stack([item.white(change) for item, change in zip(data, changes, strict=True)], below)
            for changes in around.signatures_um
        ]
        return cls(around.chosen, np.stack(white, axis=1))

    @property
    def signs(self) -> np.ndarray:
        """Sign of the strength, in typical sizes, that alone is physical; 0 where both are."""
        return np.array([candidate.one_sided * np.sign(candidate.unit) for candidate in self.chosen])

    def screen(self, fitted: Fit, null: Null) -> Screen:
        """Score every candidate beside a fit; effects that it has already are left out."""
        present = {effect.name for effect in fitted.parameters.effects}
        absent = np.array([candidate.name not in present for candidate in self.chosen])
        return screen(fitted, self.columns * absent, self.signs, null)


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
    """

    baseline: Fit
    library: Library
    null: Null
    tell: Callable[[str], None] = lambda text: None
    screened: dict[Fit, Screen] = field(default_factory=dict, repr=False)
    tried: dict[Fit, dict[str, Fit]] = field(default_factory=dict, repr=False)

    def screen(self, model: Fit) -> Screen:
        """Score every candidate beside a model."""
        if model not in self.screened:
            self.screened[model] = self.library.screen(model, self.null)
        return self.screened[model]

    def select(self, start: Fit | None = None) -> Fit:
        """Grow the model effect by effect while noise cannot explain the next one; then try to do without each.

        Parameters
        ----------
        start : Fit, optional
            A model with effects to begin with, on the same data.

        Returns
        -------
        Fit
            With the named effects among its parameters; the baseline itself where there are none.
        """
        return self._backward(self._grown(start or self.baseline))

    def widened(self, model: Fit) -> Fit:
        """Choose once more, beside the baseline, among all effects; return the better of the two models."""
        self.tried[self.baseline] = self.refits(self.baseline) | self._scouted()
        return min(model, self._backward(self._grown(self.baseline)), key=_weighed)

    def more(self, model: Fit) -> bool:
        """Tell whether some effect scores beside a model as noise hardly ever makes one."""
        scores = self.screen(model)
        return scores.p_value(np.abs(scores.z).max()) <= LEVEL

    def _grown(self, model: Fit) -> Fit:
        """Add effects, one by one, while noise cannot explain the next one."""
        while len(self.added(model)) < MOST_EFFECTS:
            if not self.more(model):
                break
            scores, tried = self.screen(model), self.refits(model)
            order = sorted(tried, key=lambda name: _weighed(tried[name]))
            for name in order[:RIVALS]:
                tried[name] = _settled(tried[name])
            convincing = [grown for name, grown in tried.items() if _convinces(grown, model, self._least(scores, name))]
            if not convincing:
                break
            model = min(convincing, key=_weighed)
        return model

    def _best(self, scores: Screen, name: str) -> int:
        """Return which of an effect's candidates scores best."""
        own = [k for k, candidate in enumerate(self.library.chosen) if candidate.name == name]
        return max(own, key=lambda k: abs(scores.z[k]))

    def _least(self, scores: Screen, name: str) -> float:
        """Return the gain in 2 ln L that an effect must bring: what noise and numerics together hardly ever give."""
        return (scores.threshold(LEVEL) * scores.spread[self._best(scores, name)]) ** 2

    def added(self, model: Fit) -> list[Effect]:
        """Return the effects that a model has and the baseline has not."""
        known = {effect.name for effect in self.baseline.parameters.effects}
        return [effect for effect in model.parameters.effects if effect.name not in known]

    def refits(self, model: Fit) -> dict[str, Fit]:
        """Refit the effects that score best, each from its best shape, together with all that the model has."""
        if model not in self.tried:
            scores, chosen = self.screen(model), {}
            strength = np.abs(scores.z)
            order = np.argsort(-strength)
            for k in order:
                if strength[k] >= max(0.5 * strength[order[0]], 1e-9) and len(chosen) < SHORTLIST:
                    chosen.setdefault(self.library.chosen[k].name, int(k))
            self.tried[model] = {
                name: refit(model, self.library.chosen[k], START_SHARE * scores.amplitude[k])
                for name, k in chosen.items()
            }
            self._told(model, self.tried[model])
        return self.tried[model]

    def _told(self, model: Fit, tried: Mapping[str, Fit]) -> None:
        self.tell("refits: " + ", ".join(f"{name} {model.chi2 - found.chi2:.0f}" for name, found in tried.items()))

    def _scouted(self) -> dict[str, Fit]:
        """Refit, beside the baseline, effects that the screen has left aside, from their typical size.

        What tangents take nearly whole, as a shift takes a lag, shows only where it bends. A whole refit is for those
        of which a few steps promise half of what the best brings.
        """
        model, scores, found = self.baseline, self.screen(self.baseline), {}
        known = self.refits(model)
        lowest = min(one.chi2 for one in known.values())
        for name in sorted({candidate.name for candidate in self.library.chosen} - set(known)):
            best = self._best(scores, name)
            signs = [float(self.library.signs[best])] if self.library.signs[best] else [1.0, -1.0]
            starts = [refit(model, self.library.chosen[best], sign, SCOUT) for sign in signs]
            start = min(starts, key=lambda one: one.chi2)
            if start.chi2 < (lowest + model.chi2) / 2:
                found[name] = _beyond(fit(model.data, start.free, known=start, start=start.point.vector, secant=True))
        self._told(model, found)
        return found

    def _backward(self, model: Fit) -> Fit:
        """Drop effects that the later ones have made unnecessary."""
        for effect in self.added(model):
            if len(self.added(model)) < 2:
                break
            fewer = without(model, effect.name)
            if fewer.chi2 - model.chi2 < self._least(self.screen(fewer), effect.name):
                model = _settled(fewer)
        return model

    def named(self, model: Fit) -> list[Named]:
        """Return the named effects of a model, strongest first, each with those that could stand in its place."""
        found = [self._named(model, effect) for effect in self.added(model)]
        return sorted(found, key=lambda item: -item.gain)

    def _named(self, model: Fit, effect: Effect) -> Named:
        rest = without(model, effect.name) if len(self.added(model)) > 1 else self.baseline
        scores = self.screen(rest)
        best = self._best(scores, effect.name)
        gain = rest.chi2 - model.chi2
        z = max(abs(scores.z[best]), np.sqrt(max(gain, 0.0)) / scores.spread[best])
        limit = max(INDISTINCT * scores.spread[best] ** 2, FORM_ERROR**2 * gain)
        others = [
            Alternative(_effect(fitted, name), fitted.chi2 - model.chi2, fitted)
            for name, fitted in self.refits(rest).items()
            if name != effect.name
        ]
        close = sorted((other for other in others if other.loss < limit), key=lambda other: other.loss)
        return Named(effect, gain, scores.p_value(z), model, rest, tuple(close))


def refit(model: Fit, candidate: Candidate, share: float, iterations: int = ITERATIONS) -> Fit:
    """Fit one more effect together with everything that the model has free, from a start strength in typical sizes."""
    limited = np.clip(share, -3, 3)
    effect = candidate.at(float(limited) if abs(limited) > 0.05 else 0.05 * (np.sign(limited) or 1.0))
    parameters = replace(model.parameters, effects=(*model.parameters.effects, effect))
    found = fit(model.data, freed(parameters, model.free), known=model, secant=True, iterations=iterations)
    return _beyond(found, secant=True) if iterations == ITERATIONS else found


def freed(parameters: ParameterSet, like: Free) -> Free:
    """Return what may move: what moved before, and of every effect the switches that are on, with their shapes."""
    names = [name for name in like.names if "." not in name]
    for effect in parameters.effects:
        on = [s for s in effect.switches() if getattr(effect, s) != declarations(effect)[s][0]]
        shapes = [n for n, (_, d) in declarations(effect).items() if d.fitted and n not in effect.switches()]
        shapes = [n for n in shapes if not (n.startswith("centre_") or _idle(effect, n))]
        names += [f"{effect.name}.{n}" for n in (*on, *shapes)]
    return choose(parameters, free=names)


def _idle(effect: Effect, name: str) -> bool:
    """Tell whether a shape belongs to a switch that is off, by trying both ends of its range on a small part."""
    on = [s for s in effect.switches() if getattr(effect, s) != declarations(effect)[s][0]]
    return not any(matters(type(effect), s, name) for s in on)


def _weighed(found: Fit) -> float:
    """Return −2 ln L, and 2 for everything that is free (Akaike 1974)."""
    return found.chi2 + 2 * len(found.free.names)


def _settled(found: Fit) -> Fit:
    """Return a quick refit brought to rest with derivatives of its own."""
    return _beyond(fit(found.data, found.free, start=found.point.vector, known=found))


def _beyond(found: Fit, *, secant: bool = False) -> Fit:
    """Go on from the other end where an effect has come to the end of a range that nature does not end."""
    effects = tuple(effect.elsewhere() for effect in found.parameters.effects)
    if effects == found.parameters.effects:
        return found
    free = freed(replace(found.parameters, effects=effects), found.free)
    return min(found, fit(found.data, free, known=found, secant=secant), key=lambda one: one.chi2)


def _convinces(grown: Fit, model: Fit, limit: float) -> bool:
    """Tell whether the last effect gains enough, with a strength whose 95 % interval leaves out its off value.

    The limit is that of one strength; whatever else it moves must bring its own 2 (Akaike 1974).
    """
    shapes = len(grown.free.names) - len(model.free.names) - 1
    return model.chi2 - grown.chi2 - 2 * shapes > limit and _inside(grown, grown.parameters.effects[-1].name)


def _inside(fitted: Fit, name: str) -> bool:
    """Tell whether a 95 % interval of any strength of the effect leaves out its off value."""
    sd = np.sqrt(np.diag(fitted.covariance()))
    effect = _effect(fitted, name)
    for switch in effect.switches():
        k = fitted.free.index(f"{name}.{switch}")
        if k is not None and abs(fitted.point.vector[k] - declarations(effect)[switch][0]) > 1.96 * sd[k]:
            return True
    return False


def without(model: Fit, name: str) -> Fit:
    """Refit the model without one of its effects."""
    kept = tuple(effect for effect in model.parameters.effects if effect.name != name)
    parameters = replace(model.parameters, effects=kept)
    return fit(model.data, freed(parameters, model.free), known=model, secant=True)


def _effect(fitted: Fit, name: str) -> Effect:
    return next(effect for effect in fitted.parameters.effects if effect.name == name)


def strengths(fitted: Fit, effect: Effect) -> dict[str, dict[str, float | str]]:
    """Return value and 95 % interval of every freed parameter of an effect, inside its declared range."""
    intervals, found = fitted.intervals(), {}
    for name, (_, declared) in declarations(effect).items():
        place = f"{effect.name}.{name}"
        if place in intervals:
            low, high = intervals[place]
            found[name] = {"value": float(getattr(effect, name)), "low": low, "high": high, "unit": declared.unit}
    return found
