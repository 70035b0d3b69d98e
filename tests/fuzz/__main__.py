"""Fuzz every reader and every command's door, and print a table; exit code 1 if there is any fault."""

import argparse
import re
import sys
import tempfile
from pathlib import Path

from dlwpredict.errors import InputError
from tests.fuzz.damage import damaged
from tests.fuzz.doors import doors
from tests.fuzz.readers import Reader, readers
from tests.fuzz.traps import TRAPS
from tests.fuzz.watch import watched


def fuzzed(reader: Reader, count: int, seed: int) -> dict:
    """Read damaged files, the endings in turn."""

    def make(rng):
        ending = reader.endings[rng.integers(len(reader.endings))]
        return ending, damaged(rng, reader.seeds[ending])

    with tempfile.TemporaryDirectory() as folder:
        return watched(reader, count, make, Path(folder), seed)


def trapped(name: str) -> dict:
    """Read a trap; the words of the refusal, or being read where there are none, are part of the promise."""
    ending, build, said = TRAPS[name]
    content = build()
    reader = next(reader for reader in readers() if ending in reader.endings)

    def read(path, rng):
        try:
            reader.read(path, None)
        except InputError as error:
            if said is None or not re.search(said, str(error)):
                raise AssertionError(f"said {error}") from None
            raise
        assert said is None, "was read"

    with tempfile.TemporaryDirectory() as folder:
        return watched(Reader(name, (ending,), read, {}), 1, lambda rng: (ending, content), Path(folder))


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=10_000, help="files per reader; a tenth per door")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", help="only readers whose name contains this")
    asked = parser.parse_args()
    faults = 0
    print(f"{'reader':24}{'inputs':>8}{'read':>8}{'refused':>9}{'faults':>8}{'slowest':>10}{'memory':>9}")
    counts = [(reader, asked.inputs) for reader in readers()] + [(door, max(asked.inputs // 10, 1)) for door in doors()]
    for reader, count in counts:
        if asked.reader and asked.reader not in reader.name:
            continue
        found = fuzzed(reader, count, asked.seed)
        ends = found["ends"]
        faults += ends.get("fault", 0)
        print(
            f"{reader.name:24}{sum(ends.values()):8}{ends.get('read', 0):8}{ends.get('refused', 0):9}"
            f"{ends.get('fault', 0):8}{found['slowest_s']:8.2f} s{found['largest_bytes'] / 2**20:6.0f} MB",
            flush=True,
        )
        for fault in found["faults"][:5]:
            print(f"  input {fault['number']} {fault.get('ending', '')}: {fault['fault'].strip()}", flush=True)
    for name in TRAPS if not asked.reader else ():
        found = trapped(name)
        faults += len(found["faults"])
        for fault in found["faults"]:
            print(f"  trap {name}: {fault['fault'].strip()}", flush=True)
    if not asked.reader:
        print(f"{len(TRAPS)} traps sprung")
    print(f"{faults} faults")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
