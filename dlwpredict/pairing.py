"""A target and its recording, brought together: all that can be wrong with a pair is said here, before any fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dlwpredict.alignment import Alignment
from dlwpredict.errors import ResultError, blaming
from dlwpredict.files.plausibility import require_sizes
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.pixels import LARGE, working_factor
from dlwpredict.infer.recording import Recording, coarser, keeps_most, prepare
from dlwpredict.metrology.walls import WALL_PX
from dlwpredict.parameters import ParameterSet


@dataclass(frozen=True, eq=False)
class Pair:
    """A target and its recording, found plausible.

    Parameters
    ----------
    names : (str, str)
        What the user calls target and recording.
    native : Recording
        On the pixels that it came on.
    factor : int
        Of these along each side of a working pixel.
    repeats : tuple of HeightMap
        Further recordings of the same print, on working pixels.
    """

    names: tuple[str, str]
    native: Recording
    factor: int = 1
    repeats: tuple[HeightMap, ...] = ()

    @classmethod
    def of(
        cls,
        target: HeightMap,
        measured: HeightMap,
        start: ParameterSet,
        *,
        names: tuple[str, str] = ("target", "recording"),
        working_pitch_um: float | None = None,
        large_px: float = LARGE,
        wall_px: int = WALL_PX,
        **settings: Any,
    ) -> Pair:
        """Check a pair, and choose its working pixels: none counts that holds a wall, and most of what counts is kept.

        Parameters
        ----------
        target, measured : HeightMap
            On one grid.
        start : ParameterSet
            Its focus is the one that is expected.
        names : (str, str)
        working_pitch_um : float, optional
            Pitch of the working pixels, about; 0 = as they are. Default: what the focus allows.
        large_px : float
            Working pixels that are too many, so that wider ones are chosen; inf for a fit of the process alone, which
            takes little time and is to know the focus.
        wall_px : int
            Points so near to a wall do not count, nor those within a working pixel of it; 0 = all count.
        **settings
            Of `prepare`: ``free_shift``.

        Raises
        ------
        InputError
            What `prepare` and `require_sizes` refuse, the file named.
        """
        settings |= {"name": names[1], "target_name": names[0]}
        native = prepare(target, measured, wall_px=wall_px, **settings)
        with blaming(names[1]):
            require_sizes(target, measured)
        widest = working_factor(target, start, working_pitch_um, large_px)
        for factor in range(widest, 0, -1):
            pair = cls(names, native.away_from_walls(factor) if wall_px else native, factor)
            if working_pitch_um is not None or keeps_most(native, pair.recording, factor):
                break
        return pair

    @cached_property
    def recording(self) -> Recording:
        """On working pixels."""
        return coarser(self.native, self.factor)

    @property
    def pitch_um(self) -> float:
        """Pitch of the working pixels, the larger where it is not the same along x and y."""
        return max(self.recording.target.dx_um, self.recording.target.dy_um)

    def repeated(self, again: HeightMap, *, name: str = "repeat") -> Pair:
        """Return the pair with one more recording of the same print, on the target's grid.

        Raises
        ------
        ResultError
            It has no point in common with those that count of the recording.
        """
        repeat = prepare(self.native.target, again, name=name, target_name=self.names[0], wall_px=0)
        same = coarser(replace(repeat, used=repeat.used & self.native.used), self.factor).measured
        if not (self.recording.used & same.measured).any():
            raise ResultError(
                "none of its points counts in the recording as well",
                where=name,
                key="--repeat",
                allowed="allowed: another recording of the same place",
            )
        return replace(self, repeats=(*self.repeats, same))

    def fine(self, values: np.ndarray) -> HeightMap:
        """Return values on working pixels, shape (rows, cols), as a map on the pixels that the pair came on."""
        target, side = self.native.target, np.ones((self.factor, self.factor))
        rows, cols = target.shape
        return target.with_heights(np.kron(values, side)[:rows, :cols])


Pairs = Iterable[Pair | tuple[HeightMap, HeightMap | Alignment]]
"""Targets and recordings: checked, or two maps each, the recording on the target's grid."""


def ready(pairs: Pairs, start: ParameterSet, **settings: Any) -> list[Pair]:
    """Check pairs of maps, with settings of `Pair.of`; what is checked already stays as it is."""
    checked = []
    for number, pair in enumerate(pairs, 1):
        if not isinstance(pair, Pair):
            target, measured = pair
            heights = measured.aligned if isinstance(measured, Alignment) else measured
            pair = Pair.of(target, heights, start, names=(f"target {number}", f"recording {number}"), **settings)
        checked.append(pair)
    return checked
