"""The mission, end to end: effects concealed by the press are named with class and side, or said not to be known."""

import pytest

from tests.mission import answered

NAMED = {
    "dose-memory": ({"gain": 0.1, "length_um": 8.0}, "print", True),
    "edge-drying": ({"depth_um": 0.15, "length_um": 3.0}, "print", True),
    "lateral-shrinkage": ({"strain": 0.02, "pin_height_um": 5.0}, "print", True),
    "shrinkage-nonlinearity": ({"exponent": 1.6}, "print", True),
    "galvo-lag": ({"lag_um": 0.3, "model": "time"}, "print", True),
    "vignetting": ({"strength": 0.15}, "print", False),
    "z-linearity": ({"periodic_um": 0.03, "period_um": 3.0}, "measurement", True),
    "slope-error": ({"bias_um": 0.05}, "measurement", True),
    "field-curvature": ({"sag_um": 0.1}, "measurement", False),
}
"""Settings, side, and whether nothing else could stand in its place."""

MOST_WORK = {0: 250, 1: 500}
"""Predictions of all recordings that a diagnosis may take, by the number of effects."""


@pytest.mark.parametrize("name", NAMED)
def test_a_concealed_effect_is_named(name):
    settings, side, alone = NAMED[name]
    found, work = answered({"name": name, **settings})
    assert found.verdict in ("identified", "ambiguous")
    first = found.named[0]
    assert name in first.names
    if alone:
        assert first.names == [name] and first.sides[side] == pytest.approx(1)
