"""Parameters as a flat vector: names for the user, numbers for an optimiser, neither knowing the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects.base import Effect
from dlwpredict.errors import InputError
from dlwpredict.parameters import Declaration, Paper, ParameterSet, declarations


def fittable(parameters: ParameterSet) -> dict[str, Declaration]:
    """Return every parameter a fit may touch: the seven, then ``effect-name.parameter`` in the order of the file.

    What effects share stands once, with the first of them.

    Examples
    --------
    >>> list(fittable(ParameterSet()))[2:4]
    ['threshold', 'crosslink_fwhm_xy_um']
    """
    known = {name: declaration for name, (_, declaration) in declarations(parameters.paper).items()}
    for effect in parameters.effects:
        for key, (_, declaration) in declarations(effect).items():
            known.setdefault(standing(parameters, f"{effect.name}.{key}"), declaration)
    return {name: declaration for name, declaration in known.items() if declaration.fitted}


def standing(parameters: ParameterSet, name: str) -> str:
    """Return the name under which a parameter is fitted: for what effects share, that of the first of them."""
    holders = _holders(parameters, name)
    return f"{holders[0].name}.{name.rpartition('.')[2]}" if holders else name


def value_of(parameters: ParameterSet, name: str) -> float:
    """Return one parameter by its flat name; of what effects share the largest, as the model does."""
    key = name.rpartition(".")[2]
    holders: Sequence[Effect | Paper] = _holders(parameters, name) or [parameters.paper]
    return max(float(getattr(holder, key)) for holder in holders)


def with_values(parameters: ParameterSet, values: Mapping[str, float]) -> ParameterSet:
    """Return the same process with some parameters changed, what effects share in all of them.

    Raises
    ------
    InputError
        A value lies outside its declared range, or κ_min above κ_max.
    """
    settings: dict[str, dict[str, float]] = {effect.name: {} for effect in parameters.effects}
    for name, value in values.items():
        for holder in _holders(parameters, name):
            settings[holder.name][name.rpartition(".")[2]] = float(value)
    seven = {name: float(value) for name, value in values.items() if "." not in name}
    effects = tuple(replace(effect, **settings[effect.name]) for effect in parameters.effects)
    return replace(parameters, paper=replace(parameters.paper, **seven), effects=effects)


def within(parameters: ParameterSet) -> ParameterSet:
    """Return the process with what its effects have outside its bounds brought to the nearest end.

    An effect that a search has added begins where it is typical, whatever bounds a file gives it.
    """
    ends = {standing(parameters, key): limits for key, limits in parameters.bounds.items() if "." in key}
    there = fittable(parameters)
    values = {name: float(np.clip(value_of(parameters, name), *ends[name])) for name in ends if name in there}
    return with_values(parameters, values)


def _holders(parameters: ParameterSet, name: str) -> list[Effect]:
    """Return the effects that hold a parameter: one, or all that share it; none for the seven and unknown names."""
    owner, _, key = name.rpartition(".")
    holders = [effect for effect in parameters.effects if key in declarations(effect)] if owner else []
    if any(declarations(effect)[key][1].shared for effect in holders):
        return holders if any(effect.name == owner for effect in holders) else []
    return [effect for effect in holders if effect.name == owner]


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

    def reach(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far each parameter may move down and up from a place; a phase goes round without end.

        Examples
        --------
        >>> free = Free(ParameterSet(), ("threshold",), np.array([0.05]), np.array([0.95]))
        >>> [end.round(2).tolist() for end in free.reach(np.array([0.95]))]
        [[-0.9], [0.0]]
        """
        known = fittable(self.base)
        endless = np.array([known[name].cyclic for name in self.names])
        low, high = np.minimum(self.low - vector, -1e-12), np.maximum(self.high - vector, 1e-12)
        return np.where(endless, -np.inf, low), np.where(endless, np.inf, high)

    def of_effect(self, name: str) -> list[int]:
        """Return the places of the parameters of an effect in the vector."""
        return [k for k, flat in enumerate(self.names) if flat.startswith(f"{name}.")]

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
    known, asked = fittable(parameters), {"--fix": fix, "--free": free}
    for option, names in asked.items():
        for name in names:
            if standing(parameters, name) not in known:
                raise InputError(f"found {name}", key=option, allowed=f"allowed: {', '.join(known)}")
    fixed, freed = ({standing(parameters, name) for name in names} for names in asked.values())
    for name in fixed & freed:
        raise InputError(f"{name} is named for both", key="--fix and --free", allowed="allowed: one of them")
    names = tuple(name for name in known if name not in fixed and (name in freed or not freed))
    if not names:
        raise InputError("every parameter is fixed", key="--fix", allowed="at least one must be free")
    bounds = [_bounds(name, known[name], parameters) for name in names]
    return Free(parameters, names, *(np.array(side) for side in zip(*bounds, strict=True)))


def _bounds(name: str, declaration: Declaration, parameters: ParameterSet) -> tuple[float, float]:
    given = [limits for key, limits in parameters.bounds.items() if standing(parameters, key) == name]
    low = max([declaration.low, *(low for low, _ in given)])
    high = min([declaration.high, *(high for _, high in given)])
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
