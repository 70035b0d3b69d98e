"""An earlier state of the program beside today's, on the same sealed cases."""

import json
import sys
from pathlib import Path

import pytest

from tests.bench import earlier


def case(kind: str, *times: float, verdict: str = "identified", held: tuple[bool, ...] = (), findings: int = 1) -> dict:
    """Return what the judge says of a case."""
    effects = [{"name": "curl", "times": one, "z": 5 * one} for one in times]
    truth = {"kind": kind, "effects": effects, "structures": [{}, {}], "form": None}
    said = [{"effects": ["curl"]}] * findings
    return {"name": kind, "truth": truth, "verdict": verdict, "detected": verdict != "none", "held": list(held),
            "findings": said, "cpu_s": 40.0}  # fmt: skip


def test_cases_count_where_both_answered_and_a_sign_test_tells_them_apart():
    good, bad = (case("pair", 3.0, 2.0, held=held) for held in ((True, True), (True, False)))
    today = [good] * 7 + [bad, good, {**good, "verdict": "failed"}]
    before: list = [bad] * 6 + [good] * 2 + [None, good]
    rows = {row.what: row for row in earlier.paired(today, before)}
    what = "two effects, both from 1.5 times their limits on: both in named classes"
    assert [sum(rows[f"{what}: {who}"].hits) for who in ("today", "then")] == [7, 2]
    assert len(rows[f"{what}: today"].hits) == 8  # where one of both has failed nothing is compared
    only = rows[f"{what}: only today right"]
    assert (sum(only.hits), len(only.hits)) == (6, 7)
    assert rows[f"{what}: as uneven by chance, p"].value == pytest.approx(2 * (1 + 7) / 2**7)
    assert rows["nothing in it: nothing said: today"].value is None


def test_strengths_decide_which_cases_count():
    today = [case("single", 1.9, held=(False,)), case("single", 2.1, held=(True,)), case("null", verdict="none")]
    rows = {row.what: row for row in earlier.paired(today, today)}
    assert rows["one effect, from twice its limit on: in a named class: then"].hits == [True]
    assert rows["nothing in it: nothing said: today"].hits == [True]
    assert rows["nothing in it: nothing named: today"].hits == [False]


def test_an_answer_on_file_is_not_asked_for_again_and_one_that_took_too_long_counts_for_nothing(tmp_path, monkeypatch):
    asked: list[str] = []

    def stand_in(place, name, program, longest_s):
        asked.append(f"{name} {Path(program).name} {longest_s:.0f}")
        return {"status": -1, "complaint": "took longer than 300 s", "cpu_s": 300.0, "seconds": 310.0}

    monkeypatch.setattr(earlier, "diagnosed", stand_in)
    answers = [earlier.asked(tmp_path, Path(sys.executable), "a") for _ in range(2)]
    assert asked == [f"a {Path(sys.executable).name} 300"] and answers[0] == answers[1]
    table = earlier.table_of([case("null")], answers[:1], "d83d3f1", "command")
    rows = {row["what"]: row for row in table["rows"]}
    assert rows["then: answered within 300 CPU s"]["hit"] == 0
    assert rows["CPU seconds, median: then, at most 300"]["value"] == 300.0
    assert json.dumps(table) and rows["every case: answered as well as it can be: today"]["count"] == 0


def test_a_case_that_align_could_not_lay_on_its_target_is_not_asked(tmp_path):
    """It would count as one that the earlier state had no answer to."""
    for place in ("data/a/target_0.tif", "data/a/raw_0.tif", "data/b/target_0.tif", "data/b/recording_0.tif"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / place).touch()
    assert [earlier.laid(tmp_path, name) for name in "ab"] == [False, True]
