"""Refits: a model with one effect more or one less, everything else that is free moving along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlwpredict.diagnose.candidates import Candidate, levelled, matters
from dlwpredict.diagnose.fit import ITERATIONS, TO_REST, Fit, doubled, fit, placed, sharing
from dlwpredict.effects.base import Effect
from dlwpredict.flat import Free, choose, value_of, with_values
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet, declarations

SCOUT = 2
"""Steps of a refit that only looks whether an effect deserves a whole one."""

FARTHEST = 3
"""Typical sizes from which a refit starts at most."""


def refit(model: Fit, candidate: Candidate, share: float, iterations: int = ITERATIONS, place_of: str = "") -> Fit:
    """Fit one more effect together with everything that the model has free, from a start strength in typical sizes.

    What it shares with an effect of the model starts at the model's value. An effect of the model may leave for it.
    """
    limited = np.clip(share, -FARTHEST, FARTHEST)
    effect = candidate.at(float(limited) if abs(limited) > 0.05 else 0.05 * (np.sign(limited) or 1.0))
    kept = lacking(model, place_of)
    known = {name: value_of(kept, name) for name in freed(kept, model.free).names}
    parameters = with_values(replace(kept, effects=(*kept.effects, effect)), known)
    found = fit(model.data, freed(parameters, model.free), known=model, secant=True, iterations=iterations)
    return _beyond(found, secant=True) if iterations == ITERATIONS else found


def kept_promise(model: Fit, candidate: Candidate, share: float, quick: Fit, bar: float) -> Fit:
    """Bring −2 ln L of a quick refit below the bar: with care, then from far away as well.

    The score is that of a small strength. What calibration takes nearly whole can be much stronger than it says, with
    the focus and the threshold far from where the model has them.
    """
    found = settled(quick)
    if found.chi2 > bar and abs(share) < FARTHEST:
        far = settled(refit(model, candidate, FARTHEST * float(np.sign(share))))
        found = min(found, far, key=lambda one: one.chi2)
    return found


def scouted(model: Fit, candidate: Candidate, sign: float, bar: float) -> Fit | None:
    """Refit from the typical size, of both signs for 0; None where −2 ln L at first stays above the bar."""
    starts = [refit(model, candidate, one, SCOUT) for one in ([sign] if sign else [1.0, -1.0])]
    start = min(starts, key=lambda one: one.chi2)
    if start.chi2 >= bar:
        return None
    return _beyond(fit(model.data, start.free, known=start, start=start.point.vector, secant=True))


def from_typical(model: Fit, candidate: Candidate, sign: float) -> Fit:
    """Refit one more effect from its typical size with derivatives of its own, from both signs for 0."""
    starts = [refit(model, candidate, one) for one in ([sign] if sign else [1.0, -1.0])]
    return min((settled(one) for one in starts), key=lambda one: one.chi2)


def settled(found: Fit) -> Fit:
    """Return a quick refit brought to rest with derivatives of its own."""
    return _beyond(fit(found.data, found.free, start=found.point.vector, known=found, iterations=TO_REST))


def rested(found: Fit, workers: Workers = ALONE) -> Fit:
    """Return a quick refit brought to rest, from its double as well where it has one; the lower of both."""
    starts = doubled(found.free, found.point.vector)[1:]
    begun = [found, *(placed(found.data, found.free, start, found.point) for start in starts)]
    return sharing(min(workers.each(settled, [(one,) for one in begun]), key=lambda one: one.chi2), found.data)


def _beyond(found: Fit, *, secant: bool = False) -> Fit:
    """Go on from the other end where an effect has come to the end of a range that nature does not end."""
    effects = tuple(effect.elsewhere() for effect in found.parameters.effects)
    if effects == found.parameters.effects:
        return found
    free = freed(replace(found.parameters, effects=effects), found.free)
    return min(found, fit(found.data, free, known=found, secant=secant), key=lambda one: one.chi2)


def without(model: Fit, name: str) -> Fit:
    """Refit the model without one of its effects."""
    return fit(model.data, freed(lacking(model, name), model.free), known=model, secant=True)


def lacking(model: Fit, name: str) -> ParameterSet:
    """Return the process as fitted, without one of its effects."""
    parameters = model.parameters
    return replace(parameters, effects=tuple(effect for effect in parameters.effects if effect.name != name))


def done_by(model: Fit, name: str) -> np.ndarray:
    """Return what an effect of a model does to its prediction, all else where it is, whitened, shape (rows,)."""
    free = freed(lacking(model, name), model.free)
    done = placed(model.data, free, free.start, model.point).residual - model.residual
    return done - model.nuisances @ (model.nuisances.T @ done)


def effect_of(fitted: Fit, name: str) -> Effect:
    """Return the effect of this name as fitted."""
    return next(effect for effect in fitted.parameters.effects if effect.name == name)


def freed(parameters: ParameterSet, like: Free) -> Free:
    """Return what may move: what moved before, and of every effect the switches that are on, with their shapes."""
    names = [name for name in like.names if "." not in name]
    for effect in parameters.effects:
        on = [s for s in effect.switches() if getattr(effect, s) != declarations(effect)[s][0]]
        shapes = [n for n, (_, d) in declarations(effect).items() if d.fitted and n not in effect.switches()]
        shapes = [n for n in shapes if not (levelled(type(effect), n) or _idle(effect, n))]
        names += [f"{effect.name}.{n}" for n in (*on, *shapes)]
    return choose(parameters, free=names)


def _idle(effect: Effect, name: str) -> bool:
    """Tell whether a shape belongs to a switch that is off, by trying both ends of its range on a small part."""
    on = [s for s in effect.switches() if getattr(effect, s) != declarations(effect)[s][0]]
    return not any(matters(type(effect), s, name) for s in on)
