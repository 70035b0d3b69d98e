"""Files broken by chance or built to hurt end in a right answer or in one line, soon, in little memory."""

from pathlib import Path

import numpy as np
import pytest

from dlwpredict.errors import InputError
from tests.fuzz.__main__ import fuzzed, trapped
from tests.fuzz.doors import doors
from tests.fuzz.readers import Reader, readers
from tests.fuzz.traps import HEAVY, TRAPS
from tests.fuzz.watch import watched

READERS = {reader.name: reader for reader in readers()}


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_damaged_files(name):
    found = fuzzed(READERS[name], 500, seed=8)
    assert found["faults"] == []
    assert sum(found["ends"].values()) == 500


@pytest.mark.parametrize("door", doors(), ids=lambda door: door.name)
def test_damaged_files_at_every_door(door):
    found = fuzzed(door, 20, seed=8)
    assert found["faults"] == []


@pytest.mark.parametrize("name", READERS)
def test_whole_files_are_read(name, tmp_path):
    """Else damage would only ever meet the first check."""
    reader = READERS[name]
    assert any(reader.seeds.values())
    for ending, seeds in reader.seeds.items():
        for content in seeds:
            path = tmp_path / f"whole{ending}"
            path.write_bytes(content)
            try:
                reader.read(path, None)
            except InputError as error:
                if "pip install" not in str(error):
                    raise
                pytest.skip("needs an extra")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in TRAPS if name not in HEAVY])
def test_traps(name):
    assert trapped(name)["faults"] == []
    assert not Path("/tmp/dlwpredict-pwned").exists()


def test_decimal_commas_are_read_right(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(TRAPS["decimal commas"][1]())
    heights = READERS["delimited text"].read(path, None).heights_um
    assert heights.tolist() == [[1.5, 2.5], [3.5, 4.5]]


@pytest.mark.parametrize(
    ("does", "said"),
    [
        (lambda path: 1 / 0, "ZeroDivisionError"),
        (lambda path: np.ones(3 * 2**27).sum(), "Unable to allocate"),
        (lambda path: __import__("os").write(2, b"hello"), "said hello"),
        (lambda path: Path("/etc/../tmp/other").write_text("x"), "touched open"),
        (lambda path: __import__("os").system("true"), "touched os.system"),
        (lambda path: __import__("warnings").warn("look", stacklevel=1), "UserWarning"),
        (lambda path: __import__("os")._exit(3), "process ended with status"),
        (lambda path: (_ for _ in ()).throw(InputError("no file named")), "said"),
    ],
)
def test_the_watch_sees_every_fault(tmp_path, does, said):
    reader = Reader("bad", (".txt",), lambda path, rng: does(path), {})
    found = watched(reader, 1, lambda rng: (".txt", b"1"), tmp_path)
    assert said in found["faults"][0]["fault"]
