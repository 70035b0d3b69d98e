"""The proof's machinery: what is drawn, sealed, asked, judged and counted. No verdict of the program is tested here."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from dlwpredict.alignment import align
from dlwpredict.effects import library
from dlwpredict.files import read_height_map
from dlwpredict.infer.recording import prepare
from tests.bench.cases import NEVER, in_terms_of
from tests.press import read_map
from tests.prove import __main__ as prove
from tests.prove import answer, judge, page, structures, table
from tests.prove.baselines import _forward
from tests.prove.hidden import FORMS, NAMED, OUTSIDE, form, named, of_press, outside
from tests.prove.linear import LIMIT_Z, coarser
from tests.prove.mix import (
    CLEAR,
    DEVELOPMENT_SEED,
    FINAL_SEED,
    FULL,
    MEASUREMENT,
    QUICK,
    ROW_UM,
    Draw,
    draw,
    listed,
    name_of,
)
from tests.prove.sealed import CLOSE, Bare, Folder, finer, press_of, seal, seals, shown, strength

SEED = 4

RAW = 23
"""A seed whose first null is recorded raw, far turned, with noise of rows; one structure, no error of form."""


def finding(*names, side="print", **parameters):
    return {"effects": list(names), "side": side, "p_value": 0.0, "gain": 50.0, "parameters": parameters}


def diagnosis(verdict, *findings, locations=()):
    seven = {name: {"value": value} for name, value in
             {"exposure_fwhm_xy_um": 0.5, "exposure_fwhm_z_um": 1.5, "threshold": 0.5, "crosslink_fwhm_xy_um": 7.0,
              "crosslink_fwhm_z_um": 7.0, "shrinkage_min": 0.7, "shrinkage_max": 1.0}.items()}  # fmt: skip
    model = {"rmse_um": 0.02, "parameters": seven}
    return {"verdict": verdict, "findings": list(findings), "locations": list(locations), "baseline": model,
            "extended": model, "remainder": {}, "not_testable": [], "noise_um": 0.01}  # fmt: skip


def truth(kind="single", *effects, index=0):
    process = {"focus_fwhm_xy_um": 0.5, "focus_fwhm_z_um": 1.5, "threshold": 0.5, "crosslink_fwhm_xy_um": 7.0,
               "crosslink_fwhm_z_um": 7.0, "shrinkage_min": 0.7, "shrinkage_max": 1.0}  # fmt: skip
    noise = {"sigma_um": 0.01, "white_um": 0.003, "correlation_um": 1.0, "kind": "gaussian"}
    return {"kind": kind, "index": index, "process": process, "noise": noise, "effects": list(effects),
            "structures": [{}] * 3, "pitch_um": 0.3, "sides_um": [[36.0, 36.0]] * 3, "raw": {},
            "form": None}  # fmt: skip


def wrong_form(times):
    return {"name": "form", "switch": "size", "value": 0.3, "times": times, "left_um": 0.004}


def effect(name, switch="strength", value=0.05, times=2.0, levelling=0.1, calibration=0.1, **entry):
    return {"name": name, "switch": switch, "value": value, "off": 0.0, "times": times, "power": 1.0,
            "z": LIMIT_Z * times, "levelling": levelling, "calibration": calibration, "raw_um": 0.02,
            "z_given": LIMIT_Z,
            "entry": {"name": name, switch: value, **entry}}  # fmt: skip


def result(name, what, told):
    answered = {"status": 0, "diagnosis": told}
    return {"name": name, "truth": what, "concealed": judge.concealments(what), "seconds": 10.0, "cpu_s": 9.0,
            "align_cpu_s": 0.0, "baselines": {}, **judge.said(answered), **judge.scored(what, told),
            "unseen_um": {"seven": 0.02, "diagnose": 0.01}}  # fmt: skip


def failed(name, what):
    told = judge.said({"status": 1, "complaint": "error: no"})
    return {"name": name, "truth": what, "concealed": judge.concealments(what), "seconds": 1.0, "baselines": {}, **told}


@pytest.fixture(scope="module")
def cases():
    """Right, wrong, silent and failed answers of several kinds."""
    dome = finding("vignetting", vignetting={"strength": {"value": 0.06, "low": 0.04, "high": 0.08}})
    return [
        result("a", truth("null"), diagnosis("none")),
        result("b", truth("null", index=1), diagnosis("identified", finding("curl"))),
        result("c", truth("single", effect("vignetting")), diagnosis("identified", dome)),
        result("d", truth("single", effect("vignetting", times=3.0), index=1), diagnosis("none")),
        failed("e", truth("single", effect("curl", "rise_um", times=4.0), index=2)),
        result("g", truth("form") | {"form": wrong_form(2.5)}, diagnosis("unexplained")),
        result("h", truth("form", index=1) | {"form": wrong_form(0.5)}, diagnosis("identified", finding("curl"))),
        failed("j", truth("form", index=2) | {"form": wrong_form(0.6)}),
        result(
            "i",
            truth("null", index=2) | {"form": wrong_form(1.5), "raw": {"pitch_um": 0.3, "turn_deg": 3.0}},
            diagnosis("unexplained"),
        ),
        result("f", truth("outside", effect("particle", "height_um", x_um=3.0, y_um=0.0)), diagnosis("unexplained")),
    ]


def test_mix_is_that_of_the_issue_and_seeds_are_apart():
    assert FULL == {"null": 60, "single": 90, "pair": 60, "outside": 40, "absorbed": 20, "measurement": 20, "form": 20}
    assert len(list(listed(FULL))) == sum(FULL.values()) == len({name_of(1, *job) for job in listed(FULL)})
    assert {kind for kind, _ in list(listed(FULL))[:16]} == set(FULL) == set(QUICK)
    assert DEVELOPMENT_SEED != FINAL_SEED
    assert not {name_of(DEVELOPMENT_SEED, *job) for job in listed(FULL)} & {
        name_of(FINAL_SEED, *job) for job in listed(FULL)
    }


def test_names_are_opaque():
    assert not any(word in name_of(SEED, kind, 0) for kind in FULL for word in (kind, kind[:3]))


def test_a_draw_depends_on_seed_and_place_alone():
    one, same, other, next_one = draw(1, "pair", 3), draw(1, "pair", 3), draw(2, "pair", 3), draw(1, "pair", 4)
    assert one == same and one.process != other.process and one.noise != next_one.noise
    assert all(0.3 <= times <= 5 for times in one.times)


def test_every_effect_and_everything_outside_has_its_turn():
    singles = {draw(SEED, "single", k).hidden[0].name for k in range(FULL["single"])}
    beyond = {draw(SEED, "outside", k).hidden[0].name for k in range(FULL["outside"])}
    assert singles == set(library()) - set(NEVER) and beyond == set(OUTSIDE) and len(beyond) >= 8


def test_absorbed_cases_are_twins_on_one_roughness_map_and_on_three_structures():
    alone, three = draw(SEED, "absorbed", 4), draw(SEED, "absorbed", 5)
    assert [one["kind"] for one in alone.structures] == ["air"] and alone.structures[0] in three.structures
    assert (alone.hidden, alone.times, alone.process) == (three.hidden, three.times, three.process)
    assert len(MEASUREMENT) == FULL["measurement"]
    assert sum(name in ("stitching", "misregistration") for name in MEASUREMENT) >= 10


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("upright", [False, True])
def test_structures_are_as_large_as_a_bench_prints_them_or_half_as_large(seed, upright):
    scale = (structures.HALF, structures.WHOLE)[seed % 2]
    given, kept = structures.several(np.random.default_rng(seed), scale, upright=upright)
    kinds = [one["kind"] for one in given]
    assert kept["kind"] not in kinds and len(set(kinds)) == len(kinds) in structures.COUNTS
    assert len(kinds) == 1 or all(set(kinds) & set(some) for some in (structures.SMOOTH, structures.STEPPED))
    assert not upright or set(kinds) <= set(structures.UPRIGHT)
    for one in (*given, kept):
        low, high = structures.SIZES_UM.get(one["kind"], structures.OTHERS_UM)
        for pitch_um in (structures.PITCHES_UM[scale][0], structures.COARSE_UM):
            part = structures.made(one, pitch_um)
            assert scale * low <= one["size_um"] <= scale * high and part.dx_um == pitch_um
            assert part.size_um[0] == pytest.approx(one["size_um"] + 2 * structures.MARGIN_UM, abs=2 * pitch_um)


@pytest.mark.parametrize("kind", [*structures.SMOOTH, *structures.STEPPED])
def test_what_is_upright_is_like_itself_in_no_other_turn(kind):
    part = structures.made(structures.drawn(kind, np.random.default_rng(1)), structures.COARSE_UM).heights_um
    same = [np.sqrt(np.mean((np.rot90(part, k) - part) ** 2)) < 0.1 * part.std() for k in (1, 2, 3)]
    assert any(same) == (kind not in structures.UPRIGHT)


def test_shares_of_the_mix_are_those_of_the_issue():
    cases = [draw(SEED, *job) for job in listed(FULL)]

    def share(chosen, among=cases):
        return np.mean([bool(chosen(one)) for one in among])

    others, raw = [one for one in cases if one.kind != "form"], [one for one in cases if one.raw]
    assert share(lambda one: one.raw) == pytest.approx(0.5, abs=0.1)
    assert share(lambda one: one.noise["row_um"]) == pytest.approx(0.25, abs=0.08)
    assert share(lambda one: one.form, others) == pytest.approx(0.5, abs=0.1)
    assert all(one.form and not one.hidden for one in cases if one.kind == "form")
    assert all(not one.noise["row_um"] or ROW_UM[0] <= one.noise["row_um"] <= ROW_UM[1] for one in cases)
    rows = [one for one in raw if one.noise["row_um"]]
    assert share(lambda one: one.raw["uneven_um"], rows) == pytest.approx(0.5, abs=0.2)
    assert all(0.05 <= abs(one.raw["uneven_um"]) <= 0.2 for one in rows if one.raw["uneven_um"])
    assert not any(one.raw["uneven_um"] for one in raw if not one.noise["row_um"])
    assert share(lambda one: abs(one.raw["turn_deg"]) <= 8, raw) == pytest.approx(0.5, abs=0.15)
    assert all(abs(one.raw["turn_deg"]) <= 8 or {s["kind"] for s in one.structures} <= set(structures.UPRIGHT)
               for one in raw)  # fmt: skip
    counts = [len(one.structures) for one in cases if one.kind == "single"]
    assert [counts.count(k) / len(counts) for k in structures.COUNTS] == pytest.approx(structures.SHARES, abs=0.12)
    pairs = [one for one in cases if one.kind == "pair"]
    assert share(lambda one: one.least == CLEAR and min(one.times) > CLEAR and one.spare, pairs) == 0.5


def test_an_error_of_form_is_a_process_and_no_effect():
    hidden = form(FORMS[1], np.random.default_rng(0))
    drawn = draw(SEED, "form", 0)
    press = press_of(drawn, [hidden.at(0.5)])
    assert press.effects == () and press.dose_conversion == 0.5
    assert all(0 < getattr(press, key) <= 0.5 for key in FORMS)
    assert not any(of_press(hidden.at(0.0))[key] for key in FORMS) and not drawn.hidden


def test_noise_on_coarser_pixels_is_that_of_their_means():
    rng, noise = np.random.default_rng(0), {"sigma_um": 0.0, "white_um": 0.004, "row_um": 0.006}
    fine = 0.004 * rng.standard_normal((600, 600)) + 0.006 * rng.standard_normal((600, 1))
    coarse, told = fine.reshape(300, 2, 300, 2).mean(axis=(1, 3)), coarser(noise, 0.25, 0.5)
    rows = coarse.mean(axis=1)
    assert rows.std() == pytest.approx(told["row_um"], rel=0.15)
    assert (coarse - rows[:, None]).std() == pytest.approx(told["white_um"], rel=0.02)


@pytest.mark.slow
def test_what_the_microscope_does_along_its_axis_turns_with_the_recording():
    lens = structures.drawn("lens", np.random.default_rng(2)) | {"size_um": 20.0}
    part = structures.made(lens, structures.COARSE_UM)
    hidden = named("slope-error", np.random.default_rng(0))

    def change(turn_deg, along):
        drawn = Draw("single", 0, draw(SEED, "null", 0).process, 0.0, {}, [], {}, (hidden,), (1.0,), {}, [],
                     raw={"turn_deg": turn_deg})  # fmt: skip
        changed, plain = (shown(drawn, [part], some)[0] for some in ([{"name": "slope-error", along: 0.05}], []))
        return (changed - plain)[12:-12, 12:-12]

    turned, along_y = change(90.0, "signed_x_um"), change(0.0, "signed_y_um")
    assert np.sqrt(np.mean((turned + along_y) ** 2)) < 0.05 * along_y.std()


def test_fine_targets_are_printed_on_their_own_pixels():
    assert (finer(0.2), finer(0.4), finer(structures.COARSE_UM)) == (1, 2, 2)


@pytest.mark.parametrize("name", sorted({*NAMED, *OUTSIDE}))
def test_what_is_drawn_is_what_the_press_knows(name):
    from tests.press.effect import make

    hidden = (named if name in NAMED else outside)(name, np.random.default_rng(3))
    assert make(hidden.at(hidden.probe)).name == name and hidden.low <= hidden.probe <= hidden.high
    assert hidden.at(1e9)[hidden.switch] == hidden.high


@pytest.fixture(scope="module")
def bare():
    drawn = draw(SEED, "single", list(NAMED).index("curl"))
    return Bare.of(drawn, drawn.limit_on)


@pytest.mark.slow
def test_a_plane_is_taken_by_levelling_and_a_parameter_by_calibration(bare):
    seen = bare.sight
    grids = [item.recording.target for item in seen.fit.data]
    plane = seen.shares([0.01 * np.broadcast_to(grid.x_um, grid.shape) for grid in grids])
    assert plane["levelling"] > 0.999 and plane["z"] < 0.1
    higher = seen.shares([0.02 * trace.heights_um for trace in seen.fit.traces])
    assert higher["levelling"] + higher["calibration"] > 0.999 and higher["calibration"] > 0.05


@pytest.mark.slow
@pytest.mark.long
def test_strength_is_the_wanted_multiple_of_the_limit(bare):
    found = strength(bare.drawn.hidden[0], 2.0, bare)
    assert found["times"] == pytest.approx(2.0, rel=CLOSE) and found["z"] == pytest.approx(2 * LIMIT_Z, rel=CLOSE)
    assert found["entry"]["rise_um"] == found["value"] != 0


@pytest.mark.slow
def test_an_effect_that_calibration_takes_whole_shows_nothing(bare):
    hidden = named("z-amplification", np.random.default_rng(0))
    found = bare.shares(hidden.at(hidden.probe))
    assert found["z"] < 0.1 * LIMIT_Z and found["levelling"] + found["calibration"] > 0.99


@pytest.fixture(scope="module")
def sealed_case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("prove")
    name = seal(folder, RAW, "null", 0)
    return folder, name, seals(folder, [name])[name]


@pytest.mark.slow
def test_the_program_is_given_opaque_maps_only(sealed_case):
    folder, name, _ = sealed_case
    files = sorted(file.name for file in Folder(folder).data(name).iterdir())
    drawn = draw(RAW, "null", 0)
    what = "raw" if drawn.raw else "recording"
    assert files == sorted(f"{one}_{k}.tif" for one in (what, "target") for k in range(len(drawn.structures)))
    content = b"".join(file.read_bytes() for file in Folder(folder).data(name).iterdir())
    assert not any(word in content for word in (b"null", b"sigma", b"threshold", b"seed", b"effect"))
    recording, target = (read_map(Folder(folder).data(name) / f"{one}_0.tif") for one in (what, "target"))
    assert (recording[0].shape == target[0].shape) != bool(drawn.raw)


def test_a_seal_opens_on_what_was_sealed_and_on_nothing_else(sealed_case):
    folder, name, sealed = sealed_case
    assert judge.opened(folder, name, sealed)["kind"] == "null"
    with pytest.raises(ValueError, match="truth: not what was sealed"):
        judge.opened(folder, name, {**sealed, "truth": "0" * 64})
    with pytest.raises(ValueError, match="maps: not what was sealed"):
        judge.opened(folder, name, {**sealed, "maps": {**sealed["maps"], "more.tif": ""}})


@pytest.mark.slow
def test_a_case_is_made_once_and_always_the_same(sealed_case, tmp_path):
    folder, name, sealed = sealed_case
    before = Folder(folder).truth(name).stat().st_mtime_ns
    assert seal(folder, RAW, "null", 0) == name and Folder(folder).truth(name).stat().st_mtime_ns == before
    seal(tmp_path, RAW, "null", 0)
    assert seals(tmp_path, [name])[name] == sealed


@pytest.mark.slow
def test_a_raw_recording_is_aligned_by_the_program_to_a_tenth_of_a_pixel(sealed_case):
    folder, name, _ = sealed_case
    place, drawn = Folder(folder), draw(RAW, "null", 0)
    truth = json.loads(place.truth(name).read_text())
    assert not drawn.form and drawn.noise["row_um"] > 0 and abs(truth["raw"]["turn_deg"]) > 20
    part = read_height_map(place.data(name) / "target_0.tif")
    report = align(read_height_map(place.data(name) / "raw_0.tif"), part).as_dict()
    pose, reach_um = truth["poses"][0], part.size_um[0] / 2
    away = np.hypot(*np.subtract(report["shift_um"], pose["shift_um"]))
    turned = np.radians((report["rotation_deg"] - pose["rotation_deg"] + 180) % 360 - 180)
    assert away + abs(turned) * reach_um < 0.1 * part.dx_um + 0.1 * truth["raw"]["pitch_um"]
    assert report["instrument_fast_axis_deg"] == pytest.approx(-report["rotation_deg"])


@pytest.mark.slow
def test_a_command_is_asked_for_its_own_seconds(tmp_path):
    busy = "sum(i * i for i in range(3_000_000))"
    status, complaint, cpu_s = answer.ran([sys.executable, "-c", busy], tmp_path)
    assert (status, complaint) == (0, "") and 0.05 < cpu_s < 30
    status, complaint, _ = answer.ran([sys.executable, "-c", "raise SystemExit('error: no')"], tmp_path)
    assert (status, complaint) == (1, "error: no")


def test_a_folder_sealed_otherwise_is_refused(tmp_path):
    made = {"seed": 1, "makers": "of yesterday", "jobs": [["null", 0]]}
    (tmp_path / "seal.json").write_text(json.dumps(made))
    with pytest.raises(ValueError, match="sealed: with other cases"):
        prove.sealed(tmp_path, 1, [("null", 0)], None)


def test_a_program_that_changes_while_it_is_asked_proves_nothing(tmp_path, monkeypatch):
    states = iter(["before", "after"])
    monkeypatch.setattr(prove, "code_sha256", lambda: next(states))
    monkeypatch.setattr(prove, "sealed", lambda *rest: {"cases": {}})
    monkeypatch.setattr(prove, "told", lambda *rest: [])
    with pytest.raises(ValueError, match="changed while it was asked"):
        prove.prove(tmp_path, SEED, [("null", 0)], every=9, processes=1)


def test_answers_are_kept_for_one_state_of_the_program(sealed_case, monkeypatch):
    folder, name, _ = sealed_case
    asked = []
    monkeypatch.setattr(answer, "ran", lambda command, where: asked.append(command) or (1, "error: no", 2.0))
    assert answer.ask(folder, name, "one")["complaint"] == "error: no"
    answer.ask(folder, name, "one")
    assert len(asked) == 1
    answer.ask(folder, name, "two")
    assert len(asked) == 2 and "align" in asked[0] and not any(name in word for word in asked[0][:6])


@pytest.mark.slow
def test_a_failure_of_the_program_is_an_answer(tmp_path):
    data = Folder(tmp_path).data("x")
    data.mkdir(parents=True)
    for what in ("target", "recording"):
        (data / f"{what}_0.tif").write_bytes(b"nothing")
    told = answer.ask(tmp_path, "x", "code")
    assert told["status"] == 1 and "target_0.tif" in told["complaint"]
    assert judge.said(told)["verdict"] == "failed"


def test_names_classes_sides_and_intervals_are_judged():
    right = finding("vignetting", "curl", vignetting={"strength": {"value": 0.06, "low": 0.04, "high": 0.08}})
    found = judge.scored(truth("single", effect("vignetting")), diagnosis("ambiguous", right))
    assert found["held"] == [True] and found["exact"] == [False] and not found["misnamed"] and not found["spurious"]
    assert found["intervals"][0]["covered"] and found["intervals"][0]["parameter"] == "vignetting.strength"
    wrong = judge.scored(
        truth("single", effect("vignetting", value=0.2)),
        diagnosis("identified", finding("field-curvature", side="measurement"), right),
    )
    turned = truth("single", effect("slope-error", "signed_x_um")) | {"raw": {"pitch_um": 0.3, "turn_deg": 80.0}}
    along = finding("slope-error", **{"slope-error": {"signed_x_um": {"value": 0.0, "low": 0.0, "high": 0.0}}})
    assert judge.scored(turned, diagnosis("identified", along))["intervals"] == []
    assert len(judge.scored(turned | {"raw": {}}, diagnosis("identified", along))["intervals"]) == 1
    assert wrong["misnamed"] and wrong["wrong_side"] and wrong["spurious"] == 1 and not wrong["first_held"]
    assert wrong["first_alike"] and wrong["held"] == [True] and not wrong["intervals"][0]["covered"]
    unsure = judge.scored(truth("single", effect("vignetting")), diagnosis("unexplained", finding("curl")))
    assert not unsure["misnamed"] and not unsure["wrong_side"] and unsure["detected"]


def test_two_effects_in_one_class_are_not_told_apart():
    both = truth("pair", effect("vignetting"), effect("curl"))
    one, two = finding("vignetting", "curl"), finding("curl", "dose-memory")
    for findings, held, apart in (
        ([one], [True, True], False),
        ([two, one], [True, True], True),
        ([two, finding("curl")], [False, True], False),
    ):
        found = judge.scored(both, diagnosis("ambiguous", *findings))
        assert found["held"] == held and found["apart"] is apart


def test_a_place_is_right_where_a_small_box_holds_the_spot():
    spot = truth("outside", effect("particle", "height_um", x_um=3.0, y_um=-4.0))
    box = {"pair": 0, "x_um": [1.0, 4.0], "y_um": [-6.0, -3.0]}
    assert judge.scored(spot, diagnosis("unexplained", locations=[box]))["place"] is True
    for far in ({"x_um": [9.0, 12.0], "y_um": [-6.0, -3.0]}, {"x_um": [-18.0, 18.0], "y_um": [-18.0, 18.0]}):
        far["pair"] = 2
        assert judge.scored(spot, diagnosis("unexplained", locations=[far]))["place"] is False
    assert judge.scored(truth("single", effect("curl")), diagnosis("none"))["place"] is None


def test_errors_of_the_seven_are_shares_of_their_ranges():
    what = truth("null")
    what["process"]["threshold"] = 0.59
    found = judge.scored(what, diagnosis("none"))["seven"]["baseline"]
    assert found["threshold"] == pytest.approx(-0.09 / 0.9) and found["shrinkage_min"] == 0


@pytest.mark.parametrize(
    ("what", "labels"),
    [
        (truth("single", effect("curl")), ["name hidden"]),
        (truth("single", effect("curl", calibration=0.6)), ["absorbed by calibration"]),
        (truth("absorbed", effect("astigmatism")), ["absorbed by calibration"]),
        (truth("pair", effect("curl"), effect("galvo-lag")), ["hidden behind another effect"]),
        (truth("single", effect("galvo-lag", levelling=0.9)), ["removed by levelling or registration"]),
        (truth("single", effect("curl", times=1.0, levelling=0.9)),
         ["removed by levelling or registration", "near the noise"]),
        (truth("null"), []),
        (truth("outside", effect("particle", "height_um")), []),
    ],
)  # fmt: skip
def test_concealment_is_told_by_what_takes_the_signature(what, labels):
    assert judge.concealments(what) == labels and set(labels) <= set(judge.CONCEALMENTS)


def test_wilson_interval_holds_the_share_and_narrows():
    assert table.wilson(0, 60) == pytest.approx([0.0, 0.0602], abs=1e-3)
    assert table.wilson(57, 60) == pytest.approx([0.863, 0.983], abs=2e-3)
    assert table.wilson(0, 0) == [0.0, 1.0]


@pytest.mark.parametrize(("angle_deg", "direction_deg"), [(85.0, 0.0), (4.0, 90.0), (178.0, 90.0)])
def test_a_focus_wider_along_one_axis_is_narrower_along_the_other(angle_deg, direction_deg):
    found = {
        "log_ratio": {"value": -0.17, "low": -0.22, "high": -0.12},
        "angle_deg": {"value": angle_deg, "low": angle_deg - 2, "high": angle_deg + 2},
    }
    concealed = {"name": "astigmatism", "log_ratio": 0.18, "angle_deg": direction_deg}
    turned = in_terms_of(concealed, found)
    assert turned["log_ratio"] == {"value": 0.17, "low": 0.12, "high": 0.22}
    q, p = (np.deg2rad(2 * one["angle_deg"]["value"]) for one in (found, turned))
    assert (-np.cos(q), -np.sin(q)) == pytest.approx((np.cos(p), np.sin(p)))
    assert in_terms_of(concealed | {"angle_deg": angle_deg}, found) == found


def test_every_name_of_the_library_stands_in_one_class():
    names = [name for several in table.CLASSES.values() for name in several]
    assert sorted(names) == sorted(library())


def test_every_number_names_its_cases_and_failures_count_as_wrong(cases):
    lines = {(line.group, line.what): line for line in table.rows(cases)}
    assert all(len(line.cases) == len(line.hits) for line in lines.values())
    plain = lines["null", "the process of the seven's form: anything said"]
    assert set(plain.cases) == {"a", "b"} and plain.value == 0.5
    assert lines["null", "an error of form: an effect named"].value == 0
    assert lines["null", "... unexplained"].value == 1
    assert lines["form", "below the limit: named with confidence"].cases == ["h"], "a refusal is no name"
    assert lines["form", "below the limit: named with confidence"].value == 1
    assert lines["form", "from twice the limit on: named with confidence"].value == 0
    assert lines["way: recorded raw", "answered without failure"].cases == ["i"]
    assert lines["work", "CPU seconds of a diagnosis, median"].value == 9
    detected = lines["single", "detected from twice the limit on"]
    assert dict(zip(detected.cases, detected.hits, strict=True)) == {"c": True, "d": False, "e": False}
    assert lines["all", "cases answered without failure"].value == pytest.approx(8 / 10)
    assert lines["outside", "from SNR 10 on: unexplained"].value == 1.0
    assert lines["size", "relative error of the strength, median"].value == pytest.approx(0.2)
    for label in judge.CONCEALMENTS:
        assert any(line.group == f"concealed: {label}" for line in lines.values())


def test_confusion_counts_every_case_once(cases):
    truths, answers, counts = table.confusion(cases)
    assert counts.sum() == sum(one["truth"]["kind"] != "form" for one in cases)
    assert counts[truths.index("dome"), answers.index("dome")] == 1
    assert counts[truths.index("nothing"), answers.index("dome")] == 1
    assert counts[truths.index("dome"), answers.index("failed")] == 1


def test_methods_are_compared_on_the_structure_kept(cases):
    errors = {"seven": 0.05, "smooth": 0.06, "stepwise": 0.03, "oracle": 0.0}
    beside = {m: {"rmse_um": 0.02, "unseen_um": e} for m, e in errors.items()}
    beside["stepwise"]["names"] = ["curl", "batwings"]
    found = {(line.group, line.what): line.value for line in table.rows([{**cases[2], "baselines": beside}])}
    gap = "gap between seven and oracle closed on the structure kept, median"
    assert found["method: diagnose", gap] == pytest.approx(1 - 0.01**2 / 0.05**2)
    assert found["method: oracle: true effect known", gap] == 1 and found["method: seven parameters alone", gap] == 0
    assert found["method: seven + smooth discrepancy", gap] < 0
    assert found["method: stepwise BIC", "first name is a true one"] == 0
    assert found["method: diagnose", "first name is a true one"] == 1


@pytest.mark.slow
def test_page_shows_what_stands_in_its_json(cases, tmp_path):
    page.publish(tmp_path, cases, {"seed": 1, "code": "f" * 64, "cases": {}}, command="make prove", every=6)
    text, summary = (tmp_path / "README.md").read_text(), json.loads((tmp_path / "summary.json").read_text())
    assert {case["name"] for case in json.loads((tmp_path / "cases.json").read_text())["cases"]} == set("abcdefghij")
    for line in summary["rows"]:
        if line["count"] and "hit" in line:
            assert f"{line['hit']} of {line['count']} = {line['value']:.1%}" in text
    for picture in ("confusion", "detection", "unseen", "intervals"):
        assert (tmp_path / f"{picture}.png").stat().st_size > 5000 and f"({picture}.png)" in text
    assert all(label in text for label in judge.CONCEALMENTS)
    listed_wrong = text.split("## Every case")[1]
    assert all(f"| `{name}` |" in listed_wrong for name in "bdeh")
    assert not any(f"| `{name}` |" in listed_wrong for name in "acfgi")


def test_stepwise_bic_finds_a_column_in_independent_noise_and_stops():
    class Column:
        def __init__(self, name):
            self.name = name

    rng = np.random.default_rng(0)
    columns, base = rng.standard_normal((3000, 4)), np.linalg.qr(rng.standard_normal((3000, 2)))[0]
    residual = 0.4 * columns[:, 2] + rng.standard_normal(3000)
    chosen, names = _forward([Column(n) for n in "abcd"], columns, residual, base)
    assert names == ["c"] and chosen[0][1] == pytest.approx(0.4, abs=0.06)


@pytest.mark.slow
@pytest.mark.long
def test_a_proof_runs_from_the_seal_to_the_page_and_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """The program is played by a stand-in that finds nothing; everything else is real."""
    asked, really = [], answer.ran

    def stand_in(command, where, longest_s=None):
        if "align" in command:
            return really(command, where)
        asked.append(where.name)
        out = {word: command[command.index(word) + 1] for word in ("-o", "--params-out")}
        told = diagnosis("none")
        seven = {name: one["value"] for name, one in told["baseline"]["parameters"].items()}
        Path(out["-o"]).write_text(yaml.safe_dump(told))
        Path(out["--params-out"]).write_text(yaml.safe_dump({"format": "dlwpredict-parameters/1", **seven}))
        return 0, "", 1.0

    monkeypatch.setattr(answer, "ran", stand_in)
    monkeypatch.setattr(prove, "code_sha256", lambda: "code")
    results, sealed = prove.prove(tmp_path, RAW, [("null", 0), ("null", 1)], every=9, processes=1)
    assert sorted(asked) == sorted(sealed["cases"]) == sorted(r["name"] for r in results) and len(asked) == 2
    assert [bool(r["baselines"]) for r in results] == [True, False]
    oracle = results[0]["baselines"]["oracle"]["unseen_um"]
    assert oracle < 0.01 < results[0]["unseen_um"]["seven"]  # the seven fitted, and the paper's defaults
    again, _ = prove.prove(tmp_path, RAW, [("null", 0), ("null", 1)], every=9, processes=1)
    assert len(asked) == 2 and again == json.loads(json.dumps(results))
    page.publish(tmp_path / "report", results, sealed, command="make prove", every=9)
    assert "2 of 2 = 100.0%" in (tmp_path / "report" / "README.md").read_text()


def test_the_page_tells_what_was_opened_before_the_rest_was_asked(tmp_path):
    place = Folder(tmp_path)
    for path in (place.answer("a"), place.answer("b"), place.result("a")):
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps({"code": "code"}))
    assert prove.opened_before(tmp_path, ["a", "b"], "code") == 0  # all were asked
    assert prove.opened_before(tmp_path, ["a", "b", "c"], "other") == 0  # of another state of the program
    assert prove.opened_before(tmp_path, ["a", "b", "c"], "code") == 1
    place.answer("c").write_text(json.dumps({"code": "code"}))
    assert prove.opened_before(tmp_path, ["a", "b", "c"], "code") == 1  # and stays so


def test_more_cases_join_those_of_an_earlier_report(tmp_path):
    """Of the same seed, makers, program and judge; no case twice."""
    seal_a = {"seed": 1, "makers": "m", "code": "c", "jobs": [["null", 0]], "cases": {"a": {}}, "opened_before": 0}
    seal_b = {**seal_a, "jobs": [["null", 1]], "cases": {"b": {}}}
    (tmp_path / "seal.json").write_text(json.dumps(seal_a))
    (tmp_path / "cases.json").write_text(json.dumps({"cases": [{"name": "a", "judge": judge.JUDGE}]}))
    results, union = prove.joined(tmp_path, [{"name": "b"}], seal_b)
    assert [one["name"] for one in results] == ["a", "b"]
    assert union == {
        **seal_a, "jobs": [["null", 0], ["null", 1]], "cases": {"a": {}, "b": {}}, "opened_before": 1
    }  # fmt: skip
    for key in ("seed", "makers", "code"):
        with pytest.raises(ValueError, match=f": {key}: is "):
            prove.joined(tmp_path, [], {**seal_b, key: "other"})
    with pytest.raises(ValueError, match="a was sealed in the run as well"):
        prove.joined(tmp_path, [], seal_a)
    (tmp_path / "cases.json").write_text(json.dumps({"cases": [{"name": "a", "judge": "other"}]}))
    with pytest.raises(ValueError, match=": judge: is other"):
        prove.joined(tmp_path, [], seal_b)


@pytest.mark.slow
def test_on_a_part_that_lies_turned_a_wall_reaches_no_point_that_counts():
    """What a microscope makes of walls 6 µm high is there beside them, and 0 elsewhere: no reading rings."""
    posts = structures.drawn("posts", np.random.default_rng(2))
    part = structures.made(posts, structures.COARSE_UM)
    hidden, entry = named("batwings", np.random.default_rng(0)), {"name": "batwings", "gain": 0.8, "fwhm_um": 0.9}
    drawn = Draw("single", 0, draw(SEED, "null", 0).process, 0.0, {}, [], {}, (hidden,), (1.0,), {}, [],
                 raw={"turn_deg": 20.0})  # fmt: skip
    changed, plain = (shown(drawn, [part], some)[0] for some in ([entry], []))
    counts = prepare(part, part.with_heights(plain)).used
    assert np.abs(changed - plain)[~counts].max() > 0.1
    assert np.abs(changed - plain)[counts].max() < 1e-6


def test_worker_processes_find_what_they_are_sent():
    """A process that is started anew does not import a package's `__main__`."""
    for work in (prove.seal, prove.judged):
        assert work.__module__ != prove.__name__
