"""What a calibration has to say, as plain numbers, texts and lists."""

from __future__ import annotations

from typing import Any

import numpy as np

from dlwpredict.calibrate.problem import Point
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.calibrate.run import Calibration
from dlwpredict.flat import fittable

FORMAT = "dlwpredict-calibration/1"


def report_of(found: Calibration) -> dict[str, Any]:
    """Return the report: fit, parameters, what is known of them, noise, recordings, warnings; no file names added."""
    holdout = found.holdout
    return {
        "format": FORMAT,
        "rmse_um": {"before": _short(found.start.rmse_um), "after": _short(found.point.rmse_um)},
        "holdout": {
            "rmse_um": _short(holdout.rmse_um),
            "folds": holdout.folds,
            "block_um": [_short(side) for side in holdout.block_um],
            "buffer_um": _short(holdout.buffer_um),
        },
        "parameters": {name: _parameter(found, k) for k, name in enumerate(found.free.names)},
        "correlation": {
            name: {other: round(float(value), 4) for other, value in zip(found.free.names, row, strict=True)}
            for name, row in zip(found.free.names, found.information.correlation, strict=True)
        },
        "open_directions": [{name: _short(v) for name, v in d.items()} for d in found.directions],
        "noise_from": found.noises[0].noise_from,
        "recordings": [_recording(found, k) for k in range(len(found.noises))],
        "work": {name: round(value, 3) for name, value in found.work.items()},
        "warnings": found.warnings,
    }


def correlation(recording: Recording, point: Point, k: int) -> float:
    """Return CC (MATLAB's corr2) of recording and prediction over the points that count, nuisances removed."""
    predicted = point.traces[k].heights_um[recording.used]
    return float(np.corrcoef(predicted, predicted + point.residuals[k])[0, 1])


def _parameter(found: Calibration, k: int) -> dict[str, Any]:
    name = found.free.names[k]
    low, high = found.intervals[k]
    return {
        "value": _short(found.point.vector[k]),
        "low": _short(low),
        "high": _short(high),
        "standard_error": _short(found.information.standard_errors[k]),
        "interval_from": "profile" if name in found.profiled else "linear",
        "identified": found.identified[name],
        "unit": fittable(found.free.base)[name].unit,
    }


def _recording(found: Calibration, k: int) -> dict[str, Any]:
    recording, noise = found.problem.recordings[k], found.noises[k]
    nuisances = zip(recording.column_names, found.point.nuisances[k], strict=True)
    return {
        "name": recording.name,
        "points": recording.points,
        "height_reference": recording.measured.height_reference,
        "rmse_um": {side: _short(_rms(point.residuals[k])) for side, point in _sides(found)},
        "cc": {side: _short(correlation(recording, point, k)) for side, point in _sides(found)},
        "nuisances_um": {name: _short(value) for name, value in nuisances},
        "noise_um": {
            "white": _short(noise.white_um),
            "correlated": _short(noise.correlated_um),
            "length": _short(noise.length_um),
            "smoothness": noise.smoothness,
        },
        "effective_points": round(noise.effective_points(recording.used)),
    }


def _sides(found: Calibration) -> tuple[tuple[str, Point], ...]:
    return ("before", found.start), ("after", found.point)


def _rms(residual: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _short(value: float) -> float:
    """Return six significant digits."""
    return float(f"{float(value):.6g}")
