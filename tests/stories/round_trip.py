"""From raw recordings to a corrected print on the same press: with the seven parameters, and with what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.stories import pictures
from tests.stories.bench import NOISE, Bench

PARTS = {
    "waves": ("cin", {"base_um": 5.0, "height_um": 1.5, "period_min_um": 3.5, "period_max_um": 10.0}),
    "rough": ("air", {"base_um": 5.0, "height_um": 2.0, "correlation_um": 4.0, "seed": 11}),
    "stairs": ("stairs", {"base_um": 3.0, "height_um": 5.0, "count": 3, "feature_um": 3.2, "feature_height_um": 0.8}),
}

POSES = (
    {"shift_um": [1.3, -0.8], "rotation_deg": 3.4, "tilt_mrad": [2.1, -3.3], "offset_um": 4.2},
    {"shift_um": [-0.7, 1.1], "rotation_deg": -5.2, "tilt_mrad": [-1.6, 2.4], "offset_um": -1.5},
    {"shift_um": [0.4, 0.9], "rotation_deg": 1.9, "tilt_mrad": [3.0, 1.2], "offset_um": 0.6},
)
"""How the parts lie under the microscope."""

RAW = {
    "pitch_um": 0.35, "field_um": 50.0, "noise": NOISE, "spikes": {"fraction": 0.0005, "height_um": 1.0},
    "dropouts": {"max_angle_deg": 65, "fraction": 0.02, "blotch_um": 2.0},
}  # fmt: skip
"""The microscope's own pixels and faults: noise, spikes, and holes where it is steep and in blotches."""

SEVEN, FOUND = "seven parameters", "with what was found"
WAYS = {SEVEN: "process", FOUND: "found_extended"}
"""The two corrections and the parameter file of each. What may be the microscope's is not corrected ..."""

BOLD = "the open ones taken for the print's"
"""... and for comparison, where the side of something is open, the opposite."""


@dataclass(frozen=True)
class Trip:
    """What a round trip gives.

    Parameters
    ----------
    poses : list of dict
        What `align` found of each recording, beside the truth.
    diagnosis : dict
    off_um : dict of str to dict of str to float
        True shape errors: of the first print, and of the corrected ones, by part.
    refusal : str
        What `precompensate` says where the side of something is open.
    """

    poses: list[dict[str, Any]]
    diagnosis: dict[str, Any]
    off_um: dict[str, dict[str, float]]
    refusal: str = ""

    def rms(self, way: str) -> float:
        """Return the root of the mean square of a way's errors over the parts, µm."""
        return float(np.sqrt(np.mean(np.square([*self.off_um[way].values()]))))

    def change(self, way: str = FOUND) -> float:
        """Return by which share the error of a way differs from that of the seven parameters."""
        return self.rms(way) / self.rms(SEVEN) - 1

    def table(self) -> str:
        """Return the errors as a Markdown table, nm."""
        heads = [*PARTS, "all"]
        lines = [f"| true shape error / nm | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
        for way, errors in self.off_um.items():
            values = [*(errors[part] for part in PARTS), self.rms(way)]
            lines.append(f"| {way} | " + " | ".join(f"{1e3 * value:.1f}" for value in values) + " |")
        return "\n".join(lines)

    def aligned(self) -> str:
        """Return how far the alignment was off and how much was missing, in words."""
        turns = [abs(one["found"]["rotation_deg"] - one["true"]["rotation_deg"]) for one in self.poses]
        most = max(abs(one["true"]["rotation_deg"]) for one in self.poses)
        missing = [100 * one["found"]["missing_fraction"] for one in self.poses]
        return (
            f"turned by up to {most:.1f}° (found to {max(turns):.3f}°), tilted, "
            f"{min(missing):.1f} to {max(missing):.1f} % of the points not measured"
        )

    def figures(self) -> dict[str, Any]:
        """Return all numbers."""
        pooled = {way: self.rms(way) for way in self.off_um}
        return {"off_um": self.off_um, "rms_um": pooled, "change": self.change(), "refusal": self.refusal,
                "poses": self.poses}  # fmt: skip


def round_trip(
    bench: Bench, *, effects: Sequence[Mapping] = (), artefacts: Sequence[Mapping] = (), **press: float
) -> Trip:
    """Print, record, align, calibrate, diagnose, correct both ways, print again."""
    settings = bench.settings("press.yaml", effects=effects, **press)
    pairs, poses, off = {}, [], {"first print": {}}
    for seed, ((part, (kind, options)), pose) in enumerate(zip(PARTS.items(), POSES, strict=True), start=1):
        target = bench.design(kind, part, **options)
        printed = bench.printed(target, settings, part)
        raw = bench.recorded(printed, f"{part}_raw", seed=seed, pixels=None, effects=list(artefacts), pose=pose, **RAW)
        aligned, report = f"{part}_aligned.tif", f"{part}_align.yaml"
        bench.program("align", raw, target, "--distortion", "rigid", "-o", aligned, "--report", report)
        poses.append({"true": pose, "found": {key: bench.yaml(report)[key] for key in (*pose, "missing_fraction")}})
        pairs[part] = target, aligned
        off["first print"][part] = bench.off(target, bench.surface(printed, f"{part}_first"))
    bench.calibrated("process", [*pairs.values()])
    found = bench.diagnosed("found", [*pairs.values()], "-p", "process.yaml", "--no-advice")
    refusal = ""
    for way, process in WAYS.items():
        sided = "undecided" in bench.yaml(f"{process}.yaml")
        if sided:
            refusal = bench.refused("precompensate", "waves.tif", "-p", f"{process}.yaml", "-o", "refused.tif")
            off[BOLD] = {part: _corrected(bench, part, process, settings, "print") for part in PARTS}
        off[way] = {part: _corrected(bench, part, process, settings, "measurement" if sided else "") for part in PARTS}
    draw(bench, off)
    return Trip(poses, found, off, refusal)


def _corrected(bench: Bench, part: str, process: str, press: str, side: str) -> float:
    """Correct a target, print it again, and return how far the print is off the target, µm."""
    name = f"{part}_{process}" + ("_as_print" if side == "print" else "")
    words = ["--undecided", side] if side else []
    bench.program("precompensate", f"{part}.tif", "-p", f"{process}.yaml", *words, "-o", f"{name}_written.tif")
    again = bench.printed(f"{name}_written.tif", press, name)
    return bench.off(f"{part}.tif", bench.surface(again, f"{name}_again"))


def draw(bench: Bench, off: Mapping[str, Mapping[str, float]]) -> None:
    """Draw the errors as bars and, of every part, what the two corrected prints are off."""
    corrected = {way: [*off[way].values()] for way in WAYS}
    pictures.bars(bench.folder / "errors.png", [*PARTS], corrected)
    for part in PARTS:
        target = bench.map(f"{part}.tif")
        errors = {way: pictures.error(target, bench.map(f"{part}_{name}_again.tif")) for way, name in WAYS.items()}
        raw = bench.map(f"{part}_raw.tif")
        pictures.maps(bench.folder / f"{part}.png", {"raw recording": raw}, errors)


PICTURES = {
    "errors.png": "True shape errors of the corrected prints, which only the press knows.",
    **{
        f"{part}.png": f"{part}: raw recording, and what the two corrected prints are off the target." for part in PARTS
    },
}
