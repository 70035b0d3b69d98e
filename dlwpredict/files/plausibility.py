"""Does an import look like a microscope's field? Catches metres taken for µm, not finer slips."""

from __future__ import annotations

import numpy as np

from dlwpredict.heightmap import HeightMap

FIELD_UM = (10.0, 1e4)
Z_RANGE_UM = (0.01, 1e3)


def plausibility(height_map: HeightMap) -> list[str]:
    """Return a warning for each size that no usual recording has.

    Usual are fields of 10 µm to 10 mm and height ranges of 10 nm to 1 mm.

    Examples
    --------
    >>> plausibility(HeightMap([[0.0, 5e-7]] * 200, dx_um=10, dy_um=0.1))
    ['z range 5e-07 µm, usual 0.01 to 1000 µm: is the unit right (--z-scale)?']
    """
    warnings = []
    for axis, extent in zip("xy", height_map.size_um, strict=True):
        if not FIELD_UM[0] <= extent <= FIELD_UM[1]:
            warnings.append(f"field {extent:.4g} µm in {axis}, usual 10 to 10000 µm: is the pitch right (--pitch-um)?")
    z_range = float(np.nanmax(height_map.heights_um) - np.nanmin(height_map.heights_um))
    if not Z_RANGE_UM[0] <= z_range <= Z_RANGE_UM[1]:
        warnings.append(f"z range {z_range:.4g} µm, usual 0.01 to 1000 µm: is the unit right (--z-scale)?")
    return warnings
