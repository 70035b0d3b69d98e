"""Random structures of the proof: small maps that still show edges, heights, slopes and periods."""

from __future__ import annotations

import numpy as np

from dlwpredict import designs
from dlwpredict.heightmap import HeightMap

PIXELS, PITCH_UM, MARGIN_PX = 80, 0.45, 8
"""Side of every map in pixels, the pixel, and the bare substrate around the part: one diagnosis costs in proportion
to the pixels."""

SMOOTH, STEPPED = ("cin", "air", "lens"), ("stairs", "posts", "pads")


def drawn(kind: str, rng: np.random.Generator) -> dict:
    """Draw the options of a kind; lengths in µm."""
    u = rng.uniform
    count, seed = int(rng.integers(3, 5)), int(rng.integers(1e6))
    options = {
        "cin": {"base_um": u(4, 7), "height_um": u(1, 2.2), "period_min_um": u(2.5, 4), "period_max_um": u(8, 12)},
        "air": {"base_um": u(4, 7), "height_um": u(1.5, 2.5), "correlation_um": u(3, 6), "seed": seed},
        "lens": {"base_um": u(2, 4), "height_um": u(3, 5)},
        "stairs": {
            "base_um": u(2.5, 4), "height_um": u(4, 6), "count": count, "feature_um": u(2.8, 3.5),
            "feature_height_um": u(0.6, 1.2),
        },
        "posts": {
            "base_um": u(1.5, 3), "height_um": u(3, 5), "count": 3, "width_min_um": u(4.5, 5.5),
            "width_max_um": u(6.5, 8.5),
        },
        "pads": {"base_um": u(1, 3), "height_um": u(4, 6), "low_um": u(1.5, 3), "count": 3, "width_um": u(5.5, 8)},
    }  # fmt: skip
    return {"kind": kind, **{key: v if isinstance(v, int) else float(v) for key, v in options[kind].items()}}


def several(rng: np.random.Generator) -> tuple[list[dict], dict]:
    """Draw three structures, a smooth and a stepped one among them, and one of another kind to be held out."""
    smooth, stepped = rng.permutation(SMOOTH), rng.permutation(STEPPED)
    others = rng.permutation([smooth[1], stepped[1]])
    return [drawn(str(kind), rng) for kind in (smooth[0], stepped[0], others[0])], drawn(str(others[1]), rng)


def made(structure: dict) -> HeightMap:
    """Return the target of a structure."""
    options = {key: value for key, value in structure.items() if key != "kind"}
    size = (PIXELS - 2 * MARGIN_PX) * PITCH_UM
    kind = designs.KINDS[structure["kind"]]
    return kind(size_um=size, pitch_um=PITCH_UM, margin_um=MARGIN_PX * PITCH_UM, **options)
