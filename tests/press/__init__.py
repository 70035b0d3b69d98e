"""The virtual press and microscope: an independent judge that knows nothing of `dlwpredict`.

A target goes in, a printed part comes out (`print_part`), and a recording of it is taken (`measure`). The numerics are
voxels and dense banded matrices; nothing here is shared with the program under test, and a test says so.

Conventions (contract.md): lengths in um, `heights[row, column]`, row 0 is the top, y grows upwards and is the fast scan
axis, x is the hatch axis, z = 0 is the substrate, height 0 = nothing written, NaN = not measured.
"""

from tests.press.config import load_microscope, load_press, microscope_from, press_from
from tests.press.effect import names
from tests.press.microscope import Microscope, Pose, Recording, measure
from tests.press.printer import Press, print_part
from tests.press.tiff import read_map, write_map

__all__ = [
    "Microscope",
    "Pose",
    "Press",
    "Recording",
    "load_microscope",
    "load_press",
    "measure",
    "microscope_from",
    "names",
    "press_from",
    "print_part",
    "read_map",
    "write_map",
]
