"""Where the voxels and pixels are."""

from dataclasses import dataclass

import numpy as np

FIELD_RADIUS_UM = 50.0  # reference radius of every field effect: rho = 1 there
GHOSTS = 2  # layers kept below the substrate, so that a surface at z = 0 is bracketed


@dataclass(frozen=True)
class Grid:
    """Centres of the voxels in um; x and y are counted from the field centre, y upwards, z from the substrate."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    dx: float
    dy: float
    dz: float

    @property
    def depth(self):
        """Height above the substrate of each layer, 0 in the ghost layers, shaped to broadcast (nz, 1, 1)."""
        return np.maximum(self.z, 0.0)[:, None, None]

    def radius(self, centre_x_um=0.0, centre_y_um=0.0):
        """Distance to a centre in units of `FIELD_RADIUS_UM`."""
        return np.hypot(self.x[None, :] - centre_x_um, self.y[:, None] - centre_y_um) / FIELD_RADIUS_UM


def centred(count, pitch):
    """Return `count` pixel centres around 0."""
    return (np.arange(count) - (count - 1) / 2) * pitch


def plane_grid(shape, dx, dy, centre=(0.0, 0.0)):
    """Return the grid of a map with rows counted upwards and its centre at a place in um, no layers yet."""
    return Grid(centred(shape[1], dx) + centre[0], centred(shape[0], dy) + centre[1], np.zeros(0), dx, dy, 1.0)


def with_layers(grid, top_um, dz):
    """Return the grid with layers of `dz` from `GHOSTS` below the substrate up to `top_um`."""
    layers = int(np.ceil(top_um / dz)) + 2
    z = (np.arange(-GHOSTS, layers) + 0.5) * dz
    return Grid(grid.x, grid.y, z, grid.dx, grid.dy, dz)
