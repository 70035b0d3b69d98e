"""The table of a proof: every number with the cases that it counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tests.bench.cases import NEVER
from tests.prove.hidden import LIKE_LIBRARY, OUTSIDE
from tests.prove.judge import CONCEALMENTS
from tests.prove.mix import CLEAR

CLASSES = {
    "dome": ("vignetting", "print-field-curvature", "field-curvature", "curl"),
    "height curve": ("z-drift", "z-linearity", "shrinkage-nonlinearity", "z-amplification"),
    "layer order": ("power-drift", "interface-offset", "spherical-aberration"),
    "sharpness": ("instrument-blur", "batwings", "astigmatism", "tip-convolution"),
    "short range": ("edge-inhibition", "psf-wings", "dose-proximity", "edge-drying"),
    "along y": ("galvo-lag", "line-end-pileup", "slope-error", "line-length-error"),
    "along x": ("dose-memory",),
    "levelled away": ("substrate-tilt",),
    "lateral scale": ("lateral-shrinkage", "misregistration"),
    "seam": ("stitching",),
}
"""Classes of the confusion matrix: those of look-alikes (effects.md, section 6), each name in one."""

STRONG_Z = 10.0
"""Physics outside the library is expected to be found from here on."""


PERCENTILES = {"median": 50, "most": 95}


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Parameters
    ----------
    group, what : str
    cases : list of str
        Names of the cases that count, one entry per count.
    hits : list of bool
        Or numbers, for a median.
    wanted : str
    kind : {"share", "median", "most"}
        `most`: the 95th percentile.
    """

    group: str
    what: str
    cases: list[str]
    hits: list
    wanted: str = ""
    kind: str = "share"

    @property
    def value(self) -> float | None:
        """Share of hits, the median, or the 95th percentile; None where nothing counts."""
        if not self.hits:
            return None
        return float(np.mean(self.hits) if self.kind == "share" else np.percentile(self.hits, PERCENTILES[self.kind]))

    def content(self) -> dict:
        """Return the line with everything it rests on."""
        shown = {"group": self.group, "what": self.what, "wanted": self.wanted, "value": self.value,
                 "count": len(self.hits), "cases": self.cases, "hits": [float(hit) for hit in self.hits]}  # fmt: skip
        if self.kind == "share":
            shown |= {"hit": int(np.sum(self.hits)), "interval": wilson(int(np.sum(self.hits)), len(self.hits))}
        return shown


def wilson(hit: int, count: int, z: float = 1.96) -> list[float]:
    """Return Wilson's 95 % interval of a share.

    Examples
    --------
    >>> [round(end, 3) for end in wilson(3, 60)]
    [0.017, 0.137]
    """
    if count == 0:
        return [0.0, 1.0]
    share, weight = hit / count, z**2 / count
    middle, half = share + weight / 2, z * np.sqrt(share * (1 - share) / count + weight / (4 * count))
    return [float(max((middle - half) / (1 + weight), 0)), float(min((middle + half) / (1 + weight), 1))]


def class_of(name: str) -> str:
    """Return the class of the confusion matrix that a name belongs to."""
    return next(label for label, names in CLASSES.items() if name in names)


def counted(group: str, what: str, results: Iterable[Mapping], hit: Callable[[Mapping], object], wanted: str = ""):
    """Return a line that counts one hit or none per case."""
    results = list(results)
    return Row(group, what, [r["name"] for r in results], [bool(hit(r)) for r in results], wanted)


def strongest(result: Mapping) -> float:
    """Return the strength of a case's strongest effect in multiples of its detection limit; 0 where there is none."""
    return max((e["times"] for e in result["truth"]["effects"]), default=0.0)


def weakest(result: Mapping) -> float:
    """Return the strength of a case's weakest effect in multiples of its detection limit; 0 where there is none."""
    return min((e["times"] for e in result["truth"]["effects"]), default=0.0)


def wrong_form(result: Mapping) -> float:
    """Return what calibration leaves of a case's error of form, in multiples of its detection limit; 0 without."""
    form = result["truth"].get("form")
    return form["times"] if form else 0.0


KINDS = ("null", "single", "pair", "outside", "absorbed", "measurement", "form")


def rows(results: Sequence[Mapping]) -> list[Row]:
    """Return the table of all cases; a case that failed counts as answered wrongly wherever it is counted."""
    of = {kind: [r for r in results if r["truth"]["kind"] == kind] for kind in KINDS}
    found = [counted("all", "cases answered without failure", results, lambda r: r["verdict"] != "failed", "100 %")]
    found += _nulls(of["null"]) + _forms(of["form"]) + _singles(of["single"]) + _sizes(of["single"])
    found += _pairs(of["pair"])
    found += _outside(of["outside"]) + _absorbed(of["absorbed"]) + _measurement(of["measurement"])
    found += _ways(results) + _work(results)
    return found + _concealed(results) + _unseen(of["single"] + of["pair"]) + _beside(results)


def _nulls(nulls: list) -> list[Row]:
    plain = [r for r in nulls if not r["truth"].get("form")]
    formed = [r for r in nulls if r["truth"].get("form")]
    clear = [r for r in formed if wrong_form(r) >= 1]
    far = [r for r in plain if r["truth"]["noise"]["correlation_um"] > 1.2]
    return [
        counted("null", "anything said", nulls, lambda r: r["verdict"] != "none", "<= 8 %"),
        counted("null", "an effect named", nulls, lambda r: r["findings"], "<= 5 %"),
        counted("null", "the process of the seven's form: anything said", plain, lambda r: r["verdict"] != "none",
                "<= 5 %"),
        counted("null", "... noise correlated over more than 1.2 um", far, lambda r: r["verdict"] != "none", "<= 5 %"),
        counted("null", "an error of form: an effect named", formed, lambda r: r["findings"], "<= 5 %"),
        counted("null", "... unexplained", formed, lambda r: r["verdict"] == "unexplained", ""),
        counted("null", "... from the limit on: an effect named", clear, lambda r: r["findings"], ""),
    ]  # fmt: skip


SIZES = {"below the limit": (0.0, 1.0), "one to two times the limit": (1.0, 2.0), "from twice the limit on": (2.0, 1e9)}


def _forms(forms: list) -> list[Row]:
    """Return the lines of cases whose process differs in form, and nothing else."""
    left = [r["truth"]["form"]["left_um"] / np.hypot(r["truth"]["noise"]["sigma_um"], r["truth"]["noise"]["white_um"])
            for r in forms]  # fmt: skip
    found = [Row("form", "what calibration leaves over noise, median", [r["name"] for r in forms], left, "", "median")]
    for words, (low, high) in SIZES.items():
        cases = [r for r in forms if low <= wrong_form(r) < high]
        said, clear = [r for r in cases if r["verdict"] != "failed"], low >= 1
        found += [
            counted("form", f"{words}: named with confidence", said, lambda r: r["misnamed"], "<= 5 %"),
            counted("form", "... unexplained", cases, lambda r: r["verdict"] == "unexplained", ">= 90 %" * clear),
            counted("form", "... nothing said", cases, lambda r: r["verdict"] == "none", ""),
        ]
    return found


WAYS: dict[str, Callable[[Mapping], bool]] = {
    "recorded raw": lambda r: bool(r["truth"].get("raw")),
    "recorded on the target's grid": lambda r: not r["truth"].get("raw"),
    "noise of rows": lambda r: r["truth"]["noise"].get("row_um", 0.0) > 0,
    "no noise of rows": lambda r: not r["truth"]["noise"].get("row_um", 0.0) > 0,
    "error of form": lambda r: bool(r["truth"].get("form")),
    "no error of form": lambda r: not r["truth"].get("form"),
}
"""Ways in which cases differ, whatever is concealed in them."""


def _ways(results: Sequence[Mapping]) -> list[Row]:
    found = []
    for label, chosen in WAYS.items():
        group, cases = f"way: {label}", [r for r in results if chosen(r)]
        nulls = [r for r in cases if r["truth"]["kind"] == "null"]
        singles = [r for r in cases if r["truth"]["kind"] == "single" and strongest(r) >= 1]
        heard = [r for r in singles if r.get("detected")]
        found += [
            counted(group, "answered without failure", cases, lambda r: r["verdict"] != "failed"),
            counted(group, "nulls: an effect named", nulls, lambda r: r["findings"]),
            counted(group, "singles from the limit on: detected", singles, lambda r: r.get("detected")),
            counted(group, "... in the named class", heard, lambda r: any(r["held"])),
            counted(group, "... a wrong name given with confidence", heard, lambda r: r["misnamed"]),
        ]
    return found


def _work(results: Sequence[Mapping]) -> list[Row]:
    """Return what answers cost."""
    done = [r for r in results if r["verdict"] != "failed"]
    names, raw = [r["name"] for r in done], [r for r in done if r["truth"].get("raw")]
    cpu_s = [r.get("cpu_s", r["seconds"]) for r in done]
    asked = [r for r in done if r.get("work", {}).get("predictions") is not None]
    predictions = [r["work"]["predictions"] for r in asked]
    align_s = [r["align_cpu_s"] for r in raw]
    return [
        Row("work", "CPU seconds of a diagnosis, median", names, cpu_s, "<= 30", "median"),
        Row("work", "... 95 % take at most", names, cpu_s, "<= 120", "most"),
        Row("work", "predictions of a diagnosis, median", [r["name"] for r in asked], predictions, "", "median"),
        Row("work", "... 95 % take at most", [r["name"] for r in asked], predictions, "", "most"),
        Row("work", "CPU seconds of aligning all recordings of a raw case, median", [r["name"] for r in raw], align_s,
            "", "median"),
    ]  # fmt: skip


def _singles(singles: list) -> list[Row]:
    def between(low: float, high: float) -> list:
        return [r for r in singles if low <= strongest(r) < high]

    def detected(r: Mapping) -> bool:
        return r.get("detected", False)

    heard = [r for r in singles if detected(r) and strongest(r) >= 1]
    alone = [r for r in heard if r["first_single"] and r["verdict"] != "unexplained"]
    return [
        counted("single", "detected from twice the limit on", between(2, 1e9), detected, ">= 95 %"),
        counted("single", "detected at 0.8 to 1.25 times the limit", between(0.8, 1.25), detected, "80 to 90 %"),
        counted("single", "anything said below 0.3 times the limit", between(0, 0.3), detected, "<= 8 %"),
        counted("single", "detected from the limit on: truth in the named class", heard,
                lambda r: any(r["held"]), ""),
        counted("single", "... from twice the limit on", [r for r in heard if strongest(r) >= 2],
                lambda r: any(r["held"]), ">= 95 %"),
        counted("single", "... truth in the first class or a look-alike of it", heard,
                lambda r: r["first_held"] or r["first_alike"], ""),
        counted("single", "... one name given: it is the true one", alone, lambda r: r["first_held"], ">= 90 %"),
        counted("single", "... wrong side", heard, lambda r: r["wrong_side"], "<= 2 %"),
        counted("single", "... called unexplained", heard, lambda r: r["verdict"] == "unexplained", ""),
        counted("single", "... a further effect invented", heard, lambda r: r["spurious"] and any(r["held"]), ""),
    ]  # fmt: skip


def _sizes(singles: list) -> list[Row]:
    def line(what: str, wanted: str, chosen: Callable[[Mapping], bool], value: Callable[[Mapping], object], kind: str):
        pairs = [(r["name"], value(one)) for r in singles for one in r.get("intervals", []) if chosen(one)]
        return Row("size", what, [name for name, _ in pairs], [v for _, v in pairs], wanted, kind)

    def bias(one: Mapping) -> float:
        return (one["value"] - one["off"]) / (one["true"] - one["off"]) - 1

    return [
        line("95 % intervals cover the truth, library's form", "90 to 98 %",
             lambda one: one["model"] == "library", lambda one: one["covered"], "share"),
        line("... longer physics of the press", ">= 85 %",
             lambda one: one["model"] != "library", lambda one: one["covered"], "share"),
        line("relative error of the strength, median", "within 10 %",
             lambda one: one["switch"] and one["true"] != one["off"], bias, "median"),
    ]  # fmt: skip


def _pairs(pairs: list) -> list[Row]:
    clear, strong = ([r for r in pairs if weakest(r) >= least] for least in (1.0, CLEAR))
    return [
        counted("pair", "both from 1.5 times the limit on: both in named classes", strong,
                lambda r: all(r.get("held", [0])), ">= 75 %"),
        counted("pair", "... each in a class of its own", strong, lambda r: r.get("apart", False), ""),
        counted("pair", "... at least one", strong, lambda r: any(r.get("held", [])), ""),
        counted("pair", "both from the limit on: both in named classes", clear, lambda r: all(r.get("held", [0])), ""),
        counted("pair", "... the weaker one in a named class", clear, _weaker, ""),
        counted("pair", "... at least one", clear, lambda r: any(r.get("held", [])), ">= 98 %"),
        counted("pair", "... a further effect invented", clear, lambda r: r.get("spurious", 1), "<= 10 %"),
        counted("pair", "all pairs: at least one in a named class", pairs, lambda r: any(r.get("held", [])), ""),
    ]  # fmt: skip


def _weaker(result: Mapping) -> bool:
    """Tell whether the weaker effect of a pair, hidden behind the other, was found."""
    times = [e["times"] for e in result["truth"]["effects"]]
    return bool(result.get("held")) and result["held"][int(np.argmin(times))]


def _outside(outside: list) -> list[Row]:
    strong = [r for r in outside if r["truth"]["effects"][0]["z"] >= STRONG_Z]
    distinct = [r for r in strong if r["truth"]["effects"][0]["name"] not in LIKE_LIBRARY]
    placed = [r for r in strong if r.get("place") is not None]
    return [
        counted("outside", "from SNR 10 on: unexplained", strong, lambda r: r["verdict"] == "unexplained", ">= 90 %"),
        counted("outside", "... without those that look like a member of the library", distinct,
                lambda r: r["verdict"] == "unexplained", ""),
        counted("outside", "... named with confidence all the same", strong, lambda r: r.get("misnamed"), "<= 5 %"),
        counted("outside", "... nothing said", strong, lambda r: r["verdict"] == "none", ""),
        counted("outside", "all: named with confidence all the same", outside, lambda r: r.get("misnamed"), "<= 10 %"),
        counted("outside", "local ones from SNR 10 on: place right", placed, lambda r: r["place"], ">= 90 %"),
    ]  # fmt: skip


def _absorbed(absorbed: list) -> list[Row]:
    alone = [r for r in absorbed if len(r["truth"]["structures"]) == 1]
    three = [r for r in absorbed if len(r["truth"]["structures"]) > 1 and strongest(r) >= 2]
    seen = [one["z_given"] / one["z"] for r in alone for one in r["truth"]["effects"] if one["z"] > 0.1]
    return [
        Row("absorbed", "one roughness map: what it shows of what three structures show, median",
            [r["name"] for r in alone for one in r["truth"]["effects"] if one["z"] > 0.1], seen, "", "median"),
        counted("absorbed", "one roughness map: a wrong name given with confidence", alone,
                lambda r: r.get("misnamed"), "0"),
        counted("absorbed", "... named rightly, or nothing said", alone,
                lambda r: r["verdict"] == "none" or r.get("first_held"), ""),
        counted("absorbed", "three structures, from twice the limit on: in a named class", three,
                lambda r: any(r.get("held", [])), "all"),
    ]  # fmt: skip


def _measurement(measurement: list) -> list[Row]:
    def real(r: Mapping) -> bool:
        return any(e["name"] not in NEVER for e in r["truth"]["effects"])

    return [
        counted("measurement", "effects and their doubles: wrong side", filter(real, measurement),
                lambda r: r.get("wrong_side"), "<= 2 %"),
        counted("measurement", "registration, spikes, tilt: anything named", [r for r in measurement if not real(r)],
                lambda r: r["findings"], "0"),
    ]  # fmt: skip


def _concealed(results: Sequence[Mapping]) -> list[Row]:
    found = []
    for label in CONCEALMENTS:
        group, cases = f"concealed: {label}", [r for r in results if label in r["concealed"]]
        clear = [r for r in cases if strongest(r) >= 2]
        found += [
            counted(group, "all strengths: a true name in a named class", cases, lambda r: any(r.get("held", []))),
            counted(group, "... a wrong name given with confidence", cases, lambda r: r.get("misnamed")),
            counted(group, "from twice the limit on: a true name in a named class", clear,
                    lambda r: any(r.get("held", []))),
        ]  # fmt: skip
    return found


def _unseen(results: list) -> list[Row]:
    """Return how much better a structure is predicted that was kept from the program, and the seven parameters."""
    heard = [r for r in results if r.get("detected") and strongest(r) >= 1]
    better = [1 - (r["unseen_um"]["diagnose"] / r["unseen_um"]["seven"]) ** 2 for r in heard]
    biases = [1 - _size(r["seven"]["extended"]) / max(_size(r["seven"]["baseline"]), 1e-12) for r in heard]
    names = [r["name"] for r in heard]
    ratio = [r["rmse_um"]["extended"] / r["noise_true_um"] for r in heard]
    return [
        Row("unseen", "structure kept from the program: share of the squared error removed, median", names, better,
            "", "median"),
        counted("unseen", "... prediction better", heard,
                lambda r: r["unseen_um"]["diagnose"] < r["unseen_um"]["seven"], ""),
        Row("unseen", "share of the bias of the seven removed, median", names, biases, ">= 70 %", "median"),
        Row("unseen", "residual over true noise, median", names, ratio, "<= 1.1", "median"),
    ]  # fmt: skip


def _size(errors: Mapping) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors.values())))))


METHODS = {
    "seven": "seven parameters alone",
    "smooth": "seven + smooth discrepancy",
    "stepwise": "stepwise BIC",
    "diagnose": "diagnose",
    "oracle": "oracle: true effect known",
}


def of_method(result: Mapping, method: str) -> dict:
    """Return error on the recordings and on the structure kept, and the names, of a method on a case."""
    if method == "diagnose":
        names = [name for f in result["findings"] for name in f["effects"][:1]]
        return {"rmse_um": result["rmse_um"]["extended"], "unseen_um": result["unseen_um"]["diagnose"], "names": names}
    return result["baselines"][method]


def _beside(results: Sequence[Mapping]) -> list[Row]:
    """Return the lines of the baselines, on the sample that has them."""
    sample = [r for r in results if r["baselines"]]
    nulls = [r for r in sample if r["truth"]["kind"] == "null"]
    known = [r for r in sample if "oracle" in r["baselines"] and strongest(r) >= 1]
    gap = [r for r in known if r["baselines"]["seven"]["unseen_um"] > 1.2 * r["baselines"]["oracle"]["unseen_um"]]
    found = []
    for method, words in METHODS.items():
        group = f"method: {words}"
        one = [of_method(r, method)["rmse_um"] / r["noise_true_um"] for r in known]
        found.append(Row(group, "residual over true noise, median", [r["name"] for r in known], one, "", "median"))
        closed = [_closed(r, method) for r in gap]
        wanted = ">= 80 %" if method == "diagnose" else ""
        found.append(Row(group, "gap between seven and oracle closed on the structure kept, median",
                         [r["name"] for r in gap], closed, wanted, "median"))  # fmt: skip
        if method in ("stepwise", "diagnose"):
            found.append(counted(group, "nulls: physics invented", nulls, lambda r, m=method: of_method(r, m)["names"]))
            found.append(counted(group, "first name is a true one", known, lambda r, m=method: _first_true(r, m)))
            found.append(counted(group, "any name that is not true", known, lambda r, m=method: _any_false(r, m)))
    return found


def _closed(result: Mapping, method: str) -> float:
    seven, oracle = (result["baselines"][m]["unseen_um"] ** 2 for m in ("seven", "oracle"))
    return (seven - of_method(result, method)["unseen_um"] ** 2) / (seven - oracle)


def _true_names(result: Mapping) -> list[str]:
    return [e["name"] for e in result["truth"]["effects"]]


def _first_true(result: Mapping, method: str) -> bool:
    return any(name in _true_names(result) for name in of_method(result, method)["names"][:1])


def _any_false(result: Mapping, method: str) -> bool:
    return any(name not in _true_names(result) for name in of_method(result, method)["names"])


def confusion(results: Sequence[Mapping]) -> tuple[list[str], list[str], np.ndarray]:
    """Return truth by answer: labels of rows and columns, and counts; singles from the limit on, and the nulls."""
    truths = ["nothing", *CLASSES, "outside"]
    answers = ["none", *CLASSES, "unexplained", "failed"]
    counts = np.zeros((len(truths), len(answers)), dtype=int)
    for r in results:
        effects = r["truth"]["effects"]
        if r["truth"]["kind"] not in ("null", "single", "outside") or (effects and strongest(r) < 1):
            continue
        row = "nothing" if not effects else "outside" if effects[0]["name"] in OUTSIDE else class_of(effects[0]["name"])
        verdict = r["verdict"]
        if verdict in ("identified", "ambiguous"):
            true = [name for name in _true_names(r) if name in r["findings"][0]["effects"]]
            verdict = class_of((true or r["findings"][0]["effects"])[0])
        counts[truths.index(row), answers.index(verdict)] += 1
    return truths, answers, counts


def limits(results: Sequence[Mapping]) -> dict[str, dict]:
    """Return for every effect's switch the size at its detection limit and the change there in nm, medians of cases."""
    found: dict[str, list] = {}
    for r in results:
        for e in r["truth"]["effects"]:
            if e["times"] > 0.1:
                found.setdefault(f"{e['name']}.{e['switch']}", []).append((e, r["name"]))
    return {
        name: {
            "limit": float(
                np.median([abs(e["value"] - e["off"]) / e["times"] ** (1 / e["power"]) for e, _ in several])
            ),
            "change_nm": float(np.median([1e3 * e["raw_um"] / e["times"] for e, _ in several])),
            "cases": [case for _, case in several],
        }
        for name, several in sorted(found.items())
    }
