"""The screen: which candidates does the residual point at, and how surely, all of them being tried at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from dlwpredict.diagnose.evidence import Whitened, prior_rows, stack, unwhitened
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.noise_fit import NoiseEstimate
from dlwpredict.parallel import ALONE, Workers

POWER = 1.28
"""An effect whose score would exceed the threshold by this much is found nine times in ten."""

COHERENT_UM = 2e-4
"""Standard deviation of the part that two honest computations of the same physics differ by along any one signature,
root mean square over the map. An average over ten thousand pixels would see it; no effect is named for it."""

DRAWS = 200
"""Maps of noise that the null distribution is made of."""


@dataclass(frozen=True, eq=False)
class Null:
    """What noise alone would look like in whitened space.

    Parameters
    ----------
    draws : numpy.ndarray, shape (rows, draws)
        Noise maps of every recording, drawn with noise models that the data allow, whitened with the estimated one.
    """

    draws: np.ndarray

    @classmethod
    def of(cls, data: Sequence[Whitened], noises: Sequence[NoiseEstimate], seed: int, workers: Workers = ALONE) -> Null:
        """Draw the null."""
        jobs = [(item, noise, (seed, k)) for k, (item, noise) in enumerate(zip(data, noises, strict=True))]
        return cls(stack(workers.each(_drawn, jobs), prior_rows(len(data))))

    def along(self, columns: np.ndarray) -> np.ndarray:
        """Return the null's components along orthonormal or unit columns, shape (columns, draws)."""
        return columns.T.astype(np.float32) @ self.draws

    def beside(self, basis: np.ndarray) -> np.ndarray:
        """Return the draws without what a fit of this freedom takes of them, shape (rows, draws)."""
        return self.draws - basis.astype(np.float32) @ self.along(basis)

    def deviations(self, fitted: Fit) -> np.ndarray:
        """Return the standard deviation of every free parameter of a fit, infinite where nothing tells it.

        What gives a parameter meets what a score meets, noise whose model is an estimate and numerical differences; and
        what priors leave open.
        """
        estimators, below = fitted.estimators, prior_rows(len(fitted.data))
        lengths = np.linalg.norm(estimators, axis=0)
        known = lengths > 0
        unit = estimators / np.where(known, lengths, 1)
        variances = self.along(unit).var(axis=1) + numerical_scores(fitted.data, unit) ** 2
        variances += np.sum(unit[-below:] ** 2, axis=0)
        return np.where(known, lengths * np.sqrt(variances), np.inf)

    def intervals(self, fitted: Fit) -> dict[str, tuple[float, float]]:
        """Return the 95 % interval of every free parameter, inside its bounds."""
        half = 1.96 * self.deviations(fitted)
        low, high = fitted.free.cut(fitted.point.vector - half, fitted.point.vector + half)
        return {name: (float(a), float(b)) for name, a, b in zip(fitted.free.names, low, high, strict=True)}


def _drawn(item: Whitened, noise: NoiseEstimate, seed: Sequence[int]) -> np.ndarray:
    rng, used = np.random.default_rng(seed), item.recording.used
    maps = np.stack([noise.draw(rng).simulate(used.shape, rng, item.slope)[used] for _ in range(DRAWS)], axis=1)
    return (item.whitener @ maps).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Screen:
    """Scores of the candidates beside a fit.

    Parameters
    ----------
    z : numpy.ndarray, shape (candidates,)
        Score in standard deviations of its own null; one-sided candidates that point the forbidden way have 0.
    amplitude : numpy.ndarray, shape (candidates,)
        Linear estimate of the strength, in typical sizes.
    visible : numpy.ndarray, shape (candidates,)
        Score that the typical size would give: what these data can see of the candidate.
    spread : numpy.ndarray, shape (candidates,)
        Standard deviation of a score before it was divided by it: 1 for exactly known white noise.
    columns : numpy.ndarray, shape (rows, candidates)
        Projected signatures of length 1.
    trials : float
        Independent tests that the whole family amounts to.
    """

    z: np.ndarray
    amplitude: np.ndarray
    visible: np.ndarray
    spread: np.ndarray
    columns: np.ndarray
    trials: float

    def p_value(self, z: float) -> float:
        """Return the probability that noise alone gives any candidate a score this large."""
        single = 2 * special.ndtr(-abs(z))
        return float(-np.expm1(self.trials * np.log1p(-min(single, 1 - 1e-12))))

    def threshold(self, level: float = 0.05) -> float:
        """Return the score that noise alone exceeds anywhere with this probability."""
        return float(-special.ndtri(-np.expm1(np.log1p(-level) / self.trials) / 2))


def beside(fit_basis: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove the fit's own freedom from columns; return unit columns, and the lengths that were left."""
    left = columns - fit_basis @ (fit_basis.T @ columns)
    left -= fit_basis @ (fit_basis.T @ left)
    lengths = np.linalg.norm(left, axis=0)
    known = lengths > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    return left * np.where(known, 1 / np.where(known, lengths, 1), 0.0), np.where(known, lengths, 0.0)


def screen(fitted: Fit, columns: np.ndarray, signs: np.ndarray, null: Null) -> Screen:
    """Score every candidate: z = g⊥·r, in units of what the null and numerical differences give.

    Parameters
    ----------
    fitted : Fit
    columns : numpy.ndarray, shape (rows, candidates)
        Whitened signatures per typical size.
    signs : numpy.ndarray, shape (candidates,)
        +1 or −1 where only this sign of the strength (in typical sizes) is physical, 0 both.
    null : Null
    """
    unit, lengths = beside(fitted.basis, columns)
    seen = lengths > 0
    components = null.along(unit)
    noise = np.where(seen, np.maximum(components.std(axis=1), 1e-6), np.inf)
    spread = np.hypot(noise, numerical_scores(fitted.data, unit))
    raw = unit.T @ fitted.residual
    allowed = (signs == 0) | (np.sign(raw) == signs)
    nulls = components / noise[:, None]
    nulls = np.where((signs == 0)[:, None] | (np.sign(nulls) == signs[:, None]), nulls, 0.0)
    amplitude = np.divide(raw, lengths, out=np.zeros_like(raw), where=seen)
    return Screen(
        z=np.where(allowed, raw / spread, 0.0),
        amplitude=amplitude,
        visible=np.where(seen, lengths / spread, 0.0),
        spread=spread,
        columns=unit,
        trials=_trials(np.abs(nulls).max(axis=0)),
    )


def numerical_scores(data: Sequence[Whitened], unit: np.ndarray) -> np.ndarray:
    """Return the score that numerical differences give along whitened columns of length 1 (or 0: none)."""
    points = sum(item.recording.points for item in data)
    height_um = np.sqrt(sum(np.sum(part**2, axis=0) for part in unwhitened(data, unit)) / points)
    return np.divide(COHERENT_UM, height_um, out=np.zeros_like(height_um), where=height_um > 0)


def p_of_largest(energy: float, largest: np.ndarray, of: int = 1) -> float:
    """Return the probability that the largest energy of noise alone reaches this one in any of several recordings.

    The largest of many squares of normal scores follows Gumbel's law; its two parameters are those of the draws.
    """
    scale = np.sqrt(6) / np.pi * largest.std(ddof=1)
    single = -np.expm1(-np.exp(-(energy - largest.mean()) / scale - np.euler_gamma))
    return float(-np.expm1(of * np.log1p(-min(single, 1 - 1e-12))))


def _trials(largest: np.ndarray) -> float:
    """Return how many independent two-sided tests have maxima distributed like these, by their upper half."""
    levels = np.array([0.5, 0.7, 0.8, 0.9, 0.95])
    single = 2 * special.ndtr(-np.quantile(largest, levels))
    return float(max(np.median(np.log(levels) / np.log1p(-np.minimum(single, 1 - 1e-9))), 1.0))
