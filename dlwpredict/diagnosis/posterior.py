"""Sets of effects: enumerate them to first order, say which to refit, and weigh those that were.

A set costs its −2 ln L, with the priors of all that moves, and the threshold of its size (`Thresholds`). Its
probability goes as exp(−cost/2).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.score import Linearised

KEPT = 200
"""Sets of every size that are kept of an enumeration."""


@dataclass(frozen=True, eq=False)
class Subset:
    """A set of effects to first order: some of the model's own, and candidates.

    Parameters
    ----------
    kept : tuple of str
        Effects of the model.
    added : tuple of int
        Candidates; one may be another switch of an effect of the model, in the place of its own or beside them.
    names : frozenset of str
    gain : float
        Fall of −2 ln L from the process alone.
    cost : float
        What it costs, the threshold of its switches included.
    """

    kept: tuple[str, ...]
    added: tuple[int, ...]
    names: frozenset[str]
    gain: float
    cost: float


@dataclass(frozen=True, eq=False)
class Sets:
    """The best sets to first order about a model, the likeliest first.

    Each stands once for every choice of the switches that come in: by which an effect promises most tells little about
    by which it fits best, once the process has answered. Those of the model's own effects change one at a time.

    Parameters
    ----------
    screen : Linearised
    price : function of the number of switches
        What they must gain.
    ranked : list of Subset
    """

    screen: Linearised
    price: Callable[[int], float]
    ranked: list[Subset]

    @classmethod
    def of(cls, screen: Linearised, price: Callable[[int], float]) -> Sets:
        """Enumerate all sets of up to `policy.MOST_EFFECTS` effects."""
        best: dict[tuple[object, ...], Subset] = {}
        for subset in _enumerated(screen, price):
            key = subset.names, subset.kept, *(screen.chosen[k].switch for k in subset.added)
            if key not in best or subset.cost < best[key].cost:
                best[key] = subset
        return cls(screen, price, sorted(best.values(), key=lambda one: one.cost))

    def strengths(self, subset: Subset) -> list[float]:
        """Return the strengths of a set's candidates in typical sizes, all columns of the set together."""
        screen = self.screen
        columns = [*_columns(screen, subset.kept), *(screen.first + k for k in subset.added)]
        found = _solved(screen.products[np.ix_(columns, columns)], screen.raw[columns])[
            len(columns) - len(subset.added) :
        ]
        lengths = [max(screen.lengths[k], 1e-12) for k in subset.added]
        return [float(a / n) for a, n in zip(found, lengths, strict=True)]

    def leading(self, model: frozenset[str], reach: float) -> list[Subset]:
        """Return the sets to refit next, beside a model with these names.

        With nothing named these are the best single effects, and pairs that beat all of them: opposed effects mask each
        other until both are there. Else one effect more, one in the place of each, and one less; and the same by other
        switches. To first order each must promise half of what it needs, for laws that bend may bring the rest.

        Parameters
        ----------
        model : frozenset of str
        reach : float
            How far in 2 ln L a set may be behind the model and still be looked at.
        """
        here = next((one.gain for one in self.ranked if one.names == model and not one.added), 0.0)
        needed = policy.HALF * (self.price(len(model) + 1) - self.price(len(model)))
        more = [one for one in self.ranked if one.names > model and len(one.names) == len(model) + 1]
        more = [one for one in more if one.gain - here >= needed]
        if not model:
            best = max((one.gain for one in more), default=0.0)
            lowest = min((one.cost for one in more), default=self.screen.cost)
            pairs = [one for one in self.ranked if len(one.names) == 2 and one.cost < lowest]
            singles = [one for one in more if one.gain >= policy.HALF * best]
            return _first(policy.SINGLES, singles) + _first(policy.PAIRS, pairs)
        same = [one for one in self.ranked if one.names == model and one.added]
        chosen = _first(policy.NEXT, more)
        for name in sorted(model):
            others = [one for one in self.ranked if one.names & model == model - {name}]
            without = [one for one in others if one.names == model - {name} and not one.added]
            least = here - max(reach, policy.HALF * (here - max((one.gain for one in without), default=0.0)))
            instead = [one for one in others if len(one.names) == len(model) and one.gain >= least]
            switched = [one for one in same if set(one.kept) == model - {name} and one.gain >= least]
            chosen += _first(policy.INSTEAD, instead) + _first(1, switched)
            chosen += [one for one in without if one.names]
        return chosen + _first(1, [one for one in same if set(one.kept) == model and one.gain >= here + needed])


def _first(count: int, sets: Sequence[Subset]) -> list[Subset]:
    """Return the first so many sets of names, each by the two choices of switches that promise most."""
    own: dict[frozenset[str], list[Subset]] = defaultdict(list)
    for one in sets:
        own[one.names].append(one)
    return [one for some in list(own.values())[:count] for one in some[: policy.BY_SWITCH]]


def _enumerated(screen: Linearised, price: Callable[[int], float]) -> Iterator[Subset]:
    """Yield the best sets of every size, for every choice of the model's own effects."""
    for size in range(len(screen.named) + 1):
        for kept in combinations(screen.named, size):
            yield from _beside(screen, price, kept)


def _beside(screen: Linearised, price: Callable[[int], float], kept: tuple[str, ...]) -> Iterator[Subset]:
    """Yield the best sets that hold these effects of the model, and candidates."""
    first, columns, on = screen.first, _columns(screen, kept), sum(screen.on[name] for name in kept)
    products, raw, known = screen.products[first:, first:], screen.raw[first:], 0.0
    if columns:
        own, cross = (
            screen.products[np.ix_(columns, columns)],
            screen.products[np.ix_(columns, range(first, len(screen.raw)))],
        )
        inverse = np.linalg.pinv(own, rcond=1e-9, hermitian=True)
        known = float(screen.raw[columns] @ inverse @ screen.raw[columns])
        products, raw = products - cross.T @ inverse @ cross, raw - cross.T @ inverse @ screen.raw[columns]

    def subset(added: tuple[int, ...], gain: float) -> Subset:
        names = frozenset((*kept, *(screen.chosen[k].name for k in added)))
        return Subset(kept, added, names, known + gain, screen.cost - known - gain + price(on + len(added)))

    yield subset((), 0.0)
    for added, gain in _gains(screen, products, raw, max(policy.MOST_EFFECTS - len(kept), 1)):
        new = all(screen.names[k] not in screen.named for k in added)
        if (new or len(added) == 1) and len((one := subset(added, gain)).names) <= policy.MOST_EFFECTS:
            yield one


def _gains(
    screen: Linearised, products: np.ndarray, raw: np.ndarray, most: int
) -> Iterator[tuple[tuple[int, ...], float]]:
    """Yield the candidates that gain most: one, two, three at once."""
    signs, names = screen.signs, np.array(screen.names)
    sizes = np.diag(products)
    alone = np.flatnonzero((screen.lengths > 0) & (sizes > 1 / policy.INFLATED))
    if not len(alone) or most < 1:
        return
    one = np.where((signs == 0) | (np.sign(raw) == signs), raw**2 / np.maximum(sizes, 1e-12), 0.0)
    for k in alone[np.argsort(-one[alone])][:KEPT]:
        yield (int(k),), float(one[k])
    if most < 2:
        return
    pairs, gains = _pairs(products, raw, signs, names, alone)
    for row in np.argsort(-gains)[:KEPT]:
        yield tuple(int(k) for k in pairs[row]), float(gains[row])
    if most < 3:
        return
    found: list[tuple[float, tuple[int, ...]]] = []
    for k in alone:
        later = alone[(alone > k) & (names[alone] != names[k])]
        share = products[later, k] / sizes[k]
        rest = products[np.ix_(later, later)] - np.outer(share, products[k, later])
        keep = np.diag(rest) > 1 / policy.INFLATED
        if keep.sum() < 2:
            continue
        left = raw[later] - share * raw[k]
        two, more = _pairs(
            rest[np.ix_(keep, keep)], left[keep], signs[later[keep]], names[later[keep]], np.arange(keep.sum())
        )
        for row in np.argsort(-more)[:20]:
            found.append(
                (float(raw[k] ** 2 / sizes[k] + more[row]), (int(k), *(int(later[keep][c]) for c in two[row])))
            )
    for gain, three in sorted(found, reverse=True)[:KEPT]:
        matrix = products[np.ix_(three, three)]
        strength = _solved(matrix, raw[list(three)])
        if all(signs[k] == 0 or np.sign(a) == signs[k] for k, a in zip(three, strength, strict=True)):
            yield three, gain


def _pairs(
    products: np.ndarray, raw: np.ndarray, signs: np.ndarray, names: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of columns of different effects and their gains; 0 where a sign is forbidden."""
    i, j = (chosen[one] for one in np.triu_indices(len(chosen), 1))
    a, b, c = products[i, i], products[j, j], products[i, j]
    determinant = a * b - c**2
    apart = (names[i] != names[j]) & (determinant * policy.INFLATED > a * b)
    i, j, a, b, c, determinant = (part[apart] for part in (i, j, a, b, c, determinant))
    first, second = (b * raw[i] - c * raw[j]) / determinant, (a * raw[j] - c * raw[i]) / determinant
    fits = ((signs[i] == 0) | (np.sign(first) == signs[i])) & ((signs[j] == 0) | (np.sign(second) == signs[j]))
    return np.stack([i, j], axis=1), np.where(fits, first * raw[i] + second * raw[j], 0.0)


def _columns(screen: Linearised, kept: Sequence[str]) -> list[int]:
    return [k for name in kept for k in range(*screen.blocks[screen.named.index(name)].indices(len(screen.raw)))]


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.linalg.pinv(matrix, rcond=1e-9, hermitian=True) @ right
