"""Diagnosis against concealed truth: false alarms, names, classes, sides, effects outside the library, held-out gain.

Run as ``python -m tests.bench.diagnosis RUN_DIR [--nulls 20 --singles 1 --raw-nulls 20 ...]``;
`make bench-diagnose` does. Every case is printed on the virtual press, recorded, and diagnosed from the recordings
alone; what was concealed is looked at afterwards. A case that has its JSON in RUN_DIR is not run again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from dlwpredict.calibrate import prepare
from dlwpredict.diagnose.content import content_of
from dlwpredict.diagnose.run import diagnose
from dlwpredict.effects import library
from dlwpredict.parameters import ParameterSet, declarations
from tests.bench.agreement import bare
from tests.bench.cases import NEVER, OUTSIDE, SIDE_UM, SIDES, Case, alike, by_machine, in_terms_of, recorded
from tests.prove.hidden import LOCAL, Hidden
from tests.prove.linear import LIMIT_Z
from tests.prove.place import points_at
from tests.prove.sealed import strength


def limits(seed: int) -> dict[str, dict[str, float | str]]:
    """Return the detection limit of every effect on the trio, as the proof takes it, by the switch that shows most.

    Which switch that is, and where to begin, is what the program says beside a null of its own; the limit itself is
    where the change that the press makes stands out of the noise once everything has been fitted anew. For physics
    outside the library, whose strength is given: how far it stands out.
    """
    known = bare(seed)
    found = diagnose([prepare(a, b) for a, b in recorded(Case(seed=seed))], ParameterSet())
    first: dict[str, tuple[float, Hidden]] = {}
    for candidate, visible in zip(found.library.chosen, found.screen.visible, strict=True):
        default = type(candidate.effect)(**{candidate.switch: candidate.off})
        if any(getattr(candidate.effect, n) != getattr(default, n) for n in declarations(default)):
            continue
        probe = getattr(candidate.at(LIMIT_Z / max(visible, 1e-9)), candidate.switch)
        ends = candidate.declaration.low, candidate.declaration.high
        if candidate.name not in first or visible > first[candidate.name][0]:
            first[candidate.name] = visible, Hidden(candidate.name, candidate.switch, candidate.off, probe, *ends)
    named = {
        name: {"switch": hidden.switch, "off": hidden.off, "low": hidden.low, "high": hidden.high}
        | {key: one[key] for key in ("value", "z")}
        for name, (_, hidden) in first.items()
        for one in [strength(hidden, 1.0, known)]
    }
    return named | {name: {"z": known.shares({"name": name, **rest})["z"]} for name, rest in OUTSIDE.items()}


def strong(name: str, limit: Mapping, times: float) -> dict:
    """Return an effect at so many times its limit, inside its range."""
    value = limit["off"] + times * (limit["value"] - limit["off"])
    return {"name": name, limit["switch"]: float(np.clip(value, limit["low"], limit["high"]))}


def case_of(*effects: Mapping, **settings) -> Case:
    """Sort effects to the press and to the microscope."""
    return Case(*by_machine(effects), **settings)


def cases(chosen: argparse.Namespace, known: Mapping) -> Iterable[tuple[str, Case]]:
    """Yield name and case of everything that was asked for."""
    rng = np.random.default_rng(chosen.seed)
    named = [name for name in library() if name not in NEVER]
    for k in range(chosen.nulls):
        strongly = k % 2
        yield (
            f"null-{k:02d}",
            Case(sigma_um=float(rng.uniform(0.006, 0.03)), correlation_um=2.5 if strongly else 0.7, seed=1000 + k),
        )
    raw = np.random.default_rng([chosen.seed, 1])
    for k in range(chosen.raw_nulls):
        noise = {"sigma_um": float(raw.uniform(0.006, 0.03)), "correlation_um": 2.5 if k % 2 else 0.7}
        yield f"raw-null-{k:02d}", Case(**noise, seed=6000 + k, raw=True)
    for k in range(chosen.raw_singles):
        for j, name in enumerate(named):
            yield f"raw-single-{name}-{k}", case_of(strong(name, known[name], 2), seed=2000 + 100 * k + j, raw=True)
    for k in range(chosen.singles):
        for j, name in enumerate(named):
            yield f"single-{name}-{k}", case_of(strong(name, known[name], 2), seed=2000 + 100 * k + j)
    for k in range(chosen.pairs):
        two = rng.choice(named, 2, replace=False)
        yield f"pair-{k:02d}", case_of(*(strong(name, known[name], 3) for name in two), seed=3000 + k)
    for k in range(chosen.outside):
        for j, (name, settings) in enumerate(OUTSIDE.items()):
            yield f"outside-{name}-{k}", case_of({"name": name, **settings}, seed=4000 + 100 * k + j)
    for k in range(chosen.absorbed):
        for j, name in enumerate(("instrument-blur", "astigmatism", "shrinkage-nonlinearity")):
            for kinds in (("air",), ("cin", "air", "stairs", "posts")):
                yield (
                    f"absorbed-{name}-{len(kinds)}-{k}",
                    case_of(strong(name, known[name], 3), structures=kinds, seed=5000 + 100 * k + j),
                )


def run(job: tuple[str, Case, Path]) -> None:
    """Diagnose one case and write what was said beside what was concealed."""
    name, case, path = job
    started = time.perf_counter()
    parts = [prepare(a, b, name=str(k)) for k, (a, b) in enumerate(recorded(case))]
    made = time.perf_counter()
    found = diagnose(parts, ParameterSet(), seed=case.seed)
    content = content_of(found)
    content["truth"] = [dict(e) for e in (*case.effects, *case.artefacts)]
    content["explained"], content["seconds"] = found.explained, time.perf_counter() - made
    path.write_text(json.dumps(content, indent=1, default=float), encoding="utf-8")
    said = [" or ".join(f["effects"]) for f in content["findings"]]
    truth = ", ".join(e["name"] for e in content["truth"]) or "nothing"
    print(
        f"{name:36s} {truth:40s} -> {content['verdict']:11s} {'; '.join(said)}  "
        f"[explained {found.explained:.2f}, rest p {content['remainder']['p_value']:.2g}, "
        f"{made - started:.0f} + {content['seconds']:.0f} s]",
        flush=True,
    )


def table(folder: Path, known: Mapping) -> None:
    """Print the table of all cases that were run, truth opened."""
    done = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json")) if path.stem != "limits"}

    def of(kind: str) -> list[dict]:
        return [content for name, content in done.items() if name.startswith(kind)]

    def rate(label: str, hits: list[bool], wanted: str) -> None:
        if hits:
            print(f"{label:58s} {sum(hits):3d} of {len(hits):3d} = {np.mean(hits):6.1%}   wanted {wanted}")

    nulls, singles = of("null"), of("single")
    raw = of("raw-single")
    rate("raw recordings, aligned: nulls: anything said", [c["verdict"] != "none" for c in of("raw-null")], "<= 5 %")
    rate("  singles at twice the limit: found", [c["verdict"] != "none" for c in raw], "")
    rate(
        "  truth in a named class", [any(c["truth"][0]["name"] in f["effects"] for f in c["findings"]) for c in raw], ""
    )
    rate("nulls: anything said", [c["verdict"] != "none" for c in nulls], "<= 5 %")
    heard = [c for c in singles if c["verdict"] != "none"]
    rate("singles at twice the limit: found", [c["verdict"] != "none" for c in singles], ">= 95 %")
    first = [(c["truth"][0]["name"], c["findings"][0]["effects"], c) for c in heard if c["findings"]]
    rate("  truth in the named class", [truth in names for truth, names, _ in first], ">= 95 %")
    rate("  first name in the truth's class of look-alikes", [alike(t, n[0]) for t, n, _ in first], "")
    rate("  exact name where one is named", [[t] == n for t, n, _ in first if len(n) == 1], ">= 85 %")
    wrong = [c["findings"][0]["side"] not in (SIDES[t], "undecided") for t, _, c in first]
    rate("  wrong side", wrong, "<= 2 %")
    both = [all(any(e["name"] in f["effects"] for f in c["findings"]) for e in c["truth"]) for c in of("pair")]
    rate("pairs: both in the named classes", both, ">= 75 %")
    outside = of("outside")
    shown = [c["verdict"] == "unexplained" for c in outside if known[c["truth"][0]["name"]]["z"] >= 2 * LIMIT_Z]
    rate("outside the library: unexplained", [c["verdict"] == "unexplained" for c in outside], "")
    rate("  of those that stand as far out as twice a limit", shown, ">= 90 %")
    spots = [(c["truth"][0], c["locations"]) for c in outside if c["truth"][0]["name"] in LOCAL]
    rate("  local ones: place right", [points_at(spot, boxes, SIDE_UM) for spot, boxes in spots], ">= 90 %")
    rate("  confidently misnamed", [c["verdict"] == "identified" for c in outside], "<= 5 %")
    one = [c for name, c in done.items() if name.startswith("absorbed") and "-1-" in name]
    four = [c for name, c in done.items() if name.startswith("absorbed") and "-4-" in name]
    misnamed = [c["verdict"] == "identified" and c["findings"][0]["effects"] != [c["truth"][0]["name"]] for c in one]
    rate("absorbed, one roughness map: wrong confident name", misnamed, "0")
    rate(
        "absorbed, four structures: named",
        [any(c["truth"][0]["name"] in f["effects"] for f in c["findings"]) for c in four],
        "all",
    )
    covered = list(_covered(singles))
    rate("95 % intervals of strengths, exact names: cover the truth", covered, "90 to 98 %")
    gaps = [
        (c["baseline"]["holdout_rmse_um"] ** 2 - c["extended"]["holdout_rmse_um"] ** 2)
        / max(c["baseline"]["holdout_rmse_um"] ** 2 - c["noise_um"] ** 2, 1e-12)
        for t, n, c in first
    ]
    if gaps:
        print(f"held-out gap baseline - noise closed (median of squares): {np.median(gaps):.2f}   wanted 0.80")
    if done:
        print(f"seconds per diagnosis, median: {np.median([c['seconds'] for c in done.values()]):.0f}")


def _covered(singles: list[dict]) -> Iterable[bool]:
    for c in singles:
        truth = c["truth"][0]
        for finding in c["findings"]:
            found = in_terms_of(truth, finding["parameters"].get(truth["name"], {}))
            for name, interval in found.items():
                if name in truth:
                    yield interval["low"] <= truth[name] <= interval["high"]


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    counts = {"nulls": 20, "singles": 1, "pairs": 8, "outside": 1, "absorbed": 1, "raw-nulls": 20, "raw-singles": 1}
    for name, count in counts.items():
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    kept = chosen.folder / "limits.json"
    if not kept.exists():
        kept.write_text(json.dumps(limits(chosen.seed), indent=1))
    known = json.loads(kept.read_text())
    jobs = [(name, case, chosen.folder / f"{name}.json") for name, case in cases(chosen, known)]
    np.random.default_rng(0).shuffle(jobs)  # an interrupted run has some of each kind
    with ProcessPoolExecutor(chosen.processes, mp_context=get_context("spawn")) as pool:
        list(pool.map(run, [job for job in jobs if not job[2].exists()]))
    table(chosen.folder, known)


if __name__ == "__main__":
    main()
