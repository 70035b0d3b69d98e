"""Which cases there are and what is drawn for each: pure functions of a seed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.bench.cases import RANGES
from tests.prove import structures
from tests.prove.hidden import NAMED, OUTSIDE, Hidden, named, outside

DEVELOPMENT_SEED, FINAL_SEED = 20250, 550173
"""The final seed is used by `make prove` alone, never while anything is tuned; once its truth has been looked at and
the program is changed, it is spent, and another is drawn (77031, 345967, 186561, 973189, 244348, 391491, 397021,
614839 and 908213 were)."""

FULL = {"null": 60, "single": 90, "pair": 30, "outside": 30, "absorbed": 20, "measurement": 10}
QUICK = {"null": 5, "single": 6, "pair": 2, "outside": 3, "absorbed": 2, "measurement": 2}

WEAKEST, STRONGEST = 0.3, 5.0
"""Strengths are drawn between these multiples of the detection limit, uniform in the logarithm."""

ABSORBED = (
    "instrument-blur", "astigmatism", "shrinkage-nonlinearity", "z-amplification", "spherical-aberration", "z-drift",
    "power-drift", "interface-offset", "psf-wings", "z-linearity",
)  # fmt: skip
"""Effects that calibration absorbs on one roughness map: each is recorded there alone, and on three structures."""

MEASUREMENT = (
    "field-curvature", "batwings", "slope-error", "z-linearity", "instrument-blur",  # the microscope's own
    "vignetting", "galvo-lag",  # of the print, and look like the microscope's
    "misregistration", "spikes", "levelling",  # what a recording may have without any fault of print or model
)  # fmt: skip


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
    }
    several, holdout = structures.several(rng)
    if kind == "absorbed" and not any(one["kind"] == "air" for one in several):
        several[0] = structures.drawn("air", rng)
    given = [one for one in several if one["kind"] == "air"] if alone else several
    hidden, microscope = _hidden(kind, twin, rng)
    low = 2.0 if kind == "absorbed" else WEAKEST
    times = tuple(float(np.exp(rng.uniform(np.log(low), np.log(STRONGEST)))) for _ in hidden)
    return Draw(kind, index, process, conversion, noise, given, holdout, hidden, times, microscope, several)


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
