"""The machinery of the stories: parts, prints, pages. What a story comes to is for `make stories`, not tested here."""

import json
import re

import numpy as np
import pytest

from tests.stories import STORIES, __main__, page, pictures
from tests.stories.bench import MARGIN_UM, PITCH_UM, PIXELS, SIZE_UM, Bench, StepError
from tests.stories.round_trip import PARTS, WAYS, Trip
from tests.stories.story import Claim, Told, besides, nm, verdict


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A bench with a lens that was printed and recorded."""
    made = Bench(tmp_path_factory.mktemp("stories") / "lens")
    made.design("lens", "lens", base_um=2.0, height_um=3.0)
    press = made.settings("press.yaml", effects=[{"name": "curl", "rise_um": 0.2}])
    printed = made.printed("lens.tif", press, "lens")
    made.recorded(printed, "recording", seed=1)
    made.surface(printed, "surface")
    return made


@pytest.mark.slow
def test_parts_fill_the_map_but_for_the_margin(bench):
    target = bench.map("lens.tif")
    assert target.shape == (PIXELS, PIXELS)
    assert target.dx_um == pytest.approx(PITCH_UM)
    cols = np.flatnonzero((target.heights_um > 0).any(axis=0))
    assert len(cols) * PITCH_UM == pytest.approx(SIZE_UM)
    assert cols[0] * PITCH_UM == pytest.approx(MARGIN_UM)


@pytest.mark.slow
def test_recording_lies_on_the_targets_grid_and_is_noisy(bench):
    recording, surface = bench.map("recording.tif"), bench.map("surface.tif")
    assert recording.shape == surface.shape == (PIXELS, PIXELS)
    substrate = bench.map("lens.tif").heights_um == 0
    substrate[3:-3, 3:-3] = False
    assert 0.005 < recording.heights_um[substrate].std() < 0.03
    assert abs(surface.heights_um[substrate]).max() < 1e-6


@pytest.mark.slow
def test_what_is_concealed_is_printed(bench):
    plain = bench.surface(bench.printed("lens.tif", bench.settings("plain.yaml"), "plain"), "plain_surface")
    change = bench.map("surface.tif").heights_um - bench.map(plain).heights_um
    middle = PIXELS // 2
    assert change[middle, 10] - change[middle, middle] > 0.05, "curl lifts the rim"


@pytest.mark.slow
def test_every_step_is_kept_as_it_was_called(bench):
    commands = [step["command"] for step in bench.steps]
    assert commands[0].startswith("dlwpredict design lens --size-um 28.8")
    assert any(re.match(r"python -m tests.press measure lens_printed.tif .*--seed 1$", one) for one in commands)
    assert "80 x 80 px" in bench.steps[0]["said"]


@pytest.mark.slow
def test_a_command_that_fails_ends_the_story(bench):
    with pytest.raises(StepError, match=r"absent\.tif"):
        bench.program("predict", "absent.tif", "-o", "never.tif")


@pytest.mark.slow
def test_a_refusal_is_kept_and_a_success_is_none(bench):
    assert "absent.tif" in bench.refused("predict", "absent.tif", "-o", "never.tif")
    assert bench.refused("convert", "lens.tif", "copy.tif") == ""


@pytest.mark.slow
def test_off_is_the_rmse_inside_the_rim(bench):
    target = bench.map("lens.tif")
    heights = target.heights_um + 0.25
    heights[target.heights_um == 0] = 9.0
    edge = int(MARGIN_UM / PITCH_UM + 0.5)
    heights[edge] = 9.0  # a row of the rim
    bench.formula("shifted", target.with_heights(heights))
    assert bench.off("lens.tif", "shifted.tif") == pytest.approx(0.25, abs=1e-6)
    assert bench.off("surface.tif", "surface.tif", part="lens.tif") == 0


def diagnosis(*classes, word="identified"):
    return {"verdict": word, "findings": [{"effects": list(names)} for names in classes]}


def told(*holds):
    claims = tuple(Claim(f"claim {k}", "1.0 nm", one) for k, one in enumerate(holds))
    return Told("A story", "`curl`", "Words.", claims, {"a.png": "A picture."}, {"rmse_um": 0.01})


def test_page_shows_claims_pictures_steps_and_what_was_concealed(tmp_path):
    page.publish(tmp_path, "wrong", told(True, False), [{"command": "dlwpredict x", "said": "said so"}])
    text = (tmp_path / "README.md").read_text()
    assert "| claim 0 | 1.0 nm | holds |" in text
    assert "| claim 1 | 1.0 nm | **does not hold** |" in text
    assert "![a.png](a.png)" in text
    assert "$ dlwpredict x\nsaid so" in text
    assert "make stories STORIES=wrong" in text
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["claims"][1] == {"claim": "claim 1", "found": "1.0 nm", "holds": False}
    assert figures["concealed"] == "`curl`"


@pytest.mark.parametrize(("holds", "code"), [((True, True), 0), ((True, False), 1)])
def test_exit_code_says_whether_all_claims_hold(tmp_path, monkeypatch, capsys, holds, code):
    class Story:
        @staticmethod
        def tell(bench):
            return told(*holds)

    monkeypatch.setitem(__main__.STORIES, "wrong", Story)
    assert __main__.main([str(tmp_path), "wrong"]) == code
    assert f"{sum(holds)} of 2 claims hold" in (tmp_path / "README.md").read_text()
    assert "[A story](wrong/README.md)" in (tmp_path / "README.md").read_text()
    assert ("DOES NOT HOLD" in capsys.readouterr().out) == bool(code)


def test_unknown_story_is_refused(tmp_path, capsys):
    assert __main__.main([str(tmp_path), "nonsense"]) == 2
    assert "allowed: " + ", ".join(STORIES) in capsys.readouterr().err


def test_words():
    assert nm(0.0123) == "12.3 nm"
    assert verdict(diagnosis(("curl", "vignetting"), word="ambiguous")) == "ambiguous: curl or vignetting"
    assert verdict(diagnosis(word="none")) == "none"
    assert besides(diagnosis(("curl",), ("z-drift",)), "curl") == " What else it names (z-drift) was not there."
    assert besides(diagnosis(("curl", "z-drift")), "curl") == ""


def test_round_trip_pools_the_parts():
    ways = dict(zip(WAYS, (0.04, 0.01), strict=True))
    off = {
        "first print": dict.fromkeys(PARTS, 1.0),
        **{way: dict.fromkeys(PARTS, value) for way, value in ways.items()},
    }
    trip = Trip([], diagnosis(("curl",)), off)
    assert trip.change() == pytest.approx(-0.75)
    assert trip.change("first print") == pytest.approx(24)
    assert "| seven parameters | 40.0 |" in trip.table()


@pytest.mark.slow
def test_error_and_profile_leave_out_walls_and_what_is_not_known(bench):
    target = bench.map("lens.tif")
    shifted = target.with_heights(target.heights_um + 0.1 * (target.x_um > 0)[None, :])
    change = pictures.error(target, shifted)
    assert np.isnan(change.heights_um[0, 0])
    place, mean = pictures.along(change, "x")
    assert np.all(np.diff(place) > 0)
    np.testing.assert_allclose(mean, 0.1 * (place > 0), atol=1e-12)
