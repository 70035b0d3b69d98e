"""What a parameter is, the paper's seven, and the set that describes one process."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, cast

import numpy as np

from dlwpredict.errors import InputError


@dataclass(frozen=True)
class Declaration:
    """What is known of a parameter besides its value; declared once, on the field that holds it.

    Parameters
    ----------
    unit : str
        Unit, "1" if none.
    low, high : float
        Allowed range, both ends included; also the default bounds of a fit.
    meaning : str
        One line for the user.
    fitted : bool
        False for settings that a fit must not touch (a writing direction, a photon order).
    typical : float, optional
        For parameters that switch an effect on: a typical size. The effect is off while all of them keep their default.
    cyclic : bool
        Both ends of the range are the same, as those of a phase.
    shared : bool
        One value for all effects that have it: it belongs to the resin.
    """

    unit: str
    low: float
    high: float
    meaning: str
    fitted: bool = True
    typical: float | None = None
    cyclic: bool = False
    shared: bool = False


def declare(
    default: float,
    unit: str,
    low: float,
    high: float,
    meaning: str,
    *,
    fitted: bool = True,
    typical: float | None = None,
    cyclic: bool = False,
    shared: bool = False,
) -> Any:  # a dataclass field
    """Declare a parameter: default, unit, allowed range and meaning in one place."""
    declaration = Declaration(unit, low, high, meaning, fitted, typical, cyclic, shared)
    return field(default=default, metadata={"declaration": declaration})


def declarations(holder: Any) -> dict[str, tuple[float, Declaration]]:
    """Return default and declaration of every declared parameter of a dataclass, in order."""
    known = ((f.name, f.default, f.metadata.get("declaration")) for f in fields(holder))
    return {name: (cast(float, default), declared) for name, default, declared in known if declared is not None}


def check_range(name: str, value: float, declaration: Declaration) -> None:
    """Refuse a value outside its declared range.

    Raises
    ------
    InputError
        Not finite, or outside.
    """
    if not (np.isfinite(value) and declaration.low <= value <= declaration.high):
        unit = "" if declaration.unit == "1" else f" {declaration.unit}"
        raise InputError(
            f"found {value:g}", key=name, allowed=f"allowed {declaration.low:g} to {declaration.high:g}{unit}"
        )


@dataclass(frozen=True)
class Paper:
    """The seven parameters of Lang et al. 2022, at the paper's defaults.

    What the paper calls σ are full widths at half maximum. κ relates printed to exposed height; the paper takes it
    as positive and below one, the small margin above one leaves room for the height scale of an instrument.
    """

    exposure_fwhm_xy_um: float = declare(0.5, "µm", 0.05, 3.0, "lateral FWHM of the exposing focus")
    exposure_fwhm_z_um: float = declare(1.5, "µm", 0.1, 10.0, "axial FWHM of the exposing focus")
    threshold: float = declare(0.5, "1", 0.05, 0.95, "polymerisation threshold, fraction of the full dose")
    crosslink_fwhm_xy_um: float = declare(7.0, "µm", 0.5, 30.0, "lateral FWHM of cross-linking")
    crosslink_fwhm_z_um: float = declare(7.0, "µm", 0.5, 30.0, "axial FWHM of cross-linking")
    shrinkage_min: float = declare(0.7, "1", 0.3, 1.1, "height factor where cross-linking is weakest (kappa_min)")
    shrinkage_max: float = declare(1.0, "1", 0.3, 1.1, "height factor where cross-linking is strongest (kappa_max)")

    def __post_init__(self) -> None:
        for name, (_, declaration) in declarations(self).items():
            check_range(name, getattr(self, name), declaration)
        if self.shrinkage_min > self.shrinkage_max:
            raise InputError(
                f"found {self.shrinkage_min:g}",
                key="shrinkage_min",
                allowed=f"at most shrinkage_max = {self.shrinkage_max:g}",
            )


@dataclass(frozen=True)
class Writing:
    """How the part is written: fixed by the print job, never fitted."""

    slicing_um: float = declare(0.0, "µm", 0.0, 5.0, "slice distance; 0 = continuous heights", fitted=False)
    hatching_um: float = declare(0.1, "µm", 0.001, 5.0, "line distance (kept for the record)", fitted=False)
    fast_axis: Literal["y"] = "y"

    def __post_init__(self) -> None:
        for name, (_, declaration) in declarations(self).items():
            check_range(f"writing.{name}", getattr(self, name), declaration)
        if self.fast_axis != "y":
            raise InputError(
                f"found {self.fast_axis}",
                key="writing.fast_axis",
                allowed="allowed: y (turn the target instead)",
            )


@dataclass(frozen=True)
class Readings:
    """Which reading of the paper is taken where its text leaves a choice.

    Parameters
    ----------
    threshold_reference : {"full_dose", "structure_maximum"}
        What the threshold is a fraction of: the dose inside a large block (1), or the largest exposure in this
        structure (the paper's wording). They differ for parts thin against the focus.
    crosslink_reference : {"structure_maximum", "bulk"}
        What cross-linking is divided by before it is mapped to κ: its largest value in this structure (the
        paper, Eq. 3; κ then depends on the structure), or its value inside a large block (1).
    pixels : {"points", "squares", "either"}
        What a pixel of a map is: a point of a smooth surface; or a square that is written as such, and whose height in
        a print is the mean over it. They differ by the variance p²/12 of a square of side p beside that of the focus.
        Where nothing tells which, half way between them errs least, and intervals hold both.
    """

    threshold_reference: Literal["full_dose", "structure_maximum"] = "full_dose"
    crosslink_reference: Literal["structure_maximum", "bulk"] = "structure_maximum"
    pixels: Literal["points", "squares", "either"] = "points"

    def __post_init__(self) -> None:
        for name, choices in READING_CHOICES.items():
            if getattr(self, name) not in choices:
                raise InputError(
                    f"found {getattr(self, name)}",
                    key=f"readings.{name}",
                    allowed=f"allowed: {' or '.join(choices)}",
                )

    @property
    def square_share(self) -> float:
        """How much of a square a pixel is: 0 a point, 1 all."""
        return {"points": 0.0, "either": 0.5, "squares": 1.0}[self.pixels]


READING_CHOICES = {
    "threshold_reference": ("full_dose", "structure_maximum"),
    "crosslink_reference": ("structure_maximum", "bulk"),
    "pixels": ("points", "squares", "either"),
}


Side = Literal["print", "measurement"]


@dataclass(frozen=True)
class Process:
    """The seven and the effects of one process, fitted together.

    Parameters
    ----------
    paper : Paper
    effects : tuple of effect steps
    """

    paper: Paper
    effects: tuple[Any, ...]


@dataclass(frozen=True)
class Undecided:
    """Effects that may as well be on the other side, and the process if they happen to the print or in the measurement.

    Parameters
    ----------
    effects : tuple of str
        Names, as listed under the file's effects.
    print, measurement : Process
        What the data say if all of them are of this side: everything else answers to that.
    """

    effects: tuple[str, ...]
    print: Process
    measurement: Process


@dataclass(frozen=True)
class ParameterSet:
    """Everything a parameter file says: the process, and what is known about its parameters.

    Parameters
    ----------
    paper : Paper
        The seven.
    writing : Writing
    readings : Readings
    effects : tuple of effect steps
        Added physics, in the order of the file.
    bounds, intervals : dict
        Parameter name to (low, high): bounds of a fit, and 95 % intervals of a calibration.
    provenance : dict
        Where the values come from: inputs' SHA-256, versions, command.
    undecided : Undecided, optional
        Effects whose side the data cannot tell.
    """

    paper: Paper = field(default_factory=Paper)
    writing: Writing = field(default_factory=Writing)
    readings: Readings = field(default_factory=Readings)
    effects: tuple[Any, ...] = ()
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    undecided: Undecided | None = None

    def decided(self, side: Side) -> ParameterSet:
        """Return the process as it is if everything whose side is open is of this side.

        The intervals are left out unless it is the process at hand: they are of that one.
        """
        if self.undecided is None:
            return self
        chosen: Process = getattr(self.undecided, side)
        decided = replace(self, paper=chosen.paper, effects=chosen.effects, undecided=None)
        if (self.paper, self.effects) == (decided.paper, decided.effects):
            return decided
        return replace(decided, intervals={})
