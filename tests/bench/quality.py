"""The table of the diagnosis benchmark: how often an answer is right, and what it cost; a column for every program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tests.bench.cases import SIDE_UM, SIDES, alike, in_terms_of
from tests.prove.hidden import LOCAL
from tests.prove.linear import LIMIT_Z
from tests.prove.place import points_at

NORMAL = 1.96


@dataclass(frozen=True)
class Line:
    """One line of the table.

    Parameters
    ----------
    label : str
    values : sequence of float
        Hits (bool) or numbers of the cases.
    wanted : str
    kind : str
        `share` of hits; `spread`: median and nine tenths of numbers.
    """

    label: str
    values: Sequence[float]
    wanted: str = ""
    kind: str = "share"

    @property
    def text(self) -> str:
        """The figure."""
        if not len(self.values):
            return "-"
        if self.kind == "spread":
            return f"{np.median(self.values):8.3g} {np.quantile(self.values, 0.9):8.3g}  ({len(self.values)})"
        hits, count = int(sum(self.values)), len(self.values)
        low, high = wilson(hits, count)
        return f"{hits:3d} of {count:3d} = {hits / count:4.0%} ({low:.0%} to {high:.0%})"


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 209, 1927).

    Examples
    --------
    >>> [round(end, 3) for end in wilson(0, 20)]
    [0.0, 0.161]
    """
    middle = (hits + NORMAL**2 / 2) / (count + NORMAL**2)
    half = NORMAL * np.sqrt(hits * (count - hits) / count + NORMAL**2 / 4) / (count + NORMAL**2)
    return float(max(middle - half, 0)), float(min(middle + half, 1))


def show(programs: Mapping[str, Mapping[str, dict]], known: Mapping) -> None:
    """Print the table.

    Parameters
    ----------
    programs : mapping of str to mapping of str to dict
        Name of the program to its answers by case.
    known : mapping
        The limits.
    """
    columns = [lines(done, known) for done in programs.values()]
    print(f"{'':62s} " + " ".join(f"{name:30s}" for name in programs) + " wanted")
    for same in zip(*columns, strict=True):
        if any(len(line.values) for line in same):
            print(f"{same[0].label:62s} " + " ".join(f"{line.text:30s}" for line in same) + f" {same[0].wanted}")


def lines(done: Mapping[str, dict], known: Mapping) -> list[Line]:
    """Return all lines of one program."""

    def of(kind: str) -> list[dict]:
        return [content for name, content in done.items() if name.startswith(kind)]

    singles, pairs, outside = of("single"), of("pair"), of("outside")
    nulls = [Line("nulls: nothing said", [c["verdict"] == "none" for c in of("null")], ">= 95 %")]
    nulls += [Line("raw nulls, aligned: nothing said", [c["verdict"] == "none" for c in of("raw-null")], ">= 95 %")]
    found = [*nulls, *_of_singles("singles at twice the limit", singles)]
    for form in ("library", "longer"):
        part = [c for c in singles if c["forms"] == [form]]
        found.append(Line(f"  {FORMS[form]}: true one in a named class", [_held(c) for c in part]))
    found += _of_singles("raw singles, aligned", of("raw-single"))
    first = [(_names(c), c["findings"]) for c in pairs if c["findings"]]
    found += [
        Line("pairs, 1.5 to 4 times the limit: heard", [_heard(c) for c in pairs]),
        Line("  both in named classes", [all(_all_held(c)) for c in pairs], ">= 75 %"),
        Line("  any of the two in a named class", [any(_all_held(c)) for c in pairs]),
        Line("  first name is one of the two", [f[0]["effects"][0] in n for n, f in first]),
        Line("findings in singles and pairs: spurious", _spurious([*singles, *pairs])),
        *_of_outside(outside, known),
        *_of_absorbed(of("absorbed")),
    ]
    for form, words in FORMS.items():
        every = list(_covered([*singles, *pairs], form, lone=False))
        found.append(Line(f"95 % intervals, {words}: cover the truth", every, "90 to 98 %"))
        lone = list(_covered([*singles, *pairs], form, lone=True))
        found.append(Line("  where one name stands alone", lone))
    found.append(Line("held-out gap baseline - noise closed, squares", _gaps(singles), "0.80", "spread"))
    return found + _costs(done)


FORMS = {"library": "library form", "longer": "longer physics"}


def _heard(c: Mapping) -> bool:
    return c["verdict"] != "none"


def _names(c: Mapping) -> list[str]:
    return [e["name"] for e in c["truth"]]


def _all_held(c: Mapping) -> list[bool]:
    """Tell of every effect that is there whether a class names it."""
    return [any(name in f["effects"] for f in c["findings"]) for name in _names(c)]


def _held(c: Mapping) -> bool:
    return all(_all_held(c))


def _of_singles(label: str, singles: Sequence[Mapping]) -> list[Line]:
    named = [c for c in singles if c["findings"]]
    first = [(c["truth"][0]["name"], c["findings"][0]) for c in named]
    return [
        Line(f"{label}: heard", [_heard(c) for c in singles], ">= 95 %"),
        Line("  of these with a finding: true one in a named class", [_held(c) for c in named], ">= 95 %"),
        Line("  first name is the true one", [f["effects"][0] == t for t, f in first]),
        Line("  first name in the truth's class of look-alikes", [alike(t, f["effects"][0]) for t, f in first]),
        Line("  lone name right", [f["effects"] == [t] for t, f in first if len(f["effects"]) == 1], ">= 85 %"),
        Line("  wrong side", [f["side"] not in (SIDES[t], "undecided") for t, f in first], "<= 2 %"),
        Line("  names in the first class", [len(f["effects"]) for _, f in first], "", "spread"),
    ]  # fmt: skip


def _spurious(several: Sequence[Mapping]) -> list[bool]:
    return [not any(name in f["effects"] for name in _names(c)) for c in several for f in c["findings"]]


def _of_outside(outside: Sequence[Mapping], known: Mapping) -> list[Line]:
    clear = [c for c in outside if known[c["truth"][0]["name"]]["z"] >= 2 * LIMIT_Z]
    spots = [(c["truth"][0], c["locations"]) for c in outside if c["truth"][0]["name"] in LOCAL]
    return [
        Line("outside the library: unexplained", [c["verdict"] == "unexplained" for c in outside]),
        Line("  of those twice a limit out", [c["verdict"] == "unexplained" for c in clear], ">= 90 %"),
        Line("  confidently misnamed", [c["verdict"] == "identified" for c in outside], "<= 5 %"),
        Line("  local ones: place right", [points_at(spot, boxes, SIDE_UM) for spot, boxes in spots], ">= 90 %"),
    ]


def _of_absorbed(absorbed: Sequence[Mapping]) -> list[Line]:
    one = [c for c in absorbed if c["structures"] == 1]
    four = [c for c in absorbed if c["structures"] > 1]
    misnamed = [c["verdict"] == "identified" and c["findings"][0]["effects"] != _names(c) for c in one]
    return [
        Line("absorbed, one roughness map: wrong confident name", misnamed, "0"),
        Line("absorbed, four structures: named", [_held(c) for c in four], "all"),
    ]


def _covered(several: Sequence[Mapping], form: str, *, lone: bool) -> Iterable[bool]:
    """Yield whether the intervals of the effects that are there hold the truth, wherever a class names them."""
    for c in several:
        for truth, own in zip(c["truth"], c["forms"], strict=True):
            for finding in c["findings"] if own == form else ():
                if lone and len(finding["effects"]) > 1:
                    continue
                found = in_terms_of(truth, finding["parameters"].get(truth["name"], {}))
                for name, interval in found.items():
                    if name in truth:
                        yield interval["low"] <= truth[name] <= interval["high"]


def _gaps(singles: Sequence[Mapping]) -> list[float]:
    """Return what share of the squared error on data not seen, beyond noise, the names remove."""
    found = []
    for c in singles:
        before, after = (c[model]["holdout_rmse_um"] for model in ("baseline", "extended"))
        if c["findings"] and before is not None:
            found.append((before**2 - after**2) / max(before**2 - c["noise_um"] ** 2, 1e-12))
    return found


def _costs(done: Mapping[str, Mapping]) -> list[Line]:
    kinds: dict[str, Callable[[str], bool]] = {
        "no effect": lambda name: "null" in name,
        "one effect": lambda name: "single" in name,
        "two effects": lambda name: name.startswith("pair"),
        "outside the library": lambda name: name.startswith("outside"),
    }
    found = []
    for what, words in (("work", "predictions"), ("cpu_s", "CPU seconds")):
        for kind, fits in kinds.items():
            values = [c[what] for name, c in done.items() if fits(name)]
            found.append(Line(f"{words}, {kind}: median, nine tenths", values, "", "spread"))
    return found
