"""The library behind the commands: the same verbs, on height maps in memory.

``import dlwpredict as dlw`` gives ``dlw.read``, ``dlw.predict`` ..., the names of ``dlwpredict.__all__``, and imports
what they need when the first of them is used. Lengths are µm; maps have shape (rows, cols) and travel with their grid.

Examples
--------
>>> import dlwpredict as dlw
>>> target = dlw.design("lens", size_um=12, pitch_um=0.5, margin_um=4)
>>> process = dlw.ParameterSet()
>>> printed = dlw.predict(target, process)
>>> better = dlw.precompensate(target, process)
>>> errors = [dlw.score(target, one, part_only=True).rmse_um for one in (printed, better.predicted)]
>>> bool(errors[1] < errors[0] / 2)
True
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlwpredict import process
from dlwpredict.alignment import Alignment, align  # noqa: F401
from dlwpredict.calibration import Calibration
from dlwpredict.calibration import calibrate as fit
from dlwpredict.correction.precompensate import Limits, Precompensation, correct
from dlwpredict.designs import KINDS
from dlwpredict.diagnosis.answer.content import content_of
from dlwpredict.diagnosis.answer.sides import extended
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.run import Course
from dlwpredict.diagnosis.run import diagnose as search
from dlwpredict.errors import InputError, ResultError  # noqa: F401 (part of the interface)
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters  # noqa: F401
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose
from dlwpredict.infer.pixels import working_factor
from dlwpredict.infer.recording import Recording, coarser
from dlwpredict.metrology.score import score  # noqa: F401
from dlwpredict.metrology.walls import WALL_PX
from dlwpredict.numerics.parallel import Workers
from dlwpredict.pairing import checked
from dlwpredict.parameters import ParameterSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Pair = tuple[HeightMap, "HeightMap | Alignment"]
"""A target and its recording on the target's grid."""


def read(path: str | PathLike[str], **settings: Any) -> HeightMap:
    """Read a height map; the ending of the file decides the format.

    Parameters
    ----------
    path : str or path
    **settings
        For files that do not say it: ``pitch_um``, ``z_scale`` (µm per stored number), ``z_range_um``, ``channel``.

    Raises
    ------
    InputError
        The file is missing, unreadable, or does not say its pitch.
    """
    return read_height_map(Path(path), **settings)


def write(path: str | PathLike[str], height_map: HeightMap) -> list[str]:
    """Write a height map, whole or not at all; return remarks on what the format could not keep."""
    return write_height_map(Path(path), height_map)


def design(kind: str, **settings: Any) -> HeightMap:
    """Make a target by formula.

    Parameters
    ----------
    kind : str
        air, blaze, cin, f, fresnel, grating, lens, lens-array, pads, posts or stairs.
    **settings
        What ``dlwpredict design KIND --help`` lists, in µm: ``size_um``, ``pitch_um``, ``margin_um`` ...

    Raises
    ------
    InputError
        Unknown kind, or a setting out of range.
    """
    if kind not in KINDS:
        raise InputError(f"found {kind}", key="kind", allowed=f"allowed: {', '.join(sorted(KINDS))}")
    return KINDS[kind](**settings)


def predict(target: HeightMap, parameters: ParameterSet | None = None, *, as_measured: bool = False) -> HeightMap:
    """Predict the print of a target, on the target's grid.

    Parameters
    ----------
    target : HeightMap
        Heights to be written, 0 and above; 0 is bare substrate.
    parameters : ParameterSet, optional
        Default: the paper's.
    as_measured : bool
        Add the effects of the instrument.
    """
    return process.predict(target, parameters or ParameterSet(), as_measured=as_measured)


def calibrate(
    pairs: Sequence[Pair],
    start: ParameterSet | None = None,
    *,
    fix: Sequence[str] = (),
    wall_px: int = WALL_PX,
    seed: int = 0,
) -> Calibration:
    """Fit one process to recordings.

    Parameters
    ----------
    pairs : sequence of (target, recording)
        The recording on the target's grid: a `HeightMap`, or what `align` has returned.
    start : ParameterSet, optional
        Where the fit begins. Default: the paper's.
    fix : sequence of str
        Parameters that are not fitted.
    wall_px : int
        Points so near to a wall do not count.
    seed : int

    Returns
    -------
    Calibration
        ``parameters`` with 95 % intervals, ``warnings``.
    """
    start = start or ParameterSet()
    return fit(_recordings(pairs, start, wall_px), choose(start, fix=fix), seed=seed)


def precompensate(
    target: HeightMap,
    parameters: ParameterSet | None = None,
    *,
    maximum_um: float | None = None,
    continued: bool = False,
    most_predictions: int = 10,
) -> Precompensation:
    """Find what to write so that the print has the target's heights.

    Parameters
    ----------
    target : HeightMap
    parameters : ParameterSet, optional
        Default: the paper's. Effects of the instrument are not corrected.
    maximum_um : float, optional
        Highest height that may be written. Default: twice the target's.
    continued : bool
        The part goes on beyond its map, instead of ending there.
    most_predictions : int

    Returns
    -------
    Precompensation
        ``corrected``, what to write; ``predicted``, its print; ``reachable``, where the print answers.

    Raises
    ------
    InputError
        The side of an effect is open: say ``parameters.decided("print")`` or ``"measurement"``.
    """
    known = parameters or ParameterSet()
    if known.undecided:
        named = ", ".join(known.undecided.effects)
        allowed = 'allowed: parameters.decided("print") or ("measurement")'
        raise InputError(f"print or measurement is open for {named}", key="undecided", allowed=allowed)
    limits = Limits.about(target, maximum_um, slicing_um=known.writing.slicing_um)
    return correct(target, known, limits, continued=continued, most_predictions=most_predictions)


@dataclass(frozen=True, eq=False)
class Answer:
    """What `diagnose` has found.

    Parameters
    ----------
    content : dict
        What the command writes into ``diagnosis.yaml``.
    parameters : ParameterSet
        The process with the effects found, for `predict` and `precompensate`.
    diagnosis : Diagnosis
        All of it: fits, noise, maps of the mismatch.
    """

    content: Mapping[str, Any]
    parameters: ParameterSet
    diagnosis: Diagnosis

    @property
    def verdict(self) -> str:
        """Identified, ambiguous, unexplained or none."""
        return str(self.content["verdict"])

    @property
    def findings(self) -> list[dict[str, Any]]:
        """One entry for each effect or class of look-alikes: names, side, probability, intervals, a statement."""
        return list(self.content["findings"])

    def __str__(self) -> str:
        return "\n".join([self.content["sentence"], *(f"- {finding['statement']}" for finding in self.findings)])

    def _repr_html_(self) -> str:
        first, *statements = str(self).split("\n- ")
        items = "".join(f"<li>{escape(statement)}</li>" for statement in statements)
        return f"<p><b>{escape(first)}</b></p><ul>{items}</ul>"


def diagnose(
    pairs: Sequence[Pair],
    start: ParameterSet | None = None,
    *,
    holdout: Sequence[Pair] = (),
    wall_px: int = WALL_PX,
    seed: int = 0,
    processes: int = 1,
) -> Answer:
    """Find out which physics the model lacks.

    Parameters
    ----------
    pairs : sequence of (target, recording)
        The recording on the target's grid: a `HeightMap`, or what `align` has returned. Two or three different
        structures say much more than one.
    start : ParameterSet, optional
        Default: the paper's.
    holdout : sequence of (target, recording)
        Predicted, and never used in a fit or a choice.
    wall_px : int
        Points so near to a wall do not count.
    seed : int
    processes : int
        How many share the work. With more than one, a script must stand under ``if __name__ == "__main__":``.
    """
    start = start or ParameterSet()
    seen, unseen = (_recordings(some, start, wall_px) for some in (pairs, holdout))
    with Workers(processes, search.__module__) as workers:
        diagnosis = search(seen, start, holdout=unseen, seed=seed, course=Course(workers=workers))
        profiled = diagnosis.intervals(diagnosis.extended.fit, profiles=True).as_dict()
        return Answer(content_of(diagnosis, profiled), extended(diagnosis, profiled), diagnosis)


def plot(*maps: HeightMap, names: Sequence[str] = ()) -> Figure:
    """Draw one map, or a reference and a test with their difference, and profiles.

    Parameters
    ----------
    *maps : HeightMap
        One, or two on one grid.
    names : sequence of str, optional

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``figure.savefig("map.png")`` keeps it.
    """
    from dlwpredict import plots  # matplotlib takes a second

    if len(maps) not in (1, 2):
        raise InputError(f"found {len(maps)} maps", key="maps", allowed="allowed: one, or two on one grid")
    if len(maps) == 1:
        return plots.overview(maps[0], name=names[0] if names else "height map")
    reference, test = names or ("reference", "test")
    return plots.comparison(*maps, names=(reference, test))


def _recordings(pairs: Sequence[Pair], start: ParameterSet, wall_px: int) -> list[Recording]:
    """Check pairs, and bring them to the pixels that a fit works on."""
    ready = []
    for number, (target, measured) in enumerate(pairs, 1):
        heights = measured.aligned if isinstance(measured, Alignment) else measured
        names = f"recording {number}", f"target {number}"
        pair = checked(target, heights, name=names[0], target_name=names[1], wall_px=wall_px)
        ready.append(coarser(pair, working_factor(target, start)))
    return ready
