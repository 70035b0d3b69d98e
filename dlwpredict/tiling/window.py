"""A window into a large map: a height map that knows where it lies."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from dlwpredict.heightmap import HeightMap


@dataclass(frozen=True, eq=False)
class Window(HeightMap):
    """Part of a larger map; its coordinates count from the centre of the whole.

    Parameters
    ----------
    centre_x_um, centre_y_um : float
        Where the window's own centre lies, from the centre of the whole map, µm.
    """

    centre_x_um: float = 0.0
    centre_y_um: float = 0.0

    @property
    def x_um(self) -> np.ndarray:
        """X of every column from the centre of the whole map, µm, shape (cols,)."""
        return super().x_um + self.centre_x_um

    @property
    def y_um(self) -> np.ndarray:
        """Y of every row from the centre of the whole map, upwards, µm, shape (rows,)."""
        return super().y_um + self.centre_y_um


@dataclass(frozen=True)
class Tile:
    """A rectangle of pixels: rows first_row … last_row − 1, columns first_col … last_col − 1."""

    first_row: int
    last_row: int
    first_col: int
    last_col: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.last_row - self.first_row, self.last_col - self.first_col

    @property
    def slices(self) -> tuple[slice, slice]:
        """The tile as an index of the whole map."""
        return slice(self.first_row, self.last_row), slice(self.first_col, self.last_col)

    def grown(self, halo_px: tuple[int, int], shape: tuple[int, int], grid_px: tuple[int, int] = (1, 1)) -> Tile:
        """Return the tile with a halo of (rows, cols) on every side, as far as the whole map of this shape goes.

        It begins at a multiple of `grid_px`, so its halo may be wider there.
        """
        (down, across), (rows, cols), (every_row, every_col) = halo_px, shape, grid_px
        return Tile(
            max(self.first_row - down, 0) // every_row * every_row,
            min(self.last_row + down, rows),
            max(self.first_col - across, 0) // every_col * every_col,
            min(self.last_col + across, cols),
        )

    def common(self, other: Tile) -> Tile:
        """Return what both share; a side of it is not positive where they share nothing."""
        return Tile(
            max(self.first_row, other.first_row),
            min(self.last_row, other.last_row),
            max(self.first_col, other.first_col),
            min(self.last_col, other.last_col),
        )

    def within(self, outer: Tile) -> tuple[slice, slice]:
        """Return this tile as an index of an array that holds the outer one."""
        top, left = outer.first_row, outer.first_col
        return slice(self.first_row - top, self.last_row - top), slice(self.first_col - left, self.last_col - left)

    def window(self, heights_um: np.ndarray, dx_um: float, dy_um: float, shape: tuple[int, int]) -> Window:
        """Return heights over this tile as a window into a map of this shape."""
        rows, cols = shape
        return Window(
            heights_um,
            dx_um,
            dy_um,
            centre_x_um=(self.first_col + self.last_col - cols) / 2 * dx_um,
            centre_y_um=(rows - self.first_row - self.last_row) / 2 * dy_um,
        )


def tiles(shape: tuple[int, int], side_px: int) -> list[Tile]:
    """Cut a map of this shape into tiles of at most this many pixels a side, as equal as whole pixels allow.

    Examples
    --------
    >>> [tile.shape for tile in tiles((5, 3), 4)]
    [(2, 3), (3, 3)]
    """
    cuts = []
    for size in shape:
        ends = np.linspace(0, size, -(-size // side_px) + 1).astype(int).tolist()
        cuts.append(list(pairwise(ends)))
    return [Tile(*rows, *cols) for rows, cols in product(*cuts)]
