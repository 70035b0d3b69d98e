"""The table of mutants still fits the code, and its runner tells caught from missed."""

from pathlib import Path

import pytest

from tests.mutants.mutant import Mutant, mutants
from tests.mutants.run import ROOT, Copy, Outcome, copied, summary

MUTANTS = mutants()


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_every_mutant_still_applies(mutant):
    """Where this fails the line was rewritten: rewrite the entry in tests/mutants/table.yaml, or take it out."""
    changed = mutant.applied((ROOT / mutant.file).read_text(encoding="utf-8"))
    compile(changed, mutant.file, "exec")
    assert mutant.tests and all((ROOT / test).is_file() for test in mutant.tests)


def test_the_table_is_large_and_says_nothing_twice():
    assert len(MUTANTS) >= 100
    assert len({(mutant.file, mutant.old, mutant.new) for mutant in MUTANTS}) == len(MUTANTS)
    assert sum(bool(mutant.reason) for mutant in MUTANTS) < 0.1 * len(MUTANTS)


@pytest.fixture
def project(tmp_path) -> Path:
    root = tmp_path / "project"
    for folder in ("dlwpredict", "tests", ".git"):
        (root / folder).mkdir(parents=True)
    (root / "dlwpredict" / "__init__.py").write_text("")
    (root / "dlwpredict" / "sums.py").write_text("def double(x):\n    return 2 * x\n")
    (root / "tests" / "test_sums.py").write_text(
        "from dlwpredict.sums import double\n\n\ndef test_double():\n    assert double(2) == 4\n"
    )
    return root


def mutant(old: str, new: str, **reasons: str) -> Mutant:
    return Mutant("dlwpredict/sums.py", old, new, ("tests/test_sums.py",), **reasons)


@pytest.mark.slow
def test_the_runner_tells_caught_from_missed_and_leaves_the_checkout_alone(project):
    before = {path: path.read_bytes() for path in project.rglob("*") if path.is_file()}
    seen, unseen, odd = mutant("2 * x", "3 * x"), mutant("2 * x", "x + x", equivalent="a sum"), mutant("2 * x", "2 *")
    with copied(project, timeout_s=60.0) as copy:
        assert copy.root != project and not (copy.root / ".git").exists()
        copy.require_passing(["tests/test_sums.py"])
        outcomes = [copy.judge(one) for one in (seen, unseen, odd, mutant("2 * x", "x * x"))]
    assert [bool(outcome.by) for outcome in outcomes] == [True, False, True, False]
    assert {path: path.read_bytes() for path in project.rglob("*") if path.is_file()} == before
    said = summary(outcomes)
    assert "4 mutants, 2 caught, 2 survive, 1 of them equivalent" in said
    assert "equivalent: a sum" in said and said.count("NO REASON GIVEN") == 1


@pytest.mark.slow
def test_a_project_that_fails_by_itself_is_refused(project):
    (project / "tests" / "test_sums.py").write_text("def test_wrong():\n    assert False\n")
    with (
        copied(project) as copy,
        pytest.raises(SystemExit, match=r"without any mutant: FAILED tests/test_sums\.py"),
    ):
        copy.require_passing(["tests/test_sums.py"])


@pytest.mark.slow
@pytest.mark.long
def test_tests_that_do_not_end_have_caught_their_mutant(project):
    copy = Copy(project, timeout_s=5.0)
    assert copy.judge(mutant("return 2 * x", "while True: pass")).by == "no end"


def test_a_place_that_stands_twice_is_refused():
    with pytest.raises(ValueError, match="stands there 2 times"):
        mutant("x", "y").applied("x = x")
    assert "NO REASON" not in summary([Outcome(mutant("x", "y"), "tests/test_sums.py", 1.0)])
