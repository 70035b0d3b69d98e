"""What a story comes to: its words, the claims that it makes good or does not, its pictures and figures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Claim:
    """One step of a story as it was to be told, and whether the run bears it out.

    Parameters
    ----------
    words : str
        The claim, with what decides it.
    found : str
        What the run gave.
    holds : bool
    """

    words: str
    found: str
    holds: bool


@dataclass(frozen=True)
class Told:
    """A story after its run.

    Parameters
    ----------
    title : str
    concealed : str
        What the program was not told.
    text : str
        Markdown; every number is taken from the run.
    claims : tuple of Claim
    pictures : dict of str to str
        File and caption.
    figures : dict
        All numbers, for `figures.json`.
    """

    title: str
    concealed: str
    text: str
    claims: tuple[Claim, ...]
    pictures: dict[str, str]
    figures: dict[str, Any] = field(repr=False)


def nm(value_um: float) -> str:
    """Return a length in µm as nm.

    >>> nm(0.01234)
    '12.3 nm'
    """
    return f"{1e3 * value_um:.1f} nm"


def verdict(diagnosis: dict[str, Any]) -> str:
    """Return a diagnosis in short: the verdict and its classes.

    >>> verdict({"verdict": "ambiguous", "findings": [{"effects": ["curl", "vignetting"]}, {"effects": ["galvo-lag"]}]})
    'ambiguous: curl or vignetting; galvo-lag'
    """
    classes = "; ".join(" or ".join(one["effects"]) for one in diagnosis["findings"])
    return f"{diagnosis['verdict']}{': ' + classes if classes else ''}"


def first_class(diagnosis: dict[str, Any]) -> list[str]:
    """Return the members of the strongest finding."""
    return diagnosis["findings"][0]["effects"] if diagnosis["findings"] else []


def besides(diagnosis: dict[str, Any], name: str) -> str:
    """Return a sentence on findings that do not hold what was concealed; nothing where there are none.

    >>> besides({"findings": [{"effects": ["curl"]}, {"effects": ["z-drift", "z-linearity"]}]}, "curl")
    ' What else it names (z-drift or z-linearity) was not there.'
    """
    others = "; ".join(" or ".join(one["effects"]) for one in diagnosis["findings"] if name not in one["effects"])
    return f" What else it names ({others}) was not there." if others else ""
