"""Which cases there are and what is drawn for each: pure functions of a seed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from tests.bench.cases import RANGES
from tests.prove import structures
from tests.prove.hidden import FORMS, NAMED, OUTSIDE, Hidden, form, named, outside

DEVELOPMENT_SEED, FINAL_SEED = 20250, 883486
"""The final seed is used by `make prove` alone, never while anything is tuned; once its truth has been looked at and
the program is changed, it is spent, and another is drawn (77031, 345967, 186561, 973189, 244348, 391491, 397021,
614839, 908213, 550173, 731906, 428617, 122774, 787942, 282159, 469281, 711323, 524530, 812914,
169957, 604127, 317074, 741905, 905263, 445236, 600002, 355611, 925340, 179067 and 631096 were)."""

FULL = {"null": 60, "single": 90, "pair": 60, "outside": 40, "absorbed": 20, "measurement": 20, "form": 20}
QUICK = {"null": 5, "single": 6, "pair": 2, "outside": 3, "absorbed": 2, "measurement": 2, "form": 2}

WEAKEST, STRONGEST = 0.3, 5.0
"""Strengths are drawn between these multiples of the detection limit, uniform in the logarithm."""

CLEAR, SPARE = 1.5, 8
"""In every second pair both effects are to reach this multiple; where one cannot, or is twice the strongest at whatever
value was tried, another takes its place, of so many that are drawn besides."""

MILD = 0.3, 3.0
"""What calibration leaves of an error of form beside other things, in multiples of the detection limit."""

RAW_SHARE, FREE_SHARE, ROW_SHARE, FORM_SHARE = 0.5, 0.5, 0.25, 0.5
"""Shares of the cases: recorded raw; of these, turned by any angle; with noise of rows; with an error of form."""

RAW_PITCHES_UM, ROW_UM = (0.15, 0.45), (0.002, 0.008)
"""Pitch of the microscope, and standard deviation of the offset that every row has of its own."""

UNEVEN_SHARE, UNEVEN_UM = 0.5, (0.05, 0.2)
"""Share of the raw recordings with noise of rows whose fast axis does not move evenly, and by how much it is off: in
half of sixteen recordings of an atomic force microscope it was off by 0.06 to 0.09 on the part alone."""

LITTLE_DEG, ABOUT_DEG = 8.0, 4.0
"""Raw recordings are turned by up to the first; by any angle; or by about a quarter or half turn, give or take the
second."""

ABSORBED = (
    "instrument-blur", "astigmatism", "shrinkage-nonlinearity", "z-amplification", "spherical-aberration", "z-drift",
    "power-drift", "interface-offset", "psf-wings", "z-linearity",
)  # fmt: skip
"""Effects that calibration absorbs on one roughness map: each is recorded there alone, and on three structures."""

MEASUREMENT = (
    "field-curvature", "stitching", "misregistration", "batwings", "slope-error", "stitching", "misregistration",
    "z-linearity", "vignetting", "stitching", "misregistration", "instrument-blur", "spikes", "stitching",
    "misregistration", "galvo-lag", "levelling", "stitching", "misregistration", "stitching",
)  # fmt: skip
"""The microscope's own effects, effects of the print that look like them (vignetting, galvo lag, stitching), and what a
recording may have without any fault of print or model."""


@dataclass(frozen=True)
class Draw:
    """What is drawn for a case, strengths still in multiples of the detection limit.

    Parameters
    ----------
    kind : str
    index : int
    process : dict
        The press's seven.
    conversion : float
        η of the resin.
    noise : dict
        Of the microscope.
    structures : list of dict
        Recorded and given to the program.
    holdout : dict
        Printed too, kept from the program.
    hidden : tuple of Hidden
    times : tuple of float
        Strength of each in multiples of its detection limit.
    microscope : dict
        Spikes, dropouts, tilt.
    limit_on : list of dict
        Structures that the detection limit is taken on.
    pitch_um : float
        Of the targets.
    form : Hidden, optional
        How the process differs in form from the seven's model.
    form_times : float
        What calibration leaves of that, in multiples of the detection limit.
    spare : tuple of Hidden
        Effects that take the place of those that cannot reach `least`, or are far stronger at any value.
    least : float
        Multiple that both effects of a pair are to reach.
    raw : dict
        `pitch_um` of the microscope, `turn_deg` of the part under it, `uneven_um` of its fast axis; empty: recorded on
        the target's grid.
    """

    kind: str
    index: int
    process: dict
    conversion: float
    noise: dict
    structures: list[dict]
    holdout: dict
    hidden: tuple[Hidden, ...]
    times: tuple[float, ...]
    microscope: dict
    limit_on: list[dict]
    pitch_um: float = structures.COARSE_UM
    form: Hidden | None = None
    form_times: float = 0.0
    spare: tuple[Hidden, ...] = ()
    least: float = 0.0
    raw: dict = field(default_factory=dict)


def name_of(seed: int, kind: str, index: int) -> str:
    """Return an opaque name."""
    return hashlib.sha256(f"{seed}/{kind}/{index}".encode()).hexdigest()[:10]


def listed(mix: dict[str, int]) -> Iterator[tuple[str, int]]:
    """Yield kind and index of every case, the kinds taking turns, so that an interrupted run has some of each."""
    places = [((index + 0.5) / count, kind, index) for kind, count in mix.items() for index in range(count)]
    yield from ((kind, index) for _, kind, index in sorted(places))


def draw(seed: int, kind: str, index: int) -> Draw:
    """Draw a case."""
    alone = kind == "absorbed" and index % 2 == 0
    twin = index // 2 if kind == "absorbed" else index
    rng = np.random.default_rng([seed, list(FULL).index(kind), twin])
    process = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    conversion = float(rng.choice([0.0, rng.uniform(0.2, 1.0)]))
    noise = {
        "sigma_um": float(np.exp(rng.uniform(np.log(0.006), np.log(0.03)))),
        "correlation_um": float(np.exp(rng.uniform(np.log(0.5), np.log(2.5)))),
        "kind": str(rng.choice(["gaussian", "matern32", "exponential"])),
        "white_um": float(rng.uniform(0.002, 0.005)),
        "row_um": float(rng.uniform(*ROW_UM)) if rng.random() < ROW_SHARE else 0.0,
    }
    raw, upright = _raw(rng)
    scale = structures.HALF if (twin + 1) % structures.WHOLE_EVERY else structures.WHOLE
    several, holdout = structures.several(rng, scale, upright=upright)
    if kind == "absorbed":
        several, holdout = _with_roughness(rng, scale, upright)
    given = [one for one in several if one["kind"] == "air"] if alone else several
    hidden, microscope = _hidden(kind, twin, rng)
    least = CLEAR if kind == "pair" and index % 2 == 0 else 0.0
    low = 2.0 if kind == "absorbed" else max(WEAKEST, 1.1 * least)
    times = tuple(_between(rng, low, STRONGEST) for _ in hidden)
    spare = tuple(named(str(name), rng) for name in _others(hidden, rng)) if least else ()
    wrong, form_times = _form(kind, twin, rng)
    if raw:
        raw["uneven_um"] = _uneven(rng) if noise["row_um"] else 0.0
    return Draw(
        kind, index, process, conversion, noise, given, holdout, hidden, times, microscope, several,
        float(rng.uniform(*structures.PITCHES_UM[scale])), wrong, form_times, spare, least, raw,
    )  # fmt: skip


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _raw(rng: np.random.Generator) -> tuple[dict, bool]:
    """Draw pitch and turn of a raw recording, if it is one, and whether its structures must show the turn."""
    raw, free, about = rng.random() < RAW_SHARE, rng.random() < FREE_SHARE, rng.random() < 0.5
    pitch_um, little = float(rng.uniform(*RAW_PITCHES_UM)), float(rng.uniform(-LITTLE_DEG, LITTLE_DEG))
    quarter = 90.0 * int(rng.integers(1, 4)) + float(rng.uniform(-ABOUT_DEG, ABOUT_DEG))
    anyhow = float(rng.uniform(-180, 180))
    turn_deg = little if not free else quarter if about else anyhow
    return ({"pitch_um": pitch_um, "turn_deg": turn_deg}, free) if raw else ({}, False)


def _uneven(rng: np.random.Generator) -> float:
    """Draw by how much the fast axis of an instrument is off, to either side."""
    on, size, sign = rng.random() < UNEVEN_SHARE, float(rng.uniform(*UNEVEN_UM)), float(rng.choice([-1.0, 1.0]))
    return sign * size if on else 0.0


def _with_roughness(rng: np.random.Generator, scale: float, upright: bool) -> tuple[list[dict], dict]:
    """Draw three structures, a roughness map among them, and one to be held out."""
    while True:
        several, holdout = structures.several(rng, scale, upright=upright)
        if len(several) == max(structures.COUNTS) and any(one["kind"] == "air" for one in several):
            return several, holdout


def _others(hidden: tuple[Hidden, ...], rng: np.random.Generator) -> list[str]:
    """Draw names besides those of a pair."""
    left = [name for name in NAMED if name not in {one.name for one in hidden}]
    return [str(name) for name in rng.choice(left, SPARE, replace=False)]


def _form(kind: str, index: int, rng: np.random.Generator) -> tuple[Hidden | None, float]:
    """Draw how the process differs in form, and what calibration leaves of it; in turn where nothing else is wrong."""
    on, name = rng.random() < FORM_SHARE, str(rng.choice(FORMS))
    if kind == "form":
        return form(FORMS[index % len(FORMS)], rng), _between(rng, WEAKEST, STRONGEST)
    return (form(name, rng), _between(rng, *MILD)) if on else (None, 0.0)


def _hidden(kind: str, index: int, rng: np.random.Generator) -> tuple[tuple[Hidden, ...], dict]:
    """Draw what is concealed, the names in turn, and what the microscope does besides."""
    if kind == "single":
        return (named(NAMED[index % len(NAMED)], rng),), {}
    if kind == "pair":
        return tuple(named(str(name), rng) for name in rng.choice(NAMED, 2, replace=False)), {}
    if kind == "outside":
        return (outside(list(OUTSIDE)[index % len(OUTSIDE)], rng),), {}
    if kind == "absorbed":
        return (named(ABSORBED[index % len(ABSORBED)], rng),), {}
    if kind == "measurement":
        name = MEASUREMENT[index % len(MEASUREMENT)]
        if name == "spikes":
            return (), {
                "spikes": {"fraction": 0.002, "height_um": 0.5},
                "dropouts": {"fraction": 0.05, "max_angle_deg": 65.0},
            }
        if name == "levelling":
            return (), {"tilt_mrad": rng.uniform(-3, 3, 2).tolist(), "offset_um": float(rng.uniform(-0.5, 0.5))}
        return (named(name, rng),), {}
    return (), {}
