"""Refractive and stepped lenses."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dlwpredict.designs.base import Base, Footprint, Relief, design, number, um
from dlwpredict.errors import InputError

Sag = Annotated[float | None, um(0.0, 500.0, "sag of the cap; 5 µm unless radius_um is given")]
Radius = Annotated[float | None, um(0.01, 1e6, "radius of curvature at the apex, instead of height_um")]
Parabolic = Annotated[bool, number(0, 1, "paraboloid instead of a sphere")]


def sphere(r_um: np.ndarray, aperture_um: float, sag_um: float) -> np.ndarray:
    """Spherical cap: √(R² − r²) − (R − sag), R = (a² + sag²)/(2 sag); 0 beyond the aperture radius a, all in µm."""
    if sag_um == 0:
        return np.zeros_like(r_um)
    radius = (aperture_um**2 + sag_um**2) / (2 * sag_um)
    cap = np.sqrt(np.maximum(radius**2 - r_um**2, 0)) - (radius - sag_um)
    return np.where(r_um < aperture_um, np.maximum(cap, 0), 0.0)


def paraboloid(r_um: np.ndarray, aperture_um: float, sag_um: float) -> np.ndarray:
    """Paraboloid sag·(1 − r²/a²) with apex radius a²/(2 sag); 0 beyond the aperture radius a, all in µm."""
    return sag_um * np.maximum(1 - (r_um / aperture_um) ** 2, 0)


def sag_of(aperture_um: float, height_um: float | None, radius_um: float | None, *, parabolic: bool) -> float:
    """Return the sag in µm from whichever of sag and radius of curvature was given.

    Raises
    ------
    InputError
        Both are given, or the cap would exceed a half sphere.
    """
    if height_um is not None and radius_um is not None:
        raise InputError("given beside height_um", key="radius_um", allowed="give one of the two")
    if radius_um is None:
        sag_um = 5.0 if height_um is None else height_um
        if not parabolic and sag_um > aperture_um:
            raise InputError(
                f"found {sag_um:g}",
                key="height_um",
                allowed=f"at most the half sphere over this aperture, {aperture_um:g} µm",
            )
        return sag_um
    if parabolic:
        return aperture_um**2 / (2 * radius_um)
    if radius_um < aperture_um:
        raise InputError(
            f"found {radius_um:g}", key="radius_um", allowed=f"at least the radius of the aperture, {aperture_um:g} µm"
        )
    return radius_um - np.sqrt(radius_um**2 - aperture_um**2)


@design("one lens: spherical cap or paraboloid on a square plate", size_um=50.0)
def lens(
    at: Footprint,
    *,
    base_um: Base = 2.0,
    height_um: Sag = None,
    radius_um: Radius = None,
    parabolic: Parabolic = False,
) -> np.ndarray:
    """Lens in the circle inscribed in the footprint, on a plate of height ``base_um``."""
    aperture = at.side_um / 2
    sag = sag_of(aperture, height_um, radius_um, parabolic=parabolic)
    return base_um + (paraboloid if parabolic else sphere)(at.radius_um, aperture, sag)


@design("square array of lenses on a plate", size_um=60.0)
def lens_array(
    at: Footprint,
    *,
    base_um: Base = 2.0,
    height_um: Sag = None,
    radius_um: Radius = None,
    parabolic: Parabolic = False,
    count: Annotated[int, number(1, 1000, "lenses along each side")] = 3,
    gap_um: Annotated[float, um(0.0, 1000.0, "least distance between neighbouring lenses")] = 1.0,
) -> np.ndarray:
    """``count`` x ``count`` equal lenses, each centred in a square cell.

    Raises
    ------
    InputError
        The gap leaves less than two pixels for a lens.
    """
    cell = at.side_um / count
    aperture = (cell - gap_um) / 2
    at.require_resolved("gap_um: lens of", 2 * aperture)
    sag = sag_of(aperture, height_um, radius_um, parabolic=parabolic)
    _, _, across, along = at.cells(count, count)
    return base_um + (paraboloid if parabolic else sphere)(np.hypot(across, along), aperture, sag)


@design("Fresnel lens: a paraboloid folded into rings of equal height", size_um=60.0)
def fresnel(
    at: Footprint,
    *,
    base_um: Base = 2.0,
    height_um: Relief = 2.0,
    zones: Annotated[int, number(1, 1000, "rings, the central disc included")] = 5,
) -> np.ndarray:
    """Rings of the radii a·√(k/zones), each falling from ``height_um`` to 0 as height·(1 − frac(zones·r²/a²)).

    It is the paraboloid of apex radius a²/(2·zones·height) with whole multiples of the height taken out; a is half
    the side.

    Raises
    ------
    InputError
        The outermost ring is below two pixels.
    """
    aperture = at.side_um / 2
    at.require_resolved("zones: outer ring", aperture * (1 - np.sqrt(1 - 1 / zones)))
    order = zones * (at.radius_um / aperture) ** 2
    return base_um + np.where(order < zones, height_um * (1 - order % 1), 0.0)
