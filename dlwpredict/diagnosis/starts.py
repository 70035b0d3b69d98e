"""Where refits of sets of effects begin."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from dlwpredict.diagnosis.library.candidates import Bent
from dlwpredict.diagnosis.library.score import Linearised
from dlwpredict.diagnosis.posterior import Sets, Subset
from dlwpredict.effects.base import Effect
from dlwpredict.infer.fitter import Fitter, Start, far_widths, from_paper
from dlwpredict.infer.model import joined, lacking
from dlwpredict.infer.objective import Fit
from dlwpredict.parameters import ParameterSet

START_SHARE = 0.5
"""Refits begin at this share of the linear strength: the full one may overshoot where the law is not linear ..."""

LEAST, FARTHEST = 0.05, 3.0
"""... and between these typical sizes."""


def beside(begun: Fit, sets: Sets, subset: Subset, fitter: Fitter, baseline: Fit) -> list[Start]:
    """Return where the refit of a set begins: a fit without what leaves, with what comes in.

    The process has answered to it to first order. Small, where tangents hold; and where one effect comes in, as large
    as it is typically: what the process has taken most of is lowest far from where its tangent points.
    """
    kept = lacking(begun.parameters, [name for name in sets.screen.named if name not in subset.kept])
    strengths = sets.strengths(subset)
    small = [START_SHARE * float(np.clip(a, -FARTHEST, FARTHEST)) for a in strengths]
    small = [a if abs(a) > LEAST else LEAST * (np.sign(a) or 1.0) for a in small]
    sizes = [small]
    if len(subset.added) == 1:
        large = [float(np.sign(a) * np.clip(abs(a), 1.0, FARTHEST)) for a in small]
        sizes += [large] if large != small else []
    return [Start(_at(kept, sets, subset, shares, fitter, baseline), begun) for shares in sizes]


def _at(
    kept: ParameterSet, sets: Sets, subset: Subset, shares: Sequence[float], fitter: Fitter, baseline: Fit
) -> ParameterSet:
    """Return a process with candidates at these strengths, in typical sizes."""
    effects: list[Effect] = []
    moved: dict[str, float] = defaultdict(float)
    for k, share in zip(subset.added, shares, strict=True):
        candidate = sets.screen.chosen[k]
        effects.append(candidate.at(share) if candidate.name in subset.kept else candidate.alone(share))
        size = np.sqrt(max(share, 0.0)) if isinstance(candidate, Bent) else share
        for name, change in sets.screen.answers[k].items():
            moved[name] += size * change
    free = fitter.free(joined(kept, effects, baseline.free))
    values = [value + moved[name] for name, value in zip(free.names, free.start, strict=True)]
    return free.parameters(free.allowed(np.array(values)))


def behind_widths(model: Fit, screen: Linearised, fitter: Fitter, baseline: Fit) -> list[Start]:
    """Return starts for effects whose place a width may have taken that came out far from its prior.

    About such a width no tangent shows them. They are those that the process hides, and that could bring the width back
    within their range; the process begins at the paper's seven.
    """
    far = far_widths(model.free, model.vector)
    largest: dict[tuple[str, str, bool], tuple[float, int]] = {}
    for k in screen.hidden:
        candidate = screen.chosen[k]
        for size in (candidate.lowest, candidate.highest):
            brought = [size * screen.answers[k].get(name, 0.0) / away for name, away in far.items()]
            place = candidate.name, candidate.switch, size > 0
            if max(brought, default=0.0) >= 1 and screen.whole[k] > largest.get(place, (0.0, k))[0]:
                largest[place] = float(screen.whole[k]), k
    starts = []
    for (_, _, above), (_, k) in largest.items():
        process = joined(model.parameters, [screen.chosen[k].at(1.0 if above else -1.0)], baseline.free)
        free = fitter.free(process)
        begun = from_paper(free, free.start)
        starts.append(Start(process if begun is None else free.parameters(begun)))
    return starts
