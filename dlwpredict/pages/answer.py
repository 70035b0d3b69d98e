"""The page of an answer: what `pages.diagnosis` shows, taken from a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dlwpredict.api.diagnose import Answer
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.noise.spectrum import spectra
from dlwpredict.pages.diagnosis import Evidence, PairMaps, write_page


def write_answer(path: Path, answer: Answer, content: Mapping[str, Any]) -> None:
    """Write a diagnosis as one HTML page.

    Parameters
    ----------
    path : Path
    answer : Answer
    content : dict
        Of diagnosis.yaml, provenance included.
    """
    diagnosis, pictures = answer.diagnosis, []
    for k, item in enumerate(diagnosis.recordings):
        shown, whitened = answer.working_maps(k), diagnosis.extended.fit.data[k]
        measured = item.measured.with_heights(np.where(item.used, item.measured.heights_um, np.nan))
        left = np.nan_to_num(shown["remainder"])
        pictures.append(
            PairMaps(
                answer.pairs[k].names[1],
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
    write_page(path, dict(content), pictures, command=content["provenance"]["command"], evidence=_evidence(diagnosis))


def _evidence(diagnosis: Diagnosis) -> list[Evidence]:
    """Return the best score of every switch of every effect, the strongest first."""
    screen = diagnosis.screen
    best: dict[str, Evidence] = {}
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
