"""Press against program, effect by effect: what is left of both changes once everything that a fit may move is fitted.

Run as ``python -m tests.bench.agreement [EFFECT ...] [--json FILE]``; `make bench-agreement` does. Maps that agree to a
nanometre may still disagree here: calibration, levelling and registration take most of a change, and what they leave
is all that a diagnosis sees. A cosine below 0.9 is a finding: a fault of either, a limit of the pixels, or another law.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from dlwpredict.effects import library
from dlwpredict.effects.base import Effect
from dlwpredict.files.atomic import write_text
from dlwpredict.infer.objective import Fit
from dlwpredict.parameters import declarations
from dlwpredict.process import predict
from tests.bench.cases import Case, process, target
from tests.press.effect import registry
from tests.prove.hidden import NAMED, SET_APART, entry_of
from tests.prove.linear import Sight
from tests.prove.mix import Draw
from tests.prove.sealed import Bare, shown

SEED, Z = 2011, 10.0
"""Of the process; how far the program's change shall stand out of the noise."""

LIKE = {("lateral-shrinkage", "shear-lag"): {"free_edges": 1.0}}
"""What the program calls a model of the press."""

LEAST = 1e-6
"""Less than this share of a change counts as nothing."""


def bare(seed: int) -> Bare:
    """Return the structures of a case with nothing concealed, printed by the press without noise."""
    case = Case(seed=seed)
    parts = [target(kind) for kind in case.structures]
    noise = {"sigma_um": case.sigma_um, "correlation_um": case.correlation_um, "white_um": case.white_um}
    drawn = Draw("null", 0, process(seed), 0.0, noise | {"kind": "gaussian"}, [], {}, (), (), {}, [])
    return Bare(drawn, parts, Sight.of(parts, drawn.process, drawn.noise), shown(drawn, parts, []))


def left(fitted: Fit, changes_um: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return what a fit leaves of a change, as a direction of length 1 in whitened space and its length."""
    seen = fitted.rows.stack([fitted.seen(k, change) for k, change in enumerate(changes_um)])
    column = fitted.beside(seen)
    length = float(np.linalg.norm(column))
    return (column / length, length) if length > LEAST * np.linalg.norm(seen) else (0 * column, 0.0)


def by_program(known: Bare, effect: Effect) -> list[np.ndarray]:
    """Return the change of the prediction, µm, shape (rows, cols) each."""
    plain = known.sight.fit.parameters
    switched = replace(plain, effects=(effect,))
    return [
        np.nan_to_num(predict(part, switched, as_measured=True).heights_um - predict(part, plain).heights_um)
        for part in known.parts
    ]


def by_press(known: Bare, effect: Effect, model: str) -> list[np.ndarray]:
    """Return the change of what the press prints and its microscope shows, with the parameters that it knows."""
    entry = entry_of(effect) | ({"model": model} if model else {})
    changed = shown(known.drawn, known.parts, [entry])
    return [np.nan_to_num(a - b) for a, b in zip(changed, known.plain, strict=True)]


@dataclass(frozen=True)
class Agreement:
    """What is left of the two changes.

    Parameters
    ----------
    effect, switch : str
    model : str
        Of the press, where it has several.
    strength : float
    program, press : float
        How far each stands out of the noise, in standard deviations.
    cosine : float
        Between their directions in whitened space.
    """

    effect: str
    switch: str
    model: str
    strength: float
    program: float
    press: float
    cosine: float


def agreements(names: Sequence[str]) -> Iterator[Agreement]:
    """Compare the two, a switch of an effect and a model of the press at a time, where the program's change stands out.

    What only some models of the press have is set in the program where `LIKE` says how.
    """
    known = bare(SEED)
    fitted = known.sight.fit
    for name in names:
        kind = library()[name]
        for switch, typical in kind.switches().items():
            if switch in SET_APART or not hasattr(registry()[name](), switch):
                continue
            off, declared = declarations(kind)[switch]
            _, length = left(fitted, by_program(known, kind(**{switch: typical})))
            strength = float(np.clip(off + (typical - off) * Z / max(length, 1e-6), declared.low, declared.high))
            for model in getattr(registry()[name], "models", ("",)):
                effect = kind(**{switch: strength}, **LIKE.get((name, model), {}))
                one, ours = left(fitted, by_program(known, effect))
                other, theirs = left(fitted, by_press(known, effect, model))
                yield Agreement(name, switch, model, strength, ours, theirs, float(one @ other))


def main() -> None:
    """Print a line for every switch of every effect."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.agreement", description=__doc__.splitlines()[0])
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="all without")
    parser.add_argument("--json", type=Path, help="keep the figures")
    asked, kept = parser.parse_args(), []
    print(
        f"{'effect':24s} {'switch':20s} {'model':10s} {'strength':>9s} {'z program':>9s} {'z press':>8s} {'cosine':>7s}"
    )
    for one in agreements(asked.effects or NAMED):
        figures = f"{one.strength:9.4g} {one.program:9.1f} {one.press:8.1f} {one.cosine:7.3f}"
        print(f"{one.effect:24s} {one.switch:20s} {one.model:10s} {figures}", flush=True)
        kept.append(asdict(one))
    if asked.json:
        asked.json.parent.mkdir(parents=True, exist_ok=True)
        write_text(asked.json, json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
