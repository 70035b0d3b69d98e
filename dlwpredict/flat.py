"""Parameters as a flat vector: names for the user, numbers for an optimiser, neither knowing the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.parameters import Declaration, ParameterSet, declarations


def fittable(parameters: ParameterSet) -> dict[str, Declaration]:
    """Return every parameter a fit may touch: the seven, then ``effect-name.parameter`` in the order of the file.

    Examples
    --------
    >>> list(fittable(ParameterSet()))[2:4]
    ['threshold', 'crosslink_fwhm_xy_um']
    """
    known = {name: declaration for name, (_, declaration) in declarations(parameters.paper).items()}
    for effect in parameters.effects:
        known |= {f"{effect.name}.{key}": declaration for key, (_, declaration) in declarations(effect).items()}
    return {name: declaration for name, declaration in known.items() if declaration.fitted}


def value_of(parameters: ParameterSet, name: str) -> float:
    """Return one parameter by its flat name."""
    effect, _, key = name.rpartition(".")
    holder = next(e for e in parameters.effects if e.name == effect) if effect else parameters.paper
    return float(getattr(holder, key))


def with_values(parameters: ParameterSet, values: Mapping[str, float]) -> ParameterSet:
    """Return the same process with some parameters changed.

    Raises
    ------
    InputError
        A value lies outside its declared range, or κ_min above κ_max.
    """

    def of(prefix: str) -> dict[str, float]:
        return {name.rpartition(".")[2]: float(v) for name, v in values.items() if name.rpartition(".")[0] == prefix}

    effects = tuple(replace(effect, **of(effect.name)) for effect in parameters.effects)
    return replace(parameters, paper=replace(parameters.paper, **of("")), effects=effects)


@dataclass(frozen=True, eq=False)
class Free:
    """The parameters that a fit moves, in order, with their bounds.

    Parameters
    ----------
    base : ParameterSet
        Holds what stays fixed.
    names : tuple of str
        Flat names.
    low, high : numpy.ndarray, shape (parameters,)
        Bounds of the fit, inside the declared ranges.
    """

    base: ParameterSet
    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray

    @property
    def start(self) -> np.ndarray:
        """Values in `base`, shape (parameters,)."""
        return self.values(self.base)

    def values(self, parameters: ParameterSet) -> np.ndarray:
        """Return the vector of a parameter set, shape (parameters,)."""
        return np.array([value_of(parameters, name) for name in self.names])

    def parameters(self, vector: Sequence[float] | np.ndarray) -> ParameterSet:
        """Return the parameter set of a vector."""
        return with_values(self.base, dict(zip(self.names, vector, strict=True)))

    def allowed(self, vector: np.ndarray) -> np.ndarray:
        """Return the nearest vector inside the bounds that keeps κ_min ≤ κ_max."""
        vector = np.clip(vector, self.low, self.high)
        low, high = (self.index(name) for name in ("shrinkage_min", "shrinkage_max"))
        if low is not None:
            vector[low] = min(vector[low], self.base.paper.shrinkage_max if high is None else vector[high])
        elif high is not None:
            vector[high] = max(vector[high], self.base.paper.shrinkage_min)
        return vector

    def cut(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return intervals inside the bounds; that of a phase that passes an end goes on at the other: it is all of it.

        Examples
        --------
        >>> free = Free(ParameterSet(), ("threshold",), np.array([0.05]), np.array([0.95]))
        >>> free.cut(np.array([0.5]), np.array([1.1]))
        (array([0.5]), array([0.95]))
        """
        known = fittable(self.base)
        beyond = np.array([known[name].cyclic for name in self.names]) & ((low < self.low) | (high > self.high))
        return np.where(beyond, self.low, np.maximum(low, self.low)), np.where(
            beyond, self.high, np.minimum(high, self.high)
        )

    def index(self, name: str) -> int | None:
        """Return the place of a parameter in the vector, None if it is fixed."""
        return self.names.index(name) if name in self.names else None


def choose(parameters: ParameterSet, *, fix: Sequence[str] = (), free: Sequence[str] = ()) -> Free:
    """Choose what a fit moves.

    Parameters
    ----------
    parameters : ParameterSet
        Start values; its ``bounds`` narrow the declared ranges.
    fix : sequence of str
        Names held at their start value.
    free : sequence of str
        If any: only these move.

    Raises
    ------
    InputError
        Unknown name, the same name fixed and freed, nothing left to fit, empty bounds, or a start value outside.
    """
    known = fittable(parameters)
    for option, names in (("--fix", fix), ("--free", free)):
        for name in names:
            if name not in known:
                raise InputError(f"found {name}", key=option, allowed=f"allowed: {', '.join(known)}")
    for name in set(fix) & set(free):
        raise InputError(f"{name} is named for both", key="--fix and --free", allowed="allowed: one of them")
    names = tuple(name for name in known if name not in fix and (name in free or not free))
    if not names:
        raise InputError("every parameter is fixed", key="--fix", allowed="at least one must be free")
    bounds = [_bounds(name, known[name], parameters) for name in names]
    return Free(parameters, names, *(np.array(side) for side in zip(*bounds, strict=True)))


def _bounds(name: str, declaration: Declaration, parameters: ParameterSet) -> tuple[float, float]:
    low, high = parameters.bounds.get(name, (declaration.low, declaration.high))
    low, high = max(low, declaration.low), min(high, declaration.high)
    if not low < high:
        raise InputError(
            f"leaves {low:g} to {high:g}",
            key=f"bounds.{name}",
            allowed=f"allowed: a range inside {declaration.low:g} to {declaration.high:g}",
        )
    value = value_of(parameters, name)
    if not low <= value <= high:
        raise InputError(f"start value {value:g}", key=name, allowed=f"allowed by the bounds: {low:g} to {high:g}")
    return low, high
