"""The verdict: what is said beside names, for which data that no fit has seen must speak."""

from types import SimpleNamespace

import pytest

from dlwpredict.diagnosis.answer.words import sentence
from dlwpredict.diagnosis.judge import Diagnosis
from dlwpredict.effects import library

ONE, CLASS = ["curl"], ["curl", "vignetting"]


class Told(Diagnosis):
    """A diagnosis of which is known what its fits err by on recordings held out, µm."""

    def held_out_um(self, fitted):
        return fitted.unseen_um


def told(
    names, before_um=0.025, after_um=0.016, *, holdout=("one",), unexplained=False, found=10.0, left=0.0, gained=5.0
):
    """Return a diagnosis that explains its own data: from 20 to 15 nm; forms find 10 beside the baseline."""
    models = [
        SimpleNamespace(
            fit=SimpleNamespace(unseen_um=unseen, rmse_um=lambda own=own: own, cost=cost),
            unexplained=unexplained,
            left=rest,
        )
        for unseen, own, rest, cost in ((before_um, 0.020, found, 100.0), (after_um, 0.015, left, 100.0 - gained))
    ]
    named = [SimpleNamespace(names=names, effect=library()[names[0]]())] if names else []
    nothing = [None] * 5
    return Told((), (), *models, tuple(named), *nothing, (), (), holdout)


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
def test_what_was_left_out_in_turn_is_no_verdict(names, verdict):
    """A fit to fewer data predicts worse, right names or not."""
    found = told(names, after_um=0.030, holdout=())
    assert found.verdict == verdict and "no certain name" not in sentence(found)


def test_what_predicts_better_may_still_leave_most_without_a_name():
    found = told(ONE, 0.025, 0.016, unexplained=True, left=4.0)
    assert found.verdict == "unexplained"
    assert "explains 60% of it" in sentence(found)


@pytest.mark.parametrize(
    ("found", "left", "gained", "share"),
    [
        (10.0, 4.0, 5.0, 0.6),  # forms find more than a name has gained
        (4.0, 4.0, 36.0, 0.9),  # no form follows what the name explains
        (0.0, 4.0, 36.0, 0.9),
        (0.0, 0.0, 0.0, 1.0),
        (4.0, 10.0, 2.0, 1 / 6),
    ],
)
def test_what_a_name_gains_was_there_to_be_explained(found, left, gained, share):
    assert told(ONE, found=found, left=left, gained=gained).explained == pytest.approx(share)


def test_nothing_named_is_no_matter_of_other_data():
    assert told([], 0.025, 0.030).verdict == "none"
