"""A diagnosis asked of whichever program is first on the path, in a process of its own.

``python -P tests/bench/answering.py CASE.npz ANSWER.json``: nothing of `tests` is loaded, so that another checkout, an
older program too, can answer the cases of this one.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import dlwpredict
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet

Pair = tuple[HeightMap, HeightMap]


@dataclass(frozen=True)
class Asked:
    """What a program is given.

    Parameters
    ----------
    pairs, holdout : list of (HeightMap, HeightMap)
        Targets and recordings, those to be fitted and those to be kept from every fit.
    start : ParameterSet
    seed : int
    """

    pairs: list[Pair]
    holdout: list[Pair]
    start: ParameterSet
    seed: int

    @classmethod
    def of(cls, path: Path) -> Asked:
        """Read a case."""
        with np.load(path) as kept:
            pairs = []
            for k in range(int(kept["pairs"])):
                dx, dy = map(float, kept[f"pitch_{k}"])
                measured = HeightMap(kept[f"recording_{k}"], dx, dy, str(kept[f"reference_{k}"]))
                pairs.append((HeightMap(kept[f"target_{k}"], dx, dy), measured))
            fitted = int(kept["fitted"]) if "fitted" in kept else len(pairs)
            start = str(kept["start"]) if "start" in kept else ""
            seed = int(kept["seed"])
        return cls(pairs[:fitted], pairs[fitted:], read_parameters(Path(start) if start else None), seed)


def answer(asked: Asked) -> dict[str, Any]:
    """Return what the program has to say, the predictions and the seconds that it took, on pixels of its own choice."""
    if not Path(dlwpredict.__file__).with_name("infer").is_dir():  # an editable install finds its modules anyway
        return _by_old(asked)
    from dlwpredict.diagnosis.answer.content import content_of
    from dlwpredict.diagnosis.run import Course, diagnose
    from dlwpredict.infer.objective import Work
    from dlwpredict.infer.pixels import working_factor
    from dlwpredict.infer.recording import coarser, prepare

    several = [asked.pairs, asked.holdout]
    parts, kept = ([coarser(prepare(a, b), working_factor(a, asked.start)) for a, b in pairs] for pairs in several)
    work, wall, cpu = Work(), time.perf_counter(), time.process_time()
    found = diagnose(parts, asked.start, holdout=kept, seed=asked.seed, course=Course(work=work))
    spent = {"cpu_s": time.process_time() - cpu, "seconds": time.perf_counter() - wall, "work": work.predictions}
    spent["pixels"] = [list(part.target.shape) for part in parts]
    said = content_of(found) | {"explained": found.explained}
    return said | spent | {"all_cpu_s": time.process_time() - cpu, "all_work": work.predictions}


def _by_old(asked: Asked) -> dict[str, Any]:
    """Ask a program from before `dlwpredict.infer`; its predictions are counted as they are made."""
    prepare = import_module("dlwpredict.calibration").prepare
    content_of = import_module("dlwpredict.diagnosis.content").content_of
    diagnose = import_module("dlwpredict.diagnosis.run").diagnose
    coarser = import_module("dlwpredict.calibration.recordings").coarser
    most = import_module("dlwpredict.cli.diagnose").LARGEST_PX
    kind = import_module("dlwpredict.calibration.trace").Trace
    several = [asked.pairs, asked.holdout]
    parts, unseen = ([coarser(prepare(a, b), -(-max(a.shape) // most)) for a, b in pairs] for pairs in several)
    made, points, begin = [], sum(part.target.heights_um.size for part in parts), kind.__init__

    def counted(self: Any, chain: tuple, states: tuple, room: tuple[int, int], work: float) -> None:
        begin(self, chain, states, room, work)
        made.append(work * np.prod([n - 2 * r for n, r in zip(states[0].shape, room, strict=True)]))

    kind.__init__ = counted
    wall, cpu = time.perf_counter(), time.process_time()
    found = diagnose(parts, asked.start, holdout=unseen, seed=asked.seed)
    spent = {"cpu_s": time.process_time() - cpu, "seconds": time.perf_counter() - wall, "work": sum(made) / points}
    spent["pixels"] = [list(part.target.shape) for part in parts]
    return content_of(found) | {"explained": found.explained} | spent


def main(case: Path, place: Path) -> None:
    """Answer one case."""
    program = str(Path(dlwpredict.__file__).parents[1])
    place.write_text(json.dumps(answer(Asked.of(case)) | {"program": program}, default=float), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
