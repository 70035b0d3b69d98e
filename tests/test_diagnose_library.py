"""The library: what every effect would change, what is left of it beside the process, and what noise alone scores."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from dlwpredict import designs
from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.library import signatures as signatures_of
from dlwpredict.diagnosis.library.candidates import NO_CANDIDATES, Bent, Candidate, candidates
from dlwpredict.diagnosis.library.hidden import answered
from dlwpredict.diagnosis.library.score import Linearised, Thresholds, thresholds
from dlwpredict.diagnosis.library.signatures import Signatures
from dlwpredict.diagnosis.posterior import Sets
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed, lacking
from dlwpredict.infer.null import COHERENT_UM, Null
from dlwpredict.infer.objective import Objective
from dlwpredict.infer.recording import doubted, prepare
from dlwpredict.infer.trace import trace
from dlwpredict.infer.whitened import Whitened
from dlwpredict.model.levels import Levels
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict

PAPER = Paper(0.6, 1.5, 0.4, 6.0, 7.0, 0.7, 0.95)
NOISE = Noise(0.003, 0.003, 1.0, 0.5, 0.5)
CHOSEN = ("curl", "field-curvature", "vignetting", "interface-offset", "batwings", "galvo-lag")


class TestCandidates:
    def test_are_all_effects_but_a_nuisance_and_an_exact_alias(self):
        assert NO_CANDIDATES == ("misregistration", "z-amplification")
        assert {one.name for one in candidates(ParameterSet())} == set(library()) - set(NO_CANDIDATES)

    def test_are_not_those_that_are_there(self):
        there = ParameterSet(effects=(library()["curl"](rise_um=0.1),))
        found, every = ({one.name for one in candidates(p)} for p in (there, ParameterSet()))
        assert every - found == {"curl"}

    def test_are_off_and_their_switch_turns_them_on_inside_its_range(self):
        for one in candidates(ParameterSet()):
            low, high = one.declaration.low, one.declaration.high
            assert all(
                getattr(one.effect, switch) == declarations(one.effect)[switch][0] for switch in one.effect.switches()
            )
            assert getattr(one.at(1.0), one.switch) == pytest.approx(one.declaration.typical)
            assert (
                low <= getattr(one.at(-50.0), one.switch) <= getattr(one.at(50.0), one.switch) <= high or one.unit < 0
            )

    def test_lengths_are_tried_one_at_a_time_and_shares_with_all(self):
        def shapes(name, *keys):
            return {tuple(getattr(c.effect, key) for key in keys) for c in candidates(ParameterSet()) if c.name == name}

        ends = [(share, ratio) for share in (0.0, 1.0) for ratio in (0.0, 1.0)]
        expected = {(share, length, ratio) for share, ratio in ends for length in (1.0, 2.0, 4.0)}
        assert shapes("line-end-pileup", "conversion", "length_um", "end_ratio") == expected
        for effect in ("vignetting", "field-curvature"):
            centres = shapes(effect, "centre_x_um", "centre_y_um")
            assert len(centres) == 5 and all(0.0 in centre for centre in centres)
        periods = {period for period, _ in shapes("z-linearity", "period_um", "phase_rad")}
        assert len(periods) == 7 and 3.0 in periods

    def test_only_a_strength_that_physics_allows_has_its_sign(self):
        sign = {one.name: one.sign for one in candidates(ParameterSet())}
        assert (sign["curl"], sign["vignetting"], sign["edge-drying"]) == (0, 1, 1)
        steepest = Candidate(library()["slope-error"](), "max_angle_deg")
        assert steepest.one_sided == -1 and steepest.unit < 0 and steepest.sign == 1

    def test_of_an_effect_that_a_diagnosis_has_named_are_its_other_switches_as_it_stands_there(self):
        """Its shape, too, where it matters already: the periods of a wave are open where only a bend is there."""
        bow = library()["field-curvature"](sag_um=0.3)
        bent = library()["z-linearity"](quadratic_um=0.02)
        there = ParameterSet(effects=(bow, bent, library()["curl"](rise_um=0.1)))
        found = [
            one for one in candidates(there, ["field-curvature", "z-linearity"]) if one.name in (bow.name, bent.name)
        ]
        assert {one.switch for one in found} == {"coma_x_um", "coma_y_um", "periodic_um"}
        assert all(one.effect == bow for one in found if one.name == bow.name)
        assert {one.effect.period_um for one in found if one.name == bent.name} > {3.0}
        (coma,) = (one for one in found if one.switch == "coma_x_um")
        assert coma.at(0.5) == replace(bow, coma_x_um=0.05)
        assert coma.alone(0.5) == library()["field-curvature"](coma_x_um=0.05)

    def test_a_switch_that_no_fit_moves_is_none(self):
        """A steepest angle leaves gaps, which a blur behind it would fill otherwise: a change that is no height's."""
        there = ParameterSet(effects=(library()["slope-error"](bias_um=0.1),))
        for found in (candidates(ParameterSet()), candidates(there, ["slope-error"])):
            own = {one.switch for one in found if one.name == "slope-error"}
            assert {"signed_x_um", "bias_abs_y_um"} <= own and "max_angle_deg" not in own

    def test_of_one_with_several_switches_on_each_could_do_alone(self):
        tilted = library()["substrate-tilt"](tilt_x_mrad=3.0, tilt_y_mrad=2.0)
        found = candidates(ParameterSet(effects=(tilted,)), ["substrate-tilt"])
        own = {one.switch: one for one in found if one.name == "substrate-tilt"}
        assert set(own) == {"tilt_x_mrad", "tilt_y_mrad"}
        moved = own["tilt_y_mrad"].at(1.0)
        assert (moved.tilt_x_mrad, moved.tilt_y_mrad) == (3.0, 7.0) and own["tilt_y_mrad"].size_of(moved) == 1.0
        assert own["tilt_y_mrad"].alone(1.0) == library()["substrate-tilt"](tilt_y_mrad=5.0)

    def test_what_bends_grows_with_the_square_of_its_size(self):
        curl = library()["curl"]()
        up, down = (Bent(curl, "rise_um", direction) for direction in (1.0, -1.0))
        assert [up.at(share).rise_um for share in (0.0, 0.25, 1.0, -1.0)] == pytest.approx([0.0, 0.1, 0.2, 0.0])
        assert down.at(0.25).rise_um == pytest.approx(-0.1)
        assert up.sign == down.sign == 1 and Candidate(curl, "rise_um").sign == 0


def linearised(truth, begun=None, named=()):
    """Return objective, fit, signatures and screen of a noisy recording, for a part of the library."""
    target = designs.air(size_um=24, pitch_um=0.5, margin_um=4, seed=3)
    drawn = NOISE.simulate(target.shape, np.random.default_rng(0))
    heights = predict(target, truth, as_measured=True).heights_um + drawn
    item = Whitened.of(doubted(prepare(target, target.with_heights(heights))), Uneven(NOISE))
    objective, begun = Objective((item,)), begun or ParameterSet(paper=PAPER)
    free = freed(begun, choose(ParameterSet(paper=PAPER)))
    fit = descend(objective, objective.differentiated(objective.at(free, free.start)))
    white = np.random.default_rng(1).standard_normal((item.recording.points, 200)).astype(np.float32)
    found = Signatures.of(fit, named, objective.work)
    return objective, fit, found, Linearised.of(found, fit, Null(objective.rows.stack([white])), objective)


@pytest.fixture(scope="module")
def part():
    """Look at a part of the library alone."""
    with pytest.MonkeyPatch.context() as patch:
        some = lambda *of: [one for one in candidates(*of) if one.name in CHOSEN]  # noqa: E731
        patch.setattr(signatures_of, "candidates", some)
        yield


@pytest.fixture(scope="module")
def curled(part):
    return linearised(ParameterSet(paper=PAPER, effects=(library()["curl"](rise_um=0.1),)))


class TestSignatures:
    @pytest.mark.slow
    def test_of_a_linear_effect_are_what_it_does(self, curled):
        _, fit, signatures, _ = curled
        place = next(k for k, one in enumerate(signatures.chosen) if one.switch == "sag_um")
        one = signatures.chosen[place]
        target = fit.data[0].recording.target
        shown = predict(target, replace(fit.parameters, effects=(one.at(0.3),)), as_measured=True).heights_um
        change = shown - predict(target, fit.parameters).heights_um
        np.testing.assert_allclose(signatures.maps_um[place][0], change / 0.3, atol=1e-6)

    @pytest.mark.slow
    def test_what_a_named_effect_does_is_the_difference_without_it(self, part):
        begun = ParameterSet(paper=PAPER, effects=(library()["curl"](rise_um=0.1),))
        _, fit, signatures, _ = linearised(begun, begun, ("curl",))
        target = fit.data[0].recording.target
        pair = (predict(target, p).heights_um for p in (fit.parameters, lacking(fit.parameters, ["curl"])))
        np.testing.assert_allclose(signatures.done_um["curl"][0], np.subtract(*pair), atol=1e-6)
        assert "curl" not in {one.name for one in signatures.chosen}

    def test_of_another_switch_are_beside_the_effect_as_it_is_and_the_other_way_at_the_end_of_a_range(self):
        kind, ramp = library()["substrate-tilt"], np.tile(np.clip(0.5 * np.arange(40), 0, 8), (20, 1))
        target = HeightMap(ramp, 0.5, 0.5)
        end = declarations(kind)["tilt_x_mrad"][1].high
        there = ParameterSet(paper=PAPER, effects=(kind(tilt_x_mrad=end, tilt_y_mrad=1.0),))
        known = trace(target, there, Levels())
        for switch, direction in (("tilt_x_mrad", -1.0), ("tilt_y_mrad", 1.0)):
            change, _ = signatures_of._change(
                Candidate(there.effects[0], switch), target, np.ones(target.shape, bool), known, there
            )
            moved = replace(there.effects[0], **{switch: getattr(there.effects[0], switch) + direction * 2.5})
            shown = trace(target, replace(there, effects=(moved,)), Levels()).heights_um
            np.testing.assert_allclose(change, (shown - known.heights_um) * direction / 0.5, atol=1e-5)

    def test_a_law_that_begins_with_a_threshold_is_tried_where_it_begins(self):
        """A cone touches flanks steeper than its own, 80° at a half-angle of 10° and 70° at one of 20°."""
        ramp = np.clip(4.0 * (np.arange(60) - 20) * 0.25, 0, 6)
        target = HeightMap(np.tile(ramp, (20, 1)), 0.25, 0.25)
        known = trace(target, ParameterSet(paper=PAPER), Levels())
        cone = Candidate(library()["tip-convolution"](), "half_angle_deg")
        steepest = np.nanmax(np.abs(np.gradient(np.nan_to_num(known.heights_um), 0.25, axis=1)))
        assert np.tan(np.deg2rad(70)) < steepest < np.tan(np.deg2rad(80))

        def change(used):
            return signatures_of._change(cone, target, used, known, ParameterSet(paper=PAPER))[0]

        def expected(share):
            shown = cone.at(share).heights(target.with_heights(known.heights_um))
            return np.nan_to_num(shown - known.heights_um) / share

        everywhere = change(np.ones(target.shape, bool))
        assert everywhere.max() > 0.01
        np.testing.assert_allclose(everywhere, expected(1.0), atol=1e-6)
        np.testing.assert_allclose(change(everywhere < 1e-6), expected(2.0), atol=1e-6)

    @pytest.mark.slow
    def test_they_are_paid_for(self, curled):
        objective, _, signatures, _ = curled
        assert objective.work.predictions > len(signatures.chosen) * 0.1


class TestScreen:
    def test_points_at_what_is_there_with_its_strength(self, curled):
        _, _, _, screen = curled
        best = int(np.argmax(np.abs(screen.z)))
        place = screen.names.index("curl")
        assert abs(screen.z[place]) > 0.98 * abs(screen.z[best]) > 10
        assert screen.amplitude[place] == pytest.approx(0.5, abs=0.1)
        assert screen.visible[place] * screen.amplitude[place] == pytest.approx(screen.z[place])

    def test_columns_are_beside_the_process_and_of_length_one(self, curled):
        _, fit, signatures, screen = curled
        np.testing.assert_allclose(np.diag(screen.products), np.where(screen.lengths > 0, 1, 0), atol=1e-9)
        place = screen.names.index("curl")
        own = fit.rows.stack([fit.seen(0, np.stack(signatures.maps_um[place]))])
        assert screen.lengths[place] == pytest.approx(np.linalg.norm(fit.beside(own)), rel=1e-3)
        assert screen.whole[place] == pytest.approx(np.linalg.norm(fit.nuisances.beside(own)), rel=1e-3)

    def test_the_process_answers_so_that_least_is_left(self, curled):
        _, fit, signatures, screen = curled
        place = screen.names.index("interface-offset")
        own = fit.nuisances.beside(fit.rows.stack([fit.seen(0, np.stack(signatures.maps_um[place]))]))[:, 0]
        moves = fit.nuisances.beside(fit.jacobian) @ [screen.answers[place].get(name, 0.0) for name in fit.free.names]
        assert np.linalg.norm(own + moves) == pytest.approx(screen.lengths[place], rel=1e-3)

    def test_noise_along_a_column_is_one_and_what_computations_differ_by(self, curled):
        """A column of length 1 is σ/√n of a map: 0.2 nm of numerics are 2 of them in a thousand points of 4 nm."""
        _, fit, _, screen = curled
        whole = COHERENT_UM / NOISE.sigma_um * np.sqrt(fit.rows.data)
        seen = screen.lengths > 0
        assert screen.spread[seen].min() >= 1
        assert np.median(screen.spread[seen]) < np.hypot(1.2, whole)

    @pytest.mark.slow
    def test_beside_a_named_effect_sets_weigh_what_they_do_without(self, part, curled):
        """Curl is linear in height: named or not, it gains the same, and so does its rival."""
        truth = ParameterSet(paper=PAPER, effects=(library()["curl"](rise_um=0.1),))
        alone, beside = curled[3], linearised(truth, truth, ("curl",))[3]
        assert beside.named == ("curl",)
        found = []
        for screen in (alone, beside):
            gains = {one.names: one.gain for one in Sets.of(screen, lambda effects: 0.0).ranked}
            found.append([gains[frozenset({name})] for name in ("curl", "field-curvature")])
        np.testing.assert_allclose(found[0], found[1], rtol=0.1, atol=8)

    @pytest.mark.slow
    def test_what_a_model_leaves_that_scatters_along_a_named_effect_is_no_gain_of_its(self, part):
        """What it does, half with one sign and half with the other: no net gain, but the scatter of one."""
        truth = ParameterSet(paper=PAPER, effects=(library()["curl"](rise_um=0.1),))
        objective, fit, signatures, screen = linearised(truth, truth, ("curl",))
        done = fit.nuisances.beside(fit.rows.stack([fit.seen(0, signatures.done_um["curl"])]).ravel())
        blocks = np.nonzero(fit.data[0].recording.used)[0] // 8
        sign = np.append(np.where(blocks % 2, 1.0, -1.0), np.zeros(fit.rows.total - fit.rows.data))
        left = replace(fit, residual=fit.residual + 100 * sign * done / np.linalg.norm(done))
        quiet = Null(fit.rows.stack([np.random.default_rng(1).standard_normal((fit.rows.data, 200))]))
        scattered = Linearised.of(signatures, left, quiet, objective)
        assert 1 <= screen.named_spread[0] < 2.5 < 4 < scattered.named_spread[0]


class TestHidden:
    def test_what_the_process_takes_has_a_second_column_per_direction(self, curled):
        """An offset of the interface is nearly what threshold and focus do."""
        objective, fit, _, screen = curled
        hidden = [k for k, one in enumerate(screen.chosen) if isinstance(one, Bent)]
        assert all(screen.chosen[k].sign == 1 for k in hidden)
        places = {(screen.chosen[k].name, screen.chosen[k].switch, screen.chosen[k].direction) for k in hidden}
        assert len(places) == len(hidden)
        assert ("interface-offset", "offset_um", 1.0) in places and ("interface-offset", "offset_um", -1.0) in places
        assert ("vignetting", "strength", -1.0) not in places
        k = next(k for k in hidden if screen.chosen[k].name == "interface-offset")
        moved = answered(objective, fit, screen.chosen[k])
        assert moved.parameters.effects[0].offset_um == pytest.approx(
            screen.chosen[k].direction * abs(library()["interface-offset"]().switches()["offset_um"])
        )
        assert np.linalg.norm(fit.residual - moved.residual) == pytest.approx(screen.whole[k], rel=1e-6)

    def test_columns_that_nothing_hides_have_no_second_one(self, curled):
        _, _, _, screen = curled
        kept = {}
        for one, left, whole in zip(screen.chosen, screen.lengths, screen.whole, strict=True):
            if not isinstance(one, Bent):
                kept.setdefault(one.name, []).append(left / whole)
        hidden = {one.name for one in screen.chosen if isinstance(one, Bent)}
        assert hidden == {name for name, shares in kept.items() if min(shares) < policy.TAKEN}


def screen_of(products, signs=None, names=None):
    count = len(products)
    effects = [library()[name]() for name in (names or [n for n in library() if library()[n].switches()][:count])]

    class Fixed(Candidate):
        sign = 0

    class Positive(Candidate):
        sign = 1

    kinds = [Positive if sign else Fixed for sign in (signs if signs is not None else np.zeros(count))]
    chosen = [kind(effect, next(iter(effect.switches()))) for kind, effect in zip(kinds, effects, strict=True)]
    one = np.ones(count)
    return Linearised(None, (), chosen, (), products, np.zeros(count), one, one, one, np.zeros(0), [{}] * count, 0.0)


def correlated(count, seed=0):
    columns = np.random.default_rng(seed).normal(size=(20, count)) + np.random.default_rng(9).normal(size=(20, 1))
    columns /= np.linalg.norm(columns, axis=0)
    return columns.T @ columns


def scores_of(products, draws, seed):
    return np.random.default_rng(seed).standard_normal((draws, len(products))) @ np.linalg.cholesky(products).T


class TestThresholds:
    def test_of_one_column_are_those_of_chi_square(self):
        found = thresholds(screen_of(np.eye(1)), 0.025, 0.1, 20.0)
        assert found.first == pytest.approx(stats.chi2.ppf(0.975, 1), rel=0.12)
        assert found.next == pytest.approx(stats.chi2.ppf(0.9, 1), rel=0.1)
        assert found.trials == pytest.approx(1, abs=0.15)

    def test_a_sign_that_is_not_physical_halves_the_tests(self):
        both, one = (thresholds(screen_of(np.eye(1), signs), 0.025, 0.1, 20.0) for signs in ([0], [1]))
        assert one.first == pytest.approx(stats.chi2.ppf(0.95, 1), rel=0.12) and one.first < both.first

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("products", "signs"), [(correlated(9), np.arange(9) % 2), (0.07 * np.eye(7) + 0.93, np.zeros(7))]
    )
    def test_noise_alone_names_something_in_two_and_a_half_percent(self, products, signs):
        """One effect, two that mask each other, or three: in columns that share some, and in some that share most."""
        screen = screen_of(products, signs)
        found = thresholds(screen, policy.LEVEL_NAMES, policy.LEVEL_NEXT, policy.INFLATED)

        def price(effects):
            return found.first + (effects - 1) * found.next if effects else 0.0

        named = []
        for scores in scores_of(products, 400, seed=7):
            drawn = replace(screen, raw=scores)
            named.append(bool(Sets.of(drawn, price).ranked[0].names))
        assert np.mean(named) < 0.025 + 2 * np.sqrt(0.025 / 400)

    def test_noise_alone_adds_one_more_in_ten_percent(self):
        products = correlated(9)
        found = thresholds(screen_of(products), policy.LEVEL_NAMES, policy.LEVEL_NEXT, policy.INFLATED)
        largest = np.max(scores_of(products, 4000, seed=8) ** 2, axis=1)
        assert np.mean(largest > found.next) == pytest.approx(0.1, abs=0.02)
        claimed = np.array([found.p_value(one) for one in largest])
        assert np.mean(claimed < 0.05) == pytest.approx(0.05, abs=0.02)

    def test_many_trials_are_paid_for(self):
        assert Thresholds(0.0, 0.0, 1.0).p_value(3.841459) == pytest.approx(0.05, rel=1e-5)
        assert Thresholds(0.0, 0.0, 10.0).p_value(3.841459) == pytest.approx(1 - 0.95**10, rel=1e-5)
        assert Thresholds(0.0, 0.0, 10.0).p_value(-1.0) == pytest.approx(1)

    def test_where_nothing_is_seen_nothing_is_named(self):
        screen = replace(screen_of(np.eye(2)), lengths=np.zeros(2))
        assert thresholds(screen, 0.025, 0.1, 20.0).first == np.inf
        ranked = Sets.of(screen, lambda effects: 0.0).ranked
        assert [one.names for one in ranked] == [frozenset()]
