"""What the property tests draw: targets, processes, grids."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Paper, ParameterSet, Readings, declarations

FREE_READINGS = st.builds(
    Readings,
    threshold_reference=st.sampled_from(["full_dose", "structure_maximum"]),
    crosslink_reference=st.sampled_from(["structure_maximum", "bulk"]),
)
"""Every reading of the paper."""

MONOTONE = Readings(threshold_reference="full_dose", crosslink_reference="bulk")
"""The readings under which no part of a structure changes what another part is measured against."""


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, width=64)


@st.composite
def heights(draw: Any, *, highest_um: float = 8.0, most_px: int = 36) -> np.ndarray:
    """Draw heights (rows, cols) with something written: blocks of one pixel and more, half of them empty glass."""
    block = draw(st.integers(1, 8))
    cells = draw(st.tuples(*[st.integers(2, max(most_px // block, 2))] * 2))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    plane = rng.uniform(0.05, highest_um, cells) * (rng.random(cells) < draw(between(0.1, 1.0)))
    plane[tuple(n // 2 for n in cells)] = draw(between(0.05, highest_um))
    return np.pad(np.kron(plane, np.ones((block, block))), draw(st.integers(0, 4)))


@st.composite
def targets(draw: Any, *, square: bool = False, **kind: Any) -> HeightMap:
    """Draw a target."""
    plane = draw(heights(**kind))
    dx_um = draw(between(0.08, 0.6))
    return HeightMap(plane, dx_um, dx_um if square else draw(between(0.08, 0.6)))


@st.composite
def processes(draw: Any, *, readings: Any = FREE_READINGS, extreme: bool = False) -> ParameterSet:
    """Draw a process: usual widths, or anything that is declared legal."""
    usual = {
        "exposure_fwhm_xy_um": (0.1, 1.5), "exposure_fwhm_z_um": (0.4, 4.0), "threshold": (0.1, 0.9),
        "crosslink_fwhm_xy_um": (1.0, 15.0), "crosslink_fwhm_z_um": (1.0, 15.0),
    }  # fmt: skip
    ranges = {name: (d.low, d.high) for name, (_, d) in declarations(Paper).items()} | ({} if extreme else usual)
    values = {name: draw(between(*limits)) for name, limits in ranges.items()}
    low, high = sorted([values.pop("shrinkage_min"), values.pop("shrinkage_max")])
    chosen = readings if isinstance(readings, Readings) else draw(readings)
    return ParameterSet(paper=Paper(**values, shrinkage_min=low, shrinkage_max=high), readings=chosen)


def several(shape: tuple[int, ...], low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, shape, elements=between(low, high))
