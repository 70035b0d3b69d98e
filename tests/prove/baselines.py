"""What else one could do: seven parameters alone, a smooth discrepancy, stepwise BIC, and the true effect known.

All are given the true noise, which the program has to find. Only predictions of the structure held out count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.diagnosis.structure.freeform import smooth_forms
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import ParameterSet, declarations
from tests.prove.linear import fitted, whitened

MOST_TERMS = 3
"""Stepwise BIC is stopped here, as the program is; it would go on."""

DISCREPANCY_UM = 0.03
"""Standard deviation of the prior of every weight of the smooth discrepancy."""

STEPS = 4
"""Steps of the fit with its terms."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A case as the baselines see it: what is given to the program, and the noise besides.

    Parameters
    ----------
    data : tuple of Whitened
    seven : Fit
        The seven parameters, fitted by maximum likelihood.
    """

    data: tuple[Whitened, ...]
    seven: Fit

    @classmethod
    def of(cls, pairs: Sequence[tuple[HeightMap, HeightMap]], start: ParameterSet, noise: dict) -> Bench:
        """Fit the seven from a start."""
        data, free = whitened(pairs, noise), choose(start)
        return cls(data, fitted(data, free, free.start))

    def oracle(self, effects: Sequence[dict]) -> Fit:
        """Fit the effects that are there, in the library's form, from their true strengths."""
        known = tuple(library()[e["name"]](**_declared(e)) for e in effects)
        free = freed(replace(self.seven.parameters, effects=known), self.seven.free)
        return fitted(self.data, free, free.start)

    def smooth(self) -> tuple[np.ndarray, float]:
        """Fit a smooth discrepancy to what the seven leave: forms in x, y, height and edge distance, one set for all.

        Returns
        -------
        weights : numpy.ndarray, shape (forms,)
            µm.
        rmse_um : float
            On the recordings.
        """
        data, rows = self.seven.data, self.seven.rows
        forms = [smooth_forms(item.recording.target) for item in data]
        beside = self.seven.nuisances.beside(rows.stack([i.white(f) for i, f in zip(data, forms, strict=True)]))
        prior = np.eye(beside.shape[1]) / DISCREPANCY_UM
        goal = np.concatenate([self.seven.residual, np.zeros(len(prior))])
        weights = np.linalg.lstsq(np.concatenate([beside, prior]), goal, rcond=None)[0]
        moved = tuple(_minus(item, np.tensordot(weights, f, axes=1)) for item, f in zip(data, forms, strict=True))
        return weights, Objective(moved).at(self.seven.free, self.seven.vector).rmse_um()

    def stepwise(self) -> tuple[list[str], Fit]:
        """Add effects while BIC falls, every pixel counted as independent; return their names and the fit with them."""
        seven, data = self.seven, self.seven.data
        around = Signatures.of(seven, (), Work())
        used = [item.recording.used for item in data]
        columns = np.stack([np.concatenate([m[u] for m, u in zip(maps, used, strict=True)])
                            for maps in around.maps_um], axis=1)  # fmt: skip
        residual = np.concatenate([seven.residual_um(k)[u] for k, u in enumerate(used)])
        base = _plain_basis(seven, used)
        chosen, names = _forward(around.chosen, columns, residual, base)
        effects = tuple(around.chosen[k].at(share) for k, share in chosen)
        parameters = replace(seven.parameters, effects=effects)
        if not effects:
            return names, seven
        white, free = [_independent(item, float(residual.std())) for item in data], freed(parameters, seven.free)
        return names, fitted(white, free, free.start, steps=STEPS)


def unseen_um(parameters: ParameterSet, target: HeightMap, clean: HeightMap, noise: dict) -> float:
    """Return the error of a prediction on a structure kept from every fit, noise-free as the instrument shows it, µm.

    Its levelling and registration are found as for any recording.
    """
    free = choose(parameters)
    return Objective(whitened([(target, clean)], noise)).at(free, free.start).rmse_um()


def unseen_smooth_um(weights: np.ndarray, seven: Fit, target: HeightMap, clean: HeightMap, noise: dict) -> float:
    """Return the same for the seven with a smooth discrepancy, carried over by its forms, µm."""
    discrepancy = np.tensordot(weights, smooth_forms(target), axes=1)
    return unseen_um(seven.parameters, target, clean.with_heights(clean.heights_um - discrepancy), noise)


def _declared(entry: dict) -> dict:
    """Return those of a press effect's settings that the library knows."""
    known = declarations(library()[entry["name"]])
    return {key: value for key, value in entry.items() if key in known}


def _minus(item: Whitened, discrepancy_um: np.ndarray) -> Whitened:
    """Return a recording with a discrepancy taken off."""
    recording = item.recording
    measured = recording.measured.with_heights(recording.measured.heights_um - discrepancy_um)
    return replace(item, recording=replace(recording, measured=measured))


def _independent(item: Whitened, sigma_um: float) -> Whitened:
    """Return a recording whose pixels pass for independent."""
    grid = item.recording.target
    noise = Noise(sigma_um, 1e-3 * sigma_um, grid.dx_um, grid.dx_um, grid.dy_um)
    return Whitened.of(item.recording, Uneven(noise))


def _plain_basis(seven: Fit, used: Sequence[np.ndarray]) -> np.ndarray:
    """Return an orthonormal basis of what the fit may move, in µm, shape (points, columns)."""
    blocks, nuisances = [], []
    for k, (item, mask) in enumerate(zip(seven.data, used, strict=True)):
        blocks.append(item.whitener.solve(seven.jacobian[seven.rows.of(k)]))
        nuisances.append(item.nuisance_maps(seven.traces[k].heights_um)[:, mask].T)
    columns = np.column_stack([np.concatenate(blocks), sparse.block_diag(nuisances).toarray()])
    left, sizes, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12), full_matrices=False)
    return left[:, sizes > 1e-8]


def _forward(candidates, columns: np.ndarray, residual: np.ndarray, base: np.ndarray):
    """Add the column that lowers n ln(RSS/n) + k ln n most, one per effect, until none does."""
    points, names, chosen = len(residual), [], []
    left = residual - base @ (base.T @ residual)
    while len(names) < MOST_TERMS:
        free = columns - base @ (base.T @ columns)
        sizes = np.linalg.norm(free, axis=0)
        seen = (sizes > 1e-6 * np.linalg.norm(columns, axis=0).max()) & np.array(
            [c.name not in names for c in candidates]
        )
        unit = free / np.where(seen, sizes, 1)
        gains = np.where(seen, unit.T @ left, 0.0)
        k = int(np.argmax(np.abs(gains)))
        rest = left - gains[k] * unit[:, k]
        if points * np.log((rest @ rest) / (left @ left)) + np.log(points) >= 0:
            break
        names.append(candidates[k].name)
        chosen.append((k, float(np.clip(gains[k] / sizes[k], -3, 3))))
        base, left = np.column_stack([base, unit[:, k]]), rest
    return chosen, names
