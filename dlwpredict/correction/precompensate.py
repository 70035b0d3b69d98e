"""Pre-compensation: find the height map h' to write so that the print has the target's heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlwpredict.correction.limits import Limits
from dlwpredict.correction.mixing import Anderson
from dlwpredict.correction.surround import Continued
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import check_target, predict

Prediction = Callable[[HeightMap], HeightMap]

UNREACHABLE_RESPONSE = 0.2
"""A place is out of reach where full correction steps move the print by less than this share of what is missing."""

LAST = 3
"""Predictions over which convergence of the search is judged."""


@dataclass(frozen=True)
class Precompensation:
    """The corrected target and how far it gets.

    Parameters
    ----------
    corrected : HeightMap
        What to write.
    predicted : HeightMap
        What will be printed, according to the same prediction.
    reachable : numpy.ndarray of bool, shape (rows, cols)
        False where no written height brings the print to the target: at the bounds, at walls, and for features
        finer than the focus.
    predictions : int
        Predictions used in the search.
    history : list of dict
        rmse and largest error of every prediction, µm, over the footprint.
    error_um : numpy.ndarray, shape (rows, cols)
        Target − predicted print, 0 beside the part.
    damped : int
        How often a step was taken back because the error had grown.
    largest_unrounded_um : float
        Largest reachable error before the heights were rounded to slices.
    limits : Limits
        What might be written.
    """

    corrected: HeightMap
    predicted: HeightMap
    error_um: np.ndarray
    reachable: np.ndarray
    predictions: int
    history: list[dict[str, float]]
    damped: int = 0
    largest_unrounded_um: float = 0.0
    limits: Limits = field(default_factory=Limits)

    def in_view(self, view: Continued) -> Precompensation:
        """Return the correction where the target is, of one that was continued."""
        corrected, predicted = view.in_view(self.corrected), view.in_view(self.predicted)
        error_um, reachable = view.cut(self.error_um), view.cut(self.reachable)
        return replace(self, corrected=corrected, predicted=predicted, error_um=error_um, reachable=reachable)

    @property
    def missing_um(self) -> np.ndarray:
        """Height that is missing where no correction reaches, 0 elsewhere, µm, shape (rows, cols)."""
        return np.where(self.reachable, 0.0, self.error_um)

    @property
    def capped_points(self) -> int:
        """Points that stand at the highest height that may be written."""
        return int((self.corrected.heights_um >= self.limits.maximum_um * (1 - 1e-9)).sum())

    @property
    def still_falling(self) -> bool:
        """Whether the last `LAST` predictions lowered the rmse by more than a hundredth: more of them may help."""
        errors = [step["rmse_um"] for step in self.history]
        return len(errors) <= LAST or min(errors) < 0.99 * min(errors[:-LAST])

    def summary(self) -> str:
        """Say how far the correction gets, in a line or two."""
        figures = self.as_dict()
        error, reached, missed = (figures[key] for key in ("rmse_um", "reachable", "unreachable"))
        said = (
            f"rmse {error['before']:.4f} -> {error['after']:.4f} µm in {self.predictions} predictions; "
            f"where reachable ({100 * reached['fraction']:.1f} % of the part) at most {reached['largest_um']:.4f} µm"
        )
        if not missed["points"]:
            return said
        beyond = f"{missed['points']} points at walls or finer than the focus, rmse {missed['rmse_um']:.3f} µm"
        return f"{said}\nout of reach: {beyond}"

    def __repr__(self) -> str:
        return f"Precompensation({self.summary()})"

    def as_dict(self) -> dict[str, Any]:
        """Return the report's figures."""
        footprint = self.corrected.heights_um > 0
        reached, missed = footprint & self.reachable, footprint & ~self.reachable
        return {
            "predictions": self.predictions,
            "damped_steps": self.damped,
            "rmse_um": {"before": self.history[0]["rmse_um"], "after": _rms(self.error_um[footprint])},
            "largest_um": {"before": self.history[0]["largest_um"], "after": _largest(self.error_um[footprint])},
            "reachable": {
                "fraction": float(reached.sum() / max(footprint.sum(), 1)),
                "rmse_um": _rms(self.error_um[reached]),
                "largest_um": _largest(self.error_um[reached]),
                "largest_to_initial": _largest(self.error_um[reached]) / self.history[0]["largest_um"],
                "largest_unrounded_um": self.largest_unrounded_um,
            },
            "unreachable": {
                "points": int(missed.sum()),
                "rmse_um": _rms(self.error_um[missed]),
                "largest_um": _largest(self.error_um[missed]),
            },
            "history": self.history,
        }


def precompensate(
    target: HeightMap,
    predict: Prediction,
    *,
    limits: Limits | None = None,
    most_predictions: int = 10,
    tolerance: float = 0.01,
    memory: int = 5,
    counted: np.ndarray | bool = True,
    on_step: Callable[[int, float], None] = lambda count, error: None,
) -> Precompensation:
    """Solve predict(h') = h by corrected fixed-point steps.

    The paper's loop is h' ← h' + (h − predict(h')), here `memory=0`. Anderson mixing (Walker & Ni 2011, type II) learns
    from the last steps how the print answers, and converges where the plain loop creeps or swings. A step after which
    the error has grown is halved and the memory forgotten. The footprint is kept: nothing is written where h = 0, and
    something everywhere else. Places that do not answer are left alone, so that they do not run away.

    Parameters
    ----------
    target : HeightMap
    predict : callable
        Any prediction HeightMap → HeightMap on the same grid.
    limits : Limits, optional
    most_predictions : int
        Predictions allowed in the search; one more judges what is reachable, and one the rounding to slices.
    tolerance : float
        Stop once the largest reachable error is below this share of the initial one.
    memory : int
        Steps that Anderson mixing remembers; 0 = the paper's loop.
    counted : numpy.ndarray of bool, shape (rows, cols), optional
        Points whose errors count.
    on_step : callable
        Told the count of predictions and the present rmse, µm.

    Raises
    ------
    InputError
        The target cannot be written, or exceeds the limits.
    ResultError
        No step lowers the error.
    """
    check_target(target)
    limits = limits or Limits()
    h, footprint = target.heights_um, target.heights_um > 0
    judged = footprint & counted
    if h.max() > limits.maximum_um:
        allowed = f"at least that; found {limits.maximum_um:g}"
        raise InputError(f"target is {h.max():.4g} µm high", key="--maximum-um", allowed=allowed)

    def error_of(written: np.ndarray) -> np.ndarray:
        return np.where(footprint, h - predict(target.with_heights(written)).heights_um, 0.0)

    error = error_of(h)
    best = _Iterate(h, error)
    history = [_figures(error[judged])]
    on_step(1, history[0]["rmse_um"])
    tolerated = tolerance * history[0]["largest_um"]
    silent = np.where(footprint, 0, 2)  # full steps that a place has left unanswered; after two it is left alone
    mixing, damped, scale = Anderson(memory), 0, 1.0
    while len(history) < most_predictions and scale > 1 / 16:
        answers = silent < 2
        if not (answers & judged).any() or np.abs(best.error[answers & judged]).max() <= tolerated:
            break
        mixed = mixing.next(best.written, np.where(answers, best.error, 0.0))
        written = limits.within(best.written + scale * (mixed - best.written), target)
        error = error_of(written)
        history.append(_figures(error[judged]))
        on_step(len(history), history[-1]["rmse_um"])
        if scale == 1.0:
            silent += ~_answers(best, written, error, tolerated)
        if _rms(error[answers & judged]) < _rms(best.error[answers & judged]):
            best, scale = _Iterate(written, error), 1.0
        else:
            damped, scale, mixing = damped + 1, scale / 2, Anderson(0)
    if best.written is h and damped:
        raise ResultError(
            "no step lowers the error of the prediction", key="precompensate", allowed="check the parameters"
        )
    trial = limits.within(best.written + best.error, target)
    meant = np.abs(best.error) <= (steps_um(target) or 0.0) / 2  # a design in steps says nothing finer than half of one
    reachable = ~footprint | meant | ((silent < 2) & _answers(best, trial, error_of(trial), tolerated))
    final = limits.sliced(best.written, footprint)
    error = best.error if final is best.written else error_of(final)
    return Precompensation(
        target.with_heights(final), target.with_heights(np.where(footprint, h - error, 0.0)), error,
        reachable, len(history), history, damped, _largest(best.error[judged & reachable]), limits,
    )  # fmt: skip


def correct(
    target: HeightMap, process: ParameterSet, limits: Limits, *, continued: bool = False, **settings: Any
) -> Precompensation:
    """Solve for a process of the program's own; what an instrument adds is not corrected.

    Parameters
    ----------
    target : HeightMap
    process : ParameterSet
    limits : Limits
    continued : bool
        The part goes on beyond its map as its mirror image, instead of ending there.
    **settings
        Of `precompensate`.
    """
    view = Continued.of(target, process, continued=continued)
    counted = np.pad(np.ones(target.shape, dtype=bool), [(r, r) for r in view.room])
    result = precompensate(
        view.whole, lambda written: predict(written, process), limits=limits, counted=counted, **settings
    )
    return result.in_view(view)


def steps_um(target: HeightMap) -> float | None:
    """Return the height of the steps in which a design comes, µm; None where its heights are continuous.

    Examples
    --------
    >>> slope = np.repeat([np.arange(1.0, 3.0, 0.01)], 9, axis=0)
    >>> steps_um(HeightMap(np.round(slope, 1), 1, 1)), steps_um(HeightMap(slope + 1e-4 * slope**2, 1, 1))
    (0.1, None)
    """
    heights = target.heights_um[target.heights_um > 0]
    levels = np.unique(np.round(heights, 4))
    if levels.size < 3 or levels.size > heights.size / 20:
        return None
    step = float(np.median(np.diff(levels)))
    whole = np.abs(levels / step - np.round(levels / step)) * step < 1e-3
    return round(step, 4) if step >= 0.01 and whole.all() else None


@dataclass(frozen=True)
class _Iterate:
    """Heights written, and what the print then lacks, µm."""

    written: np.ndarray
    error: np.ndarray


def _answers(before: _Iterate, written: np.ndarray, error: np.ndarray, tolerated: float) -> np.ndarray:
    """Tell where the print moves by at least `UNREACHABLE_RESPONSE` of what it lacked, or lacked next to nothing."""
    step = written - before.written
    moved = before.error - error
    small = np.abs(before.error) <= tolerated
    return small | ((moved * np.sign(before.error) >= UNREACHABLE_RESPONSE * np.abs(before.error)) & (step != 0))


def _figures(errors: np.ndarray) -> dict[str, float]:
    return {"rmse_um": _rms(errors), "largest_um": _largest(errors)}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max()) if values.size else 0.0
