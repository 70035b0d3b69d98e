"""Ways to damage a file: at random, but where it hurts: lengths, counts, numbers, members of archives."""

import gzip
import io
import re
import struct
import zipfile
import zlib

import numpy as np

WORDS = [
    b"nan", b"-inf", b"1e999", b"-1e308", b"1e-320", b"0", b"-1", b"1000000", b"4294967296", b"9" * 400, b"1,5",
    b"1.2.3", b"", b"BAD", b"***", b"0x10", b"1_0", "١".encode(), b"true", b"null", b"[]", b"{}", b"!!python/name:os",
    b"&a [*a]", b"%n", b"\0", b"\xff\xfe", b"../../x", b"<!ENTITY a 'b'>", b"\n", b";", b"\t", b"#", b"=",
]  # fmt: skip
INTEGERS = [0, 1, 2, 255, 65535, 10**6, 2**31 - 1, 2**31, 2**32 - 1, -1, 2**63 - 1, 10**12]
FLOATS = [float("nan"), float("inf"), -float("inf"), 1e308, 1e-320, -1.0, 0.0, 1e12]
NUMBER = re.compile(rb"[-+]?\d[\d.eE+-]*")


def damaged(rng: np.random.Generator, seeds: list[bytes]) -> bytes:
    """Return random bytes, or a whole file with one to four wounds."""
    if not seeds or rng.random() < 0.03:
        return rng.bytes(int(rng.integers(1, 600)))
    content = seeds[rng.integers(len(seeds))]
    content = _inside(rng, content) if rng.random() < 0.6 else _wounded(rng, content)
    return content or b"\n"


def _inside(rng: np.random.Generator, content: bytes) -> bytes:
    """Wound what is packed, and pack it again; what is not packed is wounded as it stands."""
    if content.startswith(b"\x1f\x8b"):
        return gzip.compress(_wounded(rng, gzip.decompress(content)), 1)
    if content.startswith(b"PK"):
        return _in_zip(rng, content)
    if content.startswith(b"\x89PNG"):
        return _in_png(rng, content)
    return _wounded(rng, content)


def _in_zip(rng: np.random.Generator, content: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    k = rng.integers(len(members))
    name, inner = members[k]
    fate = rng.integers(8)
    members[k] = ("../" * 3 + name if fate == 0 else name, inner if fate < 2 else _wounded(rng, inner))
    if fate == 1:
        members.pop(k)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, inner in members:
            archive.writestr(name, inner)
    return packed.getvalue()


def _in_png(rng: np.random.Generator, content: bytes) -> bytes:
    """Wound one chunk and mend its checksum."""
    chunks, at = [], 8
    while at < len(content):
        size = int.from_bytes(content[at : at + 4], "big")
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    k = rng.integers(len(chunks))
    chunks[k] = chunks[k][0], _wounded(rng, chunks[k][1] or b"\0")
    return content[:8] + b"".join(map(png_chunk, *zip(*chunks, strict=True)))


def png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _wounded(rng: np.random.Generator, content: bytes) -> bytes:
    for _ in range(rng.integers(1, 5)):
        content = WOUNDS[rng.integers(len(WOUNDS))](rng, content) if content else content
    return content


def _flip(rng, content):
    found = bytearray(content)
    for place in rng.integers(0, min(len(found), int(rng.choice([64, 10**6]))), rng.integers(1, 6)):
        found[place] = rng.integers(256)
    return bytes(found)


def _cut(rng, content):
    return content[: rng.integers(len(content))]


def _overwrite(rng, content, new):
    place = int(rng.integers(min(len(content), int(rng.choice([128, 10**6])))))
    return content[:place] + new + content[place + len(new) :]


def _integer(rng, content):
    value, width = INTEGERS[rng.integers(len(INTEGERS))], (1, 2, 4, 8)[rng.integers(4)]
    order = ("little", "big")[rng.integers(2)]
    return _overwrite(rng, content, (value % 2 ** (8 * width)).to_bytes(width, order))


def _float(rng, content):
    with np.errstate(all="ignore"):
        new = np.array(FLOATS[rng.integers(len(FLOATS))]).astype(("<f4", "<f8", ">f8")[rng.integers(3)])
    return _overwrite(rng, content, new.tobytes())


def _number(rng, content):
    """Put a strange word in the place of a number in a text."""
    places = [match.span() for match in NUMBER.finditer(content[:20000])]
    if not places:
        return _flip(rng, content)
    start, end = places[rng.integers(len(places))]
    return content[:start] + WORDS[rng.integers(len(WORDS))] + content[end:]


def _word(rng, content):
    place = rng.integers(len(content) + 1)
    return content[:place] + WORDS[rng.integers(len(WORDS))] + content[place:]


def _line(rng, content):
    """Drop, repeat or join lines: ragged rows."""
    lines = content.split(b"\n")
    k = rng.integers(len(lines))
    lines[k : k + 1] = [[], [lines[k]] * 2, [b"".join(lines[k : k + 2])], [lines[k] + b" " + lines[k]]][rng.integers(4)]
    return b"\n".join(lines)


def _delete(rng, content):
    start = rng.integers(len(content))
    return content[:start] + content[start + rng.integers(1, 40) :]


def _repeat(rng, content):
    start = rng.integers(len(content))
    piece = content[start : start + rng.integers(1, 200)]
    return content[:start] + piece * int(rng.integers(2, 30)) + content[start:]


def _separators(rng, content):
    old, new = (b",;\t .\n"[k : k + 1] for k in rng.integers(6, size=2))
    return content.replace(old, new)


WOUNDS = [_flip, _cut, _integer, _integer, _float, _number, _number, _word, _line, _delete, _repeat, _separators]
