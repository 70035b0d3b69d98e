"""Candidates: every named effect, at a few of its shapes: a direction in which the prediction could change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects import library
from dlwpredict.effects.base import Effect
from dlwpredict.infer.model import matters, shows, switched
from dlwpredict.parameters import Declaration, ParameterSet, declarations

NO_CANDIDATES = ("misregistration", "z-amplification")
"""One stands among the nuisances of every recording; the other is exactly what κ can do, and only a certified step
height tells them apart."""

SHAPES = (0.5, 1.0, 2.0)
"""Lengths are tried at these multiples of their default, inside the declared range."""

Placed = Mapping[str, Sequence[dict[str, float]]]
"""Name of an effect to the places where it may sit, as settings that no fit moves."""

NOWHERE: Placed = {}

WAVES = (0.5, 0.625, 0.8, 1.0, 1.25, 1.6, 2.0)
"""Periods are tried closer: two waves differ where they are half a period apart over the map's relief."""


@dataclass(frozen=True)
class Candidate:
    """One effect with one switch and one shape: a direction in which the prediction could change.

    Parameters
    ----------
    effect : Effect
        At its off values, with the shape set; one that a model has, as it is there.
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
        return self.effect.switches()[self.switch] - self.off

    @property
    def one_sided(self) -> int:
        """+1 where physics allows only values above off, −1 below, 0 both."""
        return int(self.declaration.low >= self.off) - int(self.declaration.high <= self.off)

    def at(self, share: float) -> Effect:
        """Return the effect with its switch moved by a share of the typical size, inside its range."""
        value = getattr(self.effect, self.switch) + share * self.unit
        value = np.clip(value, self.declaration.low, self.declaration.high)
        return replace(self.effect, **{self.switch: float(value)})

    def alone(self, share: float) -> Effect:
        """Return the effect with no other switch on, and this one at a share of its typical size."""
        off = {switch: declarations(self.effect)[switch][0] for switch in self.effect.switches()}
        return replace(self, effect=replace(self.effect, **off)).at(share)

    def size_of(self, moved: Effect) -> float:
        """Return by how many typical sizes the switch has been moved."""
        return float(getattr(moved, self.switch) - getattr(self.effect, self.switch)) / self.unit

    @property
    def lowest(self) -> float:
        """Strength at the end of the range on the side that the typical size is not on, in typical sizes: 0 or less."""
        return min((end - self.off) / self.unit for end in (self.declaration.low, self.declaration.high))

    @property
    def highest(self) -> float:
        """Strength at the end of the range on the side of the typical size, in typical sizes."""
        return max((end - self.off) / self.unit for end in (self.declaration.low, self.declaration.high))

    @property
    def sign(self) -> int:
        """Sign of the strength, in typical sizes, that alone is physical; 0 where both are."""
        return self.one_sided * int(np.sign(self.unit))


@dataclass(frozen=True)
class Bent(Candidate):
    """A candidate whose first-order signature the process absorbs, as a shift does a lag and a wide focus a blur.

    What is left of it grows about with the square of its size; strengths are such squares.

    Parameters
    ----------
    direction : float
        Sign of the switch's change from off, in typical sizes.
    answer : tuple of (str, float)
        By how much every parameter of the process moves in answer to the typical size.
    """

    direction: float = 1.0
    answer: tuple[tuple[str, float], ...] = ()

    @property
    def sign(self) -> int:
        """Only what is left of it can be there."""
        return 1

    def at(self, share: float) -> Effect:
        """Return the effect switched on to the root of a share."""
        return super().at(self.direction * float(np.sqrt(max(share, 0.0))))


def candidates(parameters: ParameterSet, named: Sequence[str] = (), placed: Placed = NOWHERE) -> list[Candidate]:
    """Return every candidate: effects that a process has not, and other switches of those that a diagnosis has named.

    An effect was named by the switch that promised most; where several of its own are on, each could do alone. One that
    has a place is tried at each where it may sit.
    """
    present = {effect.name: effect for effect in parameters.effects}
    new = [
        Candidate(kind(**shape, **place), switch)
        for name, kind in library().items()
        if name not in present and name not in NO_CANDIDATES
        for switch in _fitted(kind)
        for shape in _shapes(kind, switch)
        for place in placed.get(name, [{}])
    ]
    return new + [one for name in named for one in _further(present[name])]


def _fitted(kind: type[Effect]) -> list[str]:
    """Return the switches that a fit may move."""
    return [switch for switch in kind.switches() if declarations(kind)[switch][1].fitted]


def _further(effect: Effect) -> list[Candidate]:
    """Return the candidates that an effect of a model is by its other switches, its shape as it is where it matters."""
    kind, on = type(effect), switched(effect)
    known = {name for name in declarations(kind) if any(matters(kind, switch, name) for switch in on)}
    new = (
        Candidate(replace(effect, **{name: value for name, value in shape.items() if name not in known}), switch)
        for switch in _fitted(kind)
        if switch not in on or len(on) > 1
        for shape in _shapes(kind, switch)
    )
    return list(dict.fromkeys(new))


def _shapes(kind: type[Effect], switch: str) -> list[dict[str, float]]:
    """Return the settings of an effect's shape that are worth a column.

    Shares, phases and directions mix two columns each, so that all their ends are combined (a wave whose amplitude has
    one sign, from all four sides); lengths and centres are tried one at a time from their defaults.
    """
    mixed: list[dict[str, float]] = [{}]
    varied: list[dict[str, float]] = [{}]
    for name, (default, declared) in declarations(kind).items():
        if name in kind.switches() or not declared.fitted or not shows(kind, switch, name):
            continue
        values = _values(name, default, declared)
        if name.startswith("centre_") or declared.unit == "µm":
            mixed = [shape | {name: default} for shape in mixed]
            varied += [{name: value} for value in values if value != default]
        else:
            mixed = [shape | {name: value} for shape in mixed for value in values]
    return [shape | change for shape in mixed for change in varied]


def _values(name: str, default: float, declared: Declaration) -> list[float]:
    """Return the values of a shape parameter worth trying."""
    if declared.unit == "1":
        return [declared.low, declared.high]
    if declared.unit == "°":
        return [0.0, 45.0]
    if declared.unit == "rad":
        return [0.0, np.pi / 2, np.pi, -np.pi / 2]
    if declared.unit == "µm" and declared.low > 0:
        shapes = WAVES if name == "period_um" else SHAPES
        return [float(np.clip(default * s, declared.low, declared.high)) for s in shapes]
    return [declared.low / 2, default, declared.high / 2]
