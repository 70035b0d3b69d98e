"""The verdict: what is said beside names, for which data that no fit has seen must speak."""

from types import SimpleNamespace

import pytest

from dlwpredict.diagnosis.answer.words import sentence
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.diagnosis.structure.forms import Energy
from dlwpredict.effects import library

ONE, CLASS = ["curl"], ["curl", "vignetting"]


class Told(Diagnosis):
    """A diagnosis of which is known what its fits err by on recordings held out, µm, and whether its parts agree."""

    together = None

    def held_out_um(self, fitted):
        return fitted.unseen_um


def told(names, before_um=0.025, after_um=0.016, *, agree=None, parts=1, unexplained=False, left=0.0):
    """Return a diagnosis that explains its own data: from 20 to 15 nm.

    A recording is held out unless it is known by how much its recordings disagree: by 10 beside the baseline.
    """
    models = [
        SimpleNamespace(
            fit=SimpleNamespace(unseen_um=unseen, rmse_um=lambda own=own: own), unexplained=unexplained, left=rest
        )
        for unseen, own, rest in ((before_um, 0.020, 10.0), (after_um, 0.015, left))
    ]
    named = [SimpleNamespace(names=names, effect=library()[names[0]]())] if names else []
    holdout, nothing = () if agree else ("one",), [None] * 4
    found = Told((None,) * parts, (), *models, tuple(named), *nothing, Energy(10.0, 1e-9), (), (), holdout)
    found.__dict__["together"] = agree
    return found


NAMED = pytest.mark.parametrize(("names", "verdict"), [(ONE, "identified"), (CLASS, "ambiguous")])


@NAMED
@pytest.mark.parametrize(
    ("before_um", "after_um", "sure"),
    [(0.025, 0.016, True), (0.025, 0.025, False), (0.025, 0.030, False), (None, None, True), (0.025, None, True)],
)
def test_what_is_named_must_predict_better_what_was_held_out(names, verdict, before_um, after_um, sure):
    found = told(names, before_um, after_um)
    assert found.verdict == (verdict if sure else "unexplained")
    assert ("no certain name" in sentence(found)) is not sure
    assert ("that on recordings held out does not" in sentence(found)) is not sure
    assert "curl" in sentence(found)


@NAMED
@pytest.mark.parametrize(
    ("agree", "excess", "sure"),
    [(0.5, 9.0, True), (0.03, 9.0, True), (0.02, 9.0, False), (1e-9, 5.1, False), (1e-9, 4.9, True)],
)
@pytest.mark.parametrize(("parts", "each"), [(1, "block"), (2, "recording")])
def test_every_part_must_give_the_same_process_beside_what_is_named(names, verdict, agree, excess, sure, parts, each):
    """Or most of what they disagreed by is gone; however well they predict what was left out, from fewer data."""
    for after_um in (0.016, 0.030):
        found = told(names, after_um=after_um, agree=Energy(excess, agree), parts=parts)
        assert found.verdict == (verdict if sure else "unexplained")
        said = f"but every {each} alone would give another process beside it."
        assert sentence(found).endswith(said) is not sure


def test_a_lone_small_map_has_nothing_to_agree_with():
    found = told(ONE, after_um=0.030, agree=Energy(9.0, 1e-9))
    found.__dict__["together"] = None
    assert found.verdict == "identified"


def test_what_predicts_better_may_still_leave_most_without_a_name():
    found = told(ONE, 0.025, 0.016, unexplained=True, left=4.0)
    assert found.verdict == "unexplained"
    assert "explain 60% of it" in sentence(found)


def test_nothing_named_is_no_matter_of_other_data():
    assert told([], 0.025, 0.030).verdict == "none"
