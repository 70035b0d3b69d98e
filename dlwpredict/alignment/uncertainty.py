"""What a fitted figure is worth when neighbouring points err together."""

from __future__ import annotations

import numpy as np

from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.refine import Fit

BLOCKS = 8  # per side


def block_index(shape: tuple[int, int], blocks: int = BLOCKS) -> np.ndarray:
    """Number each point by its block, flat: blocks × blocks tiles of equal size.

    Examples
    --------
    >>> block_index((2, 4), 2).tolist()
    [0, 0, 1, 1, 2, 2, 3, 3]
    """
    row, col = (np.arange(n) * blocks // n for n in shape)
    return (row[:, None] * blocks + col).ravel()


def block_covariance(
    columns: np.ndarray, weights: np.ndarray, residual: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, float]:
    """Covariance of a weighted linear fit whose residuals are correlated within blocks.

    Jackknife: leaving block b out moves the parameters by d_b = (H − H_b)⁻¹ s_b, s_b = Σ_{i in b} w_i r_i a_i,
    H_b = Σ_{i in b} w_i a_i a_iᵀ; V = (B − 1)/B·Σ_b d_b d_bᵀ (CR3, Bell & McCaffrey, Surv. Methodol. 28, 169 (2002)).
    Pixels are never counted as independent, only blocks are, and a block that alone settles a figure counts as such.

    Returns
    -------
    covariance : numpy.ndarray, shape (k, k)
    count : float
        Effective blocks: (tr H)²/Σ_b (tr H_b)², columns scaled alike.
    """
    size = np.sqrt(np.maximum(np.sum(weights[:, None] * columns**2, 0), 1e-300))
    scaled = columns / size
    number, k = int(blocks.max()) + 1, columns.shape[1]
    pairs = [np.bincount(blocks, weights * scaled[:, i] * scaled[:, j], number) for i in range(k) for j in range(k)]
    parts = np.stack(pairs, axis=1).reshape(number, k, k)
    score = np.stack([np.bincount(blocks, column * weights * residual, number) for column in scaled.T], axis=1)
    inverse = np.linalg.pinv(parts.sum(0) - parts, rcond=1e-10, hermitian=True)
    moves = np.einsum("bij,bj->bi", inverse, score)
    shares = np.trace(parts, axis1=1, axis2=2)
    count = shares.sum() ** 2 / np.sum(shares**2)
    return (number - 1) / number * moves.T @ moves / np.outer(size, size), float(count)


def layouts(shape: tuple[int, int]) -> list[np.ndarray]:
    """Blocks in three layouts: tiles, columns, rows; an error that runs along a straight edge stays in one strip."""
    row, col = np.indices(shape)
    strips = [(side * 2 * BLOCKS // n).ravel() for side, n in ((col, shape[1]), (row, shape[0]))]
    return [block_index(shape), *strips]


def widest_covariance(
    columns: np.ndarray, weights: np.ndarray, residual: np.ndarray, blocks: list[np.ndarray]
) -> tuple[np.ndarray, float]:
    """`block_covariance` of the first layout, each figure's error widened to the largest of all layouts."""
    estimates = [block_covariance(columns, weights, residual, layout) for layout in blocks]
    covariance, count = estimates[0]
    spread = np.sqrt([np.maximum(np.diag(v), 1e-300) for v, _ in estimates])
    wider = spread.max(0) / spread[0]
    return covariance * np.outer(wider, wider), count


def pose_covariance(fit: Fit, *, tiles_only: bool = False) -> tuple[np.ndarray, float]:
    """Covariance of the parameters of `Pose.moved`; no direction is worse than the target's own size.

    Parameters
    ----------
    fit : Fit
    tiles_only : bool
        Blocks as tiles only: for a joint test of several figures, which widening each by its own factor would blunt.

    Returns
    -------
    covariance : numpy.ndarray, shape (parameters, parameters)
    blocks : float
    """
    reach = float(np.max(fit.pose.reach_um))
    jacobian = fit.jacobian @ fit.scale
    blocks = layouts(fit.level.grid[0].shape)[: 1 if tiles_only else None]
    covariance, count = widest_covariance(jacobian, fit.weights, fit.residual, blocks)
    values, vectors = np.linalg.eigh(covariance)
    normal = jacobian.T @ (jacobian * fit.weights[:, None])
    blind = np.einsum("ik,ij,jk->k", vectors, normal, vectors) < 1e-7 * np.linalg.eigvalsh(normal)[-1]
    values = np.where(blind, reach**2, np.clip(values, 0, reach**2))
    return fit.scale @ (vectors * values) @ vectors.T @ fit.scale.T, count


def figure_covariance(pose: Pose, covariance: np.ndarray) -> np.ndarray:
    """Carry the covariance of the parameters over to `Pose.figures`, shape (14, 14)."""
    steps = np.sqrt(np.maximum(np.diag(covariance), 1e-24)) * 1e-3
    base = pose.figures()
    change = np.stack([(pose.moved(np.diag(steps)[k]).figures() - base) / steps[k] for k in range(len(steps))])
    return change.T @ covariance @ change
