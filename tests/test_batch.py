"""Many structures through the same commands: manifest, records, failures, resuming."""

import inspect
import json
import os
import typing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.batch.chain import perform
from dlwpredict.batch.manifest import read_manifest
from dlwpredict.batch.workers import work
from dlwpredict.cli import batch, options
from dlwpredict.cli.app import app
from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import write_parameters
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

MANIFEST = """\
format: dlwpredict-batch/1
structures: targets/*.tif
commands:
  - predict {target} -p process.yaml -o predicted/{name}.tif
  - export-stl predicted/{name}.tif -o stl/{name}.stl
"""


def batch_of(folder, *words):
    return CliRunner().invoke(app, ["batch", str(folder / "m.yaml"), "--jobs", "1", *words])


def part(seed=0):
    return designs.air(size_um=10, pitch_um=0.5, margin_um=2, seed=seed)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "targets").mkdir()
    for seed, name in enumerate("abc"):
        write_height_map(tmp_path / "targets" / f"{name}.tif", part(seed))
    write_parameters(tmp_path / "process.yaml", ParameterSet())
    (tmp_path / "m.yaml").write_text(MANIFEST)
    return tmp_path


def stamps(folder):
    return {path.name: path.stat().st_mtime_ns for kind in ("predicted", "stl") for path in (folder / kind).iterdir()}


def test_every_structure_goes_through_every_command(folder):
    done = batch_of(folder)
    assert done.exit_code == 0, done.output
    assert "3 structures: 3 done, 0 finished before, 0 failed" in done.output
    for name in "abc":
        expected = predict(read_height_map(folder / f"targets/{name}.tif"), ParameterSet()).heights_um
        np.testing.assert_allclose(read_height_map(folder / f"predicted/{name}.tif").heights_um, expected, atol=1e-5)
        assert (folder / f"stl/{name}.stl").stat().st_size > 84


def test_what_is_finished_is_not_done_again(folder):
    assert batch_of(folder).exit_code == 0
    before = stamps(folder)
    done = batch_of(folder)
    assert done.exit_code == 0 and "3 finished before" in done.output
    assert stamps(folder) == before


def test_an_output_that_is_gone_is_made_again_and_no_other(folder):
    assert batch_of(folder).exit_code == 0
    before = stamps(folder)
    (folder / "predicted/b.tif").unlink()
    assert batch_of(folder).exit_code == 0
    changed = {name for name, when in stamps(folder).items() if when != before[name]}
    assert changed == {"b.tif", "b.tif.provenance.yaml"}  # the same bytes again: the STL stands


def test_changed_inputs_are_refused_until_overwriting_is_allowed(folder):
    assert batch_of(folder).exit_code == 0
    before = stamps(folder)
    write_height_map(folder / "targets/b.tif", part(7))
    refused = batch_of(folder)
    assert refused.exit_code == 1
    assert "error: b: predict: predicted/b.tif: output: has changed inputs, allowed with --overwrite" in refused.output
    assert stamps(folder) == before
    assert batch_of(folder, "--overwrite").exit_code == 0
    assert {name[0] for name, when in stamps(folder).items() if when != before[name]} == {"b"}


def test_what_a_failed_overwriting_leaves_is_not_replaced_unasked(folder):
    assert batch_of(folder).exit_code == 0
    before = stamps(folder)
    good = (folder / "targets/b.tif").read_bytes()
    write_height_map(folder / "targets/b.tif", HeightMap(np.zeros((9, 9)), 0.5, 0.5))
    assert "b: predict: targets/b.tif: heights: nothing written" in batch_of(folder, "--overwrite").output
    assert stamps(folder) == before
    (folder / "targets/b.tif").write_bytes(good)
    assert "3 finished before" in batch_of(folder).output  # the result is that of these inputs after all
    write_parameters(folder / "process.yaml", ParameterSet(paper=Paper(shrinkage_min=0.6)))
    refused = batch_of(folder)
    assert refused.exit_code == 1 and "b: predict: predicted/b.tif: output: has changed inputs" in refused.output
    assert stamps(folder) == before


def test_an_older_result_outlives_a_killed_overwriting(folder):
    assert batch_of(folder).exit_code == 0
    chain = batch.chains_of(folder / "m.yaml", folder, overwrite=True)[1]
    write_height_map(folder / "targets/b.tif", part(7))

    def killed(words, place):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        perform(replace(chain, program=killed))
    before = stamps(folder)
    refused = batch_of(folder)
    assert "b: predict: predicted/b.tif: output: exists already, allowed with --overwrite" in refused.output
    assert stamps(folder) == before
    assert batch_of(folder, "--overwrite").exit_code == 0


def test_a_process_that_changed_touches_all(folder):
    assert batch_of(folder).exit_code == 0
    write_parameters(folder / "process.yaml", ParameterSet(paper=Paper(shrinkage_min=0.6)))
    assert "3 structures: 0 done, 0 finished before, 3 failed" in batch_of(folder).output


def test_a_file_of_somebody_else_is_never_replaced(folder):
    (folder / "predicted").mkdir()
    (folder / "predicted/b.tif").write_text("mine")
    done = batch_of(folder)
    assert done.exit_code == 1 and "predicted/b.tif: output: exists already" in done.output
    assert (folder / "predicted/b.tif").read_text() == "mine"
    assert (folder / "stl/c.stl").exists() and not (folder / "stl/b.stl").exists()


def test_one_failure_stops_its_own_structure_only(folder):
    write_height_map(folder / "targets/b.tif", HeightMap(np.zeros((9, 9)), 0.5, 0.5))
    done = batch_of(folder, "--json", str(folder / "said.json"))
    assert done.exit_code == 1
    assert "error: b: predict: targets/b.tif: heights: nothing written" in done.output
    said = json.loads((folder / "said.json").read_text())
    assert (said["done"], said["finished_before"], said["failed"]) == (2, 0, 1)
    assert [step["state"] for step in said["structures"]["b"]] == ["failed", "not run"]
    assert "nothing written" in said["structures"]["b"][0]["said"][0]
    assert [line.split() for line in done.output.splitlines() if line.startswith("b ")] == [
        ["b", "failed", "not", "run"]
    ]
    assert "3 structures: 2 done, 0 finished before, 1 failed" in done.output
    assert sorted(path.name for path in (folder / "stl").glob("*.stl")) == ["a.stl", "c.stl"]


@pytest.mark.slow
def test_local_processes_give_the_same_bytes(folder):
    assert batch_of(folder).exit_code == 0
    alone = {path.name: path.read_bytes() for path in (folder / "predicted").glob("*.tif")}
    for path in (folder / "predicted").iterdir():
        path.unlink()
    assert batch_of(folder, "--jobs", "2").exit_code == 0
    assert {path.name: path.read_bytes() for path in (folder / "predicted").glob("*.tif")} == alone


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("format: dlwpredict-batch/1", "format: other"), "format: found other, allowed: dlwpredict-batch/1"),
        (
            ("commands:", "parameters: p.yaml\ncommands:"),
            "parameters: unknown key, allowed: format, structures, commands",
        ),
        (("targets/*.tif", "nowhere/*.tif"), "structures[0]: no file nowhere/*.tif"),
        (("targets/*.tif", "[{file: a.tif}]"), "structures[0]: found {'file': 'a.tif'}, allowed: a file"),
        (("targets/*.tif", "[{target: targets/a.tif, dose: 1}]"), "structures.a: dose is used by no command"),
        (("targets/*.tif", "[targets/a.tif, {target: targets/b.tif, name: a}]"), "are both called a"),
        (("-p process.yaml", "-p {recording}"), "commands[0]: {recording} is not known for a"),
        (("predict {", "print {"), "commands[0]: found print, allowed: align"),
        (("predict {", "predict --fast {"), "commands[0]: predict: No such option: --fast"),
        (("export-stl predicted", "export-stl --base-um x predicted"), "commands[1]: export-stl: Invalid value"),
        (
            ("predict {target} -p process.yaml -o predicted/{name}.tif", "score {target} {target}"),
            "score leaves no file",
        ),
        (
            ("predicted/{name}.tif\n", "predicted/all.tif\n"),
            "commands[0]: predicted/all.tif would be written for a and",
        ),
        (("-o predicted/{name}.tif", "-o {target}"), "commands[0]: targets/a.tif is read too"),
        (("-p process.yaml", "-p 'process.yaml"), "commands[0]: No closing quotation"),
    ],
)
def test_manifests_at_fault_are_refused_in_one_line(folder, change, said):
    (folder / "m.yaml").write_text(MANIFEST.replace(*change))
    done = batch_of(folder)
    assert done.exit_code == 1
    assert done.output.startswith(f"error: {folder}/m.yaml: ") and done.output.count("\n") == 1
    assert said in done.output
    assert not (folder / "predicted").exists()


def test_structures_may_have_words_of_their_own(folder):
    text = "format: dlwpredict-batch/1\nstructures: [targets/a.tif, {target: targets/b.tif, name: tall, dose: 2}]\n"
    (folder / "m.yaml").write_text(text + "commands: ['predict {target} -o {name}.tif']\n")
    with pytest.raises(InputError, match="dose is used by no command"):
        read_manifest(folder / "m.yaml")
    (folder / "m.yaml").write_text(text.replace(", dose: 2", "") + "commands: ['predict {target} -o {name}.tif']\n")
    assert [one.lines[0][3] for one in read_manifest(folder / "m.yaml")] == ["a.tif", "tall.tif"]


def test_every_path_of_a_batch_command_is_known_as_read_or_written():
    """A new output must be entered in `options.OUTPUTS`, or it would be taken for an input."""
    read = {
        "height_map",
        "holdout",
        "pair",
        "parameters",
        "recording",
        "reference",
        "repeat",
        "source",
        "target",
        "test",
    }
    from dlwpredict.cli import align, calibrate, convert, diagnose, export_stl, precompensate, score
    from dlwpredict.cli import predict as prediction

    modules = (align, calibrate, convert, diagnose, export_stl, precompensate, prediction, score)
    assert sorted(module.COMMAND for module in modules) == sorted(batch.COMMANDS)
    for module in modules:
        for name, given in inspect.signature(module.run, eval_str=True).parameters.items():
            if "Path" in str(typing.get_args(given.annotation)[:1]):
                assert name in read or name in options.OUTPUTS, f"{module.COMMAND}: {name}"


def fatal_for_three(number):
    if number == 3:
        os.kill(os.getpid(), 9)
    if number == 4:
        raise ValueError("four")
    return number * number


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_a_worker_that_dies_takes_only_its_own_job_with_it():
    found = dict(work(fatal_for_three, range(6), processes=2))
    assert "the worker died" in str(found.pop(3)) and str(found.pop(4)) == "four"
    assert found == {0: 0, 1: 1, 2: 4, 5: 25}


def test_paths_count_from_the_manifest(folder, monkeypatch):
    monkeypatch.chdir(Path(folder.root))
    assert batch_of(folder).exit_code == 0
