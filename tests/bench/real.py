"""The tables of `make real`: alignment of every real print, and prediction of those that no fit has seen.

Run as ``python -m tests.bench.real RUN_DIR FIELD ...`` after the Make rules have filled RUN_DIR; the named fields
are those that the process was calibrated on. The recordings have no zero, so offset and tilt of every field are free
for every prediction alike: best plane removed, points not measured and a rim left out.

With ``--diagnose`` the named fields, every other one if none is named, are diagnosed together, all others held out;
``--program PATH`` asks another checkout.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from scipy import ndimage
from scipy.optimize import minimize_scalar

from dlwpredict.files import read_height_map
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.regrid import resampled
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict
from tests.bench.diagnosis import ROOT, ask, keep

BLUR_PX = 3.0

RIM_UM = 1.2
"""Beyond the map the program takes empty resin; what was really printed there is not known."""

Predictor = Callable[[HeightMap], np.ndarray]


def blurred_cc(target: HeightMap, aligned: HeightMap) -> float:
    """Return the correlation of target and aligned recording, both blurred; points not measured are left out."""
    known = aligned.measured

    def smooth(heights: np.ndarray) -> np.ndarray:
        weight = ndimage.gaussian_filter(known.astype(float), BLUR_PX)
        return ndimage.gaussian_filter(np.where(known, heights, 0.0), BLUR_PX)[known] / weight[known]

    return float(np.corrcoef(smooth(target.heights_um), smooth(aligned.heights_um))[0, 1])


def scored(aligned: HeightMap) -> np.ndarray:
    """Return the points that count, shape (rows, cols)."""
    inside = np.zeros(aligned.shape, dtype=bool)
    rim = round(RIM_UM / aligned.dx_um)
    inside[rim:-rim, rim:-rim] = True
    return inside & aligned.measured


def without_plane(heights_um: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the heights at the used points less their least-squares plane, shape (points,)."""
    rows, cols = (np.linspace(-1, 1, n) for n in used.shape)
    x, y = np.meshgrid(cols, rows)
    plane = np.stack([np.ones(used.sum()), x[used], y[used]], axis=1)
    values = heights_um[used]
    return values - plane @ np.linalg.lstsq(plane, values, rcond=None)[0]


def blurred(target: HeightMap, sigma_px: float) -> np.ndarray:
    """Return the target under a Gaussian; beyond the map it goes on as at its border, as the recordings do."""
    return ndimage.gaussian_filter(target.heights_um, sigma_px, mode="nearest")


def gain_of(pairs: list[tuple[HeightMap, HeightMap]], sigma_px: float) -> tuple[float, float]:
    """Return the one gain that suits all blurred targets best, planes free, and the squares it leaves, µm²."""
    both = [np.stack([without_plane(h, scored(a)) for h in (blurred(t, sigma_px), a.heights_um)]) for t, a in pairs]
    shapes, heights = np.concatenate(both, axis=1)
    gain = float(shapes @ heights / (shapes @ shapes))
    return gain, float(np.sum((heights - gain * shapes) ** 2))


def baselines(pairs: list[tuple[HeightMap, HeightMap]]) -> dict[str, Predictor]:
    """Return the trivial predictions, their numbers fitted jointly on these pairs."""
    plain = gain_of(pairs, 0.0)[0]
    sigma = float(minimize_scalar(lambda s: gain_of(pairs, s)[1], bounds=(0.1, 20.0), method="bounded").x)
    gain = gain_of(pairs, sigma)[0]
    pitch = pairs[0][0].dx_um
    return {
        "target as it is": lambda target: target.heights_um,
        f"gain {plain:.3f}": lambda target: plain * target.heights_um,
        f"blur σ {sigma * pitch:.2f} µm, gain {gain:.3f}": lambda target: gain * blurred(target, sigma),
    }


def judged(predicted_um: np.ndarray, aligned: HeightMap) -> tuple[float, float]:
    """Return rmse (µm) and CC of a prediction against a recording, the recording's plane free."""
    used = scored(aligned)
    left = without_plane(aligned.heights_um - predicted_um, used)
    predicted = predicted_um[used]
    return float(np.sqrt(np.mean(left**2))), float(np.corrcoef(predicted, predicted + left)[0, 1])


def read_pair(folder: Path) -> tuple[HeightMap, HeightMap]:
    """Return target and aligned recording."""
    return read_height_map(folder / "target.tif"), read_height_map(folder / "aligned.tif")


def show_alignment(folders: list[Path]) -> None:
    """Print how every field was aligned."""
    print(
        f"\n{'field':8s} {'CC blurred':>10s} {'CC':>6s} {'rot °':>7s} {'±':>6s} {'scale x':>8s} {'scale y':>8s} mapping"
    )
    reached = []
    for folder in folders:
        pose = yaml.safe_load((folder / "align.yaml").read_text())
        reached.append(blurred_cc(*read_pair(folder)))
        print(
            f"{folder.name:8s} {reached[-1]:10.3f} {pose['cc']:6.3f} {pose['rotation_deg']:7.3f} "
            f"{pose['uncertainty']['rotation_deg']:6.3f} {pose['scale'][0]:8.4f} {pose['scale'][1]:8.4f} "
            f"{pose['distortion']}"
        )
    print(f"{len(reached)} fields; lowest blurred correlation {min(reached):.3f} (wanted: at least 0.93)")


def show_process(run: Path, known: list[str]) -> None:
    """Print what was calibrated."""
    fit = yaml.safe_load((run / "calibration.yaml").read_text())
    print(f"\ncalibrated on {', '.join(known)}: rmse {1e3 * fit['rmse_um']['after']:.1f} nm")
    for name, found in fit["parameters"].items():
        print(f"  {name:<22} {found['value']:8.3f}   95 % {found['low']:.3f} to {found['high']:.3f} {found['unit']}")
    for text in fit["warnings"]:
        print(f"  {text}")


def show_prediction(run: Path, known: list[str], others: list[Path]) -> None:
    """Print rmse and CC of every prediction on every field that no fit has seen."""
    trivial = baselines([read_pair(run / name) for name in known])
    names = [*trivial, "model, paper's defaults", "model, calibrated"]
    table = []
    for folder in others:
        target, aligned = read_pair(folder)
        maps = [predict(target) for predict in trivial.values()]
        maps += [read_height_map(folder / name).heights_um for name in ("default.tif", "predicted.tif")]
        table.append([judged(heights, aligned) for heights in maps])
    figures = np.array(table)
    print(
        f"\nfields not seen by any fit: rmse in nm / CC, offset and tilt of each field free, {RIM_UM:g} µm rim left out"
    )
    for number, name in enumerate(names, 1):
        print(f"  ({number}) {name}")
    print(f"{'field':8s}" + "".join(f"{f'({number})':>14s}" for number in range(1, len(names) + 1)))
    for folder, line in zip(others, figures, strict=True):
        print(f"{folder.name:8s}" + "".join(f"{1e3 * rmse:8.1f} {cc:.3f}" for rmse, cc in line))
    rms, mean = np.sqrt(np.mean(figures[..., 0] ** 2, axis=0)), figures[..., 1].mean(axis=0)
    print(f"{'all':8s}" + "".join(f"{1e3 * rmse:8.1f} {cc:.3f}" for rmse, cc in zip(rms, mean, strict=True)))


def main(run: Path, known: list[str]) -> None:
    """Print the tables."""
    folders = sorted(path.parent for path in run.glob("*/aligned.tif"))
    show_alignment(folders)
    show_process(run, known)
    show_prediction(run, known, [folder for folder in folders if folder.name not in known])


def show_diagnosis(run: Path, known: list[str], program: Path) -> None:
    """Diagnose some fields together, print what is said, what it took, and the errors on the fields held out."""
    fields = {path.parent.name: read_pair(path.parent) for path in sorted(run.glob("*/aligned.tif"))}
    known = known or list(fields)[::2]
    with TemporaryDirectory() as folder:
        place = Path(folder, "case.npz")
        unseen = [pair for name, pair in fields.items() if name not in known]
        keep(place, [fields[name] for name in known], 0, holdout=unseen, start=str(ROOT / "configs" / "real.yaml"))
        found = ask(program, place)
    print(f"\ndiagnosed by {program}: {len(known)} fields together, {len(unseen)} held out")
    print(f"  pixels {found['pixels'][0]}, {found['work']:.0f} predictions of all, {found['cpu_s']:.0f} s of CPU")
    print(f"  {found['verdict']}: {'; '.join(' or '.join(f['effects']) for f in found['findings'])}")
    print(f"  explained {found['explained']:.2f}, remainder p {found['remainder']['p_value']:.2g}")
    for model in ("baseline", "extended"):
        seen, kept = (found[model][name] for name in ("rmse_um", "holdout_rmse_um"))
        print(f"  {model:9s} rmse {1e3 * seen:6.1f} nm   {found['holdout_by']} {1e3 * kept:6.1f} nm")
    print(f"  noise {1e3 * found['noise_um']:.1f} nm")


@dataclass(frozen=True)
class Answered:
    """What `make real-diagnosis` has left, on the pixels that it worked on.

    Parameters
    ----------
    fitted, unseen : dict of str to tuple of HeightMap
        Target and aligned recording by field.
    seven, extended : function of HeightMap
        Predict with the baseline, and with what was named.
    """

    fitted: dict[str, tuple[HeightMap, HeightMap]]
    unseen: dict[str, tuple[HeightMap, HeightMap]]
    seven: Predictor
    extended: Predictor

    @classmethod
    def of(cls, run: Path) -> Answered:
        """Read it."""
        told = read_yaml(run / "diagnosis.yaml")
        pitch, known = told["working_pitch_um"], {Path(name).parent.name for name in told["recordings"]}
        fields = [path.parent for path in sorted(run.glob("*/aligned.tif"))]
        maps = {field.name: tuple(resampled(one, pitch) for one in read_pair(field)) for field in fields}
        extended = read_parameters(run / "extended.yaml")
        extended = extended.decided("measurement") if extended.undecided else extended
        paper = Paper(**{k: v["value"] for k, v in told["baseline"]["parameters"].items()})
        seven = replace(extended, paper=paper, effects=(), undecided=None, intervals={}, bounds={})
        parts = ({name: pair for name, pair in maps.items() if (name in known) == of} for of in (True, False))
        return cls(*parts, _as_recorded(seven), _as_recorded(extended))


def held_out_um(run: Path) -> dict[str, float]:
    """Return the errors on the fields that `make real-diagnosis` has held out, all predictions on the same footing, µm.

    On the pixels that the diagnosis worked on; offset and tilt of every field are free. The diagnosis's own figure lets
    registration give way as well, within what an alignment leaves.
    """
    found = Answered.of(run)
    ways = baselines(list(found.fitted.values()))
    ways |= {"seven parameters": found.seven, "with what was named": found.extended}
    errors = {
        name: [judged(way(target), aligned)[0] for target, aligned in found.unseen.values()]
        for name, way in ways.items()
    }
    return {name: float(np.sqrt(np.mean(np.square(own)))) for name, own in errors.items()}


def show_held_out(run: Path) -> None:
    """Print these errors."""
    print(f"\nfields held out, offset and tilt free, {RIM_UM:g} µm rim left out")
    for name, error in held_out_um(run).items():
        print(f"  {name:40s} {1e3 * error:6.1f} nm")


def _as_recorded(process: ParameterSet) -> Predictor:
    return lambda target: predict(target, process, as_measured=True).heights_um


def asked() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("fields", nargs="*")
    parser.add_argument("--diagnose", action="store_true", help="diagnose the fields together, the others held out")
    parser.add_argument("--held-out", action="store_true", help="errors on what `make real-diagnosis` held out")
    parser.add_argument("--program", type=Path, default=ROOT, help="another checkout, for the diagnosis")
    return parser.parse_args()


if __name__ == "__main__":
    chosen = asked()
    if chosen.held_out:
        show_held_out(chosen.folder)
    elif chosen.diagnose:
        show_diagnosis(chosen.folder, chosen.fields, chosen.program.resolve())
    else:
        main(chosen.folder, chosen.fields)
