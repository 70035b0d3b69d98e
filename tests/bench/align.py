"""Alignment against known poses: error of shift and rotation, wrong turns and mirrors, coverage of the uncertainties.

Run as ``python -m tests.bench.align [--trials 48] [--seed 0]``; `make bench-align` does.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.errors import ResultError
from dlwpredict.heightmap import HeightMap
from tests.bench.recorder import Truth, record

TARGETS = {
    "f": lambda seed: designs.f(pitch_um=0.25),
    "air": lambda seed: designs.air(size_um=40.0, pitch_um=0.25, margin_um=5.0, seed=seed),
    "air cut": lambda seed: cut(designs.air(size_um=60.0, pitch_um=0.25, margin_um=0.0, base_um=0.5, seed=seed), 30),
    "stairs": lambda seed: designs.stairs(size_um=40.0, pitch_um=0.25, margin_um=5.0, feature_um=4.0),
    "cin": lambda seed: designs.cin(size_um=40.0, pitch_um=0.25, margin_um=5.0),
}
SYMMETRY_DEG = {"cin": 90.0}  # turns that leave the target as it is; such a target has no mirror image either


def cut(part: HeightMap, rim: int) -> HeightMap:
    """Cut a rim of pixels off: a recording then shows no substrate."""
    return part.with_heights(part.heights_um[rim:-rim, rim:-rim])


def drawn(target: HeightMap, rng: np.random.Generator) -> Truth:
    """Draw pose and flaws: rotation ±180° (a third near quarter turns), shift ±20 %, ratio 0.3–3, tilt ±10 mrad."""
    size = np.array(target.size_um)
    turn = rng.uniform(-180, 180) if rng.random() < 2 / 3 else 90 * rng.integers(-1, 3) + rng.uniform(-2, 2)
    pitch = target.dx_um * np.exp(rng.uniform(np.log(0.3), np.log(3)))
    return Truth(
        shift_um=tuple(rng.uniform(-0.2, 0.2, 2) * size),
        rotation_deg=float(turn),
        tilt_mrad=tuple(rng.uniform(-10, 10, 2)),
        offset_um=float(rng.uniform(-3, 3)),
        pitch_um=(pitch, pitch * rng.choice([1.0, 1.0, 0.8])),
        field_um=tuple(rng.uniform(1.3, 1.6) * size),
        gain=float(rng.uniform(0.5, 1.2)),
        blur_um=float(rng.uniform(0.2, 0.6)),
        dome=float(rng.uniform(0, 0.2)),
        noise_um=float(rng.uniform(0.005, 0.03)),
        missing=float(rng.uniform(0.05, 0.3)),
        spikes=float(rng.uniform(0, 0.003)),
        mirrored=bool(rng.random() < 0.25),
    )


def trial(name: str, seed: int) -> dict:
    """Record a target at a drawn pose and align it."""
    rng = np.random.default_rng([seed, *name.encode()])
    target = TARGETS[name](seed)
    truth = drawn(target, rng)
    if name in SYMMETRY_DEG:
        truth = replace(truth, mirrored=False)
    if name == "air cut":
        whole = designs.air(size_um=60.0, pitch_um=0.25, margin_um=0.0, base_um=0.5, seed=seed)
        recording = record(whole, truth, rng)
    else:
        recording = record(target, truth, rng)
    start = time.perf_counter()
    try:
        found = align(recording, target, allow_mirror=True)
    except ResultError as error:
        return {"name": name, "seed": seed, "refused": str(error), "truth": truth}
    turn = found.pose.rotation_deg - truth.rotation_deg
    period = SYMMETRY_DEG.get(name, 360.0)
    error = np.subtract(found.pose.shift_um, truth.shift_um)
    return {
        "name": name,
        "seed": seed,
        "seconds": time.perf_counter() - start,
        "shift_px": float(np.hypot(*error) / target.dx_um),
        "turn_deg": float((turn + period / 2) % period - period / 2),
        "mirror_wrong": found.pose.mirrored != truth.mirrored,
        "pull": [
            *(error / found.uncertainty["shift_um"]),
            ((turn + period / 2) % period - period / 2) / max(found.uncertainty["rotation_deg"], 1e-9),
        ],
        "distortion": found.distortion,
        "reference": found.aligned.height_reference,
        "found": found,
        "truth": truth,
    }


def table(results: list[dict]) -> str:
    """Lay the results out, one line per target."""
    head = f"{'target':10s} {'n':>3s} {'refused':>7s} {'turned':>6s} {'mirror':>6s}"
    head += "".join(f" {what:>27s}" for what in ("shift error/px: 50 95 100 %", "turn error/°: 50 95 100 %"))
    lines = [head + f" {'|pull|<2':>8s} {'rigid':>5s} {'s each':>6s}"]
    for name in [*dict.fromkeys(r["name"] for r in results), "all"]:
        mine = [r for r in results if name in (r["name"], "all")]
        good = [r for r in mine if "refused" not in r]
        right = [r for r in good if abs(r["turn_deg"]) < 5 and not r["mirror_wrong"]]
        row = f"{name:10s} {len(mine):3d} {len(mine) - len(good):7d} "
        row += f"{sum(abs(r['turn_deg']) >= 5 for r in good):6d} {sum(r['mirror_wrong'] for r in good):6d}"
        for key in ("shift_px", "turn_deg"):
            values = np.abs([r[key] for r in right]) if right else np.array([np.nan])
            row += "   " + "".join(f" {np.quantile(values, q):7.4f}" for q in (0.5, 0.95, 1.0))
        pulls = np.abs([r["pull"] for r in right]).ravel() if right else np.array([np.nan])
        row += f" {np.mean(pulls < 2):8.2f} {np.mean([r['distortion'] == 'rigid' for r in right] or [0]):5.2f}"
        lines.append(row + f" {np.median([r['seconds'] for r in good] or [0]):6.2f}")
    return "\n".join(lines)


def line(result: dict) -> str:
    """Say how one trial went."""
    truth = result["truth"]
    head = f"{result['name']} {result['seed']}: ratio {truth.pitch_um[0] / 0.25:.2f}, rotation {truth.rotation_deg:.0f}"
    if "refused" in result:
        return f"{head}: refused: {result['refused']}"
    quality = result["found"].quality
    return (
        f"{head}: {result['shift_px']:.4f} px {result['turn_deg']:.4f}°, mirror wrong {result['mirror_wrong']}, "
        f"odds {quality['match_log_odds']:.0f} lead {quality['lead_log_odds']:.0f}, {result['distortion']}, "
        f"{result['reference']}, pulls {np.round(result['pull'], 1)}, {result['seconds']:.1f} s"
    )


def main() -> None:
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--targets", nargs="+", default=list(TARGETS), choices=list(TARGETS))
    parser.add_argument("--verbose", action="store_true")
    wanted = parser.parse_args()
    results = []
    for k in range(wanted.trials):
        results.append(trial(wanted.targets[k % len(wanted.targets)], wanted.seed + k // len(wanted.targets)))
        if wanted.verbose:
            print(line(results[-1]), flush=True)
    print(table(results))


if __name__ == "__main__":
    main()
