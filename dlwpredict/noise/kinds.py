"""The search: which kind of correlation, which grain, and where in its parameters a noise model is most likely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.likelihood import Likelihood, model_at

SMOOTHNESSES = (0.5, 1.5, np.inf)
"""Kinds of correlation that are tried: a rough one, Matérn's, a Gaussian. Taken for Matérn's, noise that an instrument
has smoothed would come out three times as long."""

GRAINS_PX = (0.0, 0.4, 0.5, 0.6, 0.7, 0.9, 1.2)
"""Grains that are tried, until a coarser one is less likely. Of white noise, neighbours then share 0, 4, 12, 22, 32,
49, 64 %. Read off by `align`, they share 13 % where the recording is 0.9 times as coarse as the map, 34 % where it is
1.2 times, 69 % where it is twice."""

WITHOUT_GAIN = 2
"""Grains in a row without gain that end the search: the finest hardly differs from none, and its gain may be hidden."""

CHANCE = 3.84
"""A grain is taken where −2 ln L of the points looked at falls by more: by chance in 5 % of cases."""

SHARES, LENGTHS_PX = (-1.5, 0.5, 2.5), (1.0, 2.0, 4.0, 8.0)
"""Logits of the share and lengths where the search begins: two of the first steps apart, so parabolas meet."""

STEPS = np.array([[0.8, 0.35], [0.4, 0.2], [0.2, 0.1]])
"""Steps in the logit of the share and the logarithm of the length of the parabolas that lead to the maximum."""

NINE = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=float)
"""Places of a parabola, in steps."""

PARABOLA = np.linalg.pinv(
    np.stack([np.ones(9), *NINE.T, NINE[:, 0] ** 2 / 2, NINE.prod(axis=1), NINE[:, 1] ** 2 / 2], 1)
)
"""From its values there to 1, u, v, u²/2, u·v, v²/2."""


def most_likely(
    likelihood: Likelihood, like: Noise, kinds: Sequence[float], grains_px: Sequence[float]
) -> tuple[Noise, np.ndarray, dict[float, float]]:
    """Return the most likely model, over the kinds of correlation and the grains, its place, and −2 ln L by kind.

    From grain to grain, every kind goes on from where it was, until `WITHOUT_GAIN` have been no likelier.
    """
    templates = [replace(like, smoothness=kind, grain_um=grains_px[0] * like.pitch_um) for kind in kinds]
    lengths = np.minimum(np.log(like.pitch_um * np.array(LENGTHS_PX)), likelihood.bounds(like.pitch_um)[1, 1])
    grid = np.array([(share, length) for share in SHARES for length in lengths])
    rough, _ = likelihood.profiled([(template, place) for template in templates for place in grid])
    ends = _polished(likelihood, templates, grid[rough[:, 0].reshape(len(kinds), -1).argmin(axis=1)], STEPS)
    tried = [ends]
    for grain in grains_px[1:]:
        templates = [replace(template, grain_um=grain * like.pitch_um) for template in templates]
        ends = _polished(likelihood, templates, [end[:2] for _, end in ends], STEPS[1:])
        tried.append(ends)
        if int(np.argmin(_deviances(tried).min(axis=1))) < len(tried) - WITHOUT_GAIN:
            break
    leads = [CHANCE * likelihood.share if grain else 0.0 for grain in grains_px[: len(tried)]]
    deviances = _deviances(tried)
    grain = int(np.argmin(deviances.min(axis=1) + leads))
    kind = int(np.argmin(deviances[grain]))
    model = replace(templates[kind], grain_um=grains_px[grain] * like.pitch_um)
    _, place = tried[grain][kind]
    return model_at(model, place), place, dict(zip(kinds, deviances[grain].tolist(), strict=True))


def _deviances(tried: Sequence[Sequence[tuple[float, np.ndarray]]]) -> np.ndarray:
    """Return −2 ln L of every grain and kind, shape (grains, kinds)."""
    return np.array([[deviance for deviance, _ in ends] for ends in tried])


def _polished(
    likelihood: Likelihood, templates: Sequence[Noise], places: Sequence[np.ndarray], steps: np.ndarray
) -> list[tuple[float, np.ndarray]]:
    """Return −2 ln L and place (with the scale) where parabolas of ever smaller steps lead, of each template."""
    low, high = likelihood.bounds(templates[0].pitch_um)
    for step in steps:
        around = [(model, place + step * node) for model, place in zip(templates, places, strict=True) for node in NINE]
        deviances, _ = likelihood.profiled(around)
        moves = [lowest_of(PARABOLA @ nine, 2.0) for nine in deviances[:, 0].reshape(-1, 9)]
        places = [np.clip(place + step * move, low, high) for place, move in zip(places, moves, strict=True)]
    deviances, scales = likelihood.profiled(list(zip(templates, places, strict=True)))
    return list(zip(deviances[:, 0], np.column_stack([places, scales[:, 0]]), strict=True))


def lowest_of(terms: np.ndarray, furthest: float) -> np.ndarray:
    """Return where a parabola is lowest, in steps, or in that direction where it does not bend upwards."""
    _, along, across, aa, ab, bb = terms
    values, vectors = np.linalg.eigh(np.array([[aa, ab], [ab, bb]]))
    move = -vectors @ (vectors.T @ np.array([along, across]) / np.maximum(values, 0.2))
    return np.clip(move, -furthest, furthest)
