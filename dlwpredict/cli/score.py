"""``dlwpredict score``: how alike two surfaces are."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from dlwpredict.cli import options
from dlwpredict.cli.console import say, warn
from dlwpredict.cli.plotting import check_plot, draw
from dlwpredict.errors import ResultError, blaming
from dlwpredict.files import read_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.heightmap import require_same_grid
from dlwpredict.metrology.score import MATERIAL_RATIO_RANGE, Score, score
from dlwpredict.metrology.transfer import HALF, Transfer, transfer
from dlwpredict.metrology.walls import WALL_PX

COMMAND = "score"
STREAMS = {"json_file": ".json"}

AWAY = "rmse_um", "rmse_offset_free_um", "mean_difference_um", "cc", "alpha_z", "l_z_um", "valid_fraction", "points"
"""Figures that are also given away from walls."""


def run(
    reference: Annotated[Path, typer.Argument(help="Height map to compare with.", show_default=False)],
    test: Annotated[Path, typer.Argument(help="Height map to judge, on the same grid.", show_default=False)],
    json_file: Annotated[
        Path | None, typer.Option("--json", "-o", "--output", help="Write all figures as JSON.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="Draw maps, difference and profiles (.png, .pdf, .svg).", show_default=False),
    ] = None,
    material_ratio: Annotated[
        tuple[float, float], typer.Option(help="Material ratios between which alpha_z and l_z are taken.")
    ] = MATERIAL_RATIO_RANGE,
    part_only: Annotated[
        bool, typer.Option("--part-only", help="Leave out bare substrate: points where the reference is 0 or less.")
    ] = False,
    include_filled: Annotated[
        bool, typer.Option("--include-filled", help="Let filled (interpolated) points enter as well.")
    ] = False,
    wall_px: Annotated[
        int,
        typer.Option(min=0, help="'Away from walls': this far from the reference's walls and the map's rim; 0: none."),
    ] = WALL_PX,
    transfer_function: Annotated[
        bool, typer.Option("--transfer", help="Amplitude transfer against period; the reference is a cin target.")
    ] = False,
    transfer_plot: Annotated[
        Path | None, typer.Option(help="Draw the transfer (.png, .pdf, .svg).", show_default=False)
    ] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Compare a height map with its reference: deviations, correlation, roughness, height response.

    Points that are not measured, or were filled, in either map are left out. The main figures are said once more for
    what lies away from walls: a wall a pixel out of place, or a map cut out of a larger part, outweighs all else.

    $ dlwpredict score target.tif aligned.tif --part-only --json score.json --plot score.png
    """
    options.check_outputs(json_file, plot, transfer_plot, overwrite=overwrite)
    check_plot(plot)
    check_plot(transfer_plot, "--transfer-plot")
    maps = read_height_map(reference), read_height_map(test)
    require_same_grid(*maps, names=(str(reference), str(test)))
    with blaming(test):
        compared = partial(
            score, material_ratio_range=material_ratio, part_only=part_only, include_filled=include_filled
        )
        result, away = compared(*maps), None
        if wall_px:
            with suppress(ResultError):  # where no point lies away from walls
                away = compared(*maps, wall_px=wall_px)
    figures: dict[str, Any] = asdict(result)
    if wall_px:
        figures["away_from_walls"] = {"wall_px": wall_px} | {key: asdict(away)[key] if away else None for key in AWAY}
    transfers: dict[str, Transfer] = {}
    if transfer_function or transfer_plot:
        with blaming(reference):
            transfers = transfer(*maps, include_filled=include_filled)
        figures["transfer"] = {axis: asdict(curve) for axis, curve in transfers.items()}
    title, names = f"{test.stem} against {reference.stem}", (reference.stem, test.stem)
    draw(transfer_plot, lambda plots: plots.transfer_curves(transfers, title=title))
    draw(plot, lambda plots: plots.comparison(*maps, names=names, caption=caption(result, away)))
    if json_file is not None:
        write_text(json_file, json.dumps(figures, indent=2, allow_nan=False) + "\n")
    say(table(result))
    if wall_px:
        say(away_note(away, wall_px))
    if transfers:
        say("\n" + transfer_table(transfers))
    if result.height_reference == "relative":
        warn(f"{test}: heights are relative (no substrate in view); mean_difference_um and rmse_um hold a free offset")


def away_note(away: Score | None, wall_px: int) -> str:
    """Return the main figures away from walls in one line."""
    if away is None:
        return f"away from walls: no point lies {wall_px} px from them"
    rmse = f"rmse {µm(away.rmse_um)}, offset-free {µm(away.rmse_offset_free_um)}"
    return f"away from walls and rim ({wall_px} px): {rmse}, CC {plain(away.cc)}, alpha_z {plain(away.alpha_z)}"


def table(result: Score) -> str:
    """Return all figures as aligned lines."""
    low, high = result.material_ratio_range
    rows = [
        ("rmse", µm(result.rmse_um), f"offset-free {µm(result.rmse_offset_free_um)}"),
        ("mean difference", µm(result.mean_difference_um), "test - reference"),
        ("CC", plain(result.cc), "corr2"),
        ("Sa, Sq, Sz of test", ", ".join(map(µm, (result.sa_um, result.sq_um, result.sz_um))), ""),
        (f"alpha_z, l_z {low:g}-{high:g}", f"{plain(result.alpha_z)}, {µm(result.l_z_um)}", "material ratio"),
        ("alpha_z, l_z 0-1", f"{plain(result.alpha_z_full)}, {µm(result.l_z_full_um)}", "full range"),
        ("points", str(result.points), points_note(result)),
    ]
    first, second = (max(len(row[i]) for row in rows) for i in (0, 1))
    return "\n".join(f"{name:<{first}}  {value:<{second}}  {note}".rstrip() for name, value, note in rows)


def transfer_table(transfers: dict[str, Transfer]) -> str:
    """Return transfer against period along both axes, and the period at 50 %, as aligned lines."""
    lines = ["transfer  period/µm      T  ± (half the difference of opposite sides)"]
    for axis, curve in transfers.items():
        rows = zip(curve.period_um, curve.transfer, curve.half_difference, strict=True)
        lines += [f"  along {axis}  {period:8.3f}  {value:.3f}  {spread:.3f}" for period, value, spread in rows]
    return "\n".join([*lines, *(f"50 % along {axis}: {half_note(curve)}" for axis, curve in transfers.items())])


def half_note(curve: Transfer) -> str:
    """Say the period at which half of the amplitude is left, or on which side of the periods it lies."""
    if curve.half_period_um is not None:
        return f"{curve.half_period_um:.3f} µm"
    if curve.transfer[-1] < HALF:
        return f"above {curve.period_um[-1]:.3f} µm, the longest period"
    return f"below {curve.period_um[0]:.3f} µm, the shortest period"


def points_note(result: Score) -> str:
    """Say which points entered."""
    note = f"{100 * result.valid_fraction:.4g} % of the {result.region}"
    if result.filled_points:
        note += f"; {result.filled_points} filled points {'entered' if result.filled_points_entered else 'left out'}"
    if 0 < result.substrate_fraction < 1:
        note += f"; {100 * result.substrate_fraction:.3g} % bare substrate, which governs Sa to l_z (see --part-only)"
    return note


def caption(result: Score, away: Score | None) -> str:
    """Return the main figures, a line for all points and one for those away from walls."""
    if away is None or away.points == result.points:
        lines = {"": result}
    else:
        lines = {"away from walls": away, f"whole {result.region}": result}
    return "\n".join(f"{name}     {_figures(scored)}".strip() for name, scored in lines.items())


def _figures(result: Score) -> str:
    rmse = f"rmse {µm(result.rmse_um)} (offset-free {µm(result.rmse_offset_free_um)})"
    return f"{rmse}     CC {plain(result.cc)}     α$_z$ {plain(result.alpha_z)}     l$_z$ {µm(result.l_z_um)}"


def µm(value: float | None) -> str:
    """Write a length in µm to a tenth of a nanometre."""
    return "undefined" if value is None else f"{value:.4f} µm"


def plain(value: float | None) -> str:
    """Write a number without unit."""
    return "undefined" if value is None else f"{value:.4f}"
