"""Files built to hurt: bombs, claims, references to other files, code. Each names what the refusal has to say."""

import gzip
import io
import pickle
import struct
import zipfile
import zlib

import numpy as np

from dlwpredict.parameters import Paper, declarations
from tests import instrument_files as built
from tests.fuzz.damage import png_chunk
from tests.fuzz.readers import F

MILLION = 10**6
HEIGHTS = (F * 1e-6).astype("<f4").tobytes()


def tiff(width, height, data=b"\0" * 64, *, compression=1, description=b"", next_page=0, count=None):
    """A little-endian float32 TIFF of one strip, written tag by tag."""
    place = 8 + 2 + 12 * 10 + 4
    tags = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 32), (259, 3, 1, compression), (262, 3, 1, 1),
        (270, 2, len(description) or 1, place if description else 0),
        (273, 4, 1, place + len(description)), (278, 4, 1, height), (279, 4, 1, count or len(data)), (339, 3, 1, 3),
    ]  # fmt: skip
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return b"II*\0\x08\0\0\0" + directory + struct.pack("<I", next_page) + description + data


def npy(header: str, data=b"\0" * 64):
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def png(width, height, data, *, bits=8, extra=b""):
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + extra + png_chunk(b"IDAT", data) + png_chunk(b"IEND", b"")


def stl(corners):
    """Binary triangles, corners (n, 3, 3)."""
    records = np.zeros(len(corners), np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("s", "<u2")]))
    records["c"] = corners
    return b"trap".ljust(80, b"\0") + struct.pack("<I", len(corners)) + records.tobytes()


def zeros(size: int) -> bytes:
    """Deflate that many zeros; a block that is packed once is repeated, and the checksum left wrong."""
    packer = zlib.compressobj(9)
    head = packer.compress(b"\0" * 2**20) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(b"\0" * 2**20) + packer.flush(zlib.Z_FULL_FLUSH)
    return head + block * ((size >> 20) - 1) + packer.flush()


def x3p(members, **xml):
    return built.x3p(built.main_xml(F.shape, **xml), members)


def nested_zip():
    """Forty million bytes inside a zip inside a zip."""
    inner = built.x3p("", [("a", b"\0" * 4 * 10**7)])
    return built.x3p(inner, [("bindata/data.bin", inner)])


class Touch:
    """Pickled, it would make a file."""

    def __reduce__(self):
        return open, ("/tmp/dlwpredict-pwned", "w")


BILLION = "<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {b} '{f'&{a};' * 10}'>" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
OUTSIDE = "<!DOCTYPE x [<!ENTITY e SYSTEM 'file:///etc/passwd'>]>"
OME = b'<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">' + (
    b'<Pixels ID="P:0" DimensionOrder="XYCZT" Type="float" SizeX="4" SizeY="4" SizeZ="1" SizeC="2" SizeT="1">'
    b'<TiffData IFD="0" FirstC="1"><UUID FileName="../../etc/passwd">a</UUID></TiffData></Pixels></Image></OME>\0'
)
SEVEN = "".join(f"{name}: 0.5\n" for name in declarations(Paper))
LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
PARAMETERS = f"format: dlwpredict-parameters/1\n{SEVEN}"
BIG_TRIANGLES = np.array([[[0, 0, 0], [1.2e3, 0, 1], [0, 1.2e3, 1]], [[1.2e3, 1.2e3, 0], [0, 1.2e3, 0], [1.2e3, 0, 0]]])

TRAPS = {
    "claims 10^6 x 10^6": (".tif", lambda: tiff(MILLION, MILLION), "shape: 1000000 x 1000000 points, at most"),
    "claims them packed": (".tif", lambda: tiff(MILLION, MILLION, zeros(2**20), compression=8), "shape: 1000000 x"),
    "20000 x 20000 in 2 MB": (".tif", lambda: tiff(20000, 20000, zeros(2**30), compression=8), "shape: 20000 x 20000"),
    "8192 x 8192 in nothing": (".tif", lambda: tiff(8192, 8192), "not a readable TIFF"),
    "page after page": (".tif", lambda: tiff(4, 4, next_page=8), None),
    "strip beyond the end": (".tif", lambda: tiff(4, 4, count=2**32 - 1), None),
    "OME that names a file": (".tif", lambda: tiff(4, 4, description=OME), None),
    "ImageJ of 10^6 pages": (".tif", lambda: tiff(4, 4, description=b"ImageJ=1\nimages=1000000\n\0"), None),
    "header of 10^6 x 10^6": (
        ".npy",
        lambda: npy(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({MILLION}, {MILLION}), }}"),
        "not a readable .npy",
    ),
    "header of code": (
        ".npy",
        lambda: npy("{'descr': __import__('os').system('touch /tmp/dlwpredict-pwned'), 'shape': (1, 1)}"),
        "not a readable .npy",
    ),
    "header of brackets": (".npy", lambda: npy("[" * 9000), "not a readable .npy"),
    "pickle as npy": (".npy", lambda: pickle.dumps(Touch()), "not a readable .npy"),
    "array of objects": (
        ".npy",
        lambda: npy("{'descr': '|O', 'fortran_order': False, 'shape': (2, 2), }", pickle.dumps([Touch()] * 4)),
        "not a readable .npy",
    ),
    "fields of 1 GB": (
        ".npy",
        lambda: npy("{'descr': '|V1073741824', 'fortran_order': False, 'shape': (2, 2), }"),
        "not a readable .npy|type",
    ),
    "field of 10^6 x 10^6": (
        ".gsf",
        lambda: b"Gwyddion Simple Field 1.0\nXRes = 1000000\nYRes = 1000000\n\0\0",
        "shape: 1000000 x 1000000",
    ),
    "field of 1e300": (".gsf", lambda: b"Gwyddion Simple Field 1.0\nXRes = 1e300\nYRes = 2\n\0\0", "shape: "),
    "picture of 10^6 x 10^6": (".png", lambda: png(MILLION, MILLION, zeros(2**20)), "not a readable PNG|shape"),
    "30000 x 5000 in 150 kB": (".png", lambda: png(30000, 5000, zeros(151 * 2**20)), "shape: 30000 x 5000"),
    "text of 1 GB in 1 MB": (
        ".png",
        lambda: png(4, 4, zlib.compress(b"\0" * 20), extra=png_chunk(b"zTXt", b"pitch_x_um\0\0" + zeros(2**30))),
        "not a readable PNG",
    ),
    "corners not a number": (".stl", lambda: stl(np.full((4, 3, 3), np.nan)), "triangles: no triangles, or not finite"),
    "corners at 1e30": (".stl", lambda: stl(np.eye(3)[None] * 1e30), "--pitch-um: .* allowed: up to 50000000 pixels"),
    "ASCII corners nan": (
        ".stl",
        lambda: b"solid\n" + b"vertex nan 0 0\n" * 3 + b"endsolid\n",
        "triangles: no triangles, or not finite",
    ),
    "4 billion triangles": (".stl", lambda: b"\0" * 80 + b"\xff" * 4 + b"\0" * 100, "not a whole STL"),
    "flat in one line": (".stl", lambda: stl(np.zeros((3, 3, 3))), "shape: height map of shape"),
    "64 MB of zeros in 300 kB": (".txt.gz", lambda: gzip.compress(b"0 " * 2**25, 1), "size: unpacks to more than"),
    "gzip in gzip": (".csv.gz", lambda: gzip.compress(gzip.compress(b"1 2\n3 4\n")), "not a text file|numbers"),
    "ragged": (".csv", lambda: b"1,2,3\n4,5\n6,7,8\n", "rows: line 2 has 2 values, line 1 has 3"),
    "decimal commas": (".csv", lambda: b"1,5;2,5\n3,5;4,5\n", None),
    "thousands and decimals": (".csv", lambda: b"1.234,5;2\n3;4\n", "numbers: found '1.234.5' in line 1, column 1"),
    "underscores": (".csv", lambda: b"1_000,2\n3,4\n", "numbers: found '1_000' in line 1, column 1"),
    "10^5 lines of one": (".txt", lambda: b"1\n" * 10**5, "shape: height map of shape"),
    "10^6 in one line": (".txt", lambda: b"1 " * MILLION, "shape: height map of shape"),
    "infinite": (".txt", lambda: b"1 1e999\n2 3\n", "heights: 1 infinite heights"),
    "billion laughs": (".yaml", lambda: (PARAMETERS + LAUGHS).encode(), r"found the alias \*a, no aliases"),
    "laughs as a value": (".yaml", lambda: (LAUGHS + "format: *i\n").encode(), r"found the alias \*a, no aliases"),
    "list in itself": (".yaml", lambda: b"format: &a [*a]\n", "found the alias"),
    "python call": (".yaml", lambda: b"a: !!python/object/apply:os.system ['touch /tmp/dlwpredict-pwned']\n", "tags"),
    "python name": (".yaml", lambda: b"effects: !!python/name:os.system\n", "tags"),
    "100000 brackets": (".yaml", lambda: b"a: " + b"[" * 10**5, "not plain YAML"),
    "100000 braces": (".yaml", lambda: b"{a: " * 10**5, "not plain YAML"),
    "a list as key": (".yaml", lambda: b"? [a, b]\n: 1\n", "not plain YAML"),
    "5000 keys": (".yaml", lambda: b"".join(b"k%d: 1\n" % k for k in range(5000)), "format: found None"),
    "10 MB": (".yaml", lambda: b"a: " + b"x" * 10**7, "file: 10000003 bytes, at most"),
    "number of 100000 digits": (".yaml", lambda: b"format: " + b"1" * 10**5, "YAML"),
    "hexadecimal beyond any float": (".yaml", lambda: b"format: 0x" + b"f" * 10**4, "an integer of 10002 digits"),
    "corners at 1e300": (
        ".stl",
        lambda: b"solid\n" + b"vertex 1e300 0 0\nvertex 0 1e300 0\nvertex 0 0 1e300\n" + b"endsolid\n",
        "triangles: no triangles, or not finite",
    ),
    "dates": (".yaml", lambda: b"format: 2001-99-99\n", "not plain YAML"),
    "binary": (".yaml", lambda: b"\x80\x81\x82", "not a text file"),
    "10^6 x 10^6 levels": (
        ".nms",
        lambda: built.nms(np.zeros((2, 2)))[:1368] + struct.pack("<2i2d", MILLION, MILLION, 1, 1) + b"\0" * 2100,
        "length: ",
    ),
    "surface of 10^6 x 10^6": (
        ".sdf",
        lambda: built.ascii_sdf(F).replace(b"NumPoints = 9", b"NumPoints = 1000000").replace(b"= 12", b"= 1000000"),
        "not a readable SDF",
    ),
    "binary of 65535 x 65535": (
        ".sdf",
        lambda: built.binary_sdf(F)[:42] + b"\xff" * 4 + built.binary_sdf(F)[46:],
        "not a readable SDF",
    ),
    "objects in objects": (".gwy", lambda: b"GWYP" + b"a\0\xff\xff\0\0a\0o" * 9000, "not a whole Gwyddion file"),
    "array of 4 billion": (
        ".gwy",
        lambda: b"GWYP" + built.gwy_object("GwyContainer", [b"/0/data\0D" + b"\xff" * 4]),
        "not a whole Gwyddion file",
    ),
    "list of 4 billion texts": (
        ".gwy",
        lambda: b"GWYP" + built.gwy_object("GwyContainer", [b"/0/data\0S" + b"\xff" * 4 + b"\0" * 10**6]),
        "not a whole Gwyddion file",
    ),
    "zip bomb in the heights": (".x3p", lambda: x3p([("bindata/data.bin", b"\0" * 2**30)]), "size: bindata/data.bin"),
    "zip bomb in the XML": (".x3p", lambda: built.x3p(b" " * 2**28, []), "size: main.xml unpacks to more"),
    "zip in zip": (".x3p", nested_zip, "not a readable x3p"),
    "entities": (".x3p", lambda: x3p([("bindata/data.bin", HEIGHTS)], prolog=f"{BILLION}]>", extra="&i;"), "x3p"),
    "entity of a file": (".x3p", lambda: x3p([("bindata/data.bin", HEIGHTS)], prolog=OUTSIDE, extra="&e;"), "x3p"),
    "path out of the archive": (".x3p", lambda: x3p([("../../pwned", b"x")]), "path: member '../../pwned' leads out"),
    "absolute path": (".x3p", lambda: x3p([("/tmp/dlwpredict-pwned", b"x")]), "leads out"),
    "link out of the archive": (".x3p", lambda: x3p([], link="../../../../etc/passwd"), "not a readable x3p"),
    "matrix of 10^6 x 10^6": (
        ".x3p",
        lambda: built.x3p(built.main_xml((MILLION, MILLION)), [("bindata/data.bin", HEIGHTS)]),
        "not a readable x3p",
    ),
    "many members": (".x3p", lambda: many_members(), "not a readable x3p"),
    "two large triangles": (".stl", lambda: stl(BIG_TRIANGLES), None),
}  # fmt: skip
"""Name: (ending, how to make it, what the refusal says; None where it is read)."""


HEAVY = ("zip bomb in the heights", "two large triangles")
"""Take seconds each: only in `make fuzz`."""


def many_members() -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for k in range(5000):
            archive.writestr(f"m{k}", b"")
    return packed.getvalue()
