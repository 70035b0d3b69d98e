"""What a diagnosis leaves besides its YAML: maps on the pixels of the files, and the page."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.files import write_height_map
from dlwpredict.noise.spectrum import spectra

if TYPE_CHECKING:
    from dlwpredict.cli.pairs import Pair


def maps_of(diagnosis: Diagnosis, k: int) -> dict[str, np.ndarray]:
    """Return the maps of a pair, µm and shares, NaN where nothing counts, shape (rows, cols)."""
    used = diagnosis.recordings[k].used
    residual, remainder = diagnosis.baseline.fit.residual_um(k), diagnosis.extended.fit.residual_um(k)
    return {
        "residual": residual,
        "mismatch": np.where(used, diagnosis.mismatch[k], np.nan),
        "explained": residual - remainder,
        "remainder": remainder,
    }


def write_maps(folder: Path, diagnosis: Diagnosis, pairs: Sequence[Pair]) -> None:
    """Write the maps of all pairs on the pixels of their files, all of them or none."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}") as temporary:
        for k, pair in enumerate(pairs):
            for name, values in maps_of(diagnosis, k).items():
                write_height_map(Path(temporary) / f"{name}_{k}.tif", pair.fine(values))
        folder.mkdir(exist_ok=True)
        for file in sorted(Path(temporary).iterdir()):
            shutil.move(file, folder / file.name)


def write_report(path: Path, diagnosis: Diagnosis, content: dict[str, Any], pairs: Sequence[Pair]) -> None:
    """Write the diagnosis as one HTML page."""
    from dlwpredict.pages.diagnosis import PairMaps, write_page

    pictures = []
    for k, pair in enumerate(pairs):
        item, shown = diagnosis.recordings[k], maps_of(diagnosis, k)
        measured = item.measured.with_heights(np.where(item.used, item.measured.heights_um, np.nan))
        left, whitened = np.nan_to_num(shown["remainder"]), diagnosis.extended.fit.data[k]
        pictures.append(
            PairMaps(
                str(pair.files[1]),
                item.target,
                measured,
                diagnosis.baseline.fit.predicted_um(k),
                diagnosis.extended.fit.predicted_um(k),
                shown["residual"],
                shown["explained"],
                shown["remainder"],
                diagnosis.mismatch[k],
                spectra(left, whitened.recording.used, whitened.noise, whitened.slope),
            )
        )
    write_page(path, content, pictures, command=content["provenance"]["command"], evidence=_evidence(diagnosis))


def _evidence(diagnosis: Diagnosis) -> list:
    """Return the best score of every switch of every effect, the strongest first."""
    from dlwpredict.pages.diagnosis import Evidence

    screen, best = diagnosis.screen, {}
    scores, amplitudes, visible = screen.z, screen.amplitude, screen.visible
    for k in np.argsort(-np.abs(scores), kind="stable"):
        candidate = screen.chosen[k]
        name = f"{candidate.name}.{candidate.switch}"
        if name not in best:
            strength = getattr(candidate.at(amplitudes[k]), candidate.switch)
            unit = "" if candidate.declaration.unit == "1" else f" {candidate.declaration.unit}"
            threshold, seen = float(np.sqrt(diagnosis.thresholds.first)), float(visible[k])
            best[name] = Evidence(name, float(scores[k]), threshold, f"{strength:.3g}{unit}", seen)
    return list(best.values())
