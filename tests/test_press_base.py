"""The press with everything off, against closed forms and a second, brute-force computation."""

import ast
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr, ndtri

from tests.press import Press, press_from, print_part, read_map, write_map
from tests.press.__main__ import main
from tests.press.focus import axial_weights, gauss_lorentz
from tests.press.gauss import SIGMA_PER_FWHM, lateral, line_kernel
from tests.press.grid import plane_grid
from tests.press.voxels import peak

ROOT = Path(__file__).parent
PITCH = 0.4
SHARP = {"shrinkage_min": 1.0, "shrinkage_max": 1.0}


def block(rows=50, columns=60, height=6.0, rim=12):
    target = np.zeros((rows, columns))
    target[rim:-rim, rim:-rim] = height
    return target


def f_shape():
    """An F, upright as seen from above, written with row 0 at the top."""
    target = np.zeros((60, 50))
    target[10:50, 12:18] = 5.0
    target[10:16, 12:38] = 5.0
    target[26:32, 12:30] = 5.0
    return target


def test_press_knows_nothing_of_the_program_under_test():
    allowed = {"numpy", "scipy", "tifffile", "yaml", "tests"}
    standard = {
        "argparse",
        "collections",
        "dataclasses",
        "functools",
        "importlib",
        "itertools",
        "os",
        "pathlib",
        "pkgutil",
        "sys",
        "types",
    }
    for path in (ROOT / "press").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module] if isinstance(node, ast.ImportFrom) else []
            for module in modules:
                assert module.split(".")[0] in allowed | standard, f"{path}: {module}"
                assert not module.startswith("tests.") or module.startswith("tests.press"), f"{path}: {module}"


@pytest.mark.parametrize("sigma_px", [0.6, 1.0, 7.3])
def test_kernel_has_sum_one_and_the_width_asked_for(sigma_px):
    kernel = line_kernel(sigma_px)
    place = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1, abs=1e-12)
    assert (kernel * place**2).sum() == pytest.approx(sigma_px**2, rel=0.03)


@pytest.mark.parametrize("sigma_px", [0.1, 0.3, 0.45])
def test_narrow_kernel_integrates_the_gaussian_over_pixels(sigma_px):
    kernel = line_kernel(sigma_px)
    assert kernel[len(kernel) // 2] == pytest.approx(ndtr(0.5 / sigma_px) - ndtr(-0.5 / sigma_px), abs=0.01)


def test_two_blurs_add_in_quadrature():
    grid = plane_grid((81, 91), 1.0, 1.0)
    spot = np.zeros((81, 91))
    spot[40, 45] = 1
    twice = lateral(lateral(spot, 3, 3, grid), 4, 4, grid)
    assert np.allclose(twice, lateral(spot, 5, 5, grid), atol=1e-6)


@pytest.mark.parametrize("threshold", [0.35, 0.45, 0.5, 0.7])
def test_top_of_a_large_block_is_where_the_axial_gaussian_says(threshold):
    printed = print_part(block(), PITCH, PITCH, Press(threshold=threshold, **SHARP))
    expected = 6.0 - 1.5 * SIGMA_PER_FWHM * ndtri(threshold)
    assert printed[25, 30] == pytest.approx(expected, abs=5e-4)


def test_equal_shrinkages_scale_the_exposed_height():
    exposed = print_part(block(), PITCH, PITCH, Press(**SHARP))
    printed = print_part(block(), PITCH, PITCH, Press(shrinkage_min=0.8, shrinkage_max=0.8))
    assert np.allclose(printed, 0.8 * exposed, atol=1e-6)


def test_half_threshold_leaves_a_straight_edge_in_place():
    printed = print_part(block(), PITCH, PITCH, Press(**SHARP))
    assert ((printed > 0) == (block() > 0))[25].all()


def test_part_is_highest_where_it_is_most_cross_linked():
    printed = print_part(block(), PITCH, PITCH)
    assert printed[25, 30] > printed[25, 14] > 0.7 * 5.9


@pytest.mark.parametrize(("last", "largest"), [(12, 1.0), (9, np.exp(-0.32)), (10, np.exp(-0.08))])
def test_the_largest_value_of_a_part_is_that_of_the_field_inside(last, largest):
    """exp(−(x − 11)²/12.5) on the columns up to one: a parabola through a cut-off neighbour took an eighth more."""
    x = np.arange(24.0)
    stack = np.exp(-((x - 11.0) ** 2) / 12.5) * np.ones((5, 5, 1))
    assert peak(stack, (x <= last) & np.ones(stack.shape, bool)) == pytest.approx(largest, rel=1e-3)


def test_mirrors_and_turns_commute_with_printing():
    target = f_shape()
    printed = print_part(target, PITCH, PITCH)
    assert np.allclose(print_part(target[:, ::-1], PITCH, PITCH)[:, ::-1], printed, atol=1e-5)
    assert np.allclose(print_part(np.rot90(target), PITCH, PITCH), np.rot90(printed), atol=1e-5)
    assert printed[12, 30] > 4 and printed[45, 30] == 0


def test_pitches_may_differ():
    fine = print_part(np.repeat(block(), 2, axis=1), PITCH / 2, PITCH, Press(**SHARP))
    coarse = print_part(block(), PITCH, PITCH, Press(**SHARP))
    assert np.allclose((fine[:, ::2] + fine[:, 1::2])[15:-15, 15:-15] / 2, coarse[15:-15, 15:-15], atol=5e-3)


def brute_force(target, pitch, press, dz):
    """Compute the paper's chain on fine hard voxels with scipy's filters, far from the rims of the array."""
    s_xy, s_z = press.focus_fwhm_xy_um * SIGMA_PER_FWHM, press.focus_fwhm_z_um * SIGMA_PER_FWHM
    under = int(5 * s_z / dz)
    z = (np.arange(-under, int((target.max() + 2) / dz)) + 0.5) * dz
    solid = ((z[:, None, None] < target) & (target > 0)).astype(float)
    sharp = [s_z / dz, s_xy / pitch, s_xy / pitch]
    exposed = gaussian_filter(solid, sharp, mode="nearest", truncate=5)[under:] >= press.threshold
    s_c = press.crosslink_fwhm_xy_um * SIGMA_PER_FWHM
    wide = [press.crosslink_fwhm_z_um * SIGMA_PER_FWHM / dz, s_c / pitch, s_c / pitch]
    linked = gaussian_filter(exposed.astype(float), wide, mode="constant", truncate=5)
    factor = press.shrinkage_min + (press.shrinkage_max - press.shrinkage_min) * linked / linked.max()
    return (factor * exposed).sum(axis=0) * dz


def test_agrees_with_brute_force_voxels(monkeypatch):
    monkeypatch.setattr("tests.press.voxels.THIN", [(0, 0)])  # whole pixels
    target = np.zeros((44, 44))
    x = np.arange(20) * PITCH
    target[12:32, 12:32] = 3 + np.sin(2 * np.pi * x / 4)[None] * np.cos(2 * np.pi * x / 5)[:, None]
    press = Press(threshold=0.45, focus_fwhm_xy_um=1.0, crosslink_fwhm_xy_um=4, crosslink_fwhm_z_um=4)
    difference = print_part(target, PITCH, PITCH, press) - brute_force(target, PITCH, press, 0.02)
    assert np.sqrt((difference**2).mean()) < 0.005
    assert np.abs(difference).max() < 0.015


@pytest.mark.parametrize("threshold", [0.33, 0.41, 0.5, 0.62])
def test_walls_stand_where_exposure_meets_the_threshold(threshold):
    """At s Phi^-1(1 - P) outside; the area between two squares leaves their corners out."""
    press = Press(threshold=threshold, focus_fwhm_xy_um=0.6, focus_fwhm_z_um=0.4, shrinkage_min=1.0, shrinkage_max=1.0)
    areas, sides = [], []
    for count in (24, 40):
        target = np.zeros((64, 64))
        edge = (64 - count) // 2
        target[edge : edge + count, edge : edge + count] = 4.0
        printed = print_part(target, 0.25, 0.25, press)
        areas.append(printed.sum() * 0.25**2 / printed.max())
        sides.append(count * 0.25)
    out = (areas[1] - areas[0] - sides[1] ** 2 + sides[0] ** 2) / (4 * (sides[1] - sides[0]))
    assert out == pytest.approx(-0.6 * SIGMA_PER_FWHM * ndtri(threshold), abs=0.03)


def test_layer_thickness_does_not_matter():
    coarse = print_part(block(), PITCH, PITCH, Press(threshold=0.4, dz_um=0.15))
    fine = print_part(block(), PITCH, PITCH, Press(threshold=0.4, dz_um=0.04))
    assert np.abs(coarse - fine).max() < 0.002


def test_gauss_lorentz_focus_has_the_widths_and_the_axial_law_of_a_beam():
    lobes = gauss_lorentz(0.5, 1.5)
    z = np.linspace(-3, 3, 601)
    s = np.array([lobe.s_x_um for lobe in lobes])
    energy = np.array([axial_weights(lobe, np.array([0.0]), 0.01)[0][0, 0] for lobe in lobes])
    assert energy[1:].max() < 0.01 * energy[0]
    step = 0.01
    density = np.array([lobe.cumulative(z + step / 2) - lobe.cumulative(z - step / 2) for lobe in lobes]) / step
    on_axis = (density / (2 * np.pi * s[:, None] ** 2)).sum(axis=0)
    assert on_axis[450] / on_axis[300] == pytest.approx((1 + (1.5 / 1.165) ** 2) ** -2, rel=0.12)
    assert sum(lobe.cumulative(np.array(1e3)) for lobe in lobes) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"focus_profile": "gauss-lorentz"},
        {"contrast": 8.0},
        {"dose_conversion": 0.5},
        {"slicing_um": 0.5, "slicing_phase": 0.0},
        {"crosslink_reference": "bulk"},
        {"focus_tails": 0.5},
        {"crosslink_tails": 0.5},
        {"pinning": 0.5},
    ],
)
def test_each_honest_difference_changes_the_print_a_little(change):
    target = block() + 0.3 * (block() > 0) * np.sin(np.arange(60))
    base = print_part(target, PITCH, PITCH)
    other = print_part(target, PITCH, PITCH, press_from(change))
    rms = np.sqrt(((base - other)[target > 0] ** 2).mean())
    assert 0.001 < rms < 1.0
    assert np.isfinite(other).all()


def test_an_error_of_form_in_full_is_the_other_form():
    target = block()
    tails = print_part(target, PITCH, PITCH, Press(focus_tails=1.0))
    assert tails == pytest.approx(print_part(target, PITCH, PITCH, Press(focus_profile="gauss-lorentz")), abs=1e-5)
    far = print_part(target, PITCH, PITCH, Press(crosslink_tails=1.0))
    wide = Press(crosslink_fwhm_xy_um=14.0, crosslink_fwhm_z_um=14.0)
    assert far == pytest.approx(print_part(target, PITCH, PITCH, wide), abs=1e-5)


def test_what_the_base_holds_shrinks_the_more_in_height():
    even = {"shrinkage_min": 0.8, "shrinkage_max": 0.8}
    exposed = print_part(block(), PITCH, PITCH, Press(**SHARP))[25, 30]
    held = print_part(block(), PITCH, PITCH, Press(**even, pinning=0.5, pin_height_um=3.0))[25, 30]
    more = 0.5 * 3.0 / exposed * -np.expm1(-exposed / 3.0)
    assert held == pytest.approx(exposed * (1 - 0.2 * (1 + more)), abs=1e-3)


def test_infinite_contrast_is_all_or_nothing():
    soft = print_part(block(), PITCH, PITCH, Press(contrast=200.0, dz_um=0.02))
    hard = print_part(block(), PITCH, PITCH, Press(dz_um=0.02))
    assert np.abs(soft - hard)[16:-16, 16:-16].max() < 0.02


def test_command_line_prints_and_measures_and_never_overwrites(tmp_path, capsys):
    target, printed, seen = (str(tmp_path / name) for name in ("target.tif", "printed.tif", "seen.tif"))
    write_map(target, f_shape(), 0.4, 0.5)
    settings = tmp_path / "press.yaml"
    settings.write_text(yaml.safe_dump({"format": "press/1", "threshold": 0.45}))
    assert main(["print", target, "-p", str(settings), "-o", printed]) == 0
    assert main(["print", target, "-o", printed]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert main(["measure", printed, "-o", seen, "--seed", "3", "--truth", str(tmp_path / "truth.yaml")]) == 0
    heights, dx, dy = read_map(seen)
    assert (dx, dy) == (0.4, 0.5)
    assert np.allclose(heights, print_part(f_shape(), 0.4, 0.5, Press(threshold=0.45)), atol=1e-5)
    assert yaml.safe_load((tmp_path / "truth.yaml").read_text())["rotation_deg"] == 0


def test_unknown_keys_are_refused_by_name():
    with pytest.raises(ValueError, match=r"press\.treshold"):
        press_from({"treshold": 0.5})
    with pytest.raises(ValueError, match="no such effect"):
        press_from({"effects": [{"name": "gremlin"}]})
