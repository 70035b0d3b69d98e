"""The pose to a small fraction of a pixel: robust Gauss-Newton against everything the print may look like."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import ndimage

from dlwpredict.alignment.likeness import likeness_columns
from dlwpredict.alignment.plane import mad_sigma
from dlwpredict.alignment.pose import Distortion, Pose
from dlwpredict.alignment.surface import Surface, grid_um

SMOOTHING = 0.8  # σ in pixels of a level: what is sampled is then free of aliasing to 4 %
HUBER = 2.0
FLANK = 3  # points: what lies nearer to the outline belongs to it


@dataclass(frozen=True, eq=False)
class Level:
    """Recording and target on one pitch, both smoothed by the same Gaussian, σ in µm.

    `relief`: only what lies inside the outline counts, away from its flanks.
    """

    recording: Surface
    target: Surface
    pitch_um: float
    smoothing_um: float
    relief: bool = False

    @classmethod
    def of(cls, recording: Surface, target: Surface, pitch_um: float) -> Level:
        """Smooth both maps for this pitch."""
        sigma = SMOOTHING * max(pitch_um, recording.dx_um / 2, recording.dy_um / 2)
        return cls(recording.smoothed(sigma), target.smoothed(sigma), pitch_um, sigma)

    @cached_property
    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y of the points, µm."""
        return grid_um(self.target.size_um, self.pitch_um)

    @cached_property
    def _sampled(self) -> tuple[np.ndarray, np.ndarray]:
        return self.target.at(*self.grid)

    @property
    def target_heights(self) -> np.ndarray:
        """Smoothed target on the grid, µm, shape (rows, cols)."""
        return self._sampled[0]

    @property
    def outline(self) -> np.ndarray:
        """Tell which points lie inside the target's outline, shape (rows, cols)."""
        within: np.ndarray = self.target_heights > 0.02 * self.target_heights.max()
        return within

    @cached_property
    def inside(self) -> np.ndarray:
        """Tell which points lie inside the target's outline, away from its flanks, shape (rows, cols)."""
        away: np.ndarray = ndimage.binary_erosion(self.outline, iterations=FLANK, border_value=0)
        return away

    @cached_property
    def columns(self) -> np.ndarray:
        """`likeness_columns` of the target, shape (points, columns)."""
        return likeness_columns(self._sampled[0])

    def read(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Recorded heights and their support at the target's points, flat."""
        heights, support = self.recording.at(*pose.to_recording(*self.grid))
        counts = (self._sampled[1] > 0.5) & (self.inside if self.relief else True)
        seen = np.where((support > 0.5) & counts, support, 0.0)
        return heights.ravel(), seen.ravel()


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose, how well it explains the recording, and what its figures are worth.

    Parameters
    ----------
    pose : Pose
    residual, weights, fitted : numpy.ndarray, shape (points,)
        Recording − likeness (µm), robust weight, likeness (µm).
    jacobian : numpy.ndarray, shape (points, parameters)
        Derivative of the likeness by the parameters of `Pose.moved`, what the likeness can mimic taken out.
    level : Level
    directions : numpy.ndarray, shape (parameters, free)
        Orthonormal; those in which the pose was free, parameters in units of `parameter_scale`.
    """

    pose: Pose
    residual: np.ndarray
    weights: np.ndarray
    fitted: np.ndarray
    jacobian: np.ndarray = field(repr=False)
    level: Level = field(repr=False)
    directions: np.ndarray = field(repr=False)

    @property
    def scale(self) -> np.ndarray:
        """What the columns of `directions` are in the parameters of `Pose.moved`, shape (parameters, free)."""
        sizes: np.ndarray = parameter_scale(len(self.directions), self.pose.reach_um)
        return sizes[:, None] * self.directions

    def beside(self, change: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return what of a change of the recording (points,) neither the likeness nor a shift takes up."""
        others = np.column_stack([self.level.columns, self.jacobian[:, :2]])
        return change - others @ _solved(others, weights, change)

    @property
    def correlation(self) -> float:
        """Multiple correlation of recording and likeness beyond a plane, 0 to 1."""
        use = self.weights > 0
        plane = self.level.columns[use][:, :3]
        heights = (self.fitted + self.residual)[use]
        beyond = heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
        w = self.weights[use]
        share = np.sum(w * self.residual[use] ** 2) / max(np.sum(w * beyond**2), 1e-300)
        return float(np.sqrt(max(1 - share, 0.0)))


def refine(
    level: Level, pose: Pose, distortion: Distortion, directions: np.ndarray | None = None, *, turns: int = 12
) -> Fit:
    """Improve a pose by iterated weighted least squares on one level, in all directions of a distortion or in some.

    recording(q(p)) = Σ c_k φ_k(p), with the pose in q and the φ of `likeness_columns`. The step δ solves the joint
    linear problem [φ, −∇m·∂q/∂θ]·(c, δ) = recording, m = φ·c. The gradient is that of the fitted likeness, not of
    the noisy recording, so noise does not bias the solution. Huber weights; steps are kept below one pixel of the
    level.
    """
    floor = 0.0
    for _ in range(turns):
        fit = _linear(level, pose, distortion, directions, floor)
        step, size = _step(fit)
        floor = 0.3 * float(np.sqrt(np.average(fit.residual**2, weights=fit.weights + 1e-12)))
        pose = pose.moved(step)
        if size < 2e-3:
            break
    return _linear(level, pose, distortion, directions, floor)


def _linear(level: Level, pose: Pose, distortion: Distortion, directions: np.ndarray | None, floor: float) -> Fit:
    """Fit the likeness at a fixed pose and form the derivatives there."""
    heights, support = level.read(pose)
    weights, columns = support, level.columns
    for _ in range(2):
        fitted = columns @ _solved(columns, weights, heights)
        residual = heights - fitted
        sigma = max(mad_sigma(residual[support > 0]), floor, 1e-9)
        weights = support / np.maximum(1, np.abs(residual) / (HUBER * sigma))
    jacobian = changed(level, pose, fitted, distortion)
    mimic = columns @ _solved(columns, weights, jacobian)
    free = np.eye(jacobian.shape[1]) if directions is None else directions
    return Fit(pose, residual, weights, fitted, jacobian - mimic, level, free)


def _solved(columns: np.ndarray, weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the coefficients of columns in a weighted fit to values (points, ...); what is blind stays near 0."""
    weighted = columns * weights[:, None]
    normal = columns.T @ weighted
    normal[np.diag_indices_from(normal)] *= 1 + 1e-9
    normal[np.diag_indices_from(normal)] += 1e-9 * weights.sum()
    return np.linalg.solve(normal, weighted.T @ values)


def slopes(level: Level, pose: Pose, fitted: np.ndarray) -> np.ndarray:
    """Return ∇_q m = A⁻ᵀ∇_p m of a likeness, over the recording, shape (2, points)."""
    down, right = np.gradient(fitted.reshape(level.grid[0].shape), level.pitch_um)
    return np.linalg.inv(np.array(pose.matrix)).T @ np.stack([right.ravel(), -down.ravel()])


def changed(level: Level, pose: Pose, fitted: np.ndarray, distortion: Distortion) -> np.ndarray:
    """Return the derivatives of a likeness by the parameters of `Pose.moved`, shape (points, parameters)."""
    x, y = level.grid
    moves = pose.jacobian(x.ravel(), y.ravel(), distortion)
    return np.einsum("dp,kdp->pk", slopes(level, pose, fitted), moves)


def _step(fit: Fit) -> tuple[np.ndarray, float]:
    """Gauss-Newton step and how far it moves the target's points at most, in pixels of the level."""
    scale = fit.scale * fit.level.pitch_um
    jacobian = fit.jacobian @ scale
    normal = jacobian.T @ (jacobian * fit.weights[:, None])
    values, vectors = np.linalg.eigh(normal)
    known = values > 1e-7 * values[-1]
    along = vectors.T @ (jacobian.T @ (fit.weights * fit.residual))
    # residual = recording − m and ∂recording/∂θ = J: the step that takes the residual away is −J⁺·residual
    step = -vectors @ np.where(known, along / np.where(known, values, 1.0), 0.0)
    size = float(np.abs(step).max())
    return scale @ step / max(size, 1.0), size


def parameter_scale(count: int, reach_um: tuple[float, float]) -> np.ndarray:
    """Return the size of each of so many parameters of `Pose.moved` that moves the target's rim by 1 µm."""
    turn = 1 / max(reach_um)
    return np.array([1, 1, *[turn] * 4, *[1] * 8])[:count] if count > 3 else np.array([1, 1, turn])[:count]
