"""Cases made, their truth sealed: height maps under opaque names, and the SHA-256 of what is concealed in them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from dlwpredict.files.atomic import write_text
from dlwpredict.files.provenance import sha256
from dlwpredict.heightmap import HeightMap
from tests.bench.cases import by_machine, seen
from tests.press import (
    Microscope,
    Press,
    Recording,
    measure,
    microscope_from,
    press_from,
    print_part,
    read_map,
    write_map,
)
from tests.prove import structures
from tests.prove.hidden import FORM, Hidden, of_press
from tests.prove.linear import LIMIT_Z, Sight, coarser
from tests.prove.mix import FULL, STRONGEST, WEAKEST, Draw, draw, name_of

FINER, FINEST_UM = 2, 0.14
"""The press prints the targets' pixels as squares of this many pixels a side (0.5 nm from the limit of many on pixels
of 0.45 µm), where these are no smaller than the second; else as they are: they resolve the focus, and a map of 100 µm
stays within 1 GB."""

ROUNDS, CLOSE, NEAR = 4, 0.12, 0.3
"""Times that a strength is corrected at most, since few effects grow in proportion to it, and when it is right: for an
effect, and for an error of form."""

WIDER, WOBBLE_DEG = (1.1, 1.4), 0.3
"""A raw field is so many times as wide as the part in it; parts on one sample differ in their turn by this."""

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

    def aligned(self, name: str, k: int) -> Path:
        """Return a recording as the program has laid it on its target."""
        return self.root / "aligned" / name / f"recording_{k}.tif"

    def recording(self, name: str, k: int) -> Path:
        """Return a recording on its target's grid, whoever has laid it there."""
        given = self.data(name) / f"recording_{k}.tif"
        return given if given.exists() else self.aligned(name, k)

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


def finer(pitch_um: float) -> int:
    """Return how many pixels of the press a target's pixel is wide."""
    return FINER if pitch_um >= FINER * FINEST_UM else 1


def press_of(drawn: Draw, effects: Sequence[dict]) -> Press:
    """Return the press of a case with some effects, an error of form among them."""
    form = next((of_press(one) for one in effects if one["name"] == FORM), {})
    own = [one for one in by_machine(effects)[0] if one["name"] != FORM]
    return press_from({**drawn.process, "conversion": drawn.conversion, **form, "effects": own})


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
        """Print some structures of a case with nothing concealed, on coarse pixels: only strengths hang on them."""
        pitch_um = max(drawn.pitch_um, structures.FINE_ENOUGH_UM)
        parts = [structures.made(one, pitch_um) for one in listed]
        recorded_um = drawn.raw.get("pitch_um", drawn.pitch_um)
        noise = coarser(drawn.noise, recorded_um, pitch_um)
        return cls(drawn, parts, Sight.of(parts, drawn.process, noise, recorded_um), shown(drawn, parts, []))

    def shares(self, entry: dict) -> dict[str, float]:
        """Return what becomes of the change that an effect makes, as the press prints it."""
        changed = shown(self.drawn, self.parts, [entry])
        return self.sight.shares([np.nan_to_num(a - b) for a, b in zip(changed, self.plain, strict=True)])


def shown(drawn: Draw, parts: Sequence[HeightMap], effects: Sequence[dict]) -> list[np.ndarray]:
    """Return what the instrument shows of some structures but for noise, on their grids, shape (rows, cols) each.

    Where the part lies turned under a microscope that does something, it is recorded turned and read back: what has
    an axis in the microscope has another on the part.
    """
    press, turn_deg = press_of(drawn, effects), drawn.raw.get("turn_deg", 0.0)
    if turn_deg and any(by_machine([hidden.at(hidden.probe)])[1] for hidden in (*drawn.hidden, *drawn.spare)):
        return [_turned(part, press, by_machine(effects)[1], turn_deg) for part in parts]
    scopes = [microscope_of(drawn, part, effects) for part in parts]
    return [seen(p, press, scope, finer=finer(p.dx_um)).heights_um for p, scope in zip(parts, scopes, strict=True)]


def _turned(part: HeightMap, press: Press, artefacts: Sequence[dict], turn_deg: float) -> np.ndarray:
    """Record a part that lies turned, on its own pitch, and read the recording at the target's points.

    Linearly: no wall reaches farther than a pixel, as none does where the program lays a recording on its target.
    """
    turn, side = np.radians(turn_deg), 1.02 * float(np.hypot(*part.size_um))
    pose = {"rotation_deg": turn_deg}
    scope = microscope_from({
        "pitch_um": [part.dx_um, part.dy_um], "field_um": [side, side], "pose": pose, "effects": list(artefacts)
    })  # fmt: skip
    found = recorded(part, press, scope, finer=finer(part.dx_um))
    x, y = np.meshgrid(part.x_um, part.y_um)
    columns = (x * np.cos(turn) - y * np.sin(turn)) / found.dx_um + (found.heights.shape[1] - 1) / 2
    rows = (found.heights.shape[0] - 1) / 2 - (x * np.sin(turn) + y * np.cos(turn)) / found.dy_um
    return map_coordinates(found.heights, [rows, columns], order=1, mode="nearest")


def recorded(part: HeightMap, press: Press, scope: Microscope, *, seed: int = 0, finer: int = FINER) -> Recording:
    """Print a target on pixels so many times finer and record it on the microscope's own grid."""
    heights, dx, dy = np.kron(part.heights_um, np.ones((finer, finer))), part.dx_um / finer, part.dy_um / finer
    return measure(print_part(heights, dx, dy, press), dx, dy, scope, seed=seed)


def strength(hidden: Hidden, times: float, bare: Bare, close: float = CLOSE) -> dict:
    """Return the effect at so many times its detection limit, and what becomes of it.

    Where no strength inside the range reaches the wanted multiple, the one that comes nearest is taken; where even that
    shows nearly nothing (what calibration absorbs whole), the probe. `times` says what it is worth, and grows with
    `power`.
    """
    goal = times * LIMIT_Z
    tried = {hidden.probe: bare.shares(hidden.at(hidden.probe))}
    for _ in range(ROUNDS):
        value, power = _closer(hidden, {at: shares["z"] for at, shares in tried.items()}, goal)
        if value in tried or min(abs(np.log(goal / max(s["z"], 1e-9))) for s in tried.values()) < close:
            break
        tried[value] = bare.shares(hidden.at(value))
    order = sorted(tried, key=lambda at: tried[at]["z"])
    value = [order[0], *(at for at in order if tried[at]["z"] <= goal * (1 + close))][-1]
    if tried[value]["z"] < WEAKEST * LIMIT_Z * (1 - close):
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


def concealed(drawn: Draw) -> tuple[list[dict], dict | None]:
    """Return what is concealed in a case at its strengths, and its error of form if there is one."""
    if not drawn.hidden and not drawn.form:
        return [], None
    bare, effects, spare = Bare.of(drawn, drawn.limit_on), [], list(drawn.spare)
    for hidden, times in zip(drawn.hidden, drawn.times, strict=True):
        one = strength(hidden, times, bare)
        while not drawn.least <= one["times"] <= 2 * STRONGEST and spare:
            one = strength(spare.pop(0), times, bare)
        effects.append(one)
    form = strength(drawn.form, drawn.form_times, bare, NEAR) if drawn.form else None
    given = bare if drawn.structures == drawn.limit_on else Bare.of(drawn, drawn.structures)
    for one in effects:
        one["z_given"] = one["z"] if given is bare else given.shares(one["entry"])["z"]
    return effects, form


def seal(folder: Path, seed: int, kind: str, index: int) -> str:
    """Make a case unless it is there; return its name."""
    place, name = Folder(folder), name_of(seed, kind, index)
    if place.truth(name).exists():
        return name
    drawn = draw(seed, kind, index)
    effects, form = concealed(drawn)
    entries = [one["entry"] for one in (*effects, *([form] if form else []))]
    place.data(name).mkdir(parents=True, exist_ok=True)
    place.truth(name).parent.mkdir(parents=True, exist_ok=True)
    press, rng = press_of(drawn, entries), np.random.default_rng([seed, len(FULL) + list(FULL).index(kind), index])
    what, poses, sides = "raw" if drawn.raw else "recording", [], []
    for k, structure in enumerate(drawn.structures):
        part = structures.made(structure, drawn.pitch_um)
        scope = microscope_from(_used(drawn, part, entries, rng))
        recording = recorded(part, press, scope, seed=int(rng.integers(2**31)), finer=finer(part.dx_um))
        write(place.data(name) / f"target_{k}.tif", part)
        notes = {"instrument_fast_axis_deg": 0.0} if drawn.noise["row_um"] else None
        write_map(
            place.data(name) / f"{what}_{k}.tif", recording.heights, recording.dx_um, recording.dy_um, overwrite=True,
            notes=notes,
        )  # fmt: skip
        poses.append(recording.truth)
        sides.append(part.size_um)
    kept = structures.made(drawn.holdout, structures.HELD_OUT_UM)
    write(place.kept(name, "target"), kept)
    write(place.kept(name, "clean"), kept.with_heights(shown(drawn, [kept], entries)[0]))
    truth = {
        "kind": kind, "index": index, "process": drawn.process, "conversion": drawn.conversion, "noise": drawn.noise,
        "structures": drawn.structures, "pitch_um": drawn.pitch_um, "sides_um": sides, "holdout": drawn.holdout,
        "microscope": drawn.microscope, "raw": drawn.raw, "poses": poses, "effects": effects, "form": form,
    }  # fmt: skip
    write_text(place.truth(name), json.dumps(truth, indent=1, default=float) + "\n")
    return name


def _used(drawn: Draw, part: HeightMap, entries: Sequence[dict], rng: np.random.Generator) -> dict:
    """Return the microscope as it is used on one recording: its field, the pose, noise, faults.

    On the target's grid the pose is what an alignment leaves. A raw field is larger than the part, which lies turned
    (all parts of a case on one sample) and off the middle.
    """
    own = dict(drawn.microscope)
    if drawn.raw:
        turn_deg, pitch_um = drawn.raw["turn_deg"] + float(rng.normal(0, WOBBLE_DEG)), drawn.raw["pitch_um"]
        cos, sin = abs(np.cos(np.radians(turn_deg))), abs(np.sin(np.radians(turn_deg)))
        reach = np.array([[cos, sin], [sin, cos]]) @ part.size_um
        field_um = reach * rng.uniform(*WIDER)
        pose = {
            "shift_um": ((field_um - reach) * rng.uniform(-0.4, 0.4, 2)).tolist(), "rotation_deg": turn_deg,
            "tilt_mrad": rng.uniform(-5, 5, 2).tolist(), "offset_um": float(rng.uniform(-1, 1)),
            "uneven_um": [drawn.raw["uneven_um"], 0.0],
        }  # fmt: skip
        grid = {"pitch_um": [pitch_um] * 2, "field_um": field_um.tolist()}
    else:
        pose = {"shift_um": rng.normal(0, 0.03, 2).tolist(), "rotation_deg": float(rng.normal(0, 0.02))}
        grid = {"pitch_um": [part.dx_um, part.dy_um], "pixels": list(part.shape[::-1])}
    pose |= {key: own.pop(key) for key in ("tilt_mrad", "offset_um") if key in own}
    return {**grid, "pose": pose, "noise": drawn.noise, "effects": list(by_machine(entries)[1]), **own}


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
