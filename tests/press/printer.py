"""The press: write, cure, cross-link, shrink.

In symbols:

E = focus * [solid D_f^N]              (the solid continues below z = 0 where something is written)
u = D^N E / (P P')                     D, D_f: relative intensity at the point, at the focus; N: photon order;
                                       P': local factor on the threshold
exposed: u >= 1, found between the voxels; or the gel fraction u^c / (1 + u^c) with a finite contrast c
C = cross-linking Gaussian (and a share of one twice as wide) * [exposed (1 + eta (D^N - 1)) cure(u)],  z >= 0 only
kappa = kappa_min + (kappa_max - kappa_min) C / max C
kappa -> 1 - (1 - kappa) (1 + pinning exp(-z / pin_height)),  averaged over the exposed part of the column
printed height = kappa * exposed height
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, ndtr

from tests.press import focus
from tests.press.effect import Scene, make
from tests.press.gauss import SIGMA_PER_FWHM, along_z, lateral
from tests.press.grid import GHOSTS, plane_grid, with_layers
from tests.press.voxels import fill_fractions, peak, solid_shares, with_true_moment

THICKEST_LAYER_UM = 0.15


@dataclass(frozen=True)
class Press:
    """A machine and its resin. Lengths in um, the rest without unit; defaults are the paper's."""

    focus_fwhm_xy_um: float = 0.5
    focus_fwhm_z_um: float = 1.5
    focus_profile: str = "gaussian"  # or gauss-lorentz
    focus_tails: float = 0.0  # 0-1, share of the energy that a Gaussian-Lorentzian focus has beside the profile's
    threshold: float = 0.5  # share of the dose inside a large block
    contrast: float = 0.0  # gel curve exponent, 0 = all or nothing; resins: 5-30
    dose_conversion: float = 0.0  # 0-1, how much of the conversion follows the dose above the threshold
    crosslink_fwhm_xy_um: float = 7.0
    crosslink_fwhm_z_um: float = 7.0
    crosslink_tails: float = 0.0  # 0-1, share of the cross-linking that reaches twice as far
    crosslink_reference: str = "structure_maximum"  # or bulk
    shrinkage_min: float = 0.7
    shrinkage_max: float = 1.0
    pinning: float = 0.0  # a layer that the base holds laterally shrinks so much more in height, 2 nu / (1 - nu)
    pin_height_um: float = 3.0
    slicing_um: float = 0.0  # 0 = continuous heights
    slicing_phase: float = 0.5  # 0.5 rounds to the nearest layer, 0 cuts down to it
    photon_order: float = 2.0  # N
    conversion: float = 0.0  # eta, unless a dose effect brings its own
    dz_um: float = 0.0  # 0 = chosen from the focus
    margin_um: float = 0.0  # substrate added around the target in the printed map
    part_at_um: tuple = (0.0, 0.0)  # where the target's centre lies in the printer's field
    quarter_turns: int = 0  # how often the part is turned counter-clockwise in the printer; it is returned turned back
    effects: tuple = ()

    def __post_init__(self):
        choices = {"focus_profile": tuple(focus.PROFILES), "crosslink_reference": ("structure_maximum", "bulk")}
        for key, allowed in choices.items():
            if getattr(self, key) not in allowed:
                raise ValueError(f"press.{key}: {getattr(self, key)}, allowed are {', '.join(allowed)}")
        for key in ("focus_fwhm_xy_um", "focus_fwhm_z_um", "threshold", "crosslink_fwhm_xy_um", "crosslink_fwhm_z_um"):
            if not getattr(self, key) > 0:
                raise ValueError(f"press.{key}: {getattr(self, key)}, must be positive")


def print_part(heights, dx_um, dy_um, press=None):
    """Print a target and return the printed heights in um on the same pixels (wider by `margin_um` on every side).

    Parameters
    ----------
    heights : array
        Target heights in um, row 0 at the top (y grows upwards).
    dx_um, dy_um : float
        Pixel pitches.
    press : Press, optional
        The machine; its effects may be dicts.
    """
    press = press or Press()
    effects = tuple(make(entry) for entry in press.effects)
    heights = np.asarray(heights, float)
    if not np.isfinite(heights).all() or heights.min() < 0:
        raise ValueError("target: heights must be finite and not below the substrate")
    dx, dy = (dx_um, dy_um) if press.quarter_turns % 2 == 0 else (dy_um, dx_um)
    keep, pad = _frame(press, dx, dy)
    target = np.pad(np.rot90(heights, press.quarter_turns)[::-1], [(pad[0],) * 2, (pad[1],) * 2])
    grid = plane_grid(target.shape, dx, dy, press.part_at_um)
    printed = _print(target, grid, press, effects) if target.any() else target
    cut = tuple(slice(p - k, n - p + k) for p, k, n in zip(pad, keep, target.shape, strict=True))
    return np.rot90(printed[cut][::-1], -press.quarter_turns).copy()


def _frame(press, dx, dy):
    """Return rows and columns to keep around the target, and to compute around it."""
    widest = max(2.0, 5 * press.focus_fwhm_xy_um * SIGMA_PER_FWHM)
    keep = tuple(round(press.margin_um / pitch) for pitch in (dy, dx))
    pad = tuple(k + int(np.ceil(widest / pitch)) for k, pitch in zip(keep, (dy, dx), strict=True))
    return keep, pad


def _print(target, grid, press, effects):
    """Run the stages on a padded target with rows upwards."""
    scene = _scene(target, grid, press, effects)
    here = _product(scene, [item for item in effects if not item.at_focus], "dose") ** press.photon_order
    sent = _product(scene, [item for item in effects if item.at_focus], "dose") ** press.photon_order
    excess = _exposure(scene, sent, press, effects) * here / (press.threshold * _product(scene, effects, "threshold"))
    exposed, solid = _develop(excess, scene.grid, press)
    converted = solid * _conversion(excess, here * sent, press, effects)
    factor = _shrinkage(_crosslink(converted, scene.grid, press), solid, scene.grid, press, effects)
    for item in effects:
        factor = item.column(factor, exposed, scene.grid)
    printed = factor * exposed
    for item in effects:
        printed = item.geometry(printed, scene.grid)
    return printed


def _scene(target, grid, press, effects):
    """Slice the target, let the effects bend it, and voxelise it."""
    heights = sliced(target, press.slicing_um, press.slicing_phase)
    support = (heights > 0).astype(float)
    for item in effects:
        heights, support = item.target(heights, support, grid)
    layered = with_layers(grid, heights.max() + 3 * press.focus_fwhm_z_um * SIGMA_PER_FWHM, layer_thickness(press))
    fill = fill_fractions(heights, support, layered)
    for item in effects:
        fill = item.source(fill, layered)
    return Scene(layered, heights, support, fill)


def sliced(heights, step_um, phase=0.5):
    """Return heights on the staircase of the layers: step * floor(h / step + phase); continuous for step 0."""
    return step_um * np.floor(heights / step_um + phase) if step_um > 0 else heights


def layer_thickness(press):
    """Return the voxel height: a quarter of the focus' axial standard deviation, between 0.05 and 0.15 um."""
    return press.dz_um or float(np.clip(press.focus_fwhm_z_um * SIGMA_PER_FWHM / 4, 0.05, THICKEST_LAYER_UM))


def _product(scene, effects, hook):
    """Multiply what the effects return for a hook."""
    factor = np.ones((1, 1, 1), np.float32)
    for item in effects:
        value = getattr(item, hook)(scene)
        if value is not None:
            factor = factor * np.asarray(value, np.float32)
    return factor


def _exposure(scene, sent, press, effects):
    """Return the share of the full dose in every voxel, the written voxels sending `sent` times the nominal dose."""
    lobes = focus.mixed(press.focus_profile, press.focus_tails, press.focus_fwhm_xy_um, press.focus_fwhm_z_um)
    for item in effects:
        lobes = item.lobes(lobes)
    fill = with_true_moment(scene.fill) * sent
    below = fill[0]
    total = np.zeros_like(fill)
    for lobe in lobes:
        weights, rest = focus.axial_weights(lobe, scene.grid.z, scene.grid.dz)
        spread = focus.spread_laterally(fill, lobe, scene.grid)
        total += along_z(spread, weights)
        total += rest[:, None, None].astype(np.float32) * focus.spread_laterally(below[None], lobe, scene.grid)
    return total


def _develop(excess, grid, press):
    """Return the exposed height of each column and the solid share of each voxel."""
    resin = grid.z > 0
    if press.contrast > 0:
        full = expit(-press.contrast * np.log(press.threshold))
        solid = np.minimum(expit(press.contrast * np.log(np.maximum(excess[resin], 1e-6))) / full, 1)
        return solid.sum(axis=0, dtype=float) * grid.dz, solid
    solid = solid_shares(excess, grid)
    return solid.sum(axis=0, dtype=float) * grid.dz, solid


def _conversion(excess, dose, press, effects):
    """Return the conversion of each voxel of resin, 1 at full nominal dose.

    1 + eta (D^N - 1) through the effects; and, with `dose_conversion` w, 1 - w + w cure(u) with the first-order law
    cure = (1 - exp(1 - u)) / (1 - exp(1 - 1/P)), zero at the threshold.
    """
    eta = _shared_conversion(press, effects)
    conversion = 1 + eta * (dose[GHOSTS:] - 1) if dose.shape[0] > 1 else 1 + eta * (dose - 1)
    if press.dose_conversion:
        cure = -np.expm1(np.minimum(1 - excess[GHOSTS:], 0)) / -np.expm1(1 - 1 / press.threshold)
        conversion = conversion * (1 + press.dose_conversion * (cure - 1))
    return conversion


def _shared_conversion(press, effects):
    """Return eta; it belongs to the resin, so effects that name one must name the same."""
    given = {item.conversion for item in effects if getattr(item, "conversion", None) is not None}
    if len(given) > 1:
        raise ValueError(f"effects: conversion: {sorted(given)}, all dose effects share one value")
    return given.pop() if given else press.conversion


def _crosslink(converted, grid, press):
    """Spread the conversion with the cross-linking Gaussian; nothing below the substrate takes part."""
    shares = {1: 1 - press.crosslink_tails, 2: press.crosslink_tails}
    return sum(np.float32(share) * _spread(converted, grid, press, far) for far, share in shares.items() if share)


def _spread(converted, grid, press, far):
    """Filter with the cross-linking Gaussian, so many times as wide."""
    s_xy, s_z = (far * fwhm * SIGMA_PER_FWHM for fwhm in (press.crosslink_fwhm_xy_um, press.crosslink_fwhm_z_um))
    z = grid.z[grid.z > 0]
    offset = z[None, :] - z[:, None]
    weights = ndtr((offset + grid.dz / 2) / s_z) - ndtr((offset - grid.dz / 2) / s_z)
    return lateral(along_z(np.asarray(converted, np.float32), weights), s_xy, s_xy, grid)


def _shrinkage(crosslinked, solid, grid, press, effects):
    """Return the shrinkage factor of each column, the mean over its solid part."""
    reference = peak(crosslinked, solid > 0) if press.crosslink_reference == "structure_maximum" else 1.0
    share = crosslinked / np.float32(max(reference, 1e-9))
    for item in effects:
        share = item.curing(share)
    amount = np.maximum(solid.sum(axis=0, dtype=float), 1e-9)
    span = press.shrinkage_max - press.shrinkage_min
    factor = press.shrinkage_min + span * np.einsum("zyx,zyx->yx", share, solid, dtype=float) / amount
    if press.pinning:
        held = (np.exp(-grid.z[grid.z > 0] / press.pin_height_um)[:, None, None] * solid).astype(np.float32)
        lost = (1 - press.shrinkage_min) * held.sum(axis=0, dtype=float)
        lost = lost - span * np.einsum("zyx,zyx->yx", share, held, dtype=float)
        factor = factor - press.pinning * lost / amount
    return factor


def with_effects(press, *effects):
    """Return the press with more effects."""
    return replace(press, effects=(*press.effects, *effects))
