"""Cases for the diagnosis: structures printed on the virtual press and recorded; only the judge knows the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from tests.press import Microscope, Press, Recording, measure, microscope_from, press_from, print_part

PITCH_UM = 0.4
FINER = 3
"""The press prints the target's pixels as squares of this many pixels a side, which resolve its focus."""

RAW_PITCH_UM = 0.25, 0.5
"""Pitches of raw recordings: finer and coarser than the target's."""

SIZE_UM, MARGIN_UM = 46.0, 6.0
SIDE_UM = SIZE_UM + 2 * MARGIN_UM
"""Of the square maps: the structure with the substrate around it."""

STRUCTURES = {
    "cin": {"size_um": SIZE_UM},
    "air": {"size_um": SIZE_UM},
    "stairs": {"size_um": SIZE_UM, "feature_um": 5.0},
    "posts": {"size_um": SIZE_UM},
}
TRIO = ("cin", "air", "stairs")

RANGES = {
    "focus_fwhm_xy_um": (0.45, 0.65),
    "focus_fwhm_z_um": (1.3, 1.9),
    "threshold": (0.40, 0.55),
    "crosslink_fwhm_xy_um": (5.5, 8.5),
    "crosslink_fwhm_z_um": (5.5, 8.5),
    "shrinkage_min": (0.68, 0.80),
    "shrinkage_max": (0.90, 1.00),
}
"""Process parameters are drawn from these."""


NEVER = ("z-amplification", "misregistration")
"""Named effects that are no cases here: one no recording can show, one is a nuisance of every recording."""

SIDES = {name: kind.side for name, kind in library().items()}
ALIKE = (
    {"vignetting", "print-field-curvature", "field-curvature", "curl"},
    {"z-drift", "z-linearity", "power-drift", "shrinkage-nonlinearity", "z-amplification"},
    {"power-drift", "interface-offset", "spherical-aberration", "z-drift"},
    {"instrument-blur", "batwings"},
    {"edge-inhibition", "psf-wings", "dose-proximity", "edge-drying"},
    {"galvo-lag", "slope-error", "astigmatism"},
    {"line-length-error", "slope-error", "line-end-pileup", "galvo-lag"},
    {"tip-convolution", "instrument-blur", "edge-drying"},
    {"line-end-pileup", "batwings", "edge-drying"},
    {"interface-offset", "substrate-tilt", "print-field-curvature"},
)
"""Classes of effects that look alike: effects.md, section 6."""

OUTSIDE = {
    "particle": {"x_um": 4.0, "y_um": -3.0, "diameter_um": 4.0, "height_um": 0.3},
    "blister": {"x_um": -6.0, "y_um": 8.0, "rise_um": 0.2},
    "vibration-ripple": {"amplitude_um": 0.03},
    "blanked-strip": {"x_um": 5.0, "loss": 0.1},
    "scratch": {"x_um": -2.0, "y_um": 4.0, "width_um": 1.5, "depth_um": 0.3},
    "resin-layer": {"slant_x_mrad": 30.0, "change": 0.1},
    "mode-hop": {"from_z_um": 6.0, "step": 0.1},
    "droplet-residue": {"share": 0.1, "thickest_um": 0.3},
    "line-jitter": {"sigma_um": 0.08},
    "micro-explosion": {"x_um": 7.0, "y_um": 5.0, "depth_um": 0.5},
    "scan-wobble": {"amplitude_um": 0.1},
    "hatch-creep": {"creep_mrad_per_um": 0.2},
    "thermal-lens": {"strength": 0.1},
}
"""Physics that the library does not have; the last two resemble members of it."""


IN_MICROSCOPE = ("scan-wobble",)
"""Those of them that the microscope does."""


@dataclass(frozen=True)
class Case:
    """What was printed and recorded, and what is concealed in it.

    Parameters
    ----------
    effects : tuple of dict
        Press effects.
    artefacts : tuple of dict
        Microscope effects.
    structures : tuple of str
    sigma_um, correlation_um, white_um : float
        Correlated noise (standard deviation, correlation length) and white noise.
    seed : int
        Of process, pose and noise.
    base : mapping
        Of the press, besides.
    raw : bool
        Recorded on pixels of the microscope's own, turned, shifted and tilted, and aligned by the program.
    """

    effects: tuple[Mapping, ...] = ()
    artefacts: tuple[Mapping, ...] = ()
    structures: tuple[str, ...] = TRIO
    sigma_um: float = 0.015
    correlation_um: float = 1.0
    white_um: float = 0.004
    seed: int = 0
    base: Mapping = field(default_factory=dict)
    raw: bool = False


def target(kind: str) -> HeightMap:
    """Return a structure on 145 × 145 pixels, substrate around."""
    return getattr(designs, kind)(pitch_um=PITCH_UM, margin_um=MARGIN_UM, **STRUCTURES[kind])


def process(seed: int) -> dict[str, float]:
    """Draw the process of a case."""
    rng = np.random.default_rng([seed, 1])
    return {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}


def press_of(case: Case):
    """Return the press of a case."""
    return press_from({**process(case.seed), **case.base, "effects": list(case.effects)})


def microscope_of(case: Case, part: HeightMap, rng: np.random.Generator) -> Microscope:
    """Return the microscope: the target's own grid and a pose that an alignment would have left, or a raw one."""
    if case.raw:
        pitch_um = float(rng.uniform(*RAW_PITCH_UM))
        pose = {
            "shift_um": rng.uniform(-1.5, 1.5, 2).tolist(), "rotation_deg": float(rng.uniform(-4, 4)),
            "tilt_mrad": rng.uniform(-5, 5, 2).tolist(), "offset_um": float(rng.uniform(-1, 1)),
        }  # fmt: skip
        grid = {"pitch_um": [pitch_um] * 2, "pixels": [int(1.2 * size / pitch_um) for size in part.size_um]}
    else:
        pose = {"shift_um": rng.normal(0, 0.03, 2).tolist(), "rotation_deg": float(rng.normal(0, 0.02))}
        grid = {"pitch_um": [part.dx_um, part.dy_um], "pixels": list(part.shape[::-1])}
    return microscope_from({
        **grid, "pose": pose,
        "noise": {"sigma_um": case.sigma_um, "correlation_um": case.correlation_um, "white_um": case.white_um},
        "effects": list(case.artefacts),
    })  # fmt: skip


def recorded(case: Case) -> list[tuple[HeightMap, HeightMap]]:
    """Print and record every structure: pairs of target and recording on one grid."""
    rng = np.random.default_rng([case.seed, 2])
    press, pairs, look = press_of(case), [], aligned if case.raw else seen
    for k, kind in enumerate(case.structures):
        part = target(kind)
        pairs.append((part, look(part, press, microscope_of(case, part, rng), seed=1000 * case.seed + k)))
    return pairs


def aligned(part: HeightMap, press: Press, microscope: Microscope, *, seed: int = 0) -> HeightMap:
    """Print a target, record it on the microscope's pixels and align the recording."""
    found = _recorded(part, press, microscope, seed, FINER)
    return align(HeightMap(found.heights, found.dx_um, found.dy_um), part).aligned


def seen(part: HeightMap, press: Press, microscope: Microscope, *, seed: int = 0, finer: int = FINER) -> HeightMap:
    """Print a target on pixels so many times finer and record it on its own grid."""
    return part.with_heights(_recorded(part, press, microscope, seed, finer).heights)


def _recorded(part: HeightMap, press: Press, microscope: Microscope, seed: int, finer: int) -> Recording:
    heights = np.kron(part.heights_um, np.ones((finer, finer)))
    dx, dy = part.dx_um / finer, part.dy_um / finer
    return measure(print_part(heights, dx, dy, press), dx, dy, microscope, seed=seed)


def by_machine(effects: Sequence[Mapping]) -> tuple[tuple[Mapping, ...], tuple[Mapping, ...]]:
    """Return the effects of the press, and those of the microscope."""
    artefacts = tuple(e for e in effects if SIDES.get(e["name"]) == "measurement" or e["name"] in IN_MICROSCOPE)
    return tuple(e for e in effects if e not in artefacts), artefacts


def alike(a: str, b: str) -> bool:
    """Tell whether two effects stand in one class of look-alikes."""
    return a == b or any(a in group and b in group for group in ALIKE)


def in_terms_of(truth: Mapping, found: Mapping[str, Mapping]) -> dict[str, Mapping]:
    """Return found parameters in the truth's terms: a focus wider by q along an axis is so by −q a quarter turn on."""
    if truth["name"] != "astigmatism" or "angle_deg" not in found:
        return dict(found)
    away = (found["angle_deg"]["value"] - truth.get("angle_deg", 0.0) + 90) % 180 - 90
    if abs(away) <= 45:
        return dict(found)
    ratio, angle, quarter = found["log_ratio"], found["angle_deg"], 90 * np.sign(away)
    return found | {
        "log_ratio": ratio | {"value": -ratio["value"], "low": -ratio["high"], "high": -ratio["low"]},
        "angle_deg": angle | {end: angle[end] - quarter for end in ("value", "low", "high")},
    }


def effects_of(press: Sequence[Mapping], artefacts: Sequence[Mapping] = ()) -> str:
    """Return the truth in words."""
    return " + ".join(str(e["name"]) for e in (*press, *artefacts)) or "nothing"
