"""An effect that calibration absorbs whole: invisible in the error, shown by a second structure, confirmed on a third.

Lines written just before raise the dose of the next ones, so the print grows along the hatch. On a ramp that rises the
same way, "written later" and "taller" are the same thing, and the seven parameters take all of it.
"""

from __future__ import annotations

from tests.stories import pictures
from tests.stories.bench import PROCESS, SIZE_UM, Bench
from tests.stories.story import Claim, Told, besides, nm, verdict

TITLE = "An effect wholly absorbed by calibration"
MEMORY = {"name": "dose-memory", "gain": 0.12, "length_um": 6.0, "model": "time"}
CONVERSION = 0.0
PARTS = {
    "ramp": ("blaze", {"period_um": SIZE_UM, "base_um": 3.0, "height_um": 4.0}),
    "waves": ("cin", {"base_um": 5.0, "height_um": 1.5, "period_min_um": 3.5, "period_max_um": 10.0}),
    "rough": ("air", {"base_um": 5.0, "height_um": 2.0, "correlation_um": 4.0, "seed": 11}),
}
"""The structure that hides it, the one that shows it, and the one that is held out."""

TRIED = """Told first with a resin whose conversion follows the dose (η above 0). Then the memory showed faintly on the
ramp alone, and `diagnose` gave it a wrong name there, `field-curvature`: one structure is too little to name by."""


SAME = 1.05
"""The errors of two calibrations are the same where one is no more than this many times the other."""


def tell(bench: Bench) -> Told:
    """Run the story."""
    presses = {
        "with": bench.settings("press.yaml", effects=[MEMORY], conversion=CONVERSION),
        "without": bench.settings("press_without.yaml"),
    }
    pairs, raw = {}, {}
    for seed, (part, (kind, options)) in enumerate(PARTS.items(), start=1):
        target = bench.design(kind, part, **options)
        for which, press in presses.items():
            if which == "without" and part != "ramp":
                continue
            name = part if which == "with" else f"{part}_without"
            printed = bench.printed(target, press, name)
            pairs[name] = target, bench.recorded(printed, f"{name}_recording", seed=seed)
            raw[name] = bench.surface(printed, f"{name}_surface")
    change = bench.off(raw["ramp_without"], raw["ramp"], part="ramp.tif")
    fits = {name: bench.calibrated(f"process_{name}", [pairs[name]]) for name in ("ramp", "ramp_without")}
    alone = bench.diagnosed("alone", [pairs["ramp"]], "--no-advice", "--maps", "alone_maps")
    two = bench.diagnosed("two", [pairs["ramp"], pairs["waves"]], "--no-advice", holdout=[pairs["rough"]])
    bench.calibrated("process_two", [pairs["ramp"], pairs["waves"]])
    processes = {"ramp alone": "process_ramp", "ramp and waves": "process_two", "with what was found": "two_extended"}
    errors = {}
    for words, process in processes.items():
        shown = {part: bench.predicted(f"{part}.tif", f"{process}.yaml", f"{part}_{process}") for part in PARTS}
        errors[words] = {part: bench.off(pairs[part][1], one, part=f"{part}.tif") for part, one in shown.items()}
    draw(bench, errors, alone["noise_um"])
    return told(fits, change, alone, two, errors)


def told(fits: dict, change: float, alone: dict, two: dict, errors: dict) -> Told:
    """Put the story into words."""
    left = {name: fit["rmse_um"]["after"] for name, fit in fits.items()}
    named = [name for one in two["findings"] for name in one["effects"]]
    ramp, pair, extended = errors.values()
    driven = "\n".join(
        f"| `{key}` | {found['value']:.3g} | {fits['ramp_without']['parameters'][key]['value']:.3g} | {true:.3g} |"
        for (key, found), true in zip(fits["ramp"]["parameters"].items(), PROCESS.values(), strict=True)
    )
    text = f"""
A ramp rises along the hatch. What is concealed changes its print by {nm(change)} (rms); the noise is
{nm(alone["noise_um"])}. After calibration the error is {nm(left["ramp"])}; the same ramp from a press without the
effect gives {nm(left["ramp_without"])}. `diagnose`, given this ramp alone, says: *{verdict(alone)}*. The change went
into the parameters, where nobody can tell it from the process:

| parameter | with the effect | without | of the press |
|---|---|---|---|
{driven}

A second structure, waves on a plate, is {nm(ramp["waves"])} off what they predict. Calibrated on both, the
seven parameters leave {nm(pair["ramp"])} and {nm(pair["waves"])}. `diagnose` on both says: *{verdict(two)}*; with
that the errors are {nm(extended["ramp"])} and {nm(extended["waves"])}.{besides(two, MEMORY["name"])}

A third structure, a roughness map, was in no fit and no choice. The seven parameters miss it by {nm(pair["rough"])},
the process with what was found by {nm(extended["rough"])}.

{TRIED}
"""
    claims = (
        Claim(f"changed by more than 3 times the noise, yet the calibrated error is at most {SAME:g} × that without",
              f"{nm(change)} change; {nm(left['ramp'])} with, {nm(left['ramp_without'])} without",
              change > 3 * alone["noise_um"] and left["ramp"] < SAME * left["ramp_without"]),
        Claim("on the one structure nothing is found, since nothing shows", verdict(alone), alone["verdict"] == "none"),
        Claim("a second structure reveals it by name", verdict(two), MEMORY["name"] in named),
        Claim("the third, held out, confirms it: its error falls by more than 30 %",
              f"{nm(pair['rough'])} to {nm(extended['rough'])}", extended["rough"] < 0.7 * pair["rough"]),
    )  # fmt: skip
    figures = {
        "change_um": change, "calibrated_rmse_um": left, "noise_um": alone["noise_um"], "alone": verdict(alone),
        "two": verdict(two), "rmse_um": errors,
        "parameters": {
            name: {key: one["value"] for key, one in fit["parameters"].items()} for name, fit in fits.items()
        },
    }  # fmt: skip
    shown = {
        "errors.png": "Errors of the structures: ramp fitted alone, ramp and waves fitted, and with what was found. "
        "The rough plate is never fitted. Without the small lateral shift that a fit allows each recording.",
        "hidden.png": "The ramp: recording, what the concealed effect changes, and what calibration leaves of it.",
        "left.png": "Held out: what seven parameters (of ramp and waves) and the process with what was found leave.",
    }
    concealed = f"`dose-memory` (lines in time, gain {MEMORY['gain']:g}, {MEMORY['length_um']:g} µm; η {CONVERSION:g})"
    return Told(TITLE, concealed, text, claims, shown, figures)


def draw(bench: Bench, errors: dict, noise_um: float) -> None:
    """Draw the pictures."""
    series = {words: list(values.values()) for words, values in errors.items()}
    groups = ["ramp", "waves", "rough: held out"]
    pictures.bars(bench.folder / "errors.png", groups, series, noise_um=noise_um)
    seen, surface, without = (bench.map(f"ramp{end}.tif") for end in ("_recording", "_surface", "_without_surface"))
    change = pictures.error(without, surface)
    left = bench.map("alone_maps/residual_0.tif")
    pictures.maps(
        bench.folder / "hidden.png",
        {"recording": seen},
        {"changed by the effect": change, "left by calibration": left},
    )
    rough = bench.map("rough_recording.tif")
    kept = {
        words: pictures.error(bench.map(f"rough_{process}.tif"), rough)
        for words, process in (("seven parameters", "process_two"), ("with what was found", "two_extended"))
    }
    pictures.maps(bench.folder / "left.png", {"recording": rough}, kept)
