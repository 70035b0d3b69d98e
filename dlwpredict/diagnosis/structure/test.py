"""Everything that tests a fit without names, together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Beside, Energy, Forms
from dlwpredict.diagnosis.structure.ripple import Ripple, ripple
from dlwpredict.diagnosis.structure.spots import Bumps, Spot, spot
from dlwpredict.infer import held_out
from dlwpredict.infer.held_out import LeftOut
from dlwpredict.infer.null import Null
from dlwpredict.infer.objective import Fit

WAYS = 4
"""Ways of looking for structure: free forms, a ripple, a spot, columns; each has its share of the level."""

SINGLE = policy.LEVEL_STRUCTURE / WAYS

Pattern = Ripple | Spot | Columns
"""Structure that has a form of its own."""


@dataclass(frozen=True, eq=False)
class Model:
    """A fit, what free forms still find in its residual, and how it predicts what it has not seen.

    Parameters
    ----------
    fit : Fit
    draws : numpy.ndarray, shape (rows, draws)
        Noise, beside the fit.
    beside : Beside
        The free forms beside it.
    forms : Energy
        What they explain of the residual.
    ripple : Ripple
        The strongest wave in the residual.
    spot : Spot
        The strongest bump or dent in the residual.
    columns : Columns
        Offsets of whole columns, lines along y, that the residual was found to have.
    blocks, recordings : LeftOut or None
        Errors on blocks and on whole recordings that the fit had not seen.
    left_out : tuple of Spot
        Blemishes that the fit was kept from: structure that no model of it explains.
    """

    fit: Fit
    draws: np.ndarray
    beside: Beside
    forms: Energy
    ripple: Ripple
    spot: Spot
    columns: Columns
    blocks: LeftOut | None
    recordings: LeftOut | None
    left_out: tuple[Spot, ...] = ()

    @classmethod
    def of(
        cls,
        fit: Fit,
        forms: Forms,
        bumps: Sequence[Bumps],
        columns: Columns,
        null: Null,
        left_out: Sequence[Spot] = (),
    ) -> Model:
        """Test a fit."""
        draws = null.beside(fit)
        beside = Beside.of(fit, forms.blocks, draws)
        return cls(
            fit,
            draws,
            beside,
            beside.energy(),
            ripple(fit, draws),
            spot(fit, draws, bumps),
            columns,
            held_out.blocks(fit),
            held_out.recordings(fit),
            tuple(left_out),
        )

    @cached_property
    def structure_um(self) -> float:
        """Root mean square of what free forms explain of the residual, µm."""
        return self.beside.structure_um(self.draws)

    @property
    def residual(self) -> tuple[Ripple, Spot, Columns]:
        """The strongest of each kind of structure that has a form of its own, in what the fit leaves."""
        return self.ripple, self.spot, self.columns

    @property
    def patterns(self) -> tuple[Ripple, Spot, Columns]:
        """The same, blemishes that were left out included."""
        return self.ripple, min((self.spot, *self.left_out), key=lambda one: (one.p_value, -one.excess)), self.columns

    @property
    def p_value(self) -> float:
        """Probability that noise alone leaves as strange a remainder, in any of the ways."""
        return min(WAYS * min(self.forms.p_value, *(pattern.p_value for pattern in self.patterns)), 1.0)

    @property
    def unexplained(self) -> bool:
        """Whether there is more than noise in the residual."""
        return self.p_value < policy.LEVEL_STRUCTURE

    @property
    def left(self) -> float:
        """What χ² in the residual is beyond noise: by free forms, and by every pattern that stands out by itself."""
        strange = [pattern for pattern in self.residual if pattern.p_value < SINGLE]
        return max(self.forms.excess, 0) + sum(pattern.excess for pattern in (*strange, *self.left_out))
