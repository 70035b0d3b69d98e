"""Print and measure from the command line, like a real machine.

python -m tests.press print TARGET.tif -p PRESS.yaml -o PRINTED.tif
python -m tests.press measure PRINTED.tif -p MICROSCOPE.yaml -o RECORDING.tif --seed 1 --truth truth.yaml
"""

import argparse
import sys
from pathlib import Path

import yaml

from tests.press.config import load_microscope, load_press
from tests.press.effect import names
from tests.press.microscope import Microscope, measure
from tests.press.printer import Press, print_part
from tests.press.tiff import read_map, write_map


def parser():
    """Return the command line."""
    top = argparse.ArgumentParser(prog="python -m tests.press", description="A virtual press and microscope.")
    commands = top.add_subparsers(dest="command", required=True)
    for name, source, text in (
        ("print", "target", "print a target height map"),
        ("measure", "printed", "record a printed height map"),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument(source, type=Path, metavar=source.upper() + ".tif")
        command.add_argument("-p", "--parameters", type=Path, metavar="YAML", help="its settings; defaults without")
        command.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.tif")
        command.add_argument("--overwrite", action="store_true", help="replace an existing output")
    command.add_argument("--seed", type=int, help="of the noise; wins over the file's")
    command.add_argument("--truth", type=Path, metavar="YAML", help="write the true pose, in the words of align.yaml")
    commands.add_parser("effects", help="list the names of all effects")
    return top


def run_print(options):
    """Print one target."""
    heights, dx, dy = read_map(options.target)
    press = load_press(options.parameters) if options.parameters else Press()
    write_map(options.output, print_part(heights, dx, dy, press), dx, dy, overwrite=options.overwrite)


def run_measure(options):
    """Record one printed map."""
    heights, dx, dy = read_map(options.printed)
    scope = load_microscope(options.parameters) if options.parameters else Microscope()
    seen = measure(heights, dx, dy, scope, seed=options.seed)
    if options.truth and options.truth.exists() and not options.overwrite:
        raise FileExistsError(f"{options.truth}: exists, use --overwrite to replace it")
    write_map(options.output, seen.heights, seen.dx_um, seen.dy_um, overwrite=options.overwrite)
    if options.truth:
        options.truth.write_text(yaml.safe_dump({"format": "press-truth/1", **seen.truth}, sort_keys=False))


def run_effects(_):
    """List the effects."""
    for side in ("print", "measurement"):
        for inside in (True, False):
            for name in names(side=side, inside_library=inside):
                print(f"{name:24s} {side:12s} {'library' if inside else 'outside'}")


def main(arguments=None):
    """Run one command; a fault of the input is one line on stderr and exit code 1."""
    options = parser().parse_args(arguments)
    try:
        {"print": run_print, "measure": run_measure, "effects": run_effects}[options.command](options)
    except (OSError, ValueError, yaml.YAMLError) as fault:
        print(f"error: {str(fault).splitlines()[0]}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
