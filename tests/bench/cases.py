"""Cases for the diagnosis: structures printed on the virtual press and recorded; only the judge knows the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dlwpredict import designs
from dlwpredict.heightmap import HeightMap
from tests.press import Microscope, measure, microscope_from, press_from, print_part

PITCH_UM = 0.4
FINER = 3
"""The press prints the target's pixels as squares of this many pixels a side, which resolve its focus."""

STRUCTURES = {
    "cin": {"size_um": 46.0},
    "air": {"size_um": 46.0},
    "stairs": {"size_um": 46.0, "feature_um": 5.0},
    "posts": {"size_um": 46.0},
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
    """

    effects: tuple[Mapping, ...] = ()
    artefacts: tuple[Mapping, ...] = ()
    structures: tuple[str, ...] = TRIO
    sigma_um: float = 0.015
    correlation_um: float = 1.0
    white_um: float = 0.004
    seed: int = 0
    base: Mapping = field(default_factory=dict)


def target(kind: str) -> HeightMap:
    """Return a structure on 145 × 145 pixels, 6 µm of substrate around."""
    return getattr(designs, kind)(pitch_um=PITCH_UM, margin_um=6.0, **STRUCTURES[kind])


def process(seed: int) -> dict[str, float]:
    """Draw the process of a case."""
    rng = np.random.default_rng([seed, 1])
    return {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}


def press_of(case: Case):
    """Return the press of a case."""
    return press_from({**process(case.seed), **case.base, "effects": list(case.effects)})


def microscope_of(case: Case, part: HeightMap, rng: np.random.Generator) -> Microscope:
    """Return the microscope: the target's own grid, a pose that an alignment would have left."""
    pose = {"shift_um": rng.normal(0, 0.03, 2).tolist(), "rotation_deg": float(rng.normal(0, 0.02))}
    rows, cols = part.shape
    return microscope_from({
        "pitch_um": [part.dx_um, part.dy_um], "pixels": [cols, rows], "pose": pose,
        "noise": {"sigma_um": case.sigma_um, "correlation_um": case.correlation_um, "white_um": case.white_um},
        "effects": list(case.artefacts),
    })  # fmt: skip


def recorded(case: Case) -> list[tuple[HeightMap, HeightMap]]:
    """Print and record every structure: pairs of target and recording on one grid."""
    rng = np.random.default_rng([case.seed, 2])
    press, pairs = press_of(case), []
    for k, kind in enumerate(case.structures):
        part = target(kind)
        heights = np.kron(part.heights_um, np.ones((FINER, FINER)))
        dx, dy = part.dx_um / FINER, part.dy_um / FINER
        printed = print_part(heights, dx, dy, press)
        seen = measure(printed, dx, dy, microscope_of(case, part, rng), seed=1000 * case.seed + k)
        pairs.append((part, part.with_heights(seen.heights)))
    return pairs


def effects_of(press: Sequence[Mapping], artefacts: Sequence[Mapping] = ()) -> str:
    """Return the truth in words."""
    return " + ".join(str(e["name"]) for e in (*press, *artefacts)) or "nothing"
