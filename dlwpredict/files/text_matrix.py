"""Lines of text to a matrix: delimiter, decimal comma, spellings of "not measured", axes around the heights."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from dlwpredict.errors import InputError

_BLANKS_BETWEEN = re.compile(r"[^\s,]\s+[^\s,]")  # blanks that do not just follow a comma
_FEWEST = 3  # points on an axis that make an even spacing worth noticing


def matrix_of(lines: list[tuple[int, str]]) -> tuple[np.ndarray, InputError | None]:
    """Return the matrix of numbered lines, and what stood in its first cell if that was no number.

    A label in the first cell is only allowed where axes surround the heights; `without_axes` decides.

    Raises
    ------
    InputError
        A row of another length, or a cell that is no number.

    Examples
    --------
    >>> matrix_of([(1, "1,5;BAD;"), (2, "2;2,5;")])[0]
    array([[1.5, nan],
           [2. , 2.5]])
    """
    delimiter = delimiter_of(lines[0][1])
    texts = [line for _, line in lines]
    if delimiter is not None:
        texts = [line.strip(" ") for line in texts]
        if all(line.endswith(delimiter) for line in texts):  # an empty last column
            texts = [line[:-1] for line in texts]
    if delimiter != "," and any("," in line for line in texts):
        texts = [line.replace(",", ".") for line in texts]
    label: InputError | None = None
    rows: list[Any] = []
    for (number, _), text in zip(lines, texts, strict=True):
        cells = text.split(delimiter)
        if not rows:
            label, cells[0] = _label(cells[0], number)
        rows.append(_row(cells, number))
        if len(cells) != len(rows[0]):
            raise InputError(
                f"line {number} has {len(cells)} values, line {lines[0][0]} has {len(rows[0])}",
                key="rows",
                allowed="the same number in every line",
            )
    matrix = np.array(rows)
    if _lists_points(matrix):
        raise InputError(
            f"{len(matrix)} lines of x, y and z", key="numbers", allowed="a matrix of heights, a line for each row"
        )
    return matrix, label


def _lists_points(matrix: np.ndarray) -> bool:
    """Tell whether a matrix is a list of x, y, z: three columns, the first two of them places on a grid, each once.

    >>> _lists_points(np.array([[x, y, 0.5] for y in range(4) for x in range(3)]))
    True
    """
    if matrix.shape[1] != 3 or len(matrix) < _FEWEST**2:
        return False
    places = [len(np.unique(matrix[:, k])) for k in (0, 1)]
    return min(places) > 1 and places[0] * places[1] == len(matrix) == len(np.unique(matrix[:, :2], axis=0))


def delimiter_of(line: str) -> str | None:
    r"""Return what stands between the numbers of a line; None = blanks.

    >>> [delimiter_of(line) for line in ("1\t2", "1,5;2,5", "1, 2", "1,5 2,5", "1 2")]
    ['\t', ';', ',', None, None]
    """
    for delimiter in "\t;":
        if delimiter in line:
            return delimiter
    return "," if "," in line and not _BLANKS_BETWEEN.search(line.strip()) else None


def without_axes(matrix: np.ndarray, label: InputError | None) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Split off a first row x and a first column y, if there are any; their even spacing is the pitch, µm.

    Axes are evenly spaced, and the row after the first does not go on with the same spacing (a tilted plane does).
    Rows are kept in their order whichever way y runs.

    Raises
    ------
    InputError
        x falls from left to right (a mirrored map), or a label in the first cell without axes.
    """
    across, down = _step(matrix[0, 1:]), _step(matrix[1:, 0])
    if across is None or down is None or np.isclose(_step(matrix[1, 1:]) or 0.0, across, rtol=0.01):
        if label is not None:
            raise label
        return matrix, None
    if across < 0:
        raise InputError("x falls from left to right", key="x", allowed="allowed: rising, or the map is mirrored")
    return matrix[1:, 1:], (across, abs(down))


def _step(axis: np.ndarray) -> float | None:
    """Return the spacing of evenly spaced numbers (to a hundredth of it, as printed digits allow), else None."""
    if axis.size < _FEWEST or not np.isfinite(axis).all():
        return None
    step = (axis[-1] - axis[0]) / (axis.size - 1)
    even = np.abs(np.diff(axis) - step).max() <= 0.01 * abs(step)
    return float(step) if step and even else None


def _label(cell: str, line: int) -> tuple[InputError | None, str]:
    """Set aside a first cell that is no number."""
    try:
        _value(cell, line, 1)
    except InputError as error:
        return error, ""
    return None, cell


def _row(cells: list[str], line: int) -> np.ndarray:
    try:
        if "_" not in "".join(cells):  # Python would read 1_0 as 10
            return np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        pass
    return np.array([_value(cell, line, column) for column, cell in enumerate(cells, 1)])


def _value(cell: str, line: int, column: int) -> float:
    text = cell.strip()
    if text.lower() in ("", "bad") or not text.strip("*"):
        return math.nan
    try:
        return float(text.replace("_", "?"))
    except ValueError:
        raise InputError(
            f"found {text[:30]!r} in line {line}, column {column}",
            key="numbers",
            allowed="numbers, nan, BAD, ***, empty",
        ) from None
