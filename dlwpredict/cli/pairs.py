"""Targets and recordings of a diagnosis, from files to working pixels and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlwpredict.cli.console import detail
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.pixels import working_factor
from dlwpredict.infer.recording import Recording, coarser, prepare
from dlwpredict.pairing import checked
from dlwpredict.parameters import ParameterSet

Files = Sequence[tuple[Path, Path]]


@dataclass(frozen=True, eq=False)
class Pair:
    """A target and its recording.

    Parameters
    ----------
    files : (Path, Path)
    part : HeightMap
        The target as it was read.
    recording : Recording
        On working pixels.
    factor : int
        Pixels of the file along each side of a working one.
    """

    files: tuple[Path, Path]
    part: HeightMap
    recording: Recording
    factor: int

    @classmethod
    def read(cls, files: tuple[Path, Path], start: ParameterSet, wall_px: int, pitch_um: float | None) -> Pair:
        """Read and check a pair."""
        target, recording = files
        part, measured = read_height_map(target), read_height_map(recording)
        pair = checked(part, measured, name=str(recording), target_name=str(target), wall_px=wall_px)
        factor = working_factor(part, start, pitch_um)
        detail(f"{recording}: {pair.points} points count, {factor} × {factor} pixels make one")
        return cls(files, part, coarser(pair, factor), factor)

    @property
    def pitch_um(self) -> float:
        """Pitch of the working pixels, the larger where it is not the same along x and y."""
        return max(self.recording.target.dx_um, self.recording.target.dy_um)

    def fine(self, values: np.ndarray) -> HeightMap:
        """Return values on the pixels of the file."""
        spread = np.kron(values, np.ones((self.factor, self.factor)))
        return self.part.with_heights(spread[: self.part.shape[0], : self.part.shape[1]])


def pixels_of(pairs: Sequence[Pair]) -> str:
    """Say on which pixels the recordings are worked."""
    kinds = dict.fromkeys((pair.factor, pair.pitch_um) for pair in pairs)
    each = [f"{p:.3g} µm ({'as recorded' if f == 1 else f'{f} × {f} recorded ones'})" for f, p in kinds]
    return f"working pixels of {' and '.join(each)}"


def repeats_of(pairs: Sequence[Pair], repeats: Files) -> list[list[HeightMap]]:
    """Return the repeats of every recording, on its pixels.

    Raises
    ------
    InputError
        A repeat names a recording that stands in no pair, or has another grid.
    """
    again: list[list[HeightMap]] = [[] for _ in pairs]
    known = {pair.files[1].resolve(): k for k, pair in enumerate(pairs)}
    for recording, repeat in repeats:
        if recording.resolve() not in known:
            raise InputError("stands in no --pair", where=recording, key="--repeat", allowed="a recording of a --pair")
        k = known[recording.resolve()]
        repeated = prepare(pairs[k].part, read_height_map(repeat), name=str(repeat), target_name=str(pairs[k].files[0]))
        again[k].append(coarser(repeated, pairs[k].factor).measured)
    return again
