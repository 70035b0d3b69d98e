"""A target and its recording, brought together: all that can be wrong with a pair is said here, before any fit."""

from __future__ import annotations

from typing import Any

from dlwpredict.errors import blaming
from dlwpredict.files.plausibility import require_sizes
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.recording import Recording, prepare


def checked(target: HeightMap, measured: HeightMap, *, name: str, target_name: str, **settings: Any) -> Recording:
    """Return a pair ready for a fit, its units found plausible.

    Raises
    ------
    InputError
        What `prepare` and `require_sizes` refuse, the file named.
    """
    recording = prepare(target, measured, name=name, target_name=target_name, **settings)
    with blaming(name):
        require_sizes(target, measured)
    return recording
