"""Scores: how much of a residual each candidate explains beside what the process may answer, to first order.

About a model with named effects, the residual is that of the model with all that its effects do put back; each of its
effects is a block of columns: what it does, and its tangents. So sets with and without them are compared alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg, special

from dlwpredict.diagnosis.library.candidates import Candidate
from dlwpredict.diagnosis.library.hidden import bent, hidden
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.infer.model import on
from dlwpredict.infer.null import Null, numerical
from dlwpredict.infer.objective import Fit, Objective

SIMULATED = 8000
"""Draws of scores from which thresholds are known: a level of 2.5 % to a fourteenth
of itself, its gain to 0.1 of 12."""

COLUMNS_AT_ONCE, ROWS_AT_ONCE = 32, 8192
"""Columns that are whitened, and rows that are multiplied, at once: what is kept in double precision meanwhile."""

PAIRS_AT_ONCE = 25
"""Pairs of columns whose draws are compared at once: they fit the cache."""

LEAST_LENGTH = 1e-6
"""A column of which less than this share is left, projected orthogonally to the process, is absorbed by it."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """The objective to first order about a model, in terms of what its named effects and all candidates explain.

    Parameters
    ----------
    model : Fit
    named : tuple of str
        Effects of the model that a diagnosis has added: each a block of columns.
    chosen : list of Candidate
        All others: a column each.
    blocks : tuple of slice
        Columns of each named effect; the candidates' columns stand behind them.
    products : numpy.ndarray, shape (columns, columns)
        Scalar products of the columns of length 1, beside the process.
    raw : numpy.ndarray, shape (columns,)
        Scalar products with the residual of the process alone.
    lengths : numpy.ndarray, shape (candidates,)
        Length of a candidate's column per typical size, 0 where the process takes it whole.
    whole : numpy.ndarray, shape (candidates,)
        The same before the process has answered.
    spread : numpy.ndarray, shape (candidates,)
        Standard deviation that noise and numerical differences give along each column: 1 for exactly known noise.
    named_spread : numpy.ndarray, shape (named effects,)
        The same along what each named effect does; of noise or of what the residual's blocks show, the larger: what a
        name gains must stand above all that the model leaves unsaid.
    answers : list of dict
        By how much every parameter of the process answers to a typical size of each candidate.
    cost : float
        Of the process alone.
    """

    model: Fit
    named: tuple[str, ...]
    chosen: list[Candidate]
    blocks: tuple[slice, ...]
    products: np.ndarray
    raw: np.ndarray
    lengths: np.ndarray
    whole: np.ndarray
    spread: np.ndarray
    named_spread: np.ndarray
    answers: list[dict[str, float]]
    cost: float

    @classmethod
    def of(cls, signatures: Signatures, model: Fit, null: Null, objective: Objective) -> Linearised:
        """Linearise about a model at (or very near) the place of the signatures."""
        named = tuple(signatures.done_um)
        places = [model.free.of_effect(effect) for effect in named]
        process = [k for k in process_of(model, named) if k in model.unbound]
        beside = Beside.of(model, process)
        done = [model.seen_in_all(signatures.done_um[effect]) for effect in named]
        residual = beside(model.residual + sum(done)) if done else beside(model.residual)
        columns = [beside(np.column_stack([d, model.jacobian[:, o]])) for d, o in zip(done, places, strict=True)]
        ends = np.cumsum([0, *(block.shape[1] for block in columns)])
        left, lengths, whole, answers = beside.signatures(signatures)
        hidden, more = bent(objective, model, process, signatures.chosen, answers, lengths, whole)
        left = np.column_stack([left, (further := beside(more)).astype(np.float32)])
        lengths = np.append(lengths, np.linalg.norm(further, axis=0))
        whole = np.append(whole, np.linalg.norm(more, axis=0))
        lengths = np.where(lengths > LEAST_LENGTH * np.maximum(whole, 1e-12), lengths, 0.0)
        real = lengths > 0
        left *= np.where(real, 1 / np.where(real, lengths, 1), 0.0)
        own_units = [block / np.maximum(np.linalg.norm(block, axis=0), 1e-12) for block in columns]
        first = np.column_stack([np.zeros((len(residual), 0)), *(block[:, :1] for block in own_units)])
        spread = np.maximum(null.spread(model, left), 1.0)
        own_spread = np.sqrt(np.maximum(null.shown(model, first), 1.0) + numerical(model, first) ** 2)
        products, raw = _products(np.column_stack([*own_units, left]).astype(np.float32, copy=False), residual)
        return cls(
            model,
            named,
            [*signatures.chosen, *hidden],
            tuple(slice(int(a), int(b)) for a, b in pairwise(ends)),
            products,
            raw,
            lengths,
            whole,
            spread,
            own_spread,
            [dict(zip([model.free.names[k] for k in process], answer, strict=True)) for answer in answers.T]
            + [dict(candidate.answer) for candidate in hidden],
            float(residual @ residual),
        )

    @cached_property
    def on(self) -> dict[str, int]:
        """How many switches of every named effect are on."""
        return {name: on(self.model.parameters, name) for name in self.named}

    @cached_property
    def names(self) -> list[str]:
        """Effect of every candidate."""
        return [candidate.name for candidate in self.chosen]

    @cached_property
    def hidden(self) -> list[int]:
        """Candidates that stand out until the process has answered, which takes all of them but little."""
        return hidden(self.whole, self.lengths, self.chosen)

    @cached_property
    def signs(self) -> np.ndarray:
        """Sign of the strength that alone is physical; 0 where both are, shape (candidates,)."""
        return np.array([candidate.sign for candidate in self.chosen])

    @property
    def first(self) -> int:
        """Number of columns that stand before the candidates'."""
        return self.blocks[-1].stop if self.blocks else 0

    @cached_property
    def z(self) -> np.ndarray:
        """Score of every candidate beside the process alone, in standard deviations; 0 where the sign is forbidden."""
        raw = self.raw[self.first :]
        return np.where((self.signs == 0) | (np.sign(raw) == self.signs), raw / self.spread, 0.0)

    @property
    def amplitude(self) -> np.ndarray:
        """Strength of every candidate alone, in typical sizes."""
        return np.divide(self.raw[self.first :], self.lengths, out=np.zeros(len(self.chosen)), where=self.lengths > 0)

    @property
    def visible(self) -> np.ndarray:
        """Score that the typical size of every candidate would give."""
        return self.lengths / self.spread


@dataclass(frozen=True, eq=False)
class Beside:
    """What is left of columns beside the process and the nuisances.

    Parameters
    ----------
    model : Fit
    moves : numpy.ndarray, shape (rows, parameters of the process)
        Derivatives beside the nuisances.
    tangents : numpy.ndarray, shape (rows, directions)
        Their orthonormal basis.
    """

    model: Fit
    moves: np.ndarray
    tangents: np.ndarray

    @classmethod
    def of(cls, model: Fit, process: Sequence[int]) -> Beside:
        """Build it from the parameters that are the process's own."""
        moves = model.nuisances.beside(model.jacobian[:, list(process)])
        return cls(model, moves, _orthonormal(moves))

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (rows, ...) beside all of it."""
        left = self.model.nuisances.beside(columns)
        for _ in range(2):
            left -= self.tangents @ (self.tangents.T @ left)
        return left

    def signatures(self, signatures: Signatures) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what is left of every candidate's signature, kept in single precision: there are many on large maps.

        Returns
        -------
        numpy.ndarray of float32, shape (rows, candidates)
            Beside the process.
        numpy.ndarray, shape (candidates,)
            Lengths of these.
        numpy.ndarray, shape (candidates,)
            Lengths before the process has answered.
        numpy.ndarray, shape (process, candidates)
            By how much every parameter of the process answers.
        """
        model, count = self.model, len(signatures.maps_um)
        sizes = np.maximum(np.linalg.norm(self.moves, axis=0), 1e-12)
        answering = np.linalg.pinv(self.moves / sizes, rcond=1e-6)
        left, lengths, whole = np.empty((model.rows.total, count), np.float32), np.empty(count), np.empty(count)
        answers = np.empty((len(sizes), count))
        for first in range(0, count, COLUMNS_AT_ONCE):
            some = slice(first, first + COLUMNS_AT_ONCE)
            maps = zip(*signatures.maps_um[some], strict=True)
            seen = model.nuisances.beside(model.seen_in_all([np.stack(own) for own in maps]))
            beside = self(seen)
            left[:, some], lengths[some] = beside, np.linalg.norm(beside, axis=0)
            whole[some] = np.linalg.norm(seen, axis=0)
            answers[:, some] = -(answering @ seen) / sizes[:, None]
        return left, lengths, whole, answers


def process_of(model: Fit, named: Sequence[str]) -> list[int]:
    """Return the places of the parameters that belong to none of some effects: those of the process."""
    own = {k for effect in named for k in model.free.of_effect(effect)}
    return [k for k in range(len(model.free.names)) if k not in own]


def _products(columns: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the scalar products of columns (rows, columns) with one another and with a residual, summed in double."""
    products, raw = np.zeros((columns.shape[1], columns.shape[1])), np.zeros(columns.shape[1])
    for first in range(0, len(columns), ROWS_AT_ONCE):
        part = columns[first : first + ROWS_AT_ONCE].astype(float)
        products += part.T @ part
        raw += part.T @ residual[first : first + ROWS_AT_ONCE]
    return products, raw


@dataclass(frozen=True)
class Thresholds:
    """What one, two, three effects must gain together so that noise alone hardly ever names them.

    Parameters
    ----------
    first, next : float
        Gain of the first effect, and of each further one, in 2 ln L and units of their spread squared.
    trials : float
        Independent tests that the whole library amounts to.
    """

    first: float
    next: float
    trials: float

    def p_value(self, gain: float) -> float:
        """Return the probability that noise alone gives any effect this gain."""
        single = min(float(special.chdtrc(1, max(gain, 0.0))), 1 - 1e-12)
        return float(-np.expm1(self.trials * np.log1p(-single)))


def thresholds(screen: Linearised, level: float, level_next: float, inflated: float, seed: int = 0) -> Thresholds:
    """Simulate the screen under noise alone.

    Scores are drawn with the correlations of the columns. Once an effect stands, the next one passes as often as its
    level says where the others are noise. The first threshold is set so that neither one effect nor two together, which
    may mask each other, pass more often than its level.
    """
    products = screen.products[screen.first :, screen.first :]
    seen = np.flatnonzero(screen.lengths > 0)
    if not len(seen):
        return Thresholds(np.inf, np.inf, 1.0)
    products, signs = products[np.ix_(seen, seen)], screen.signs[seen]
    names = np.array(screen.names)[seen]
    root = _root(products)
    scores = np.random.default_rng(seed).standard_normal((SIMULATED, root.shape[1])) @ root.T
    allowed = (signs == 0) | (np.sign(scores) == signs)
    squares = np.where(allowed, scores**2, 0.0)
    single = squares.max(axis=1)
    i, j = np.triu_indices(len(seen), 1)
    rho = products[i, j]
    apart = (names[i] != names[j]) & (1 / np.maximum(1 - rho**2, 1e-12) < inflated)
    double = _largest_pairs(scores, signs, i[apart], j[apart], rho[apart])
    next_one = float(np.quantile(single, 1 - level_next))
    excess = np.maximum(single, double - next_one)
    levels = np.array([0.5, 0.7, 0.8, 0.9, 0.95])
    each = special.chdtrc(1, np.quantile(single, levels))
    trials = float(max(np.median(np.log(levels) / np.log1p(-np.minimum(each, 1 - 1e-9))), 1.0))
    return Thresholds(float(np.quantile(excess, 1 - level)), next_one, trials)


def _largest_pairs(scores: np.ndarray, signs: np.ndarray, i: np.ndarray, j: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Return the largest gain of any pair of columns with allowed signs, shape (draws,)."""
    largest = np.zeros(len(scores))
    for part in np.array_split(np.arange(len(i)), max(len(i) // PAIRS_AT_ONCE, 1)):
        a, b, r = scores[:, i[part]], scores[:, j[part]], rho[part]
        first, second = a - r * b, b - r * a
        fits = ((signs[i[part]] == 0) | (np.sign(first) == signs[i[part]])) & (
            (signs[j[part]] == 0) | (np.sign(second) == signs[j[part]])
        )
        gain = np.where(fits, (a * first + b * second) / (1 - r**2), 0.0)
        largest = np.maximum(largest, gain.max(axis=1, initial=0.0))
    return largest


def _root(products: np.ndarray) -> np.ndarray:
    values, vectors = linalg.eigh(products)
    real = values > 1e-9 * values[-1]
    return vectors[:, real] * np.sqrt(values[real])


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    left, sizes, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12), full_matrices=False)
    return left[:, sizes > 1e-6]
