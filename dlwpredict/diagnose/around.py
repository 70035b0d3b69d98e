"""What the prediction could change by, about the calibrated place, µm: computed once, before anything is whitened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.diagnose.baseline import discretisation_um
from dlwpredict.diagnose.candidates import Candidate, candidates, signatures
from dlwpredict.diagnose.evidence import gradient, steepness
from dlwpredict.diagnose.freeform import smooth_forms
from dlwpredict.flat import Free
from dlwpredict.parallel import ALONE, Workers


@dataclass(frozen=True, eq=False)
class Around:
    """Derivatives and signatures of every recording.

    Parameters
    ----------
    recordings : tuple of Recording
    free : Free
        The parameters of the baseline.
    point : Point
        The calibrated place.
    chosen : list of Candidate
    signatures_um : list (candidate) of list (recording) of numpy.ndarray, shape (rows, cols)
        Per typical size.
    discretisation_um : list of numpy.ndarray, shape (rows, cols)
    designs : list of numpy.ndarray, shape (columns, rows, cols)
        What a residual may hold besides noise.
    slopes : list of numpy.ndarray, shape (rows, cols)
        |∇f| of the predictions.
    """

    recordings: tuple[Recording, ...]
    free: Free
    point: Point
    chosen: list[Candidate]
    signatures_um: list[list[np.ndarray]]
    discretisation_um: list[np.ndarray]
    designs: list[np.ndarray]
    slopes: list[np.ndarray]

    @classmethod
    def of(cls, recordings: Sequence[Recording], free: Free, point: Point, workers: Workers = ALONE) -> Around:
        """Compute them."""
        parameters = free.parameters(point.vector)
        problem = Problem(tuple(recordings), free, numerics=point.traces[0].numerics)
        chosen = candidates(parameters)
        changes = signatures(chosen, recordings, parameters, point.traces, workers)
        fine = workers.each(discretisation_um, [(recording, parameters) for recording in recordings])
        derivatives = problem.derivatives(point)
        designs = []
        for k, recording in enumerate(recordings):
            grid, predicted = recording.target, point.traces[k].heights_um
            shifts = gradient(predicted, grid.dx_um, 1), gradient(predicted, grid.dy_um, 0)
            named = np.stack([maps[k] for maps in changes])
            designs.append(np.concatenate([smooth_forms(grid), derivatives[k], np.stack([*shifts, fine[k]]), named]))
        slopes = [steepness(t.heights_um, r.target) for t, r in zip(point.traces, recordings, strict=True)]
        return cls(tuple(recordings), free, point, chosen, changes, fine, designs, slopes)

    def residuals_um(self) -> list[np.ndarray]:
        """Return recording − prediction, 0 where a point does not count, shape (rows, cols) each."""
        pairs = zip(self.recordings, self.point.residuals, strict=True)
        return [recording.on_map(residual) for recording, residual in pairs]
