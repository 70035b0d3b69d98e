"""The content of diagnosis.yaml: what a diagnosis has to say, as plain numbers, texts and lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.answer import words
from dlwpredict.diagnosis.classes import Named, strengths
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.library.score import Linearised, Thresholds
from dlwpredict.diagnosis.structure.registrations import Registration, registrations
from dlwpredict.diagnosis.structure.test import Model
from dlwpredict.effects import library as every_effect
from dlwpredict.effects.base import Effect
from dlwpredict.infer.free import Free, fittable
from dlwpredict.infer.noises import scale_um
from dlwpredict.infer.recording import Recording
from dlwpredict.noise.lines import Lines

FORMAT = "dlwpredict-diagnosis/1"

Ends = Mapping[str, tuple[float, float]]
"""95 % intervals by name."""


def content_of(diagnosis: Diagnosis, profiled: Ends | None = None) -> dict[str, Any]:
    """Return the content of diagnosis.yaml; commands, work and provenance are added by who knows them.

    Parameters
    ----------
    diagnosis : Diagnosis
    profiled : mapping, optional
        95 % intervals of the extended fit with their profiles, the last thing that takes time. Without them all
        intervals are those of a straight line, and the answer is not complete.
    """
    finished = profiled is not None and diagnosis.complete
    intervals = diagnosis.intervals(diagnosis.extended.fit).as_dict() if profiled is None else profiled
    named = {item.effect.name for item in diagnosis.named}
    given = {effect.name for effect in diagnosis.baseline.fit.parameters.effects}
    blind = not_testable(diagnosis.screen, diagnosis.thresholds) - named - given
    baseline = _model(diagnosis.baseline, diagnosis, intervals if diagnosis.baseline is diagnosis.extended else None)
    return {
        "format": FORMAT,
        "verdict": diagnosis.verdict,
        "complete": finished,
        "sentence": words.sentence(diagnosis, finished=finished),
        "noise_um": _short(np.sqrt(np.mean([n.model.sigma_um**2 for n in diagnosis.noises]))),
        "noise_from": ", ".join(sorted({n.source for n in diagnosis.noises})),
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
                "rows": _lines(n.model.rows),
                "columns": _lines(n.model.columns),
            }
            | ({"scars": recording.scars} if recording.scans else {})
            for n, recording in zip(diagnosis.noises, diagnosis.recordings, strict=True)
        ],
        "baseline": baseline,
        "extended": _model(diagnosis.extended, diagnosis, intervals),
        "holdout_by": diagnosis.holdout_by,
        "locations": [
            {
                "pair": place.pair,
                "where": place.where,
                "share": round(place.share, 3),
                "p_value": _short(place.p_value),
                "x_um": [round(v, 2) for v in place.x_um],
                "y_um": [round(v, 2) for v in place.y_um],
            }
            for place in diagnosis.places
        ],
        "registration": [_registration(one) for one in registrations(diagnosis.extended.fit)],
        "blemishes": [
            {
                "pair": one.pair,
                "x_um": round(one.x_um, 2),
                "y_um": round(one.y_um, 2),
                "points": int(one.points.sum()),
                "p_value": _short(one.p_value),
            }
            for one in diagnosis.blemishes
        ],
        "doubted": list(diagnosis.doubted),
        "findings": [_finding(diagnosis, item, intervals) for item in diagnosis.named],
        "remainder": {
            "significant": diagnosis.extended.unexplained,
            "kind": words.kind_of_remainder(diagnosis),
            "rms_um": _short(diagnosis.extended.structure_um),
            "p_value": _short(diagnosis.extended.p_value),
            "explained_share": round(diagnosis.explained, 3),
            "description": words.remainder(diagnosis),
        },
        "tests": words.tests(diagnosis),
        "not_tried": list(diagnosis.not_tried),
        "not_testable": sorted(blind),
        "tested": sorted(set(every_effect()) - blind - set(diagnosis.not_tried)),
    }


def untested(recordings: Sequence[Recording], predicted_um: Sequence[np.ndarray], free: Free) -> dict[str, Any]:
    """Return the content before anything was fitted: the errors of the start, and that nothing was tested.

    What stands for the noise is how much neighbouring points of a recording differ beyond what the prediction has them
    differ by.

    Parameters
    ----------
    recordings : sequence of Recording
    predicted_um : sequence of numpy.ndarray, shape (rows, cols)
        By the process that the diagnosis starts from.
    free : Free
        What a fit will move.
    """
    left = [np.where(r.used, r.measured.heights_um - p, np.nan) for r, p in zip(recordings, predicted_um, strict=True)]
    values = np.concatenate([residual[np.isfinite(residual)] for residual in left])
    steps = np.concatenate([np.diff(residual, axis=1).ravel() for residual in left])
    steps = steps[np.isfinite(steps)]
    units = fittable(free.base)
    model = {
        "rmse_um": _short(np.sqrt(np.mean(values**2))),
        "holdout_rmse_um": None,
        "parameters": {
            name: {"value": _short(value), "low": None, "high": None, "unit": units[name].unit}
            for name, value in zip(free.names, free.start, strict=True)
        },
    }
    remainder = {"significant": False, "kind": "none", "rms_um": None, "p_value": None, "explained_share": None}
    return {
        "format": FORMAT,
        "verdict": "unexplained",
        "complete": False,
        "sentence": words.UNTESTED,
        "noise_um": _short(scale_um(steps) / np.sqrt(2) if steps.size else 1e-3),
        "noise_from": "differences of neighbouring points, before any fit",
        "baseline": model,
        "extended": model,
        "locations": [],
        "findings": [],
        "remainder": remainder | {"description": words.UNTESTED},
        "not_tried": sorted(every_effect()),
        "not_testable": [],
        "tested": [],
    }


def _finding(diagnosis: Diagnosis, item: Named, intervals: Ends) -> dict[str, Any]:
    model = diagnosis.extended.fit
    members = [(item.effect, intervals)]
    members += [(member.effect, diagnosis.intervals(member.fit).as_dict()) for member in item.others]
    return {
        "effects": item.names,
        "side": words.side_of(item.names),
        "probability": _share(item.probability),
        "members": {member.effect.name: _share(member.probability) for member in item.members},
        "side_probability": {side: _share(value) for side, value in item.sides.items()},
        "statement": words.statement(item, intervals),
        "parameters": {effect.name: _strengths(effect, ends) for effect, ends in members},
        "p_value": _short(item.p_value),
        "gain": _short(item.gain),
        "alternatives": [{"name": member.effect.name, "loss": _short(member.loss)} for member in item.others],
        "rmse_um": {"before": _short(item.reduced.rmse_um()), "after": _short(model.rmse_um())},
        "holdout_rmse_um": {
            "before": _short(diagnosis.held_out_um(item.reduced)),
            "after": _short(diagnosis.held_out_um(model)),
        },
        "separate_by": None,
    }


def _registration(one: Registration) -> dict[str, float | int | None]:
    """Return how a recording lies in the units of the effect `misregistration`."""
    settings = {name: _short(value) for name, value in one.settings.items()}
    return {"pair": one.pair, **settings, "p_value": _short(one.p_value)}


def _strengths(effect: Effect, intervals: Ends) -> dict[str, dict[str, Any]]:
    return {
        name: {key: v if isinstance(v, str) else _short(v) for key, v in values.items()}
        for name, values in strengths(effect, intervals).items()
    }


def _model(model: Model, diagnosis: Diagnosis, intervals: Ends | None = None) -> dict[str, Any]:
    fitted = model.fit
    known = diagnosis.intervals(fitted).as_dict() if intervals is None else intervals
    units = fittable(fitted.parameters)
    values = {
        name: {"value": _short(value), "low": _short(low), "high": _short(high), "unit": units[name].unit}
        for value, (name, (low, high)) in zip(fitted.vector, known.items(), strict=True)
    }
    return {
        "rmse_um": _short(fitted.rmse_um()),
        "holdout_rmse_um": _short(diagnosis.held_out_um(fitted)),
        "parameters": values,
        "pixels": fitted.parameters.readings.pixels,
    }


def not_testable(screen: Linearised, asked: Thresholds) -> set[str]:
    """Return the effects that these data would miss more often than one time in ten, even at the end of their range.

    Misregistration is tested beside all of them (`registrations`).
    """
    largest: dict[str, float] = dict.fromkeys(set(every_effect()) - {"misregistration"}, 0.0)
    for candidate, visible in zip(screen.chosen, screen.visible, strict=True):
        declared = candidate.declaration
        reach = max(abs(declared.high - candidate.off), abs(declared.low - candidate.off)) / abs(candidate.unit)
        largest[candidate.name] = max(largest[candidate.name], float(visible * reach))
    return {name for name, seen in largest.items() if seen < np.sqrt(asked.first) + policy.POWER}


def _share(value: float) -> float:
    """Return a probability; what is nearly sure does not become certain by rounding."""
    return float(f"{value:.4g}") if value < 0.9999 else float(min(value, 1.0))


def _lines(lines: Lines) -> dict[str, float | None]:
    """Return the parts that the noise of lines has: offsets independent, drifting, swinging; tilts."""
    parts = {"white_um": lines.white_um, "tilt_um": lines.tilt_um}
    parts |= {"drift_um": lines.red_um, "drift_lines": lines.red_lines} if lines.red_um else {}
    hum = {"hum_um": lines.hum_um, "hum_period_lines": lines.period_lines, "hum_lines": lines.hum_lines}
    parts |= hum if lines.hum_um else {}
    return {name: _short(size) for name, size in parts.items() if size}


def _short(value: float | None) -> float | None:
    """Return five significant digits."""
    return None if value is None or not np.isfinite(value) else float(f"{float(value):.5g}")
