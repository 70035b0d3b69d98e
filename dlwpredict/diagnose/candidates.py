"""Candidates: every named effect, at a few of its shapes, and what it would do to these recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np

from dlwpredict.calibrate.recordings import Recording
from dlwpredict.calibrate.trace import Trace, trace
from dlwpredict.effects import library
from dlwpredict.effects.base import Effect
from dlwpredict.heightmap import HeightMap
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import Declaration, ParameterSet, declarations
from dlwpredict.process import predict

NO_CANDIDATES = ("misregistration", "z-amplification")
"""One stands among the nuisances of every recording; the other is exactly what κ can do, and only a certified step
height tells them apart."""

SHAPES = (0.5, 1.0, 2.0)
"""Lengths are tried at these multiples of their default, inside the declared range."""

SMALL = 0.5
"""Signatures are derivatives, taken by a step of this share of the typical size."""


@dataclass(frozen=True)
class Candidate:
    """One effect with one switch and one shape: a direction in which the prediction could change.

    Parameters
    ----------
    effect : Effect
        At its off values, with the shape set.
    switch : str
        The parameter that grows from its off value.
    """

    effect: Effect
    switch: str

    @property
    def name(self) -> str:
        """Standard name of the effect."""
        return self.effect.name

    @property
    def declaration(self) -> Declaration:
        """What is declared of the switch."""
        return declarations(self.effect)[self.switch][1]

    @property
    def off(self) -> float:
        """Value of the switch at which nothing happens."""
        return declarations(self.effect)[self.switch][0]

    @property
    def unit(self) -> float:
        """Change of the switch from off to its typical size."""
        return self.declaration.typical - self.off

    @property
    def one_sided(self) -> int:
        """+1 where physics allows only values above off, −1 below, 0 both."""
        return int(self.declaration.low >= self.off) - int(self.declaration.high <= self.off)

    def at(self, share: float) -> Effect:
        """Return the effect switched on to a share of its typical size, inside its range."""
        value = np.clip(self.off + share * self.unit, self.declaration.low, self.declaration.high)
        return replace(self.effect, **{self.switch: float(value)})


def candidates(parameters: ParameterSet) -> list[Candidate]:
    """Return every candidate that the parameter set does not contain already."""
    present = {effect.name for effect in parameters.effects}
    found = []
    for name, kind in library().items():
        if name not in present and name not in NO_CANDIDATES:
            found += [Candidate(kind(**shape), switch) for switch in kind.switches() for shape in _shapes(kind, switch)]
    return found


def _shapes(kind: type[Effect], switch: str) -> list[dict[str, float]]:
    """Return the settings of an effect's shape that are worth a column: lengths, angles, the channels of a dose."""
    axes: dict[str, list[float]] = {}
    for name, (default, declared) in declarations(kind).items():
        values = [] if levelled(kind, name) else _values(name, default, declared)
        if name not in kind.switches() and declared.fitted and values and matters(kind, switch, name):
            axes[name] = values
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def _values(name: str, default: float, declared: Declaration) -> list[float]:
    """Return the values of a shape parameter worth trying."""
    if declared.unit == "1":
        return [declared.low, declared.high]
    if declared.unit == "°":
        return [0.0, 45.0]
    if declared.unit == "rad":
        return [0.0, np.pi / 2]
    if declared.unit == "µm" and declared.low > 0:
        return [float(np.clip(default * s, declared.low, declared.high)) for s in SHAPES]
    return [declared.low / 2, default, declared.high / 2]


def levelled(kind: type[Effect], name: str) -> bool:
    """Tell whether a shape is the centre of a bend of heights: elsewhere it is the same bend and a plane."""
    return name.startswith("centre_") and kind.stage != "dose"


@cache
def matters(kind: type[Effect], switch: str, name: str) -> bool:
    """Tell whether a shape parameter changes anything while this switch is on, by trying it on a small part."""
    heights = np.zeros((20, 20))
    heights[4:16, 4:16] = np.linspace(2, 6, 12)
    default, declared = declarations(kind)[name]
    other = declared.low if default == declared.high else min(declared.high, 2 * default or 1.0)
    switched = {switch: declarations(kind)[switch][1].typical}
    maps = [
        predict(HeightMap(heights, 1.0, 1.0), ParameterSet(effects=(kind(**settings),)), as_measured=True).heights_um
        for settings in (switched, switched | {name: other})
    ]
    return bool(np.abs(np.nan_to_num(maps[1] - maps[0])).max() > 1e-7)


def signatures(
    chosen: Sequence[Candidate],
    recordings: Sequence[Recording],
    parameters: ParameterSet,
    known: Sequence[Trace],
    workers: Workers = ALONE,
) -> list[list[np.ndarray]]:
    """Return the change of every recording's prediction per typical size of every candidate.

    Returns
    -------
    list (candidate) of list (recording) of numpy.ndarray, shape (rows, cols), µm
        The derivative at off, by one forward difference.
    """
    jobs = [
        (candidate, recording.target, parameters, before)
        for candidate in chosen
        for recording, before in zip(recordings, known, strict=True)
    ]
    maps, per = workers.each(_change, jobs), len(recordings)
    return [maps[k * per : (k + 1) * per] for k in range(len(chosen))]


def _change(candidate: Candidate, target: HeightMap, parameters: ParameterSet, known: Trace) -> np.ndarray:
    effect = candidate.at(SMALL)
    step = (getattr(effect, candidate.switch) - candidate.off) / candidate.unit
    with_effect = replace(parameters, effects=(*parameters.effects, effect))
    moved = trace(target, with_effect, known.numerics, known)
    return np.nan_to_num(moved.heights_um - known.heights_um) / step
