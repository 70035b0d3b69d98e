"""Does an import look like a microscope's field? Catches metres taken for µm and clipped heights, not finer slips."""

from __future__ import annotations

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap

FIELD_UM = (10.0, 1e4)
Z_RANGE_UM = (0.01, 1e3)
CLIPPED_SHARE, CLIPPED_POINTS = 1e-4, 10
WRITTEN_SUBSTRATE = 0.05  # share of points at exactly 0, which no microscope gives: a design, not a recording
CONTINUOUS_HEIGHTS = 1000  # different ones, from which a map is more than a design of few levels

DOUBTED, REFUSED = 3.0, 30.0
"""Factors between the relief of a recording and of its target, and between their sizes: beyond the first there is a
warning, beyond the second a unit is wrong, and nothing is fitted."""

FLAT_UM = 1e-8
"""Relief that rounding leaves of a flat map: of its unit nothing is known."""

ENDS = 0.1
"""Per cent of the heights at either end that the relief leaves out: spikes are none of it."""

MOSTLY_CLIPPED = 0.01
"""Share of points at the lowest or highest height beyond which a recording is refused."""

UNITS = {"nm": 1e-3, "Å": 1e-4, "pm": 1e-6, "mm": 1e3, "m": 1e6, "inch": 25400.0}
"""Units that heights or pitches may have been taken for µm in, and what they are to be multiplied by."""


def plausibility(height_map: HeightMap) -> list[str]:
    """Return a warning for each size that no usual recording has.

    Usual are fields of 10 µm to 10 mm and height ranges of 10 nm to 1 mm, and that hardly two points share the
    lowest or the highest height; 0 is left out, where a design has nothing.

    Examples
    --------
    >>> plausibility(HeightMap([[0.0, 5e-7]] * 200, dx_um=10, dy_um=0.1))
    ['z range 5e-07 µm, usual 0.01 to 1000 µm: is the unit right (--z-scale)?']
    """
    warnings = []
    for axis, extent in zip("xy", height_map.size_um, strict=True):
        if not FIELD_UM[0] <= extent <= FIELD_UM[1]:
            warnings.append(f"field {extent:.4g} µm in {axis}, usual 10 to 10000 µm: is the pitch right (--pitch-um)?")
    heights = height_map.heights_um
    return warnings + unusual_range(float(np.nanmax(heights) - np.nanmin(heights))) + clipping(height_map)


def unusual_height(design: HeightMap) -> list[str]:
    """Return a warning where a design is lower or higher than any usual one; of one that is empty others speak."""
    height = float(np.nanmax(design.heights_um))
    return unusual_range(height) if height > 0 else []


def unusual_range(z_range: float) -> list[str]:
    """Return a warning where heights in µm span less or more than usual."""
    if Z_RANGE_UM[0] <= z_range <= Z_RANGE_UM[1]:
        return []
    return [f"z range {z_range:.4g} µm, usual 0.01 to 1000 µm: is the unit right (--z-scale)?"]


def clipping(height_map: HeightMap) -> list[str]:
    """Return a warning where the lowest or the highest height of a recording stands at many points.

    0, the substrate, is left out; a map with much of it is a design, whose highest points may well be alike.
    """
    heights = height_map.heights_um[~np.isnan(height_map.heights_um)]
    if np.mean(heights == 0) > WRITTEN_SUBSTRATE:
        return []
    counts = [(name, end, int((heights == end).sum())) for name, end in _ends(heights) if end != 0]
    share = CLIPPED_SHARE * heights.size
    many = [(name, end, count) for name, end, count in counts if count >= CLIPPED_POINTS and count > share]
    if not many or np.unique(heights).size <= CONTINUOUS_HEIGHTS:
        return []
    return [
        f"{points} points at the {name} height, {end:.4g} µm: is the recording clipped?" for name, end, points in many
    ]


def require_unclipped(height_map: HeightMap) -> None:
    """Refuse a recording much of which stands at its lowest or highest height; a design is none.

    Raises
    ------
    InputError
        More than a hundredth of its points do.
    """
    heights = height_map.heights_um[~np.isnan(height_map.heights_um)]
    if np.mean(heights == 0) > WRITTEN_SUBSTRATE or np.unique(heights).size <= CONTINUOUS_HEIGHTS:
        return
    for name, end in _ends(heights):
        share = float(np.mean(heights == end))
        if share > MOSTLY_CLIPPED:
            raise InputError(
                f"{100 * share:.0f} % of the points at the {name} height, {end:.4g} µm",
                key="heights",
                allowed=f"at most {100 * MOSTLY_CLIPPED:g} %: the recording is clipped, take a larger z range",
            )


def _ends(heights: np.ndarray) -> tuple[tuple[str, float], tuple[str, float]]:
    return ("lowest", float(heights.min())), ("highest", float(heights.max()))


def require_sizes(target: HeightMap, measured: HeightMap) -> None:
    """Refuse a recording whose relief or field is more than `REFUSED` times off its target's: a unit is wrong.

    Raises
    ------
    InputError
        Names the unit that it looks like.
    """
    for what, key, option, recorded, wanted in _compared(target, measured):
        if not 1 / REFUSED <= recorded / wanted <= REFUSED:
            raise InputError(
                f"{what} {recorded:.4g} µm, {recorded / wanted:.3g} times the target's {wanted:.4g} µm",
                key=key,
                allowed=f"within a factor of {REFUSED:g}; {_unit(recorded / wanted, key, option)}",
            )


def doubts_of_size(target: HeightMap, measured: HeightMap) -> list[str]:
    """Return a warning where relief or field of a recording are more than `DOUBTED` times off its target's.

    Examples
    --------
    >>> part = HeightMap(np.add.outer(np.arange(40.0), np.arange(40.0) ** 2), 1, 1)
    >>> doubts_of_size(part, part.with_heights(part.heights_um * 1e-3))
    ['relief 1.557 µm, 1560 µm in the target: is the unit right (--z-scale)?']
    """
    return [
        f"{what} {recorded:.4g} µm, {wanted:.4g} µm in the target: is the unit right ({option})?"
        for what, _, option, recorded, wanted in _compared(target, measured)
        if not 1 / DOUBTED <= recorded / wanted <= DOUBTED
    ]


def _compared(target: HeightMap, measured: HeightMap) -> list[tuple[str, str, str, float, float]]:
    """Return what is compared: name, key, option, and the size of the recording and of the target, µm.

    Of a recording that may be tilted the relief is only known to lie between that about its plane and that as it lies;
    of a target without bare substrate, between its own and its height. What agrees best is taken.
    """
    top, lowest = float(np.nanmax(target.heights_um)), float(np.nanmin(target.heights_um))
    across, up = (slope / 1e3 for slope in tilt_mrad(measured))
    plane = across * measured.x_um + up * measured.y_um[:, None]
    low, high = sorted(_relief_um(heights) for heights in (measured.heights_um - plane, measured.heights_um))
    written = float(np.clip(high, top - lowest, top - min(lowest, 0.0)))
    field, wanted = (float(np.sqrt(np.prod(height_map.size_um))) for height_map in (measured, target))
    compared = [
        ("relief", "heights", "--z-scale", float(np.clip(written, low, high)), written),
        ("field", "pitch", "--pitch-um", field, wanted),
    ]
    return [sizes for sizes in compared if sizes[3] > FLAT_UM and sizes[4] > 0]


def _relief_um(heights_um: np.ndarray) -> float:
    """Return the range of heights, spikes left out, µm."""
    low, high = np.nanpercentile(heights_um, [ENDS, 100 - ENDS])
    return float(high - low)


def _unit(times: float, key: str, option: str) -> str:
    """Say which unit was taken for µm, where the factor is near one of them."""
    near = min(UNITS, key=lambda unit: abs(np.log(times * UNITS[unit])))
    if abs(np.log(times * UNITS[near])) > np.log(REFUSED) / 2:
        return f"is the unit right (convert {option}), and is it the recording of this target?"
    value = f"{UNITS[near]:g}" if option == "--z-scale" else f"as they are times {UNITS[near]:g}"
    return f"the unit looks like {near}: convert {option} {value}"


def plausibility_of_pitch(own_um: tuple[float, float], given_um: tuple[float, float]) -> list[str]:
    """Return a warning where the pitch that a user gives is not the file's own."""
    if np.allclose(own_um, given_um, rtol=0.01):
        return []
    stated, given = (" x ".join(f"{pitch:.4g}" for pitch in pair) for pair in (own_um, given_um))
    return [f"--pitch-um says {given} µm, the file itself {stated} µm: the option was taken"]


def tilt_mrad(height_map: HeightMap) -> tuple[float, float]:
    """Return the slopes along x and y (up) of the plane of least squares through the measured points, mrad.

    Examples
    --------
    >>> plane = HeightMap(np.add.outer([0.2, 0.0], [0.0, 0.1, 0.2]), dx_um=100, dy_um=100)
    >>> [round(slope, 6) for slope in tilt_mrad(plane)]
    [1.0, 2.0]
    """
    known = ~np.isnan(height_map.heights_um)
    heights = np.where(known, height_map.heights_um, 0.0)
    x, y, in_col, in_row = height_map.x_um, height_map.y_um, known.sum(0), known.sum(1)
    xy = y @ (known @ x)
    products = [
        [in_col.sum(), in_col @ x, in_row @ y],
        [in_col @ x, in_col @ x**2, xy],
        [in_row @ y, xy, in_row @ y**2],
    ]
    right = [heights.sum(), heights.sum(0) @ x, heights.sum(1) @ y]
    _, along_x, along_y = np.linalg.lstsq(np.array(products), np.array(right), rcond=None)[0]
    return 1e3 * float(along_x), 1e3 * float(along_y)
