"""What may be written: how high, in which slices, and in which shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dlwpredict.correction.printable import Printable
from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap

HIGHEST = 2.0
"""Nothing is written higher than so many times the target's highest point, unless a maximum is given: resin shrinks by
less than half, and what asks for more is a wall or an edge that no height mends."""

LEAST_SLICE_UM = 1e-4
"""A tenth of a nanometre: no stage moves by less, and heights are no finite number of slices of nearly nothing."""

AS_IT_COMES = Printable()


@dataclass(frozen=True)
class Limits:
    """What may be written.

    Parameters
    ----------
    maximum_um : float
        Highest written height, µm.
    printable : Printable
        What its shape may be.
    slicing_um : float
        Heights are rounded to multiples of this at the end; 0 = continuous.
    """

    maximum_um: float = np.inf
    slicing_um: float = 0.0
    printable: Printable = AS_IT_COMES

    @classmethod
    def about(cls, target: HeightMap, maximum_um: float | None = None, **settings: Any) -> Limits:
        """Return limits for a target, `HIGHEST` times as high as it is unless a maximum is given."""
        limits = cls(HIGHEST * float(target.heights_um.max()) if maximum_um is None else maximum_um, **settings)
        limits.printable.require_within(max(target.size_um))
        return limits

    def __post_init__(self) -> None:
        if not self.maximum_um > 0:
            raise InputError(f"found {self.maximum_um:g}", key="--maximum-um", allowed="allowed: above 0")
        whole = LEAST_SLICE_UM <= self.slicing_um <= self.maximum_um and np.isfinite(self.slicing_um)
        if self.slicing_um != 0 and not whole:
            allowed = f"allowed: 0, or {LEAST_SLICE_UM:g} to {self.maximum_um:.4g}, the highest that may be written"
            raise InputError(f"found {self.slicing_um:g}", key="--slicing-um", allowed=allowed)

    def within(self, written: np.ndarray, target: HeightMap) -> np.ndarray:
        """Keep heights printable, between a fiftieth of the target and the maximum; nothing is written beside it."""
        shaped = self.printable.of(written, target)
        return np.where(target.heights_um > 0, np.clip(shaped, target.heights_um / 50, self.maximum_um), 0.0)

    def sliced(self, written: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """Round to whole slices within the limits; at least one where something stands."""
        if self.slicing_um == 0:
            return written
        most = np.floor(self.maximum_um / self.slicing_um + 1e-9)
        return np.where(footprint, np.clip(np.round(written / self.slicing_um), 1, most) * self.slicing_um, 0.0)
