"""Predicting again after a change: what lies upstream of the change is taken over, not recomputed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.model.states import Crosslinked, Dose, Exposed, Numerics
from dlwpredict.model.steps import Shrinkage, Threshold
from dlwpredict.parameters import ParameterSet, declarations
from dlwpredict.process import room_px, steps

WORK_SHARE = {"exposed": 0.7, "column mean": 0.3}
"""Share of the two costly steps in one prediction: 0.44 to 0.84 for the first, median 0.7, of twelve parts of 76² to
158² pixels at 0.3 to 0.4 µm."""


@dataclass(frozen=True, eq=False)
class Known:
    """Numerics that have been here before: the column mean is already computed."""

    mean: np.ndarray

    def exposed(self, dose: Dose, threshold: float, reference: str) -> Exposed:
        """Refuse: no threshold comes after the column mean."""
        raise TypeError("the column mean is already computed")

    def column_mean(self, crosslinked: Crosslinked, reference: str) -> np.ndarray:
        """Return the mean that was computed before, shape (rows, cols)."""
        return self.mean


@dataclass(frozen=True)
class ColumnMean:
    """Compute the column mean of cross-linking ahead of `Shrinkage`, so that a change of κ finds it done."""

    reference: str
    stage: ClassVar[str] = "crosslink"

    def __call__(self, crosslinked: Crosslinked) -> Crosslinked:
        """Return the state with its column mean known."""
        exposed = crosslinked.exposed
        known = Known(exposed.dose.numerics.column_mean(crosslinked, self.reference))
        return replace(crosslinked, exposed=replace(exposed, dose=replace(exposed.dose, numerics=known)))


@dataclass(frozen=True, eq=False)
class Trace:
    """One prediction with every state it passed through.

    Parameters
    ----------
    chain : tuple
        The steps.
    states : tuple
        The state before the first step, and after each.
    room : tuple of int
        Rows and columns of empty resin around the map.
    work : float
        What this prediction cost in full predictions of this target.
    """

    chain: tuple
    states: tuple
    room: tuple[int, int]
    work: float

    @property
    def numerics(self) -> Numerics:
        """The way of computing that the steps share."""
        return next(step.numerics for step in self.chain if hasattr(step, "numerics"))

    @property
    def heights_um(self) -> np.ndarray:
        """Predicted heights on the target's grid, shape (rows, cols)."""
        return self.states[-1].heights_um

    @property
    def bare(self) -> Trace:
        """The prediction without the states that it passed through: nothing can be taken over from it."""
        return replace(self, states=self.states[-1:], room=(-1, -1))


def whole(parameters: ParameterSet) -> ParameterSet:
    """Return a process whose instrument leaves no gaps: what a recording lacks does not count, and needs no prediction.

    Gaps come from switches that no fit moves, such as the steepest angle of `slope-error`.
    """
    gaps = [
        {n: declarations(e)[n][0] for n in e.switches() if not declarations(e)[n][1].fitted} for e in parameters.effects
    ]
    if not any(gaps):
        return parameters
    return replace(
        parameters, effects=tuple(replace(e, **off) for e, off in zip(parameters.effects, gaps, strict=True))
    )


def trace(target: HeightMap, parameters: ParameterSet, numerics: Numerics, known: Trace | None = None) -> Trace:
    """Predict what an instrument would show, starting from the last state that an earlier prediction shares.

    A change of κ repeats the last step alone, one of the cross-linking FWHMs leaves the exposure as it is; an added
    effect repeats what follows it. Gaps that an instrument would leave are none here.

    Parameters
    ----------
    target : HeightMap
    parameters : ParameterSet
    numerics : Numerics
        The same object in every call, or nothing is shared.
    known : Trace, optional
        An earlier prediction of the same target.
    """
    parameters = whole(parameters)
    room = room_px(target, parameters)
    chain = tuple(_chain(parameters, numerics, room))
    states: list[Any] = [target.with_heights(np.pad(target.heights_um, [(r, r) for r in room]))]
    if known is not None and known.room == room:
        shared = next(
            (k for k, (a, b) in enumerate(zip(chain, known.chain, strict=False)) if a != b),
            min(len(chain), len(known.chain)),
        )
        states = list(known.states[: shared + 1])
    todo = chain[len(states) - 1 :]
    for step in todo:
        states.append(step(states[-1]))
    return Trace(chain, tuple(states), room, sum(_cost(step) for step in todo))


def _chain(parameters: ParameterSet, numerics: Numerics, room: tuple[int, int]) -> list[Any]:
    chain = steps(parameters, numerics, as_measured=True, room_px=room)
    at = next(k for k, step in enumerate(chain) if isinstance(step, Shrinkage))
    return [*chain[:at], ColumnMean(parameters.readings.crosslink_reference), *chain[at:]]


def _cost(step: Any) -> float:
    kind = "exposed" if isinstance(step, Threshold) else "column mean" if isinstance(step, ColumnMean) else ""
    return WORK_SHARE.get(kind, 0.0)
