"""The objective: rows, priors, nuisances and derivatives, against what can be derived on paper."""

from dataclasses import replace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer import baseline
from dlwpredict.infer.baseline import rewhitened, unsaid
from dlwpredict.infer.free import choose
from dlwpredict.infer.noises import white
from dlwpredict.infer.objective import Objective, Work
from dlwpredict.infer.priors import LATERAL, NUISANCES, PARAMETERS, PLACE, Prior, bounded, rows
from dlwpredict.infer.recording import Recording, prepare
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.whitened import Whitened, gradient
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict

TRUTH = ParameterSet(paper=Paper(0.55, 1.7, 0.42, 6.0, 8.0, 0.74, 0.96))
SEVEN = choose(TRUTH)


@pytest.fixture(scope="module")
def air() -> HeightMap:
    return designs.air(size_um=24.0, pitch_um=0.5, margin_um=4.0)


@pytest.fixture(scope="module")
def printed(air) -> HeightMap:
    return predict(air, TRUTH)


def objective_of(*recordings: Recording, sigma_um: float = 0.01, **known) -> Objective:
    return Objective(tuple(Whitened.of(r, white(r, sigma_um)) for r in recordings), **known)


class TestRows:
    def test_every_row_belongs_to_one(self):
        layout = Rows((4, 6, 1), (1, 0, 2), 5)
        owners = [layout.of(k) for k in range(3)] + [layout.nuisance_priors(k) for k in range(3)]
        taken = np.concatenate([np.arange(layout.total)[own] for own in (*owners, layout.parameter_priors)])
        np.testing.assert_array_equal(taken, np.arange(layout.total))
        assert layout.data == 11

    def test_stacked_and_split(self):
        layout = Rows((4, 6), (1, 2), 3)
        parts = [np.ones((4, 2)), np.full((6, 2), 2.0)]
        stacked = layout.stack(parts)
        assert stacked.shape == (16, 2) and not stacked[10:].any()
        for found, part in zip(layout.split(stacked), parts, strict=True):
            np.testing.assert_array_equal(found, part)


class TestPriors:
    @pytest.mark.parametrize("prior", [Prior(2.0, 0.5), Prior(2.0, 0.5, logarithm=True)])
    def test_derivative_is_that_of_the_row(self, prior):
        above, below = (prior.row(1.7 + step)[0] for step in (1e-6, -1e-6))
        assert prior.row(1.7)[1] == pytest.approx(-(above - below) / 2e-6, rel=1e-6)
        assert prior.row(2.0)[0] == 0
        assert prior.sd_at(2.0) == pytest.approx(1 / prior.row(2.0)[1])

    def test_every_fwhm_of_the_paper_has_one_and_threshold_and_shrinkage_have_none(self):
        assert {name for name in PARAMETERS if "." not in name} == {n for n in declarations(Paper) if "fwhm" in n}

    def test_what_is_fixed_or_not_known_has_no_say(self):
        free = choose(TRUTH, free=["threshold", "exposure_fwhm_z_um"])
        residual, derivative = rows(free, free.start, PARAMETERS)
        own = PLACE["exposure_fwhm_z_um"]
        assert np.flatnonzero(residual).tolist() == [own] and np.argwhere(derivative).tolist() == [[own, 0]]
        assert not rows(free, free.start, {})[0].any()

    def test_they_cost_what_they_say(self, air, printed):
        recording = prepare(air, printed)
        known, bare = (objective_of(recording, known=k).at(SEVEN, SEVEN.start).cost for k in (PARAMETERS, {}))
        said = sum(PARAMETERS[n].row(v)[0] ** 2 for n, v in zip(SEVEN.names, SEVEN.start, strict=True) if "fwhm" in n)
        assert known - bare == pytest.approx(said, rel=1e-6)

    def test_levelling_has_none(self):
        assert [tuple(NUISANCES)[k] for k in bounded(tuple(NUISANCES))] == [*LATERAL]


class TestNuisances:
    def test_of_a_plane_are_its_slopes_and_edges(self):
        """Shifting by +x lowers what rises along x; y grows upwards, rows downwards; tilts are µm at the rim."""
        target = HeightMap(np.full((40, 40), 2.0), 0.5, 0.25)
        pair = prepare(target, replace(target, height_reference="relative"), wall_px=0)
        x, y = np.meshgrid(target.x_um, target.y_um)
        maps = Whitened.of(pair, white(pair, 0.01)).nuisance_maps(0.3 * x - 0.2 * y)[:, 4:-4, 4:-4]
        columns, x, y = dict(zip(pair.nuisances, maps, strict=True)), x[4:-4, 4:-4], y[4:-4, 4:-4]
        for name, expected in {
            "offset": np.ones_like(x),
            "tilt_x": x / 10,
            "tilt_y": y / 5,
            "shift_x": np.full_like(x, -0.3),
            "shift_y": np.full_like(x, 0.2),
            "rotation": 0.3 * y + 0.2 * x,
            "scale_x": -0.3 * x,
            "scale_y": 0.2 * y,
            "shear": -0.3 * y,
        }.items():
            np.testing.assert_allclose(columns[name], expected, atol=1e-9, err_msg=name)

    def test_offset_tilt_and_shift_of_a_relative_map_cost_nothing(self, air, printed):
        x, y = np.meshgrid(air.x_um, air.y_um)
        tilted = HeightMap(printed.heights_um - 3.0 + 0.01 * x - 0.004 * y, 0.5, 0.5, "relative")
        found = objective_of(prepare(air, tilted)).at(SEVEN, SEVEN.start)
        assert found.rmse_um() < 1e-6
        values = dict(zip(found.data[0].nuisances, found.coefficients[0], strict=True))
        assert values["offset"] == pytest.approx(-3.0, abs=1e-6)
        assert values["tilt_x"] == pytest.approx(0.01 * 16, abs=1e-6)
        known = objective_of(prepare(air, replace(tilted, height_reference="substrate"))).at(SEVEN, SEVEN.start)
        assert known.rmse_um() > 1

    def test_free_shift_takes_out_what_registration_left(self, air, printed):
        moved = printed.heights_um - 0.04 * gradient(printed.heights_um, 0.5, 1)
        found = objective_of(prepare(air, printed.with_heights(moved)), sigma_um=1e-3).at(SEVEN, SEVEN.start)
        assert found.data[0].place[:2] == pytest.approx((0.04, 0.0), abs=2e-3)
        fixed = replace(prepare(air, printed.with_heights(moved)), nuisances=())
        assert found.rmse_um() < 0.1 * objective_of(fixed).at(SEVEN, SEVEN.start).rmse_um()

    def test_nothing_free_is_nothing_fitted(self, air, printed):
        pair = replace(prepare(air, printed.with_heights(printed.heights_um + 0.1)), nuisances=())
        found = objective_of(pair, sigma_um=0.05, known={}).at(SEVEN, SEVEN.start)
        assert found.cost == pytest.approx(4 * pair.points, rel=1e-9)
        np.testing.assert_allclose(found.residual_um(0)[pair.used], 0.1)


class TestDerivatives:
    @pytest.mark.parametrize("name", ["crosslink_fwhm_xy_um", "exposure_fwhm_z_um", "threshold"])
    def test_finite_differences_are_derivatives(self, name):
        """Against central differences of a step ten times smaller, to a tenth."""
        rng = np.random.default_rng(1)
        target = HeightMap(np.pad(rng.uniform(3, 4.9, (16, 16)), 3), 0.5, 0.5)
        inside = np.s_[5:-5, 5:-5]  # the share of a pixel bends where the edge enters it
        free = choose(ParameterSet(paper=Paper(threshold=0.4)), free=(name,))
        objective = objective_of(prepare(target, target, wall_px=0))
        found = objective.derivatives(objective.at(free, free.start), [0])[0][0]
        step = 2e-3 * free.start[0]
        above, below = (objective.at(free, free.start + sign * step).traces[0].heights_um for sign in (1, -1))
        expected = (above - below) / (2 * step)
        assert np.sqrt(np.mean((found - expected)[inside] ** 2)) < 0.1 * np.sqrt(np.mean(expected[inside] ** 2))

    def test_at_a_bound_they_are_those_beside_it(self):
        """At the upper end of a range the step goes the other way."""
        rng = np.random.default_rng(0)
        target = HeightMap(np.pad(rng.uniform(1, 3, (12, 12)), 2), 0.5, 0.5)
        objective = objective_of(prepare(target, target, wall_px=0))

        def derivative(low: float) -> np.ndarray:
            free = choose(ParameterSet(paper=Paper(shrinkage_min=low, shrinkage_max=1.1)), free=("shrinkage_max",))
            return objective.derivatives(objective.at(free, free.start - (0.05 if low < 0.5 else 0.0)), [0])[0][0]

        np.testing.assert_allclose(derivative(0.6), derivative(0.4), rtol=1e-6, atol=1e-9)
        assert derivative(0.6).max() > 0.5

    def test_known_ones_are_taken_over_and_cost_nothing(self, air, printed):
        objective = objective_of(prepare(air, printed))
        now = objective.differentiated(objective.at(SEVEN, SEVEN.start))
        spent = objective.work.predictions
        assert spent == pytest.approx(1 + 3 + 2 * 0.3)
        again = objective.differentiated(now, now)
        np.testing.assert_array_equal(again.jacobian, now.jacobian)
        assert objective.work.predictions == spent

    @pytest.mark.parametrize("change_um", [0.02, -0.02])
    @pytest.mark.parametrize(("end", "beyond"), [("high", 1), ("low", -1)])
    def test_a_parameter_that_would_go_beyond_its_range_cannot_answer(self, air, printed, end, beyond, change_um):
        """κ_max at an end: a print whose top is higher asks for more of it, a lower one for less.

        What would lie beyond the end stands out of the tangents; where the range goes on, it is among them.
        """
        shown = printed.with_heights(printed.heights_um + change_um * (printed.heights_um > 0))
        objective, free = objective_of(prepare(air, shown), known={}), choose(TRUTH, free=("shrinkage_max",))
        value = TRUTH.paper.shrinkage_max
        for place, held in ((value, change_um * beyond > 0), (value + 0.01 * beyond, False)):
            model = objective.differentiated(objective.at(replace(free, **{end: np.array([place])}), free.start))
            assert model.unbound == ([] if held else [0])
            assert model.tangents.shape[1] == len(model.unbound)

    @pytest.mark.parametrize(("free_shift", "share"), [(False, 1e-9), (True, 0.01)])
    def test_beside_another_noise_they_are_what_they_would_be(self, air, printed, free_shift, share):
        """Exactly where no registration moves with the noise; else but for the 10 nm by which it does here."""
        recording = prepare(air, printed.with_heights(1.001 * printed.heights_um), free_shift=free_shift)
        first, other = objective_of(recording), Whitened.of(recording, Uneven(Noise(0.004, 0.01, 1.0, 0.5, 0.5)))
        now = first.differentiated(first.at(SEVEN, SEVEN.start))
        second = Objective((replace(other, place=now.data[0].place),))
        anew, over = second.differentiated(second.at(SEVEN, SEVEN.start)), rewhitened(now, second)
        np.testing.assert_allclose(over.residual, anew.residual, atol=1e-8)
        for name in ("shrinkage_min", "shrinkage_max"):
            one, two = over.jacobian[:, SEVEN.index(name)], anew.jacobian[:, SEVEN.index(name)]
            assert np.linalg.norm(one - two) < share * np.linalg.norm(two)
        priors = second.rows.parameter_priors
        assert anew.jacobian[priors].any()
        np.testing.assert_allclose(over.jacobian[priors], anew.jacobian[priors])


@pytest.mark.parametrize(("said", "taken"), [("points", "either"), ("squares", "squares"), ("either", "either")])
def test_what_a_file_leaves_open_of_pixels_may_be_either(said, taken):
    start = ParameterSet()
    start = replace(start, readings=replace(start.readings, pixels=said))
    assert unsaid(start).readings.pixels == taken


def test_work_counts_predictions_and_shows_places(air, printed):
    seen = []
    objective = objective_of(prepare(air, printed), prepare(air, printed), work=Work(seen=seen.append))
    first = objective.at(SEVEN, SEVEN.start)
    objective.at(SEVEN, SEVEN.start * [1, 1, 1, 1, 1, 0.9, 1], first)
    assert objective.work.predictions == pytest.approx(1)
    assert len(seen) == 2 and seen[0] is first


def test_work_can_be_stopped(air, printed):
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        objective_of(prepare(air, printed), work=Work(stop=stop)).at(SEVEN, SEVEN.start)


def test_predictions_on_coarse_pixels_count_by_their_points(monkeypatch):
    """Two descents on pixels of twice the side come first: each of their predictions is a quarter of one."""
    target = designs.air(size_um=36, pitch_um=0.5, margin_um=2, seed=3)
    recording = prepare(target, target.with_heights(predict(target, TRUTH).heights_um))
    fit_white, began, spent = baseline._white, [], []

    def watched(recordings, *rest):
        work = rest[-1]
        began.append((recordings[0].target.shape, work.predictions))
        fit = fit_white(recordings, *rest)
        spent.append(work.predictions - began[-1][1])
        return fit

    monkeypatch.setattr(baseline, "_white", watched)
    baseline.rough([recording], choose(TRUTH, free=("shrinkage_max",)), {}, Work(), spikes=False)
    assert [shape for shape, _ in began] == [(40, 40), (40, 40), (80, 80)] and min(spent) > 0
    assert began[2][1] == pytest.approx(1 + (spent[0] + spent[1]) / 4)
