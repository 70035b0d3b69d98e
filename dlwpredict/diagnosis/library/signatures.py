"""Signatures: what every candidate would change in these recordings about the place where a fit is, in µm.

They do not depend on the noise: computed once per linearisation point, they serve every noise model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnosis.library.candidates import NOWHERE, Candidate, Placed, candidates
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.model import holding, lacking
from dlwpredict.infer.objective import Fit, Work
from dlwpredict.infer.trace import Trace, trace
from dlwpredict.numerics.parallel import ALONE, Workers
from dlwpredict.parameters import ParameterSet

STEPS, SEEN_UM = (0.5, 1.0, 2.0), 1e-5
"""Signatures are derivatives, taken by a step of the first of these shares of the typical size that changes any point
that counts by more than the second: some laws begin with a threshold, as a tip that touches no flank but steep ones."""


@dataclass(frozen=True, eq=False)
class Signatures:
    """What could change about a fit.

    Parameters
    ----------
    at : Fit
    chosen : list of Candidate
        All effects that the fit does not have, and other switches of the named ones.
    maps_um : list (candidate) of list (recording) of numpy.ndarray, shape (rows, cols)
        Change per typical size: the derivative where the fit is, by one difference; in single precision.
    done_um : dict
        Name of every named effect of the fit to the list (recording) of what it does there.
    """

    at: Fit
    chosen: list[Candidate]
    maps_um: list[list[np.ndarray]]
    done_um: dict[str, list[np.ndarray]]

    @classmethod
    def of(
        cls, fitted: Fit, named: Sequence[str], work: Work, workers: Workers = ALONE, placed: Placed = NOWHERE
    ) -> Signatures:
        """Compute them where a fit is.

        Parameters
        ----------
        fitted : Fit
        named : sequence of str
            Its effects that a diagnosis has added.
        work : Work
        workers : Workers
        placed : mapping of str to sequence of dict
            Where an effect may sit, as its settings.
        """
        chosen = candidates(fitted.parameters, named, placed)
        maps = _changes(fitted, chosen, work, workers)
        return cls(fitted, chosen, maps, {name: done_by(fitted, name, work) for name in named})


def _changes(fitted: Fit, chosen: Sequence[Candidate], work: Work, workers: Workers) -> list[list[np.ndarray]]:
    """Return what candidates would change in every recording, as of `Signatures.maps_um`."""
    targets, parameters = [item.recording.target for item in fitted.data], fitted.parameters
    used = [item.recording.used for item in fitted.data]
    seen = list(zip(targets, used, fitted.traces, strict=True))
    jobs = [(candidate, *one, parameters) for candidate in chosen for one in seen]
    shares = [target.heights_um.size / sum(grid.heights_um.size for grid in targets) for target in targets]
    changes, per = workers.each(_change, jobs), len(targets)
    work.predictions += sum(spent * shares[k % per] for k, (_, spent) in enumerate(changes))
    maps = [change for change, _ in changes]
    return [maps[k * per : (k + 1) * per] for k in range(len(chosen))]


def done_by(fitted: Fit, name: str, work: Work) -> list[np.ndarray]:
    """Return what one effect of a fit changes in every recording, µm, all others as they are; (rows, cols) each."""
    process, changes = lacking(fitted.parameters, [name]), []
    whole = sum(item.recording.target.heights_um.size for item in fitted.data)
    for item, now in zip(fitted.data, fitted.traces, strict=True):
        target = item.recording.target
        without = trace(target, process, now.numerics, now)
        work.predictions += without.work * target.heights_um.size / whole
        changes.append(np.nan_to_num(now.heights_um - without.heights_um))
    return changes


def _change(
    candidate: Candidate, target: HeightMap, used: np.ndarray, known: Trace, parameters: ParameterSet
) -> tuple[np.ndarray, float]:
    """Return the change per typical size, and the work that it took."""
    work = 0.0
    for share in STEPS:
        ways = (candidate.at(share), candidate.at(-share))  # a fit may stand at the end of a range
        effect, step = next((one, size) for one in ways if (size := candidate.size_of(one)))
        moved = trace(target, holding(parameters, [effect]), known.numerics, known)
        change, work = np.nan_to_num(moved.heights_um - known.heights_um), work + moved.work
        if np.abs(change[used]).max(initial=0.0) > SEEN_UM:
            break
    return (change / step).astype(np.float32), work
