"""What the process's own form may be wrong by: how much of a name's gain stands beside it, and what a rival is excused.

The widths of cross-linking are means: radicals reach differently far, and no distribution of reaches is one Gaussian. A
spread of relative size s changes a print by ½ s² ∂²h/∂(ln w)², whatever its cause: tails, kinetics of conversion, two
kinds of radicals. Tails reach too far for that alone, and along and across the axis at once: a share a of the radicals
that reaches f times as far changes it by a (h(f·w) − h(w)). And the base holds the lowest layers, so that they shrink
in height otherwise than those above.
These hold most of what calibration leaves of an error of form; the focus's own form shows beside walls, where no points
count. They are doubted as far as their standard deviations go. An effect that explains nothing beside them is not known
to be there.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import linalg
from scipy.optimize import lsq_linear

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.score import process_of
from dlwpredict.diagnosis.library.signatures import done_by
from dlwpredict.infer.free import fittable
from dlwpredict.infer.objective import Fit, Objective


class Standing(NamedTuple):
    """How a model stands beside what is doubted about the process's form.

    Parameters
    ----------
    shares : dict
        Name of an effect to the share of its gain that the process's form cannot have, 0 to 1.
    doubted : float
        2 ln L of what the model leaves that the doubts explain.
    """

    shares: dict[str, float]
    doubted: float

    def excuses(self, rival: Standing) -> float:
        """Return how much of what a rival costs more than this model the process's form may have made, 2 ln L.

        As of the gain of a name beside none.
        """
        return max(_of_form(rival.doubted, self.doubted), 0.0)


def doubts(model: Fit, objective: Objective) -> list[np.ndarray]:
    """Return what spreads and tails of cross-linking do to every recording, and κ_min that changes with height.

    Parameters
    ----------
    model : Fit
    objective : Objective
        Predicts, and counts the work: two predictions for each, one for the tails.

    Returns
    -------
    list of numpy.ndarray, shape (doubts, rows, cols)
        µm for one standard deviation.
    """
    widths = _spreads(model)
    columns = [_spread(model, objective, k, size) for k, size in widths.items()]
    if widths:
        columns.append(_tail(model, objective, list(widths)))
    if (k := model.free.index("shrinkage_min")) is not None:
        slopes, now = objective.derivatives(model, [k]), [trace.heights_um for trace in model.traces]
        highest = max(float(heights.max()) for heights in now)
        columns.append([policy.HELD * one[0] * heights / highest for one, heights in zip(slopes, now, strict=True)])
    return [np.stack(maps) for maps in zip(*columns, strict=True)] if columns else []


def _spreads(model: Fit) -> dict[int, float]:
    """Return the widths that may be spread, and by how much."""
    values = enumerate(zip(model.free.names, model.vector, strict=True))
    return {k: policy.SPREAD * value for k, (name, value) in values if name.startswith("crosslink_fwhm")}


def _spread(model: Fit, objective: Objective, k: int, size: float) -> list[np.ndarray]:
    """Return ½ s² ∂²h/∂θ² of every recording by a second difference, taken inside the declared range."""
    value, declared = model.vector[k], fittable(model.free.base)[model.free.names[k]]
    step = min(size, value - declared.low, declared.high - value)
    if step < 0.1 * size:
        return [np.zeros(trace.heights_um.shape) for trace in model.traces]
    moved = [model.free.parameters(model.vector + way * step * np.eye(len(model.vector))[k]) for way in (1, -1)]
    jobs = [(i, process, before) for i, before in enumerate(model.traces) for process in moved]
    ends = [one.heights_um for one in objective.traces(jobs)]
    pairs = zip(ends[::2], ends[1::2], model.traces, strict=True)
    return [np.nan_to_num(up + down - 2 * now.heights_um) / 2 * (size / step) ** 2 for up, down, now in pairs]


def _tail(model: Fit, objective: Objective, widths: Sequence[int]) -> list[np.ndarray]:
    """Return a (h(f·w) − h(w)) of every recording, all widths together, where ln w spreads by a (ln f)² = `SPREAD`².

    f is `policy.FARTHER`, or as far as the declared ranges go.
    """
    declared, vector = fittable(model.free.base), model.vector.copy()
    farther = min(policy.FARTHER, *(declared[model.free.names[k]].high / vector[k] for k in widths))
    if farther < 1 + policy.SPREAD:
        return [np.zeros(trace.heights_um.shape) for trace in model.traces]
    vector[list(widths)] *= farther
    process, share = model.free.parameters(vector), (policy.SPREAD / np.log(farther)) ** 2
    ends = objective.traces([(i, process, before) for i, before in enumerate(model.traces)])
    return [share * np.nan_to_num(end.heights_um - now.heights_um) for end, now in zip(ends, model.traces, strict=True)]


def standing(model: Fit, named: Sequence[str], objective: Objective) -> Standing:
    """Return how a model stands beside the doubts, to first order.

    Of an effect stands, beside all others, what it gains beside the doubts, less the share of what the doubts gain
    without it that an error of form leaves them. The process stays within its ranges: a width at the end of one cannot
    answer beyond it.

    Parameters
    ----------
    model : Fit
        With derivatives.
    named : sequence of str
        Effects that a diagnosis has added.
    objective : Objective
    """
    if not (maps := doubts(model, objective)):
        return Standing(dict.fromkeys(named, 1.0), 0.0)
    process, done = process_of(model, named), {name: done_by(model, name, objective.work) for name in named}
    seen = {name: model.seen_in_all(change) for name, change in done.items()}
    blocks = [np.column_stack([seen[name], model.jacobian[:, model.free.of_effect(name)]]) for name in named]
    parts = [model.jacobian[:, process], model.seen_in_all(maps), *blocks]
    rows = model.nuisances.triangle(np.column_stack([*parts, model.residual + sum(seen.values())]))
    ends = np.cumsum([0, *(part.shape[1] for part in parts)])
    own, doubted, *effects = (rows[:, first:last] for first, last in pairwise(ends))
    reach = [end[process] for end in model.free.reach(model.vector)]

    def left(free: Sequence[np.ndarray]) -> list[float]:
        """Return −2 ln L beside columns of any strength: of the process as it is, and as it is doubted."""
        columns = np.column_stack([own[:, :0], *free])
        return [_left(rows[:, -1], columns, own, reach, some) for some in (doubted[:, :0], doubted)]

    with_it, both = left(effects)
    shares = {}
    for k, name in enumerate(named):
        bare, in_doubt = left(effects[:k] + effects[k + 1 :])
        sure = bare - with_it - _of_form(bare - in_doubt, with_it - both)
        shares[name] = float(np.clip(sure / (bare - with_it), 0, 1)) if bare > with_it else 1.0
    return Standing(shares, with_it - both)


def _of_form(beside_other: float, beside_model: float) -> float:
    """Return what an error of form may have of the distance between two models, by what the doubts explain beside each.

    Beside the worse one it explains what they do, and the share of that which it leaves them.
    """
    return (1 + policy.UNDOUBTED) * beside_other - beside_model


def _left(
    residual: np.ndarray, free: np.ndarray, own: np.ndarray, reach: Sequence[np.ndarray], doubted: np.ndarray
) -> float:
    """Return −2 ln L beside columns of any strength, a process within its ranges, and doubts as strong as they may be.

    Their strengths have a standard deviation of 1, and none is larger than `policy.POSSIBLE`: a strong effect would
    have them at any size, where no process is that wrong.
    """
    sizes = np.maximum(np.linalg.norm(free, axis=0), 1e-12)
    basis = linalg.orth(free / sizes, rcond=1e-5) if free.size else free
    bounded = np.hstack([own, doubted])
    known = np.eye(bounded.shape[1])[own.shape[1] :]
    columns = np.vstack([bounded - basis @ (basis.T @ bounded), known])
    ends = np.append(residual - basis @ (basis.T @ residual), np.zeros(len(known)))
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    most = np.full(len(known), policy.POSSIBLE)
    limits = np.append(reach[0], -most) * sizes, np.append(reach[1], most) * sizes
    return 2 * float(lsq_linear(columns / sizes, ends, limits, method="bvls").cost)
