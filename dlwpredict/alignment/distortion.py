"""How much distortion the data call for: nested models, tested with correlated residuals in mind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from dlwpredict.alignment.pose import Distortion, Pose, Wanted
from dlwpredict.alignment.refine import Fit, Level, refine, slopes
from dlwpredict.alignment.uncertainty import figure_covariance, pose_covariance

SIGNIFICANCE = 1e-3
LEAST_MOVE_PX = 0.1
UNDETERMINED_DEG = 5.0

LEAST_OWN = 0.05
"""Share, in energy, of what a distortion changes that nothing else may look like, at least: no formula of a print's
form is trusted further than to 5 % (`diagnosis.policy.FORM_ERROR`). A lone lens that is wider is a wider lens."""

# what each model adds to the one below: places in `Pose.figures` and their values without distortion
_ADDED = {"affine": (slice(3, 6), np.array([1.0, 1.0, 0.0])), "bow": (slice(6, 12), np.zeros(6))}


@dataclass(frozen=True)
class Registration:
    """The final pose, its covariance, and why this much distortion was allowed."""

    fit: Fit
    distortion: str
    covariance: np.ndarray
    tests: dict[str, dict[str, float | bool]]
    rotation_known: bool


def register(levels: list[Level], pose: Pose, wanted: Wanted, pixel_um: float, *, is_round: bool) -> Registration:
    """Refine a pose from coarse to fine and settle the distortion.

    ``wanted`` is rigid, affine or bow, or auto: bow where its six terms differ from zero, else affine where scale
    and shear do, else rigid. "Differ": Hotelling's T² of the added figures with the block-jackknife covariance,
    T²·(B − q)/(q(B − 1)) against F(q, B − q) over B effective blocks, p < 0.001; the rim moves by more than a tenth of
    a target pixel; and of what changes, more than `LEAST_OWN` is nothing that the print itself may look like. Where
    that does not hold of scale and shear, a bow, which has them too, is not asked for.
    """
    for level in levels:
        fit = refine(level, pose, "rigid")
        pose = fit.pose
    known = not is_round and rotation_sd(fit, "rigid") < UNDETERMINED_DEG
    if not known:
        fit = refine(
            levels[-1], Pose.rigid(pose.shift_um, 0.0, reach_um=pose.reach_um, mirrored=pose.mirrored), "shift"
        )
    fits: dict[Distortion, Fit] = {"rigid": fit}
    tests: dict[str, dict[str, float | bool]] = {}
    models: tuple[Distortion, ...] = ("affine", "bow")
    for model in () if wanted == "rigid" or (wanted == "auto" and not known) else models:
        fit = refine(levels[-1], fit.pose, model)
        fits[model] = fit
        tests[model] = _test(fit, model, pixel_um)
        if model == wanted or (wanted == "auto" and tests[model]["own_share"] <= LEAST_OWN):
            break
    settled: Distortion
    if wanted == "auto":
        settled = next((model for model in reversed(models) if model in tests and tests[model]["accepted"]), "rigid")
    else:
        settled = wanted
    fit = fits[settled]
    kind: Distortion = settled if known or settled != "rigid" else "shift"
    covariance = figure_covariance(fit.pose, pose_covariance(fit, kind)[0])
    if not known:
        covariance[2, :] = covariance[:, 2] = 0.0
        covariance[2, 2] = 180.0**2 / 3  # uniform over the circle
    return Registration(fit, settled, covariance, tests, known)


def rotation_sd(fit: Fit, model: Distortion) -> float:
    """Standard error of the rotation, degrees."""
    return float(np.sqrt(figure_covariance(fit.pose, pose_covariance(fit, model)[0])[2, 2]))


def _test(fit: Fit, model: Distortion, pixel_um: float) -> dict[str, float | bool]:
    """Hotelling's test of the figures that a model adds."""
    covariance, blocks = pose_covariance(fit, model, tiles_only=True)
    places, without = _ADDED[model]
    added = fit.pose.figures()[places] - without
    spread = figure_covariance(fit.pose, covariance)[places, places]
    count = len(added)
    size = np.sqrt(np.maximum(np.diag(spread), 1e-30))
    t2 = float(added / size @ np.linalg.pinv(spread / np.outer(size, size), hermitian=True) @ (added / size))
    free = max(blocks - count, 1.0)
    p = float(special.fdtrc(count, free, t2 * free / (count * max(blocks - 1, 1.0))))
    move, own = _rim_move(fit.pose, model) / pixel_um, own_share(fit)
    moved, told = p < SIGNIFICANCE and move > LEAST_MOVE_PX, own > LEAST_OWN
    found = {"p_value": p, "rim_px": move, "blocks": blocks, "own_share": own}
    return {**found, "untold": moved and not told, "accepted": moved and told}


def own_share(fit: Fit) -> float:
    """Share of what the distortion of a pose changes, in energy, that neither the likeness nor a shift takes up.

    A point's change is known no better than to `LEAST_OWN` of its energy: walls, which change most, drown nothing.
    """
    pose, (x, y) = fit.pose, fit.level.grid
    rigid = Pose.rigid(pose.shift_um, pose.rotation_deg)
    moved = np.subtract(pose.to_recording(x.ravel(), y.ravel()), rigid.to_recording(x.ravel(), y.ravel()))
    change = np.sum(slopes(fit.level, pose, fit.fitted) * moved, axis=0)
    variance = np.average(fit.residual**2, weights=fit.weights + 1e-12)
    weights = fit.weights / (variance + LEAST_OWN * change**2)
    left = fit.beside(change, weights)
    return float(np.sum(weights * left**2) / max(np.sum(weights * change**2), 1e-300))


def _rim_move(pose: Pose, model: str) -> float:
    """Largest move of the target's corners and edge middles by what the model adds, µm."""
    x, y = (np.array(pose.reach_um) * np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)], float)).T
    plain = Pose(pose.shift_um, pose.matrix) if model == "bow" else Pose.rigid(pose.shift_um, pose.rotation_deg)
    full = pose if model == "bow" else Pose(pose.shift_um, pose.matrix)
    return float(np.max(np.hypot(*np.subtract(full.to_recording(x, y), plain.to_recording(x, y)))))
