"""Fits as plain records that JSON can hold, so that an interrupted run is taken up again exactly as it was.

A converged fit is its vector, the registration of every recording and the change on finer pixels that it was made with:
all else follows, derivatives included. Numbers are kept to the last digit, for the search goes on from these fits, and
a descent that begins a little elsewhere ends a little elsewhere.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import replace
from typing import Any

import numpy as np

from dlwpredict.effects import library
from dlwpredict.infer.free import Free, with_values
from dlwpredict.infer.model import moving
from dlwpredict.infer.objective import Fit, Objective
from dlwpredict.parameters import declarations

MAPS = "maps"
"""Under this name stand the changes on finer pixels, by a checksum: many fits share one."""


def recorded(fit: Fit, maps: dict[str, str]) -> dict[str, Any]:
    """Return a fit as a record; changes on finer pixels that are new are added to the maps."""
    items = []
    for item in fit.data:
        values = np.ascontiguousarray(item.discretisation_um, dtype=float).tobytes()
        mark = f"{zlib.crc32(values):08x}-{len(values)}"
        if mark not in maps:
            maps[mark] = base64.b64encode(zlib.compress(values, 1)).decode()
        names, width = item.discretised
        items.append({"shift_um": list(item.shift_um), "pixels": mark, "effects": list(names), "width": width})
    effects = {one.name: {key: getattr(one, key) for key in declarations(one)} for one in fit.parameters.effects}
    return {"effects": effects, "values": dict(zip(fit.free.names, fit.vector.tolist(), strict=True)), "items": items}


def restored(objective: Objective, like: Free, record: dict[str, Any], maps: dict[str, str]) -> tuple[Fit, float]:
    """Return a fit as it was, and the work that it took."""
    effects = tuple(library()[name](**values) for name, values in record["effects"].items())
    free = moving(with_values(replace(like.base, effects=effects), record["values"]), like)
    data = []
    for item, one in zip(objective.data, record["items"], strict=True):
        values = np.frombuffer(zlib.decompress(base64.b64decode(maps[one["pixels"]])))
        pixels = values.reshape(item.recording.target.shape) if values.size > 1 else float(values[0])
        place = tuple(one["effects"]), one["width"]
        data.append(replace(item, shift_um=tuple(one["shift_um"]), discretisation_um=pixels, discretised=place))
    objective = replace(objective, data=tuple(data))
    found = objective.at(free, np.array([record["values"][name] for name in free.names]))
    return objective.differentiated(found), objective.work.predictions
