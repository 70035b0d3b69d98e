"""What others would say of the sealed cases: forward BIC, group lasso with stability selection, spike and slab.

Run as ``python -m tests.bench.competitors RUN_DIR [--cases N] [--minutes M] [--report FILE.json]`` on a folder of
`make prove` that has been opened. Every case is fitted once, by the program's own estimator; all competitors get the
program's own screen: the same noise model, residual and nuisance space, and one column for every signature of its
library, in units in which noise (with what numerics add) has a standard deviation of 1. None of them refits anything.
All are scored by the same rules, the program beside them by the first name of each of its findings.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import runpy
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg, special

from dlwpredict import __version__
from dlwpredict.alignment import align
from dlwpredict.cli.pairs import read_pair
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library.candidates import Bent
from dlwpredict.diagnosis.library.hidden import answered
from dlwpredict.diagnosis.library.score import Linearised
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.diagnosis.run import _designs
from dlwpredict.effects import library
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.infer.baseline import fitter_of, rough, unsaid
from dlwpredict.infer.fitter import Start
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed
from dlwpredict.infer.noises import noises
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit, Objective, Work, nothing
from dlwpredict.infer.pixels import working_factor
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import Recording, coarser, doubted, prepare
from dlwpredict.infer.whitened import steepness
from dlwpredict.noise.covariance import Noise
from dlwpredict.parameters import ParameterSet
from tests.bench.cases import NEVER
from tests.prove.answer import code_sha256
from tests.prove.hidden import OUTSIDE
from tests.prove.sealed import Folder
from tests.prove.table import CLASSES, wilson

MAKE = Path(__file__).parents[2] / "docs" / "make.py"

MOST = policy.MOST_EFFECTS
"""No competitor names more effects than the program may."""

BLOCKS = 4
"""Blocks along each side of a map: halves of all blocks are the subsamples of stability selection."""

PAIRS, ENTERING, EXPECTED = 50, 2, 0.05
"""Complementary pairs of halves; groups that each half lets in, the fewest by which a pair of effects can be found; and
false selections that are expected at most."""

RATIO, SWEEPS, STILL = 0.9, 200, 1e-4
"""Of the path of penalties: one to the next; sweeps over the groups at each, at most; change that ends them."""

LEVEL, DRAWS, IN_FULL = policy.LEVEL_NAMES, 2000, 0.05
"""How often noise alone may be given a name by spike and slab; draws by which its odds are set so; and the share of
them, those nearest to a name, for which sets of three are summed as well."""

SLAB = 1.0
"""Standard deviation of the slab in typical sizes."""


# -- what all are given ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Blocks:
    """Scalar products block by block, so that any part of the data can be fitted alone.

    Parameters
    ----------
    products : numpy.ndarray, shape (blocks, columns, columns)
        Of nuisances (the process's tangents among them), signatures and, last, the residual.
    always : numpy.ndarray, shape (columns, columns)
        Of the rows of priors, which every part has.
    nuisances : int
        Columns that stand first.
    """

    products: np.ndarray
    always: np.ndarray
    nuisances: int

    @classmethod
    def of(cls, nuisances: np.ndarray, columns: np.ndarray, residual: np.ndarray, block: np.ndarray) -> Blocks:
        """Sum them.

        Parameters
        ----------
        nuisances : numpy.ndarray, shape (rows, nuisances)
        columns : numpy.ndarray, shape (rows, signatures)
        residual : numpy.ndarray, shape (rows,)
        block : numpy.ndarray of int, shape (rows,)
            Number of the block that a row is in; −1 for priors.
        """
        unit = nuisances / np.maximum(np.linalg.norm(nuisances, axis=0), 1e-12)
        sums = []
        for number in range(-1, int(block.max()) + 1):
            inside = block == number
            part = np.column_stack([unit[inside], columns[inside], residual[inside]]).astype(float)
            sums.append(part.T @ part)
        return cls(np.array(sums[1:]), sums[0], nuisances.shape[1])

    def part(self, chosen: Sequence[int] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return products and scores of the columns beside the nuisances, all fitted to these blocks alone.

        Columns are of length 1 there; one that is not to be seen there is 0.
        """
        whole = self.products[chosen].sum(axis=0) + self.always
        n = self.nuisances
        inverse = np.linalg.pinv(whole[:n, :n], rcond=1e-9, hermitian=True)
        left = whole[n:, n:] - whole[n:, :n] @ inverse @ whole[:n, n:]
        products, scores, sizes = left[:-1, :-1], left[:-1, -1], np.diag(left)[:-1]
        seen = sizes > 1e-6 * np.maximum(np.diag(whole)[n:-1], 1e-12)
        unit = np.where(seen, 1 / np.sqrt(np.where(seen, sizes, 1)), 0.0)
        return products * unit * unit[:, None], scores * unit


@dataclass(frozen=True, eq=False)
class Screen:
    """One case to first order, as all competitors are given it.

    Parameters
    ----------
    names : list of str
        Effect of every column.
    signs : numpy.ndarray, shape (columns,)
        Sign of the strength that alone is physical; 0 where both are.
    products : numpy.ndarray, shape (columns, columns)
        Scalar products of the columns of length 1, beside everything that the fit may move.
    scores : numpy.ndarray, shape (columns,)
        Scalar products with the residual, in standard deviations.
    visible : numpy.ndarray, shape (columns,)
        Score that the typical size of each would give.
    spread : numpy.ndarray, shape (columns,)
        Standard deviation that noise and numerics give along each, in that of known noise.
    points : float
        Effective points: as many independent ones would tell as much of the noise.
    blocks : Blocks
    """

    names: list[str]
    signs: np.ndarray
    products: np.ndarray
    scores: np.ndarray
    visible: np.ndarray
    spread: np.ndarray
    points: float
    blocks: Blocks

    @property
    def effects(self) -> list[str]:
        """Names of the effects, each once."""
        return list(dict.fromkeys(self.names))


def screen_of(parts: Sequence[Recording], seed: int = 0) -> Screen:
    """Fit the seven, estimate the noise and linearise, all as the first round of `diagnose` does."""
    start, work = unsaid(ParameterSet()), Work()
    recordings, first = rough([doubted(r) for r in parts], freed(start, choose(start)), PARAMETERS, work)
    objective = Objective(first.data, PARAMETERS, work)
    signatures = Signatures.of(first, (), work)
    slopes = [steepness(one.heights_um, r.target) for one, r in zip(first.traces, recordings, strict=True)]
    designs = _designs(first, signatures, objective)
    found = noises(recordings, first.residuals_um(), designs, slopes=slopes, seed=seed)
    fitter = fitter_of(recordings, [one.model for one in found], slopes, first, objective)
    seven = fitter.best(Start(first.parameters))
    null = Null.of(seven.data, fitter.objective.rows, found, seed)
    screen = Linearised.of(signatures, seven, null, fitter.objective)
    seen = np.flatnonzero(screen.lengths > 0)
    columns = _columns(seven, screen, signatures, fitter.objective, seen)
    blocks = Blocks.of(_nuisances(seven), columns, seven.residual, _block(seven))
    return Screen(
        [screen.names[k] for k in seen],
        screen.signs[seen],
        screen.products[np.ix_(seen, seen)],
        (screen.raw / screen.spread)[seen],
        screen.visible[seen],
        screen.spread[seen],
        sum(effective(one.model.even, r.points) for one, r in zip(found, recordings, strict=True)),
        blocks,
    )


def effective(noise: Noise, points: int) -> float:
    """Return how many independent points tell as much of the noise: all of them over Σρ², ρ the correlation over lags.

    (Bayley & Hammersley, J. R. Stat. Soc. Suppl. 8, 184, 1946. Offsets of whole lines are not counted.)

    Examples
    --------
    >>> effective(Noise(0.01, 0.0, 1.0, 0.5, 0.5), 900)
    900.0
    """
    reach = max(8 * noise.length_um if noise.correlated_um > 0 else 0.0, 6 * noise.grain_um)
    x, y = (pitch * np.arange(-int(reach / pitch), int(reach / pitch) + 1) for pitch in (noise.dx_um, noise.dy_um))
    rho = noise.at(np.hypot(x, y[:, None])) / noise.sigma_um**2
    return float(points / np.sum(rho**2))


def _columns(
    seven: Fit, screen: Linearised, signatures: Signatures, objective: Objective, seen: np.ndarray
) -> np.ndarray:
    """Return the whitened signatures of some candidates, of length 1 beside the fit, shape (rows, candidates)."""
    columns = np.empty((seven.rows.total, len(seen)), np.float32)
    for row, k in enumerate(seen):
        candidate = screen.chosen[k]
        if isinstance(candidate, Bent):
            change = seven.residual - answered(objective, seven, candidate).residual
        else:
            maps = enumerate(signatures.maps_um[k])
            change = seven.nuisances.beside(seven.rows.stack([seven.seen(place, one) for place, one in maps]))
        columns[:, row] = change / screen.lengths[k]
    return columns


def _nuisances(seven: Fit) -> np.ndarray:
    """Return everything that the fit may move: each recording's own nuisances and the seven, shape (rows, columns)."""
    rows, columns = seven.rows, [seven.jacobian]
    for k, (above, below) in enumerate(zip(seven.nuisances.above, seven.nuisances.below, strict=True)):
        own = np.zeros((rows.total, above.shape[1]))
        own[rows.of(k)], own[rows.nuisance_priors(k)] = above, below
        columns.append(own)
    return np.column_stack(columns)


def _block(seven: Fit) -> np.ndarray:
    """Return the number of the block that every row is in, −1 for priors, shape (rows,)."""
    numbers = np.full(seven.rows.total, -1)
    for k, item in enumerate(seven.data):
        rows, cols = item.recording.used.shape
        down, across = np.arange(rows) * BLOCKS // rows, np.arange(cols) * BLOCKS // cols
        places = k * BLOCKS**2 + down[:, None] * BLOCKS + across
        numbers[seven.rows.of(k)] = places[item.recording.used]
    return numbers


# -- forward selection by BIC ----------------------------------------------------------------


def forward(screen: Screen, extended: bool = False) -> list[str]:
    """Add the column that gains most beside those chosen, one per effect, while it gains more than ln n in 2 ln L.

    The noise is known (whitened), so that BIC is RSS + k·ln n. Extended, each costs 2 ln p more for the p columns that
    it was chosen from (Chen & Chen, Biometrika 95, 759, 2008). Forbidden signs are not chosen; nor is what those chosen
    explain nearly whole already.
    """
    price = np.log(screen.points) + 2 * np.log(len(screen.names)) * extended
    products, left, names = screen.products.copy(), screen.scores.copy(), np.array(screen.names)
    chosen: list[str] = []
    while len(chosen) < MOST:
        sizes = np.diag(products)
        allowed = ((screen.signs == 0) | (np.sign(left) == screen.signs)) & (sizes > 1 / policy.INFLATED)
        allowed &= ~np.isin(names, chosen)
        gains = np.where(allowed, left**2 / np.maximum(sizes, 1e-12), 0.0)
        k = int(np.argmax(gains))
        if gains[k] <= price:
            break
        chosen.append(screen.names[k])
        share = products[k] / sizes[k]
        left = left - share * left[k]
        products = products - np.outer(share, products[k])
    return chosen


# -- group lasso with stability selection ----------------------------------------------------


def stable(screen: Screen, seed: int = 0) -> tuple[list[str], dict[str, float]]:
    """Return the effects that nearly every half of the data lets in, the most frequent first, and all frequencies.

    Complementary pairs (Shah & Samworth, J. R. Stat. Soc. B 75, 55, 2013): all blocks of all maps are halved at random,
    and on each half the first `ENTERING` groups of the path of the group lasso are taken. Which signs are physical is
    not told to it.
    """
    rng, count = np.random.default_rng(seed), len(screen.blocks.products)
    hits = dict.fromkeys(screen.effects, 0)
    for _ in range(PAIRS):
        order = rng.permutation(count)
        for half in (order[: count // 2], order[count // 2 :]):
            products, scores = screen.blocks.part(half)
            for name in entering(products, scores / screen.spread, screen.names, ENTERING):
                hits[name] += 1
    share = {name: hit / (2 * PAIRS) for name, hit in sorted(hits.items(), key=lambda one: -one[1])}
    least = threshold(len(share))
    return [name for name in share if share[name] >= least][:MOST], share


def threshold(groups: int) -> float:
    """Return the least frequency at which no more false selections than `EXPECTED` are to be expected."""
    tried = [n / (2 * PAIRS) for n in range(PAIRS + 1, 2 * PAIRS + 1)]
    return next((tau for tau in tried if false_selections(tau, groups) <= EXPECTED), math.inf)


def false_selections(tau: float, groups: int) -> float:
    """Return how many groups that a half selects no more often than at random are selected at most, on average.

    Shah & Samworth's theorem 2, which takes the frequencies over pairs to be unimodal: C(τ, B)·q²/p.

    Examples
    --------
    >>> round(false_selections(0.9, 20), 4), round(false_selections(0.75, 20), 4)
    (0.0863, 0.2041)
    """
    often = ENTERING**2 / groups
    if tau <= 0.75:
        return often / (2 * max(2 * tau - 1 - 1 / (2 * PAIRS), 1e-9))
    return often * 4 * (1 - tau + 1 / (2 * PAIRS)) / (1 + 1 / PAIRS)


def entering(products: np.ndarray, scores: np.ndarray, names: Sequence[str], most: int) -> list[str]:
    """Return the first groups on the path of the group lasso, in the order in which they enter.

    Least is ½·βᵀPβ − sᵀβ + λ·Σ √d·|β_g| over the groups g of d columns (Yuan & Lin, J. R. Stat. Soc. B 68, 49, 2006).
    λ falls from where all is 0, each solution beginning at the last; only groups that are not 0, and those whose
    gradient exceeds λ·√d, are swept over.

    Parameters
    ----------
    products : numpy.ndarray, shape (columns, columns)
        P, of columns of length 1, or of 0.
    scores : numpy.ndarray, shape (columns,)
        s.
    names : sequence of str
        Group of every column.
    most : int
    """
    label, live = np.array(names), np.diag(products) > 0
    groups = {name: np.flatnonzero((label == name) & live) for name in dict.fromkeys(names)}
    groups = {name: own for name, own in groups.items() if len(own)}
    weight = {name: np.sqrt(len(own)) for name, own in groups.items()}
    curve = {name: float(linalg.eigvalsh(products[np.ix_(own, own)])[-1]) for name, own in groups.items()}
    strengths, entered = np.zeros(len(scores)), []

    def steep(name: str) -> float:
        own = groups[name]
        return float(np.linalg.norm(scores[own] - products[own] @ strengths)) / weight[name]

    penalty = max((steep(name) for name in groups), default=0.0)
    active: list[str] = []
    for _ in range(int(np.log(1e-4) / np.log(RATIO))):
        if len(entered) >= min(most, len(groups)) or penalty <= 0:
            break
        penalty *= RATIO
        while new := [name for name in groups if name not in active and steep(name) > penalty]:
            active.append(max(new, key=steep))
            _descend(products, scores, strengths, [(groups[n], penalty * weight[n], curve[n]) for n in active])
        active = [name for name in active if strengths[groups[name]].any()]
        entered += [name for name in active if name not in entered]
    return entered[:most]


def _descend(
    products: np.ndarray, scores: np.ndarray, strengths: np.ndarray, groups: Sequence[tuple[np.ndarray, float, float]]
) -> None:
    """Sweep over groups (columns, penalty, curvature), each moved to the least of its majorant, until nothing moves.

    (Yang & Zou, Stat. Comput. 25, 1129, 2015.)
    """
    for _ in range(SWEEPS):
        moved = 0.0
        for own, penalty, curvature in groups:
            before = strengths[own]
            goal = curvature * before + scores[own] - products[own] @ strengths
            after = goal * max(1 - penalty / max(np.linalg.norm(goal), 1e-300), 0.0) / curvature
            strengths[own] = after
            moved = max(moved, curvature * float(np.abs(after - before).max()))
        if moved < STILL * max(float(np.abs(scores).max()), 1.0):
            break


# -- spike and slab --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SetsOfSize:
    """All sets of so many columns of different effects.

    Parameters
    ----------
    columns : numpy.ndarray of int, shape (sets, size)
    answer : numpy.ndarray, shape (sets, size, size)
        Posterior covariance of the strengths, in the units of scores.
    constant : numpy.ndarray, shape (sets,)
        What of the logarithm of the Bayes factor hangs on no score: −½·ln det(I + V½PV½), and the prior's share of each
        column among those of its effect.
    effects : numpy.ndarray of int, shape (sets,)
        Number of the set of effects, of `names`.
    names : list of tuple of str
    """

    columns: np.ndarray
    answer: np.ndarray
    constant: np.ndarray
    effects: np.ndarray
    names: list[tuple[str, ...]]

    @classmethod
    def of(cls, screen: Screen, size: int) -> SetsOfSize:
        """Enumerate them."""
        kinds = screen.effects
        kind = np.array([kinds.index(name) for name in screen.names])
        counts = np.bincount(kind, minlength=len(kinds))
        columns = np.array(list(combinations(range(len(kind)), size)), dtype=np.int32).reshape(-1, size)
        own = np.sort(kind[columns], axis=1)
        apart = (np.diff(own, axis=1) > 0).all(axis=1)
        columns, own = columns[apart], own[apart]
        sd = np.maximum(SLAB * screen.visible, 1e-6)
        products = screen.products[columns[:, :, None], columns[:, None, :]]
        prior = products * sd[columns][:, :, None] * sd[columns][:, None, :] + np.eye(size)
        answer = np.linalg.inv(prior) * sd[columns][:, :, None] * sd[columns][:, None, :]
        shares = np.log(counts[kind[columns]]).sum(axis=1)
        known, number = np.unique(own, axis=0, return_inverse=True)
        return cls(
            columns,
            answer,
            -np.linalg.slogdet(prior)[1] / 2 - shares,
            number.reshape(-1),
            [tuple(kinds[k] for k in row) for row in known],
        )

    def factors(self, scores: np.ndarray, signs: np.ndarray) -> np.ndarray:
        """Return the logarithm of every set's Bayes factor; −∞ where a strength comes out with a forbidden sign."""
        here, wanted = scores[self.columns], signs[self.columns]
        means = np.einsum("sij,sj->si", self.answer, here)
        allowed = ((wanted == 0) | (np.sign(means) == wanted)).all(axis=1)
        return np.where(allowed, np.einsum("si,si->s", means, here) / 2 + self.constant, -np.inf)


def spiked(screen: Screen, seed: int = 0) -> tuple[list[str], float]:
    """Return the likeliest set of effects, where something is likelier than nothing, and the odds of nothing.

    Every set of up to three columns is summed exactly: strengths have a Gaussian prior of `SLAB` typical sizes, every
    effect the same prior odds, shared by its columns.
    """
    sizes = [SetsOfSize.of(screen, size) for size in range(1, MOST + 1)]
    odds = calibrated(screen, sizes, seed)
    found: list[tuple[float, tuple[str, ...]]] = []
    for size, sets in enumerate(sizes, start=1):
        sums = np.full(len(sets.names), -np.inf)
        np.logaddexp.at(sums, sets.effects, sets.factors(screen.scores, screen.signs) + size * odds)
        found += zip(sums.tolist(), sets.names, strict=True)
    something = float(special.logsumexp([weight for weight, _ in found])) if found else -math.inf
    return list(max(found)[1]) if something > 0 else [], -something


def calibrated(screen: Screen, sizes: Sequence[SetsOfSize], seed: int = 0) -> float:
    """Return the logarithm of the prior odds of an effect at which noise alone is given a name as often as `LEVEL`.

    Scores are drawn with the correlations of the columns. For each draw, the odds at which something becomes as likely
    as nothing follow from its sums of Bayes factors; sets of three are summed where those of one and two come near.
    """
    values, vectors = linalg.eigh(screen.products)
    real = values > 1e-9 * values[-1]
    root = vectors[:, real] * np.sqrt(values[real])
    scores = np.random.default_rng(seed).standard_normal((DRAWS, root.shape[1])) @ root.T
    sums = np.full((DRAWS, len(sizes)), -np.inf)
    for k, sets in enumerate(sizes):
        near = np.argsort(_even(sums[:, :k])) if k > 1 else np.arange(DRAWS)
        for row in near[: max(int(IN_FULL * DRAWS), 1)] if k > 1 else near:
            sums[row, k] = special.logsumexp(sets.factors(scores[row], screen.signs)) if len(sets.columns) else -np.inf
    return float(np.quantile(_even(sums), LEVEL))


def _even(sums: np.ndarray) -> np.ndarray:
    """Return ln ω at which Σ ω^k·B_k = 1, from ln B_k, k = 1, 2, ..., shape (draws, k): by bisection."""
    low, high = np.full(len(sums), -60.0), np.full(len(sums), 30.0)
    power = np.arange(1, sums.shape[1] + 1)
    for _ in range(60):
        middle = (low + high) / 2
        more = special.logsumexp(sums + middle[:, None] * power, axis=1) > 0
        low, high = np.where(more, low, middle), np.where(more, middle, high)
    return (low + high) / 2


# -- the same rules for all ------------------------------------------------------------------

METHODS: dict[str, tuple[str, Callable[[Screen], list[str]]]] = {
    "bic": ("forward selection by BIC", forward),
    "ebic": ("... by extended BIC", lambda screen: forward(screen, extended=True)),
    "lasso": ("group lasso, stability selection", lambda screen: stable(screen)[0]),
    "slab": ("spike and slab on the linear screen", lambda screen: spiked(screen)[0]),
}
PROGRAM = "diagnose"

COLUMNS = {
    "heard": "one effect from its limit on: anything said",
    "class": "a name of its class",
    "exact": "its name",
    "pairs": "two from their limits on: both, by class",
    "pairs exact": "both, by name",
    "false": "nothing in it: anything said",
    "wrong": "any effect of the library, weak ones too: a name of another class, or one too many",
    "outside": "physics outside the library: a name given",
    "form": "a process of another form: a name given",
}


def class_of(name: str) -> str:
    """Return the class of a name, itself where it is in none."""
    return next((label for label, names in CLASSES.items() if name in names), name)


def told_by_program(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the program has said: the first name of each finding, and whether it has said anything at all."""
    names = [finding["effects"][0] for finding in result.get("findings", []) if finding.get("effects")]
    return {"names": names, "heard": result.get("verdict") not in ("none", "failed")}


def true_names(truth: Mapping[str, Any]) -> list[str]:
    """Return the effects of the library that are in a case and can be named."""
    return [one["name"] for one in truth["effects"] if one["name"] in library() and one["name"] not in NEVER]


def matched(true: Sequence[str], said: Sequence[str], same: Callable[[str], str]) -> int:
    """Return how many true names have a said one of their own that is the same.

    Examples
    --------
    >>> matched(["curl", "galvo-lag"], ["vignetting", "curl"], class_of), matched(["curl"], ["vignetting"], str)
    (1, 0)
    """
    best = 0
    for order in permutations([*said, *("" for _ in true)], len(true)):
        best = max(best, sum(bool(b) and same(a) == same(b) for a, b in zip(true, order, strict=True)))
    return best


def marks(truth: Mapping[str, Any], told: Mapping[str, Any]) -> dict[str, bool]:
    """Return which of the table's columns count a case, and whether it is a hit there."""
    true, said = true_names(truth), list(told["names"])
    clear = all(one.get("times", 0.0) >= 1 for one in truth["effects"] if one["name"] in true)
    by_class, by_name = matched(true, said, class_of), matched(true, said, str)
    found: dict[str, bool] = {}
    if truth["kind"] == "null":
        found["false"] = bool(told["heard"])
    if truth["kind"] == "single" and clear and len(true) == 1:
        found |= {"heard": bool(told["heard"]), "class": by_class == 1, "exact": by_name == 1}
    if truth["kind"] == "pair" and clear and len(true) == 2:
        found |= {"pairs": by_class == 2, "pairs exact": by_name == 2}
    if truth["kind"] == "form":
        found["form"] = bool(said)
    if any(one["name"] in OUTSIDE for one in truth["effects"]):
        found["outside"] = bool(said)
    elif true:
        found["wrong"] = by_class < len(said)
    return found


def compared(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one line per method: counts with their 95 % intervals, and the median of its processor time."""
    lines = []
    for method, words in (*((key, words) for key, (words, _) in METHODS.items()), (PROGRAM, "diagnose")):
        line: dict[str, Any] = {"method": words, "seconds": None}
        for column in COLUMNS:
            hits = [case["marks"][method][column] for case in cases if column in case["marks"][method]]
            line[column] = {"hit": sum(hits), "count": len(hits), "interval": wilson(sum(hits), len(hits))}
        spent = [case["said"][method]["seconds"] for case in cases]
        line["seconds"] = float(np.median(spent)) if spent else None
        lines.append(line)
    return lines


def markdown(table: Mapping[str, Any]) -> str:
    """Return the table as Markdown, as it stands on the page of evidence."""
    return runpy.run_path(str(MAKE))["beside"](table)


# -- a run folder ----------------------------------------------------------------------------


def opened(folder: Path) -> list[dict[str, Any]]:
    """Return the results of a run that hold their truth, in the order of its seal: kinds take turns in it."""
    found = [json.loads(path.read_text()) for path in sorted((folder / "results").glob("*.json"))]
    found = [one for one in found if "truth" in one and "findings" in one]
    seal = folder / "seal.json"
    order = list(json.loads(seal.read_text())["cases"]) if seal.exists() else []
    places = {name: k for k, name in enumerate(order)}
    return sorted(found, key=lambda one: places.get(one["name"], len(places)))


def recordings(folder: Path, name: str) -> list[Recording]:
    """Return the recordings of a case as the program reads them; one off its target's grid is aligned before."""
    place, found = Folder(folder), []
    laid = getattr(place, "recording", lambda name, k: place.data(name) / f"recording_{k}.tif")
    for k in range(len(list(place.data(name).glob("target_*.tif")))):
        files = place.data(name) / f"target_{k}.tif", laid(name, k)
        target, measured = (read_height_map(file) for file in files)
        if (measured.shape, measured.dx_um, measured.dy_um) == (target.shape, target.dx_um, target.dy_um):
            found.append(read_pair(files, ParameterSet()).recording)
        else:
            part = prepare(target, align(measured, target).aligned)
            found.append(coarser(part, working_factor(target, ParameterSet())))
    return found


def compete(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what everybody says of a case, and how each is marked."""
    begun = time.process_time()
    screen = screen_of(recordings(folder, result["name"]))
    shared = time.process_time() - begun
    said: dict[str, dict[str, Any]] = {}
    for method, (_, ask) in METHODS.items():
        begun = time.process_time()
        names = ask(screen)
        own = time.process_time() - begun
        said[method] = {"names": names, "heard": bool(names), "own_s": own, "seconds": shared + own}
    said[PROGRAM] = told_by_program(result) | {"seconds": _spent(folder, result)}
    truth = result["truth"]
    concealed = [{key: one.get(key) for key in ("name", "times")} for one in truth["effects"]]
    about = {"columns": len(screen.names), "effects": len(screen.effects), "points": screen.points, "shared_s": shared}
    asked = {"name": result["name"], "kind": truth["kind"], "truth": concealed, "answered_by": result.get("code")}
    found = asked | about | {"said": said}
    return found | {"marks": {method: marks(truth, told) for method, told in said.items()}}


def _spent(folder: Path, result: Mapping[str, Any]) -> float:
    """Return the program's processor time where its answer tells it, else the time on the clock, s."""
    path = Folder(folder).answer(result["name"])
    told = json.loads(path.read_text()).get("diagnosis", {}) if path.exists() else {}
    return float(told.get("work", {}).get("cpu_s", result.get("seconds", math.nan)))


def table_of(cases: Sequence[Mapping[str, Any]], command: str, failed: Mapping[str, str], whole: int) -> dict[str, Any]:
    """Return everything that is written."""
    text = (
        f"{len(cases)} of the {whole} sealed cases that were opened. All have the same fit of the seven, noise model, "
        "nuisance space and library of signatures, and name at most three effects; none but `diagnose` refits anything "
        "or can say that something without a name is there. Of `diagnose`, the first name of every finding counts. "
        "Each cell counts cases; in parentheses the 95 % interval (Wilson)."
    )
    machine = f"{platform.system()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return {
        "title": "Sealed cases, answered by other methods", "version": __version__, "command": command,
        "machine": machine, "date": f"{date.today()}", "text": text, "columns": COLUMNS, "methods": compared(cases),
        "code": code_sha256(), "failed": dict(failed), "cases": list(cases),
    }  # fmt: skip


def run(
    folder: Path,
    most: int | None,
    minutes: float,
    tell: Callable[[str], object] = print,
    keep: Callable[[dict[str, Any]], object] = nothing,
) -> dict[str, Any]:
    """Ask all competitors of a run's cases, until so many are done or the time is over; keep the table after each."""
    results, last = opened(folder), time.monotonic() + 60 * minutes
    cases, failed = [], {}
    command = f"python -m tests.bench.competitors {folder}" + (f" --cases {most}" if most else "")
    for result in results[:most]:
        if time.monotonic() > last:
            break
        try:
            cases.append(compete(folder, result))
        except (InputError, OSError, np.linalg.LinAlgError) as fault:
            failed[result["name"]] = str(fault)
            tell(f"{result['name']} failed: {fault}")
        else:
            tell(in_words(cases[-1]))
        keep(table_of(cases, command, failed, len(results)))
    return table_of(cases, command, failed, len(results))


def in_words(case: Mapping[str, Any]) -> str:
    """Return a case in a line."""
    truth = ", ".join(f"{one['name']} {one['times'] or 0:.1f}" for one in case["truth"]) or "nothing"
    said = [f"{method}: {', '.join(one['names']) or '-'}" for method, one in case["said"].items()]
    return f"{case['name']} {case['kind']} ({truth}) {'; '.join(said)}"


def main(words: Iterable[str] | None = None) -> int:
    """Compare them on a run folder."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.competitors", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="RUN_DIR")
    parser.add_argument("--cases", type=int, help="so many cases; all that were opened without")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no further case after so long")
    parser.add_argument("--report", type=Path, help="the JSON; RUN_DIR/competitors.json without")
    chosen = parser.parse_args(None if words is None else list(words))
    report = chosen.report or chosen.folder / "competitors.json"

    def keep(table: dict[str, Any]) -> None:
        write_text(report, json.dumps(table, indent=1, ensure_ascii=False) + "\n")

    table = run(chosen.folder, chosen.cases, chosen.minutes, lambda line: print(line, flush=True), keep)
    keep(table)
    print(f"\n{markdown(table)}\n{report}: {len(table['cases'])} cases, {len(table['failed'])} failed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
