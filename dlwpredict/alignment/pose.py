"""Where a target lies in a recording: shift, rotation, scale, shear, a quadratic bow, and a cubic along each axis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

Distortion = Literal["shift", "rigid", "affine", "bow", "cubic"]  # "shift" inside only: a round part has no rotation
Wanted = Literal["auto", "rigid", "affine", "bow", "cubic"]

CUBIC = np.polynomial.legendre.Legendre([0, 0, 0, 1])
"""(5·w³ − 3·w)/2: 1 at the rim, and nothing of it is a scale."""


def rotation_matrix(rotation_deg: float) -> np.ndarray:
    """Matrix of a counter-clockwise rotation (x right, y up), shape (2, 2).

    Examples
    --------
    >>> (rotation_matrix(90) @ [1, 0]).round(12).tolist()
    [0.0, 1.0]
    """
    cosine, sine = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
    return np.array([[cosine, -sine], [sine, cosine]])


@dataclass(frozen=True)
class Pose:
    """Map from the target to the recording, both counted from their centres in µm, x right, y up.

    q = shift + A·p + B·(u², u·v, v²) + (c_x·P₃(w_x), c_y·P₃(w_y)),  u = p_x / reach_x, v = p_y / reach_y,

    A = R(rotation)·[[1, shear], [0, 1]]·diag(scale). The bow B (2 × 3, µm) is what a quadratic distortion adds
    at the rim of the target, half its width from the centre. The cubic (c, µm) is what an axis of the instrument whose
    displacement is not linear adds there: P₃ is Legendre's polynomial, w = A·p over half the turned target's width.

    Parameters
    ----------
    shift_um : tuple of float
        Where the target's centre lies in the recording, µm.
    matrix : tuple of tuple of float
        The matrix A.
    bow_um : tuple of tuple of float
        The matrix B: one row for x, one for y, columns xx, xy, yy, µm.
    cubic_um : tuple of float
        c along the recording's x and y, µm.
    reach_um : tuple of float
        Half the target's width and height, µm.
    mirrored : bool
        The recording was turned back (its columns reversed) before the pose was counted.
    """

    shift_um: tuple[float, float]
    matrix: tuple[tuple[float, float], tuple[float, float]]
    bow_um: tuple = ((0.0,) * 3,) * 2
    cubic_um: tuple[float, float] = (0.0, 0.0)
    reach_um: tuple[float, float] = (1.0, 1.0)
    mirrored: bool = False

    @classmethod
    def rigid(cls, shift_um, rotation_deg, *, reach_um=(1.0, 1.0), mirrored=False) -> Pose:
        """Make a pose of a shift and a rotation only."""
        return cls(tuple(shift_um), _rows(rotation_matrix(rotation_deg)), reach_um=reach_um, mirrored=mirrored)

    @cached_property
    def rotation_deg(self) -> float:
        """Counter-clockwise rotation in (−180°, 180°]."""
        (a, _), (c, _) = self.matrix
        return float(np.degrees(np.arctan2(c, a)))

    @property
    def _upright(self) -> np.ndarray:
        return rotation_matrix(-self.rotation_deg) @ np.array(self.matrix)

    @property
    def scale(self) -> tuple[float, float]:
        """Recording length per target length along the target's x and y."""
        upright = self._upright
        return float(upright[0, 0]), float(upright[1, 1])

    @property
    def shear(self) -> float:
        """Shear: x moves by this much of y (rad)."""
        upright = self._upright
        return float(upright[0, 1] / upright[1, 1])

    def to_recording(self, x_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where target points lie in the recording, µm.

        Examples
        --------
        >>> x, y = Pose.rigid((10.0, 0.0), 90.0).to_recording(np.array([1.0]), np.array([0.0]))
        >>> round(float(x[0]), 9), round(float(y[0]), 9)
        (10.0, 1.0)
        """
        u, v = x_um / self.reach_um[0], y_um / self.reach_um[1]
        cubic = self._cubic(x_um, y_um) if any(self.cubic_um) else (0.0, 0.0)
        return tuple(
            self.shift_um[i]
            + self.matrix[i][0] * x_um
            + self.matrix[i][1] * y_um
            + (self.bow_um[i][0] * u + self.bow_um[i][1] * v) * u
            + self.bow_um[i][2] * v * v
            + self.cubic_um[i] * cubic[i]
            for i in (0, 1)
        )

    def _cubic(self, x_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return P₃ along the recording's x and y, where target points lie."""
        reach = np.abs(rotation_matrix(self.rotation_deg)) @ np.array(self.reach_um)
        along = [(row[0] * x_um + row[1] * y_um) / half for row, half in zip(self.matrix, reach, strict=True)]
        return CUBIC(along[0]), CUBIC(along[1])

    def to_target(self, x_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where recording points lie in the target, µm (fixed-point iteration for what bends)."""
        inverse = np.linalg.inv(np.array(self.matrix))
        points = np.stack([np.asarray(x_um, float), np.asarray(y_um, float)])
        target = np.tensordot(inverse, points - _column(self.shift_um, points), 1)
        for _ in range(8):
            error = points - np.stack(self.to_recording(*target))
            target = target + np.tensordot(inverse, error, 1)
        return target[0], target[1]

    def jacobian(self, x_um: np.ndarray, y_um: np.ndarray, distortion: Distortion) -> np.ndarray:
        """Derivatives of the recording position by the parameters of `moved`, shape (parameters, 2, points)."""
        ones, zeros = np.ones_like(x_um), np.zeros_like(x_um)
        (a, b), (c, d) = self.matrix
        columns = [(ones, zeros), (zeros, ones)]
        if distortion == "shift":
            return np.array(columns)
        if distortion == "rigid":
            columns.append((-(c * x_um + d * y_um), a * x_um + b * y_um))
        else:
            columns += [(x_um, zeros), (y_um, zeros), (zeros, x_um), (zeros, y_um)]
        if distortion in ("bow", "cubic"):
            u, v = x_um / self.reach_um[0], y_um / self.reach_um[1]
            terms = (u * u, u * v, v * v)
            columns += [(term, zeros) for term in terms] + [(zeros, term) for term in terms]
        if distortion == "cubic":
            along_x, along_y = self._cubic(x_um, y_um)
            columns += [(along_x, zeros), (zeros, along_y)]
        return np.array(columns)

    def moved(self, step: np.ndarray) -> Pose:
        """Return the pose after a step.

        2 parameters (shift), 3 (rigid), 6 (affine: shift, A), 12 (bow: + B) or 14 (cubic: + c).
        """
        matrix, bow, cubic = np.array(self.matrix), np.array(self.bow_um), np.array(self.cubic_um)
        if len(step) == 3:
            matrix = rotation_matrix(np.degrees(step[2])) @ matrix
        elif len(step) > 3:
            matrix = matrix + np.reshape(step[2:6], (2, 2))
            if len(step) >= 12:
                bow = bow + np.reshape(step[6:12], (2, 3))
            if len(step) == 14:
                cubic = cubic + step[12:]
        (x, y), (right, up) = self.shift_um, step[:2]
        shift = float(x + right), float(y + up)
        (third,) = _rows(cubic[None])
        return replace(self, shift_um=shift, matrix=_rows(matrix), bow_um=_rows(bow), cubic_um=third)

    def figures(self) -> np.ndarray:
        """Shift x, y; rotation (°); scale x, y; shear (mrad); bow; cubic (µm): 14 numbers for reports and tests."""
        bent = *np.ravel(self.bow_um), *self.cubic_um
        return np.array([*self.shift_um, self.rotation_deg, *self.scale, 1e3 * self.shear, *bent])


def _rows(matrix: np.ndarray) -> tuple:
    return tuple(tuple(float(value) for value in row) for row in matrix)


def _column(pair, like: np.ndarray) -> np.ndarray:
    return np.reshape(pair, (2, *(1,) * (like.ndim - 1)))
