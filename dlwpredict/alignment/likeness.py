"""What a print may look like: any symmetric function of its target, so that no part of it can feign a shift."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import fft

from dlwpredict.alignment.plane import plane_columns

KERNEL_RATIO, WIDEST = 2.5, 0.25
"""Widths of neighbouring Gaussians; the widest, as a share of the map: cross-linking reaches over a quarter of a small
part, and what it does there is not to pass for a scale of the microscope."""


def gaussian_reflected(image: np.ndarray, sigma: float) -> np.ndarray:
    """Convolve with a Gaussian of σ pixels, edges reflected: the transfer function exp(−σ²k²/2) on cosines.

    Examples
    --------
    >>> float(gaussian_reflected(np.full((5, 4), 3.0), 2.0).std()) < 1e-12
    True
    """
    rows, cols = (np.pi * np.arange(n) / n for n in image.shape)
    transfer = np.exp(-0.5 * sigma**2 * (rows[:, None] ** 2 + cols**2))
    return fft.idctn(transfer * fft.dctn(image, type=2), type=2)


def likeness_columns(target: np.ndarray) -> np.ndarray:
    """Columns whose linear combinations can look like a print of the target.

    The print and its recording are isotropic to good approximation: blur of focus and instrument, threshold,
    shrinkage that grows with the cross-linked neighbourhood, cut corners. Here these are sums of T, T², T³ and of
    Gσ∗T, T·(Gσ∗T), Gσ∗F, T·(Gσ∗F) (F: footprint T > 0) with Gaussians of all widths, of |∇T| and |∇T|² (edges that
    grow sideways, slopes that read low), and a plane for the tilt. A
    symmetric kernel moves no feature, so what these columns take up is never mistaken for a shift.

    Parameters
    ----------
    target : numpy.ndarray, shape (rows, cols)

    Returns
    -------
    numpy.ndarray, shape (points, columns)
        Columns of unit size; a column that says nothing new is left out.
    """
    row, col = np.indices(target.shape, dtype=float)
    columns = [*plane_columns(col / max(target.shape) - 0.5, row / max(target.shape) - 0.5).T]
    columns += [term.ravel() for term in _terms(target)]
    scaled = [column / size for column in columns if (size := np.sqrt(np.mean(column**2))) > 1e-12]
    return np.stack(scaled, axis=1)


def _terms(target: np.ndarray) -> Iterator[np.ndarray]:
    height = target / max(float(np.abs(target).max()), 1e-12)
    yield from (height, height**2, height**3)
    sources = [height]
    inside = (target > 0.02 * target.max()).astype(float)
    if 0.01 < inside.mean() < 0.99:
        yield inside
        sources.append(inside)
    for sigma in (0.0, 1.5):
        slope = np.hypot(*np.gradient(gaussian_reflected(height, sigma)))
        yield from (slope, slope**2)
    sigma = 1.5
    while sigma <= WIDEST * min(target.shape):
        for source in sources:
            blurred = gaussian_reflected(source, sigma)
            yield blurred
            yield height * blurred
        sigma *= KERNEL_RATIO
