"""Cases made, their truth sealed: height maps under opaque names, and the SHA-256 of what is concealed in them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import sha256
from dlwpredict.heightmap import HeightMap
from tests.bench.cases import by_machine, seen
from tests.press import Microscope, Press, microscope_from, press_from, read_map, write_map
from tests.prove import structures
from tests.prove.hidden import Hidden
from tests.prove.linear import LIMIT_Z, Sight
from tests.prove.mix import FULL, WEAKEST, Draw, draw, name_of

FINER = 2
"""The press prints the targets' pixels as squares of this many pixels a side: 0.5 nm from the limit of many."""

ROUNDS, CLOSE = 6, 0.1
"""Times that a strength is corrected at most, since few effects grow in proportion to it, and when it is right."""

POWERS = (0.5, 4.0)
"""Powers of its strength with which an effect is taken to grow."""


@dataclass(frozen=True)
class Folder:
    """Where a run keeps its data, its truth and its answers."""

    root: Path

    def data(self, name: str) -> Path:
        """Return the folder that the program is given."""
        return self.root / "data" / name

    def truth(self, name: str) -> Path:
        """Return the sealed truth of a case."""
        return self.root / "sealed" / f"{name}.json"

    def kept(self, name: str, what: str) -> Path:
        """Return a map that is kept from the program: `target` or `clean`, of the structure held out."""
        return self.root / "sealed" / f"{name}_{what}.tif"

    def answer(self, name: str) -> Path:
        """Return what the program has said."""
        return self.root / "answers" / f"{name}.json"

    def result(self, name: str) -> Path:
        """Return what was said beside what was concealed."""
        return self.root / "results" / f"{name}.json"


def read(path: Path) -> HeightMap:
    """Read one of the proof's maps."""
    heights, dx, dy = read_map(path)
    return HeightMap(heights, dx, dy)


def write(path: Path, shown: HeightMap) -> None:
    """Write one of the proof's maps."""
    write_map(path, shown.heights_um, shown.dx_um, shown.dy_um, overwrite=True)


def press_of(drawn: Draw, effects: Sequence[dict]) -> Press:
    """Return the press of a case with some effects."""
    return press_from({**drawn.process, "conversion": drawn.conversion, "effects": list(by_machine(effects)[0])})


def microscope_of(drawn: Draw, part: HeightMap, effects: Sequence[dict], **settings) -> Microscope:
    """Return the microscope on the target's own grid, as an alignment would have left it."""
    rows, cols = part.shape
    grid = {"pitch_um": [part.dx_um, part.dy_um], "pixels": [cols, rows]}
    return microscope_from({**grid, "effects": list(by_machine(effects)[1]), **settings})


@dataclass(frozen=True, eq=False)
class Bare:
    """Structures of a case without anything concealed, noise-free: what a change is counted from.

    Parameters
    ----------
    drawn : Draw
    parts : list of HeightMap
    sight : Sight
    plain : list of numpy.ndarray, shape (rows, cols)
    """

    drawn: Draw
    parts: list[HeightMap]
    sight: Sight
    plain: list[np.ndarray]

    @classmethod
    def of(cls, drawn: Draw, listed: Sequence[dict]) -> Bare:
        """Print some structures of a case with nothing concealed."""
        parts = [structures.made(one) for one in listed]
        return cls(drawn, parts, Sight.of(parts, drawn.process, drawn.noise), shown(drawn, parts, []))

    def shares(self, entry: dict) -> dict[str, float]:
        """Return what becomes of the change that an effect makes, as the press prints it."""
        changed = shown(self.drawn, self.parts, [entry])
        return self.sight.shares([np.nan_to_num(a - b) for a, b in zip(changed, self.plain, strict=True)])


def shown(drawn: Draw, parts: Sequence[HeightMap], effects: Sequence[dict]) -> list[np.ndarray]:
    """Return what the instrument shows of some structures but for noise, shape (rows, cols) each."""
    press = press_of(drawn, effects)
    return [seen(part, press, microscope_of(drawn, part, effects), finer=FINER).heights_um for part in parts]


def strength(hidden: Hidden, times: float, bare: Bare) -> dict:
    """Return the effect at so many times its detection limit, and what becomes of it.

    Where no strength inside the range reaches the wanted multiple, the one that comes nearest is taken; where even that
    shows nearly nothing (what calibration absorbs whole), the probe. `times` says what it is worth, and grows with
    `power`.
    """
    goal = times * LIMIT_Z
    tried = {hidden.probe: bare.shares(hidden.at(hidden.probe))}
    for _ in range(ROUNDS):
        value, power = _closer(hidden, {at: shares["z"] for at, shares in tried.items()}, goal)
        if value in tried or min(abs(np.log(goal / max(s["z"], 1e-9))) for s in tried.values()) < CLOSE:
            break
        tried[value] = bare.shares(hidden.at(value))
    order = sorted(tried, key=lambda at: tried[at]["z"])
    value = [order[0], *(at for at in order if tried[at]["z"] <= goal * (1 + CLOSE))][-1]
    if tried[value]["z"] < WEAKEST * LIMIT_Z * (1 - CLOSE):
        value = hidden.probe
    shares = tried[value]
    return {
        "name": hidden.name, "switch": hidden.switch, "value": value, "off": hidden.off, "wanted": times,
        "times": shares["z"] / LIMIT_Z, "power": power, **shares, "entry": hidden.at(value),
    }  # fmt: skip


def _closer(hidden: Hidden, z: dict[float, float], wanted: float) -> tuple[float, float]:
    """Return the next strength to try, and the power of the strength that z goes with there.

    The power is that between the two tries around the wanted z, or the two that come nearest to it.
    """
    sizes = sorted((abs(value - hidden.off), max(found, 1e-9)) for value, found in z.items())
    below, above = [one for one in sizes if one[1] <= wanted], [one for one in sizes if one[1] > wanted]
    pair = (below[-1], above[0]) if below and above else (below[:-3:-1] or above[:2])
    (size, found), (other, beside) = pair[0], pair[-1]
    power = float(np.clip(np.log(beside / found) / np.log(other / size), *POWERS)) if len(pair) > 1 else 1.0
    step = np.sign(hidden.probe - hidden.off) * size * (wanted / found) ** (1 / power)
    return float(np.clip(hidden.off + step, hidden.low, hidden.high)), power


def seal(folder: Path, seed: int, kind: str, index: int) -> str:
    """Make a case unless it is there; return its name."""
    place, name = Folder(folder), name_of(seed, kind, index)
    if place.truth(name).exists():
        return name
    drawn = draw(seed, kind, index)
    parts = [structures.made(one) for one in drawn.structures]
    effects = []
    if drawn.hidden:
        bare = Bare.of(drawn, drawn.limit_on)
        effects = [strength(h, t, bare) for h, t in zip(drawn.hidden, drawn.times, strict=True)]
        given = bare if drawn.structures == drawn.limit_on else Bare.of(drawn, drawn.structures)
        for one in effects:
            one["z_given"] = one["z"] if given is bare else given.shares(one["entry"])["z"]
    entries = [one["entry"] for one in effects]
    truth = {
        "kind": kind, "index": index, "process": drawn.process, "conversion": drawn.conversion, "noise": drawn.noise,
        "structures": drawn.structures, "holdout": drawn.holdout, "microscope": drawn.microscope, "effects": effects,
    }  # fmt: skip
    place.data(name).mkdir(parents=True, exist_ok=True)
    place.truth(name).parent.mkdir(parents=True, exist_ok=True)
    press, rng = press_of(drawn, entries), np.random.default_rng([seed, len(FULL) + list(FULL).index(kind), index])
    for k, part in enumerate(parts):
        scope = microscope_of(drawn, part, entries, **_used(drawn, rng))
        recording = seen(part, press, scope, seed=int(rng.integers(2**31)), finer=FINER)
        write(place.data(name) / f"target_{k}.tif", part)
        write(place.data(name) / f"recording_{k}.tif", recording)
    kept = structures.made(drawn.holdout)
    write(place.kept(name, "target"), kept)
    write(place.kept(name, "clean"), seen(kept, press, microscope_of(drawn, kept, entries), finer=FINER))
    write_text(place.truth(name), json.dumps(truth, indent=1, default=float) + "\n")
    return name


def _used(drawn: Draw, rng: np.random.Generator) -> dict:
    """Return how the microscope is used on one recording: the pose that an alignment leaves, noise, faults."""
    own = dict(drawn.microscope)
    pose = {"shift_um": rng.normal(0, 0.03, 2).tolist(), "rotation_deg": float(rng.normal(0, 0.02))}
    pose |= {key: own.pop(key) for key in ("tilt_mrad", "offset_um") if key in own}
    return {"pose": pose, "noise": drawn.noise, **own}


def seals(folder: Path, names: Sequence[str]) -> dict[str, dict]:
    """Return the SHA-256 of every truth and of every map of the cases."""
    place = Folder(folder)
    return {
        name: {
            "truth": sha256(place.truth(name)),
            "maps": {path.name: sha256(path) for path in sorted(place.data(name).glob("*.tif"))},
            "kept": {what: sha256(place.kept(name, what)) for what in ("target", "clean")},
        }
        for name in names
    }
