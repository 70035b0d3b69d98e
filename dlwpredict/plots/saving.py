"""Figures as files: the same figure gives the same bytes."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from dlwpredict.files.atomic import replacing


def save(path: Path | str, figure: Figure, *, dpi: float = 200) -> None:
    """Write a figure whole or not at all; the same figure gives the same bytes."""
    with replacing(path) as temporary:
        temporary.write_bytes(drawn(figure, Path(path).suffix.lower().lstrip("."), dpi=dpi))


def drawn(figure: Figure, kind: str, *, dpi: float = 200) -> bytes:
    """Return a figure as png, pdf or svg; the same figure gives the same bytes (no date, no program name)."""
    silent = {
        "png": {"Software": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        "svg": {"Date": None, "Creator": None},
    }
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "dlwpredict"}):
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=silent.get(kind))
    return buffer.getvalue()
