"""A map continued smoothly from where it is trusted, across what is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

Pixels = tuple[np.ndarray, np.ndarray]

EXTRAPOLATED = np.array([[1, 0, 0], [2, -1, 0], [3, -3, 1]])
"""Weights of the values one, two and three steps back, of a constant, a straight line and a parabola."""


@dataclass(frozen=True, eq=False)
class Continuation:
    """How pixels follow from others, by the parabola through three that are trusted.

    f(p + d) = 3·f(p) − 3·f(p − d) + f(p − 2d) from the nearest trusted pixel p; the straight line, or f(p) alone, where
    p − 2d, or p − d, is not trusted itself. Linear in f.

    Parameters
    ----------
    pixels : tuple of numpy.ndarray
        p + d, rows and columns.
    known : tuple of tuple of numpy.ndarray
        p, p − d and p − 2d.
    weights : numpy.ndarray, shape (3, pixels)
    """

    pixels: Pixels
    known: tuple[Pixels, ...]
    weights: np.ndarray

    @classmethod
    def across(cls, left_out: np.ndarray) -> Continuation:
        """Continue across pixels that are left out, shape (rows, cols); some are not.

        Examples
        --------
        >>> parabola = np.array([[1.0, 4.0, 9.0, 16.0, 25.0, 0.0]])
        >>> Continuation.across(parabola == 0)(parabola).tolist()
        [[1.0, 4.0, 9.0, 16.0, 25.0, 36.0]]
        """
        pixels = np.argwhere(left_out).T
        found = ndimage.distance_transform_edt(left_out, return_distances=False, return_indices=True)
        nearest = found[:, *pixels]
        known, order = [nearest], np.zeros(pixels.shape[1], dtype=int)
        for back in (1, 2):
            there = nearest - back * (pixels - nearest)
            trusted = ndimage.map_coordinates(~left_out, there, order=0, mode="constant", cval=0)
            order += trusted
            known.append(np.where(trusted, there, nearest))
        (rows, cols), weights = pixels, EXTRAPOLATED[order].T
        return cls((rows, cols), tuple((r, c) for r, c in known), weights)

    def __call__(self, maps: np.ndarray) -> np.ndarray:
        """Return maps (..., rows, cols), continued."""
        continued = np.array(maps)
        parts = zip(self.weights, self.known, strict=True)
        continued[..., *self.pixels] = sum(weight * continued[..., *place] for weight, place in parts)
        return continued
