"""Random structures of the proof: as large and as fine as a bench prints them, most at half of that size."""

from __future__ import annotations

import numpy as np

from dlwpredict import designs
from dlwpredict.heightmap import HeightMap

WHOLE, HALF, WHOLE_EVERY = 1.0, 0.5, 5
"""Every fifth case is as large as on a bench, the others half as large: a sixth of the seconds, and as much to find."""

PITCHES_UM, MARGIN_UM = {WHOLE: (0.2, 0.4), HALF: (0.3, 0.45)}, 4.0
"""Native pitch of the targets of a case, and the bare substrate around the part."""

COARSE_UM = 0.5
"""Pitch on which baselines are fitted; the structures are the same at any pitch."""

FINE_ENOUGH_UM = 0.35
"""Strengths are found on the pitch of the targets, or on this one: on pixels as wide as the focus, an error of form
shows a third of what it does on the cases' own."""

HELD_OUT_UM = 0.4
"""Pitch of the structure held out, which nobody but the judge predicts."""

SIZES_UM = {"cin": (60.0, 80.0), "air": (80.0, 100.0)}
OTHERS_UM = 40.0, 60.0
"""Sides of the parts of each kind, and of all other kinds, where they are whole."""

COUNTS, SHARES = (1, 2, 3), (1 / 6, 1 / 2, 1 / 3)
"""Numbers of structures that a case gives, and the share of the cases with so many."""

SMOOTH, STEPPED = ("cin", "air", "lens"), ("stairs", "posts", "pads")

UPRIGHT = ("air", "stairs", "posts")
"""Kinds that a quarter or half turn brings onto nothing like themselves: the others lie as well in four ways, and
nothing in a recording tells which."""


def drawn(kind: str, rng: np.random.Generator, scale: float = WHOLE) -> dict:
    """Draw the options of a kind; lengths in µm."""
    u = rng.uniform
    size = scale * u(*SIZES_UM.get(kind, OTHERS_UM))
    count, seed = int(rng.integers(3, 5)), int(rng.integers(1e6))
    options = {
        "cin": {
            "base_um": u(4, 7), "height_um": u(1, 2.2), "period_min_um": u(2.5, 4),
            "period_max_um": size * u(0.16, 0.2),
        },
        "air": {"base_um": u(4, 7), "height_um": u(1.5, 2.5), "correlation_um": u(3, 6), "seed": seed},
        "lens": {"base_um": u(2, 4), "height_um": u(3, 5)},
        "stairs": {
            "base_um": u(2.5, 4), "height_um": u(4, 6), "count": count, "feature_um": size * u(0.09, 0.12),
            "feature_height_um": u(0.6, 1.2),
        },
        "posts": {
            "base_um": u(1.5, 3), "height_um": u(3, 5), "count": count, "width_min_um": size * u(0.1, 0.15),
            "width_max_um": size * u(0.18, 0.24),
        },
        "pads": {
            "base_um": u(1, 3), "height_um": u(4, 6), "low_um": u(1.5, 3), "count": count,
            "width_um": size * u(0.15, 0.24),
        },
    }  # fmt: skip
    known = {key: v if isinstance(v, int) else float(v) for key, v in options[kind].items()}
    return {"kind": kind, "size_um": float(size), **known}


def several(rng: np.random.Generator, scale: float = WHOLE, *, upright: bool = False) -> tuple[list[dict], dict]:
    """Draw one to three structures, and one of another kind to be held out.

    Of two or more, one is smooth and one stepped. Those that are `upright` show how a recording is turned.
    """
    smooth, stepped = ([str(k) for k in rng.permutation(kinds)] for kinds in (SMOOTH, STEPPED))
    if upright:
        smooth, stepped = (sorted(kinds, key=lambda k: k not in UPRIGHT) for kinds in (smooth, stepped))
    first = [smooth[0], stepped[0]] if rng.random() < 0.5 else [stepped[0], smooth[0]]
    third, *left = [stepped[1], smooth[1]] if upright or rng.random() < 0.5 else [smooth[1], stepped[1]]
    count = int(rng.choice(COUNTS, p=SHARES))
    return [drawn(kind, rng, scale) for kind in [*first, third][:count]], drawn(left[0], rng, scale)


def made(structure: dict, pitch_um: float) -> HeightMap:
    """Return the target of a structure on pixels of a pitch."""
    options = {key: value for key, value in structure.items() if key != "kind"}
    return designs.KINDS[structure["kind"]](pitch_um=pitch_um, margin_um=MARGIN_UM, **options)
