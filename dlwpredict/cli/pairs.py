"""Targets and recordings, from files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map
from dlwpredict.pairing import Pair
from dlwpredict.parameters import ParameterSet

Files = Sequence[tuple[Path, Path]]


def read_pair(files: tuple[Path, Path], start: ParameterSet, **settings: Any) -> Pair:
    """Read and check a pair, with settings of `Pair.of`."""
    target, recording = (read_height_map(file) for file in files)
    return Pair.of(target, recording, start, names=(str(files[0]), str(files[1])), **settings)


def with_repeats(pairs: Sequence[Pair], repeats: Files) -> list[Pair]:
    """Return the pairs with the repeats of their recordings.

    Raises
    ------
    InputError
        A repeat names a recording that stands in no pair, or has another grid.
    """
    repeated = {Path(pair.names[1]).resolve(): pair for pair in pairs}
    for recording, repeat in repeats:
        if recording.resolve() not in repeated:
            raise InputError("stands in no --pair", where=recording, key="--repeat", allowed="a recording of a --pair")
        pair = repeated[recording.resolve()]
        repeated[recording.resolve()] = pair.repeated(read_height_map(repeat), name=str(repeat))
    return list(repeated.values())
