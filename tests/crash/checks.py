"""What must hold after a kill, on a full disk, in a read-only folder, and with two writers at once."""

import os
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tests.crash.kill import run

Between = Mapping[str, Callable[[Path], bool]] | None
OLD = b"the old output, which is no height map"


SPENT = re.compile(rb"^  cpu_s: .*\n|\"cpu_s\": [\d.]+", re.MULTILINE)
"""What is another one in every run."""


def snapshot(folder: Path) -> dict[str, bytes]:
    """Return the content of all files, but for the time that they took."""
    return {str(path.relative_to(folder)): content_of(path) for path in sorted(folder.rglob("*")) if path.is_file()}


def content_of(path: Path) -> bytes:
    """Return the content of a file, but for the time that it took."""
    content = path.read_bytes()
    return SPENT.sub(b"", content) if path.suffix in (".yaml", ".json") else content


def killed(
    words: tuple[str, ...], source: Path, folder: Path, kills: int, seed: int, between: Between = None
) -> Counter:
    """Kill a command at random moments of its writing; every output must be the old or the new one, or one between.

    Parameters
    ----------
    between : mapping, optional
        By the name of an output that is written more than once, what tells a whole one; also of
        files that the command removes at its end.

    Returns
    -------
    Counter
        How many kills came in time and how many after the end; how many outputs were old and new then.

    Raises
    ------
    AssertionError
        A broken output, a file of another name, or temporary files that the next run leaves.
    """
    rng, between = np.random.default_rng(seed), between or {}
    given = snapshot(source)
    shutil.copytree(source, folder)
    times = []
    for _ in range(3):
        status, said, seconds = run((*words, "--overwrite"), folder)
        assert status == 0, said
        times.append(seconds)
    new, writing = snapshot(folder), min(times)
    outputs = sorted(new.keys() - given.keys())
    assert outputs
    found = Counter()
    while found["killed"] < kills:
        for name in outputs:
            (folder / name).write_bytes(OLD)
        status, _, _ = run((*words, "--overwrite"), folder, kill_after=rng.uniform(0, writing))
        found["killed" if status == -9 else "came to its end"] += 1
        for name in outputs:
            content = content_of(folder / name)
            known = content in (OLD, new[name]) or (name in between and between[name](folder / name))
            assert known, f"{name} is broken: {len(content)} bytes"
            found["old" if content == OLD else "new" if content == new[name] else "between"] += 1
        left = snapshot(folder).keys() - new.keys()
        for name in left & between.keys():
            assert between[name](folder / name), f"{name} is broken"
            (folder / name).unlink()
        left -= between.keys()
        assert all(Path(name).name.startswith(".dlwpredict-") for name in left), left
        found["temporary files left"] += len(left)
    status, said, _ = run((*words, "--overwrite"), folder)
    assert status == 0, said
    assert snapshot(folder) == new
    return found


def refused(words: tuple[str, ...], source: Path, folder: Path, **limits) -> str:
    """Run a command that cannot write; return its one line. Nothing in the folder may have changed."""
    shutil.copytree(source, folder, dirs_exist_ok=True)
    return _refused(words, folder, **limits)


def _refused(words: tuple[str, ...], folder: Path, **limits) -> str:
    before = snapshot(folder)
    status, said, _ = run((*words, "--overwrite"), folder, **limits)
    lines = [line for line in said.splitlines() if not line.startswith("warning: ")]
    assert (status, len(lines)) == (1, 1), said
    assert lines[0].startswith("error: "), said
    assert snapshot(folder) == before
    return lines[0]


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """Mount a disk of that size; OSError where that is not allowed."""
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True).returncode:
        raise OSError("mounting is not allowed")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def full_disk(words: tuple[str, ...], source: Path, folder: Path) -> str:
    """Run a command on a disk that its inputs and older outputs fill."""
    with small_disk(folder, "16m") as disk:
        shutil.copytree(source, disk, dirs_exist_ok=True)
        with (disk / "filler").open("wb") as filler:
            try:
                while True:
                    filler.write(b"\0" * 65536)
                    filler.flush()
            except OSError:
                pass
        return _refused(words, disk)


def read_only(words: tuple[str, ...], source: Path, folder: Path) -> str:
    """Run a command where nothing may be written; root is bound by a disk mounted so, not by permissions."""
    if os.getuid() != 0:
        shutil.copytree(source, folder)
        folder.chmod(0o555)
        try:
            return _refused(words, folder)
        finally:
            folder.chmod(0o755)
    with small_disk(folder, "16m") as disk:
        shutil.copytree(source, disk, dirs_exist_ok=True)
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        return _refused(words, disk)


def two_at_once(words: tuple[str, ...], other: tuple[str, ...], source: Path, folder: Path, times: int) -> Counter:
    """Run two commands that write one output, both at once; each output must be all of one or all of the other."""
    shutil.copytree(source, folder)
    whole = []
    for command in (words, other):
        assert run((*command, "--overwrite"), folder)[0] == 0
        whole.append(snapshot(folder))
    found = Counter()
    for number in range(times):
        mine, theirs = (words, other)[:: 1 if number % 2 else -1]  # who starts first is ahead as a rule
        child = os.fork()
        if child == 0:
            os._exit(run((*theirs, "--overwrite"), folder)[0])
        status, said, _ = run((*mine, "--overwrite"), folder)
        assert status == 0, said
        assert os.waitpid(child, 0)[1] == 0
        now = snapshot(folder)
        assert now.keys() == whole[0].keys()
        for name, content in now.items():
            assert content in (whole[0][name], whole[1][name]), f"{name} is broken"
        found["first" if now == whole[0] else "second" if now == whole[1] else "one file of each"] += 1
    return found
