"""`dlwpredict diagnose` ended at any moment: what is there is whole, and the same command goes on from it."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.cli.anytime import Ending, seconds
from dlwpredict.effects import library
from dlwpredict.files import write_height_map
from dlwpredict.files.resume import Companion
from dlwpredict.files.yaml_text import read_yaml
from dlwpredict.noise.covariance import Noise
from dlwpredict.pages.records import read_record
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

PRINTED = ParameterSet(
    paper=Paper(exposure_fwhm_z_um=1.7, threshold=0.47, shrinkage_min=0.74, shrinkage_max=0.96),
    effects=(library()["edge-drying"](depth_um=0.3, length_um=3.0),),
)
NOISE = Noise(0.004, 0.01, 1.0, 0.5, 0.5)
PART = {"size_um": 16.0, "pitch_um": 0.5, "margin_um": 4.0}
LONGEST_S = 300

LISTENING = """
import signal
from dlwpredict.cli import main
from dlwpredict.diagnosis.library import signatures
from dlwpredict.diagnosis.library.candidates import candidates

few = {"curl", "edge-drying", "instrument-blur", "vignetting"}
signatures.candidates = lambda *of: [one for one in candidates(*of) if one.name in few]
signal.signal(signal.SIGINT, signal.default_int_handler)
main()
"""
"""The program, which listens to Ctrl-C as from a terminal, even where these tests run in the background and ignore it.

It looks at a part of the library alone: how it ends does not depend on how many effects there are.
"""


@pytest.fixture(scope="module")
def prints(tmp_path_factory):
    folder = tmp_path_factory.mktemp("prints")
    for k, target in enumerate((designs.air(**PART), designs.stairs(feature_um=2.0, **PART))):
        surface = predict(target, PRINTED, as_measured=True)
        noise = NOISE.simulate(target.shape, np.random.default_rng(k))
        write_height_map(folder / f"t{k}.tif", target)
        write_height_map(folder / f"r{k}.tif", surface.with_heights(surface.heights_um + noise))
    return folder


def begun(prints, folder, *words, jobs="1"):
    """Start a diagnosis into a folder, in a process group of its own."""
    program = [sys.executable, "-c", LISTENING, "diagnose"]
    pairs = [str(prints / name) for name in ("t0.tif", "r0.tif", "t1.tif", "r1.tif")]
    given = ["--pair", *pairs[:2], "--pair", *pairs[2:], "-o", "d.yaml", "--no-advice", "--jobs", jobs, *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*program, *given], cwd=folder, start_new_session=True, **pipes)


def done(prints, folder, *words, jobs="1"):
    running = begun(prints, folder, *words, jobs=jobs)
    out, err = running.communicate(timeout=LONGEST_S)
    return running.returncode, out, err


def content(folder):
    """Return what a diagnosis says, checked for all that a page reads; nothing of how it came about."""
    kind, found = read_record(folder / "d.yaml")
    assert kind == "diagnosis"
    return {key: value for key, value in found.items() if key not in ("work", "provenance")}


def until(folder, running, condition):
    """Wait until what stands in the folder meets a condition."""
    began = time.monotonic()
    while not ((folder / "d.yaml").exists() and condition(read_yaml(folder / "d.yaml"))):
        assert running.poll() is None and time.monotonic() < began + LONGEST_S, running.communicate()
        time.sleep(0.02)


def alive(group, patience_s=5.0):
    """Return the processes of a group that still run after some patience."""
    end = time.monotonic() + patience_s
    while True:
        asked = ["ps", "-e", "-o", "pgid=,pid=,stat=,args="]
        listed = [
            line.split(None, 3) for line in subprocess.run(asked, capture_output=True, text=True).stdout.splitlines()
        ]
        found = [line for line in listed if line[0] == str(group) and line[2][0] not in "ZX"]
        if not found or time.monotonic() > end:
            return found
        time.sleep(0.1)


def known_by(found):
    """Tell whether anything is known by an answer."""
    return bool(found["tested"])


@pytest.fixture(scope="module")
def whole(prints, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    began = time.monotonic()
    status, out, err = done(prints, folder)
    assert status == 0, err
    assert sorted(path.name for path in folder.iterdir()) == ["d.yaml"]
    found = content(folder)
    assert found["complete"] and found["findings"][0]["effects"] == ["edge-drying"]
    assert out.startswith("working pixels of 0.5 µm (as recorded); this takes ")
    return found, time.monotonic() - began


def goes_on(prints, folder, whole, *words):
    """Resume, and compare with the run that nobody ended: the same numbers, to all of their digits."""
    status, _, err = done(prints, folder, "--resume", *words)
    assert status == 0, err
    assert content(folder) == whole[0]
    assert not (folder / "d.resume.json").exists()


def test_the_end_of_a_time_waits_for_a_first_answer_and_ctrl_c_does_not():
    end = Ending(waits=True)
    end._strike(signal.SIGALRM, None)
    with pytest.raises(KeyboardInterrupt):
        end.stop()
    with pytest.raises(KeyboardInterrupt):
        end._strike(signal.SIGINT, None)
    for number in (signal.SIGINT, signal.SIGALRM):  # once is enough, also while it waits
        end._strike(number, None)
    assert end.cause == "Ctrl-C"


@pytest.mark.slow
@pytest.mark.long
def test_a_time_limit_ends_it_before_anything_was_tested(prints, whole, tmp_path):
    """However short it is and however busy the machine: an answer is there; a page that is not there is no success."""
    status, out, err = done(prints, tmp_path, "--time-limit", "0.001s", "--report", "d.html")
    assert status == 1, err
    found = content(tmp_path)
    assert (found["verdict"], found["complete"], found["tested"]) == ("unexplained", False, [])
    assert found["not_tried"] == sorted(library())
    assert "Nothing was tested yet" in found["sentence"] and "Nothing was tested yet" in out
    warning, error = err.splitlines()
    assert "ended by the time limit; not tried: astigmatism" in warning and "--resume" in warning
    assert error.startswith("error: d.html: output: not written: ended before there was an answer")
    assert not (tmp_path / "d.html").exists()
    goes_on(prints, tmp_path, whole, "--report", "d.html")
    assert (tmp_path / "d.html").exists()


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGINT, "1"), (signal.SIGTERM, "2")])
def test_a_signal_ends_it_in_good_order(prints, whole, tmp_path, number, jobs):
    files = "--maps", "maps", "--report", "d.html", "--params-out", "e.yaml"
    running = begun(prints, tmp_path, *files, jobs=jobs)
    until(tmp_path, running, known_by)
    os.kill(running.pid, number)
    out, err = running.communicate(timeout=30)
    assert running.returncode == 130, err
    found = content(tmp_path)
    assert not found["complete"] and found["not_tried"]
    assert "Not complete" in found["sentence"] and "not complete (" in out
    assert "--resume goes on from here" in err and err.count("\n") == 1
    assert len(list((tmp_path / "maps").iterdir())) == 8 + 8  # each with its provenance
    assert (tmp_path / "d.html").exists() and read_record(tmp_path / "e.yaml")[0] == "parameters"
    assert alive(running.pid) == []
    goes_on(prints, tmp_path, whole, *files)


@pytest.mark.slow
@pytest.mark.long
def test_a_kill_at_any_moment_leaves_a_whole_answer(prints, whole, tmp_path):
    """Killed and taken up again, and again: it comes to its end, which is that of a run that nobody killed."""
    rng, words = np.random.default_rng(3), ()
    for _ in range(4):
        running = begun(prints, tmp_path, *words)
        time.sleep(rng.uniform(0.15, 0.9) * whole[1])
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()
        if (tmp_path / "d.yaml").exists():
            found, words = content(tmp_path), ("--resume",)
            if found["complete"]:
                break
            assert Companion(tmp_path / "d.resume.json", "another").path.exists()
    if not content(tmp_path)["complete"]:
        goes_on(prints, tmp_path, whole)
    assert content(tmp_path) == whole[0]


@pytest.mark.slow
@pytest.mark.long
def test_an_answer_stands_until_there_is_another(prints, tmp_path):
    (tmp_path / "d.yaml").write_text("mine")
    running = begun(prints, tmp_path, "--overwrite")
    while not (tmp_path / "d.resume.json").exists():
        time.sleep(0.01)
    os.killpg(running.pid, signal.SIGKILL)
    running.communicate()
    assert (tmp_path / "d.yaml").read_text() == "mine"
    status, _, err = done(prints, tmp_path, "--time-limit", "0.001s", "--overwrite")
    assert status == 1 and "d.yaml: output: not written" in err
    assert (tmp_path / "d.yaml").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.long
def test_only_the_same_command_goes_on(prints, tmp_path):
    assert done(prints, tmp_path, "--time-limit", "0.2")[0] == 0
    before = (tmp_path / "d.yaml").read_bytes()
    for words, said in (
        ((), "d.yaml: output: exists already"),
        (("--resume", "--seed", "1"), "d.resume.json: --resume: made from other inputs, options or versions"),
    ):
        status, _, err = done(prints, tmp_path, *words)
        assert status == 1 and said in err and err.count("\n") == 1
        assert (tmp_path / "d.yaml").read_bytes() == before
    (tmp_path / "d.resume.json").unlink()
    status, out, _ = done(prints, tmp_path, "--resume", "--time-limit", "0.2")
    assert status == 0 and "begins afresh: there is no d.resume.json" in out
    (tmp_path / "d.resume.json").write_text("{")
    status, _, err = done(prints, tmp_path, "--resume")
    assert status == 1 and "cannot be read" in err and err.count("\n") == 1
    (tmp_path / "d.resume.json").unlink()
    (tmp_path / "d.yaml").write_bytes(before.replace(b"complete: false", b"complete: true"))
    status, _, err = done(prints, tmp_path, "--resume")
    assert status == 1 and "d.yaml: output: exists already" in err


def test_times_are_read_with_their_units():
    assert [seconds(text) for text in ("90", "90s", "5m", "1.5h", ".5")] == [90, 90, 300, 5400, 0.5]
    for text in ("", "0", "m", "5 days", "-3", "nan"):
        with pytest.raises(ValueError, match="no time"):
            seconds(text)
