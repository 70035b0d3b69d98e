"""Edge inhibition: fresh quencher diffuses in from unexposed resin and raises the threshold, at the top as well.

literal:   P -> P (1 + gain (1 - G_fwhm * written)); the glass is no resin, written columns continue below z = 0.
diffusion: steady state of a quencher that diffuses and is used up where is written,
           l^2 lap q = q inside, l^2 lap q = 4 (q - 1) outside, q = 1 far away, no flux into the glass,
           with l = 0.6 FWHM; P -> P (1 + gain q). Solved by conjugate gradients on coarser voxels.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import LinearOperator, cg

from tests.press.effect import PrintEffect, effect
from tests.press.grid import GHOSTS
from tests.press.spread import spread

REPLENISHED = 4.0
LENGTH_PER_FWHM = 0.6


@effect("edge-inhibition")
@dataclass(frozen=True)
class EdgeInhibition(PrintEffect):
    """Gain without unit, FWHM in um."""

    models = ("literal", "diffusion")
    gain: float = 0.0
    fwhm_um: float = 3.0
    model: str = "literal"

    def threshold(self, scene):
        if self.gain == 0:
            return None
        if self.model == "diffusion":
            return 1 + self.gain * quencher(scene, LENGTH_PER_FWHM * self.fwhm_um)
        return 1 + self.gain * (1 - spread(scene, self.fwhm_um, below=True))


def quencher(scene, length_um):
    """Return the share of quencher left in every voxel."""
    grid = scene.grid
    pitches = np.array([grid.dz, grid.dy, grid.dx])
    blocks = np.maximum(np.floor(length_um / 2.5 / pitches), 1).astype(int)
    written = _block_means(scene.fill[GHOSTS:], blocks)
    stiff = (length_um / (blocks * pitches)) ** 2
    sink = written + REPLENISHED * (1 - written)
    source = REPLENISHED * (1 - written) + _rim(written.shape, stiff)

    def apply(flat):
        q = flat.reshape(written.shape)
        return (sink * q - _laplacian(q, stiff)).ravel()

    system = LinearOperator((written.size, written.size), matvec=apply, dtype=float)
    solved, _ = cg(system, source.ravel(), x0=1 - written.ravel() / 2, rtol=1e-5, maxiter=300)
    return _back(solved.reshape(written.shape), scene.fill.shape, blocks)


def _block_means(stack, blocks):
    """Return means over blocks, the rest filled with nothing written."""
    wanted = [(-count) % block for count, block in zip(stack.shape, blocks, strict=True)]
    padded = np.pad(stack, [(0, extra) for extra in wanted])
    shape = [part for count, block in zip(padded.shape, blocks, strict=True) for part in (count // block, block)]
    return padded.reshape(shape).mean(axis=(1, 3, 5)).astype(float)


def _laplacian(q, stiff):
    """Return the weighted second differences with q = 0 beyond the rim, except no flux through the glass."""
    out = np.zeros_like(q)
    for axis, weight in enumerate(stiff):
        flow = weight * np.diff(q, axis=axis)
        first, last = ([slice(None)] * 3 for _ in range(2))
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        out[tuple(first)] += flow
        out[tuple(last)] -= flow
        end = [slice(None)] * 3
        end[axis] = -1
        out[tuple(end)] -= weight * q[tuple(end)]
        if axis > 0:
            end[axis] = 0
            out[tuple(end)] -= weight * q[tuple(end)]
    return out


def _rim(shape, stiff):
    """Return what the fresh resin beyond the rim (q = 1) sends in."""
    return -_laplacian(np.ones(shape), stiff)


def _back(coarse, shape, blocks):
    """Interpolate block values back to voxels, ghosts below the substrate taking the lowest."""
    places = [(np.arange(count) - start + 0.5) / block - 0.5
              for count, start, block in zip(shape, (GHOSTS, 0, 0), blocks, strict=True)]  # fmt: skip
    return map_coordinates(coarse, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest")
