"""Grey PNG, 16 bit on writing: what grey-level writers take. Levels mean heights only with a range.

The range and the size travel as Gwyddion's tEXt chunks (``Gwy::ZMin`` and ``Gwy::ZMax`` belong to level 0 and the
highest one, in metres), the pitch also at full precision as ``pitch_x_um`` and ``pitch_y_um``.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, require_size, um_per, unmarked
from dlwpredict.files.key_lines import key_lines, stored_facts
from dlwpredict.heightmap import HeightMap

_TOP_LEVEL = {"L": 255, "I;16": 65535, "I;16B": 65535}
_MOST_LEVELS = 65535


def read_png(path: Path, pitch_um: Pair | None) -> Stored:
    """Read grey levels of 8 or 16 bit with the range and the pitch that the file states, if any.

    Raises
    ------
    InputError
        Not a PNG, truncated, or not one grey channel.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngImageFile

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked here
            with Image.open(path, formats=["PNG"]) as picture:
                require_size(*picture.size)
                mode, levels = picture.mode, np.asarray(picture)
                text: dict[str, str] = dict(picture.text) if isinstance(picture, PngImageFile) else {}
    except InputError:
        raise
    except Exception as error:  # Pillow meets broken files with errors of every kind
        raise InputError(
            f"not a readable PNG ({type(error).__name__})", key="file", allowed="needs one grey channel of 16 bit"
        ) from None
    if mode not in _TOP_LEVEL:
        raise InputError(f"picture of type {mode}", key="channels", allowed="allowed: one grey channel of 8 or 16 bit")
    facts = stored_facts(text)
    if "pitch_um" not in facts and pitch_um is None:
        facts["pitch_um"] = _gwyddion_pitch(text, levels.shape)
    low_high = _gwyddion(text, ("ZMin", "ZMax"), "ZUnit")
    return Stored(levels, **facts, z_range_um=low_high, top_level=_TOP_LEVEL[mode])


def write_png(path: Path, height_map: HeightMap, *, z_range_um: Pair | None = None) -> list[str]:
    """Write 16-bit levels over the given range, or over lowest to highest height.

    Raises
    ------
    InputError
        Points that are not measured (a PNG has no such thing), or heights outside the range.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    heights = height_map.heights_um
    if missing := int(np.isnan(heights).sum()):
        raise InputError(f"{missing} points not measured", key="heights", allowed="a PNG has no NaN: use --fill")
    low, high = z_range_um or (float(heights.min()), float(heights.max()))
    if not low <= high:
        raise InputError(f"found {low:g} {high:g}", key="--z-range", allowed="allowed: the lower one first")
    if heights.min() < low or heights.max() > high:
        raise InputError(
            f"heights {heights.min():.6g} to {heights.max():.6g} µm",
            key="--z-range",
            allowed=f"allowed {low:g} to {high:g}",
        )
    levels = np.rint((heights - low) * (_MOST_LEVELS / (high - low) if high > low else 0.0)).astype(np.uint16)
    width, depth = height_map.size_um
    chunks = {"XReal": width, "YReal": depth, "ZMin": low, "ZMax": high}
    lines = {f"Gwy::{key}": repr(value * 1e-6) for key, value in chunks.items()}
    lines |= {"Gwy::XYUnit": "m", "Gwy::ZUnit": "m", "Gwy::Title": "Height", **key_lines(height_map)}
    info = PngInfo()
    for key, value in lines.items():
        info.add_text(key, value)
    Image.fromarray(levels).save(path, format="PNG", pnginfo=info)
    return unmarked(height_map)


def _gwyddion(text: dict[str, str], names: tuple[str, str], unit: str) -> Pair | None:
    """Return two lengths of Gwyddion's chunks in µm, or None where they are absent."""
    if not all(f"Gwy::{name}" in text for name in names):
        return None
    factor = um_per(text.get(f"Gwy::{unit}") or "m", f"Gwy::{unit}")
    values = []
    for name in names:
        value = text[f"Gwy::{name}"]
        try:
            values.append(factor * float(value))
        except ValueError:
            raise InputError(f"found {value}", key=f"Gwy::{name}", allowed="allowed: a number") from None
    return values[0], values[1]


def _gwyddion_pitch(text: dict[str, str], shape: tuple[int, ...]) -> Pair | None:
    size = _gwyddion(text, ("XReal", "YReal"), "XYUnit")
    return None if size is None else (size[0] / shape[1], size[1] / shape[0])


FORMAT = Format("16-bit grey PNG", (".png",), read_png, write_png)
