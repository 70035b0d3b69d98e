"""A small part of `make test-crash`: commands killed while they write, full disks, two writers at once."""

import os
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.atomic import replacing
from dlwpredict.heightmap import HeightMap
from tests.crash.checks import full_disk, killed, read_only, refused, small_disk, two_at_once
from tests.crash.commands import COMMANDS, OTHERS, WRITE_NOTHING, commands, inputs
from tests.crash.resume import resumed

QUICK = ("design", "convert", "predict", "precompensate", "export-stl")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("source")
    inputs(folder)
    return folder


def test_no_command_is_forgotten():
    assert commands() <= COMMANDS.keys() | WRITE_NOTHING | OTHERS


@pytest.mark.slow
@pytest.mark.parametrize("command", QUICK)
def test_a_kill_leaves_the_old_output_or_the_new_one(source, tmp_path, command):
    """Whether a kill comes before the renaming is chance: it is tried until one has."""
    found, tries = Counter(), 0
    while not found["old"] and tries < 8:
        found += killed(COMMANDS[command], source, tmp_path / f"work{tries}", kills=2, seed=8 + tries)
        tries += 1
    assert found["killed"] == 2 * tries
    assert found["old"] > 0


@pytest.mark.parametrize("command", QUICK)
def test_an_output_cut_off_by_the_system_is_refused_and_the_old_one_kept(source, tmp_path, command):
    """The limit of a process stands for the end of a disk."""
    said = refused(COMMANDS[command], source, tmp_path, largest=2000)
    assert "output: cannot write (File too large)" in said or "output: cannot write (disk full?" in said


def test_a_full_disk_or_a_closed_folder_is_one_line(source, tmp_path):
    try:
        with small_disk(tmp_path / "try", "1m"):
            pass
    except OSError as error:
        pytest.skip(str(error))
    assert "cannot write (No space left on device)" in full_disk(COMMANDS["convert"], source, tmp_path / "full")
    assert "folder cannot be written to" in read_only(COMMANDS["convert"], source, tmp_path / "closed")


@pytest.mark.slow
@pytest.mark.long
def test_a_killed_batch_goes_on_as_if_nothing_had_happened(tmp_path):
    assert resumed(tmp_path, kills=1, seed=0)["killed"] == 1


@pytest.mark.slow
def test_of_two_writers_one_wins_whole(source, tmp_path):
    first, second = ("convert", "large.tif", "out.csv"), ("convert", "target.tif", "out.csv")
    assert two_at_once(first, second, source, tmp_path / "work", 3).total() == 3


def test_temporary_files_of_the_dead_are_cleared_away_those_of_the_living_are_not(tmp_path):
    path = tmp_path / "a.tif"
    with replacing(tmp_path / "b.tif") as living:
        living.write_text("half")
        dead = living.with_name(living.name.replace(f"-{living.name.split('-')[2]}-", "-4194304-"))
        dead.write_text("half")  # no process has this number: it is above the largest of a system
        write_height_map(path, HeightMap(np.ones((4, 4)), 1, 1))
        assert living.exists()
        assert not dead.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.tif", "b.tif"]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks the process list")
def test_a_process_that_nobody_has_asked_about_is_dead_all_the_same(tmp_path):
    """As in a container: what a killed worker has left there would stay for ever."""
    with subprocess.Popen(["true"]) as ended:
        os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)
        with replacing(tmp_path / "b.tif") as living:
            left = living.with_name(living.name.replace(f"-{os.getpid()}-", f"-{ended.pid}-"))
            living.write_text("half")
            left.write_text("half")
            write_height_map(tmp_path / "a.tif", HeightMap(np.ones((4, 4)), 1, 1))
            assert living.exists()
            assert not left.exists()


def test_a_failure_keeps_the_old_output(tmp_path):
    path = tmp_path / "a.tif"
    write_height_map(path, HeightMap(np.ones((4, 4)), 1, 1))
    with pytest.raises(InputError):
        write_height_map(path, HeightMap(np.full((4, 4), 1e300), 1, 1))
    assert (read_height_map(path).heights_um == 1).all()
    assert list(tmp_path.iterdir()) == [path]
