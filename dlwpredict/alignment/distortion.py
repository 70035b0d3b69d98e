"""How much distortion the data call for: nested models, tested with correlated residuals in mind."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from dlwpredict.alignment.pose import Distortion, Pose, Wanted, rotation_matrix
from dlwpredict.alignment.refine import Fit, Level, changed, parameter_scale, refine, slopes
from dlwpredict.alignment.uncertainty import figure_covariance, pose_covariance

SIGNIFICANCE = 1e-3
LEAST_MOVE_PX = 0.1
UNDETERMINED_DEG = 5.0

LEAST_OWN = 0.05
"""Share, in energy, of what a distortion changes that nothing else may look like, at least: no formula of a print's
form is trusted further than to 5 % (`diagnosis.policy.FORM_ERROR`). A lone lens that is wider is a wider lens."""

BLIND = 1e-7
"""Share of the most that a direction may change, in energy, below which it changes nothing."""

_ADDED = {
    "affine": (slice(3, 6), np.array([1.0, 1.0, 0.0]), np.eye(3)),
    "bow": (slice(6, 12), np.zeros(6), np.eye(6)),
    "cubic": (slice(12, 14), np.zeros(2), np.array([[1.0, -1.0]])),
}
"""What each model adds to the one below: places in `Pose.figures`, their values without distortion, and which
combinations of their differences are tested. A print that holds on to its substrate shrinks alike along x and y, most
at its rim: of a cubic only what differs between the axes is surely the instrument's."""


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

    ``wanted`` is rigid, affine, bow or cubic, with all its figures free; or auto: cubic where its two terms differ from
    one another, else bow where its six differ from zero, else affine where scale and shear do, else rigid. "Differ":
    Hotelling's T² of the added figures with the block-jackknife covariance, T²·(B − q)/(q(B − 1)) against F(q, B − q)
    over B effective blocks and q free directions, p < 0.001; and the rim moves by more than a tenth of a target pixel.
    With auto, what lies inside the outline must not contradict a bow or cubic, p < 0.001 again: a relief that the
    instrument reads to the side of walls that stay looks bent.
    With auto, only those directions of scale, shear, bow and cubic are free that the print itself cannot look like
    (`told`); where there are none of scale and shear, no bow is asked for, and so on. What all directions together
    would have moved besides is in the covariance.
    """
    for level in levels:
        fit = refine(level, pose, "rigid")
        pose = fit.pose
    known = not is_round and rotation_sd(fit) < UNDETERMINED_DEG
    if not known:
        fit = refine(
            levels[-1], Pose.rigid(pose.shift_um, 0.0, reach_um=pose.reach_um, mirrored=pose.mirrored), "shift"
        )
    fits: dict[Distortion, tuple[Fit, Fit]] = {"rigid": (fit, fit)}  # with all directions free, and with those told
    tests: dict[str, dict[str, float | bool]] = {}
    models: tuple[Distortion, ...] = ("affine", "bow", "cubic")
    free = _directions(fit.pose, "rigid")
    for model in () if wanted == "rigid" or (wanted == "auto" and not known) else models:
        whole = own = refine(levels[-1], fit.pose, model)
        added = _directions(fit.pose, model)
        if wanted == "auto":
            added = told(whole, model, added)
            free = np.column_stack([np.pad(free, [(0, len(added) - len(free)), (0, 0)]), added])
            own = refine(levels[-1], fit.pose, model, np.linalg.qr(free)[0])
        fits[model] = whole, own
        tests[model] = _test(whole, own, model, added.shape[1], pixel_um)
        if wanted == "auto" and model != "affine" and tests[model]["accepted"]:
            relief = refine(replace(levels[-1], relief=True), own.pose, model, own.directions)
            agrees = _chance(relief, model, added.shape[1], own.pose)[0]
            tests[model] |= {"relief_p_value": agrees, "accepted": agrees > SIGNIFICANCE}
        if model == wanted or added.shape[1] == 0:
            break
        fit = own
    settled: Distortion
    if wanted == "auto":
        settled = next((model for model in reversed(models) if model in tests and tests[model]["accepted"]), "rigid")
    else:
        settled = wanted
    whole, fit = fits[settled]
    untold = whole.pose.figures() - fit.pose.figures()
    untold[2] = (untold[2] + 180) % 360 - 180
    covariance = figure_covariance(fit.pose, pose_covariance(fit)[0]) + np.outer(untold, untold)
    if not known:
        covariance[2, :] = covariance[:, 2] = 0.0
        covariance[2, 2] = 180.0**2 / 3  # uniform over the circle
    return Registration(fit, settled, covariance, tests, known)


def rotation_sd(fit: Fit) -> float:
    """Standard error of the rotation, degrees."""
    return float(np.sqrt(figure_covariance(fit.pose, pose_covariance(fit)[0])[2, 2]))


def told(fit: Fit, model: Distortion, directions: np.ndarray) -> np.ndarray:
    """Return those directions of a distortion along which the recording tells it from the form of the print.

    They stand at right angles to all in which the likeness of the target, or a shift, takes up 1 − `LEAST_OWN` of what
    the distortion changes, in energy: what nothing tells is taken to be as little as can be. A point's change is known
    no better than to `LEAST_OWN` of its energy: walls, which change most, drown nothing.

    Parameters
    ----------
    fit : Fit
        With all of the distortion free.
    model : Distortion
    directions : numpy.ndarray, shape (parameters, directions)
        In units of `parameter_scale`.

    Returns
    -------
    numpy.ndarray, shape (parameters, told)
    """
    weights, scale = _trusted(fit, model), parameter_scale(len(directions), fit.pose.reach_um)
    changes = changed(fit.level, fit.pose, fit.fitted, model) @ (scale[:, None] * directions)
    sizes, axes = np.linalg.eigh(changes.T @ (changes * weights[:, None]))
    seen = sizes > BLIND * sizes[-1]
    scaled = axes[:, seen] / np.sqrt(sizes[seen])
    left = fit.beside(changes @ scaled, weights)
    shares, turns = np.linalg.eigh(left.T @ (left * weights[:, None]))
    open_ones = np.column_stack([axes[:, ~seen], scaled @ turns[:, shares <= LEAST_OWN]])
    across: np.ndarray = directions @ np.linalg.qr(open_ones, mode="complete")[0][:, open_ones.shape[1] :]
    return across


def own_share(fit: Fit, model: Distortion) -> float:
    """Return the share of what a model adds to the one below, in energy, that neither likeness nor shift takes up."""
    weights, change = _trusted(fit, model), _change(fit, model)
    left = fit.beside(change, weights)
    return float(np.sum(weights * left**2) / max(np.sum(weights * change**2), 1e-300))


def _trusted(fit: Fit, model: Distortion) -> np.ndarray:
    """Return the weights of the points: none's change is known better than to `LEAST_OWN` of its energy."""
    variance = np.average(fit.residual**2, weights=fit.weights + 1e-12)
    return fit.weights / (variance + LEAST_OWN * _change(fit, model) ** 2)


def _change(fit: Fit, model: Distortion) -> np.ndarray:
    """Return what a model adds to the one below, µm of height to first order, shape (points,)."""
    pose, (x, y) = fit.pose, fit.level.grid
    below = _below(pose, model)
    moved = np.subtract(pose.to_recording(x.ravel(), y.ravel()), below.to_recording(x.ravel(), y.ravel()))
    return np.sum(slopes(fit.level, pose, fit.fitted) * moved, axis=0)


def _below(pose: Pose, model: Distortion) -> Pose:
    """Return a pose without what a model adds to the one below."""
    if model == "affine":
        return Pose.rigid(pose.shift_um, pose.rotation_deg, reach_um=pose.reach_um)
    without = {"bow_um": Pose.bow_um} if model == "bow" else {"cubic_um": Pose.cubic_um}
    return replace(pose, **without)


def _directions(pose: Pose, model: Distortion) -> np.ndarray:
    """Return what a model adds to the one below, as directions of the parameters: shape (parameters, directions)."""
    if model in ("bow", "cubic"):
        places = _ADDED[model][0]
        return np.eye(places.stop)[:, places]
    turn = rotation_matrix(pose.rotation_deg)
    scales = [(turn @ np.array(added)).ravel() for added in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 1], [0, 0]])]
    if model == "affine":
        return np.concatenate([np.zeros((2, 3)), np.transpose(scales)])
    around = (turn @ np.array([[0, -1], [1, 0]])).ravel() / np.sqrt(2)
    return np.column_stack([np.eye(6)[:, :2], [0, 0, *around]])


def _test(whole: Fit, own: Fit, model: Distortion, free: int, pixel_um: float) -> dict[str, float | bool]:
    """Hotelling's test of what a model adds, in its free directions, and what of it was left out."""
    p, blocks = _chance(own, model, free)
    move = _rim_distance(own.pose, _below(own.pose, model)) / pixel_um
    left = _rim_distance(whole.pose, own.pose) / pixel_um
    return {
        "p_value": p,
        "rim_px": move,
        "blocks": blocks,
        "own_share": own_share(whole, model),
        "untold_px": left,
        "untold": left > LEAST_MOVE_PX and _chance(whole, model, len(_ADDED[model][1]))[0] < SIGNIFICANCE,
        "accepted": move > LEAST_MOVE_PX and p < SIGNIFICANCE,
    }


def _chance(fit: Fit, model: Distortion, free: int, true: Pose | None = None) -> tuple[float, float]:
    """Return the probability of what a model adds where nothing is, or a true pose; and the effective blocks."""
    covariance, blocks = pose_covariance(fit, tiles_only=True)
    if not free:
        return 1.0, blocks
    places, without, tested = _ADDED[model]
    without = without if true is None else true.figures()[places]
    free = min(free, len(tested))
    added = tested @ (fit.pose.figures()[places] - without)
    spread = tested @ figure_covariance(fit.pose, covariance)[places, places] @ tested.T
    size = np.sqrt(np.maximum(np.diag(spread), 1e-30))
    values, axes = np.linalg.eigh(spread / np.outer(size, size))
    along = (axes.T @ (added / size))[-free:]
    t2 = float(np.sum(along**2 / np.maximum(values[-free:], 1e-15)))
    left = max(blocks - free, 1.0)
    return float(special.fdtrc(free, left, t2 * left / (free * max(blocks - 1, 1.0)))), blocks


def _rim_distance(one: Pose, other: Pose) -> float:
    """Largest distance between two poses of the target's corners and edge middles, µm."""
    reach = np.array(one.reach_um)
    x, y = (reach * np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)], float)).T
    return float(np.max(np.hypot(*np.subtract(one.to_recording(x, y), other.to_recording(x, y)))))
