"""Small instrument files of our own making, byte by byte from the layouts; nothing here uses the readers."""

import io
import struct
import zipfile

import numpy as np

NS = "http://www.opengps.eu/2008/ISO5436_2"


def letter_f():
    """An F, 12 rows x 9 columns, µm; no flip or turn maps it onto itself."""
    heights = np.zeros((12, 9))
    heights[1:11, 2:4] = 1.0
    heights[1:3, 2:8] = 2.0
    heights[5:7, 2:6] = 3.0
    return heights


def nms(
    raw, intensity=None, *, low_um=0.0, high_um=65.535, pitch_nm=(100.0, 300.0), version=b"OM_MS_2.0", levels=(0, 65535)
):
    """Heights as 16-bit levels (rows, cols), with or without the 8-bit intensity picture."""
    rows, cols = raw.shape
    head = bytearray(3468)
    struct.pack_into("<4i2d", head, 0, 2, 1, *levels, low_um, high_um)
    head[32 : 32 + len(version)] = version
    struct.pack_into("<2i2d", head, 1368, cols, rows, *pitch_nm)
    struct.pack_into("<i", head, 1416, int(intensity is not None))
    picture = b"" if intensity is None else intensity.astype(np.uint8).tobytes()
    return bytes(head) + raw.astype("<u2").tobytes() + picture


def ascii_sdf(heights_um, *, magic="aISO-1.0", pitch_m=(1e-7, 3e-7), missing=(), bad="BAD"):
    """Text SDF with heights as multiples of 1 nm; ``missing`` are (row, col) of points not measured."""
    rows, cols = heights_um.shape
    cells = np.rint(heights_um * 1000).astype(int).astype(object)
    for place in missing:
        cells[place] = bad
    header = {
        "ManufacID": "test",
        "CreateDate": "010120200000",
        "ModDate": "010120200000",
        "NumPoints": cols,
        "NumProfiles": rows,
        "Xscale": pitch_m[0],
        "Yscale": pitch_m[1],
        "Zscale": 1e-9,
        "Zresolution": -1,
        "Compression": 0,
        "DataType": 6,
        "CheckType": 0,
    }
    lines = [magic, *(f"{key} = {value}" for key, value in header.items()), "*"]
    lines += [" ".join(map(str, row)) for row in cells] + ["*", "*"]
    return "\r\n".join([*lines, ""]).encode()


def binary_sdf(heights_um, *, missing=()):
    """Binary SDF, ISO-1.0, 32-bit multiples of 1 nm; the lowest integer = not measured."""
    rows, cols = heights_um.shape
    values = np.rint(heights_um * 1000).astype("<i4")
    for place in missing:
        values[place] = -(2**31)
    head = struct.pack(
        "<8s10s12s12sHHdddd", b"bISO-1.0", b"test", b"010120200000", b"010120200000", cols, rows, 1e-7, 3e-7, 1e-9, -1
    )
    return head + struct.pack("<bbb", 0, 6, 0) + values.tobytes()


def gwy_component(name, kind, value):
    """One component of a Gwyddion object; ``value`` for objects is bytes from `gwy_object`."""
    head = name.encode() + b"\0" + kind.encode()
    if kind == "s":
        return head + value.encode() + b"\0"
    if kind == "D":
        return head + struct.pack("<I", value.size) + value.astype("<f8").tobytes()
    if kind == "o":
        return head + value
    return head + struct.pack({"i": "<i", "d": "<d", "b": "<?", "q": "<q"}[kind], value)


def gwy_object(name, components):
    body = b"".join(components)
    return name.encode() + b"\0" + struct.pack("<I", len(body)) + body


def gwy_field(values, *, size_m=(9e-7, 36e-7), unit="m", xy_unit="m"):
    rows, cols = values.shape
    parts = [
        gwy_component("xres", "i", cols),
        gwy_component("yres", "i", rows),
        gwy_component("xreal", "d", size_m[0]),
        gwy_component("yreal", "d", size_m[1]),
        gwy_component("si_unit_xy", "o", gwy_object("GwySIUnit", [gwy_component("unitstr", "s", xy_unit)])),
        gwy_component("si_unit_z", "o", gwy_object("GwySIUnit", [gwy_component("unitstr", "s", unit)])),
        gwy_component("data", "D", values),
    ]
    return gwy_object("GwyDataField", parts)


def gwy(channels, masks=()):
    """A container of (title, field) channels; ``masks`` are (number, values)."""
    parts = [gwy_component("/filename", "s", "a.gwy"), gwy_component("/0/data/visible", "b", True)]
    for number, (title, field) in enumerate(channels):
        parts += [gwy_component(f"/{number}/data", "o", field), gwy_component(f"/{number}/data/title", "s", title)]
    parts += [gwy_component(f"/{number}/mask", "o", gwy_field(values, unit="")) for number, values in masks]
    return b"GWYP" + gwy_object("GwyContainer", parts)


def main_xml(
    shape, *, prolog="", revision="ISO5436 - 2000", link="bindata/data.bin", valid="", kind="F", step=1.0, extra=""
):
    """The XML of an x3p of one layer with a pitch of 0.1 x 0.3 µm."""
    axis = "<{0}><AxisType>I</AxisType><DataType>D</DataType><Increment>{1}</Increment><Offset>0</Offset></{0}>"
    z = f"<CZ><AxisType>A</AxisType><DataType>{kind}</DataType><Increment>{step}</Increment><Offset>0</Offset></CZ>"
    valid = f"<ValidPointsLink>{valid}</ValidPointsLink>" if valid else ""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{prolog}<p:ISO5436_2 xmlns:p="{NS}">'
        f"<Record1><Revision>{revision}</Revision><FeatureType>SUR</FeatureType>"
        f"<Axes>{axis.format('CX', 1e-7)}{axis.format('CY', 3e-7)}{z}</Axes></Record1>{extra}"
        f"<Record3><MatrixDimension><SizeX>{shape[1]}</SizeX><SizeY>{shape[0]}</SizeY><SizeZ>1</SizeZ>"
        f"</MatrixDimension><DataLink><PointDataLink>{link}</PointDataLink>{valid}</DataLink></Record3>"
        "<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></p:ISO5436_2>"
    )


def x3p(xml, members):
    """A zip of main.xml and other members (name, content)."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in [("main.xml", xml), *members]:
            archive.writestr(name, content)
    return buffer.getvalue()


def tmd(heights_um, *, size_mm=(9e-4, 36e-4)):
    """TrueMap: magic, a comment of 24 bytes, sizes and heights in mm."""
    rows, cols = heights_um.shape
    head = b"Binary TrueMap Data File v2.0\r\n\0" + b"Created by TrueMap v6\r\n\0"
    return head + struct.pack("<2I4f", cols, rows, *size_mm, 0, 0) + (heights_um * 1e-3).astype("<f4").tobytes()
