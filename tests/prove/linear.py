"""What recordings could show at best: changes beside everything that a fit may move, with the noise known.

The only file of the proof, besides the baselines, that looks into the program under test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.effects.base import Effect
from dlwpredict.heightmap import HeightMap, Instrument
from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import Free, choose
from dlwpredict.infer.model import freed
from dlwpredict.infer.objective import Fit, Objective
from dlwpredict.infer.recording import doubted, prepare
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.lines import Lines
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import Paper, ParameterSet, Readings
from dlwpredict.process import predict

LIMIT_Z = 5.0
"""The detection limit: a change that stands this many standard deviations out of the noise after the seven parameters,
levelling and registration have been fitted to it. About a hundred candidates at 2.5 % family-wise need 3.7; 1.28 more
are found nine times in ten."""

NUMERICS_UM = 4e-4
"""Root mean square by which the press's own voxels are off beside what a fit moves (0.1 to 0.4 nm, from 3 to 5 parts of
a pixel and with thinner layers). What shows no more than that is not known to be there."""

REFITS, GAIN = 15, 0.05
"""Steps of a refit, at most; it ends before where a step promises less than this in −2 ln L."""

SMOOTHNESS = {"gaussian": (np.inf, np.sqrt(2)), "matern32": (1.5, 1.0), "exponential": (0.5, 1.0)}
"""The microscope's kinds of correlation in the program's words: smoothness, and factor on the length."""


def noise_model(noise: dict, grid: HeightMap) -> Noise:
    """Return the true noise of a recording."""
    smoothness, factor = SMOOTHNESS[noise["kind"]]
    length = factor * noise["correlation_um"]
    return Noise(noise["white_um"], noise["sigma_um"], length, grid.dx_um, grid.dy_um, smoothness)


def coarser(noise: dict, pitch_um: float, coarse_um: float) -> dict:
    """Return the noise on pixels that are means over squares of another side, of as many rows."""
    share = pitch_um / coarse_um
    row_um = noise.get("row_um", 0.0) * np.sqrt(share)
    return noise | {"white_um": noise["white_um"] * share, "row_um": float(row_um)}


def parameters_of(process: dict) -> ParameterSet:
    """Return the seven of a press, in the program's words; it prints pixels as squares."""
    paper = Paper(**{name.replace("focus_", "exposure_"): value for name, value in process.items()})
    return ParameterSet(paper=paper, readings=Readings(pixels="squares"))


def whitened(pairs: Sequence[tuple[HeightMap, HeightMap]], noise: dict) -> tuple[Whitened, ...]:
    """Return recordings in whitened space, every nuisance free, with the true noise, its lines along the rows."""
    found, rows = [], Lines(white_um=noise.get("row_um", 0.0))
    for target, measured in pairs:
        recording = doubted(prepare(target, measured))
        found.append(Whitened.of(recording, Uneven(noise_model(noise, target), rows=rows)))
    return tuple(found)


def placed(data: Sequence[Whitened], free: Free, vector: np.ndarray, near: Fit | None = None) -> Fit:
    """Predict recordings with given parameters: only nuisances are fitted, and there are derivatives."""
    objective = Objective(tuple(data))
    begun = replace(near, data=objective.data) if near else None
    return objective.differentiated(objective.at(free, free.allowed(vector), begun))


def fitted(
    data: Sequence[Whitened], free: Free, vector: np.ndarray, near: Fit | None = None, steps: int = REFITS
) -> Fit:
    """Fit everything from a start."""
    return descend(Objective(tuple(data)), placed(data, free, vector, near), steps=steps, gain=GAIN)


@dataclass(frozen=True, eq=False)
class Sight:
    """What these structures can show under this process and noise.

    Parameters
    ----------
    fit : Fit
        At the true process, on recordings without noise.
    rest : float
        What is left of −2 ln L (of priors, the recordings being without noise) once the process is fitted.
    """

    fit: Fit
    rest: float

    @classmethod
    def of(
        cls,
        targets: Sequence[HeightMap],
        process: dict,
        noise: dict,
        recorded_um: float | None = None,
        effects: Sequence[Effect] = (),
    ) -> Sight:
        """Linearise about the truth; pixels that were recorded wider than the target's make walls wider.

        Effects that are known to be there move with the seven.
        """
        seven, instrument = parameters_of(process), Instrument(pitch_um=recorded_um)
        parameters = replace(seven, effects=tuple(effects))
        shown = [predict(target, parameters, as_measured=True) for target in targets]
        pairs = [(target, replace(seen, instrument=instrument)) for target, seen in zip(targets, shown, strict=True)]
        free = freed(parameters, choose(seven))
        true = placed(whitened(pairs, noise), free, free.start)
        return cls(true, _refitted(true, [0.0] * len(pairs)).cost)

    def shares(self, changes: Sequence[np.ndarray]) -> dict[str, float]:
        """Return what becomes of a change of the recordings (µm, shape (rows, cols) each).

        Returns
        -------
        dict
            `z`: √(−2 ln L) of the changed recordings, without noise, after everything has been fitted anew, over
            √(1 + n²), with n what numerics have of it: of no more standard deviations can a model speak that holds
            the true effect. (To first order it is the length of the change beside all tangents; but calibration
            bends, and may take most of what no tangent takes.)
            `left_um`: rms of what is left of it then.
            `levelling`: share of the energy that levelling and registration take, to first order; `calibration`: share
            that they leave and calibration takes; `raw_um`: rms on the part.
        """
        data = self.fit.data
        pairs = list(zip(data, changes, strict=True))
        column = self.fit.rows.stack([item.white(change) for item, change in pairs])
        whole = float(column @ column) or 1e-30
        levelled = self.fit.nuisances.beside(column)
        refitted = _refitted(self.fit, changes)
        left, left_um = max(refitted.cost - self.rest, 0.0), refitted.rmse_um()
        numerics = NUMERICS_UM * np.sqrt(left) / max(left_um, 1e-12)
        on_part = np.concatenate([change[item.recording.target.heights_um > 0] for item, change in pairs])
        return {
            "z": float(np.sqrt(left) / np.hypot(1, numerics)),
            "left_um": left_um,
            "levelling": float(1 - levelled @ levelled / whole),
            "calibration": float(max(levelled @ levelled - left, 0.0) / whole),
            "raw_um": float(np.sqrt(np.mean(on_part**2))),
        }


def _refitted(true: Fit, changes: Sequence[np.ndarray]) -> Fit:
    """Return the fit when recordings have changed and everything is fitted anew.

    From the truth, and from a focus of twice its size: a wide one takes a blur, and no descent finds it from there.
    """
    data = []
    for item, change in zip(true.data, changes, strict=True):
        measured = item.recording.measured
        changed = measured.with_heights(measured.heights_um + change)
        data.append(replace(item, recording=replace(item.recording, measured=changed)))
    wide = true.vector * [2 if name.startswith("exposure_fwhm") else 1 for name in true.free.names]
    return min((fitted(data, true.free, start, true) for start in (true.vector, wide)), key=lambda fit: fit.cost)
