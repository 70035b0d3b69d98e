"""The page of a diagnosis, and its lines for the terminal, from an invented diagnosis of predicted maps."""

import base64
import re
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from dlwpredict.designs import air, f
from dlwpredict.diagnosis.answer.words import statement
from dlwpredict.diagnosis.classes import Member, Named
from dlwpredict.effects import library
from dlwpredict.files.parameters_yaml import parameters_as_dict
from dlwpredict.heightmap import Instrument
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.spectrum import spectra
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.pages import diagnosis
from dlwpredict.pages.diagnosis import Evidence, PairMaps, parameter_rows, write_page
from dlwpredict.pages.pictures import coarser, pictures, worst_place
from dlwpredict.pages.spectra import spectra as pictures_of_spectra
from dlwpredict.pages.terminal import lines
from dlwpredict.parameters import ParameterSet
from dlwpredict.process import predict
from tests.chromium import CHROMIUM, needs_chromium

MEMORY = library()["dose-memory"](gain=0.12, length_um=6.0)
BASELINE = ParameterSet()
EXTENDED = replace(BASELINE, effects=(MEMORY,))
NOISE_UM = 0.02
COMMAND = (
    "dlwpredict diagnose --pair air.tif air-print.tif --pair f.tif f-print.tif -o diagnosis.yaml --report report.html"
)


def pair(name, target, seed):
    """One pair: printed with dose memory, recorded with noise and a hole."""
    rng = np.random.default_rng(seed)
    before, after = (predict(target, one, as_measured=True).heights_um for one in (BASELINE, EXTENDED))
    noise = Noise(NOISE_UM * 0.8, NOISE_UM * 0.6, 1.0, target.dx_um, target.dy_um).simulate(target.shape, rng)
    heights = after + noise
    heights[5:12, 8:20] = np.nan
    residual = heights - before
    mismatch = np.clip((np.abs(after - before) / NOISE_UM - 1) / 3, 0, 1)
    measured = target.with_heights(heights)
    return PairMaps(name, target, measured, before, after, residual, after - before, heights - after, mismatch)


def with_spectra(pair, instrument):
    """Return a pair with the spectra of its remainder, recorded by an instrument."""
    left, used = np.nan_to_num(pair.remainder_um), ~np.isnan(pair.remainder_um)
    noise = Uneven(Noise(NOISE_UM * 0.8, NOISE_UM * 0.6, 1.0, pair.target.dx_um, pair.target.dy_um))
    return replace(pair, measured=replace(pair.measured, instrument=instrument), spectra=spectra(left, used, noise))


def invented(**changes):
    """Return the content of a diagnosis.yaml as the contract has it."""
    plain, grown = parameters_as_dict(BASELINE), parameters_as_dict(EXTENDED)
    content = {
        "format": "dlwpredict-diagnosis/1",
        "verdict": "identified",
        "noise_um": NOISE_UM,
        "baseline": {"rmse_um": 0.0841, "holdout_rmse_um": 0.0893, "parameters": plain},
        "extended": {"rmse_um": 0.0212, "holdout_rmse_um": 0.0229, "parameters": grown},
        "locations": [
            {
                "pair": 0,
                "where": "left edges, up the hatch direction",
                "share": 0.61,
                "x_um": [-50, -20],
                "y_um": [-50, 50],
            },
            {"pair": 1, "where": "stem of the F", "share": 0.22, "x_um": [-5.0, 0.0], "y_um": [-8.0, 8.0]},
            {"pair": 0, "where": "highest parts", "share": 0.08, "x_um": [8.0, 31.0], "y_um": [-16.0, 13.5]},
        ],
        "findings": [
            {
                "effects": ["dose-memory"],
                "side": "print",
                "statement": "Lines written just before raise the dose of the next ones by 12 %, fading over 6 µm: "
                "parts grow higher along the hatch, from left to right.",
                "parameters": {
                    "dose-memory": {
                        "gain": {"value": 0.1203, "low": 0.1121, "high": 0.1285, "unit": "1"},
                        "length_um": {"value": 6.04, "low": 5.31, "high": 6.77, "unit": "µm"},
                    }
                },
                "p_value": 3.1e-14,
                "rmse_um": {"before": 0.0841, "after": 0.0212},
                "holdout_rmse_um": {"before": 0.0893, "after": 0.0229},
                "separate_by": None,
            }
        ],
        "remainder": {"significant": False, "rms_um": 0.0031, "p_value": 0.41, "description": "nothing beyond noise"},
        "not_testable": ["z-amplification", "lateral-shrinkage", "field-curvature", "stitching"],
        "tested": ["dose-memory", "line-end-pileup", "vignetting", "galvo-lag", "batwings", "instrument-blur"],
    }
    return content | changes


def ambiguous():
    """Return a diagnosis with an alias class, and with every key that is not in the contract."""
    content = invented(verdict="ambiguous")
    memory = content["findings"][0]
    memory |= {
        "effects": ["dose-memory", "substrate-tilt"],
        "side": "undecided",
        "separate_by": {
            "statement": "the same part printed with the hatch mirrored: a memory turns round, a tilt stays",
            "command": "dlwpredict design pads -o pads.tif",
        },
        "alternatives": [{"name": "substrate-tilt", "loss": 3.2}],
    }
    return content | {
        "sentence": "Parts grow higher from left to right: dose memory or a tilted substrate.",
        "holdout_by": "blocks",
        "noise": [{"white_um": 0.016, "correlated_um": 0.0123, "length_um": 1.02, "smoothness": 1.5}] * 2,
        "noise_from": "the residual, beside smooth forms and the signatures of all effects",
        "tests": [
            {"name": "free forms", "p_value": 2e-12, "statement": "The residual holds more than noise."},
            {"name": "recordings agree", "p_value": 0.32, "statement": "Both recordings ask for the same parameters."},
        ],
    }


def scores():
    """Return scores of all effects: two stand out, the others are drawn."""
    rng = np.random.default_rng(3)
    found = {"dose-memory.gain": (31.4, "0.121"), "substrate-tilt.tilt_x_mrad": (24.8, "4.1 mrad")}
    names = [f"{name}.{switch}" for name, kind in library().items() for switch in kind.switches()]
    rows = [(name, *found.get(name, (rng.normal(0, 1.5), "0.01"))) for name in names]
    return [Evidence(name, score, 4.1, strength, visible=18.0) for name, score, strength in rows]


@pytest.fixture(scope="module")
def maps():
    return [pair("air-print.tif", air(pitch_um=1.0, margin_um=3), 0), pair("f-print.tif", f(pitch_um=0.5), 1)]


@pytest.fixture(scope="module")
def pictures_of(maps):
    """Return `pictures` with a memory: of recordings that are the same, and shown the same, they are drawn once."""
    known = {}

    def remembered(pair, locations, **shown):
        drawn_from = (id(value) for name, value in vars(pair).items() if name not in ("name", "measured"))
        key = (*drawn_from, id(pair.measured.heights_um), repr(locations), repr(shown))
        if key not in known:
            known[key] = pair, pictures(pair, locations, **shown)  # the pair as well: it keeps its ids to itself
        return known[key][1]

    return remembered


@pytest.fixture(autouse=True)
def drawn_once(monkeypatch, pictures_of):
    """Most of a page's time goes into its pictures, and most tests look at its words."""
    monkeypatch.setattr(diagnosis, "pictures", pictures_of)


def written(path, content, maps, command=COMMAND):
    write_page(path, content, maps, command=command, evidence=scores())
    return path.read_text(encoding="utf-8")


class Reader(HTMLParser):
    """Collects the text, the tags, and every address that a page refers to."""

    def __init__(self, text):
        super().__init__()
        self.text, self.tags, self.addresses = "", [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data):
        self.text += data


def images(text):
    """Return the decoded pictures of a page."""
    return [base64.b64decode(found).decode() for found in re.findall(r"data:image/svg\+xml;base64,([^\"]+)", text)]


@pytest.mark.slow
@pytest.mark.parametrize("make", [invented, ambiguous])
def test_the_page_says_all_that_the_diagnosis_holds(tmp_path, maps, make):
    content = make()
    text = " ".join(Reader(written(tmp_path / "report.html", content, maps)).text.split())
    said = [content["verdict"], content.get("sentence", ""), content.get("noise_from", ""), COMMAND]
    said += [item.name for item in maps] + content["not_testable"] + [place["where"] for place in content["locations"]]
    said += [finding["statement"] for finding in content["findings"]]
    said += [test["statement"] for test in content.get("tests", [])]
    said += ["0.1203 (0.1121 to 0.1285)", "84.1 nm → 21.2 nm", "89.3 nm → 22.9 nm", "dose-memory.gain", "61 %"]
    if make is ambiguous:
        said += [
            "substrate-tilt 3.2",
            "left-out data (blocks)",
            "12.3 nm",
            "1.02 µm",
            *content["findings"][0]["separate_by"].values(),
        ]
    assert [one for one in said if one not in text] == []


@pytest.mark.slow
def test_what_is_likelier_than_the_effect_fitted_stands_in_its_place_not_in_its_own(tmp_path, maps):
    """A class names the likeliest first, which need not be the one whose model this is."""
    content = ambiguous()
    memory = content["findings"][0]
    memory |= {
        "effects": ["substrate-tilt", "dose-memory"],
        "alternatives": [{"name": "substrate-tilt", "loss": -3.2}],
    }
    text = " ".join(Reader(written(tmp_path / "report.html", content, maps)).text.split())
    assert "In the place of dose-memory the fit loses, in 2 ln L: substrate-tilt -3.2" in text
    tilt = library()["substrate-tilt"](tilt_x_mrad=4.0)
    members = Member(tilt, 0.0, 0.6, None), Member(MEMORY, 3.2, 0.4, None)
    named = Named(MEMORY, 50.0, 1e-6, 0.98765, None, None, members)
    assert named.names == memory["effects"]
    assert statement(named, {}).endswith(
        " substrate-tilt would fit as well, or nearly. Probability that one of them is there: 99 %; of these: "
        "substrate-tilt 60 %, dose-memory 40 %."
    )


@pytest.mark.slow
def test_page_and_terminal_say_how_sure_and_how_far(tmp_path, maps):
    content = ambiguous() | {"complete": False, "not_tried": ["curl", "z-drift"], "working_pitch_um": 0.4}
    content["work"] = {"predictions": 412.3, "cpu_s": 33.2}
    content["findings"][0] |= {
        "probability": 0.98,
        "members": {"dose-memory": 0.7, "substrate-tilt": 0.3},
        "side_probability": {"print": 0.7, "measurement": 0.3},
    }
    page = " ".join(Reader(written(tmp_path / "report.html", content, maps)).text.split())
    said = " ".join(" ".join(lines(content)).split())
    assert "side undecided, probability 98 %" in page
    assert "probability 98 %: dose-memory 70 %, substrate-tilt 30 %; print 70 %, measurement 30 %)" in said
    spent = "412 predictions, pixels of 0.4 µm"
    assert "The search was not complete. Not tried: curl, z-drift." in page and spent in page
    assert f"not complete ({spent}, 33 s of processor time); not tried: curl, z-drift" in said
    whole = content | {"complete": True, "not_tried": []}
    assert f"complete: {spent}, 33 s of processor time" in lines(whole)
    assert "not complete" not in Reader(written(tmp_path / "whole.html", whole, maps)).text


@pytest.mark.slow
def test_page_and_terminal_say_how_many_lines_of_the_scan_were_left_out(tmp_path, maps):
    content = ambiguous()
    assert "scars" not in " ".join(lines(content))
    content["noise"] = [content["noise"][0] | {"scars": 2}, content["noise"][1] | {"scars": 1}]
    assert "noise 20.0 nm; 3 lines of the scan left out for scars" in " ".join(" ".join(lines(content)).split())
    text = written(tmp_path / "report.html", content, maps)
    cells = re.findall(r"<td[^>]*>([^<]*)</td></tr>", text[text.index("lines with scars") :])
    assert cells[:2] == ["2", "1"]


@pytest.mark.slow
def test_the_spectra_of_what_is_left_stand_beside_the_noise(tmp_path, maps):
    shown = [with_spectra(maps[0], Instrument("afm", 90.0)), maps[1]]
    text = written(tmp_path / "report.html", ambiguous(), shown)
    assert len(images(text)) == 6 * len(maps) + 2
    assert (
        text.index("<h2>Noise</h2>") < text.index("Spectrum along y, the fast axis") < text.index("Parameters before")
    )


@pytest.mark.parametrize(
    ("instrument", "titles"),
    [
        (Instrument("afm", 177.0), ["Spectrum along x, the fast axis", "Spectrum along y, the slow axis"]),
        (Instrument("afm", -90.0), ["Spectrum along y, the fast axis", "Spectrum along x, the slow axis"]),
        (Instrument("confocal"), ["Spectrum along x", "Spectrum along y"]),
    ],
)
def test_the_fast_axis_comes_first(maps, instrument, titles):
    assert [one.title for one in pictures_of_spectra(with_spectra(maps[1], instrument))] == titles


@pytest.mark.slow
def test_without_its_own_sentence_the_verdict_makes_one(tmp_path, maps):
    text = Reader(written(tmp_path / "report.html", invented(), maps)).text
    assert "The model lacks dose-memory: the error falls from 84.1 nm to 21.2 nm." in text


@pytest.mark.slow
def test_every_pair_has_four_maps_and_two_profiles_and_two_maps_where_nothing_was_named(tmp_path, maps):
    assert len(images(written(tmp_path / "some.html", invented(), maps))) == 6 * len(maps)
    nothing = invented(verdict="none", findings=[], locations=[], not_testable=[], tested=[])
    nothing["extended"] = nothing["baseline"] = nothing["baseline"] | {"holdout_rmse_um": None}
    text = written(tmp_path / "none.html", nothing, maps)
    assert len(images(text)) == 4 * len(maps)
    assert "No named effect was added" in text
    assert "Nothing beyond the noise of 20.0 nm" in text


@pytest.mark.slow
def test_markup_in_names_and_texts_is_shown_not_obeyed(tmp_path, maps):
    evil = """<script>alert("1")</script><img src=x onerror='a'>&amp;"""
    content = ambiguous() | {"sentence": evil, "noise_from": evil, "not_testable": [evil], "tested": [evil]}
    content["locations"][0]["where"] = content["findings"][0]["statement"] = evil
    plain = Reader(written(tmp_path / "plain.html", ambiguous(), maps))
    shown = Reader(written(tmp_path / "evil.html", content, [replace(maps[0], name=evil), maps[1]], command=evil))
    assert shown.text.count(evil) == 7 + 4  # the recording stands in its heading, beside its noise and two places
    assert set(shown.tags) == set(plain.tags)
    assert shown.tags.count("img") == plain.tags.count("img")


@pytest.mark.slow
def test_nothing_outside_the_file_is_asked_for(tmp_path, maps):
    text = written(tmp_path / "report.html", ambiguous(), maps)
    found = Reader(text)
    assert found.addresses
    assert [one for one in found.addresses if not one.startswith("data:")] == []
    assert [one for one in ("http:", "https:", "url(", "@import", "<script", "javascript:") if one in text] == []
    inner = [one for image in images(text) for one in re.findall(r'href="([^"]{,20})', image)]
    assert inner
    assert [one for one in inner if not one.startswith(("#", "data:"))] == []


@pytest.mark.slow
def test_the_same_diagnosis_gives_the_same_bytes(tmp_path, maps, monkeypatch):
    monkeypatch.setattr(diagnosis, "pictures", pictures)
    assert written(tmp_path / "a.html", ambiguous(), maps) == written(tmp_path / "b.html", ambiguous(), maps)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.html", "b.html"]


@pytest.mark.slow
def test_a_large_recording_stays_a_small_page(tmp_path):
    rng = np.random.default_rng(0)
    noise = f(pitch_um=0.5).with_heights(rng.normal(0, 1, (900, 900)))
    large = PairMaps("large.tif", noise, noise, *[noise.heights_um] * 5, mismatch=rng.random((900, 900)))
    text = written(tmp_path / "report.html", invented(locations=[]), [large])
    assert len(text) < 3e6
    assert "Drawn on 300 × 300 of 900 × 900 points" in " ".join(text.split())


def test_coarser_pixels_hold_the_mean_of_what_they_cover():
    grid = f(pitch_um=0.5).with_heights(np.arange(48.0).reshape(6, 8))
    found = coarser(grid, grid.heights_um, 12)
    assert found.size_um == grid.size_um
    assert found.heights_um == pytest.approx(grid.heights_um.reshape(3, 2, 4, 2).mean(axis=(1, 3)))
    assert coarser(grid, grid.heights_um, 15).heights_um.mean() == pytest.approx(grid.heights_um.mean())
    holed = np.where(grid.heights_um == 0, np.nan, grid.heights_um)
    assert coarser(grid, holed, 12).heights_um[0, 0] == pytest.approx((1 + 8 + 9) / 3)


def test_the_worst_place_is_the_middle_of_a_hill_not_a_spike_and_not_where_nothing_counts():
    rows, cols = np.mgrid[:40, :60]
    residual = -np.exp(-((rows - 12) ** 2 + (cols - 41) ** 2) / 50)
    residual[30, 10] = 5.0
    assert worst_place(residual) == (12, 41)
    residual[10:15, 39:44] = np.nan
    row, col = worst_place(residual)
    assert not np.isnan(residual[row, col])
    assert np.hypot(row - 12, col - 41) < 6


def test_parameters_stand_side_by_side_with_dotted_names_for_effects():
    rows = parameter_rows(parameters_as_dict(BASELINE), parameters_as_dict(EXTENDED))
    changed = {row.name: (row.before, row.after) for row in rows if row.before != row.after}
    assert changed["dose-memory.gain"] == ("", "0.120")
    assert all(name.startswith("dose-memory.") for name in changed)
    assert {"threshold", "writing.hatching_um"} < {row.name for row in rows}


@pytest.mark.slow
@needs_chromium
def test_chromium_renders_the_page_without_a_complaint(tmp_path, maps):
    written(tmp_path / "report.html", ambiguous(), maps)
    picture = tmp_path / "page.png"
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--window-size=1280,3000"]
    done = subprocess.run(
        [CHROMIUM, *flags, f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}", "report.html"],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB"), dtype=int)
    blue = np.array([0x00, 0x72, 0xB2])  # the baseline's line: inside the pictures only
    assert (np.abs(pixels - blue).max(axis=-1) < 40).sum() > 100


def test_the_terminal_has_verdict_first_and_what_the_bench_needs():
    said = lines(ambiguous())
    assert said[0] == "AMBIGUOUS: Parts grow higher from left to right: dose memory or a tilted substrate."
    assert "   dlwpredict design pads -o pads.tif" in said
    together = " ".join(" ".join(said).split())
    for part in (
        "rmse 84.1 nm → 21.2 nm, on left-out data 89.3 nm → 22.9 nm; noise 20.0 nm",
        "1. dose-memory or substrate-tilt (side undecided)",
        "dose-memory.gain 0.1203 (0.1121 to 0.1285), dose-memory.length_um 6.04 (5.31 to 6.77) µm",
        "the same part printed with the hatch mirrored: a memory turns round, a tilt stays",
        "where: 61 % in pair 0, left edges, up the hatch direction",
        "remainder: no more than noise (3.10 nm, p = 0.41). nothing beyond noise",
        "not testable: z-amplification, lateral-shrinkage, field-curvature, stitching",
    ):
        assert part in together


@pytest.mark.slow
def test_a_partial_explanation_is_called_one(tmp_path, maps):
    content = invented(verdict="unexplained")
    text = " ".join(Reader(written(tmp_path / "report.html", content, maps)).text.split())
    assert "unexplained – effects are named, but none for certain" in text
    assert "None of these is certain" in text
    bare = " ".join(Reader(written(tmp_path / "bare.html", content | {"findings": []}, maps)).text.split())
    assert "unexplained – no named effect explains it" in bare and "None of these" not in bare


@pytest.mark.slow
def test_what_could_not_be_left_out_is_said_once_with_the_reason(tmp_path, maps):
    content = invented()
    for part in (content["baseline"], content["extended"]):
        part["holdout_rmse_um"] = None
    content["findings"][0]["holdout_rmse_um"] = {"before": None, "after": None}
    text = Reader(written(tmp_path / "report.html", content, maps)).text
    assert text.count("too small to leave blocks of them out") == 1
    assert "on left-out data" not in text.replace("rmse on left-out data", "")
    said = " ".join(" ".join(lines(content)).split())
    assert said.count("too small to leave blocks of them out") == 1 and "left-out –" not in said


@pytest.mark.slow
def test_a_place_that_is_the_whole_field_gets_no_box(tmp_path, maps):
    half = maps[0].target.size_um[0] / 2
    content = invented()
    content["locations"][0] |= {"x_um": [-half, half], "y_um": [-half, half]}
    text = " ".join(Reader(written(tmp_path / "report.html", content, maps)).text.split())
    assert text.count("all over the field") == 1
    assert "8 to 31" in text  # the other place of the pair is number 1 now


def test_recordings_are_named_by_their_files():
    said = " ".join(lines(invented(recordings=["scans/air.tif", "scans/f.tif"])))
    assert "where: 61 % in air.tif, left edges" in said and "22 % in f.tif" in said


def test_a_diagnosis_without_findings_is_short():
    said = lines(invented(verdict="none", findings=[], locations=[], not_testable=[]))
    assert said[0].startswith("NONE: Nothing beyond the noise of 20.0 nm")
    assert len(said) == 3


@pytest.mark.parametrize("options", [3, 12, 60])
def test_the_terminal_shows_at_most_25_lines_of_100_characters_and_no_half_command(options):
    content = ambiguous() | {"sentence": "A long sentence. " * 40, "not_testable": [f"effect-{k}" for k in range(90)]}
    command = "dlwpredict design pads -o pads.tif" + "".join(f" --option-{k} {k}.25" for k in range(options))
    many = {f"parameter_{k}_um": {"value": k, "low": k - 0.1, "high": k + 0.1, "unit": "µm"} for k in range(20)}
    finding = content["findings"][0] | {
        "effects": [f"effect-number-{k}" for k in range(20)],
        "parameters": {"effect-number-0": many},
        "separate_by": {"statement": "Another print. " * 30, "command": command},
    }
    content |= {"findings": [finding] * 5, "locations": content["locations"] * 4}
    content["locations"][0]["where"] = "x" * 300
    content["remainder"]["description"] = "A long description. " * 30
    said = lines(content)
    assert len(said) <= 25
    assert max(map(len, said)) <= 100
    joined = " ".join("\n".join(said).replace("\\\n", "").split())
    assert (command in joined) == (options < 60)
    assert ("its command is in the diagnosis" in joined) == (options == 60)
    assert "more" in said[-1]


def test_a_quoted_command_stays_in_one_piece():
    content = ambiguous()
    for length, whole in ((20, True), (120, False)):
        command = "dlwpredict design pads -o '" + "my  pads " * (length // 9) + ".tif'"
        content["findings"][0]["separate_by"] = {"statement": "Another print.", "command": command}
        assert (f"   {command}" in lines(content)) == whole
        assert ("   (its command is in the diagnosis)" in lines(content)) != whole
