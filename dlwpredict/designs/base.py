"""What all designs share: the square footprint, the declared options, the substrate margin and the list of kinds."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Protocol, cast, get_args

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Declaration, check_range

Shape = Callable[..., np.ndarray]


class Design(Protocol):
    """A kind of target: called with its options, which its signature declares."""

    meaning: str
    __signature__: inspect.Signature

    def __call__(self, **options: Any) -> HeightMap:
        """Make the target."""


KINDS: dict[str, Design] = {}
MOST_POINTS = 25_000_000


def um(low: float, high: float, meaning: str) -> Declaration:
    """Declare an option that is a length in µm."""
    return Declaration("µm", low, high, meaning)


def number(low: float, high: float, meaning: str) -> Declaration:
    """Declare an option without a unit: a count, a fraction, a seed; a switch ranges over 0 to 1."""
    return Declaration("1", low, high, meaning)


Relief = Annotated[float, um(0.0, 500.0, "range of the relief, lowest to highest point")]
Base = Annotated[float, um(0.0, 500.0, "height of the solid block under the relief: its lowest point")]


def common(
    *,
    size_um: Annotated[float, um(0.1, 10_000.0, "side of the square footprint, rounded to whole pixels")],
    pitch_um: Annotated[float, um(0.001, 100.0, "pixel pitch")] = 0.2,
    pitch_y_um: Annotated[float | None, um(0.001, 100.0, "pitch along y where it differs from pitch_um")] = None,
    margin_um: Annotated[float, um(0.0, 1000.0, "bare substrate around the part, rounded to whole pixels")] = 10.0,
) -> None:
    """Hold the options of every kind; only the signature is used."""


@dataclass(frozen=True)
class Footprint:
    """The square on which a part stands, as pixel centres counted from its own centre, y up.

    Parameters
    ----------
    rows, cols : int
    dx_um, dy_um : float
        Pitch, µm.
    """

    rows: int
    cols: int
    dx_um: float
    dy_um: float

    @property
    def x_um(self) -> np.ndarray:
        """Every column's x, µm, shape (1, cols)."""
        return ((np.arange(self.cols) - (self.cols - 1) / 2) * self.dx_um)[None, :]

    @property
    def y_um(self) -> np.ndarray:
        """Every row's y, upwards, µm, shape (rows, 1)."""
        return (((self.rows - 1) / 2 - np.arange(self.rows)) * self.dy_um)[:, None]

    @property
    def radius_um(self) -> np.ndarray:
        """Distance from the centre, µm, shape (rows, cols)."""
        return np.hypot(self.x_um, self.y_um)

    @property
    def width_um(self) -> float:
        """Side along x after rounding, µm."""
        return self.cols * self.dx_um

    @property
    def depth_um(self) -> float:
        """Side along y after rounding, µm."""
        return self.rows * self.dy_um

    @property
    def side_um(self) -> float:
        """Shorter side after rounding, µm."""
        return min(self.width_um, self.depth_um)

    def cells(self, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Cut the footprint into equal cells; return which cell each pixel lies in, and where in it.

        Returns
        -------
        column, row : numpy.ndarray of int, shapes (1, cols) and (rows, 1)
            Counted from the left and from the bottom.
        across_um, along_um : numpy.ndarray, shapes (1, cols) and (rows, 1)
            x and y from the cell's centre, µm.
        """
        column, across_um = cell_of(self.x_um, columns, self.width_um)
        row, along_um = cell_of(self.y_um, rows, self.depth_um)
        return column, row, across_um, along_um

    def along_um(self, angle_deg: float) -> np.ndarray:
        """Return the coordinate along a direction, counter-clockwise from x, µm, shape (rows, cols)."""
        angle = np.deg2rad(angle_deg)
        return self.x_um * np.cos(angle) + self.y_um * np.sin(angle)

    def require_resolved(self, name: str, length_um: float) -> None:
        """Refuse a length of the relief shorter than two pixels.

        Raises
        ------
        InputError
            Named after the option that sets the length.
        """
        pitch = max(self.dx_um, self.dy_um)
        if length_um < 2 * pitch * (1 - 1e-9):
            raise InputError(
                f"{length_um:.4g} µm is too fine for a pitch of {pitch:g} µm",
                key=name,
                allowed=f"allowed: at least two pixels, {2 * pitch:g} µm",
            )


def cell_of(x_um: np.ndarray, count: int, size_um: float) -> tuple[np.ndarray, np.ndarray]:
    """Return each coordinate's cell, 0 to count − 1 upwards, and the coordinate from that cell's centre, µm."""
    index = np.clip(np.floor(np.round(count * (x_um / size_um + 0.5), 9)).astype(int), 0, count - 1)
    return index, x_um - (index - (count - 1) / 2) * size_um / count


def inside(distance_um: np.ndarray, half_width_um: np.ndarray | float) -> np.ndarray:
    """Tell which pixel centres lie inside; a centre on the edge counts as outside on every side alike."""
    return distance_um < half_width_um - 1e-9


def rows_and_cols(size_um: float, margin_um: float, dx_um: float, dy_um: float) -> tuple[Footprint, tuple[int, int]]:
    """Round footprint and margin to whole pixels.

    Raises
    ------
    InputError
        Fewer than 2 x 2 or more than 25 million points.
    """
    footprint = Footprint(round(size_um / dy_um), round(size_um / dx_um), dx_um, dy_um)
    margin = round(margin_um / dy_um), round(margin_um / dx_um)
    if min(footprint.rows, footprint.cols) < 2:
        raise InputError(
            f"{size_um:g} µm at a pitch of {dx_um:g} x {dy_um:g} µm", key="size_um", allowed="at least 2 x 2 pixels"
        )
    points = (footprint.rows + 2 * margin[0]) * (footprint.cols + 2 * margin[1])
    if points > MOST_POINTS:
        raise InputError(f"{points} pixels", key="pitch_um", allowed=f"allowed: at most {MOST_POINTS} pixels")
    return footprint, margin


def design(meaning: str, *, size_um: float) -> Callable[[Shape], Design]:
    """Turn a formula on a `Footprint` into a design: options checked, margin added, entered in `KINDS`.

    Parameters
    ----------
    meaning : str
        One line for the list of kinds.
    size_um : float
        Default side of the footprint, µm.
    """

    def enter(shape: Shape) -> Design:
        special = list(inspect.signature(shape, eval_str=True).parameters.values())[1:]
        shared = list(inspect.signature(common, eval_str=True).parameters.values())
        shared[0] = shared[0].replace(default=size_um)
        signature = inspect.Signature(shared + special, return_annotation=HeightMap)

        @functools.wraps(shape)
        def make(**options: Any) -> HeightMap:
            bound = signature.bind(**options)
            bound.apply_defaults()
            values = bound.arguments
            for name, declaration in options_of(kind).items():
                if values[name] is not None:
                    check_range(name, values[name], declaration)
            dx_um, dy_um = values["pitch_um"], values["pitch_y_um"] or values["pitch_um"]
            footprint, margin = rows_and_cols(values["size_um"], values["margin_um"], dx_um, dy_um)
            heights = shape(footprint, **{option.name: values[option.name] for option in special})
            return HeightMap(np.pad(heights, ((margin[0],) * 2, (margin[1],) * 2)), dx_um, dy_um)

        kind = cast(Design, make)
        kind.__signature__ = signature
        kind.meaning = meaning
        name = shape.__name__.replace("_", "-")
        if name in KINDS:
            raise TypeError(f"two designs are called {name}")
        KINDS[name] = kind
        return kind

    return enter


def options_of(make: Design) -> dict[str, Declaration]:
    """Return what is declared of each option of a kind, in order; the default stands in its signature."""
    return {option.name: get_args(option.annotation)[1] for option in inspect.signature(make).parameters.values()}
