"""What is timed: ``python -m tests.bench.speed.jobs NAME WORDS`` prints one line of JSON with seconds and peak memory.

Preparing the data and loading libraries is not timed; start-up is a figure of its own.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from scipy import fft, optimize

import dlwpredict.model.exposed_surface as exposed_surface
from dlwpredict import designs
from dlwpredict.calibration.simplex import EVALUATIONS_PER_PARAMETER, TOLERANCE
from dlwpredict.correction.precompensate import precompensate
from dlwpredict.diagnosis.run import Course, diagnose
from dlwpredict.files import read_height_map
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose
from dlwpredict.infer.objective import Work
from dlwpredict.infer.recording import prepare
from dlwpredict.model.column_mean import _chebyshev_levels
from dlwpredict.model.exposed_surface import LEVEL_STEP_SIGMAS
from dlwpredict.model.levels import Levels
from dlwpredict.numerics.parallel import Workers, cores
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict
from tests.bench.calibration import METHODS, noise
from tests.bench.cases import Case, recorded
from tests.bench.diagnosis import ROOT, ask, keep
from tests.bench.speed import reference

PROGRAM = Path(sys.executable).with_name("dlwpredict")
REAL = ROOT.parent / "shared" / "recordings" / "two_photon"
"""Real prints; `RECORDINGS` of the Makefile."""

PITCH_UM, SLICE_UM, MARGIN_UM = 0.1, 0.1, 4.0
TRUTH = ParameterSet(Paper(0.55, 1.6, 0.47, 6.2, 6.6, 0.74, 0.96))
FINE_STEP_SIGMAS = 0.1
"""Levels this close stand for the converged limit."""


def part(side_px: int, kind: str = "air", pitch_um: float = PITCH_UM) -> HeightMap:
    """Return a structure on side_px² pixels, substrate around; 11.5 µm high (air) or 10 µm (cin)."""
    seed = {"seed": 1} if kind == "air" else {}
    return getattr(designs, kind)(
        size_um=side_px * pitch_um - 2 * MARGIN_UM, pitch_um=pitch_um, margin_um=MARGIN_UM, **seed
    )


def printed(side_px: str, threads: str = "1", times: str = "1") -> Callable[[], dict]:
    """Predict with the program; ``times``: the structure is so many times higher."""
    target = part(int(side_px))
    target = target.with_heights(target.heights_um * float(times))
    predict(part(100), ParameterSet())  # loads what it needs
    return lambda: {"top_um": predict(target, ParameterSet(), numerics=Levels(int(threads))).heights_um.max()}


def voxels(side_px: str) -> Callable[[], dict]:
    """Predict with the voxels of the reference."""
    heights = part(int(side_px)).heights_um
    return lambda: {"top_um": reference.predict(heights, PITCH_UM, SLICE_UM, Paper()).max()}


def error(side_px: str) -> Callable[[], dict]:
    """Compare the prediction with that of much closer levels, in nm."""
    target = part(int(side_px))

    def run() -> dict:
        found = predict(target, ParameterSet()).heights_um
        exposed_surface.LEVEL_STEP_SIGMAS = FINE_STEP_SIGMAS
        difference = 1e3 * (found - predict(target, ParameterSet()).heights_um)
        return {"rms_nm": np.sqrt(np.mean(difference**2)), "most_nm": np.abs(difference).max()}

    return run


def floor(side_px: str) -> Callable[[], dict]:
    """Transform a plane forth and back for every level that the whole map needs."""
    target, paper = part(int(side_px)), Paper()
    top = target.heights_um.max()
    lowest = target.heights_um[target.heights_um > 0].min()
    focus, spread = (fwhm / FWHM_PER_SIGMA for fwhm in (paper.exposure_fwhm_z_um, paper.crosslink_fwhm_z_um))
    count = int((top - lowest + 4 * focus) / (LEVEL_STEP_SIGMAS * focus)) + 4
    count += len(_chebyshev_levels(float(top), spread))
    plane = np.random.default_rng(0).random(target.shape)

    def run() -> dict:
        for _ in range(count):
            fft.irfft2(fft.rfft2(plane), plane.shape)
        return {"levels": count}

    return run


def recording(kind: str, side_px: int, pitch_um: float):
    """Return a prepared pair: the truth's print with 20 nm of noise."""
    target = part(side_px, kind, pitch_um)
    heights = predict(target, TRUTH).heights_um
    return prepare(target, target.with_heights(heights + noise(np.random.default_rng(5), target.shape, 0.7)))


def calibrated(method: str, kind: str, side_px: str, pitch_um: str) -> Callable[[], dict]:
    """Calibrate one recording from the paper's defaults, full resolution at the end."""
    pair, work = recording(kind, int(side_px), float(pitch_um)), Work()

    def run() -> dict:
        fit = METHODS[method]([pair], choose(ParameterSet()), work)
        return {"rmse_nm": 1e3 * fit.rmse_um(), "predictions": work.predictions}

    return run


def voxel_simplex(kind: str, side_px: str, pitch_um: str) -> Callable[[], dict]:
    """Calibrate as the paper did: the simplex on voxels, with the rules of `calibration.simplex`, one run."""
    pair = recording(kind, int(side_px), float(pitch_um))
    declared = [known for _, known in declarations(Paper).values()]
    start = np.array([default for default, _ in declarations(Paper).values()])

    def rmse(values: np.ndarray) -> float:
        found = reference.predict(pair.target.heights_um, float(pitch_um), SLICE_UM, Paper(*values * start))
        return float(np.sqrt(np.mean((found[pair.used] - pair.heights_um) ** 2)))

    def run() -> dict:
        bounds = [(known.low / s, known.high / s) for known, s in zip(declared, start, strict=True)]
        most = EVALUATIONS_PER_PARAMETER * len(start)
        options = {"xatol": TOLERANCE, "fatol": TOLERANCE, "maxfev": most}
        found = optimize.minimize(rmse, np.ones(len(start)), method="Nelder-Mead", bounds=bounds, options=options)
        return {"rmse_nm": 1e3 * found.fun, "predictions": found.nfev}

    return run


def corrected(side_px: str) -> Callable[[], dict]:
    """Correct a structure."""
    target = part(int(side_px))
    predict(part(100), ParameterSet())
    count = 0

    def once(one: HeightMap) -> HeightMap:
        nonlocal count
        count += 1
        return predict(one, ParameterSet(), numerics=Levels(1))

    return lambda: precompensate(target, once) and {"predictions": count}


def diagnosed() -> Callable[[], dict]:
    """Diagnose three recordings of 145² points, the whole library, on all cores."""
    pairs = [prepare(target, seen) for target, seen in recorded(Case(seed=1000))]

    def run() -> dict:
        with Workers(cores(), diagnose.__module__) as workers:
            return {"verdict": diagnose(pairs, ParameterSet(), course=Course(workers=workers)).verdict}

    return run


LAG = {"name": "galvo-lag", "lag_um": 0.3, "model": "time"}
CURL = {"name": "curl", "rise_um": 0.04}
"""Twice their limits on three maps (10.3 and 11.0 standard deviations beside all that a fit moves, 10.3 and 11.2)."""

PRINTED = {
    "nothing": Case(seed=1000),
    "one": Case(effects=(LAG,), seed=2000),
    "two": Case(effects=(LAG, CURL), seed=3000),
}
"""Three maps of 145² points, and what is concealed in them."""


def aligned(target: Sequence[str], recording: Sequence[str], folder: Path) -> tuple[HeightMap, HeightMap]:
    """Convert and align a pair with the program's commands, as `make demo` and `make real` do."""
    target_file, recording_file, found = (str(folder / f"{name}.tif") for name in ("target", "recording", "aligned"))
    steps = ["convert", *target, target_file], ["convert", *recording, recording_file]
    for words in (*steps, ["align", recording_file, target_file, "-o", found]):
        subprocess.run([str(PROGRAM), *words, "--overwrite"], check=True, stdout=subprocess.DEVNULL)
    return read_height_map(Path(target_file)), read_height_map(Path(found))


def of_demo(folder: Path) -> list[tuple[HeightMap, HeightMap]]:
    """Return the two recordings of `sample_data`, aligned."""
    place, pitch = ROOT / "sample_data", ["--pitch-um", "0.3125"]
    return [
        aligned([str(place / "cin_target.tif")],
                [str(place / "cin_recording.txt.gz"), *pitch, "--z-scale", "1e6"], folder),
        aligned([str(place / "air_target.tif")], [str(place / "air_recording.tif"), *pitch], folder),
    ]  # fmt: skip


def of_field(folder: Path) -> list[tuple[HeightMap, HeightMap]]:
    """Return one real print, from its design levels and the text file of the AFM, aligned."""
    pitch = ["--pitch-um", "0.1"]
    design = [str(REAL / "FOV11_design_levels.tif"), *pitch, "--z-scale", "0.1"]
    return [aligned(design, [str(REAL / "FOV11_afm.txt"), *pitch, "--z-scale", "1e6"], folder)]


def asked(what: str, program: str = str(ROOT)) -> Callable[[], dict]:
    """Ask a checkout for a diagnosis, in one process; only the diagnosis itself is timed."""
    folder = Path(mkdtemp())
    pairs = {"demo": of_demo, "FOV11": of_field}[what](folder) if what not in PRINTED else recorded(PRINTED[what])
    start = str(ROOT / "configs" / "real.yaml") if what == "FOV11" else ""
    keep(folder / "case.npz", pairs, 0, start=start)

    def run() -> dict:
        found = ask(Path(program), folder / "case.npz")
        shutil.rmtree(folder)
        said = [" or ".join(finding["effects"]) for finding in found["findings"]]
        figures = {"wall_s": found["seconds"], "cpu_s": found["cpu_s"], "predictions": found["work"]}
        return figures | {"said": "; ".join([found["verdict"], *said]), "pixels": str(found["pixels"][0])}

    return run


JOBS = {
    job.__name__: job
    for job in (printed, voxels, error, floor, calibrated, voxel_simplex, corrected, diagnosed, asked)
}  # fmt: skip


def main(name: str, *words: str) -> None:
    """Prepare, then time once."""
    run = JOBS[name](*words)
    wall, cpu = time.perf_counter(), time.process_time()
    said = run()
    figures = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    figures["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(figures | said, default=float))


if __name__ == "__main__":
    main(*sys.argv[1:])
