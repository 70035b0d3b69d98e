"""Kill every command, fill the disk under it, and print what was found; an exception where a promise is broken."""

import argparse
import tempfile
import time
from pathlib import Path

from tests.crash.checks import full_disk, killed, read_only, two_at_once
from tests.crash.commands import BETWEEN, COMMANDS, inputs
from tests.crash.resume import resumed


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=50, help="kills per command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--command", choices=[*COMMANDS, "batch"], action="append", help="only these")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        source = root / "source"
        source.mkdir()
        inputs(source)
        for command in asked.command or [*COMMANDS, "batch"]:
            if command == "batch":
                print(f"batch, begun again: {dict(resumed(root / 'batch', asked.kills, asked.seed))}", flush=True)
                continue
            words, began = COMMANDS[command], time.perf_counter()
            found = killed(words, source, root / f"killed-{command}", asked.kills, asked.seed, BETWEEN.get(command))
            told = ", ".join(f"{count} {what}" for what, count in sorted(found.items()))
            print(f"{command}: {told}; {time.perf_counter() - began:.0f} s", flush=True)
            try:
                print(f"  full disk: {full_disk(words, source, root / f'full-{command}')}", flush=True)
            except OSError as error:
                print(f"  full disk: not tried, {error}", flush=True)
            print(f"  read-only folder: {read_only(words, source, root / f'closed-{command}')}", flush=True)
        words = ("convert", "large.tif", "out.csv")
        found = two_at_once(words, ("convert", "target.tif", "out.csv"), source, root / "two", asked.kills)
        print(f"two writers of one output: {dict(found)}")


if __name__ == "__main__":
    main()
