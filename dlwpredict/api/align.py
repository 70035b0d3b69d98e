"""``align``: a recording brought onto its target's grid."""

from __future__ import annotations

from typing import Any

from dlwpredict import alignment
from dlwpredict.alignment import Alignment
from dlwpredict.errors import blaming
from dlwpredict.files.plausibility import require_sizes, require_unclipped
from dlwpredict.heightmap import HeightMap


def align(recording: HeightMap, target: HeightMap, **settings: Any) -> Alignment:
    """Find a target in a recording, bring the recording onto the target's grid, and level it.

    Parameters
    ----------
    recording, target : HeightMap
        Each on a grid of its own.
    **settings
        Of `dlwpredict.alignment.align`: ``distortion`` ("auto", "rigid", "affine", "bow" or "cubic"), ``allow_mirror``,
        ``keep_missing``, ``known_part``.

    Returns
    -------
    Alignment
        ``aligned``, the recording on the target's grid; ``pose``, ``cc`` and an uncertainty for every figure.

    Raises
    ------
    InputError
        A unit is wrong by far, or much of the recording is clipped.
    ResultError
        No reliable match, a mirrored recording, or one that is smaller than the part.
    """
    with blaming("recording"):
        require_unclipped(recording)
        require_sizes(target, recording)
        return alignment.align(recording, target, **settings)
