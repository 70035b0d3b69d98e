"""What a calibration has to say, as plain numbers, texts and lists."""

from __future__ import annotations

from typing import Any

import numpy as np

from dlwpredict.calibration.run import Calibration
from dlwpredict.calibration.words import nuisances_um
from dlwpredict.infer.free import fittable
from dlwpredict.infer.objective import Fit

FORMAT = "dlwpredict-calibration/1"


def report_of(calibration: Calibration) -> dict[str, Any]:
    """Return the report: fit, parameters, what is known of them, noise, recordings, warnings; no file names added."""
    holdout = calibration.holdout
    return {
        "format": FORMAT,
        "rmse_um": {side: _short(fit.rmse_um()) for side, fit in _sides(calibration)},
        "holdout": {
            "rmse_um": _short(holdout.rmse_um) if holdout.folds else None,
            "folds": holdout.folds,
            "block_um": [_short(side) for side in holdout.block_um],
            "buffer_um": _short(holdout.buffer_um),
        },
        "parameters": {name: _parameter(calibration, k) for k, name in enumerate(calibration.free.names)},
        "correlation": {
            name: {partner: round(float(value), 4) for partner, value in zip(calibration.free.names, row, strict=True)}
            for name, row in zip(calibration.free.names, calibration.correlation, strict=True)
        },
        "open_directions": [{name: _short(v) for name, v in d.items()} for d in calibration.directions],
        "noise_from": ", ".join(sorted({noise.source for noise in calibration.noises})),
        "recordings": [_recording(calibration, k) for k in range(len(calibration.noises))],
        "work": {name: round(value, 3) for name, value in calibration.work.items()},
        "warnings": calibration.warnings,
    }


def correlation(fit: Fit, k: int) -> float:
    """Return CC (MATLAB's corr2) of recording k and prediction over the points that count, nuisances removed."""
    used = fit.data[k].recording.used
    predicted = fit.traces[k].heights_um[used]
    return float(np.corrcoef(predicted, predicted + fit.residual_um(k)[used])[0, 1])


def _parameter(calibration: Calibration, k: int) -> dict[str, Any]:
    name, free = calibration.free.names[k], calibration.free
    low, high = calibration.intervals.ends[k] if np.ptp(calibration.intervals.ends[k]) > 0 else (None, None)
    return {
        "value": _short(calibration.end.vector[k]),
        "low": None if low is None else _short(low),
        "high": None if high is None else _short(high),
        "standard_error": _short(min(calibration.intervals.sd[k], free.high[k] - free.low[k])),
        "interval_from": "profile" if name in calibration.intervals.profiled else "linear",
        "identified": calibration.identified[name],
        "unit": fittable(free.base)[name].unit,
    }


def _recording(calibration: Calibration, k: int) -> dict[str, Any]:
    recording, noise = calibration.recordings[k], calibration.noises[k].model
    return {
        "name": recording.name,
        "points": recording.points,
        "height_reference": recording.measured.height_reference,
        "rmse_um": {side: _short(np.sqrt(np.nanmean(fit.residual_um(k) ** 2))) for side, fit in _sides(calibration)},
        "cc": {side: _short(correlation(fit, k)) for side, fit in _sides(calibration)},
        "nuisances_um": {name: _short(value) for name, value in nuisances_um(calibration.end, k).items()},
        "noise_um": {
            "white": _short(noise.even.white_um),
            "correlated": _short(noise.even.correlated_um),
            "length": _short(noise.even.length_um),
            "smoothness": noise.even.smoothness,
            "jitter": _short(noise.jitter_um),
            "rows": _short(noise.row_um),
            "columns": _short(noise.column_um),
        },
        "effective_points": round(noise.even.effective_points(recording.used)),
    }


def _sides(calibration: Calibration) -> tuple[tuple[str, Fit], ...]:
    return ("before", calibration.start), ("after", calibration.end)


def _short(value: float) -> float:
    """Return six significant digits."""
    return float(f"{float(value):.6g}")
