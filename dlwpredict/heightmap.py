"""The height map: heights that always travel with their grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dlwpredict.errors import InputError

HeightReference = Literal["substrate", "relative"]


INSTRUMENTS = ("confocal", "wli", "afm", "unknown")
"""Confocal microscope, white-light interferometer, atomic force microscope."""


TALLEST_UM = 1e4
"""Highest structure that is taken for one, µm: a centimetre. Beyond it a unit is wrong."""


@dataclass(frozen=True)
class Instrument:
    """What has recorded a map, and in which direction it scans its lines.

    Parameters
    ----------
    kind : {"confocal", "wli", "afm", "unknown"}
    fast_axis_deg : float, optional
        Direction of the fast measuring axis in the frame of the map, counter-clockwise from x, −180 < it ≤ 180;
        None where there is none, or none is known.
    pitch_um : float, optional
        Pitch that it recorded with, the larger where it is not the same along x and y; None where it is the map's.
    scale : float
        By this factor it showed the map narrower along both axes than the target, which an alignment has taken out; a
        print that shrinks sideways is so, too. 1 where nothing was.

    Raises
    ------
    InputError
        Another kind, a direction that is not finite, a pitch that is not positive, or a scale that is not up to 1.

    Examples
    --------
    >>> Instrument("afm", 30.0).turned(-90.0).fast_axis_deg, Instrument("afm", 30.0).mirrored().fast_axis_deg
    (-60.0, 150.0)
    """

    kind: str = "unknown"
    fast_axis_deg: float | None = None
    pitch_um: float | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in INSTRUMENTS:
            raise InputError(f"found {self.kind}", key="instrument", allowed=f"allowed: {', '.join(INSTRUMENTS)}")
        if self.fast_axis_deg is not None:
            if not np.isfinite(self.fast_axis_deg):
                raise InputError(
                    f"found {self.fast_axis_deg:g}", key="instrument_fast_axis_deg", allowed="allowed: degrees from x"
                )
            object.__setattr__(self, "fast_axis_deg", 180 - (180 - float(self.fast_axis_deg)) % 360)
        if self.pitch_um is not None and not (np.isfinite(self.pitch_um) and self.pitch_um > 0):
            raise InputError(
                f"found {self.pitch_um:g}", key="instrument_pitch_um", allowed="allowed: a positive number"
            )
        if not 0 < self.scale <= 1:
            raise InputError(f"found {self.scale:g}", key="instrument_scale", allowed="allowed: above 0, up to 1")

    def turned(self, angle_deg: float) -> Instrument:
        """Return the instrument in the frame of a map that was turned by an angle, counter-clockwise."""
        return self if self.fast_axis_deg is None else replace(self, fast_axis_deg=self.fast_axis_deg + angle_deg)

    def mirrored(self) -> Instrument:
        """Return the instrument in the frame of a map whose columns were reversed."""
        return self if self.fast_axis_deg is None else replace(self, fast_axis_deg=180 - self.fast_axis_deg)


UNKNOWN = Instrument()


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over a regular grid, all lengths in µm.

    ``heights_um[row, col]``: x grows with ``col``; row 0 is the top, so y = (rows − 1 − row)·dy. Seen from
    above, the part looks like the picture. z = 0 is the substrate, height 0 means nothing written there, NaN
    means not measured. Pixels may be non-square.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
        Heights, µm; stored as float64.
    dx_um, dy_um : float
        Pixel pitch along x (columns) and y (rows), µm.
    height_reference : {"substrate", "relative"}
        Whether absolute heights can be trusted. "relative": no substrate was in view, offset and tilt are free.
    filled : numpy.ndarray of bool, shape (rows, cols), optional
        True where the height was interpolated, not measured. Such points never carry weight in a fit.
    instrument : Instrument
        What has recorded it.

    Raises
    ------
    InputError
        Not two-dimensional, fewer than 2 × 2 points, pitch not positive and finite, or infinite heights.

    Examples
    --------
    >>> part = HeightMap([[0.0, 1.0], [2.0, np.nan]], dx_um=0.5, dy_um=0.25)
    >>> part.size_um, part.missing_fraction
    ((1.0, 0.5), 0.25)
    >>> part.y_um.tolist()  # centred, row 0 on top
    [0.125, -0.125]
    """

    heights_um: np.ndarray
    dx_um: float
    dy_um: float
    height_reference: HeightReference = "substrate"
    filled: np.ndarray | None = None
    instrument: Instrument = UNKNOWN

    def __post_init__(self) -> None:
        heights = np.array(self.heights_um, dtype=float)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InputError(
                f"height map of shape {heights.shape}",
                key="shape",
                allowed="at least 2 x 2 points in one channel",
            )
        if np.isinf(heights).any():
            raise InputError(
                f"{np.isinf(heights).sum()} infinite heights",
                key="heights",
                allowed="finite numbers or NaN (not measured)",
            )
        for name in ("dx_um", "dy_um"):
            pitch = float(getattr(self, name))
            if not (np.isfinite(pitch) and pitch > 0):
                raise InputError(f"pitch {name} = {pitch:g}", key="pitch", allowed="allowed: a positive number of µm")
            object.__setattr__(self, name, pitch)
        heights.setflags(write=False)
        object.__setattr__(self, "heights_um", heights)
        if self.filled is not None:
            filled = np.array(self.filled, dtype=bool)
            if filled.shape != heights.shape:
                raise InputError(f"mask of shape {filled.shape} on heights of shape {heights.shape}", key="filled")
            object.__setattr__(self, "filled", filled if filled.any() else None)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.heights_um.shape

    @property
    def size_um(self) -> tuple[float, float]:
        """Extent along x and y in µm, pixels counted whole."""
        rows, cols = self.shape
        return cols * self.dx_um, rows * self.dy_um

    @property
    def x_um(self) -> np.ndarray:
        """X of every column from the map's centre, µm, shape (cols,)."""
        cols = self.shape[1]
        return (np.arange(cols) - (cols - 1) / 2) * self.dx_um

    @property
    def y_um(self) -> np.ndarray:
        """Y of every row from the map's centre, upwards, µm, shape (rows,)."""
        rows = self.shape[0]
        return ((rows - 1) / 2 - np.arange(rows)) * self.dy_um

    @property
    def measured(self) -> np.ndarray:
        """True where a height was measured: neither NaN nor filled."""
        known = ~np.isnan(self.heights_um)
        return known if self.filled is None else known & ~self.filled

    @property
    def missing_fraction(self) -> float:
        """Fraction of points without a height (NaN)."""
        return float(np.isnan(self.heights_um).mean())

    def with_heights(self, heights_um: np.ndarray) -> HeightMap:
        """Return other heights on the same grid; the mask of filled points stays where the shape does."""
        filled = self.filled if np.shape(heights_um) == self.shape else None
        return replace(self, heights_um=heights_um, filled=filled)

    def same_grid(self, other: HeightMap) -> bool:
        """Tell whether two maps lie on the same grid (pitch to 1e-6 of itself)."""
        return self.shape == other.shape and bool(
            np.allclose((self.dx_um, self.dy_um), (other.dx_um, other.dy_um), rtol=1e-6, atol=0)
        )

    def __repr__(self) -> str:
        return f"HeightMap({self.summary()}, heights {self.height_reference})"

    def summary(self) -> str:
        """Say size, pitch, field, z range and missing fraction in one line."""
        rows, cols = self.shape
        width, depth = self.size_um
        known = self.heights_um[~np.isnan(self.heights_um)]
        span = f"z {known.min():.4g} to {known.max():.4g} µm" if known.size else "z: no measured point"
        return (
            f"{cols} x {rows} px, pitch {self.dx_um:.6g} x {self.dy_um:.6g} µm, field {width:.5g} x {depth:.5g} µm, "
            f"{span}, missing {100 * self.missing_fraction:.3g} %"
        )


def require_same_grid(first: HeightMap, second: HeightMap, names: tuple[str, str]) -> None:
    """Refuse two maps that do not lie on the same grid, naming both.

    Raises
    ------
    InputError
        Shape or pitch differ.
    """
    if not first.same_grid(second):
        a, b = (f"{m.shape[1]} x {m.shape[0]} px at {m.dx_um:.6g} x {m.dy_um:.6g} µm" for m in (first, second))
        raise InputError(
            f"{b}, but {names[0]} has {a}",
            where=names[1],
            key="grid",
            allowed="both maps must share shape and pitch (use align)",
        )
