"""Fast numerics: a few smooth levels in z, convolutions in (x, y) only, no voxels.

The solid under a height map h is one interval per column, so its axial convolution is closed: Φ((h − z)/s_z). What
remains at each level z is two-dimensional. Exposure falls monotonically with z, so the exposed resin is a height
map e(x, y) again, and the same holds for cross-linking. This is the limit that voxels reach as their slice goes to 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.model.column_mean import column_mean
from dlwpredict.model.exposed_surface import exposed_surface
from dlwpredict.model.states import Crosslinked, Dose, Exposed


@dataclass(frozen=True)
class Levels:
    """The fast numerics.

    Parameters
    ----------
    threads : int
        Tiles computed at once. The steps of a tile are short, and two threads mostly wait for the interpreter: on two
        cores they take longer than one. Processes do better (`batch`).
    whole_pixels : bool
        Whether a column is exposed as its centre is, as voxels are, and not in the share of it that is.
    """

    threads: int = 1
    whole_pixels: bool = False

    def exposed(self, dose: Dose, threshold: float, reference: str) -> Exposed:
        """Solve exposure = threshold for the height of every column."""
        surface = exposed_surface(dose, threshold, reference, self.threads, whole_pixels=self.whole_pixels)
        return Exposed(surface, dose)

    def column_mean(self, crosslinked: Crosslinked, reference: str) -> np.ndarray:
        """Average normalised cross-linking over 0 … e(x, y)."""
        return column_mean(crosslinked, reference, self.threads)
