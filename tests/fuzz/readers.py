"""Every reader of the program, with small whole files that damage starts from.

Height-map formats come from the program's own list; a format that it gains is fuzzed without a word here, from
what its writer makes, else from `BUILT`, else from random bytes.
"""

import gzip
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.formats import formats
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.heightmap import HeightMap
from tests import instrument_files as built

F = built.letter_f() + 0.5
HOLES = np.where(F > 2, np.nan, F)
RAW = np.rint(F * 1000).astype(int)

BUILT: dict[str, list[bytes]] = {
    ".nms": [built.nms(RAW), built.nms(RAW, np.where(F > 2, 0, 9))],
    ".sdf": [built.ascii_sdf(F), built.ascii_sdf(F, missing=[(1, 2)]), built.binary_sdf(F, missing=[(1, 2)])],
    ".gwy": [
        built.gwy([("Height", built.gwy_field(F * 1e-6))]),
        built.gwy([("Height", built.gwy_field(F * 1e-6))], masks=[(0, (F > 2).astype(float))]),
    ],
    ".x3p": [
        built.x3p(built.main_xml(F.shape), [("bindata/data.bin", (F * 1e-6).astype("<f4").tobytes())]),
        built.x3p(built.main_xml(F.shape, kind="I", step=1e-9), [("bindata/data.bin", RAW.astype("<i2").tobytes())]),
    ],
    ".tmd": [built.tmd(F)],
    ".txt": [
        b"1,5;2,5;BAD\n3;4;nan\n0;1;2\n",
        b"\xef\xbb\xbf# Width: 5 \xc2\xb5m\n# Height: 5 um\n# Value units: nm\n1\t2\n3\t***\n",
        b"nm;0;1;2;3\n0;5;9;7;8\n1;5;6;7;9\n2;5;5;5;5\n",
        "1 2\r\n3 4\r\n".encode("utf-16"),
    ],
    ".stl": [
        b"solid a\n"
        + b"".join(
            b"facet normal 0 0 1\nouter loop\nvertex 0 0 %d\nvertex 3 0 1\nvertex 0 3 1\nendloop\nendfacet\n" % z
            for z in range(3)
        )
        + b"endsolid a\n"
    ],
}

PARAMETERS = [
    Path("configs/paper-defaults.yaml").read_bytes(),
    b"""format: dlwpredict-parameters/1
exposure_fwhm_xy_um: 5.0e-1
exposure_fwhm_z_um: 1.5
threshold: 0.5
crosslink_fwhm_xy_um: 7
crosslink_fwhm_z_um: 7.0
shrinkage_min: 0.7
shrinkage_max: 1.0
writing: {slicing_um: 0.1, hatching_um: 0.1, fast_axis: y}
effects: [{name: vignetting, strength: 0.05}, {name: dose-memory, gain: 0.1}]
undecided:
  effects: [vignetting]
  print: {exposure_fwhm_xy_um: 0.5, exposure_fwhm_z_um: 1.5, threshold: 0.5, crosslink_fwhm_xy_um: 7,
    crosslink_fwhm_z_um: 7.0, shrinkage_min: 0.7, shrinkage_max: 1.0, effects: [{name: vignetting}]}
  measurement: {exposure_fwhm_xy_um: 0.4, exposure_fwhm_z_um: 1.5, threshold: 0.5, crosslink_fwhm_xy_um: 7,
    crosslink_fwhm_z_um: 7.0, shrinkage_min: 0.7, shrinkage_max: 1.0, effects: [{name: field-curvature}]}
bounds: {threshold: [0.1, 0.9]}
intervals: {shrinkage_min: [0.6, 0.8]}
provenance: {command: a, inputs: {a.tif: 00ff}}
""",
]


@dataclass(frozen=True)
class Reader:
    """A reader of the program: what it is called, its endings, its call, and whole files by ending."""

    name: str
    endings: tuple[str, ...]
    read: Callable[[Path, np.random.Generator | None], object]
    seeds: dict[str, list[bytes]]


def readers() -> list[Reader]:
    """Return one reader per format of height maps, and that of parameter files."""
    found = [
        Reader(this.name, this.endings, _heights, {ending: _seeds(ending) for ending in this.endings})
        for this in dict.fromkeys(formats().values())
        if this.read
    ]
    return [*found, Reader("parameters", (".yaml",), lambda path, rng: read_parameters(path), {".yaml": PARAMETERS})]


def _heights(path: Path, rng: np.random.Generator | None) -> HeightMap:
    """Read as a user would, with or without the pitch; a height map must keep what its class promises."""
    pitch = (None, 0.5, (0.1, 0.3))[1 if rng is None else rng.integers(3)]
    heights = read_height_map(path, pitch_um=pitch, z_range_um=(0, 1) if path.suffix == ".png" else None)
    assert min(heights.shape) >= 2
    assert np.isfinite(heights.heights_um).any()
    assert not np.isinf(heights.heights_um).any()
    assert 0 < heights.dx_um < np.inf
    assert 0 < heights.dy_um < np.inf
    return heights


def _seeds(ending: str) -> list[bytes]:
    """Return whole files: what the program writes (with holes and marks where it can), and what stands in `BUILT`."""
    wanted = formats()[ending]
    maps = [HeightMap(F, 0.5, 0.25), HeightMap(HOLES, 0.5, 0.5, "relative", filled=F < 1)] if wanted.write else []
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for height_map in maps:
            path = Path(folder) / f"seed{ending}"
            try:
                write_height_map(path, height_map)
            except InputError:  # a format without NaN
                continue
            found.append(path.read_bytes())
    if ending.endswith(".gz"):
        return found + [gzip.compress(seed) for seed in BUILT[".txt"]]
    return found + BUILT.get(ending, BUILT[".txt"] if ending in (".csv", ".asc", ".dat") else [])
