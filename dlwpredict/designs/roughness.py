"""The areal roughness calibration structure."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dlwpredict.designs.base import Base, Footprint, Relief, design, number, um


@design("areal roughness with a linear Abbott curve (AIR): height scale", size_um=100.0)
def air(
    at: Footprint,
    *,
    base_um: Base = 9.0,
    height_um: Relief = 2.46,
    correlation_um: Annotated[float, um(0.01, 1000.0, "lateral correlation length (1/e of the autocorrelation)")] = 6.0,
    seed: Annotated[int, number(0, 2**32 - 1, "seed of the random surface")] = 0,
) -> np.ndarray:
    """Smooth random surface whose heights are uniformly distributed, so that the Abbott curve is a straight line.

    A Gaussian random field is mapped by rank: the k-th lowest of N points, k from 0, gets (k + ½)/N·height. Then
    Sa = height/4 and Sq = height/√12; the default 2.46 µm gives the 0.615 and 0.710 µm of Lang et al. 2022 (the idea:
    Eifler et al. 2018). The same seed gives the same surface at any pitch.

    Raises
    ------
    InputError
        The correlation length is below two pixels.
    """
    at.require_resolved("correlation_um", correlation_um)
    field = random_field(at, correlation_um, np.random.default_rng(seed))
    ranks = np.empty(field.size)
    ranks[np.argsort(field, axis=None, kind="stable")] = np.arange(field.size)
    return base_um + height_um * ((ranks + 0.5) / field.size).reshape(field.shape)


def random_field(at: Footprint, correlation_um: float, rng: np.random.Generator) -> np.ndarray:
    """Return a Gaussian random field with the autocorrelation exp(−r²/ξ²), shape (rows, cols).

    Sum of plane waves on a lattice of wave numbers with complex normal amplitudes ∝ exp(−(kξ)²/8), up to kξ = 10. The
    period exceeds the footprint by 4 ξ, so that opposite edges are independent. Unlike filtered pixel noise, this does
    not depend on the pitch.
    """
    period = at.side_um + 4 * correlation_um
    highest = int(np.ceil(10 / correlation_um * period / (2 * np.pi)))
    wave = 2 * np.pi / period * np.arange(-highest, highest + 1)  # 1/µm
    weight = np.exp(-((wave * correlation_um) ** 2) / 8)
    amplitude = rng.standard_normal((2, wave.size, wave.size)) * weight[:, None] * weight[None, :]
    along_y = np.exp(1j * at.y_um * wave)
    along_x = np.exp(1j * wave[:, None] * at.x_um)
    return (along_y @ (amplitude[0] + 1j * amplitude[1]) @ along_x).real
