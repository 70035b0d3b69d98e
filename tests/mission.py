"""Small concealed cases: printed on the press, recorded, and diagnosed end to end."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from dlwpredict import designs
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.run import Course, diagnose
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.objective import Work
from dlwpredict.infer.recording import prepare
from dlwpredict.parameters import ParameterSet
from tests.bench.cases import by_machine, seen
from tests.press import microscope_from, press_from

PITCH_UM = 0.5
PROCESS = {
    "focus_fwhm_xy_um": 0.55,
    "focus_fwhm_z_um": 1.6,
    "threshold": 0.46,
    "crosslink_fwhm_xy_um": 6.5,
    "crosslink_fwhm_z_um": 7.0,
    "shrinkage_min": 0.73,
    "shrinkage_max": 0.96,
}
NOISE = {"sigma_um": 0.006, "correlation_um": 0.8, "white_um": 0.002}


@cache
def target(kind: str) -> HeightMap:
    """Return a small structure with the substrate around it."""
    made = {
        "cin": lambda: designs.cin(size_um=30, pitch_um=PITCH_UM, margin_um=4),
        "air": lambda: designs.air(size_um=30, pitch_um=PITCH_UM, margin_um=4, seed=3),
        "stairs": lambda: designs.stairs(size_um=30, pitch_um=PITCH_UM, margin_um=4, feature_um=3.5),
    }
    return made[kind]()


def recorded(
    effects: Sequence[dict], structures: Sequence[str], seed: int, **form: float
) -> list[tuple[HeightMap, HeightMap]]:
    """Print and record the structures with these effects concealed in press or microscope, the process of some form."""
    printing, measuring = by_machine(effects)
    press, pairs = press_from({**PROCESS, **form, "effects": list(printing)}), []
    for k, kind in enumerate(structures):
        part = target(kind)
        look = {"pitch_um": [part.dx_um, part.dy_um], "pixels": list(part.shape[::-1])}
        pose = {"shift_um": [0.02, -0.03], "rotation_deg": 0.01}
        microscope = microscope_from({**look, "pose": pose, "noise": NOISE, "effects": list(measuring)})
        pairs.append((part, seen(part, press, microscope, seed=100 * seed + k)))
    return pairs


def answered(
    *effects: dict, structures: Sequence[str] = ("cin", "stairs"), seed: int = 0, **form: float
) -> tuple[Diagnosis, Work]:
    """Return what the program says of a case, and the work that it took."""
    work, printed = Work(), recorded(effects, structures, seed, **form)
    pairs = [prepare(part, shown, name=str(k)) for k, (part, shown) in enumerate(printed)]
    return diagnose(pairs, ParameterSet(), seed=seed, course=Course(work=work)), work
