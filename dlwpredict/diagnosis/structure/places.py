"""Where a residual differs from noise: maps of significance, and places in words with boxes around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlwpredict.diagnosis.structure.blemishes import Blemish
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Beside, Energy, Forms
from dlwpredict.diagnosis.structure.ripple import Ripple
from dlwpredict.diagnosis.structure.spots import SURE, Bumps, Spot, mismatch, patch
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.objective import Fit
from dlwpredict.infer.whitened import Whitened

SIMPLER = 0.8
"""Simpler families of forms are named where they explain this share of what better ones do."""

MOST_PLACES = 3
"""Places named per recording."""

WHERE = {
    "radius": "with the distance from the centre",
    "height": "with the height of the part",
    "x": "along x, the hatch direction",
    "y": "along y, the scan direction",
    "slope": "on slopes",
    "curvature": "on ridges and in grooves",
    "left edges": "left edges, where hatching begins, and up the hatch direction",
    "right edges": "right edges, where hatching ends, and down the hatch direction",
    "lower edges": "lower edges, where lines start, and up the scan direction",
    "upper edges": "upper edges, where lines end, and down the scan direction",
    "place": "in one place",
}
"""Families of free forms in words, the simplest first."""


@dataclass(frozen=True)
class Place:
    """One place of the mismatch.

    Parameters
    ----------
    pair : int
    where : str
        In words.
    share : float
        Share of the energy beyond noise, of all recordings together.
    p_value : float
    x_um, y_um : tuple of float
        Box around it, from the map's centre, y upwards.
    """

    pair: int
    where: str
    share: float
    p_value: float
    x_um: tuple[float, float]
    y_um: tuple[float, float]


def locate(
    fitted: Fit,
    forms: Forms,
    beside: Beside,
    bumps: Sequence[Bumps],
    patterns: Sequence[Ripple | Spot | Columns],
    blemishes: Sequence[Blemish] = (),
) -> tuple[list[Place], list[np.ndarray]]:
    """Name the places of a fit's mismatch, the largest share first; and return the maps of `mismatch`.

    Patterns that are more than noise are places, too: a spot where free forms have not found it, waves and columns over
    the whole map, for no form follows them. So is every blemish that was left out of the fit.
    """
    lone = next((pattern for pattern in patterns if isinstance(pattern, Spot)), None)
    wide = [pattern for pattern in patterns if not isinstance(pattern, Spot)]
    whole = max(beside.energy().excess, lone.excess if lone else 0.0, 0.0) + sum(pattern.excess for pattern in wide)
    whole = max(whole + sum(one.excess for one in blemishes), 1e-9)
    places, maps = [], []
    for k, item in enumerate(fitted.data):
        score = bumps[k].scores(fitted.residual[fitted.rows.of(k)])
        maps.append(mismatch(score, item.recording.used))
        families = _families(forms, beside, k)
        if lone and lone.pair == k and "place" not in dict(families):
            families.append(("place", Energy(lone.excess, lone.p_value)))
        for family, energy in families:
            x_um, y_um, middle = _box(item, score, maps[-1], local=family == "place")
            where = f"around x = {middle[0]:.1f}, y = {middle[1]:.1f} µm" if family == "place" else WHERE[family]
            share = float(np.clip(energy.excess / whole, 0, 1))
            places.append(Place(k, where, share, energy.p_value, x_um, y_um))
    for pattern in wide:
        x_um, y_um = _outline(fitted.data[pattern.pair].recording.target)
        share = float(np.clip(pattern.excess / whole, 0, 1))
        places.append(Place(pattern.pair, pattern.where, share, pattern.p_value, x_um, y_um))
    for one in blemishes:
        where, share = f"around x = {one.x_um:.1f}, y = {one.y_um:.1f} µm", float(np.clip(one.excess / whole, 0, 1))
        box = _ends(fitted.data[one.pair].recording.target, one.points.astype(float))
        places.append(Place(one.pair, where, share, one.p_value, *box))
        maps[one.pair] = np.where(one.points, 1.0, maps[one.pair])
    return sorted(places, key=lambda place: -place.share), maps


def _outline(grid: HeightMap) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of a map in x and y, µm."""
    width, depth = grid.size_um
    return (-width / 2, width / 2), (-depth / 2, depth / 2)


def _families(forms: Forms, beside: Beside, k: int) -> list[tuple[str, Energy]]:
    """Return the families that a recording's mismatch follows, each beside those before it.

    Places come first where the wide families together explain much less than places alone do.
    """
    families = [family for family in WHERE if family in forms.families[k]]
    wide = _following(forms, beside, k, [family for family in families if family != "place"])
    local = beside.energy(forms.places[k, "place"]).excess
    if sum(gained.excess for _, gained in wide) >= SIMPLER * local:
        return wide
    return _following(forms, beside, k, ["place"]) + wide[: MOST_PLACES - 1]


def _following(forms: Forms, beside: Beside, k: int, left: list[str]) -> list[tuple[str, Energy]]:
    """Return families by how much more of the mismatch each explains, as long as that is more than noise."""
    level = 0.05 / (len(WHERE) * len(forms.families))
    columns, known, before = forms.places, np.zeros(0, dtype=int), 0.0
    followed: list[tuple[str, Energy]] = []
    while left and len(followed) < MOST_PLACES:
        joint = {family: beside.energy(np.append(known, columns[k, family])).excess - before for family in left}
        best = max(joint.values())
        if best <= 0:
            break
        family = next(f for f in left if joint[f] >= SIMPLER * best)
        gained = Energy(joint[family], beside.energy(columns[k, family]).p_value)
        if gained.p_value > level or gained.excess < max(0.1 * before, 6.0):
            break
        followed.append((family, gained))
        known, before = np.append(known, columns[k, family]), before + gained.excess
        left = [name for name in left if name != family]
    return followed


def _box(
    item: Whitened, score: np.ndarray, sure: np.ndarray, *, local: bool
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """Return the box (x, y) around the mismatch, and its strongest point, µm.

    A local mismatch is the connected region about the strongest score; a wide one is where the middle 95 % of the
    energy in sure pixels lie.
    """
    grid, strength = item.recording.target, np.abs(score).max(axis=0)
    row, col = np.unravel_index(np.argmax(np.where(item.recording.used, strength, 0)), strength.shape)
    region = sure >= SURE
    if local or not region.any():
        region = patch(sure, int(row), int(col))
    return *_ends(grid, np.where(region, strength**2, 0.0)), (float(grid.x_um[col]), float(grid.y_um[row]))


def _ends(grid: HeightMap, weight: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return between which x and which y the middle 95 % of weights (rows, cols) lie, µm."""

    def ends(positions: np.ndarray, weights: np.ndarray, pitch: float) -> tuple[float, float]:
        order = np.argsort(positions)
        share = np.cumsum(weights[order]) / weights.sum()
        low, high = positions[order][np.searchsorted(share, (0.025, 0.975))]
        return float(low - pitch / 2), float(high + pitch / 2)

    return ends(grid.x_um, weight.sum(axis=0), grid.dx_um), ends(grid.y_um, weight.sum(axis=1), grid.dy_um)
