"""The content of diagnosis.yaml: what a diagnosis has to say, as plain numbers, texts and lists."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dlwpredict.diagnose import words
from dlwpredict.diagnose.competitor import LEVEL
from dlwpredict.diagnose.library import Library
from dlwpredict.diagnose.naming import Named, strengths
from dlwpredict.diagnose.run import Diagnosis, Model
from dlwpredict.diagnose.screen import POWER, Screen
from dlwpredict.effects import library as every_effect
from dlwpredict.effects.base import Effect
from dlwpredict.flat import fittable

FORMAT = "dlwpredict-diagnosis/1"


def content_of(found: Diagnosis) -> dict[str, Any]:
    """Return the content of diagnosis.yaml; commands and provenance are added by who knows them."""
    findings = [_finding(found, item) for item in found.named]
    blind = not_testable(found.library, found.screen) - {item.effect.name for item in found.named}
    content = {
        "format": FORMAT,
        "verdict": found.verdict,
        "sentence": words.sentence(found),
        "noise_um": _short(np.sqrt(np.mean([n.model.sigma_um**2 for n in found.noises]))),
        "noise_from": ", ".join(sorted({n.source for n in found.noises})),
        "noise": [
            {
                "white_um": _short(n.model.even.white_um),
                "correlated_um": _short(n.model.even.correlated_um),
                "length_um": _short(n.model.even.length_um),
                "smoothness": float(n.model.even.smoothness),
                "grain_um": _short(n.model.even.grain_um),
                "jitter_um": _short(n.model.jitter_um),
                "row_um": _short(n.model.row_um),
                "column_um": _short(n.model.column_um),
            }
            for n in found.noises
        ],
        "baseline": _model(found.baseline, found),
        "extended": _model(found.extended, found),
        "holdout_by": found.holdout_by,
        "locations": [
            {
                "pair": place.pair,
                "where": place.where,
                "share": round(place.share, 3),
                "p_value": _short(place.p_value),
                "x_um": [round(v, 2) for v in place.x_um],
                "y_um": [round(v, 2) for v in place.y_um],
            }
            for place in found.places
        ],
        "findings": findings,
        "remainder": {
            "significant": found.extended.unexplained,
            "rms_um": _short(found.extended.structure_um),
            "p_value": _short(found.extended.p_value),
            "explained_share": round(found.explained, 3),
            "description": words.remainder(found),
        },
        "tests": words.tests(found),
        "not_testable": sorted(blind),
        "tested": sorted(set(every_effect()) - blind),
    }
    return content


def _finding(found: Diagnosis, item: Named) -> dict[str, Any]:
    model = found.extended.fit
    intervals = found.null.intervals(model)
    others = [(other.effect, found.null.intervals(other.fit)) for other in item.alternatives]
    return {
        "effects": item.names,
        "side": words.side_of(item.names),
        "statement": words.statement(item, intervals),
        "parameters": {effect.name: _strengths(effect, own) for effect, own in [(item.effect, intervals), *others]},
        "p_value": _short(item.p_value),
        "gain": _short(item.gain),
        "alternatives": [{"name": other.effect.name, "loss": _short(other.loss)} for other in item.alternatives],
        "rmse_um": {"before": _short(item.rest.rmse_um()), "after": _short(model.rmse_um())},
        "holdout_rmse_um": {
            "before": _short(found.held_out_um(item.rest)),
            "after": _short(found.held_out_um(model)),
        },
        "separate_by": None,
    }


def _strengths(effect: Effect, intervals: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, Any]]:
    found = strengths(effect, intervals)
    return {
        name: {key: _short(v) if key != "unit" else v for key, v in values.items()} for name, values in found.items()
    }


def _model(model: Model, found: Diagnosis) -> dict[str, Any]:
    fitted = model.fit
    units, vector = fittable(fitted.parameters), fitted.point.vector
    values = {
        name: {"value": _short(vector[k]), "low": _short(low), "high": _short(high), "unit": units[name].unit}
        for k, (name, (low, high)) in enumerate(found.null.intervals(fitted).items())
    }
    return {
        "rmse_um": _short(fitted.rmse_um()),
        "holdout_rmse_um": _short(found.held_out_um(fitted)),
        "parameters": values,
    }


def not_testable(library: Library, scored: Screen) -> set[str]:
    """Return the effects that these data would miss more often than one time in ten, even at the end of their range."""
    largest: dict[str, float] = dict.fromkeys(every_effect(), 0.0)
    for candidate, visible in zip(library.chosen, scored.visible, strict=True):
        declared = candidate.declaration
        reach = max(abs(declared.high - candidate.off), abs(declared.low - candidate.off)) / abs(candidate.unit)
        largest[candidate.name] = max(largest[candidate.name], float(visible * reach))
    return {name for name, seen in largest.items() if seen < scored.threshold(LEVEL) + POWER}


def _short(value: float | None) -> float | None:
    """Return five significant digits."""
    return None if value is None or not np.isfinite(value) else float(f"{float(value):.5g}")
