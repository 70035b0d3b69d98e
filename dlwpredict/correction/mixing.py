"""Anderson mixing: the next point of a fixed-point search, from its last steps."""

from __future__ import annotations

import numpy as np


class Anderson:
    """Combine the last steps so that their changes cancel the present one."""

    def __init__(self, memory: int) -> None:
        self.memory = memory
        self.points: list[np.ndarray] = []
        self.steps: list[np.ndarray] = []

    def next(self, point: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the next point from the present one and its step."""
        self.points = [*self.points, point][-self.memory - 1 :]
        self.steps = [*self.steps, step][-self.memory - 1 :]
        if len(self.steps) < 2 or self.memory == 0:
            return point + step
        d_steps = np.stack([(step - s).ravel() for s in self.steps[:-1]], axis=1)
        d_points = np.stack([(point - p).ravel() for p in self.points[:-1]], axis=1)
        gram = d_steps.T @ d_steps
        weights = np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ (d_steps.T @ step.ravel())
        return point + step - ((d_points + d_steps) @ weights).reshape(point.shape)
