"""Names and classes: what a set of effects is given, how surely, and what could stand in the place of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.search import Names, Search
from dlwpredict.effects import library
from dlwpredict.effects.base import Effect
from dlwpredict.infer.model import effect_of
from dlwpredict.infer.objective import Fit
from dlwpredict.parameters import declarations


@dataclass(frozen=True, eq=False)
class Member:
    """An effect that could stand in one slot of a set.

    Parameters
    ----------
    effect : Effect
        As fitted.
    loss : float
        2 ln L that the set loses with it.
    probability : float
        Of it among the members of its class.
    fit : Fit
        The set with it.
    """

    effect: Effect
    loss: float
    probability: float
    fit: Fit


@dataclass(frozen=True, eq=False)
class Named:
    """One slot of the best set: its effect, and those that would do nearly as well.

    Parameters
    ----------
    effect : Effect
        As fitted in the best set.
    gain : float
        2 ln L that it brings beside the others.
    p_value : float
        Family-wise.
    probability : float
        That something of the class is there; what is left without a name may be what it was taken for.
    fit, reduced : Fit
        The set with it and without.
    members : tuple of Member
        Of the class, the likeliest first; the effect is one of them.
    """

    effect: Effect
    gain: float
    p_value: float
    probability: float
    fit: Fit
    reduced: Fit
    members: tuple[Member, ...]

    @property
    def names(self) -> list[str]:
        """The whole class, most likely first."""
        return [member.effect.name for member in self.members]

    @property
    def others(self) -> tuple[Member, ...]:
        """All members but the effect."""
        return tuple(member for member in self.members if member.effect.name != self.effect.name)

    @property
    def sides(self) -> dict[str, float]:
        """Probability of each side."""
        probabilities = {"print": 0.0, "measurement": 0.0}
        for member in self.members:
            probabilities[library()[member.effect.name].side] += member.probability
        return probabilities


def named_in(search: Search, best: Names, left: float) -> list[Named]:
    """Return the slots of the best set, the strongest first.

    A class is the smallest set of names that holds `policy.CREDIBLE` of the probability of a slot, all other slots
    being as they are. Costs count in units of the slot's width (`Search.width`), but for what the process's own form
    may have made of them.

    Parameters
    ----------
    search : Search
    best : frozenset of str
    left : float
        2 ln L beyond noise that the set leaves, 0 where that is chance.
    """
    return sorted((_named(search, best, name, left) for name in sorted(best)), key=lambda slot: -slot.gain)


def _named(search: Search, best: Names, name: str, left: float) -> Named:
    fit, gain = search.fitted[best], search.gain(best, name)
    width = search.width(gain, name, left)
    rivals = {name: fit}
    for names, rival in search.fitted.items():
        if len(names) == len(best) and len(names - best) == 1 and best - names == {name}:
            rivals[next(iter(names - best))] = rival
    losses = {member: max(search.priced(rival) - search.priced(fit), 0.0) for member, rival in rivals.items()}
    form = gain - search.surely(best, name)  # what an error of form may have of it; no rival has more
    for member, loss in losses.items():
        if member != name and 0 < loss <= form:
            losses[member] = max(loss - search.excused(best, best - {name} | {member}), 0.0)
    weights = {member: float(np.exp(-loss / width / 2)) for member, loss in losses.items()}
    whole, held, members = sum(weights.values()), 0.0, []
    for member in sorted(weights, key=lambda member: -weights[member]):
        if held >= policy.CREDIBLE and member != name:
            break
        held += weights[member] / whole
        members.append(member)
    share = sum(weights[member] for member in members)
    reduced = search.without(best, name)
    sure = search.surely(best, name) - search.place_price.get(name, 0.0)
    odds = (search.surely(best, name) - search.needed(best, name)) / search.width(0.0, name, left) / 2
    return Named(
        effect_of(fit.parameters, name),
        gain,
        search.asked.p_value(sure / search.spread.get(name, 1.0) ** 2),
        float(1 / (1 + np.exp(-min(odds, 500.0)))),
        fit,
        reduced,
        tuple(
            Member(
                effect_of(rivals[member].parameters, member), losses[member], weights[member] / share, rivals[member]
            )
            for member in members
        ),
    )


def strengths(effect: Effect, intervals: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float | str]]:
    """Return value and 95 % interval of every freed parameter of an effect, inside its declared range.

    What effects share stands under the name of one of them.
    """
    sizes: dict[str, dict[str, float | str]] = {}
    for name, (_, declared) in declarations(effect).items():
        places = [k for k in intervals if k == f"{effect.name}.{name}" or (declared.shared and k.endswith(f".{name}"))]
        if places:
            low, high = intervals[places[0]]
            sizes[name] = {"value": float(getattr(effect, name)), "low": low, "high": high, "unit": declared.unit}
    return sizes
