"""``dlwpredict diagnose``: what the model lacks, where it shows, and whether the data can know."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from dlwpredict.calibrate import Recording, prepare
from dlwpredict.calibrate.recordings import WALL_PX, coarser
from dlwpredict.calibrate.words import cautions_of
from dlwpredict.cli import options
from dlwpredict.cli.console import detail, progress_shown, say
from dlwpredict.cli.plotting import Plot, check_plot
from dlwpredict.cli.streams import tell as figures
from dlwpredict.diagnose.advise import advise
from dlwpredict.diagnose.content import content_of
from dlwpredict.diagnose.run import LEVEL, Diagnosis, diagnose
from dlwpredict.diagnose.sides import undecided
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters
from dlwpredict.files.provenance import origin, with_cautions
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.heightmap import HeightMap
from dlwpredict.parallel import Workers, cores_for_workers
from dlwpredict.parameters import ParameterSet

COMMAND = "diagnose"
CLASS = options.PairCommand
STREAMS = {"output": ".yaml"}
FIGURES = True

LARGEST_PX = 200
"""Maps are averaged over whole pixels until no side is longer than this: physics is wider than a camera's pixel."""


def run(
    pair: options.Pairs,
    output: options.Output,
    parameters: options.Parameters = None,
    params_out: Annotated[Path | None, typer.Option(help="Parameter file with the effects found.")] = None,
    maps: Annotated[Path | None, typer.Option(help="Folder for the maps of every pair.")] = None,
    report: Annotated[Path | None, typer.Option(help="The diagnosis as one HTML page.")] = None,
    plot: Plot = None,
    holdout: options.Holdouts = None,
    repeat: options.Repeats = None,
    advice: Annotated[
        bool, typer.Option("--advice/--no-advice", help="Simulate the recordings that would tell look-alikes apart.")
    ] = True,
    wall_px: Annotated[int, typer.Option(help="Points this near to walls do not count.", min=0)] = WALL_PX,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Say what physics the model lacks, where it shows, and how much better the prediction gets with it.

    $ dlwpredict diagnose --pair cin.tif cin_aligned.tif --pair air.tif air_aligned.tif -o diagnosis.yaml
    """
    options.check_outputs(output, params_out, report, plot, overwrite=overwrite)
    check_plot(plot)
    if maps and not maps.parent.is_dir():
        raise InputError("folder does not exist", where=maps, key="--maps", allowed=f"create {maps.parent} first")
    if maps and maps.exists() and not (maps.is_dir() and (overwrite or not any(maps.iterdir()))):
        raise InputError("exists already", where=maps, key="--maps", allowed="an empty or new folder, or --overwrite")
    pairs, kept = options.pairs_of(pair), options.pairs_of(holdout or [], "--holdout")
    repeats = options.pairs_of(repeat or [], "--repeat")
    start = read_parameters(parameters)
    recordings = [_prepared(*files, wall_px) for files in pairs]
    with _progress() as tell, Workers(jobs or cores_for_workers(), diagnose.__module__) as workers:
        found = diagnose(
            [recording for recording, _ in recordings],
            start,
            repeats=_repeats(pairs, recordings, repeats),
            holdout=[_prepared(*files, wall_px)[0] for files in kept],
            seed=seed,
            tell=tell,
            workers=workers,
        )
        content = content_of(found) | {"recordings": [str(recording) for _, recording in pairs]}
        if advice:
            tell("advice")
            _advised(found, content)
        process = extended(found, workers) if params_out else None
    content["provenance"] = origin()
    if maps:
        _write_maps(maps, found, [part for _, part in recordings])
    if report:
        _write_report(report, found, content, pairs)
    if plot:
        from dlwpredict import plots

        rows = [
            (str(one), found.recordings[k].target, *_pair_maps(found, k).values()) for k, (_, one) in enumerate(pairs)
        ]
        plots.save(plot, plots.diagnosis(rows, caption=content["sentence"]))
    if process:
        stated = with_cautions(cautions(found, content))
        write_parameters(params_out, replace(process, provenance=stated))
    write_text(output, yaml_text(content))
    figures(content)
    from dlwpredict.pages.terminal import lines

    for line in lines(content):
        say(line)


def extended(found: Diagnosis, workers: Workers) -> ParameterSet:
    """Return the process with the effects found; where a side is open, with the process on either."""
    fitted = found.extended.fit
    either = undecided(found.named, fitted, workers)
    return replace(fitted.parameters, undecided=either, intervals=found.null.intervals(fitted))


def cautions(found: Diagnosis, content: dict[str, Any]) -> list[str]:
    """Say what should be known wherever the extended process is used."""
    rest, said = content["remainder"], []
    if content["verdict"] == "unexplained":
        said.append("the diagnosis is 'unexplained': most of the mismatch has no name, and its effects stand in for it")
    elif rest["significant"]:
        said.append(f"the diagnosis left {rest['rms_um']:.3g} µm beyond noise that no named effect explains")
    return said + cautions_of(found.recordings)


def _prepared(target: Path, recording: Path, wall_px: int) -> tuple[Recording, HeightMap]:
    """Read and check a pair; return it on pixels that are coarse enough, and the target as it was read."""
    part, measured = read_height_map(target), read_height_map(recording)
    found = prepare(part, measured, name=str(recording), target_name=str(target), wall_px=wall_px)
    factor = -(-max(part.shape) // LARGEST_PX)
    detail(f"{recording}: {found.points} points count, {factor} × {factor} pixels make one")
    return coarser(found, factor), part


def _repeats(
    pairs: list[tuple[Path, Path]], recordings: list[tuple[Recording, HeightMap]], repeats: list[tuple[Path, Path]]
) -> list[list[HeightMap]]:
    """Return the repeats of every recording, on its pixels.

    Raises
    ------
    InputError
        A repeat names a recording that stands in no pair, or has another grid.
    """
    found: list[list[HeightMap]] = [[] for _ in pairs]
    known = {recording.resolve(): k for k, (_, recording) in enumerate(pairs)}
    for recording, again in repeats:
        if recording.resolve() not in known:
            raise InputError("stands in no --pair", where=recording, key="--repeat", allowed="a recording of a --pair")
        k = known[recording.resolve()]
        prepared, part = recordings[k]
        repeated = prepare(part, read_height_map(again), name=str(again), target_name=str(pairs[k][0]))
        found[k].append(coarser(repeated, _factor(prepared, part)).measured)
    return found


def _advised(found: Diagnosis, content: dict[str, Any]) -> None:
    """Add to every class the recording that would tell its members apart."""
    for item, finding in zip(found.named, content["findings"], strict=True):
        if len(item.names) > 1:
            members = [item.effect, *(other.effect for other in item.alternatives)]
            advice = advise(found.baseline.fit, members)
            finding["separate_by"] = advice.sentence if advice else None
            finding["separate_command"] = advice.command if advice else None


def _factor(recording: Recording, part: HeightMap) -> int:
    """Return how many pixels of the file make up one that was fitted."""
    return round(recording.target.dx_um / part.dx_um)


def _fine(values: np.ndarray, recording: Recording, part: HeightMap) -> HeightMap:
    """Return values on the pixels of the file."""
    square = np.ones((_factor(recording, part),) * 2)
    return part.with_heights(np.kron(values, square)[: part.shape[0], : part.shape[1]])


def _pair_maps(found: Diagnosis, k: int) -> dict[str, np.ndarray]:
    """Return the maps of a pair, µm and shares, NaN where nothing counts, shape (rows, cols)."""
    used = found.recordings[k].used
    residual, remainder = found.baseline.fit.residual_um(k), found.extended.fit.residual_um(k)
    return {
        "residual": residual,
        "mismatch": np.where(used, found.mismatch[k], np.nan),
        "explained": residual - remainder,
        "remainder": remainder,
    }


def _write_maps(folder: Path, found: Diagnosis, parts: list[HeightMap]) -> None:
    """Write the maps of all pairs on the pixels of their files, all of them or none."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}") as temporary:
        for k, part in enumerate(parts):
            for name, values in _pair_maps(found, k).items():
                write_height_map(Path(temporary) / f"{name}_{k}.tif", _fine(values, found.recordings[k], part))
        folder.mkdir(exist_ok=True)
        for file in sorted(Path(temporary).iterdir()):
            shutil.move(file, folder / file.name)


def _write_report(path: Path, found: Diagnosis, content: dict[str, Any], pairs: list[tuple[Path, Path]]) -> None:
    from dlwpredict.pages.diagnosis import PairMaps, write_page

    pictures = []
    for k, (_, recording) in enumerate(pairs):
        item, shown = found.recordings[k], _pair_maps(found, k)
        measured = item.measured.with_heights(np.where(item.used, item.measured.heights_um, np.nan))
        pictures.append(
            PairMaps(
                str(recording),
                item.target,
                measured,
                found.baseline.fit.predicted_um(k),
                found.extended.fit.predicted_um(k),
                shown["residual"],
                shown["explained"],
                shown["remainder"],
                found.mismatch[k],
            )
        )
    write_page(path, content, pictures, command=content["provenance"]["command"], evidence=_evidence(found))


def _evidence(found: Diagnosis) -> list:
    """Return the best score of every switch of every effect, the strongest first."""
    from dlwpredict.pages.diagnosis import Evidence

    scores, best = found.screen, {}
    for k in np.argsort(-np.abs(scores.z)):
        candidate = found.library.chosen[k]
        name = f"{candidate.name}.{candidate.switch}"
        if name not in best:
            strength = candidate.off + scores.amplitude[k] * candidate.unit
            unit = "" if candidate.declaration.unit == "1" else f" {candidate.declaration.unit}"
            best[name] = Evidence(
                name,
                float(scores.z[k]),
                scores.threshold(LEVEL),
                f"{strength:.3g}{unit}",
                float(scores.visible[k]),
            )
    return list(best.values())


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Say what goes on: on a terminal in one line that goes away, with ``--verbose`` line by line."""
    if not progress_shown():
        yield detail
        return
    from rich.console import Console

    with Console(stderr=True).status("diagnosing") as status:
        yield lambda text: (status.update(text), detail(text))
