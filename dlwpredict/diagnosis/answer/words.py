"""A diagnosis in the words of the bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.classes import Named, strengths
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.structure.columns import Columns
from dlwpredict.diagnosis.structure.forms import Energy
from dlwpredict.diagnosis.structure.registrations import PARAMETERS, Registration, chance_of, registrations
from dlwpredict.diagnosis.structure.ripple import Ripple
from dlwpredict.diagnosis.structure.test import SINGLE, Model, Pattern
from dlwpredict.effects import library
from dlwpredict.infer.recording import Recording
from dlwpredict.parameters import declarations

UNTESTED = "Nothing was tested yet: no fit has been made."
MOST_NAMES = 6
"""Names that a sentence lists."""


def side_of(names: Sequence[str]) -> str:
    """Return the side of a class: print, measurement, or undecided where it has members on both."""
    sides = {library()[name].side for name in names}
    return sides.pop() if len(sides) == 1 else "undecided"


def chance(probability: float) -> str:
    """Return a probability in per cent; what is nearly sure or nearly impossible is called no more than that.

    >>> chance(0.7312), chance(0.99996), chance(0.0001)
    ('73 %', 'over 99.9 %', 'below 0.1 %')
    """
    if probability > 0.999:
        return "over 99.9 %"
    if probability < 0.001:
        return "below 0.1 %"
    return f"{100 * probability:.1f} %" if not 0.01 <= probability <= 0.99 else f"{100 * probability:.0f} %"


def listed(names: Sequence[str]) -> str:
    """Return names, the first few of many.

    >>> listed(["a", "b"]), listed(list("abcdefgh"))
    ('a, b', 'a, b, c, d, e, f and 2 more')
    """
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def missing(diagnosis: Diagnosis, *, finished: bool) -> str:
    """Return what an answer lacks, empty where it is whole."""
    if finished:
        return ""
    untried = diagnosis.not_tried
    if untried:
        return f"Not complete, {len(untried)} effects were not refitted yet ({listed(untried)})."
    if not diagnosis.complete:
        return "Not complete: the sets of effects that were refitted have not settled yet."
    return "The search is complete; its intervals are those of a straight line, and no recording was advised."


def sentence(diagnosis: Diagnosis, *, finished: bool = True) -> str:
    """Return the verdict in one sentence; a second one says what is not known yet."""
    lacks = missing(diagnosis, finished=finished)
    return _verdict(diagnosis) + (f" {lacks}" if lacks else "")


def _each(diagnosis: Diagnosis) -> str:
    """Return what a process is asked to be the same for."""
    return "recording" if len(diagnosis.recordings) > 1 else "block"


def _verdict(diagnosis: Diagnosis) -> str:
    before, after = 1e3 * diagnosis.baseline.fit.rmse_um(), 1e3 * diagnosis.extended.fit.rmse_um()
    if diagnosis.verdict == "none":
        return (
            f"Nothing beyond noise: the model predicts these recordings to {before:.1f} nm, the rest looks like noise."
        )
    if diagnosis.verdict == "unexplained":
        named = ", ".join(" or ".join(item.names) for item in diagnosis.named)
        explains = "explains" if len(diagnosis.named) == 1 else "explain"
        if named and diagnosis.predicts_better:
            return (
                f"Part of the mismatch has no name: {named} {explains} {diagnosis.explained:.0%} of it "
                f"(error {before:.1f} to {after:.1f} nm), so even these are not certain."
            )
        if named:
            return (
                f"What is missing has no certain name: with {named} the error falls from {before:.1f} to "
                f"{after:.1f} nm, but that on {diagnosis.holdout_by} does not."
            )
        if not diagnosis.complete:
            return "Recording and prediction differ beyond noise; whether a named effect explains it is still open."
        if diagnosis.doubted:
            return (
                "Recording and prediction differ beyond noise in a way that the form of the process itself may make: "
                f"{listed(diagnosis.doubted)} would explain it no better."
            )
        return "Recording and prediction differ beyond noise in a way that no named effect explains."
    first = diagnosis.named[0]
    gain = f"the error falls from {before:.1f} to {after:.1f} nm"
    others = [item.effect.name for item in diagnosis.named[1:]]
    more = f", with {' and '.join(others)}" if others else ""
    if diagnosis.verdict == "identified":
        return f"The model lacks {first.effect.name}{more}: {first.effect.meaning}; {gain}."
    return f"The model lacks one of {', '.join(first.names)}{more}, which these data cannot tell apart; {gain}."


def statement(item: Named, intervals: Mapping[str, tuple[float, float]]) -> str:
    """Return a finding in a few sentences; the intervals are those of its model."""
    effect, sizes = item.effect, strengths(item.effect, intervals)
    said = []
    for name, size in sizes.items():
        meaning, unit = declarations(effect)[name][1].meaning, "" if size["unit"] == "1" else f" {size['unit']}"
        said.append(f"{meaning}: {size['value']:.3g}{unit} ({size['low']:.3g} to {size['high']:.3g})")
    text = f"{effect.meaning[0].upper()}{effect.meaning[1:]}; {'; '.join(said)}."
    if item.others:
        text += f" {', '.join(member.effect.name for member in item.others)} would fit as well, or nearly."
    return f"{text} {surely(item)}"


def surely(item: Named) -> str:
    """Return how sure a finding is: that it is there, what of its class it is, and on which side."""
    if len(item.members) == 1:
        return f"Probability that it is there: {chance(item.probability)}."
    each = ", ".join(f"{member.effect.name} {chance(member.probability)}" for member in item.members)
    text = f"Probability that one of them is there: {chance(item.probability)}; of these: {each}"
    if side_of(item.names) == "undecided":
        text += f"; of the print {chance(item.sides['print'])}, of the measurement {chance(item.sides['measurement'])}"
    return f"{text}."


def kind_of_remainder(diagnosis: Diagnosis) -> str:
    """Return what is left, by whatever of it holds most: none, smooth, ripple, spot or columns."""
    if not diagnosis.extended.unexplained:
        return "none"
    most = _strange(diagnosis.extended)[0]
    return "smooth" if isinstance(most, Energy) else most.kind


def _strange(model: Model) -> list[Energy | Pattern]:
    """Return what is more than noise of what a model leaves, that which holds most first."""
    strange = [one for one in (model.forms, *model.patterns) if one.p_value < SINGLE]
    return sorted(strange, key=lambda one: one.excess, reverse=True)


def remainder(diagnosis: Diagnosis) -> str:
    """Return what is left, in words."""
    spots = [(b.x_um, b.y_um, diagnosis.recordings[b.pair].name) for b in diagnosis.blemishes]
    said = "; ".join(f"x = {x:.1f}, y = {y:.1f} µm in {name}" for x, y, name in spots)
    parts = [_left(diagnosis)] if diagnosis.extended.unexplained or not diagnosis.doubted else []
    parts += [f"Left out of the fits as blemishes: {said}."] if said else []
    parts += [_doubt(diagnosis)] if diagnosis.doubted else []
    return " ".join(parts)


def _doubt(diagnosis: Diagnosis) -> str:
    named = f"of {diagnosis.named[0].effect.name}, or " if diagnosis.named else ""
    return (
        f"{listed(diagnosis.doubted)} would explain more than noise; so might the form {named}of the process itself: "
        "cross-linking that reaches farther than a Gaussian, layers that the base holds."
    )


def _left(diagnosis: Diagnosis) -> str:
    """Return everything that is left, what holds most first."""
    if not diagnosis.extended.unexplained:
        return "What is left looks like noise."
    return " ".join(_described(diagnosis, one) for one in _strange(diagnosis.extended))


def _described(diagnosis: Diagnosis, one: Energy | Pattern) -> str:
    return _smooth(diagnosis) if isinstance(one, Energy) else _pattern(diagnosis, one)


def _pattern(diagnosis: Diagnosis, pattern: Pattern) -> str:
    name = diagnosis.recordings[pattern.pair].name
    if isinstance(pattern, Ripple):
        return (
            f"A ripple of period {pattern.period_um:.1f} µm runs at {round(pattern.angle_deg)}° to x in {name}; "
            "no named effect makes one."
        )
    if isinstance(pattern, Columns):
        return (
            f"Lines along y differ by {1e3 * pattern.size_um:.1f} nm from one another in {name}: "
            "of the print, or of a scan along y: repeats tell."
        )
    return (
        f"A spot about {pattern.fwhm_um:.1f} µm wide sits at x = {pattern.x_um:.1f}, y = {pattern.y_um:.1f} µm in "
        f"{name}: look there; no named effect makes one."
    )


def _smooth(diagnosis: Diagnosis) -> str:
    share = f"What is named explains {diagnosis.explained:.0%} of the structure; " if diagnosis.named else ""
    return f"{share}{1e3 * diagnosis.extended.structure_um:.1f} nm of structure have no name."


def tests(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the tests that need no library of effects."""
    model, said = diagnosis.baseline, []
    wave, lone, columns = model.patterns

    def add(name: str, p_value: float, begin: str, more: str, less: str, level: float = SINGLE) -> None:
        text = f"{begin} {more if p_value < level else less}"
        said.append({"name": name, "p_value": p_value, "statement": text})

    forms = "free forms (height, radius, edges, slope, place) explain"
    part = "of the residual than of noise"
    add("structure beyond noise", model.forms.p_value, forms, f"more {part}", f"no more {part}")
    strongest = f"the strongest wave, period {wave.period_um:.1f} µm at {round(wave.angle_deg)}° to x, is"
    add("ripple", wave.p_value, strongest, "more than noise", "no more than noise")
    strongest = f"the strongest bump or dent, at x = {lone.x_um:.1f}, y = {lone.y_um:.1f} µm, is"
    add("spot", lone.p_value, strongest, "more than noise", "no more than noise")
    whole = "whole columns differ"
    add("lines along y", columns.p_value, whole, "from one another", "no more than noise does")
    told = [("", diagnosis.agreement), (" beside what was named", diagnosis.together if diagnosis.named else None)]
    for beside, test in told:
        if test:
            more, less = "other parameters: the model does not transfer", "the same parameters"
            begin, level = f"every {_each(diagnosis)} alone would give", policy.LEVEL_STRUCTURE
            add(f"one process for all {_each(diagnosis)}s{beside}", test.p_value, begin, more, less, level)
    if lying := registrations(diagnosis.extended.fit):
        worst, p_value = chance_of(lying)
        name, less = diagnosis.recordings[worst.pair].name, _lies_well(diagnosis.recordings)
        add("registration", p_value, name, f"{_lies(worst)}: align it anew, or see misregistration", less)
    return said


def _lies_well(recordings: Sequence[Recording]) -> str:
    """Return that a recording lies well, in words, and what of it alignments have made so."""
    taken = max(one.stretched for one in recordings)
    but = f" ({100 * taken:.1f} % of scale that was taken out may be the print's)" if taken else ""
    return f"lies where its alignment says, as far as that goes{but}"


def _lies(one: Registration) -> str:
    """Return how a recording lies, in words.

    >>> _lies(Registration(0, {"scale_x": -0.018, "shift_y": 0.05}, {"scale_x": 0.002, "shift_y": 1.0}))
    'is 1.80 % narrower along x than its alignment says, which leaves 0.20 % open'
    """
    name, value, left = one.farthest, one.moved[one.farthest], one.left_open[one.farthest]
    if name.startswith("scale"):
        wider, share, open_share = "wider" if value > 0 else "narrower", 100 * abs(value), 100 * left
        return (
            f"is {share:.2f} % {wider} along {name[-1]} than its alignment says, which leaves {open_share:.2f} % open"
        )
    if name.startswith("shift"):
        return f"lies {value:+.2f} µm along {name[-1]} from where its alignment says, which leaves {left:.2g} µm open"
    parameter, per_one = PARAMETERS[name]
    unit = declarations(library()["misregistration"])[parameter][1].unit
    what, gap = ("turned", "") if name == "rotation" else ("sheared", " ")
    by, open_by = (f"{per_one * size:.2g}{gap}{unit}" for size in (value, left))
    return f"is {what} by {by} against its alignment, which leaves {open_by} open"
