"""What can be concealed: effects of the library and physics outside it, with random shapes and a strength to be set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from dlwpredict.effects import library
from dlwpredict.effects.base import Effect, settings
from dlwpredict.infer.model import matters
from dlwpredict.parameters import declarations
from tests.bench.cases import NEVER
from tests.press.effect import registry

NAMED = tuple(name for name in library() if name not in NEVER)
"""Effects that recordings can show."""

CENTRE_UM, SHAPE = 8.0, 1.7
"""Centres of fields are drawn from ± this; lengths from their default divided and multiplied by this factor."""


LIBRARY_FORM = {"galvo-lag": "time"}
"""The press's model that is the library's formula, where it is not the one called literal."""

SET_APART = ("conversion", "max_angle_deg")
"""η belongs to the resin, dropouts to the microscope."""


@dataclass(frozen=True)
class Hidden:
    """One effect of the press whose strength is open.

    Parameters
    ----------
    name : str
    switch : str
        The parameter that sets the strength.
    off, probe, low, high : float
        Its off value, a value to begin with, and its ends.
    settings : mapping
        Everything else, in the press's words.
    """

    name: str
    switch: str
    off: float
    probe: float
    low: float
    high: float
    settings: Mapping = field(default_factory=dict)

    def at(self, value: float) -> dict:
        """Return the effect, in the press's words, at a strength inside its ends."""
        return {"name": self.name, **self.settings, self.switch: float(np.clip(value, self.low, self.high))}


def named(name: str, rng: np.random.Generator) -> Hidden:
    """Draw an effect of the library: its switch, sign and shape, and the library's form or the longer physics."""
    kind, press_kind = library()[name], registry()[name]
    known = {item.name for item in fields(press_kind)}
    switch = str(rng.choice([s for s in kind.switches() if s in known and s not in SET_APART]))
    off, declared = declarations(kind)[switch]
    sign = float(rng.choice([-1.0, 1.0])) if declared.low < off < declared.high else 1.0
    settings = {}
    for key, (default, shape) in declarations(kind).items():
        if key in (*kind.switches(), *SET_APART) or key not in known or not shape.fitted:
            continue
        if not matters(kind, switch, key):
            continue
        if key.startswith("centre_"):
            settings[key] = float(rng.uniform(-CENTRE_UM, CENTRE_UM))
        elif shape.unit in ("°", "rad"):
            settings[key] = float(rng.uniform(shape.low, shape.high))
        elif shape.unit == "µm":
            settings[key] = float(np.clip(default * SHAPE ** rng.uniform(-1, 1), shape.low, shape.high))
    models = getattr(press_kind, "models", ())
    if models:
        settings["model"] = str(rng.choice([models[0], models[-1]]))
    return Hidden(name, switch, off, off + sign * (declared.typical - off), declared.low, declared.high, settings)


def _place(rng: np.random.Generator) -> dict:
    return {"x_um": float(rng.uniform(-9, 9)), "y_um": float(rng.uniform(-9, 9))}


OUTSIDE: dict[str, tuple[str, float, float, Callable[[np.random.Generator], dict]]] = {
    "particle": ("height_um", 0.3, 3, lambda rng: _place(rng) | {"diameter_um": rng.uniform(2, 5)}),
    "blister": ("rise_um", 0.2, 2, lambda rng: _place(rng) | {"radius_um": rng.uniform(4, 8)}),
    "vibration-ripple": ("amplitude_um", 0.03, 0.5, lambda rng: {
        "period_um": rng.uniform(4, 9), "angle_deg": rng.uniform(0, 180), "phase_rad": rng.uniform(0, 6)}),
    "blanked-strip": ("loss", 0.1, 0.9, lambda rng: {"x_um": rng.uniform(-9, 9), "width_um": rng.uniform(1.5, 3)}),
    "scratch": ("depth_um", 0.3, 2, lambda rng: _place(rng) | {
        "angle_deg": rng.uniform(0, 180), "length_um": rng.uniform(8, 20), "width_um": rng.uniform(0.8, 1.6)}),
    "resin-layer": ("change", 0.05, 0.4, lambda rng: {
        "boundary_um": rng.uniform(2, 5), "slant_x_mrad": rng.uniform(-40, 40), "slant_y_mrad": rng.uniform(-40, 40)}),
    "mode-hop": ("step", 0.05, 0.4, lambda rng: {"from_z_um": rng.uniform(2, 5)}),
    "droplet-residue": ("share", 0.1, 1, lambda rng: {"radius_um": rng.uniform(1.2, 2.5)}),
    "line-jitter": ("sigma_um", 0.08, 0.6, lambda rng: {
        "correlation_um": rng.uniform(0.6, 1.5), "seed": int(rng.integers(1e6))}),
    "micro-explosion": ("depth_um", 0.3, 3, lambda rng: _place(rng) | {"radius_um": rng.uniform(1.2, 2.5)}),
    "scan-wobble": ("amplitude_um", 0.02, 0.5, lambda rng: {
        "period_um": rng.uniform(3, 9), "phase_rad": rng.uniform(0, 6)}),
    "hatch-creep": ("creep_mrad_per_um", 1, 20, lambda rng: {}),
    "thermal-lens": ("strength", 0.05, 0.5, lambda rng: {"fwhm_um": rng.uniform(8, 20)}),
}  # fmt: skip
"""Physics that the library does not have: the switch, a probe of it, its end, and how the rest is drawn."""

LOCAL = ("particle", "blister", "micro-explosion", "scratch")
"""Those of them that sit in one place."""

LIKE_LIBRARY = ("hatch-creep", "thermal-lens")
"""Those that look like members of the library; no test of shapes can know better."""


def outside(name: str, rng: np.random.Generator) -> Hidden:
    """Draw physics that the library does not have."""
    switch, probe, high, rest = OUTSIDE[name]
    return Hidden(name, switch, 0.0, probe, 0.0, high, rest(rng))


FORM, FORMS = "form", ("focus_tails", "dose_conversion", "pinning", "crosslink_tails")
"""Ways in which the press's process differs in form from the seven's model, keys of the press from 0 to 1: the tails of
a Gaussian-Lorentzian focus; conversion that follows the dose above the threshold; layers that the base holds laterally
and that shrink the more in height; cross-linking that has tails."""

LEAST_PART, PIN_UM = 0.3, (2.0, 8.0)
"""Every way has at least this part of the one that has most; heights within which the base holds the part."""


def form(most: str, rng: np.random.Generator) -> Hidden:
    """Draw an error of form: one way in full, the others in part, and a size from 0 to 1 for all together."""
    parts = {key: 1.0 if key == most else float(rng.uniform(LEAST_PART, 1)) for key in FORMS}
    return Hidden(FORM, "size", 0.0, 0.3, 0.0, 1.0, parts | {"pin_height_um": float(rng.uniform(*PIN_UM))})


def entry_of(effect: Effect) -> dict:
    """Return an effect of the program in the press's words, as far as the press has them."""
    known = {item.name for item in fields(registry()[effect.name])} - set(SET_APART)
    return {"name": effect.name} | {name: value for name, value in settings(effect).items() if name in known}


def of_press(entry: Mapping) -> dict:
    """Return an error of form in the press's words."""
    parts = {key: entry["size"] * entry[key] for key in FORMS}
    return parts | {"pin_height_um": entry["pin_height_um"]}
