"""One diagnosis from files to files: at any time there is a whole answer, and what it takes to go on from it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dlwpredict.calibration.words import cautions_of
from dlwpredict.cli.anytime import Companion, cpu_s, end_workers, fingerprint
from dlwpredict.cli.anytime import said as about
from dlwpredict.cli.console import say, warn
from dlwpredict.cli.diagnosis_files import maps_of, write_maps, write_report
from dlwpredict.cli.pairs import Files, Pair, pixels_of, repeats_of
from dlwpredict.cli.progress import progress
from dlwpredict.cli.streams import tell as figures
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.answer.advise import advise
from dlwpredict.diagnosis.answer.content import FORMAT, content_of, untested
from dlwpredict.diagnosis.answer.halves import Classes, halves, named_by, with_halves
from dlwpredict.diagnosis.answer.sides import extended
from dlwpredict.diagnosis.answer.words import listed
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.run import Course, Stage, diagnose
from dlwpredict.errors import InputError
from dlwpredict.files.atomic import write_text
from dlwpredict.files.parameters_yaml import read_parameters, write_parameters
from dlwpredict.files.provenance import origin, with_cautions
from dlwpredict.files.yaml_text import read_yaml, yaml_text
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed
from dlwpredict.infer.objective import Work
from dlwpredict.infer.recording import Recording, check_points
from dlwpredict.infer.trace import trace
from dlwpredict.model.levels import Levels
from dlwpredict.numerics.parallel import Workers
from dlwpredict.parameters import ParameterSet

PREDICTIONS = 600, 3000
"""A diagnosis takes about as long as so many predictions of all recordings: half of it is predictions."""

COLD_S = 1.0
"""A first prediction that takes less is timed again: loading what it needs took part of it."""


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
        """Read and check pairs."""
        return [Pair.read(pair, start, self.wall_px, self.pitch_um) for pair in files]

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
    if Companion.beside(output).path.exists():
        return True
    try:
        content = read_yaml(output)
    except InputError:
        return False
    return isinstance(content, dict) and content.get("format") == FORMAT and content.get("complete") is False


@dataclass(eq=False)
class Session:
    """A diagnosis that goes on.

    Parameters
    ----------
    pairs : list of Pair
    start : ParameterSet
    holdout : list of Recording
    repeats : list of list of HeightMap
        Of every pair.
    seed : int
    outputs : Outputs
    companion : Companion
    processes : int
    work : Work
    content : dict
        Of diagnosis.yaml as it stands; empty before there is any.
    best : Diagnosis or None
        What the content says.
    process : ParameterSet or None
        With the effects found, once the search is complete.
    finished : bool
    """

    pairs: list[Pair]
    start: ParameterSet
    holdout: list[Recording]
    repeats: list[list[HeightMap]]
    seed: int
    outputs: Outputs
    companion: Companion
    processes: int = 1
    work: Work = field(default_factory=Work)
    content: dict[str, Any] = field(default_factory=dict)
    best: Diagnosis | None = None
    process: ParameterSet | None = None
    finished: bool = False
    _expected_s: float = 0.0
    _cpu_s: float = 0.0

    @classmethod
    def of(cls, inputs: Inputs, outputs: Outputs, *, seed: int) -> Session:
        """Read and check everything."""
        begun, start = cpu_s(), read_parameters(inputs.parameters)
        pairs = inputs.read(inputs.pairs, start)
        holdout = [pair.recording for pair in inputs.read(inputs.holdout, start)]
        repeats = repeats_of(pairs, inputs.repeats)
        check_points([pair.recording for pair in pairs])
        companion = replace(Companion.beside(outputs.output), fingerprint=inputs.fingerprint(seed))
        return cls(pairs, start, holdout, repeats, seed, outputs, companion, _cpu_s=begun)

    @property
    def recordings(self) -> list[Recording]:
        """All of them."""
        return [pair.recording for pair in self.pairs]

    def begin(self, processes: int, *, resume: bool) -> None:
        """Take up what an interrupted run has left, say how long it may take, and write an answer that knows nothing.

        An answer that the interrupted run has left says more: it stays.
        """
        self.processes, output = processes, self.outputs.output
        free = freed(self.start, choose(self.start))
        if resume and self.companion.read():
            fits = sum(len(stored) for stored in self.companion.stored.values())
            say(f"going on with {fits} fits of {self.companion.path}")
            if output.exists():
                self.content = read_yaml(output)
        elif resume:
            say(f"begins afresh: there is no {self.companion.path}")
        predicted, prediction_s = _timed(self.recordings, self.start)
        self._expected_s = prediction_s * sum(PREDICTIONS) / len(PREDICTIONS) / processes
        low, high = (about(prediction_s * count / processes) for count in PREDICTIONS)
        say(f"{pixels_of(self.pairs)}; this takes {low} to {high} or so, Ctrl-C ends it with the best answer so far")
        if not self.content:
            self.content = self._completed(untested(self.recordings, predicted, free))
            self._write_answer()
        self.companion.write()

    def search(self, *, advice: bool, reproducible: bool = False) -> None:
        """Diagnose, keeping every answer on the way."""
        with progress(self._expected_s) as tell, Workers(self.processes, diagnose.__module__) as workers:
            try:
                diagnosis = diagnose(
                    self.recordings,
                    self.start,
                    repeats=self.repeats,
                    holdout=self.holdout,
                    seed=self.seed,
                    course=Course(tell, self.keep, workers, self.work, self.companion.stored),
                )
                tell(Stage("judgement", 0.95, "intervals, and what to record next"))
                profiled = diagnosis.intervals(diagnosis.extended.fit, profiles=True).as_dict()
                content = content_of(diagnosis, profiled)
                if advice:
                    _advised(diagnosis, content)
                self.process = extended(diagnosis, profiled) if self.outputs.params_out else None
                self.best, self.content = diagnosis, self._completed(content)
                if reproducible:
                    self._write_answer()
                    content = with_halves(content, list(self._halves(tell, workers)))
                self.content, self.finished = self._completed(content), True
            except KeyboardInterrupt:
                end_workers()
                raise

    def _halves(self, tell: Callable[[Stage], None], workers: Workers) -> Iterator[Classes]:
        """Diagnose halves of the recordings."""
        chosen = halves(len(self.recordings), policy.SPLITS, self.seed)
        for number, half in enumerate(chosen, start=1):
            tell(Stage("judgement", 0.99, f"half {number} of {len(chosen)}"))
            stored = self.companion.stored.setdefault(f"half {half}", {})
            course = Course(workers=workers, work=self.work, stored=stored)
            yield named_by(half, self.recordings, self.start, self.repeats, self.seed, course)
            self.companion.write()

    def keep(self, diagnosis: Diagnosis) -> None:
        """Write an answer that is valid already, unless it says less than the one that stands."""
        self.companion.write()
        if not (diagnosis.named or diagnosis.complete) and self.content.get("findings"):
            return
        first, self.best = self.best is None, diagnosis
        self.content = self._completed(content_of(diagnosis))
        self._write_answer()
        if first and self.outputs.maps:
            write_maps(self.outputs.maps, diagnosis, self.pairs)

    def close(self, cause: str) -> None:
        """Write all outputs of the best answer, and say what it is; the answer itself comes last.

        Parameters
        ----------
        cause : str
            What has ended the search before it was finished; empty where nothing has.
        """
        diagnosis, outputs = self.best, self.outputs
        if diagnosis:
            if outputs.maps:
                write_maps(outputs.maps, diagnosis, self.pairs)
            if outputs.report:
                write_report(outputs.report, diagnosis, self.content, self.pairs)
            if outputs.plot:
                self._draw(outputs.plot, diagnosis)
            if outputs.params_out:
                process = self.process or extended(diagnosis)
                stated = with_cautions(cautions(diagnosis, self.content))
                write_parameters(outputs.params_out, replace(process, provenance=stated))
            self._write_answer()
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

    def _unfinished(self, cause: str) -> str:
        """Say in one line what has not been tried."""
        names = self.content.get("not_tried", [])
        tried = listed(names) if names else "the last steps of a search that has settled"
        if diagnosis := self.best:
            tried = tried if names or diagnosis.complete else "whether the sets of effects that were refitted stay"
        return f"ended by {cause}; not tried: {tried}; the same command with --resume goes on from here"

    def _completed(self, content: dict[str, Any]) -> dict[str, Any]:
        """Return content with what a diagnosis does not know of itself."""
        pitches = [float(f"{pair.pitch_um:.6g}") for pair in self.pairs]
        return content | {
            "working_pitch_um": pitches[0] if len(set(pitches)) == 1 else pitches,
            "work": {"predictions": round(self.work.predictions, 1), "cpu_s": round(cpu_s() - self._cpu_s, 1)},
            "recordings": [str(pair.files[1]) for pair in self.pairs],
            "provenance": origin(),
        }

    def _write_answer(self) -> None:
        write_text(self.outputs.output, yaml_text(self.content))

    def _draw(self, path: Path, diagnosis: Diagnosis) -> None:
        from dlwpredict import plots

        rows = []
        for k, pair in enumerate(self.pairs):
            residual, mismatch, explained, remainder = maps_of(diagnosis, k).values()
            rows.append((str(pair.files[1]), pair.recording.target, residual, mismatch, explained, remainder))
        plots.save(path, plots.diagnosis(rows, caption=self.content["sentence"]))


def cautions(diagnosis: Diagnosis, content: dict[str, Any]) -> list[str]:
    """Say what should be known wherever the extended process is used."""
    remainder, said = content["remainder"], []
    if not content.get("complete", True):
        said.append("the diagnosis was ended before it was complete: other effects may explain the recordings better")
    if content["verdict"] == "unexplained":
        said.append("the diagnosis is 'unexplained': most of the mismatch has no name, and its effects stand in for it")
    elif remainder["significant"]:
        said.append(f"the diagnosis left {remainder['rms_um']:.3g} µm beyond noise that no named effect explains")
    return said + cautions_of(diagnosis.recordings)


def _timed(recordings: Sequence[Recording], start: ParameterSet) -> tuple[list[np.ndarray], float]:
    """Predict all recordings once; return the heights, µm, and the seconds that it takes."""
    for _ in range(2):
        begun = time.perf_counter()
        predicted = [trace(recording.target, start, Levels()).heights_um for recording in recordings]
        took = time.perf_counter() - begun
        if took > COLD_S:
            break
    return predicted, took


def _advised(diagnosis: Diagnosis, content: dict[str, Any]) -> None:
    """Add to every class the recording that would tell its members apart."""
    for item, finding in zip(diagnosis.named, content["findings"], strict=True):
        if len(item.members) > 1:
            advice = advise(diagnosis.baseline.fit, [member.effect for member in item.members])
            finding["separate_by"] = advice.sentence if advice else None
            finding["separate_command"] = advice.command if advice else None
