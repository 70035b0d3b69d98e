"""The footprint of a part: its edge distance, centre and size."""

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, grey_dilation


def stands(heights):
    """Return where a part stands; a pixel at its outline that its wall leaves less than half full does not count."""
    ground = heights <= 0
    outline = binary_dilation(ground, structure=np.ones((3, 3))) & ~ground
    return ~ground & ~(outline & (2 * heights < grey_dilation(heights, size=(3, 3))))


def edge_distance(standing, grid):
    """Return the lateral distance in um of each pixel centre from the nearest free edge, 0 outside."""
    distance = distance_transform_edt(np.pad(standing, 1), sampling=(grid.dy, grid.dx))[1:-1, 1:-1]
    return np.maximum(distance - (grid.dx + grid.dy) / 4, 0) * standing


def centroid(standing, grid):
    """Return the centre of mass (x, y) of the footprint in um."""
    row, column = np.nonzero(standing)
    return (grid.x[column].mean(), grid.y[row].mean()) if len(row) else (0.0, 0.0)


def half_size(standing, grid):
    """Return half the mean side of the footprint's bounding box in um."""
    row, column = np.nonzero(standing)
    sides = (np.ptp(column) + 1) * grid.dx, (np.ptp(row) + 1) * grid.dy
    return sum(sides) / 4
