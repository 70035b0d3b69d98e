"""What speaks for an effect: its score, what a refit with it gains, and whether its strength stands."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from dlwpredict.diagnose.competitor import SINGLE, Beside, Forms
from dlwpredict.diagnose.evidence import WIDTHS, width_rows
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.library import Library
from dlwpredict.diagnose.refit import effect_of
from dlwpredict.diagnose.screen import Null, Screen
from dlwpredict.effects.base import Effect
from dlwpredict.parameters import declarations

LEVEL = 0.025
"""Family-wise probability at which noise alone would name an effect; as much is left to the free forms."""

INDISTINCT = 9.0
"""An effect may as well be another while that one, refitted in its place, is not this far behind in 2 ln L, in units of
the score's own variance; one that is as far ahead takes its place."""

UNLIKELY = 0.05
"""A focus that the prior of its widths makes less probable than this is taken to have been moved by something else."""

HIDDEN = 5.0
"""Standard deviations that a typical size of an effect stands out before calibration has answered to it, and does not
afterwards: the answer hides it, as a wider focus hides a blur."""


@dataclass(frozen=True, eq=False)
class Judge:
    """What a baseline's data say about the effects that it may lack.

    Parameters
    ----------
    baseline : Fit
    library : Library
    null : Null
    """

    baseline: Fit
    library: Library
    null: Null
    screened: dict[Fit, Screen] = field(default_factory=dict, repr=False)

    def added(self, model: Fit) -> list[Effect]:
        """Return the effects that a model has and the baseline has not."""
        known = {effect.name for effect in self.baseline.parameters.effects}
        return [effect for effect in model.parameters.effects if effect.name not in known]

    def screen(self, model: Fit) -> Screen:
        """Score every candidate beside a model."""
        if model not in self.screened:
            self.screened[model] = self.library.screen(model, self.null)
        return self.screened[model]

    def spread(self, model: Fit, name: str) -> float:
        """Return the standard deviation of an effect's best score beside a model, 1 for exactly known white noise."""
        scores = self.screen(model)
        return float(scores.spread[self.library.best(scores, name)])

    def more(self, model: Fit) -> bool:
        """Tell whether some effect scores beside a model as noise hardly ever makes one."""
        scores = self.screen(model)
        return scores.p_value(np.abs(scores.z).max()) <= LEVEL

    def hidden(self, model: Fit) -> list[int]:
        """Return the candidates, one per effect, that calibration may have answered to with a focus that is none."""
        if model is not self.baseline or not strange(model):
            return []
        scores = self.screen(model)
        whole = np.linalg.norm(self.library.columns, axis=0) / scores.spread
        absorbed = np.flatnonzero((whole >= HIDDEN) & (scores.visible < HIDDEN))
        return sorted({self.library.best(scores, self.library.chosen[k].name) for k in absorbed})

    def convinces(self, grown: Fit, model: Fit) -> bool:
        """Tell whether the last effect gains enough, with a strength whose 95 % interval leaves out its off value.

        The limit is that of one strength; whatever else it moves must bring its own 2 (Akaike 1974).
        """
        name, shapes = grown.parameters.effects[-1].name, len(grown.free.names) - len(model.free.names) - 1
        gain = model.chi2 - grown.chi2 - 2 * shapes
        return gain > self.least(model, name) and self._stands(grown, name)

    def idle(self, model: Fit) -> str:
        """Return an effect of a model that nothing says is there, now that all else is at rest; "" if all are."""
        return next((effect.name for effect in self.added(model) if not self._stands(model, effect.name)), "")

    def suffices(self, grown: Fit) -> bool:
        """Tell whether one effect explains all that there is beside the baseline, by scores and by free forms."""
        if not self.convinces(grown, self.baseline) or self.more(grown):
            return False
        return Beside.of(grown, Forms.of(self.baseline).columns, self.null).energy().p_value >= SINGLE

    def least(self, model: Fit, name: str) -> float:
        """Return the gain in 2 ln L that an effect must bring: what noise and numerics together hardly ever give."""
        return (self.screen(model).threshold(LEVEL) * self.spread(model, name)) ** 2

    def _stands(self, grown: Fit, name: str) -> bool:
        """Tell whether the 95 % interval of any strength of an effect leaves out its off value."""
        effect, sd = effect_of(grown, name), self.null.deviations(grown)
        for switch in effect.switches():
            k = grown.free.index(f"{name}.{switch}")
            if k is not None and abs(grown.point.vector[k] - declarations(effect)[switch][0]) > 1.96 * sd[k]:
                return True
        return False


def strange(model: Fit) -> bool:
    """Tell whether a focus is unlikely by the prior of its widths."""
    rows = dict(zip(WIDTHS, width_rows(model.parameters, model.free.names)[0], strict=True))
    focus = [row for name, row in rows.items() if name.startswith("exposure") and name in model.free.names]
    return stats.chi2.sf(np.sum(np.square(focus)), max(len(focus), 1)) < UNLIKELY


def weighed(found: Fit) -> float:
    """Return −2 ln L, and 2 for everything that is free (Akaike 1974)."""
    return found.chi2 + 2 * len(found.free.names)
