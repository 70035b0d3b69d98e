"""Gaps filled before a map is exported."""

import numpy as np

from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.missing import fill_missing


def test_nearest_is_nearest_in_um():
    """Two pixels of 0.1 µm to the left are nearer than one of 0.3 µm upwards."""
    part = HeightMap([[7.0, 7.0, 7.0], [1.0, np.nan, np.nan]], 0.1, 0.3)
    assert fill_missing(part, "nearest").heights_um[1].tolist() == [1.0, 1.0, 1.0]
    turned = HeightMap(part.heights_um.T, 0.3, 0.1)
    assert fill_missing(turned, "nearest").heights_um[:, 1].tolist() == [1.0, 1.0, 1.0]
