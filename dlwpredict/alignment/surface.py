"""A map ready to be read anywhere: gaps filled, and how much of each reading was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from dlwpredict.numerics.interpolation import read_means


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights without gaps on a grid, beside the share of each that was measured.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
        Heights, µm, finite everywhere.
    support : numpy.ndarray, shape (rows, cols)
        1 where measured, 0 where filled; between them after smoothing.
    dx_um, dy_um : float
        Pitch, µm.
    """

    heights_um: np.ndarray
    support: np.ndarray
    dx_um: float
    dy_um: float

    @property
    def size_um(self) -> tuple[float, float]:
        """Extent along x and y, pixels counted whole, µm."""
        rows, cols = self.heights_um.shape
        return cols * self.dx_um, rows * self.dy_um

    def mirrored(self) -> Surface:
        """Return the surface as in a mirror: columns reversed."""
        return replace(self, heights_um=self.heights_um[:, ::-1], support=self.support[:, ::-1])

    def smoothed(self, sigma_um: float) -> Surface:
        """Return the surface convolved with a Gaussian of this standard deviation (µm)."""
        sigma = (sigma_um / self.dy_um, sigma_um / self.dx_um)
        return replace(
            self,
            heights_um=ndimage.gaussian_filter(self.heights_um, sigma, mode="nearest", truncate=4),
            support=ndimage.gaussian_filter(self.support, sigma, mode="nearest", truncate=4),
        )

    @cached_property
    def _spline(self) -> np.ndarray:
        return ndimage.spline_filter(self.heights_um, order=3, mode="mirror")

    def at(self, x_um: np.ndarray, y_um: np.ndarray, how: str = "spline") -> tuple[np.ndarray, np.ndarray]:
        """Read heights and support at points from the centre; no support outside.

        Parameters
        ----------
        x_um, y_um : numpy.ndarray
        how : {"spline", "linear"}
        """
        place = self._place(x_um, y_um)
        source, order = (self._spline, 3) if how == "spline" else (self.heights_um, 1)
        heights = ndimage.map_coordinates(source, place, order=order, mode="mirror", prefilter=False)
        return heights, self._support(x_um, y_um)

    def mean_at(
        self, x_um: np.ndarray, y_um: np.ndarray, side_um: tuple[float, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Read means over rectangles about points from the centre, the heights being means over their pixels; support.

        From the nearest pixels along each axis (`read_means`): a spline rings several pixels deep at walls.

        Parameters
        ----------
        x_um, y_um : numpy.ndarray
        side_um : tuple of float
            Along x and y, at most two pixels.
        """
        width_px = side_um[1] / self.dy_um, side_um[0] / self.dx_um
        return read_means(self.heights_um, self._place(x_um, y_um), width_px), self._support(x_um, y_um)

    def _place(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return rows and columns of points, with fractions, shape (2, ...)."""
        rows, cols = self.heights_um.shape
        return np.array([(rows - 1) / 2 - y_um / self.dy_um, (cols - 1) / 2 + x_um / self.dx_um])

    def _support(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return the share of each reading that was measured."""
        rows, cols = self.heights_um.shape
        support = ndimage.map_coordinates(self.support, self._place(x_um, y_um), order=1, mode="nearest")
        inside = (np.abs(x_um) <= cols * self.dx_um / 2) & (np.abs(y_um) <= rows * self.dy_um / 2)
        return np.where(inside, support, 0.0)


def grid_um(size_um: tuple[float, float], pitch_um: float) -> tuple[np.ndarray, np.ndarray]:
    """Centred square grid over a field, x and y of each point, row 0 on top, µm."""
    cols, rows = (max(int(np.floor(size / pitch_um + 1e-6)), 2) for size in size_um)
    x = (np.arange(cols) - (cols - 1) / 2) * pitch_um
    y = ((rows - 1) / 2 - np.arange(rows)) * pitch_um
    return np.meshgrid(x, y)
