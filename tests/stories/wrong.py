"""The same gain from a wrong effect: equal on the recording fitted, rejected by one that was held out.

A part curls: its rim comes up in proportion to the footprint. A bent focal surface of the writer lifts the rim as well,
in proportion to the place in the field. On one footprint both are the same paraboloid; on a smaller one they are not.
"""

from __future__ import annotations

from tests.stories import pictures
from tests.stories.bench import PITCH_UM, SIZE_UM, Bench
from tests.stories.story import Claim, Told, besides, first_class, nm, verdict

TITLE = "The same gain from a wrong effect"
RISE_UM = 0.12
NARROW_UM = 0.5 * SIZE_UM
RIVALS = {"curl": "rise_um", "print-field-curvature": "sag_um"}
"""The effect that is there, and one that is not; what is fitted of each."""

EQUAL = 0.02
"""Two errors are the same where they differ by less than this share."""


def tell(bench: Bench) -> Told:
    """Run the story."""
    roughness = {"base_um": 5.0, "height_um": 2.0, "correlation_um": 4.0}
    bench.design("air", "wide", seed=3, **roughness)
    narrow = PITCH_UM * round(NARROW_UM / PITCH_UM)
    bench.design("air", "narrow", size_um=narrow, seed=5, **roughness)
    press = bench.settings("press.yaml", effects=[{"name": "curl", "rise_um": RISE_UM}])
    pairs = {}
    for seed, name in enumerate(("wide", "narrow"), start=1):
        printed = bench.printed(f"{name}.tif", press, name)
        pairs[name] = f"{name}.tif", bench.recorded(printed, f"{name}_recording", seed=seed)

    bench.calibrated("seven", [pairs["wide"]])
    processes = {"seven": bench.yaml("seven.yaml")}
    for name, switch in RIVALS.items():
        start = {key: value for key, value in processes["seven"].items() if key not in ("intervals", "provenance")}
        bench.write(f"{name}_start.yaml", {**start, "effects": [{"name": name, switch: 0.0}]})
        seven = [key for key in start if isinstance(start[key], float)]
        free = [word for key in (*seven, f"{name}.{switch}") for word in ("--free", key)]
        bench.calibrated(name, [pairs["wide"]], "-p", f"{name}_start.yaml", *free)
        processes[name] = bench.yaml(f"{name}.yaml")

    errors = {name: {} for name in processes}
    for name in processes:
        for part, (target, recording) in pairs.items():
            shown = bench.predicted(target, f"{name}.yaml", f"{part}_{name}")
            errors[name][part] = bench.off(recording, shown, part=target)
    one = bench.diagnosed("one", [pairs["wide"]], holdout=[pairs["narrow"]])
    both = bench.diagnosed("both", [*pairs.values()], "--no-advice")
    return told(bench, errors, {name: strength(processes[name], name) for name in RIVALS}, one, both)


def strength(process: dict, name: str) -> float:
    """Return what calibration made of an effect."""
    return next(entry[RIVALS[name]] for entry in process["effects"] if entry["name"] == name)


def told(bench: Bench, errors: dict, sizes: dict[str, float], one: dict, both: dict) -> Told:
    """Put the story into words."""
    right, wrong = RIVALS
    noise = one["noise_um"]
    seven, with_right, with_wrong = (errors[name] for name in ("seven", right, wrong))
    apart = abs(with_wrong["wide"] - with_right["wide"]) / with_right["wide"]
    draw(bench, errors, noise)
    text = f"""
One plate of {SIZE_UM:.1f} µm is printed and recorded. The seven parameters leave {nm(seven["wide"])} where the noise is
{nm(noise)}. Adding `{right}` (rim up by {sizes[right]:.3f} µm; printed with {RISE_UM:g} µm) brings the error to
{nm(with_right["wide"])}; adding `{wrong}` instead (sag of {sizes[wrong]:.2f} µm at 50 µm; there is none) brings it to
{nm(with_wrong["wide"])}. The gain cannot say which one is true. `diagnose` says:
*{verdict(one)}*.

A second plate of half the width, from the same press, was in no fit. There the two predict different rims:
{nm(with_right["narrow"])} off with `{right}`, {nm(with_wrong["narrow"])} with `{wrong}`, {nm(seven["narrow"])} with the
seven parameters alone. Given both recordings, `diagnose` says: *{verdict(both)}*.{besides(both, right)}
"""
    claims = (
        Claim(f"both effects bring the same gain (errors within {EQUAL:.0%})",
              f"{nm(with_right['wide'])} and {nm(with_wrong['wide'])}, {apart:.1%} apart",
              apart < EQUAL and max(with_right["wide"], with_wrong["wide"]) < 0.9 * seven["wide"]),
        Claim("on the one recording the wrong effect stays in the class with the right one", verdict(one),
              {right, wrong} <= set(first_class(one))),
        Claim("held out: the right effect lowers the error, the wrong one is more than 10 % worse than the right one",
              f"{nm(seven['narrow'])} without, {nm(with_right['narrow'])} right, {nm(with_wrong['narrow'])} wrong",
              with_right["narrow"] < seven["narrow"] and with_wrong["narrow"] > 1.1 * with_right["narrow"]),
        Claim("with both recordings only the right one is left", verdict(both), first_class(both) == [right]),
    )  # fmt: skip
    shown = {
        "errors.png": "Error of the recording fitted (wide) and of the one held out (narrow).",
        "wide.png": "What is left on the plate that was fitted: the seven parameters alone, and with each effect.",
        "narrow.png": "The same on the plate that was held out.",
    }
    figures = {"rmse_um": errors, "noise_um": noise, "strengths": sizes, "one": verdict(one), "both": verdict(both),
               "printed_rise_um": RISE_UM}  # fmt: skip
    return Told(TITLE, f"`curl`, the rim up by {RISE_UM:g} µm", text, claims, shown, figures)


def draw(bench: Bench, errors: dict, noise_um: float) -> None:
    """Draw the pictures."""
    series = {name: list(errors[name].values()) for name in errors}
    pictures.bars(bench.folder / "errors.png", ["wide: fitted", "narrow: held out"], series, noise_um=noise_um)
    for part in ("wide", "narrow"):
        seen = bench.map(f"{part}_recording.tif")
        left = {name: pictures.error(bench.map(f"{part}_{name}.tif"), seen) for name in errors}
        pictures.maps(bench.folder / f"{part}.png", {}, left)
