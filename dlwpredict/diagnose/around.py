"""What the prediction could change by, about the place where a fit is, µm: computed once, before noise is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnose.baseline import discretisations_um
from dlwpredict.diagnose.candidates import Candidate, candidates, signatures
from dlwpredict.diagnose.evidence import gradient, steepness
from dlwpredict.diagnose.fit import Fit, problem_of
from dlwpredict.diagnose.freeform import smooth_forms
from dlwpredict.parallel import ALONE, Workers


@dataclass(frozen=True, eq=False)
class Around:
    """Derivatives and signatures of every recording.

    Parameters
    ----------
    chosen : list of Candidate
    signatures_um : list (candidate) of list (recording) of numpy.ndarray, shape (rows, cols)
        Per typical size.
    discretisation_um : list of numpy.ndarray, shape (rows, cols)
    designs : list of numpy.ndarray, shape (columns, rows, cols)
        What a residual may hold besides noise.
    slopes : list of numpy.ndarray, shape (rows, cols)
        |∇f| of the predictions.
    """

    chosen: list[Candidate]
    signatures_um: list[list[np.ndarray]]
    discretisation_um: list[np.ndarray]
    designs: list[np.ndarray]
    slopes: list[np.ndarray]

    @classmethod
    def of(cls, fitted: Fit, workers: Workers = ALONE) -> Around:
        """Compute them where a fit is."""
        parameters, traces = fitted.parameters, fitted.point.traces
        recordings = [item.recording for item in fitted.data]
        chosen = candidates(parameters)
        changes = signatures(chosen, recordings, parameters, traces, workers)
        fine = discretisations_um(recordings, parameters, traces, workers)
        derivatives = problem_of(fitted.data, fitted.free).derivatives(fitted.point)
        designs, slopes = [], []
        for k, (recording, known) in enumerate(zip(recordings, traces, strict=True)):
            grid, predicted = recording.target, known.heights_um
            shifts = gradient(predicted, grid.dx_um, 1), gradient(predicted, grid.dy_um, 0)
            named = np.stack([maps[k] for maps in changes])
            designs.append(np.concatenate([smooth_forms(grid), derivatives[k], np.stack([*shifts, fine[k]]), named]))
            slopes.append(steepness(predicted, grid))
        return cls(chosen, changes, fine, designs, slopes)
