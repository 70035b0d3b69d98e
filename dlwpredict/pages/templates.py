"""The templates of all pages: one look, one way to say numbers; what is inserted is shown, never obeyed."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

from dlwpredict.pages import words

_FILTERS = (
    *(words.length, words.significant, words.probability, words.percent, words.chance),
    *(words.estimate, words.change),
)
_FUNCTIONS = (
    *(words.sentence, words.separation, words.side, words.verdict, words.recording, words.left_out),
    words.work,
)


@cache
def template(name: str) -> Template:
    """Return a template of this folder, with the words of `words` as filters and functions."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({says.__name__: says for says in _FILTERS})
    environment.globals.update({says.__name__: says for says in _FUNCTIONS})
    return environment.get_template(name)
