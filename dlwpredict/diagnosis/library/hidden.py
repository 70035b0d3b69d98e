"""Second columns of effects whose first-order signature the process absorbs.

To first order nothing is left of them, and no score points at them. At its typical size such an effect is not linear:
the process answers, registration is fitted anew, and the remaining difference is a column like any other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.candidates import Bent, Candidate
from dlwpredict.infer.model import freed, holding
from dlwpredict.infer.objective import Fit, Objective


def bent(
    objective: Objective,
    model: Fit,
    process: Sequence[int],
    chosen: Sequence[Candidate],
    answers: np.ndarray,
    lengths: np.ndarray,
    whole: np.ndarray,
) -> tuple[list[Bent], np.ndarray]:
    """Return the candidates that the process hides, and what is left of each at its typical size.

    Parameters
    ----------
    objective : Objective
    model : Fit
    process : sequence of int
        Parameters of the model that are the process's own.
    chosen : sequence of Candidate
    answers : numpy.ndarray, shape (process, candidates)
        By how much every parameter of the process answers to a typical size, to first order.
    lengths, whole : numpy.ndarray, shape (candidates,)
        Lengths of the signatures beside the process, and before it has answered.

    Returns
    -------
    list of Bent
    numpy.ndarray, shape (rows, candidates)
        Change of the prediction beside the nuisances.
    """
    largest: dict[tuple[str, str], int] = {}
    for k in hidden(whole, lengths, chosen):
        place = chosen[k].name, chosen[k].switch
        if place not in largest or whole[k] > whole[largest[place]]:
            largest[place] = int(k)
    names = [model.free.names[k] for k in process]
    candidates, columns = [], []
    for k in largest.values():
        for direction in (1.0, -1.0):
            if direction * chosen[k].sign < 0:
                continue
            vector = model.vector.copy()
            vector[list(process)] += direction * answers[:, k]
            moved = (model.free.allowed(vector) - model.vector)[list(process)]
            answer = tuple(zip(names, moved, strict=True))
            candidate = Bent(chosen[k].effect, chosen[k].switch, direction, answer)
            columns.append(model.residual - answered(objective, model, candidate).residual)
            candidates.append(candidate)
    return candidates, np.stack(columns, axis=1) if columns else np.zeros((model.rows.total, 0))


def hidden(whole: np.ndarray, lengths: np.ndarray, chosen: Sequence[Candidate]) -> list[int]:
    """Return the candidates whose typical size is visible with the process fixed, and hardly once it is fitted.

    That is from `policy.SEEN` standard deviations on, and down to the share `policy.TAKEN`; second columns (`Bent`) are
    never among them.
    """
    taken = np.flatnonzero((whole >= policy.SEEN) & (lengths < policy.TAKEN * whole)).tolist()
    return [k for k in taken if not isinstance(chosen[k], Bent)]


def answered(objective: Objective, model: Fit, candidate: Bent) -> Fit:
    """Return the model with the candidate at its typical size, the process having answered; nuisances are fitted."""
    answer = dict(candidate.answer)
    pairs = zip(model.free.names, model.vector, strict=True)
    moved = model.free.allowed(np.array([value + answer.get(name, 0.0) for name, value in pairs]))
    process = holding(model.free.parameters(moved), [candidate.at(1.0)])
    free = freed(process, model.free)
    return objective.at(free, free.start, model)
