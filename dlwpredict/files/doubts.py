"""Does what a command has read belong together, and to that command? Units, mirrors, mix-ups, things done twice.

Only coarse slips are named, and only as warnings: a factor of 3 in height, another side up, no likeness at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dlwpredict.files.plausibility import clipping, doubts_of_size
from dlwpredict.files.provenance import Run
from dlwpredict.heightmap import HeightMap

_ALIKE, _UNLIKE = 0.5, 0.3  # correlations

PART = 0.05
"""Share of a map that a part must cover for its relief alone to be compared."""

_ALREADY = {
    ("align", "align"): "is levelled and on a target's grid already: align the recording itself",
    ("precompensate", "precompensate"): "is corrected already: correct the target itself",
    ("precompensate", "predict"): "is a prediction, not a target",
    ("precompensate", "align"): "is a recording, not a target",
}
"""What to say by command and by the command that made what it reads."""

_OF_RECORDINGS = "align", "calibrate", "diagnose"

_TURNS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], bool]] = {
    "": (lambda z: z, True),
    "mirrored left to right": (np.fliplr, True),
    "mirrored top to bottom": (np.flipud, True),
    "turned by 180°": (lambda z: z[::-1, ::-1], True),
    "turned by 90°": (np.rot90, False),
    "turned by 270°": (lambda z: np.rot90(z, 3), False),
    "mirrored along a diagonal": (np.transpose, False),
    "mirrored along the other diagonal": (lambda z: np.rot90(z.T, 2), False),
}
"""Ways to lay a map, and whether any grid allows them or only a square one."""


def doubts(run: Run, pairs: Sequence[tuple[Path, Path]]) -> list[str]:
    """Return a warning for everything that looks wrong about what a command has read, each with its file.

    Parameters
    ----------
    run : Run
        The command, with the maps that it read.
    pairs : sequence of pairs of Path
        Which maps belong together: target and recording.
    """
    warnings: list[str] = []
    command = run.words[1] if len(run.words) > 1 else ""
    for path, step in run.steps.items():
        if said := _ALREADY.get((command, step)):
            warnings.append(f"{path}: {said}")
    for target, recording in pairs:
        if run.steps.get(target) == "align" and run.steps.get(recording) == "design":
            warnings.append(f"{target}: was made by align, {recording} by design: are target and recording swapped?")
        elif command in _OF_RECORDINGS and run.steps.get(recording) == "design":
            warnings.append(f"{recording}: was made by design: are target and recording exchanged?")
        elif target in run.maps and recording in run.maps:
            differences = disagreement(run.maps[target], run.maps[recording])
            if recording not in run.steps:  # else said when it was converted
                differences += clipping(run.maps[recording])
            warnings += [f"{recording}: {text}" for text in differences]
    return warnings


def disagreement(target: HeightMap, recording: HeightMap) -> list[str]:
    """Return a warning if two maps that belong together differ in unit, lie differently, or show different things.

    How they lie is only asked of maps on one grid.

    Examples
    --------
    >>> part = HeightMap(np.add.outer(np.arange(40.0), np.arange(40.0) ** 2), 1, 1)
    >>> disagreement(part, part.with_heights(part.heights_um[:, ::-1]))
    ['fits better mirrored left to right (CC 1.00) than as it lies (CC -0.87): use align']
    """
    if sizes := doubts_of_size(target, recording):
        return sizes
    if not target.same_grid(recording):
        return []
    square = target.shape[0] == target.shape[1] and np.isclose(target.dx_um, target.dy_um)
    measured = np.where(recording.measured, recording.heights_um, np.nan)
    wanted = target.heights_um  # beside a block its outline outweighs all relief on it, and looks alike all round
    if (part := wanted > 0).mean() > PART and np.ptp(wanted[part]) > 0:
        wanted = np.where(part, wanted, np.nan)
    likeness = {how: _correlation(wanted, turn(measured)) for how, (turn, free) in _TURNS.items() if square or free}
    as_it_lies = likeness.pop("")
    how, best = max(likeness.items(), key=lambda item: item[1])
    if best > max(_ALIKE, as_it_lies + 0.1):
        return [f"fits better {how} (CC {best:.2f}) than as it lies (CC {as_it_lies:.2f}): use align"]
    if max(best, as_it_lies) < _UNLIKE:
        return [f"hardly resembles the target (CC {as_it_lies:.2f}): is it a recording of another structure?"]
    return []


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return the correlation over the points known in both; 1 where one of them is flat and nothing can be said."""
    known = np.isfinite(first) & np.isfinite(second)
    a, b = first[known] - first[known].mean(), second[known] - second[known].mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / size) if size > 0 else 1.0
