"""Names: which effects a model was given, how surely, and what could stand in their place nearly as well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnose.attempts import Attempts
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.judge import INDISTINCT
from dlwpredict.diagnose.refit import effect_of
from dlwpredict.effects.base import Effect
from dlwpredict.parameters import declarations

FORM_ERROR = 20**-0.5
"""Two effects stay in one class while the runner-up is not `INDISTINCT` behind, nor by the energy of this share of the
signature, a twentieth: beside one that explains the rest, a strength has 20 times the variance that it has alone, and
no formula is trusted further than that."""

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


def named_in(attempts: Attempts, model: Fit, left: float) -> list[Named]:
    """Return the named effects of a model, strongest first, each with those that could stand in its place.

    Where χ² beyond noise is left, something that has no name is at work, and may have tipped the balance between two
    names by as much: whatever convinces by itself, and is not farther behind, stays in the class.

    Parameters
    ----------
    attempts : Attempts
    model : Fit
    left : float
        χ² beyond noise that the model leaves, 0 where that is chance.
    """
    found = [_named(attempts, model, effect, left) for effect in attempts.judge.added(model)]
    return sorted(found, key=lambda item: -item.gain)


def _named(attempts: Attempts, model: Fit, effect: Effect, left: float) -> Named:
    rest, others = attempts.rest(model, effect.name), dict(attempts.instead(model, effect))
    scores = attempts.judge.screen(rest)
    best = attempts.library.best(scores, effect.name)
    gain = rest.chi2 - model.chi2
    z = max(abs(scores.z[best]), np.sqrt(max(gain, 0.0)) / scores.spread[best])
    limit = max(INDISTINCT * scores.spread[best] ** 2, FORM_ERROR**2 * gain)
    for name, fitted in others.items():
        if limit <= fitted.chi2 - model.chi2 < NEARLY * limit:
            others[name] = attempts.at_rest(fitted)
    found = [Alternative(effect_of(fitted, name), fitted.chi2 - model.chi2, fitted) for name, fitted in others.items()]
    close = [one for one in found if one.loss < limit or (one.loss < left and attempts.judge.convinces(one.fit, rest))]
    close.sort(key=lambda other: other.loss)
    return Named(effect, gain, scores.p_value(z), model, rest, tuple(close))


def strengths(effect: Effect, intervals: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float | str]]:
    """Return value and 95 % interval of every freed parameter of an effect, inside its declared range.

    What effects share stands under the name of one of them.
    """
    found = {}
    for name, (_, declared) in declarations(effect).items():
        places = [k for k in intervals if k == f"{effect.name}.{name}" or (declared.shared and k.endswith(f".{name}"))]
        if places:
            low, high = intervals[places[0]]
            found[name] = {"value": float(getattr(effect, name)), "low": low, "high": high, "unit": declared.unit}
    return found
