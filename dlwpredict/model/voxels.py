"""Literal numerics: the paper's chain on a 3-D grid of voxels, in bounded memory.

It is the judge of the fast numerics. Its error falls linearly with the slice because voxels are all or nothing:
about 27 nm rms at 0.1 µm, half of that at 0.05 µm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from dlwpredict.model.states import Crosslinked, Dose, Exposed
from dlwpredict.smoothing import FWHM_PER_SIGMA, REACH_SIGMAS, blur, gaussian_taps


@dataclass(frozen=True)
class Voxels:
    """The literal numerics.

    Parameters
    ----------
    slice_um : float
        Height of a voxel, µm; its other sides are the target's pixels.
    memory_mb : float
        Rows are worked on in blocks whose stacks stay within this.
    """

    slice_um: float = 0.1
    memory_mb: float = 600.0

    def centres(self, count: int) -> np.ndarray:
        """Return z of the first slices' centres, µm."""
        return (np.arange(count) + 0.5) * self.slice_um

    def exposed(self, dose: Dose, threshold: float, reference: str) -> Exposed:
        """Mark every voxel whose exposure reaches the threshold, slice by slice."""
        heights = dose.written.heights_um
        widest = max(part.sigma_z_um(heights.max()) for part in dose.focus)
        count = int(np.ceil((heights.max() + REACH_SIGMAS * widest) / self.slice_um))
        if reference == "structure_maximum":
            threshold = threshold * float(self._exposure(dose, 0).max())
        solid, exposed_slices = [], np.zeros(heights.shape, dtype=np.int32)
        for first in range(0, count, 8):
            chunk = np.zeros((8, *heights.shape), dtype=bool)
            for i in range(first, min(first + 8, count)):
                z = self.centres(i + 1)[-1]
                chunk[i - first] = self._exposure(dose, i) >= threshold * dose.relative_threshold(z)
            exposed_slices += chunk.sum(axis=0, dtype=np.int32)
            solid.append(np.packbits(chunk, axis=0))
            if not chunk.any():
                break
        surface = dose.written.with_heights(exposed_slices * self.slice_um)
        return Exposed(surface, dose, np.concatenate(solid))

    def _exposure(self, dose: Dose, index: int) -> np.ndarray:
        """Convolve the binary solid with the focus, in one slice.

        A column of n solid voxels, continued below the substrate, contributes the axial taps up to n − index: the sum of
        the taps over the solid voxels around this slice, read from their running sum.
        """
        heights = dose.written.heights_um
        solid_voxels = np.ceil(heights / self.slice_um - 0.5).astype(int)
        z = self.centres(index + 1)[-1]
        total = np.zeros(heights.shape)
        for part in dose.focus:
            taps = gaussian_taps(float(part.sigma_z_um(z) / self.slice_um))
            running = np.concatenate([[0.0], np.cumsum(taps)])
            axial = running[np.clip(solid_voxels - index + len(taps) // 2, 0, len(taps))]
            total += part.weight * part.spread(
                np.where(heights > 0, axial, 0.0), dose.written.dx_um, dose.written.dy_um
            )
        return total

    def column_mean(self, crosslinked: Crosslinked, reference: str) -> np.ndarray:
        """Average (curved) normalised cross-linking over the exposed voxels of every column."""
        surface = crosslinked.exposed.surface
        if not surface.heights_um.any():
            return np.zeros(surface.shape)
        largest = 1.0
        if reference == "structure_maximum":
            largest = max(float(m_cl.max()) for _, m_cl, _ in self._blocks(crosslinked))
        mean = np.zeros(surface.shape)
        for rows, m_cl, solid in self._blocks(crosslinked):
            values = m_cl / largest
            for curve in crosslinked.curves:
                values = curve(np.clip(values, 0, 1))
            mean[rows] = np.sum(values * solid, axis=0) / np.maximum(solid.sum(axis=0), 1)
        return mean

    def _blocks(self, crosslinked: Crosslinked) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Yield, block of rows by block of rows, the rows, m_cl (slice, rows, cols), and the exposed voxels."""
        exposed = crosslinked.exposed
        packed, dose, grid = exposed.solid, exposed.dose, exposed.surface
        sigma_xy, sigma_z = crosslinked.fwhm_xy_um / FWHM_PER_SIGMA, crosslinked.fwhm_z_um / FWHM_PER_SIGMA
        count, rows, cols = 8 * len(packed), *grid.shape
        axial = _axial_matrix(sigma_z / self.slice_um, count)
        halo = int(np.ceil(REACH_SIGMAS * sigma_xy / grid.dy_um))
        # a block holds about five stacks of four bytes
        block = max(int(self.memory_mb * 1e6 / (count * cols * 20)) - 2 * halo, 16)
        z = self.centres(count)
        for first in range(0, rows, block):
            start, stop = max(first - halo, 0), min(first + block + halo, rows)
            inner = slice(first - start, min(first + block, rows) - start)
            solid = np.unpackbits(packed[:, start:stop], axis=0).astype(np.float32)
            source = solid
            if dose.conversion and dose.intensity:
                source = solid.copy()
                for plane, height in zip(source, z, strict=True):
                    plane *= np.broadcast_to(dose.source_weight(height), grid.shape)[start:stop]
            m_cl = blur(np.tensordot(axial, source, axes=1), sigma_xy / grid.dy_um, sigma_xy / grid.dx_um)
            yield slice(first, min(first + block, rows)), m_cl[:, inner], solid[:, inner]


def _axial_matrix(sigma_px: float, count: int) -> np.ndarray:
    """Return the matrix (count, count) that convolves a column with a Gaussian; below z = 0 nothing polymerises."""
    taps = gaussian_taps(float(sigma_px))
    right = taps[len(taps) // 2 :][:count]
    return toeplitz(np.pad(right, (0, count - len(right)))).astype(np.float32)
