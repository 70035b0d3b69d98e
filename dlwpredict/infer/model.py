"""Which parameters of a process a fit moves, and what makes two processes the same model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from dlwpredict.effects.base import Effect
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import Free, choose, value_of, with_values, within
from dlwpredict.infer.whitened import levels
from dlwpredict.parameters import ParameterSet, declarations
from dlwpredict.process import predict

Key = tuple[str, ...]


def freed(parameters: ParameterSet, like: Free) -> Free:
    """Return what may move: of the seven what moved before, of every effect the switches that are on, and their shapes.

    Parameters
    ----------
    parameters : ParameterSet
    like : Free
        Says which of the seven move.
    """
    names = [name for name in like.names if "." not in name]
    for effect in parameters.effects:
        kind, switches = type(effect), switched(effect)
        shapes = [n for n, (_, d) in declarations(effect).items() if d.fitted and n not in effect.switches()]
        shapes = [n for n in shapes if any(shows(kind, s, n) for s in switches)]
        names += [f"{effect.name}.{n}" for n in (*switches, *shapes)]
    return choose(within(parameters), free=names)


def switched(effect: Effect) -> list[str]:
    """Return the switches of an effect that are on and that a fit may move: not a steepest angle, which leaves gaps."""
    known = {switch: declarations(effect)[switch] for switch in effect.switches()}
    return [switch for switch, (off, declared) in known.items() if declared.fitted and getattr(effect, switch) != off]


def on(parameters: ParameterSet, name: str) -> int:
    """Return how many switches of an effect are on: one, where a fit has put it to nothing."""
    return max(len(switched(effect_of(parameters, name))), 1)


def moving(parameters: ParameterSet, like: Free) -> Free:
    """Return what a fit moves: where the effects are those of `like`, just what `like` says; else what is `freed`."""
    if [effect.name for effect in parameters.effects] == [effect.name for effect in like.base.effects]:
        return replace(like, base=parameters)
    return freed(parameters, like)


def key_of(free: Free) -> Key:
    """Return what makes a model: the names that move, and what no fit moves of its effects where that is not usual.

    What effects share belongs to none of them, whichever stands first.
    """
    settings = [
        f"{effect.name}.{name}={getattr(effect, name):.9g}"
        for effect in free.base.effects
        for name, (default, declared) in declarations(effect).items()
        if not declared.fitted and getattr(effect, name) != default
    ]
    shared = {f"{one.name}.{n}": n for one in free.base.effects for n, (_, d) in declarations(one).items() if d.shared}
    return tuple(sorted([*(shared.get(name, name) for name in free.names), *settings]))


def matters(kind: type[Effect], switch: str, name: str) -> bool:
    """Tell whether a shape parameter changes anything while this switch is on."""
    return _changes(kind, switch, name)[0]  # type: ignore[arg-type]  # mypy takes no class for Hashable


def shows(kind: type[Effect], switch: str, name: str) -> bool:
    """Tell whether a shape parameter changes more than a plane, which levelling takes, while this switch is on.

    A sag of all heights in view is elsewhere the same sag and a plane; a coma is not.
    """
    return _changes(kind, switch, name)[1]  # type: ignore[arg-type]  # mypy takes no class for Hashable


@cache
def _changes(kind: type[Effect], switch: str, name: str) -> tuple[bool, bool]:
    """Tell whether a shape changes anything, and more than a plane, by trying it on a small part."""
    heights = np.zeros((20, 20))
    heights[4:16, 4:16] = np.linspace(2, 6, 12)
    part = HeightMap(heights, 1.0, 1.0)
    default, declared = declarations(kind)[name]
    changed = declared.low if default == declared.high else min(declared.high, 2 * default or 1.0)
    switched = {switch: declarations(kind)[switch][1].typical}
    maps = [
        predict(part, ParameterSet(effects=(kind(**settings),)), as_measured=True).heights_um
        for settings in (switched, switched | {name: changed})
    ]
    change, planes = np.nan_to_num(maps[1] - maps[0]).ravel(), levels(part).reshape(-1, heights.size).T
    bend = change - planes @ np.linalg.lstsq(planes, change, rcond=None)[0]
    return bool(np.abs(change).max() > 1e-7), bool(np.abs(bend).max() > 1e-7)


def effect_of(parameters: ParameterSet, name: str) -> Effect:
    """Return the effect of this name."""
    return next(effect for effect in parameters.effects if effect.name == name)


def lacking(parameters: ParameterSet, names: Sequence[str]) -> ParameterSet:
    """Return the process without some of its effects."""
    return replace(parameters, effects=tuple(effect for effect in parameters.effects if effect.name not in names))


def joined(parameters: ParameterSet, effects: Sequence[Effect], like: Free) -> ParameterSet:
    """Return the process with effects, each in the place of its own where it has one already.

    What moves there, and what effects share, keeps its value.
    """
    known = {name: value_of(parameters, name) for name in freed(parameters, like).names}
    return with_values(holding(parameters, effects), known)


def holding(parameters: ParameterSet, effects: Sequence[Effect]) -> ParameterSet:
    """Return the process with effects, each in the place of its own where it has one already."""
    new = {effect.name: effect for effect in effects}
    there = {effect.name: new.pop(effect.name, effect) for effect in parameters.effects}
    return replace(parameters, effects=(*there.values(), *new.values()))
