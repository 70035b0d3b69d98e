"""What a fitted figure is worth when neighbouring points err together."""

from __future__ import annotations

import numpy as np

from dlwpredict.align.pose import Pose
from dlwpredict.align.refine import Fit, parameter_scale

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
) -> tuple[np.ndarray, int]:
    """Covariance of a weighted linear fit whose residuals are correlated within blocks.

    V = H⁻¹ (Σ_b s_b s_bᵀ) H⁻¹·B/(B − k), s_b = Σ_{i in b} w_i r_i a_i, H = Σ w a aᵀ: the sandwich with clusters
    (Liang & Zeger, Biometrika 73, 13 (1986)). Pixels are never counted as independent; only blocks are.

    Returns
    -------
    covariance : numpy.ndarray, shape (k, k)
        Directions that the data leave open have infinite variance on the diagonal.
    count : int
        Blocks that hold measured points.
    """
    normal = columns.T @ (columns * weights[:, None])
    score = columns * (weights * residual)[:, None]
    sums = np.stack([np.bincount(blocks, column, minlength=blocks.max() + 1) for column in score.T])
    count = int(np.unique(blocks[weights > 0]).size)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(size, size)
    meat = sums @ sums.T * count / max(count - columns.shape[1], 1)
    return inverse @ meat @ inverse, count


def pose_covariance(fit: Fit, distortion: str) -> tuple[np.ndarray, int]:
    """Covariance of the parameters of `Pose.moved`; no direction is worse than the target's own size.

    Returns
    -------
    covariance : numpy.ndarray, shape (parameters, parameters)
    blocks : int
    """
    reach = float(np.max(fit.pose.reach_um))
    scale = parameter_scale(distortion, fit.pose.reach_um)
    index = block_index(fit.level.grid[0].shape)
    covariance, count = block_covariance(fit.jacobian * scale, fit.weights, fit.residual, index)
    values, vectors = np.linalg.eigh(covariance)
    normal = (fit.jacobian * scale).T @ (fit.jacobian * scale * fit.weights[:, None])
    blind = np.einsum("ik,ij,jk->k", vectors, normal, vectors) < 1e-7 * np.linalg.eigvalsh(normal)[-1]
    values = np.where(blind, reach**2, np.clip(values, 0, reach**2))
    return (vectors * values) @ vectors.T * np.outer(scale, scale), count


def figure_covariance(pose: Pose, covariance: np.ndarray) -> np.ndarray:
    """Carry the covariance of the parameters over to `Pose.figures`, shape (12, 12)."""
    steps = np.sqrt(np.maximum(np.diag(covariance), 1e-24)) * 1e-3
    base = pose.figures()
    change = np.stack([(pose.moved(np.diag(steps)[k]).figures() - base) / steps[k] for k in range(len(steps))])
    return change.T @ covariance @ change
