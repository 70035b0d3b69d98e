"""What holds for every effect of the library, whatever its physics."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from dlwpredict.cli.app import app
from dlwpredict.correction.precompensate import precompensate
from dlwpredict.effects import library
from dlwpredict.errors import InputError
from dlwpredict.files.parameters_yaml import parameters_as_dict, parameters_from, read_parameters
from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.walls import near_walls
from dlwpredict.model.levels import Levels
from dlwpredict.model.states import STAGES
from dlwpredict.model.voxels import Voxels
from dlwpredict.numerics.smoothing import blur
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict, run, steps

PITCH = 0.3
PRINT = """
vignetting print-field-curvature galvo-lag line-end-pileup dose-memory dose-proximity edge-inhibition psf-wings
astigmatism spherical-aberration edge-drying shrinkage-nonlinearity lateral-shrinkage curl power-drift
interface-offset substrate-tilt z-drift stitching line-length-error
"""
MEASUREMENT = """
instrument-blur batwings slope-error z-amplification z-linearity field-curvature misregistration
tip-convolution
"""

NAMES = sorted(library())
SWITCHES = [(name, switch) for name in NAMES for switch in library()[name].switches()]
SMOOTH_SWITCHES = [(n, s) for n, s in SWITCHES if declarations(library()[n])[s][1].fitted]


def relief(pixels=64, margin=9, base=4.0, seed=0) -> HeightMap:
    """A rough plateau with a groove, on a substrate margin, not symmetric in any way."""
    rng = np.random.default_rng(seed)
    rough = blur(rng.normal(size=(pixels - 2 * margin,) * 2), 4, 4)
    rough[: pixels // 4, pixels // 3 : pixels // 3 + 4] -= 1.5 * rough.std()
    return HeightMap(np.pad(base + 0.5 * rough / rough.std(), margin), PITCH, PITCH)


def switched_on(name, *switches, **others):
    kind = library()[name]
    typical = kind.switches()
    return kind(**{s: typical[s] for s in switches or typical}, **others)


def recorded(target, *effects, **options) -> np.ndarray:
    return predict(target, ParameterSet(effects=effects), as_measured=True, **options).heights_um


@cache
def plain() -> np.ndarray:
    return recorded(relief())


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_every_name_of_the_contract_is_there():
    assert {name for name, kind in library().items() if kind.side == "measurement"} == set(MEASUREMENT.split())
    assert {name for name, kind in library().items() if kind.side == "print"} == set(PRINT.split())


@pytest.mark.parametrize("name", NAMES)
class TestKnowledge:
    def test_says_what_it_is(self, name):
        kind = library()[name]
        assert kind.name == name
        assert kind.frame in ("printer", "sample", "instrument")
        assert kind.stage in STAGES
        assert min(len(kind.meaning), len(kind.source), len(kind.separated_by)) > 15
        assert set(kind.confused_with) <= set(NAMES) - {name}
        assert kind.confused_with

    def test_only_the_measurement_acts_on_the_recording(self, name):
        kind = library()[name]
        assert (kind.side == "measurement") == (kind.stage == "recording") == (kind.frame == "instrument")

    def test_every_parameter_has_unit_range_and_meaning(self, name):
        kind = library()[name]
        assert kind.switches()
        for parameter, (default, known) in declarations(kind).items():
            assert known.unit and len(known.meaning) > 5
            assert known.low <= default <= known.high
            for unit in ("um", "deg", "mrad", "rad"):
                if parameter.endswith(f"_{unit}") and not parameter.endswith("_per_um"):
                    assert known.unit == {"um": "µm", "deg": "°"}.get(unit, unit)
            if known.typical is not None:
                assert known.low <= known.typical <= known.high and known.typical != default

    def test_out_of_range_is_refused_by_name(self, name):
        kind = library()[name]
        for parameter, (_, known) in declarations(kind).items():
            for bad in (known.low - 1, known.high + 1, np.nan):
                with pytest.raises(InputError) as refused:
                    kind(**{parameter: bad})
                assert refused.value.key == f"{name}.{parameter}"

    def test_survives_the_parameter_file(self, name):
        parameters = ParameterSet(effects=(switched_on(name),))
        assert parameters_from(parameters_as_dict(parameters)) == parameters

    def test_printed_example_is_a_valid_entry(self, name, tmp_path):
        shown = CliRunner().invoke(app, ["effects", name, "--yaml"])
        file = tmp_path / "p.yaml"
        seven = "\n".join(f"{key}: {value}" for key, value in vars(Paper()).items())
        file.write_text(f"format: dlwpredict-parameters/1\n{seven}\n{shown.stdout}")
        assert read_parameters(file).effects == (switched_on(name),)


@pytest.mark.parametrize("name", NAMES)
class TestAction:
    def test_off_is_the_identity_bit_for_bit(self, name):
        kind = library()[name]
        state = object()
        assert kind()(state) is state
        others = {p: k.high for p, (_, k) in declarations(kind).items() if p not in kind.switches()}
        assert kind(**others)(state) is state
        np.testing.assert_array_equal(recorded(relief(), kind()), plain())

    def test_on_it_changes_something_finitely_and_repeatably(self, name):
        target = relief()
        before = target.heights_um.copy()
        effect = switched_on(name)
        once, again = recorded(target, effect), recorded(target, effect)
        np.testing.assert_array_equal(once, again)
        np.testing.assert_array_equal(target.heights_um, before)
        assert once.shape == target.shape
        gaps = np.isnan(once)
        assert not gaps.any() or name == "slope-error"
        assert np.isfinite(once[~gaps]).all()
        assert rms((once - plain())[~gaps]) > 2e-4

    def test_finite_at_both_ends_of_every_range(self, name):
        target = relief(40, 7)
        for parameter, (_, known) in declarations(library()[name]).items():
            for end in (known.low, known.high):
                if parameter != "direction":
                    effect = replace(switched_on(name), **{parameter: end})
                    printed = recorded(target, effect)
                    assert np.isfinite(printed).all() or name == "slope-error"

    def test_room_around_the_map_changes_nothing(self, name):
        if name == "z-linearity":
            pytest.skip("a microscope's scale is set by the heights in view")
        target = relief()
        wide = HeightMap(np.pad(target.heights_um, 20), PITCH, PITCH)
        effect = switched_on(name)
        inner = recorded(wide, effect)[20:-20, 20:-20]
        np.testing.assert_allclose(recorded(target, effect), inner, atol=2e-4)

    def test_written_heights_stay_where_something_was_written(self, name):
        if library()[name].side == "print":
            part = np.zeros((40, 40))
            part[10:30, 10:30] = 0.05
            printed = recorded(HeightMap(part, PITCH, PITCH), switched_on(name))
            assert printed.min() >= 0
            assert not printed[:4].any()

    def test_measurement_is_left_out_unless_asked_for(self, name):
        if library()[name].side == "measurement":
            target = relief()
            effects = ParameterSet(effects=(switched_on(name),))
            np.testing.assert_array_equal(predict(target, effects).heights_um, plain())

    def test_gaps_of_a_recording_stay_gaps_and_do_not_spread(self, name):
        if library()[name].stage == "recording" and name != "misregistration":
            state = relief()
            holed = state.heights_um.copy()
            holed[30:33, 30:33] = np.nan
            effect = replace(switched_on(name), **({"max_angle_deg": 90.0} if name == "slope-error" else {}))
            seen = effect(state.with_heights(holed)).heights_um
            np.testing.assert_array_equal(np.isnan(seen), np.isnan(holed))
            if name == "z-linearity":
                return  # the mean of what is in view is another one
            far = np.ones(state.shape, bool)
            far[20:43, 20:43] = False
            np.testing.assert_allclose(seen[far], effect(state).heights_um[far], atol=1e-4)


@pytest.mark.parametrize(("name", "switch"), SMOOTH_SWITCHES)
def test_derivative_is_continuous_at_off(name, switch):
    """Neighbouring small steps show one slope, on both sides where both are allowed."""
    kind = library()[name]
    off, known = declarations(kind)[switch]
    step = 0.004 * (known.typical - off)
    target = relief()
    # the exposed share of a pixel bends where the edge enters it
    counted = (target.heights_um > 0) & ~near_walls(target)

    def slope(low, high):
        maps = [plain() if at == 0 else recorded(target, kind(**{switch: off + at * step})) for at in (low, high)]
        return ((maps[1] - maps[0]) / (high - low))[counted]

    first = slope(0, 1)
    # a width has no slope at 0: there the typical change sets the scale; single precision rounds by 1.5e-7 µm, and
    # a difference of two slopes has four such errors, two of them the same one
    allowed = 0.02 * max(rms(first), rms(slope(0, 250))) + np.sqrt(6) * 1.5e-7
    assert rms(slope(1, 2) - first) <= allowed
    if known.low < off:
        assert rms(slope(-1, 0) - first) <= allowed


@pytest.mark.parametrize(("name", "switch"), [(n, s) for n, s in SMOOTH_SWITCHES if "_x" not in s and "_y" not in s])
def test_quarter_turns_and_mirrors(name, switch):
    """An isotropic effect does not know where x is; every other one does."""
    effect = switched_on(name, switch)
    target = relief()
    straight = recorded(target, effect)
    alike = [
        np.allclose(recorded(target.with_heights(change(target.heights_um)), effect), change(straight), atol=5e-4)
        for change in (np.rot90, np.fliplr)
    ]
    assert all(alike) == effect.isotropic


class TestCausality:
    """Lines are written towards +y, one beside the other towards +x."""

    def signature(self, effect):
        part = np.zeros((60, 60))
        part[10:50, 10:50] = 4.0
        target = HeightMap(part, PITCH, PITCH)
        heights = [
            predict(target, ParameterSet(Paper(shrinkage_min=1.0), effects=effects)).heights_um
            for effects in ((effect,), ())
        ]
        return heights[0] - heights[1], target

    def test_dose_memory_rises_along_x(self):
        change, _ = self.signature(switched_on("dose-memory", length_um=3.0))
        profile = change[25:35, 13:47].mean(axis=0)
        assert (np.diff(profile) > 0).all()
        mirrored, _ = self.signature(switched_on("dose-memory", length_um=3.0, direction=-1.0))
        np.testing.assert_allclose(mirrored, change[:, ::-1], atol=2e-4)

    def test_dose_memory_knows_nothing_of_what_is_written_later(self):
        target = relief()
        effect = switched_on("dose-memory")
        later = target.heights_um.copy()
        later[:, 40:] = 1.0
        before, after = (effect.intensity(target.with_heights(h), 3.0) for h in (target.heights_um, later))
        np.testing.assert_array_equal(before[:, :40], after[:, :40])
        assert (before[:, 40:] != after[:, 40:]).any()

    def test_galvo_lag_moves_the_part_towards_plus_y(self):
        change, target = self.signature(switched_on("galvo-lag"))
        x_um, y_um = np.meshgrid(target.x_um, target.y_um)
        rounding_um = np.finfo(np.float32).eps * target.heights_um.max()  # exposure is in single precision
        assert (y_um * change).sum() > 0.5
        assert abs((x_um * change).sum()) < rounding_um * np.linalg.norm(x_um[target.heights_um > 0])
        reversed_lines, _ = self.signature(switched_on("galvo-lag", direction=-1.0))
        np.testing.assert_allclose(reversed_lines, change[::-1], atol=2e-4)

    def test_lines_start_at_low_y(self):
        change, _ = self.signature(switched_on("line-end-pileup", end_ratio=0.0))
        # row 0 is the highest y
        assert change[45, 30] > 5 * change[14, 30] > 0

    @pytest.mark.parametrize("name", ["dose-memory", "galvo-lag"])
    def test_direction_is_one_or_the_other(self, name):
        with pytest.raises(InputError, match="1 or -1"):
            library()[name](direction=0.5)


def voxel_cases():
    for name, switch in SMOOTH_SWITCHES:
        if name in PRINT.split():
            yield name, switch, {}
            if "conversion" in declarations(library()[name]) and switch in ("strength", "gain", "drift", "overlap"):
                yield name, switch, {"conversion": 1.0}


WHOLE = Levels(whole_pixels=True)
"""Voxels are exposed or not, as their centres are."""


@cache
def thin() -> tuple[HeightMap, np.ndarray, np.ndarray]:
    target = relief(44, 7, base=2.2, seed=3)
    return target, recorded(target, numerics=WHOLE), recorded(target, numerics=Voxels(0.025))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "switch", "more"), list(voxel_cases()))
def test_voxels_show_the_same_signature(name, switch, more):
    """Rms within what 0.025 µm slices leave in a difference of two maps, and 3 % of the signature."""
    target, fast, literal = thin()
    effect = switched_on(name, switch, **more)
    by_levels = recorded(target, effect, numerics=WHOLE) - fast
    by_voxels = recorded(target, effect, numerics=Voxels(0.025)) - literal
    # the rim is where one voxel more or less decides whether anything stands
    part = (fast > 0) & (literal > 0) & (fast + by_levels > 0) & (literal + by_voxels > 0)
    quantisation = 0.025 / np.sqrt(6)
    assert rms((by_levels - by_voxels)[part]) <= np.hypot(1.2 * quantisation, 0.03 * rms(by_levels[part]))
    assert abs((by_levels - by_voxels)[part].mean()) <= 1.5e-3 + 0.03 * rms(by_levels[part])


def test_effects_of_one_stage_may_be_named_in_any_order():
    target = relief()
    some = [switched_on(n) for n in ("stitching", "dose-memory", "psf-wings", "vignetting")]
    np.testing.assert_allclose(recorded(target, *some), recorded(target, *some[::-1]), atol=2e-4)


def test_conversion_belongs_to_the_resin_and_is_shared():
    effects = [switched_on("dose-memory", conversion=0.3), switched_on("vignetting", conversion=0.8)]
    chain = steps(ParameterSet(effects=tuple(effects)), None)
    dose = run([step for step in chain if step.stage in ("target", "dose")], relief())
    assert dose.conversion == 0.8
    off = library()["power-drift"](conversion=1.0)
    assert off(dose).conversion == 0.8


def test_precompensation_does_not_correct_the_measurement():
    target = relief(40, 8)
    measured = ParameterSet(effects=(switched_on("field-curvature"), switched_on("z-amplification")))
    results = [
        precompensate(target, lambda part, p=p: predict(part, p), most_predictions=3).corrected.heights_um
        for p in (measured, ParameterSet())
    ]
    np.testing.assert_array_equal(*results)


class TestCommand:
    def test_overview_names_every_effect_and_parameter(self):
        text = CliRunner().invoke(app, ["effects"]).stdout
        for name, kind in library().items():
            assert f"  {name}  [" in text
            assert all(parameter in text for parameter in declarations(kind))

    def test_card_holds_everything(self):
        text = CliRunner().invoke(app, ["effects", "dose-memory"]).stdout
        for word in ("printer", "Waller", "length_um", "field-curvature", "µm", "0.5 to 50", "never fitted"):
            assert word in text

    def test_unknown_name_is_refused(self):
        result = CliRunner().invoke(app, ["effects", "vignette"])
        assert result.exit_code == 1
        assert "error: NAME: found vignette, allowed: astigmatism" in result.stderr
