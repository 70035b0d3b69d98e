"""Which further recording would tell apart what the present ones cannot.

Every recording that could be made is simulated with the fitted process, noise and nuisances included. Two effects are
as far apart as what is left of one, over the present recordings and the new one together, once the parameters, the
nuisances and any strength of the other have imitated what they can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby, permutations

import numpy as np
from scipy import ndimage

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.answer.setups import Setup, setups_for
from dlwpredict.effects.base import Effect
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import Free
from dlwpredict.infer.objective import STEP_OF_RANGE, STEP_OF_VALUE, Fit, Nuisances, Objective
from dlwpredict.infer.recording import doubted, prepare
from dlwpredict.infer.registration import registered
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.trace import trace
from dlwpredict.infer.whitened import UNMOVED, Whitened, steepness
from dlwpredict.metrology.walls import WALL_PX
from dlwpredict.model.levels import Levels
from dlwpredict.noise.covariance import FLOOR
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import ParameterSet

ALIKE = policy.FORM_ERROR**0.5
"""Share of a signature by which its formula may be wrong; no two are told apart by less."""

SURE = 5.0
"""Standard deviations at which two effects count as told apart; nothing dearer is then looked for ..."""

LEAST = 3.0
"""... and below which a recording is not worth making."""

MORE = 1.2
"""A turn must bring this many times what recording the same once more would: else it is no better than any repeat."""

FINE_PX, ROUGH_PX = 160, 100
"""Simulated maps have at most this many pixels a side; fewer where many setups are compared first."""

MOST_FINE = 4
"""More setups of one cost than this are compared on rough pixels, and the best `BEST` of them on fine ones: lags and
slopes look further apart on rough pixels than they are."""

BEST = 3


@dataclass(frozen=True)
class Advice:
    """What to record next.

    Parameters
    ----------
    sentence : str
        For the bench.
    command : str or None
        Makes the design, where it is a new one.
    separation : float
        Expected standard deviations between the closest two members.
    setup : str
        Short name; "none" where nothing that was simulated helps.
    """

    sentence: str
    command: str | None
    separation: float
    setup: str


@dataclass(frozen=True)
class Separation:
    """How far apart the closest two members of a class are.

    Parameters
    ----------
    pair : (int, int)
        Which two; the first is seen, the second imitates it.
    sd : float
        Standard deviations.
    share : float
        The same as a share of the signature that can be seen at all.
    """

    pair: tuple[int, int]
    sd: float
    share: float

    @property
    def worth(self) -> float:
        """At least 1 where the two count as told apart; no formula is trusted further than `ALIKE`."""
        return min(self.sd / SURE, self.share / ALIKE)


def advise(fitted: Fit, members: Sequence[Effect], *, setups: Sequence[Setup] | None = None) -> Advice | None:
    """Find the recording that would separate effects which these data cannot tell apart.

    Parameters
    ----------
    fitted : Fit
        The baseline, without the members.
    members : sequence of Effect
        Each at its fitted strength.
    setups : sequence of Setup, optional
        What could be recorded; default `setups_for`.

    Returns
    -------
    Advice or None
        None for fewer than two members. The cheapest recording that is enough, else the one that separates best.
    """
    if len(members) < 2:
        return None
    columns = present_columns(fitted, members)
    present = fitted.nuisances.triangle(columns)
    simulate = simulator(fitted, members)
    free = len(fitted.free.names)

    def expected(setup: Setup, *, rough: bool = False) -> Separation:
        return separation(np.vstack([present, simulate(setup, rough)]), free)

    candidates: list[tuple[Setup, Separation]] = []
    possible = setups_for(fitted, members, columns) if setups is None else setups
    for _, group in groupby(sorted(possible, key=lambda setup: setup.cost), key=lambda setup: setup.cost):
        equal = list(group)
        if len(equal) > MOST_FINE:
            equal = sorted(equal, key=lambda setup: -expected(setup, rough=True).worth)[:BEST]
        for setup in equal:
            apart = expected(setup)
            if not (setup.print_turns or setup.view_turns) or apart.sd > MORE * expected(setup.unturned).sd:
                candidates.append((setup, apart))
        if any(apart.worth >= 1 for _, apart in candidates):
            break
    best = max(candidates, key=lambda item: item[1].worth, default=None)
    return worded(members, separation(present, free), best)


def separation(rows: np.ndarray, free: int) -> Separation:
    """Return how far the closest two members are apart.

    Parameters
    ----------
    rows : numpy.ndarray, shape (rows, free + members)
        Whitened derivatives by the free parameters, then the signatures, beside the nuisances.
    free : int
    """
    unit = rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    parameters = range(free)
    apart = []
    for pair in permutations(range(rows.shape[1] - free), 2):
        seen, imitator = (free + member for member in pair)
        visible = np.linalg.norm(_left(rows[:, seen], unit[:, parameters]))
        sd = np.linalg.norm(_left(rows[:, seen], unit[:, [*parameters, imitator]]))
        apart.append(Separation(pair, float(sd), float(sd / np.maximum(visible, 1e-12))))
    return min(apart, key=lambda pair: pair.worth)


def _left(values: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return what the columns cannot imitate."""
    return values - columns @ np.linalg.lstsq(columns, values, rcond=1e-6)[0]


def present_columns(fitted: Fit, members: Sequence[Effect]) -> np.ndarray:
    """Return whitened derivatives and signatures on the present recordings, shape (rows, free + members)."""
    parameters, white = fitted.parameters, []
    for k, (item, known) in enumerate(zip(fitted.data, fitted.traces, strict=True)):
        changed = [trace(item.recording.target, _with(parameters, m), known.numerics, known) for m in members]
        white.append(fitted.seen(k, np.nan_to_num([new.heights_um - known.heights_um for new in changed])))
    return np.column_stack([fitted.jacobian, fitted.rows.stack(white)])


def simulator(fitted: Fit, members: Sequence[Effect]) -> Callable[[Setup, bool], np.ndarray]:
    """Return the function that simulates a setup, on rough pixels or not: its triangle, as of `present_columns`."""
    parameters, vector = fitted.parameters, fitted.vector
    moved = [neighbour(fitted.free, vector, k) for k in range(len(vector))]
    widths = np.array([place[k] - vector[k] for k, place in enumerate(moved)])
    sets = [parameters, *(fitted.free.parameters(place) for place in moved), *(_with(parameters, m) for m in members)]
    present = {item.recording.target: item for item in fitted.data}
    numerics = Levels()
    resized = cache(fewer_pixels)

    @cache
    def printed(target: HeightMap, turns: int) -> tuple[Whitened, list[HeightMap]]:
        """Print a target with every set of parameters; surfaces in the frame of the sample."""
        written, first, surfaces = turned(target, turns), None, []
        for each in sets:
            made = trace(written, _printing(each), numerics, first)
            first = first or made
            surfaces.append(turned(written.with_heights(made.heights_um), -turns))
        item = present[target] if target in present else simulated(target, surfaces[0], fitted)
        return item, surfaces

    def simulate(setup: Setup, rough: bool) -> np.ndarray:
        target = resized(setup.target, ROUGH_PX if rough else FINE_PX)
        item, surfaces = printed(target, setup.print_turns)
        seen = np.stack([viewed(s, each, setup.view_turns) for s, each in zip(surfaces, sets, strict=True)])
        changes = np.nan_to_num(seen[1:] - seen[0])
        changes[: len(widths)] /= widths[:, None, None]
        rows, nuisances = nuisances_of(item, np.nan_to_num(seen[0]))
        return nuisances.triangle(rows.stack([item.white(changes)]))

    return simulate


def simulated(target: HeightMap, surface: HeightMap, fitted: Fit) -> Whitened:
    """Return a recording of a simulated surface with the noise of the present ones.

    The width left out at walls is theirs too.
    """
    item = sorted(fitted.data, key=lambda item: item.noise.sigma_um)[len(fitted.data) // 2]
    noise = on_pixels(item.noise, target)
    even = item.noise.even
    wall_px = max(round(WALL_PX * max(even.dx_um, even.dy_um) / max(target.dx_um, target.dy_um)), 1)
    recording = doubted(prepare(target, surface, wall_px=wall_px))
    return Whitened.of(recording, noise, steepness(surface.heights_um, target))


def nuisances_of(item: Whitened, shown_um: np.ndarray) -> tuple[Rows, Nuisances]:
    """Return the rows of a single recording that shows just this, and its nuisances about it."""
    measured = item.recording.target.with_heights(shown_um)
    item = replace(item, recording=replace(item.recording, measured=measured), place=UNMOVED)
    rows, solution = Objective((item,)).rows, registered(item, shown_um)
    return rows, Nuisances(rows, (solution.above,), (solution.below,))


def fewer_pixels(part: HeightMap, most: int) -> HeightMap:
    """Return a map with at most so many pixels a side, read by linear interpolation; the same where it is small."""
    ratio = max(part.shape) / most
    if ratio <= 1:
        return part
    places = [(np.arange(int(n / ratio + 1e-9)) + 0.5) * ratio - 0.5 for n in part.shape]
    read = ndimage.map_coordinates(part.heights_um, np.meshgrid(*places, indexing="ij"), order=1)
    return HeightMap(read, part.dx_um * ratio, part.dy_um * ratio)


def on_pixels(noise: Uneven, grid: HeightMap) -> Uneven:
    """Return the noise on other pixels: its white part averages out over wider ones."""
    even = noise.even
    share = np.sqrt(even.dx_um * even.dy_um / (grid.dx_um * grid.dy_um))
    white = max(even.white_um * share, FLOOR * even.sigma_um)
    return replace(noise, even=replace(even, white_um=white, dx_um=grid.dx_um, dy_um=grid.dy_um))


def neighbour(free: Free, vector: np.ndarray, k: int) -> np.ndarray:
    """Return a place one finite step along parameter k, inside the bounds, shape (parameters,)."""
    size = max(STEP_OF_RANGE * (free.high[k] - free.low[k]), STEP_OF_VALUE * abs(vector[k]))
    unit = np.eye(len(vector))[k]
    return max((free.allowed(vector + s * unit) for s in (size, -size)), key=lambda place: abs(place[k] - vector[k]))


def turned(part: HeightMap, quarters: int) -> HeightMap:
    """Return a map turned counter-clockwise by quarter turns."""
    dx_um, dy_um = (part.dx_um, part.dy_um) if quarters % 2 == 0 else (part.dy_um, part.dx_um)
    return HeightMap(np.rot90(part.heights_um, quarters), dx_um, dy_um)


def viewed(surface: HeightMap, parameters: ParameterSet, quarters: int) -> np.ndarray:
    """Return what the microscope shows of a turned sample, turned back, µm, shape (rows, cols)."""
    shown = turned(surface, quarters)
    for effect in parameters.effects:
        if effect.stage == "recording":
            shown = effect(shown)
    return turned(shown, -quarters).heights_um


def _with(parameters: ParameterSet, effect: Effect) -> ParameterSet:
    return replace(parameters, effects=(*parameters.effects, effect))


def _printing(parameters: ParameterSet) -> ParameterSet:
    """Return the process without what only the microscope does."""
    return replace(parameters, effects=tuple(e for e in parameters.effects if e.stage != "recording"))


def worded(members: Sequence[Effect], now: Separation, best: tuple[Setup, Separation] | None) -> Advice:
    """Say what to record, and what to expect of it."""
    if best is None or best[1].worth < LEAST / SURE:
        pair = _pair(members, best[1] if best else now)
        tried = f" (best: {best[0].name}, {_expected(best[1])})" if best else ""
        others = "; or ".join(dict.fromkeys(member.separated_by for member in members))
        sentence = f"No recording that was simulated tells {pair} apart{tried}. What can: {others}."
        return Advice(sentence, None, max(best[1].sd if best else 0.0, now.sd), "none")
    setup, apart = best
    sentence = f"{setup.action}: {_pair(members, apart)} are then {_expected(apart)}, now {_number(now.sd)}."
    return Advice(sentence, setup.command, apart.sd, setup.name)


def _pair(members: Sequence[Effect], apart: Separation) -> str:
    first, second = (members[k].name for k in sorted(apart.pair))
    return f"{first} and {second}" + (f" (the closest two of {len(members)})" if len(members) > 2 else "")


def _expected(apart: Separation) -> str:
    small = f", but by only {100 * apart.share:.0f} % of the effect" if apart.share < ALIKE else ""
    return f"expected {_number(apart.sd)} standard deviations apart{small}"


def _number(sd: float) -> str:
    return f"{sd:.0f}" if sd >= 10 else f"{sd:.1f}"
