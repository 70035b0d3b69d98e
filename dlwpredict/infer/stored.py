"""Fits as plain records that JSON can hold, so that an interrupted run is taken up again exactly as it was.

A converged fit is its vector and the registration of every recording: all else follows, derivatives included. Numbers
are kept to the last digit, for the search goes on from these fits, and a descent that begins a little elsewhere ends a
little elsewhere.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dlwpredict.effects import library
from dlwpredict.effects.base import settings
from dlwpredict.infer.free import Free, with_values
from dlwpredict.infer.model import moving
from dlwpredict.infer.objective import Fit, Objective


def recorded(fit: Fit) -> dict[str, Any]:
    """Return a fit as a record."""
    effects = {effect.name: settings(effect) for effect in fit.parameters.effects}
    values = dict(zip(fit.free.names, fit.vector.tolist(), strict=True))
    places = [list(item.place) for item in fit.data]
    return {"effects": effects, "values": values, "places": places, "promise": fit.promise}


def restored(objective: Objective, like: Free, record: dict[str, Any]) -> tuple[Fit, float]:
    """Return a fit as it was, and the work that it took."""
    effects = tuple(library()[name](**values) for name, values in record["effects"].items())
    free = moving(with_values(replace(like.base, effects=effects), record["values"]), like)
    pairs = zip(objective.data, record["places"], strict=True)
    objective = replace(objective, data=tuple(replace(item, place=tuple(place)) for item, place in pairs))
    fit = objective.at(free, np.array([record["values"][name] for name in free.names]))
    return replace(objective.differentiated(fit), promise=record["promise"]), objective.work.predictions
