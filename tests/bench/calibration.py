"""Calibration against known truth: coverage of the 95 % intervals, and fast against simplex.

Run as ``python -m tests.bench.calibration [--trials 100] [--cases 20] [--first 0]``; `make bench-calibration` does.
Recordings are predictions, every other trial prints of the virtual press with its own physics off, with 20 nm of
correlated noise: white noise under a Gaussian filter. The press prints on finer pixels that resolve its focus; the
program knows the target, and the recording, at the centres of the coarse ones only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dlwpredict import designs
from dlwpredict.calibration import calibrate
from dlwpredict.calibration.simplex import QUIET_UM, simplex
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.baseline import rough
from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import Free, choose, value_of
from dlwpredict.infer.noises import white
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.priors import LEVELLING, SHIFTS
from dlwpredict.infer.recording import Recording, prepare
from dlwpredict.infer.whitened import Whitened
from dlwpredict.numerics.smoothing import blur
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict
from tests.press import press_from, print_part

NOISE_UM = 0.02
PITCH_UM = 0.5
FINER = 3  # the press's pixels per recorded pixel and side; odd, so that centres coincide
SAME = 1e-4  # fast has reached the rmse of simplex where it is at most this share above it


def targets() -> list[HeightMap]:
    """Build a small trio with the substrate in view, on the pixels of the press: chirp, roughness, stairs."""
    common = {"pitch_um": PITCH_UM / FINER, "margin_um": 4.0}
    return [
        designs.cin(size_um=32.0, **common),
        designs.air(size_um=32.0, **common),
        designs.stairs(size_um=32.0, feature_um=4.0, **common),
    ]


def at_centres(part: HeightMap) -> HeightMap:
    """Return the heights at the centres of the recorded pixels."""
    return HeightMap(part.heights_um[FINER // 2 :: FINER, FINER // 2 :: FINER], PITCH_UM, PITCH_UM)


def drawn_truth(rng: np.random.Generator) -> ParameterSet:
    """Draw seven parameters about the paper's."""
    low = np.array([0.45, 1.3, 0.40, 5.5, 5.5, 0.68, 0.90])
    high = np.array([0.65, 1.9, 0.55, 8.5, 8.5, 0.80, 1.00])
    return ParameterSet(paper=Paper(*rng.uniform(low, high)))


def noise(rng: np.random.Generator, shape: tuple[int, int], width_um: float) -> np.ndarray:
    """Draw Gaussian-filtered noise of 20 nm (standard deviation of the filter: width_um)."""
    wide = [n + 2 * int(6 * width_um / PITCH_UM) for n in shape]
    field = blur(rng.standard_normal(wide), width_um / PITCH_UM, width_um / PITCH_UM)
    rows, cols = ((n - m) // 2 for n, m in zip(wide, shape, strict=True))
    field = field[rows : rows + shape[0], cols : cols + shape[1]]
    return NOISE_UM * field * (2 * np.sqrt(np.pi) * width_um / PITCH_UM)


def pressed(part: HeightMap, truth: ParameterSet) -> HeightMap:
    """Print a part on the virtual press, its own physics off."""
    names = {"exposure_fwhm_xy_um": "focus_fwhm_xy_um", "exposure_fwhm_z_um": "focus_fwhm_z_um"}
    settings = {names.get(name, name): value for name, value in vars(truth.paper).items()}
    return part.with_heights(print_part(part.heights_um, part.dx_um, part.dy_um, press_from(settings)))


def recorded(
    parts: list[HeightMap], truth: ParameterSet, rng: np.random.Generator, *, on_press: bool = False
) -> tuple[Recording, ...]:
    """Record the trio: each with noise of its own correlation, 0.4 to 1 µm."""
    found = []
    for part in parts:
        target = at_centres(part)
        printed = at_centres(pressed(part, truth)) if on_press else predict(target, truth)
        heights = printed.heights_um + noise(rng, target.shape, rng.uniform(0.4, 1))
        found.append(prepare(target, target.with_heights(heights)))
    return tuple(found)


def coverage(trials: range, seed: int) -> None:
    """Print how often the intervals cover the truth."""
    names = list(declarations(Paper))
    covered, known, missed, seconds, work = [], [], [], [], []
    for trial in trials:
        rng = np.random.default_rng([seed, trial])
        truth = drawn_truth(rng)
        started = time.perf_counter()
        parts = recorded(targets(), truth, rng, on_press=bool(trial % 2))
        found = calibrate(parts, choose(ParameterSet()), seed=trial)
        seconds.append(time.perf_counter() - started)
        work.append(found.work["all"])
        values = np.array([value_of(truth, name) for name in names])
        low, high = found.intervals.ends.T
        covered.append((low <= values) & (values <= high))
        known.append(list(found.identified.values()))
        missed.append((found.end.vector - values) / values)
        print(
            f"trial {trial}: identified {sum(known[-1])}, of these covered {int(sum(covered[-1][known[-1]]))}; missed "
            f"{[n for n, c in zip(names, covered[-1], strict=True) if not c]}",
            flush=True,
        )
    covered, known = np.array(covered), np.array(known)
    print(f"\n95 % intervals over {len(trials)} trials, {NOISE_UM * 1e3:.0f} nm noise, {np.median(seconds):.1f} s each")
    print(f"{'parameter':<24}{'identified':>12}{'covered':>10}{'error rms %':>13}{'bias %':>8}")
    for k, name in enumerate(names):
        error = 100 * np.array(missed)[:, k]
        print(
            f"{name:<24}{known[:, k].mean():>12.0%}{covered[:, k].mean():>10.1%}"
            f"{np.sqrt(np.mean(error**2)):>13.2f}{error.mean():>8.2f}"
        )
    print(f"{'all identified':<24}{'':>12}{covered[known].mean():>10.1%}   (wanted 90 to 98 %)")
    for label, part in (("own predictions", slice(0, None, 2)), ("virtual press", slice(1, None, 2))):
        print(f"  {label:<22}{'':>12}{covered[part][known[part]].mean():>10.1%}")
    print(f"work per trial: {np.median(work):.0f} predictions of the trio, intervals included")


def fast(recordings: Sequence[Recording], free: Free, work: Work) -> Fit:
    """Follow the loss of the simplex, the plain sum of squares, down with derivatives, from where a rough fit ends."""
    begun = rough(recordings, free, {}, work, spikes=False)[1]
    few = [replace(r, nuisances=tuple(n for n in r.nuisances if n in (*LEVELLING, *SHIFTS))) for r in recordings]
    plain = Objective(tuple(Whitened.of(r, white(r, QUIET_UM)) for r in few), {}, work)
    return descend(plain, plain.differentiated(plain.at(free, begun.vector)))


METHODS: dict[str, Callable[[Sequence[Recording], Free, Work], Fit]] = {
    "fast": fast,
    "simplex": lambda recordings, free, work: simplex(recordings, free, work, spikes=False)[1],
}


def race(cases: range, seed: int) -> None:
    """Print fast against simplex from the same start, on the same square loss."""
    wins, works, walls = [], [], []
    for case in cases:
        rng = np.random.default_rng([seed, 1000 + case])
        recordings = recorded(targets()[: 1 + case % 2], drawn_truth(rng), rng)
        found = {}
        for name, method in METHODS.items():
            work, started = Work(), time.perf_counter()
            fit = method(recordings, choose(ParameterSet()), work)
            found[name] = fit.rmse_um(), work.predictions, time.perf_counter() - started
        (a, wa, ta), (b, wb, tb) = found["fast"], found["simplex"]
        wins.append(a <= b * (1 + SAME))
        works.append(wb / wa)
        walls.append(tb / ta)
        print(
            f"case {case:2d}: rmse fast {1e3 * a:.4f} nm, simplex {1e3 * b:.4f} nm; "
            f"work {wa:.0f} against {wb:.0f} (x{wb / wa:.0f}); wall {ta:.1f} against {tb:.1f} s (x{tb / ta:.0f})",
            flush=True,
        )
    print(
        f"\nfast reaches the same or a lower rmse (to {SAME:.0e}) in {np.mean(wins):.0%} of {len(cases)} (wanted 95 %)"
    )
    print(f"work ratio: median x{np.median(works):.0f}, least x{min(works):.0f} (wanted 20)")
    print(f"wall ratio: median x{np.median(walls):.0f}, least x{min(walls):.0f}")


def main() -> None:
    """Run both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="skip this many, where a run is split")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    if chosen.cases > chosen.first:
        race(range(chosen.first, chosen.cases), chosen.seed)
    if chosen.trials > chosen.first:
        coverage(range(chosen.first, chosen.trials), chosen.seed)


if __name__ == "__main__":
    main()
