"""A diagnosis in the words of the bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dlwpredict.diagnose.competitor import LEVEL, SINGLE
from dlwpredict.diagnose.naming import Named, strengths
from dlwpredict.diagnose.run import Diagnosis
from dlwpredict.effects import library
from dlwpredict.parameters import declarations


def side_of(names: Sequence[str]) -> str:
    """Return the side of a class: print, measurement, or undecided where it has members on both."""
    sides = {library()[name].side for name in names}
    return sides.pop() if len(sides) == 1 else "undecided"


def sentence(found: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    before, after = 1e3 * found.baseline.fit.rmse_um(), 1e3 * found.extended.fit.rmse_um()
    if found.verdict == "none":
        return (
            f"Nothing beyond noise: the model predicts these recordings to {before:.1f} nm, the rest looks like noise."
        )
    if found.verdict == "unexplained":
        named = ", ".join(" or ".join(item.names) for item in found.named)
        if not named:
            return "Recording and prediction differ beyond noise in a way that no named effect explains."
        return (
            f"Part of the mismatch has no name: {named} explain {found.explained:.0%} of it "
            f"(error {before:.1f} to {after:.1f} nm), so even these are not certain."
        )
    first = found.named[0]
    gain = f"the error falls from {before:.1f} to {after:.1f} nm"
    others = [item.effect.name for item in found.named[1:]]
    more = f", with {' and '.join(others)}" if others else ""
    if found.verdict == "identified":
        return f"The model lacks {first.effect.name}{more}: {first.effect.meaning}; {gain}."
    return f"The model lacks one of {', '.join(first.names)}{more}, which these data cannot tell apart; {gain}."


def statement(item: Named, intervals: Mapping[str, tuple[float, float]]) -> str:
    """Return a finding in one or two sentences; the intervals are those of its model."""
    effect, sizes = item.effect, strengths(item.effect, intervals)
    said = []
    for name, size in sizes.items():
        meaning, unit = declarations(effect)[name][1].meaning, "" if size["unit"] == "1" else f" {size['unit']}"
        said.append(f"{meaning}: {size['value']:.3g}{unit} ({size['low']:.3g} to {size['high']:.3g})")
    text = f"{effect.meaning[0].upper()}{effect.meaning[1:]}; {'; '.join(said)}."
    if item.alternatives:
        others = [name for name in item.names if name != effect.name]
        text += f" {', '.join(others)} would fit as well, or nearly."
    return text


def remainder(found: Diagnosis) -> str:
    """Return what is left, in words."""
    if not found.extended.unexplained:
        return "What is left looks like noise."
    wave, lone, columns = found.extended.patterns
    strangest = min(found.extended.patterns, key=lambda one: (one.p_value, -one.excess))
    if strangest.p_value < SINGLE:
        name = found.recordings[strangest.pair].name
        if strangest is wave:
            return (
                f"A ripple of period {wave.period_um:.1f} µm runs at {round(wave.angle_deg)}° to x in {name}; "
                "no named effect makes one."
            )
        if strangest is lone:
            return (
                f"A spot about {lone.fwhm_um:.1f} µm wide sits at x = {lone.x_um:.1f}, y = {lone.y_um:.1f} µm in "
                f"{name}: look there; no named effect makes one."
            )
        return (
            f"Lines along y differ by {1e3 * columns.size_um:.1f} nm from one another in {name}: of the print, or of a "
            "scan along y: repeats tell."
        )
    share = f"The named effects explain {found.explained:.0%} of the structure; " if found.named else ""
    return f"{share}{1e3 * found.extended.structure_um:.1f} nm of structure have no name."


def tests(found: Diagnosis) -> list[dict[str, Any]]:
    """Return the tests that need no library of effects."""
    p_value = found.baseline.rest.p_value
    more = "more of the residual than of noise" if p_value < LEVEL else "no more of the residual than of noise"
    said = [
        {
            "name": "structure beyond noise",
            "p_value": p_value,
            "statement": f"free forms (height, radius, edges, slope, place) explain {more}",
        }
    ]
    wave = found.baseline.ripple
    strongest = f"the strongest wave, period {wave.period_um:.1f} µm at {round(wave.angle_deg)}° to x, is"
    kind = "more than noise" if wave.p_value < LEVEL else "no more than noise"
    said.append({"name": "ripple", "p_value": wave.p_value, "statement": f"{strongest} {kind}"})
    lone = found.baseline.spot
    strongest = f"the strongest bump or dent, at x = {lone.x_um:.1f}, y = {lone.y_um:.1f} µm, is"
    kind = "more than noise" if lone.p_value < LEVEL else "no more than noise"
    said.append({"name": "spot", "p_value": lone.p_value, "statement": f"{strongest} {kind}"})
    columns = found.baseline.columns
    differ = "differ from one another" if columns.p_value < LEVEL else "differ no more than noise does"
    said.append({"name": "lines along y", "p_value": columns.p_value, "statement": f"whole columns {differ}"})
    if found.agreement:
        p_value = found.agreement.p_value
        other = "other parameters: the model does not transfer" if p_value < LEVEL else "the same parameters"
        text = f"every recording alone would give {other}"
        said.append({"name": "one process for all recordings", "p_value": p_value, "statement": text})
    return said
