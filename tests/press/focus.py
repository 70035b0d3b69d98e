"""The focus as a short sum of lobes, each a lateral Gaussian times an axial distribution.

One lobe is the paper's Gaussian. The two-photon Gaussian-Lorentzian focus, I^2 of a Gaussian beam,

    I^2(r, z) ~ w(z)^-4 exp(-4 r^2 / w(z)^2),   w(z)^2 = w0^2 (1 + z^2 / zR^2),

is written as lobes of fixed widths between which w(z)^2 is interpolated, so that every layer keeps the exact energy
(~ 1 / w^2) and the exact second moment.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve
from scipy.special import ndtr

from tests.press.gauss import REACH, SIGMA_PER_FWHM, along_x, along_y, line_kernel, parts_of

GAUSS_LORENTZ_REACH = 6.0  # Rayleigh lengths
GAUSS_LORENTZ_LOBES = 7


@dataclass(frozen=True)
class Lobe:
    """Lateral standard deviations in um along two principal axes, and the axial cumulative share of energy.

    `cumulative(u)` is the energy at axial offsets below u (um); `angle_deg` turns the axes counter-clockwise;
    `stretch(depth)` is the factor on axial widths at a depth in um, the depth being that of the point that is
    exposed, or of the focus if `stretched_at_focus`.
    """

    s_x_um: float
    s_y_um: float
    cumulative: Callable[[np.ndarray], np.ndarray]
    angle_deg: float = 0.0
    stretch: Callable[[np.ndarray], np.ndarray] = np.ones_like
    stretched_at_focus: bool = False

    def scaled(self, weight, ratio):
        """Return the lobe with its energy times `weight` and all widths times `ratio`."""
        return replace(
            self,
            s_x_um=self.s_x_um * ratio,
            s_y_um=self.s_y_um * ratio,
            cumulative=lambda u: weight * self.cumulative(u / ratio),
        )


def gaussian(fwhm_xy_um, fwhm_z_um):
    """Return the paper's focus: one three-dimensional Gaussian."""
    s_xy, s_z = fwhm_xy_um * SIGMA_PER_FWHM, fwhm_z_um * SIGMA_PER_FWHM
    return [Lobe(s_xy, s_xy, lambda u: ndtr(u / s_z))]


def gauss_lorentz(fwhm_xy_um, fwhm_z_um):
    """Return I^2 of a Gaussian beam with the given lateral and on-axis axial FWHM of I^2."""
    s_xy = fwhm_xy_um * SIGMA_PER_FWHM
    rayleigh = fwhm_z_um / (2 * np.sqrt(np.sqrt(2) - 1))
    u = np.linspace(-GAUSS_LORENTZ_REACH, GAUSS_LORENTZ_REACH, 2401) * rayleigh
    spread = 1 + (u / rayleigh) ** 2
    energy = 1 / spread
    nodes = np.geomspace(1, spread.max(), GAUSS_LORENTZ_LOBES)
    total = np.trapezoid(energy, u)
    lobes = []
    for index, node in enumerate(nodes):
        share = energy * np.interp(spread, nodes, np.eye(len(nodes))[index])
        steps = np.concatenate([[0.0], np.cumsum((share[1:] + share[:-1]) / 2 * np.diff(u))]) / total
        lobes.append(Lobe(s_xy * np.sqrt(node), s_xy * np.sqrt(node), _table(u, steps)))
    return lobes


def _table(u, values):
    """Return a cumulative distribution read from a table."""
    return lambda offset: np.interp(offset, u, values)


PROFILES = {"gaussian": gaussian, "gauss-lorentz": gauss_lorentz}


def mixed(profile, tails, fwhm_xy_um, fwhm_z_um):
    """Return a profile of which a share of the energy is spread as a Gaussian-Lorentzian focus of the same widths."""
    lobes = PROFILES[profile](fwhm_xy_um, fwhm_z_um)
    if tails == 0:
        return lobes
    own, further = (
        [(lobe, 1 - tails) for lobe in lobes],
        [(lobe, tails) for lobe in gauss_lorentz(fwhm_xy_um, fwhm_z_um)],
    )
    return [lobe.scaled(share, 1.0) for lobe, share in own + further if share > 0]


def axial_weights(lobe, z, dz):
    """Return the exposure that each point of `z` gets from each full layer, and from all below the lowest layer."""
    depth = np.maximum(z, 0.0)
    stretch = lobe.stretch(depth[None, :] if lobe.stretched_at_focus else depth[:, None])
    offset = z[None, :] - z[:, None]
    upper = lobe.cumulative((offset + dz / 2) / stretch)
    lower = lobe.cumulative((offset - dz / 2) / stretch)
    return upper - lower, lower[:, 0]


def _turned_kernel(lobe, grid, parts):
    """Return the lateral weights of a lobe whose axes are turned, from sub-pixels, sum 1."""
    half_x = int(np.ceil(REACH * max(lobe.s_x_um, lobe.s_y_um) / grid.dx))
    half_y = int(np.ceil(REACH * max(lobe.s_x_um, lobe.s_y_um) / grid.dy))
    x = np.arange(-half_x * parts - parts // 2, half_x * parts + parts // 2 + 1) / parts * grid.dx
    y = (np.arange(-half_y * parts - parts // 2, half_y * parts + parts // 2 + 1) / parts * grid.dy)[:, None]
    turn = np.radians(lobe.angle_deg)
    first, second = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    fine = np.exp(-0.5 * (first / lobe.s_x_um) ** 2 - 0.5 * (second / lobe.s_y_um) ** 2)
    weights = fine.reshape(2 * half_y + 1, parts, 2 * half_x + 1, parts).sum(axis=(1, 3))
    return (weights / weights.sum()).astype(np.float32)


def spread_laterally(stack, lobe, grid):
    """Apply the lateral part of a lobe to every layer; a map is refined along both axes or along none."""
    parts = parts_of(min(lobe.s_x_um, lobe.s_y_um) / max(grid.dx, grid.dy))
    if lobe.angle_deg % 90 == 0:
        quarter = (lobe.angle_deg // 90) % 2 == 1
        s_x, s_y = (lobe.s_y_um, lobe.s_x_um) if quarter else (lobe.s_x_um, lobe.s_y_um)
        return along_y(along_x(stack, line_kernel(s_x / grid.dx, parts)), line_kernel(s_y / grid.dy, parts))
    kernel = _turned_kernel(lobe, grid, parts)
    return fftconvolve(stack, kernel[(None,) * (stack.ndim - 2)], mode="same", axes=(-2, -1)).astype(stack.dtype)
