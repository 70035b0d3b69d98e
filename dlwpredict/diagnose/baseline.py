"""The baseline: what the model without any further effect makes of the recordings, noise included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlwpredict.align.spikes import suspected_spikes
from dlwpredict.calibrate.descend import descend
from dlwpredict.calibrate.fast import fast
from dlwpredict.calibrate.loss import scale_um
from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.calibrate.trace import Trace, trace
from dlwpredict.diagnose.evidence import Whitened
from dlwpredict.diagnose.fit import Fit, bare, doubled, valleys
from dlwpredict.diagnose.freeform import smooth_forms
from dlwpredict.diagnose.noise_fit import GRAINS_PX, SMOOTHNESSES, NoiseEstimate, estimate
from dlwpredict.flat import Free
from dlwpredict.heightmap import HeightMap
from dlwpredict.model.levels import Levels
from dlwpredict.noise import Noise
from dlwpredict.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict, run
from dlwpredict.smoothing import block_mean
from dlwpredict.uneven import Uneven

GAIN = 1e-3
"""The descent with free shifts ends when the next step promises less than this share of the cost."""

ALIKE = 1e-6
"""Share of the largest energy below which a direction is dropped."""


def calibrated(recordings: Sequence[Recording], free: Free, seed: int) -> Point:
    """Fit by robust least squares, then once more with lateral shifts free: the start of the likelihood."""
    problem = Problem(tuple(recordings), free)
    start = problem.at(free.start)
    problem = problem.with_loss_scaled(start, robust=True)
    point = fast(problem, problem.compared(start.vector, start.traces), seed=seed, gain=GAIN)
    problem = problem.with_loss_scaled(point, robust=True).with_free_shift(point)
    return descend(problem, problem.compared(point.vector, point.traces), gain=GAIN, iterations=10)


def without_spikes(recordings: Sequence[Recording], free: Free, point: Point) -> tuple[tuple[Recording, ...], Point]:
    """Leave out lone points that stand out of the residual; return the recordings and the point compared with them."""
    kept = []
    for recording, predicted in zip(recordings, point.traces, strict=True):
        residual = np.where(recording.used, recording.measured.heights_um - predicted.heights_um, 0.0)
        used = recording.used & ~suspected_spikes(residual, recording.used)
        kept.append(bare(replace(recording, used=used)))
    return tuple(kept), Problem(tuple(kept), free).compared(point.vector, point.traces)


def likely(recordings: Sequence[Recording], free: Free, point: Point, workers: Workers = ALONE) -> list[Fit]:
    """Fit by likelihood as if the noise were white, in every valley; the lowest comes first.

    Calibration knows no prior of the widths, and a focus that the data leave open may end at 10 µm: derivatives and
    signatures there are not those of the process.
    """
    changes, data = discretisations_um(recordings, free.parameters(point.vector), point.traces, workers), []
    for recording, residual, change in zip(recordings, point.residuals, changes, strict=True):
        grid = recording.target
        white = Noise(scale_um(residual), 0.0, grid.dx_um, grid.dx_um, grid.dy_um)
        data.append(Whitened.of(recording, Uneven(white), change))
    return valleys(data, free, doubled(free, point.vector), workers)


def noises(
    recordings: Sequence[Recording],
    residuals_um: Sequence[np.ndarray],
    designs: Sequence[np.ndarray],
    repeats: Sequence[Sequence[HeightMap]],
    like: Sequence[NoiseEstimate] | None = None,
    slopes: Sequence[np.ndarray] | None = None,
    seed: int = 0,
    workers: Workers = ALONE,
) -> list[NoiseEstimate]:
    """Estimate every recording's noise: from its repeats where there are any, else from the residual.

    Parameters
    ----------
    recordings : sequence of Recording
    residuals_um : sequence of numpy.ndarray, shape (rows, cols)
        Recording − prediction, 0 where a point does not count.
    designs : sequence of numpy.ndarray, shape (columns, rows, cols)
        What may be in the residual besides noise: derivatives, signatures of named effects, smooth forms.
    repeats : sequence of sequence of HeightMap
        Further recordings of the same print, on the same grid, for each recording; may be empty.
    like : sequence of NoiseEstimate, optional
        Earlier estimates, whose kind of correlation and grain are kept.
    slopes : sequence of numpy.ndarray, shape (rows, cols), optional
        |∇f| of each recording, on which its noise may hang.
    seed : int
        Of the drawn noise.
    workers : Workers
    """
    kinds = [_kinds(known.model.even) for known in like] if like else [(SMOOTHNESSES, GRAINS_PX)] * len(recordings)
    jobs = []
    for recording, residual, design, others, kind, slope in zip(
        recordings, residuals_um, designs, repeats, kinds, slopes or [0.0] * len(recordings), strict=True
    ):
        used, pitch, source = recording.used, (recording.target.dx_um, recording.target.dy_um), "residual"
        if others:
            difference = (recording.measured.heights_um - others[0].heights_um) / np.sqrt(2)
            used, source = used & np.isfinite(difference), "repeats"
            residual, design = np.where(used, difference, 0.0), smooth_forms(recording.target)
        jobs.append((residual, used, pitch, design, kind, slope, source, seed + len(jobs)))
    return workers.each(_noise, jobs)


def _kinds(known: Noise) -> tuple[tuple[float], tuple[float]]:
    """Return the smoothness and the grain (pixels) of a noise that is known."""
    return (known.smoothness,), (known.grain_um / known.pitch_um,)


def _noise(
    residual_um: np.ndarray,
    used: np.ndarray,
    pitch_um: tuple[float, float],
    design: np.ndarray,
    kinds: tuple[Sequence[float], Sequence[float]],
    slope: np.ndarray | float,
    source: str,
    seed: int,
) -> NoiseEstimate:
    forms = compressed(design, used)
    return estimate(residual_um, used, pitch_um, forms, *kinds, slope=slope, source=source, seed=seed)


def compressed(columns: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return an orthogonal set of the same span, without what is nearly a combination of the others.

    Parameters
    ----------
    columns : numpy.ndarray, shape (columns, rows, cols)
    used : numpy.ndarray of bool, shape (rows, cols)
    """
    values = columns[:, used].T
    sizes = np.linalg.norm(values, axis=0)
    values = values[:, sizes > 0] / sizes[sizes > 0]
    energies, vectors = np.linalg.eigh(values.T @ values)
    real = energies > ALIKE * energies[-1]
    maps = np.zeros((int(real.sum()), *used.shape))
    maps[:, used] = ((values @ vectors[:, real]) / np.sqrt(energies[real])).T * np.sqrt(used.sum())
    return maps


def discretisation_um(
    recording: Recording, parameters: ParameterSet, predicted_um: np.ndarray | None = None
) -> np.ndarray:
    """Return what the prediction changes on pixels of half the size, µm, shape (rows, cols).

    Two honest discretisations of the same physics differ by this much; it is free in every fit, within its prior.

    Parameters
    ----------
    recording : Recording
    parameters : ParameterSet
    predicted_um : numpy.ndarray, shape (rows, cols), optional
        The prediction on the recording's own pixels, where it is known.
    """
    if predicted_um is None:
        predicted_um = predict(recording.target, parameters, as_measured=True).heights_um
    return np.nan_to_num(finer(recording, parameters)[0] - predicted_um)


def discretisations_um(
    recordings: Sequence[Recording], parameters: ParameterSet, known: Sequence[Trace], workers: Workers = ALONE
) -> list[np.ndarray]:
    """Return the same of every recording, its prediction on its own pixels being known."""
    jobs = [(recording, parameters, t.heights_um) for recording, t in zip(recordings, known, strict=True)]
    return workers.each(discretisation_um, jobs)


def finer(recording: Recording, parameters: ParameterSet, known: Trace | None = None) -> tuple[np.ndarray, Trace]:
    """Predict a recording from its print on pixels of half the size.

    The print has no pixels, the recording has: its effects act on the recording's own.

    Parameters
    ----------
    recording : Recording
    parameters : ParameterSet
    known : Trace, optional
        An earlier one's print.

    Returns
    -------
    numpy.ndarray, shape (rows, cols)
        What an instrument would show, µm.
    Trace
        Of the print.
    """
    target = recording.target
    fine = HeightMap(np.kron(target.heights_um, np.ones((2, 2))), target.dx_um / 2, target.dy_um / 2)
    seen = [effect for effect in parameters.effects if effect.stage == "recording"]
    written = tuple(effect for effect in parameters.effects if effect.stage != "recording")
    printed = trace(fine, replace(parameters, effects=written), Levels(), known)
    return run(seen, target.with_heights(block_mean(printed.heights_um, (2, 2)))).heights_um, printed
