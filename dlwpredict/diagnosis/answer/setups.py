"""What could be recorded next: present samples and targets once more, turned or on another base, and new designs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from dlwpredict.designs import KINDS
from dlwpredict.effects.base import Effect, Frame
from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.objective import Fit

MOST_PRESENT = 2
"""Of the present targets, those that show most of the class are varied."""

MARGIN = 0.1
"""Bare substrate on each side of a new design, as a share of the present field."""


@dataclass(frozen=True, eq=False)
class Setup:
    """A recording that could be made.

    Parameters
    ----------
    name : str
    cost : int
        0 = another recording of a present print, 1 = a present target printed again, 2 = a new target.
    action : str
        What to do, as the beginning of a sentence.
    target : HeightMap
        In the frame of the sample, on the pixels of the present recordings.
    print_turns, view_turns : int
        Quarter turns, counter-clockwise, of the part in the printer and of the sample under the microscope.
    command : str or None
    """

    name: str
    cost: int
    action: str
    target: HeightMap
    print_turns: int = 0
    view_turns: int = 0
    command: str | None = None

    @property
    def unturned(self) -> Setup:
        """The same without turning anything."""
        return replace(self, print_turns=0, view_turns=0)


def setups_for(fitted: Fit, members: Sequence[Effect], columns: np.ndarray) -> list[Setup]:
    """Return what could be recorded to tell the members apart; `columns` are those of `present_columns`."""
    frames = {member.frame for member in members}
    present = telling(fitted, columns[:, -len(members) :])
    return [setup for k in present for setup in _of_present(fitted, k, frames)] + new_designs(fitted)


def telling(fitted: Fit, signatures: np.ndarray) -> list[int]:
    """Return the present recordings that show most of the members, at most `MOST_PRESENT`."""
    visible = fitted.beside(signatures)
    energy = np.sum((visible / np.maximum(np.linalg.norm(visible, axis=0), 1e-12)) ** 2, axis=1)
    shares = [part.sum() for part in fitted.rows.split(energy)]
    return [int(k) for k in np.argsort(shares)[::-1][:MOST_PRESENT]]


def _of_present(fitted: Fit, k: int, frames: set[Frame]) -> list[Setup]:
    """Return recordings of a present sample, and prints of a present target; turns where they move anything."""
    target, name = fitted.data[k].recording.target, fitted.data[k].recording.name
    setups = []
    if "instrument" in frames:
        setups += [
            Setup(f"sample turned {90 * turns}°", 0,
                  f"Record {name} once more with the sample turned by {90 * turns}° under the microscope",
                  target, view_turns=turns)
            for turns in (1, 2)
        ]  # fmt: skip
    if "printer" in frames:
        action = f"Print {name} once more turned by 90° in the printer, and record it as before"
        setups.append(Setup(f"{name} printed turned 90°", 1, action, target, print_turns=1))
    base = float(target.heights_um[target.heights_um > 0].min())
    if base > target.heights_um.max() / 10:
        for share, words in ((0.5, "half"), (2.0, "twice")):
            heights = np.where(target.heights_um > 0, target.heights_um + (share - 1) * base, 0.0)
            action = f"Print and record {name} on a base {words} as high ({share * base:.3g} instead of {base:.3g} µm)"
            setups.append(Setup(f"{name} on {words} the base", 2, action, target.with_heights(heights)))
    return setups


def new_designs(fitted: Fit) -> list[Setup]:
    """Return new targets of about the size, pitch and height of the present ones, on bare substrate."""
    targets = [item.recording.target for item in fitted.data]
    field = max(targets, key=lambda target: min(target.size_um))
    top_um = float(f"{np.median([target.heights_um.max() for target in targets]):.3g}")
    px = max(field.dx_um, field.dy_um)
    pixels = int(min(field.size_um) / px + 1e-6)
    margin = int(np.ceil(MARGIN * pixels))
    side_um = (pixels - 2 * margin) * px
    shared = {"size_um": side_um, "margin_um": margin * px}
    pitches = {"pitch_um": field.dx_um} | ({"pitch_y_um": field.dy_um} if field.dy_um != field.dx_um else {})
    setups = []
    for name, (kind, settings) in kinds(side_um, top_um, px).items():
        options = {key: v if isinstance(v, int) else float(f"{v:.4g}") for key, v in (shared | settings).items()}
        words = " ".join(f"--{key.replace('_', '-')} {value:.10g}" for key, value in (options | pitches).items())
        command = f"dlwpredict design {kind} -o next-{name}.tif {words}"
        action = f"Print and record one more structure, next-{name}.tif ({KINDS[kind].meaning})"
        with suppress(InputError):  # a field too small for its details
            setups.append(Setup(name, 2, action, KINDS[kind](**options, **pitches), command=command))
    return setups


def kinds(side_um: float, top_um: float, px_um: float) -> dict[str, tuple[str, dict[str, float]]]:
    """Return name, kind and options of the designs that are tried.

    Parameters
    ----------
    side_um : float
        Footprint.
    top_um : float
        Height of the present targets.
    px_um : float
        Pixel: nothing is to be narrower than four.
    """

    def width(share: float) -> float:
        return max(share * side_um, 4 * px_um)

    low = {"base_um": 0.3 * top_um, "height_um": 0.3 * top_um, "period_um": width(1 / 6)}
    return {
        "pads": ("pads", {"height_um": top_um, "low_um": 0.4 * top_um, "count": 3, "width_um": 0.2 * side_um}),
        "many-pads": ("pads", {"height_um": top_um, "low_um": 0.4 * top_um, "count": 5, "width_um": 0.13 * side_um}),
        "stairs": ("stairs", {"base_um": 0.25 * top_um, "height_um": top_um, "count": 4,
                              "feature_um": 0.1 * side_um, "feature_height_um": 0.15 * top_um}),
        "tall-stairs": ("stairs", {"base_um": 0.5 * top_um, "height_um": 1.5 * top_um, "count": 4, "feature_um": 0}),
        "posts": ("posts", {"height_um": top_um, "count": 4,
                            "width_min_um": min(width(0.05), 0.1 * side_um), "width_max_um": 0.18 * side_um}),
        "grating": ("grating", low),
        "grating-across": ("grating", low | {"angle_deg": 90}),
        "blaze": ("blaze", low),
        "blaze-across": ("blaze", low | {"angle_deg": 90}),
        "cin": ("cin", {"base_um": 0.5 * top_um, "height_um": 0.3 * top_um,
                        "period_min_um": width(0.06), "period_max_um": width(0.28)}),
        "air": ("air", {"base_um": 0.4 * top_um, "height_um": 0.6 * top_um, "correlation_um": width(1 / 8), "seed": 1}),
        "lens": ("lens", {"height_um": min(0.8 * top_um, 0.4 * side_um), "base_um": 0.2 * top_um}),
    }  # fmt: skip
