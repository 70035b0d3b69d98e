"""All effects that the model may lack, with what they would change at the baseline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnose.around import Around
from dlwpredict.diagnose.candidates import Candidate
from dlwpredict.diagnose.evidence import prior_rows, stack
from dlwpredict.diagnose.fit import Fit
from dlwpredict.diagnose.screen import Null, Screen, screen


@dataclass(frozen=True, eq=False)
class Library:
    """All candidates with their whitened signatures at the baseline.

    Parameters
    ----------
    chosen : list of Candidate
    columns : numpy.ndarray, shape (rows, candidates)
        Whitened change per typical size.
    """

    chosen: list[Candidate]
    columns: np.ndarray

    @classmethod
    def of(cls, around: Around, baseline: Fit) -> Library:
        """Whiten the signatures."""
        below = prior_rows(len(baseline.data))
        white = [
            stack([baseline.seen(k, change) for k, change in enumerate(changes)], below)
            for changes in around.signatures_um
        ]
        return cls(around.chosen, np.stack(white, axis=1))

    @property
    def signs(self) -> np.ndarray:
        """Sign of the strength, in typical sizes, that alone is physical; 0 where both are."""
        return np.array([candidate.one_sided * np.sign(candidate.unit) for candidate in self.chosen])

    def screen(self, fitted: Fit, null: Null) -> Screen:
        """Score every candidate beside a fit; effects that it has already are left out."""
        present = {effect.name for effect in fitted.parameters.effects}
        absent = np.array([candidate.name not in present for candidate in self.chosen])
        return screen(fitted, self.columns * absent, self.signs, null)

    def best(self, scores: Screen, name: str) -> int:
        """Return which of an effect's candidates scores best."""
        own = [k for k, candidate in enumerate(self.chosen) if candidate.name == name]
        return max(own, key=lambda k: abs(scores.z[k]))
