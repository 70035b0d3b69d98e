"""Names: which effects a model was given, how surely, and what could stand in their place nearly as well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnose.finer import on_own_pixels
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.refit import effect_of, settled, without
from dlwpredict.diagnose.select import Search
from dlwpredict.effects.base import Effect
from dlwpredict.parameters import declarations

INDISTINCT = 9.0
"""Two effects stay in one class while the refitted runner-up is not this far behind in 2 ln L, in units of the score's
own variance ..."""

FORM_ERROR = 20**-0.5
"""... nor by the energy of this share of the signature, a twentieth: beside one that explains the rest, a strength has
20 times the variance that it has alone, and no formula is trusted further than that."""

NEARLY = 3.0
"""A quick refit that is not this many times as far behind is done with care before it is left out of the class."""


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


def named_in(search: Search, model: Fit) -> list[Named]:
    """Return the named effects of a model, strongest first, each with those that could stand in its place."""
    found = [_named(search, model, effect) for effect in search.added(model)]
    return sorted(found, key=lambda item: -item.gain)


def _named(search: Search, model: Fit, effect: Effect) -> Named:
    rest = without(model, effect.name) if len(search.added(model)) > 1 else search.baseline
    scores = search.screen(rest)
    best = search.best(scores, effect.name)
    gain = rest.chi2 - model.chi2
    z = max(abs(scores.z[best]), np.sqrt(max(gain, 0.0)) / scores.spread[best])
    limit = max(INDISTINCT * scores.spread[best] ** 2, FORM_ERROR**2 * gain)
    others = {name: fitted for name, fitted in search.refits(rest, model.chi2).items() if name != effect.name}
    others |= search.look_alikes(rest, effect, model.chi2)
    for name, fitted in others.items():
        if limit <= fitted.chi2 - model.chi2 < NEARLY * limit:
            others[name] = on_own_pixels(settled(fitted), search.workers)
    found = [Alternative(effect_of(fitted, name), fitted.chi2 - model.chi2, fitted) for name, fitted in others.items()]
    close = sorted((other for other in found if other.loss < limit), key=lambda other: other.loss)
    return Named(effect, gain, scores.p_value(z), model, rest, tuple(close))


def strengths(effect: Effect, intervals: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float | str]]:
    """Return value and 95 % interval of every freed parameter of an effect, inside its declared range."""
    found = {}
    for name, (_, declared) in declarations(effect).items():
        place = f"{effect.name}.{name}"
        if place in intervals:
            low, high = intervals[place]
            found[name] = {"value": float(getattr(effect, name)), "low": low, "high": high, "unit": declared.unit}
    return found
