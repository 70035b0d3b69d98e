"""The report of a run folder: what it shows, of whole and of partial runs, and what it refuses."""

import base64
import copy
import io
import json
import pickle
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from dlwpredict import designs
from dlwpredict.cli.app import app
from dlwpredict.errors import InputError
from dlwpredict.files import write_height_map
from dlwpredict.files.parameters_yaml import write_parameters
from dlwpredict.files.provenance import note_input, origin, running
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.metrology.score import score
from dlwpredict.pages.relief import relief
from dlwpredict.pages.report import changed_inputs, figures, page
from dlwpredict.pages.report_pictures import lead, pictures, reachable
from dlwpredict.pages.run_folder import read_run
from dlwpredict.pages.words import length as words_of
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict
from tests.chromium import chromium, needs_chromium
from tests.test_pages import Reader, ambiguous, images, invented

LETTER = designs.f(pitch_um=0.5)
TARGET = LETTER.with_heights(np.where(LETTER.heights_um > 0, LETTER.heights_um + 0.08 * LETTER.x_um, 0))
PROCESS = ParameterSet(intervals={"threshold": (0.45, 0.56), "shrinkage_min": (0.8, 0.9)})
ALIGNMENT = {
    "shift_um": [2.415, -1.593],
    "rotation_deg": 3.3816,
    "scale": [1.0, 1.0002],
    "tilt_mrad": [2.058, -3.272],
    "cc": 0.9974,
    "mirrored": False,
    "missing_fraction": 0.0539,
    "filled_points": 1571,
    "height_reference": "substrate",
    "uncertainty": {"shift_um": [0.023, 0.009], "scale": [0, 0], "tilt_mrad": [0.03, 0.02], "rotation_deg": 0.021},
}
CORRECTION = {
    "predictions": 7,
    "rmse_um": {"before": 0.856, "after": 0.00998},
    "reachable": {"fraction": 0.9664, "largest_um": 0.0431},
    "unreachable": {"points": 525},
}
CALIBRATION = {
    "format": "dlwpredict-calibration/1",
    "rmse_um": {"before": 0.1541, "after": 0.1416},
    "holdout": {"rmse_um": 0.1432},
    "parameters": {},
    "warnings": ["threshold is not identified by these structures"],
}


CORRECTED = TARGET.with_heights(1.2 * TARGET.heights_um)


@cache
def predicted(corrected=False):
    """Return what the defaults make of the target, or of its corrected design."""
    return predict(CORRECTED if corrected else TARGET, ParameterSet())


def printed(scale=1.0, seed=0):
    """Return a recording of a print: predicted, scaled, with noise and a hole."""
    heights = scale * predicted().heights_um
    heights = heights + np.random.default_rng(seed).normal(scale=0.01, size=TARGET.shape)
    heights[3:6, 4:9] = np.nan
    return TARGET.with_heights(heights)


def put(folder: Path, **files):
    """Write maps as NAME.tif, mappings as NAME.yaml, parameter sets as NAME.yaml."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        if isinstance(content, dict):
            (folder / f"{name}.yaml").write_text(yaml_text(content), encoding="utf-8")
        elif isinstance(content, ParameterSet):
            write_parameters(folder / f"{name}.yaml", content)
        else:
            write_height_map(folder / f"{name}.tif", content)
    return folder


PICTURES_OF = {}


def remembered(draw):
    """Return a drawing function with a memory: of what is the same in all of its bytes, a picture is drawn once."""

    def drawn(structure, pixels):
        key = draw, pickle.dumps(structure), pixels
        if key not in PICTURES_OF:
            PICTURES_OF[key] = draw(structure, pixels)
        return PICTURES_OF[key]

    return drawn


@pytest.fixture(autouse=True)
def drawn_once(monkeypatch):
    """Most of a report's time goes into its pictures, and most tests look at its words."""
    for draw in (lead, pictures):
        monkeypatch.setattr(f"dlwpredict.pages.report.{draw.__name__}", remembered(draw))


@pytest.fixture
def run(tmp_path):
    """A whole run: one structure with everything, a process, a diagnosis."""
    folder = tmp_path / "bench"
    put(folder / "letter", target=TARGET, recording=printed(), aligned=printed(), corrected=CORRECTED)
    put(folder / "letter", predicted=predicted(), reprinted=predicted(corrected=True))
    put(folder / "letter", align=ALIGNMENT, precompensation=CORRECTION)
    inputs = [folder / "letter/target.tif", folder / "letter/aligned.tif"]
    with running(["dlwpredict", "calibrate", "--pair", *map(str, inputs)]):
        for path in inputs:
            note_input(path)
        stated = origin()
    put(folder, process=replace(PROCESS, provenance=stated), calibration=CALIBRATION, diagnosis=invented(locations=[]))
    return folder


def report(folder, *words, output="report.html"):
    return CliRunner().invoke(app, ["report", str(folder), "-o", str(Path(folder).parent / output), *words])


def text_of(folder, **words):
    """Return the text of a report as read, and the page."""
    done = report(folder, **words)
    assert done.exit_code == 0, done.output
    whole = (folder.parent / words.get("output", "report.html")).read_text(encoding="utf-8")
    return " ".join(Reader(re.sub(r"<(script|style).*?</\1>", "", whole, flags=re.DOTALL)).text.split()), whole


@pytest.mark.slow
def test_the_report_shows_all_that_the_run_holds(run):
    text, whole = text_of(run)
    # three that lead; target, recording, print, prediction, design, reprint, three differences; profiles
    assert len(images(whole)) == 3 + 9 + 2
    said = ["letter: the print is", "2.415 ± 0.023, -1.593 ± 0.009", "3.382 ± 0.021", "5.39 %", "1571"]
    said += ["856 nm → 9.98 nm", "97 %", "43.1 nm", "525", "154 nm → 142 nm", "143 nm", *CALIBRATION["warnings"]]
    said += [
        "0.500 (0.450 to 0.560)",
        "exposure_fwhm_z_um",
        "0.700, outside its interval 0.8 to 0.9",
        "writing.fast_axis",
    ]
    said += ["identified – one effect is named", invented()["findings"][0]["statement"], "dlwpredict calibrate --pair"]
    said += [entry.sha256[:16] for entry in read_run(run).entries]
    assert [one for one in said if one not in text] == []


@pytest.mark.slow
def test_the_next_print_is_held_against_the_target(run):
    before = images(text_of(run)[1])
    put(run / "letter", next=predicted(corrected=True))
    text, whole = text_of(run, output="again.html")
    assert len(images(whole)) == len(before) + 2
    assert "Next print" in text and "Prediction − target" in text
    rows = {row.name: row.values for row in figures(read_run(run).structures[0])}
    assert rows["predicted print of the corrected design"] == rows["print of the corrected design"]
    assert not read_run(run).others
    (run / "letter/reprinted.tif").unlink()
    text, _ = text_of(run, output="predicted.html")
    assert "printed again" not in text and "times closer" not in text  # what is predicted is not printed yet


@pytest.mark.slow
def test_figures_are_those_of_the_score_command(run, tmp_path):
    words = [
        str(run / "letter/target.tif"),
        str(run / "letter/aligned.tif"),
        "--part-only",
        "--json",
        str(tmp_path / "s.json"),
    ]
    assert CliRunner().invoke(app, ["score", *words]).exit_code == 0
    expected = json.loads((tmp_path / "s.json").read_text())
    found = figures(read_run(run).structures[0])
    rows = {(row.name, row.reference): row for row in found}
    rows["print"] = rows["print", "target"]
    for key, value in expected["away_from_walls"].items():
        if key != "wall_px":
            assert rows["print"].away[key] == pytest.approx(value, rel=1e-6), key
    assert rows["print"].away["rmse_um"] < 0.9 * rows["print"].values["rmse_um"]
    assert rows["print"].values["material_ratio_range"] == tuple(expected["material_ratio_range"])
    for key in (
        "rmse_um",
        "rmse_offset_free_um",
        "cc",
        "alpha_z",
        "l_z_um",
        "sa_um",
        "sq_um",
        "sz_um",
        "valid_fraction",
    ):
        assert rows["print"].values[key] == pytest.approx(expected[key], rel=1e-6), key
    part = TARGET.heights_um > 0
    off = printed().heights_um[part] - predict(TARGET, ParameterSet()).heights_um[part]
    against = rows["print", "predicted print"].values
    assert against["rmse_um"] == pytest.approx(np.sqrt(np.nanmean(off**2)), rel=1e-4)
    assert against["mean_difference_um"] == pytest.approx(np.nanmean(off), abs=1e-6)  # as in score predicted aligned
    assert set(rows["target", ""].values) == {"sa_um", "sq_um", "sz_um"}
    text, _ = text_of(run)
    assert f"{expected['rmse_um']:.3f}" in text
    ends = [rows[name, "target"] for name in ("print", "print of the corrected design")]
    away = [words_of(one.away["rmse_um"]) for one in ends]
    whole = [words_of(one.values["rmse_um"]) for one in ends]
    said = f"the print is {away[0]} off its target (rms, away from walls and rim)"
    assert f"letter: {said}; printed again from the corrected design it is {away[1]} off." in text
    assert "letter: target, print, correction" in text
    assert all(one not in text.partition("Figures")[0] for one in whole)


@pytest.mark.slow
def test_of_relative_heights_the_headline_is_about_their_mean(tmp_path):
    """A millimetre of offset is nobody's error."""
    away = replace(TARGET, heights_um=printed().heights_um + 1e3, height_reference="relative")
    text, _ = text_of(put(tmp_path / "some", target=TARGET, aligned=away))
    lead = text.partition("Figures")[0]
    assert "mean difference taken off" in lead and "1.00e" not in lead and re.search(r"the print is \d+ nm off", lead)


def test_a_target_without_a_print_has_no_figures(tmp_path):
    assert figures(read_run(put(tmp_path / "bare", target=TARGET)).structures[0]) == []


@pytest.mark.slow
def test_generations_stand_in_order_under_their_part(tmp_path):
    folder = put(tmp_path / "runs" / "letter", target=TARGET)
    for k, scale in ((0, 0.8), (2, 1.02), (10, 1.1)):
        written = TARGET if k == 0 else TARGET.with_heights(TARGET.heights_um / scale)
        put(folder / f"g{k}", written=written, aligned=printed(scale, k), align=ALIGNMENT)
    for start in (folder, folder.parent):
        (structure,) = read_run(start).structures
        assert [one.name for one in structure.prints] == ["g0", "g2", "g10"]
        errors = [row.values["rmse_um"] for row in figures(structure)[1:]]
        assert [row.name for row in figures(structure)] == ["target", "print g0", "print g2", "print g10"]
        assert np.all(np.diff(errors) < 0)
    text, whole = text_of(folder)
    assert re.search(
        r"letter: the print is .* off its target \(rms, away from walls and rim\); printed again .* off", text
    )
    assert text.count("Design written") == 2  # the first was the target itself
    assert len(images(whole)) == 3 + 1 + 2 + 3 + 3 + 2


def test_notes_and_names_with_a_part_belong_to_their_part(tmp_path):
    run = put(tmp_path / "results" / "lens", target=TARGET, aligned=printed()).parent
    put(run / "lens--monday", aligned=printed(1.1))
    put(run, cin_target=TARGET, cin_aligned=printed(), cin_align=ALIGNMENT)
    found = {one.name: [(p.name, set(p.maps), set(p.facts)) for p in one.prints] for one in read_run(run).structures}
    assert found == {
        "cin": [("", {"aligned"}, {"alignment"})],
        "lens": [("", {"aligned"}, set()), ("monday", {"aligned"}, set())],
    }
    assert [row.name for row in figures(read_run(run).structures[1])] == ["target", "print", "print monday"]


RELATIVE = replace(printed(), height_reference="relative")
PARTS = {
    "target": ({"target": TARGET}, "Target", 3),
    "recording": ({"recording": printed()}, "Recording", 1),
    "print": ({"aligned": printed()}, "Print", 3),
    "prediction and print": ({"aligned": printed(), "predicted": TARGET}, "Print − prediction", 5),
    "relative heights": ({"target": TARGET, "aligned": RELATIVE}, "without the mean: relative heights", 2 + 5),
    "other grid": ({"target": TARGET, "aligned": designs.f(pitch_um=0.25)}, "not on the same grid", 4),
    "parameters": ({"process": PROCESS}, "crosslink_fwhm_z_um", 0),
    "calibration": ({"calibration": CALIBRATION}, "on left-out blocks 143 nm", 0),
    "diagnosis": ({"diagnosis": invented()}, "The model lacks dose-memory", 0),
    "alignment": ({"align": ALIGNMENT}, "3.382 ± 0.021", 0),
    "correction": ({"pre": CORRECTION}, "856 nm → 9.98 nm", 0),
}


DRAWN = ("print", "prediction and print", "relative heights", "other grid")
"""Those with many pictures."""


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in DRAWN)) for one in PARTS])
def test_a_run_with_only_some_of_the_files_still_gives_a_page(name, tmp_path):
    files, shown, pictures = PARTS[name]
    text, whole = text_of(put(tmp_path / "some", **files))
    assert shown in text
    assert len(images(whole)) == pictures
    assert [word for word in ("None", "nan", "Undefined", "undefined") if re.search(rf"\b{word}\b", text)] == []
    assert ("<canvas" in whole) == any(one in files for one in ("target", "aligned"))


def test_a_score_alone_is_shown_as_it_stands(tmp_path):
    folder = tmp_path / "scores"
    folder.mkdir()
    values = asdict_score()
    (folder / "score.json").write_text(json.dumps(values))
    text, _ = text_of(folder)
    assert f"{values['rmse_um']:.3f}" in text
    assert "as stated" in text and "not stated" in text


def test_comparisons_and_diagnoses_are_counted_once_and_named(tmp_path):
    folder = put(tmp_path / "lab", target=TARGET, aligned=printed())
    for name in ("score0", "score1"):
        words = [str(folder / f"{one}.tif") for one in ("target", "aligned")]
        assert CliRunner().invoke(app, ["score", *words, "--json", str(folder / f"{name}.json")]).exit_code == 0
    stated = {"command": "dlwpredict diagnose -o d.yaml --json d.json"}
    put(folder, d=invented(provenance=stated), e=invented(provenance={"command": "another"}))
    (folder / "d.json").write_text(json.dumps(invented(provenance=stated)))
    found = read_run(folder)
    assert list(found.diagnoses) == ["d.yaml", "e.yaml"]
    assert [one.name for one in found.structures] == ["lab", "score0", "score1"]
    (row,) = figures(found.structures[1])
    assert (row.name, row.reference, row.note) == ("aligned.tif", "target.tif", "as stated")


@pytest.mark.slow
def test_names_that_do_not_belong_together_are_told(tmp_path):
    folder = put(tmp_path / "lab", fov_target=TARGET, afm_aligned=printed())
    done = report(folder)
    assert "fov has a target and no print, afm a print and no target" in done.stderr
    assert "let their names start alike" in (folder.parent / "report.html").read_text()
    (folder / "afm_aligned.tif").rename(folder / "fov_aligned.tif")
    assert "start alike" not in report(folder, "--overwrite").stderr


@pytest.mark.slow
def test_a_damaged_file_is_named_and_the_rest_is_shown(run):
    (run / "typing.yaml").write_text("format: dlwpredict-parameters/1\nthreshhold: 0.5\n")
    (run / "letter" / "written.tif").write_text("x")
    done = report(run)
    assert done.exit_code == 0
    assert "warning: not shown: " in done.stderr and "typing.yaml: threshhold: unknown key" in done.stderr
    whole = (run.parent / "report.html").read_text(encoding="utf-8")
    assert "Could not be read and is not shown" in whole
    assert "typing.yaml: threshhold: unknown key" in whole and "written.tif: file: not a readable TIFF" in whole
    assert "The model lacks" in whole and "print of the corrected design" in whole


@pytest.mark.slow
def test_a_corrected_design_is_not_cut_off_in_its_profile(run, monkeypatch):
    seen = []
    monkeypatch.setattr("dlwpredict.pages.report_pictures.uri", lambda figure: seen.append(figure) or "data:,")
    put(run / "letter", corrected=TARGET.with_heights(2 * TARGET.heights_um))
    pictures(read_run(run).structures[0], 10_000)
    for figure in seen[-2:]:
        (axes,) = figure.axes
        inner = [line.get_ydata() for line in axes.lines if len(line.get_ydata()) > 2]
        assert axes.get_ylim()[1] >= max(np.nanmax(heights) for heights in inner)


def asdict_score():
    found = score(TARGET, printed(), part_only=True)
    return {name: getattr(found, name) for name in found.__dataclass_fields__}


def broken(**changes):
    """Return a diagnosis with faults."""
    return {**invented(), **changes}


BAD = {
    "nothing of ours": (
        lambda folder: (folder / "notes.txt").write_text("x"),
        "run: holds nothing that a report shows",
    ),
    "no TIFF": (lambda folder: (folder / "target.tif").write_text("x"), "target.tif: file: not a readable TIFF"),
    "half a map": (lambda folder: (folder / "a_aligned.tif").write_bytes(b"II*\0\x08\0\0\0"), "a_aligned.tif: file: "),
    "half a file": (
        lambda folder: (folder / "p.yaml").write_text("format: dlwpredict-parameters/1\nthreshold: ["),
        "p.yaml: file: not plain YAML",
    ),
    "missing parameter": (
        lambda folder: (folder / "p.yaml").write_text("format: dlwpredict-parameters/1\n"),
        "p.yaml: exposure_fwhm_xy_um: missing",
    ),
    "missing key": (
        lambda folder: put(folder, d={k: v for k, v in invented().items() if k != "remainder"}),
        "d.yaml: remainder: missing",
    ),
    "wrong kind": (
        lambda folder: put(folder, d=broken(noise_um="low")),
        "d.yaml: noise_um: found 'low', allowed: a number",
    ),
    "no list": (lambda folder: put(folder, d=broken(findings={})), "d.yaml: findings: found {}, allowed: a list"),
    "entry": (lambda folder: put(folder, d=broken(locations=[3])), "d.yaml: locations[0]: found 3, allowed: a mapping"),
    "verdict": (
        lambda folder: put(folder, d=broken(verdict="sure")),
        "d.yaml: verdict: found 'sure', allowed: identified",
    ),
    "calibration": (lambda folder: put(folder, c=CALIBRATION | {"holdout": None}), "c.yaml: holdout: found None"),
    "alignment": (
        lambda folder: put(folder, align=ALIGNMENT | {"shift_um": [1]}),
        "align.yaml: shift_um: found [1], allowed: two numbers",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_runs_are_refused_in_one_line(name, tmp_path):
    make, said = BAD[name]
    folder = tmp_path / "run"
    folder.mkdir()
    make(folder)
    done = report(folder)
    assert done.exit_code == 1, done.output
    (line,) = done.output.splitlines()
    assert line.startswith("error: ") and said in line
    assert not (tmp_path / "report.html").exists()


ODD = (None, "x", [], {}, [1], {"a": 1}, True, -1, 1e300, float("inf"), float("nan"), "<b>", 0)
RECORDS = {"d": ambiguous(), "c": CALIBRATION, "align": ALIGNMENT, "pre": CORRECTION}


def places(content, path=()):
    """Return the path of every key and entry of a record."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [found for key, value in inner for found in [(*path, key), *places(value, (*path, key))]]


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDS)
def test_a_record_with_anything_in_any_place_gives_a_page_or_one_line(name, tmp_path):
    rng, refused = np.random.default_rng(7), 0
    everywhere = [(path, odd) for path in places(RECORDS[name]) for odd in ("gone", *ODD)]
    for k in rng.permutation(len(everywhere))[:150]:
        path, odd = everywhere[k]
        content = inner = copy.deepcopy(RECORDS[name])
        for key in path[:-1]:
            inner = inner[key]
        if odd == "gone":
            del inner[path[-1]]
        else:
            inner[path[-1]] = odd
        put(tmp_path, **{name: content})
        try:
            assert "<b>" not in page(read_run(tmp_path)).replace("<b>These", "").replace("<b>What", "").replace(
                "<b>Made", ""
            )
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
    assert 10 < refused < 140


@pytest.mark.parametrize("name, said", [("none", "no such folder"), ("file.txt", "is a file")])
def test_what_is_no_folder_is_refused(name, said, tmp_path):
    (tmp_path / "file.txt").write_text("x")
    done = report(tmp_path / name)
    assert (done.exit_code, len(done.output.splitlines())) == (1, 1)
    assert said in done.output


@pytest.mark.slow
def test_files_of_others_are_named_not_read(run):
    (run / "compose.yaml").write_text("service: !!python/object:os.system {}\n")
    (run / "list.json").write_text("[1, 2")
    (run / "photo.tif").write_text("not a picture")
    (run / ".hidden").mkdir()
    (run / ".hidden" / "target.tif").write_text("x")
    text, _ = text_of(run)
    assert "Not shown: compose.yaml, list.json, photo.tif." in text


@pytest.mark.slow
def test_markup_in_names_is_shown_not_obeyed(tmp_path):
    evil = "<img src=x onerror=alert(1)>&amp;"
    run = put(tmp_path / evil, target=TARGET, aligned=printed(), diagnosis=invented(sentence=f"</script>{evil}"))
    plain = put(tmp_path / "plain", target=TARGET, aligned=printed(), diagnosis=invented(sentence="x"))
    pages = [Reader(text_of(folder, output=f"{k}.html")[1]) for k, folder in enumerate((run, plain))]
    assert pages[0].tags == pages[1].tags
    assert evil in pages[0].text


@pytest.mark.slow
def test_nothing_outside_the_file_is_asked_for_and_the_same_run_gives_the_same_bytes(run, monkeypatch):
    for draw in (lead, pictures):
        monkeypatch.setattr(f"dlwpredict.pages.report.{draw.__name__}", draw)
    _, whole = text_of(run)
    assert [one for one in Reader(whole).addresses if not one.startswith("data:")] == []
    assert [one for one in ("http:", "https:", "url(", "@import", "javascript:", "import(") if one in whole] == []
    assert len(whole) < 3e6
    assert page(read_run(run)) == whole


@pytest.mark.slow
def test_the_report_may_lie_in_its_run_and_is_not_overwritten_unasked(run):
    inside = "bench/report.html"
    first = text_of(run, output=inside)[1]
    assert "exists already" in report(run, output=inside).output
    assert report(run, "--overwrite", output=inside).exit_code == 0
    assert (run / "report.html").read_text(encoding="utf-8") == first


@pytest.mark.slow
def test_inputs_that_changed_since_are_named(run):
    assert changed_inputs(read_run(run)) == []
    put(run / "letter", aligned=printed(1.1))
    ((result, name),) = changed_inputs(read_run(run))
    assert (result, Path(name).name) == ("process.yaml", "aligned.tif")
    assert "Made from inputs that have changed since: process.yaml" in text_of(run)[0]


def test_a_relief_holds_the_heights_to_a_level():
    heights = printed()
    found = relief("a", "b", heights, (0, 5), points=10**6)
    levels = np.frombuffer(base64.b64decode(found["levels"]), "<u2").reshape(found["rows"], found["cols"]).astype(float)
    step = (found["top"] - found["bottom"]) / 65534
    decoded = np.where(levels == 65535, np.nan, found["bottom"] + step * levels)
    np.testing.assert_allclose(decoded, heights.heights_um, atol=0.51 * step)
    few = relief("a", "b", heights, (0, 5), points=100)
    assert few["rows"] * few["cols"] <= 100
    assert (few["width"], few["depth"]) == pytest.approx(heights.size_um)


# --- in a browser -----------------------------------------------------------------------------------

SET = """
for (const [id, value] of Object.entries(%s)) document.getElementById(id).value = value;
turn.dispatchEvent(new Event("input"));"""


def seen(browser, canvas=0):
    """Return brightness of a canvas on white, 0 to 255, shape (rows, cols), and its pixels per CSS pixel."""
    found, wide = browser.run(
        f"((one) => [one.toDataURL(), one.clientWidth])(document.querySelectorAll('canvas')[{canvas}])"
    )
    with Image.open(io.BytesIO(base64.b64decode(found.partition(",")[2]))) as image:
        paper = Image.new("RGBA", image.size, "white")
        paper.alpha_composite(image.convert("RGBA"))
    return np.asarray(paper.convert("L"), dtype=int), paper.width / wide


DRAWN = "new Promise((done) => setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(done)), 1000))"


@pytest.mark.slow
@pytest.mark.long
@needs_chromium
def test_a_browser_shows_the_report_without_a_complaint_and_the_view_turns(run, tmp_path):
    text_of(run)
    with chromium(tmp_path) as browser:
        browser.open(tmp_path / "report.html")
        widths = browser.run("[...document.images].map((one) => one.complete && one.naturalWidth)")
        assert len(widths) == 14 and min(widths) > 100
        left, right = seen(browser, 0)[0], seen(browser, 1)[0]
        assert (left < 235).mean() > 0.1  # something is drawn,
        assert len(np.unique(left)) > 50  # in many shades,
        assert (left != right).mean() > 0.01  # and the print is not the target
        browser.run(DRAWN)
        assert np.array_equal(seen(browser, 0)[0], left)  # it was whole from the first

        browser.run("document.querySelector('canvas').scrollIntoView({block: 'center', behavior: 'instant'})")
        box = browser.run("JSON.parse(JSON.stringify(document.querySelector('canvas').getBoundingClientRect()))")
        start = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        before = browser.run("[Number(turn.value), Number(tilt.value)]")
        browser.drag(start, (start[0] + 80, start[1] + 30))
        browser.run(DRAWN)
        assert browser.run("[Number(turn.value), Number(tilt.value)]") == [before[0] + 40, before[1] + 12]
        assert (seen(browser, 0)[0] != left).mean() > 0.05  # both turn
        assert (seen(browser, 1)[0] != right).mean() > 0.05

        turned = seen(browser)[0]
        browser.run("document.querySelector('select').value = 4")
        browser.run("document.querySelector('select').dispatchEvent(new Event('change'))")
        browser.run(DRAWN)
        assert (seen(browser)[0] != turned).mean() > 0.01
        assert browser.pdf().count(b"/Type /Page\n") >= 2
        assert browser.complaints == []
        assert browser.asked_for == [(tmp_path / "report.html").as_uri()]


@pytest.mark.slow
@pytest.mark.long
@needs_chromium
def test_from_above_the_surface_looks_like_the_map(tmp_path):
    """Row 0 on top and x to the right at 0°, turned counter-clockwise; an F tells mirror images apart."""
    text_of(put(tmp_path / "letter", target=LETTER))
    rows, cols = np.indices(LETTER.shape)
    within = (rows > 0) & (rows < rows.max()) & (cols > 0) & (cols < cols.max())  # half a cell at the rim is not drawn
    with chromium(tmp_path) as browser:
        browser.open(tmp_path / "report.html")
        for turn, quarters in ((0, 0), (90, 1), (180, 2), (-90, 3)):
            browser.run(SET % json.dumps({"turn": turn, "tilt": 90}))
            browser.run(DRAWN)
            gray, density = seen(browser)
            high, wide = (side / density for side in gray.shape)
            scale = min(wide, high) - 92
            x, y = ((cols - cols.max() / 2) * 0.5, (rows.max() / 2 - rows) * 0.5)
            at = np.stack(
                (high / 2 - scale / np.hypot(*LETTER.size_um) * y, wide / 2 + scale / np.hypot(*LETTER.size_um) * x)
            )
            bright = gray[tuple(np.round(density * at).astype(int))] > 110
            expected = np.rot90(LETTER.heights_um > 0, quarters)
            assert (bright == expected)[within].mean() > 0.97
            assert (bright == expected[::-1])[within].mean() < 0.95
            assert (bright == expected[:, ::-1])[within].mean() < 0.95


@pytest.mark.slow
def test_what_no_correction_reaches_is_shown_apart_and_left_out_of_the_error(run):
    missing = np.zeros(TARGET.shape)
    missing[20:30, 20:30] = 0.2
    assert "no correction mends" not in page(read_run(run))
    put(run / "letter", unreachable=TARGET.with_heights(missing))
    shown = page(read_run(run))
    assert "grey: out of reach" in shown
    assert "no correction mends" in shown
    np.testing.assert_array_equal(np.isnan(reachable(TARGET, TARGET.with_heights(missing)).heights_um), missing > 0)
