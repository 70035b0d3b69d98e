"""From scores to a model: add the effect that convinces, drop what does not, exchange what another does better."""

from __future__ import annotations

from dlwpredict.diagnose.attempts import Attempts, ordered
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.judge import INDISTINCT, weighed

MOST_EFFECTS = 3
"""Effects that one diagnosis names at most."""

RIVALS = 2
"""Of these the best are brought to rest, on pixels of their own, before one is taken."""


def select(attempts: Attempts, start: Fit | None = None) -> Fit:
    """Grow the model effect by effect while noise cannot explain the next one; then try others in their places.

    The first effect is chosen while the others are missing, and may be the one that best stands in for all of them.
    So the model tries to do without each, and to replace it (sequential replacement; Miller, Subset Selection in
    Regression, 2002).

    Parameters
    ----------
    attempts : Attempts
    start : Fit, optional
        A model with effects to begin with, on the same data.

    Returns
    -------
    Fit
        With the named effects among its parameters; the baseline itself where there are none.
    """
    model = _backward(attempts, _grown(attempts, start or attempts.judge.baseline))
    for _ in range(MOST_EFFECTS):
        other = _exchanged(attempts, model)
        if other is model:
            break
        model = _backward(attempts, _grown(attempts, other))
    return model


def _grown(attempts: Attempts, model: Fit) -> Fit:
    """Add effects, one by one, while noise cannot explain the next one."""
    judge = attempts.judge
    while len(judge.added(model)) < MOST_EFFECTS:
        if not judge.more(model) and not judge.hidden(model):
            break
        tried = attempts.from_every_valley() if model is judge.baseline else attempts.refits(model)
        for name in ordered(tried)[:RIVALS]:
            tried[name] = attempts.at_rest(tried[name])
        convincing = [grown for grown in tried.values() if judge.convinces(grown, model)]
        if not convincing:
            break
        model = min(convincing, key=weighed)
    return model


def _exchanged(attempts: Attempts, model: Fit) -> Fit:
    """Return the likeliest model with another effect in the place of one, or the model itself."""
    judge = attempts.judge
    here = weighed(model)
    found = {model: here}
    for effect in judge.added(model):
        rest, tried = attempts.rest(model, effect.name), attempts.instead(model, effect)
        ahead = INDISTINCT * judge.spread(rest, effect.name) ** 2
        for name in ordered(tried)[:RIVALS]:
            if weighed(tried[name]) < here + ahead:
                tried[name] = attempts.at_rest(tried[name])
        found |= {one: weighed(one) + ahead for one in tried.values() if judge.convinces(one, rest)}
    return min(found, key=found.__getitem__)


def _backward(attempts: Attempts, model: Fit) -> Fit:
    """Drop effects that the later ones have made unnecessary."""
    judge = attempts.judge
    for effect in judge.added(model):
        if len(judge.added(model)) < 2:
            break
        fewer = attempts.rest(model, effect.name)
        if fewer.chi2 - model.chi2 < judge.least(fewer, effect.name):
            model = fewer
    return model
