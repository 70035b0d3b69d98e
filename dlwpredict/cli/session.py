"""One diagnosis from files to files: at any time there is a whole answer, and what it takes to go on from it."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dlwpredict.api.diagnose import Answer, diagnose, first_look, in_halves
from dlwpredict.cli.anytime import said as about
from dlwpredict.cli.console import detail, say, warn
from dlwpredict.cli.pairs import Files, read_pair, with_repeats
from dlwpredict.cli.plotting import draw
from dlwpredict.cli.progress import progress
from dlwpredict.cli.streams import tell as figures
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.answer.content import FORMAT
from dlwpredict.diagnosis.answer.words import listed
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.run import Course, Stage
from dlwpredict.errors import InputError, ResultError
from dlwpredict.files import write_height_map
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters
from dlwpredict.files.provenance import origin, with_cautions
from dlwpredict.files.resume import Companion, fingerprint
from dlwpredict.files.yaml_text import read_yaml, yaml_text
from dlwpredict.infer.objective import Work
from dlwpredict.infer.recording import check_points, require_points
from dlwpredict.numerics.parallel import cpu_s
from dlwpredict.pairing import Pair
from dlwpredict.parameters import ParameterSet

PREDICTIONS = 600, 6000
"""A diagnosis takes about as long as so many predictions of all recordings, less than half of it for them: in 59 cases
of a spent proof 450 to 3100 (5 and 95 %), with two strong effects on large maps 5800."""


@dataclass(frozen=True)
class Inputs:
    """Which files a diagnosis is made from, and how they are read.

    Parameters
    ----------
    pairs, holdout : sequence of (Path, Path)
        Target and recording.
    repeats : sequence of (Path, Path)
        Recording and its repeat.
    parameters : Path, optional
    wall_px : int
    pitch_um : float, optional
        Of the working pixels; if absent, what the focus allows.
    """

    pairs: Files
    holdout: Files
    repeats: Files
    parameters: Path | None
    wall_px: int
    pitch_um: float | None

    def read(self, files: Files, start: ParameterSet) -> list[Pair]:
        """Read and check pairs, and say on which pixels they are worked."""
        pairs = []
        for pair in files:
            one = read_pair(pair, start, wall_px=self.wall_px, working_pitch_um=self.pitch_um)
            detail(f"{pair[1]}: {one.native.points} points count, {one.factor} × {one.factor} pixels make one")
            pairs.append(one)
        return pairs

    def fingerprint(self, seed: int) -> str:
        """Return what another run must share with this one to take up its work."""
        files = [file for pair in (*self.pairs, *self.holdout, *self.repeats) for file in pair]
        recordings = [str(recording.resolve()) for _, recording in self.pairs]
        options = {
            "wall_px": self.wall_px,
            "working_pitch_um": self.pitch_um,
            "seed": seed,
            "counts": [len(self.pairs), len(self.holdout), len(self.repeats), self.parameters is not None],
            "repeats": [recordings.index(str(recording.resolve())) for recording, _ in self.repeats],
        }
        return fingerprint([*files, self.parameters] if self.parameters else files, options)


@dataclass(frozen=True)
class Outputs:
    """Where the results go."""

    output: Path
    params_out: Path | None
    maps: Path | None
    report: Path | None
    plot: Path | None


def is_unfinished(output: Path) -> bool:
    """Tell whether an output is a diagnosis that was interrupted: a run that goes on may replace it."""
    return Companion.beside(output).path.exists() or bool(unfinished(output))


def unfinished(output: Path) -> dict[str, Any]:
    """Return the content of a diagnosis that was interrupted; nothing of any other file."""
    try:
        content = read_yaml(output)
    except InputError:
        return {}
    ours = isinstance(content, dict) and content.get("format") == FORMAT
    return content if ours and content.get("complete") is False else {}


@dataclass(eq=False)
class Session:
    """A diagnosis that goes on.

    Parameters
    ----------
    pairs : list of Pair
    start : ParameterSet
    holdout : list of Pair
    seed : int
    outputs : Outputs
    companion : Companion
    processes : int
    work : Work
    content : dict
        Of diagnosis.yaml as it stands; empty before there is any.
    best : Answer or None
        What the content says.
    finished : bool
    stands : bool
        Whether something else than an unfinished answer stood in the place of the output when this run began.
    """

    pairs: list[Pair]
    start: ParameterSet
    holdout: list[Pair]
    seed: int
    outputs: Outputs
    companion: Companion
    processes: int = 1
    work: Work = field(default_factory=Work)
    content: dict[str, Any] = field(default_factory=dict)
    best: Answer | None = None
    finished: bool = False
    stands: bool = False
    _expected_s: float = 0.0
    _cpu_s: float = 0.0

    @classmethod
    def of(cls, inputs: Inputs, outputs: Outputs, *, seed: int) -> Session:
        """Read and check everything."""
        begun, start = cpu_s(), read_parameters(inputs.parameters)
        pairs, holdout = inputs.read(inputs.pairs, start), inputs.read(inputs.holdout, start)
        pairs = with_repeats(pairs, inputs.repeats)
        check_points([pair.recording for pair in pairs])
        require_points([pair.recording for pair in holdout])
        companion = replace(Companion.beside(outputs.output), fingerprint=inputs.fingerprint(seed))
        return cls(pairs, start, holdout, seed, outputs, companion, _cpu_s=begun)

    def begin(self, processes: int, *, resume: bool) -> None:
        """Take up what an interrupted run has left, say how long it may take, and write an answer that knows nothing.

        An answer that the interrupted run has left says more: it stays.
        """
        self.processes, output = processes, self.outputs.output
        if resume and self.companion.read():
            fits = sum(len(stored) for stored in self.companion.stored.values())
            say(f"going on with {fits} fits of {self.companion.path}")
            self.content = unfinished(output)
        elif resume:
            say(f"begins afresh: there is no {self.companion.path}")
        self.stands = output.exists() and not unfinished(output)
        content, prediction_s = first_look(self.pairs, self.start)
        self._expected_s = prediction_s * sum(PREDICTIONS) / len(PREDICTIONS) / processes
        low, high = (about(prediction_s * count / processes) for count in PREDICTIONS)
        say(f"{pixels_of(self.pairs)}; this takes {low} to {high} or so, Ctrl-C ends it with the best answer so far")
        if not self.content:
            if self.stands:  # it is replaced by an answer that says something
                self.content = self._completed(content)
            else:
                self._write_answer(content)
        self.companion.write()

    def search(self, *, advice: bool, reproducible: bool = False) -> None:
        """Diagnose, keeping every answer on the way."""
        begun = time.monotonic()
        running: dict[str, Any] = {"seed": self.seed, "processes": self.processes}
        with progress(self._expected_s) as tell:
            course = Course(tell, self._keep, work=self.work, stored=self.companion.stored)
            answer = diagnose(self.pairs, self.start, holdout=self.holdout, advice=advice, course=course, **running)
            if self.outputs.params_out:
                answer.parameters  # noqa: B018 (may fit once more: while that can still be interrupted)
            self.best, self.content = answer, self._completed(answer.content)
        if reproducible:
            write_text(self.outputs.output, yaml_text(self.content))
            with progress(policy.SPLITS * (time.monotonic() - begun)) as tell:  # both halves: as long as the whole

                def step(stage: Stage) -> None:
                    self.companion.write()
                    tell(stage)

                answer = in_halves(answer, self.start, course=replace(course, tell=step), **running)
            self.best, self.content = answer, self._completed(answer.content)
        self.finished = True

    def _keep(self, diagnosis: Diagnosis) -> None:
        """Write an answer that is valid already, unless it says less than the one that stands."""
        self.companion.write()
        if not (diagnosis.named or diagnosis.complete) and self.content.get("findings"):
            return
        first, self.best = self.best is None, Answer.of(diagnosis, self.pairs)
        self._write_answer(self.best.content)
        if first and self.outputs.maps:
            write_maps(self.outputs.maps, self.best)

    def close(self, cause: str) -> None:
        """Write all outputs of the best answer, and say what it is; the answer itself comes last.

        Parameters
        ----------
        cause : str
            What has ended the search before it was finished; empty where nothing has.
        """
        answer, outputs = self.best, self.outputs
        if answer:
            if outputs.maps:
                write_maps(outputs.maps, answer)
            if outputs.report:
                from dlwpredict.pages.answer import write_answer  # matplotlib takes a second

                write_answer(outputs.report, answer, self.content)
            draw(outputs.plot, lambda plots: plots.diagnosis(_rows(answer), caption=self.content["sentence"]))
            if outputs.params_out:
                stated = with_cautions(answer.cautions)
                write_parameters(outputs.params_out, replace(answer.parameters, provenance=stated))
            write_text(outputs.output, yaml_text(self.content))
        if self.finished:
            self.companion.remove()
        elif self.content:
            self.companion.write()
        figures(self.content)
        from dlwpredict.pages.terminal import lines

        for line in lines(self.content) if self.content else ():
            say(line)
        if not self.finished:
            warn(self._unfinished(cause))

    def require_outputs(self) -> None:
        """Refuse to end well where a file that was asked for was not written: a Makefile would go on with an older one.

        Raises
        ------
        ResultError
            The search was ended before there was any answer.
        """
        files = self.outputs.params_out, self.outputs.maps, self.outputs.report, self.outputs.plot
        lacking = [path for path in (self.outputs.output if self.stands else None, *files) if path]
        if lacking and self.best is None:
            raise ResultError(
                "not written: ended before there was an answer",
                where=lacking[0],
                key="output",
                allowed="--resume goes on",
            )

    def _unfinished(self, cause: str) -> str:
        """Say in one line what has not been tried."""
        names = self.content.get("not_tried", [])
        tried = listed(names) if names else "the last steps of a search that has settled"
        if self.best and not (names or self.best.diagnosis.complete):
            tried = "whether the sets of effects that were refitted stay"
        return f"ended by {cause}; not tried: {tried}; the same command with --resume goes on from here"

    def _completed(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Return content with what a diagnosis does not know of itself."""
        pitches = [float(f"{pair.pitch_um:.6g}") for pair in self.pairs]
        return {
            **content,
            "working_pitch_um": pitches[0] if len(set(pitches)) == 1 else pitches,
            "work": {"predictions": round(self.work.predictions, 1), "cpu_s": round(cpu_s() - self._cpu_s, 1)},
            "recordings": [pair.names[1] for pair in self.pairs],
            "provenance": origin(),
        }

    def _write_answer(self, content: Mapping[str, Any]) -> None:
        self.content = self._completed(content)
        write_text(self.outputs.output, yaml_text(self.content))


def _rows(answer: Answer) -> list[tuple[Any, ...]]:
    """Return name, target and maps of every recording, as they are drawn."""
    maps = [tuple(answer.working_maps(k).values()) for k in range(len(answer.pairs))]
    return [(pair.names[1], pair.recording.target, *shown) for pair, shown in zip(answer.pairs, maps, strict=True)]


def pixels_of(pairs: Sequence[Pair]) -> str:
    """Say on which pixels the recordings are worked."""
    kinds = dict.fromkeys((pair.factor, pair.pitch_um) for pair in pairs)
    each = [f"{p:.3g} µm ({'as recorded' if f == 1 else f'{f} × {f} recorded ones'})" for f, p in kinds]
    return f"working pixels of {' and '.join(each)}"


def write_maps(folder: Path, answer: Answer) -> None:
    """Write the maps of all pairs on the pixels of their files, all of them or none."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}") as temporary:
        for k in range(len(answer.pairs)):
            for name, shown in answer.maps(k).items():
                write_height_map(Path(temporary) / f"{name}_{k}.tif", shown)
        folder.mkdir(exist_ok=True)
        for file in sorted(Path(temporary).iterdir()):
            shutil.move(file, folder / file.name)
