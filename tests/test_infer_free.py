"""What a fit moves: names for the user, a vector for the optimiser, and coordinates for the descent."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict.effects import library
from dlwpredict.errors import InputError
from dlwpredict.infer.free import choose, fittable, value_of, with_values
from dlwpredict.infer.model import freed, key_of, moving
from dlwpredict.infer.straight import bending, bent, straight
from dlwpredict.parameters import Paper, ParameterSet, declarations

TRUTH = ParameterSet(paper=Paper(0.55, 1.7, 0.42, 6.0, 8.0, 0.74, 0.96))


class TestFree:
    def test_values_go_in_and_come_out(self):
        changed = with_values(ParameterSet(), {"threshold": 0.4, "shrinkage_max": 0.9})
        assert (value_of(changed, "threshold"), value_of(changed, "shrinkage_max")) == (0.4, 0.9)

    @pytest.mark.parametrize("name", list(library()))
    def test_every_effect_is_reached_by_its_flat_names(self, name):
        process = ParameterSet(effects=(library()[name](),))
        names = [n for n in fittable(process) if n.startswith(f"{name}.")]
        wanted = [f"{name}.{key}" for key, (_, d) in declarations(library()[name]).items() if d.fitted]
        assert names == wanted
        free = choose(process)
        np.testing.assert_array_equal(free.values(free.parameters(free.start)), free.start)

    def test_a_phase_goes_round_without_end(self):
        """All others reach to the ends of their ranges."""
        free = choose(ParameterSet(effects=(library()["z-linearity"](periodic_um=0.1, phase_rad=3.0),)))
        (down, up), phase = free.reach(free.start), free.index("z-linearity.phase_rad")
        assert (down[phase], up[phase]) == (-np.inf, np.inf)
        np.testing.assert_allclose(np.delete(down, phase), np.delete(np.minimum(free.low - free.start, -1e-12), phase))
        assert np.isfinite(np.delete(up, phase)).all()

    def test_what_effects_share_moves_once_and_in_all_of_them(self):
        """With one value for each, of which the model takes the largest, the others have no derivative: a trap."""
        memory, fading = library()["dose-memory"](gain=0.1), library()["vignetting"](strength=0.1, conversion=0.6)
        process = ParameterSet(effects=(memory, fading), bounds={"vignetting.conversion": (0.1, 0.9)})
        free = choose(process)
        assert [name for name in free.names if name.endswith("conversion")] == ["dose-memory.conversion"]
        k = free.index("dose-memory.conversion")
        assert (free.start[k], free.low[k], free.high[k]) == (0.6, 0.1, 0.9)
        assert [effect.conversion for effect in free.parameters(free.start).effects] == [0.6, 0.6]
        assert "dose-memory.conversion" not in choose(process, fix=["vignetting.conversion"]).names
        assert choose(process, free=["vignetting.conversion"]).names == ("dose-memory.conversion",)
        for names in (["vignetting.conversion"], ["dose-memory.conversion", "threshold"]):
            with pytest.raises(InputError, match="named for both"):
                choose(process, fix=["dose-memory.conversion"], free=names)
        with pytest.raises(InputError, match="found curl"):
            choose(process, fix=["curl.conversion"])

    @pytest.mark.parametrize(
        ("chosen", "said"),
        [
            ({"fix": ["kappa"]}, "--fix: found kappa"),
            ({"free": ["colour"]}, "--free: found colour"),
            ({"fix": list(declarations(Paper))}, "every parameter is fixed"),
            ({"fix": ["threshold"], "free": ["threshold"]}, "named for both"),
        ],
    )
    def test_wrong_choices_are_refused_by_name(self, chosen, said):
        with pytest.raises(InputError, match=said):
            choose(ParameterSet(), **chosen)

    def test_start_outside_its_bounds_is_refused(self):
        with pytest.raises(InputError, match=r"threshold: start value 0.5, allowed by the bounds: 0.1 to 0.3"):
            choose(ParameterSet(bounds={"threshold": (0.1, 0.3)}))


class TestMoving:
    """With the effects of its own a process moves what was chosen; with others, what the effects that are on say."""

    memory = library()["dose-memory"](gain=0.1)
    process = ParameterSet(effects=(memory,))

    def test_with_its_own_effects_just_what_was_chosen(self):
        like = choose(self.process, free=["threshold", "dose-memory.gain"])
        again = moving(replace(self.process, effects=(replace(self.memory, gain=0.2),)), like)
        assert again.names == ("threshold", "dose-memory.gain")
        np.testing.assert_array_equal(again.start, [0.5, 0.2])

    def test_with_other_effects_what_is_on(self):
        like = choose(ParameterSet(), free=["threshold"])
        assert moving(self.process, like).names == freed(self.process, like).names
        assert {"threshold", "dose-memory.gain"} <= set(moving(self.process, like).names)

    def test_what_no_fit_moves_stays_though_it_is_on(self):
        """A steepest angle that the microscope still reads leaves gaps; the effect beside it is fitted."""
        effect = library()["slope-error"](bias_um=0.02, max_angle_deg=60.0)
        names = freed(ParameterSet(effects=(effect,)), choose(ParameterSet(), free=["threshold"])).names
        assert names == ("threshold", "slope-error.bias_um")

    def test_bounds_of_an_effect_that_a_search_adds_are_no_error(self):
        """A file may hold them; what the search begins with is brought inside."""
        process = ParameterSet(effects=(library()["curl"](rise_um=-0.2),), bounds={"curl.rise_um": (0.2, 0.5)})
        free = freed(process, choose(ParameterSet(), free=["threshold"]))
        assert free.start[free.index("curl.rise_um")] == 0.2

    def test_a_model_is_the_same_in_whatever_order_its_effects_stand(self):
        """What they share belongs to none of them."""
        effects = library()["vignetting"](strength=0.05), library()["dose-memory"](gain=0.05)
        models = [freed(ParameterSet(effects=order), choose(ParameterSet())) for order in (effects, effects[::-1])]
        assert models[0].names != models[1].names and key_of(models[0]) == key_of(models[1])


class TestStraight:
    def test_there_and_back(self):
        free = choose(TRUTH)
        np.testing.assert_allclose(bent(free, straight(free, free.start)), free.start, rtol=1e-12)

    def test_derivatives_are_those_of_the_map(self):
        free = choose(TRUTH)
        here = straight(free, free.start)
        numeric = [(bent(free, here + 1e-6 * e) - bent(free, here - 1e-6 * e)) / 2e-6 for e in np.eye(len(here))]
        np.testing.assert_allclose(bending(free, free.start), np.array(numeric).T, atol=1e-7)


def test_only_a_sag_of_all_in_view_has_no_centre():
    """Elsewhere it is the same sag and a plane; coma is not, nor is a sag of the part alone, beside its substrate."""
    start, like = ParameterSet(), choose(ParameterSet())
    for name, switch, has in (
        ("field-curvature", "sag_um", False),
        ("field-curvature", "coma_x_um", True),
        ("print-field-curvature", "sag_um", True),
    ):
        moved = freed(replace(start, effects=(library()[name](**{switch: 0.1}),)), like).names
        assert (f"{name}.centre_x_um" in moved) is has
