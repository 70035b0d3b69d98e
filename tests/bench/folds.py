"""Sixteen real prints halved at random, again and again: what the diagnosis of one half predicts of the other.

Run as ``python -m tests.bench.folds REAL_DIR [--folds 7] [--minutes M]`` once `make real` has aligned the fields. Every
prediction stands on the same footing: offset and tilt of every field are free, then those of every scan line besides.
What a division came to is kept in the report, and another run of the same version goes on after it.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from dlwpredict import __version__
from dlwpredict.files.atomic import write_text
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.heightmap import HeightMap
from tests.bench.evidence import row
from tests.bench.real import Answered, Predictor, baselines, blurred, scored, without_plane
from tests.prove.answer import command_of, ran

SEED, LONGEST_S = 160, 7200.0
"""Of the divisions; CPU seconds that one may take."""

START = Path("configs/real.yaml")
WAYS = ("the target as it is", "the target scaled", "blurred and scaled", "blurred, scaled and bent")
SEVEN, NAMED = "seven parameters", "with what was named"
WANTED = {(NAMED, "plane"): "<= 24", (NAMED, "lines"): "<= 22"}
FREE = {"plane": "offset and tilt free", "lines": "those of every scan line besides"}


def halved(fields: Sequence[str], fold: int) -> tuple[list[str], list[str]]:
    """Return the fields of a division that are fitted, and those that are not."""
    order = [str(name) for name in np.random.default_rng([SEED, fold]).permutation(sorted(fields))]
    half = len(order) // 2
    return sorted(order[:half]), sorted(order[half:])


def diagnosed(real: Path, fold: int) -> tuple[Path, float]:
    """Have one half diagnosed, the other held out; return the folder of the answer and the CPU seconds.

    Raises
    ------
    RuntimeError
        There is no answer.
    """
    folder = real.resolve() / "folds" / str(fold)
    fields = [path.parent for path in sorted(real.resolve().glob("*/aligned.tif"))]
    for field in fields:
        (folder / field.name).mkdir(parents=True, exist_ok=True)
        for name in ("target.tif", "aligned.tif"):
            if not (link := folder / field.name / name).exists():
                link.symlink_to(field / name)
    words = ["diagnose", "-p", str(START.resolve()), "-o", "diagnosis.yaml", "--params-out", "extended.yaml"]
    words += ["--no-advice", "--overwrite", "--jobs", "1", "--quiet"]
    for option, names in zip(("--pair", "--holdout"), halved([one.name for one in fields], fold), strict=True):
        words += [word for name in names for word in (option, f"{name}/target.tif", f"{name}/aligned.tif")]
    status, complaint, cpu_s = ran(command_of(words), folder, LONGEST_S)
    if status:
        raise RuntimeError(f"{folder}: {complaint}")
    return folder, cpu_s


def bent(pairs: Sequence[tuple[HeightMap, HeightMap]]) -> Predictor:
    """Return the prediction a·b + c·b², b the blurred target, its three numbers fitted jointly on these pairs."""

    def fitted(sigma_px: float) -> tuple[np.ndarray, float]:
        rows = []
        for target, aligned in pairs:
            shape, used = blurred(target, sigma_px), scored(aligned)
            rows.append([without_plane(heights, used) for heights in (shape, shape**2, aligned.heights_um)])
        *shapes, heights = np.concatenate(rows, axis=1)
        factors, left, *_ = np.linalg.lstsq(np.stack(shapes, axis=1), heights, rcond=None)
        return factors, float(left[0])

    sigma = float(minimize_scalar(lambda s: fitted(s)[1], bounds=(0.1, 20.0), method="bounded").x)
    a, c = fitted(sigma)[0]

    def predicted(target: HeightMap) -> np.ndarray:
        shape = blurred(target, sigma)
        return a * shape + c * shape**2

    return predicted


def left_um(predicted_um: np.ndarray, aligned: HeightMap) -> dict[str, float]:
    """Return the rms errors of a prediction, µm, by what is free of the recording."""
    used, error = scored(aligned), aligned.heights_um - predicted_um
    lines = [without_plane(row[None], on[None]) for row, on in zip(error, used, strict=True) if on.any()]
    left = {"plane": without_plane(error, used), "lines": np.concatenate(lines)}
    return {name: float(np.sqrt(np.mean(values**2))) for name, values in left.items()}


def errors_um(folder: Path) -> dict[str, dict[str, float]]:
    """Return the errors on the half held out of every way to predict it, µm, all its fields together."""
    found = Answered.of(folder)
    seen = list(found.fitted.values())
    ways = dict(zip(WAYS, [*baselines(seen).values(), bent(seen)], strict=True))
    ways |= {SEVEN: found.seven, NAMED: found.extended}
    errors = {}
    for name, way in ways.items():
        own = [left_um(way(target), aligned) for target, aligned in found.unseen.values()]
        errors[name] = {free: float(np.sqrt(np.mean([one[free] ** 2 for one in own]))) for free in FREE}
    return errors


def folded(real: Path, fold: int) -> dict[str, Any]:
    """Return what one division came to."""
    folder, cpu_s = diagnosed(real, fold)
    told = read_yaml(folder / "diagnosis.yaml")
    return {
        "fold": fold,
        "version": __version__,
        "fitted": [Path(name).parent.name for name in told["recordings"]],
        "cpu_s": round(cpu_s),
        "predictions": told["work"]["predictions"],
        "verdict": told["verdict"],
        "named": [[finding["effects"], finding["probability"]] for finding in told["findings"]],
        "explained": told["remainder"]["explained_share"],
        "errors_um": errors_um(folder),
    }


def table_of(folds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return everything that is written."""
    rows = []
    for free, words in FREE.items():
        for way in folds[0]["errors_um"]:
            errors = [1e3 * one["errors_um"][way][free] for one in folds]
            what = f"{words}: {way}, median ({min(errors):.1f} to {max(errors):.1f})"
            rows.append(row(what, float(np.median(errors)), "nm", WANTED.get((way, free), "")))
        gained = [one["errors_um"][NAMED][free] < one["errors_um"][SEVEN][free] for one in folds]
        rows.append(row(f"{words}: names predict better than the seven alone, share", float(np.mean(gained))))
    shares = [one["explained"] or 0.0 for one in folds]
    what = f"share of the mismatch that has a name, median ({min(shares):.2f} to {max(shares):.2f})"
    rows.append(row(what, float(np.median(shares)), wanted=">= 60 %"))
    for name in sorted({name for one in folds for names, _ in one["named"] for name in names}):
        held = sum(any(name in names for names, _ in one["named"]) for one in folds)
        first = sum(any(names[0] == name for names, _ in one["named"]) for one in folds)
        if 2 * held >= len(folds):
            rows.append(row(f"{name} in a named class, divisions ({first} times the likeliest of it)", held))
    rows.append(row("processor time, median", float(np.median([one["cpu_s"] for one in folds])), "s"))
    text = (
        f"The sixteen prints halved at random {len(folds)} times: one half fitted and diagnosed, the other predicted. "
        "In brackets the least and the greatest of all divisions. Blur, scale and bend are fitted to the same half."
    )
    machine = f"{platform.system()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return {
        "title": "Real prints, halved again and again", "version": __version__,
        "command": "python -m tests.bench.folds runs/real", "machine": machine, "date": f"{date.today()}",
        "text": text, "rows": rows, "folds": list(folds),
    }  # fmt: skip


def main(words: Sequence[str] | None = None) -> int:
    """Go on with the divisions that the report lacks; write it after each."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.folds", description=__doc__.splitlines()[0])
    parser.add_argument("real", type=Path, metavar="REAL_DIR")
    parser.add_argument("--folds", type=int, default=7)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=np.inf, help="begin nothing more after so long")
    parser.add_argument("--report", type=Path, default=Path("docs/evidence/folds.json"))
    chosen = parser.parse_args(words)
    last = time.monotonic() + 60 * chosen.minutes
    kept = json.loads(chosen.report.read_text())["folds"] if chosen.report.exists() else []
    done = {one["fold"]: one for one in kept if one["version"] == __version__}

    def go_on(fold: int) -> None:
        if fold in done or time.monotonic() > last:
            return
        done[fold] = folded(chosen.real, fold)
        table = table_of([done[k] for k in sorted(done)])
        write_text(chosen.report, json.dumps(table, indent=1) + "\n")
        print(f"{fold}: {done[fold]['cpu_s']} s, {done[fold]['verdict']}, {done[fold]['named']}", flush=True)

    with ThreadPoolExecutor(chosen.processes) as askers:
        list(askers.map(go_on, range(chosen.folds)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
