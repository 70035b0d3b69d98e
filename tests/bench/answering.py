"""A diagnosis asked of whichever program is first on the path, in a process of its own.

``python -P tests/bench/answering.py CASE.npz ANSWER.json``: nothing of `tests` is loaded, so that another checkout, an
older program too, can answer the cases of this one.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import dlwpredict
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet


def pairs_in(path: Path) -> tuple[list[tuple[HeightMap, HeightMap]], int]:
    """Return targets and recordings, and the seed of the case."""
    with np.load(path) as kept:
        pairs = []
        for k in range(int(kept["pairs"])):
            dx, dy = kept[f"pitch_{k}"]
            target = HeightMap(kept[f"target_{k}"], float(dx), float(dy))
            pairs.append((target, HeightMap(kept[f"recording_{k}"], float(dx), float(dy), str(kept[f"reference_{k}"]))))
        return pairs, int(kept["seed"])


def answer(pairs: list[tuple[HeightMap, HeightMap]], seed: int) -> dict[str, Any]:
    """Return what the program has to say, the predictions and the seconds that it took."""
    if not Path(dlwpredict.__file__).with_name("infer").is_dir():  # an editable install finds its modules anyway
        return _by_old(pairs, seed)
    from dlwpredict.diagnose.answer.content import content_of
    from dlwpredict.diagnose.run import diagnose
    from dlwpredict.infer.objective import Work
    from dlwpredict.infer.recording import prepare

    work, parts = Work(), [prepare(a, b, name=str(k)) for k, (a, b) in enumerate(pairs)]
    wall, cpu = time.perf_counter(), time.process_time()
    found = diagnose(parts, ParameterSet(), seed=seed, work=work)
    spent = {"cpu_s": time.process_time() - cpu, "seconds": time.perf_counter() - wall, "work": work.predictions}
    said = content_of(found) | {"explained": found.explained}
    return said | spent | {"all_cpu_s": time.process_time() - cpu, "all_work": work.predictions}


def _by_old(pairs: list[tuple[HeightMap, HeightMap]], seed: int) -> dict[str, Any]:
    """Ask a program from before `dlwpredict.infer`; its predictions are counted as they are made."""
    prepare = import_module("dlwpredict.calibrate").prepare
    content_of = import_module("dlwpredict.diagnose.content").content_of
    diagnose = import_module("dlwpredict.diagnose.run").diagnose
    kind = import_module("dlwpredict.calibrate.trace").Trace
    made, points = [], sum(target.heights_um.size for target, _ in pairs)
    begin = kind.__init__

    def counted(self: Any, chain: tuple, states: tuple, room: tuple[int, int], work: float) -> None:
        begin(self, chain, states, room, work)
        made.append(work * np.prod([n - 2 * r for n, r in zip(states[0].shape, room, strict=True)]))

    kind.__init__ = counted
    parts = [prepare(a, b, name=str(k)) for k, (a, b) in enumerate(pairs)]
    wall, cpu = time.perf_counter(), time.process_time()
    found = diagnose(parts, ParameterSet(), seed=seed)
    spent = {"cpu_s": time.process_time() - cpu, "seconds": time.perf_counter() - wall, "work": sum(made) / points}
    return content_of(found) | {"explained": found.explained} | spent


def main(case: Path, place: Path) -> None:
    """Answer one case."""
    program = str(Path(dlwpredict.__file__).parents[1])
    place.write_text(json.dumps(answer(*pairs_in(case)) | {"program": program}, default=float), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
