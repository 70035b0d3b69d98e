"""A recording beside its target: which points count, what is free about its pose, and on which pixels it is worked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dlwpredict.alignment.scars import suspected_scars
from dlwpredict.alignment.spikes import suspected_spikes
from dlwpredict.errors import InputError, ResultError, blaming
from dlwpredict.heightmap import HeightMap, require_same_grid
from dlwpredict.infer.priors import CERTIFIED, LATERAL, LEVELLING, NUISANCES, SCALES
from dlwpredict.metrology.walls import WALL_PX, near_unresolved_walls, near_walls_of_both
from dlwpredict.numerics.continuation import Continuation
from dlwpredict.process import check_target

FEWEST_POINTS = 100
"""Measured points on the part that a fit must at least have, all recordings together: ten for each of the seven
parameters and a levelling. Six empty maps of 150 to 402 such points are called none; the noise of one came out 31 % too
large, that of the others within a tenth."""

KEPT = 0.5
"""Share of the points that count which wide pixels must keep: between many walls, narrower ones are taken."""

PRINTED_PX = 2
"""So near to a wall of the target no prediction is read: the print may have the wall a pixel from there. Nor farther:
what is continued is not what was printed. With one pixel more, stairs a quarter of a pixel to the side were registered
as much as 77 nm off; with one less, the wall itself is read where a part has shrunk."""

SLIGHTLY = 0.2
"""Pixels that a wall does not reach farther for: the scales of target and recording differ by as much."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One aligned recording and its target, ready to be fitted.

    Parameters
    ----------
    name : str
        What the user calls it.
    target, measured : HeightMap
        On one grid.
    used : numpy.ndarray of bool, shape (rows, cols)
        Points that count: measured, not filled, away from walls.
    nuisances : tuple of str
        What is free about it, of `priors.NUISANCES`: all else is trusted.
    scars : int
        Lines of the scan that were left out, in whole or in part.
    width_px : float
        Side of the square over which every height is a mean and the target's is not; 0 where that is not known.
    unsaid_px : float
        Side of a pixel of which nobody says whether its height is that of a point or a mean; 0 where that is known.
    """

    name: str
    target: HeightMap
    measured: HeightMap
    used: np.ndarray = field(repr=False)
    nuisances: tuple[str, ...] = ()
    scars: int = 0
    width_px: float = 0.0
    unsaid_px: float = 0.0

    @property
    def heights_um(self) -> np.ndarray:
        """Measured heights at the used points, shape (points,)."""
        return self.measured.heights_um[self.used]

    @property
    def points(self) -> int:
        """Number of used points."""
        return int(self.used.sum())

    @cached_property
    def across_walls(self) -> Continuation:
        """How a prediction goes on from the points that count into walls.

        One is moved by reading it between its pixels. Beside a wall that must not be read: it may be printed a pixel
        from where the target has it, and moves with the parameters. A steep flank that pixels resolve is read: nothing
        tells how a wave goes on.
        """
        return Continuation.across(near_unresolved_walls(self.target, PRINTED_PX) & ~self.used)

    @property
    def scans(self) -> bool:
        """Whether it is known to be scanned line by line, and in which direction."""
        return self.measured.instrument.fast_axis_deg is not None

    @property
    def scanned_axes(self) -> tuple[int, ...]:
        """Whether lines of the scan may be rows (0) or columns (1) of the map: both where that is not known."""
        fast = self.measured.instrument.fast_axis_deg
        return (0, 1) if fast is None else (int(abs(np.cos(np.deg2rad(fast))) < np.sqrt(0.5)),)

    @property
    def lean(self) -> float:
        """Lines of the scan that a row, or a column where it runs along columns, crosses per pixel; 0 if not known.

        A line along θ has the same row + tan θ·(dx/dy)·column, rows counted downwards.
        """
        fast = self.measured.instrument.fast_axis_deg
        if fast is None:
            return 0.0
        across, up = np.cos(np.deg2rad(fast)) * self.target.dy_um, np.sin(np.deg2rad(fast)) * self.target.dx_um
        return float(up / across if self.scanned_axes == (0,) else across / up)

    @property
    def stretched(self) -> float:
        """Share by which an alignment has stretched both axes, which may be the print's; 0 within a certificate."""
        share = 1 - self.measured.instrument.scale
        return share if share > CERTIFIED else 0.0

    @property
    def left_open(self) -> np.ndarray:
        """Standard deviations of what an alignment leaves of the nuisances, `priors.NUISANCES`, in their order.

        Where a print that shrinks may have been stretched, it may as well not have been.
        """
        return np.array([max(NUISANCES[name], self.stretched * (name in SCALES)) for name in self.nuisances])

    @property
    def read_px(self) -> float:
        """Pitch of the instrument's pixels between which a map was read, in pixels of the map; 0: they are the same."""
        return (self.measured.instrument.pitch_um or 0.0) / float(np.sqrt(self.target.dx_um * self.target.dy_um))

    def away_from_walls(self, wall_px: int) -> Recording:
        """Return the recording without the points so near to a wall."""
        near = near_walls_of_both(self.target, self.measured, seen_px(wall_px, self.measured))
        return replace(self, used=self.used & ~near)

    def on_map(self, values: np.ndarray) -> np.ndarray:
        """Return values at the used points as a map, 0 elsewhere, shape (..., rows, cols)."""
        maps = np.zeros((*values.shape[:-1], *self.used.shape))
        maps[..., self.used] = values
        return maps


def prepare(
    target: HeightMap,
    measured: HeightMap,
    *,
    name: str = "recording",
    target_name: str = "target",
    wall_px: int = WALL_PX,
    free_shift: bool = True,
) -> Recording:
    """Check a pair and choose the points that count.

    Its registration is free within what an alignment leaves, which must not bend the parameters, unless `free_shift` is
    off; its levelling where its heights are relative.

    Raises
    ------
    InputError
        Nothing written, negative or missing target heights, different grids.
    ResultError
        No measured point left.
    """
    with blaming(target_name):
        _check_target(target, measured)
    require_same_grid(target, measured, (target_name, name))
    beside = seen_px(wall_px, measured)
    used = measured.measured & ~near_walls_of_both(target, measured, beside)
    if not used.any():
        raise ResultError(
            f"none of {int(measured.measured.sum())} measured points lies {beside} px away from walls",
            where=name,
            key="heights",
            allowed="use a smaller --wall-px or a structure with slopes",
        )
    nuisances = [nuisance for nuisance in trusted(measured) if free_shift or nuisance not in LATERAL]
    # `align` reads means over the target's pixels; of other maps it is not known
    aligned = float(measured.instrument.pitch_um is not None)
    return Recording(name, target, measured, used, tuple(nuisances), width_px=aligned, unsaid_px=1 - aligned)


def seen_px(wall_px: int, measured: HeightMap) -> int:
    """Return how many pixels of a map a wall reaches: as many of the instrument's, where those are wider.

    Examples
    --------
    >>> from dlwpredict.heightmap import Instrument
    >>> seen_px(3, HeightMap(np.zeros((4, 4)), 0.3, 0.3, instrument=Instrument(pitch_um=0.4)))
    4
    """
    pitch_um = min(measured.dx_um, measured.dy_um)
    return int(np.ceil(wall_px * max((measured.instrument.pitch_um or pitch_um) / pitch_um, 1.0) - SLIGHTLY))


def trusted(measured: HeightMap) -> tuple[str, ...]:
    """Return the nuisances of a recording whose heights are taken at their word."""
    return (*(LEVELLING if measured.height_reference == "relative" else ()), *LATERAL)


def doubted(recording: Recording) -> Recording:
    """Return the recording with every nuisance free: what levelling and pixels do must not pass for physics."""
    return replace(recording, nuisances=tuple(NUISANCES))


def _check_target(target: HeightMap, measured: HeightMap) -> None:
    """Refuse a target that cannot be written, and say so where the recording in its place could be."""
    try:
        check_target(target)
    except InputError as error:
        try:
            check_target(measured)
        except InputError:
            raise error from None
        allowed = f"{error.allowed}; are target and recording exchanged?"
        raise type(error)(error.what, key=error.key, allowed=allowed) from None


def require_points(recordings: Sequence[Recording]) -> None:
    """Refuse a recording on which no point counts.

    Raises
    ------
    ResultError
    """
    for recording in recordings:
        if not recording.points:
            raise ResultError(
                "no measured point away from walls is left",
                where=recording.name,
                key="heights",
                allowed="use a smaller --wall-px or --working-pitch-um",
            )


def check_points(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that leave fewer points than a fit needs.

    Raises
    ------
    ResultError
        Fewer than `FEWEST_POINTS`, or none at all on one of them.
    """
    require_points(recordings)
    points = sum(int((r.used & (r.target.heights_um > 0)).sum()) for r in recordings)
    if points < FEWEST_POINTS:
        raise ResultError(
            f"{points} measured points on the part and away from walls",
            where=recordings[0].name,
            key="heights",
            allowed=f"at least {FEWEST_POINTS} in all recordings together",
        )


def without_outliers(recording: Recording, residual_um: np.ndarray, predicted_um: np.ndarray) -> Recording:
    """Return the recording without what stands out of its residual: lone points, and scars where it is a scan.

    Parameters
    ----------
    recording : Recording
    residual_um : numpy.ndarray, shape (rows, cols)
        Recording − prediction, 0 where a point does not count.
    predicted_um : numpy.ndarray, shape (rows, cols)
        Where the prediction bends from line to line, so may its misfit.
    """
    used, count = recording.used, 0
    if recording.scans:
        (axis,) = recording.scanned_axes
        scars = suspected_scars(residual_um, used, predicted_um, axis)
        used, count = used & ~scars, int(scars.any(axis=1 - axis).sum())
    return replace(recording, used=used & ~suspected_spikes(residual_um, used), scars=count)


def coarser(recording: Recording, factor: int) -> Recording:
    """Return the pair on pixels ``factor`` times as wide; a wide pixel counts where most of it counted.

    Where some of it did not, what is measured is by how much recording and target differ: on a slope, the mean height
    of some of its points is not that of all. At the rim the target is completed with empty resin.
    """
    if factor == 1:
        return recording
    counts = _blocks(recording.used.astype(float), factor)
    differences = recording.measured.heights_um - recording.target.heights_um
    difference = _blocks(np.where(recording.used, differences, 0.0), factor)
    wide, used = _blocks(recording.target.heights_um, factor), counts > 0.5
    measured = np.where(used, wide + difference / np.where(used, counts, 1), np.nan)

    def on_grid(values: np.ndarray) -> HeightMap:
        grid = recording.target
        return HeightMap(values, grid.dx_um * factor, grid.dy_um * factor, recording.measured.height_reference)

    target = replace(on_grid(wide), height_reference="substrate")
    shown = replace(on_grid(measured), instrument=recording.measured.instrument)
    # of target and recording alike the block is the mean: only what the recording was a mean over before is its own
    width_px, unsaid_px = recording.width_px / factor, recording.unsaid_px / factor
    return Recording(recording.name, target, shown, used, recording.nuisances, width_px=width_px, unsaid_px=unsaid_px)


def keeps_most(recording: Recording, wide: Recording, factor: int) -> bool:
    """Tell whether a recording on pixels so many times as wide keeps most of what counts."""
    return wide.points * factor**2 > KEPT * recording.points


def _blocks(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the means over blocks of factor × factor pixels, zeros beyond the map."""
    padded = np.pad(values, [(0, -n % factor) for n in values.shape])
    rows, cols = (n // factor for n in padded.shape)
    return padded.reshape(rows, factor, cols, factor).mean(axis=(1, 3))
