"""The descent and the fitter: they come to rest where nothing is lower, from wherever they begin."""

import json
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from dlwpredict import designs
from dlwpredict.effects import library
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer import fitter as fitting
from dlwpredict.infer.descend import _broyden, _step, descend
from dlwpredict.infer.fitter import Fitter, Start
from dlwpredict.infer.free import Free, choose
from dlwpredict.infer.model import key_of
from dlwpredict.infer.noises import white
from dlwpredict.infer.objective import Fit, Nuisances, Objective, Work
from dlwpredict.infer.priors import PARAMETERS
from dlwpredict.infer.recording import prepare
from dlwpredict.infer.rows import Rows
from dlwpredict.infer.whitened import Whitened
from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.unevenness import Uneven
from dlwpredict.parameters import Paper, ParameterSet
from dlwpredict.process import predict

TRUTH = ParameterSet(paper=Paper(0.55, 1.7, 0.42, 6.0, 8.0, 0.74, 0.96))
KAPPAS = ("shrinkage_min", "shrinkage_max")
NOISE = Noise(0.002, 0.004, 1.0, 0.5, 0.5)
LOW = ParameterSet(paper=replace(TRUTH.paper, shrinkage_min=0.6))


@pytest.fixture(scope="module")
def air() -> HeightMap:
    return designs.air(size_um=24.0, pitch_um=0.5, margin_um=4.0)


@pytest.fixture(scope="module")
def printed(air) -> HeightMap:
    return predict(air, TRUTH)


def objective_of(target: HeightMap, measured: HeightMap, sigma_um: float = 1e-3, **known) -> Objective:
    recording = prepare(target, measured)
    return Objective((Whitened.of(recording, white(recording, sigma_um)),), **known)


def descended(objective: Objective, free: Free, gain: float = 1e-6) -> Fit:
    return descend(objective, objective.differentiated(objective.at(free, free.start)), gain=gain, steps=20)


def by_hand(free: Free, vector: np.ndarray, residual: np.ndarray, jacobian: np.ndarray | None = None) -> Fit:
    """Build a fit without recordings."""
    layout = Rows((len(residual),), (0,), 0)
    nothing = Nuisances(layout, (np.zeros((len(residual), 0)),), (np.zeros((0, 0)),))
    jacobian = np.zeros((len(residual), len(vector))) if jacobian is None else jacobian
    return Fit((), free, vector, (), layout, residual, nothing, (), jacobian)


@dataclass
class Banana:
    """Rosenbrock's valley, residuals 3 (v − u²) and 1 − u: a full step along its floor ends up its flank."""

    free: Free = field(
        default_factory=lambda: Free(ParameterSet(), ("u", "v"), np.array([-5.0, -30.0]), np.array([5.0, 30.0]))
    )
    jacobians: int = 0
    places: int = 0
    explained: float = 0.0

    def at(self, free: Free, vector: np.ndarray, near: Fit | None = None) -> Fit:
        self.places += 1
        return by_hand(free, vector, np.array([3 * (vector[1] - vector[0] ** 2), 1 - vector[0], 0]))

    def differentiated(self, now: Fit) -> Fit:
        """Differentiate what is subtracted: recording − prediction is the residual."""
        self.jacobians += 1
        return replace(now, jacobian=np.array([[6 * now.vector[0], -3.0], [1.0, 0.0], [0.0, 0.0]]))


@dataclass
class Flat(Banana):
    """A residual that hardly answers to u, with derivatives that say it does."""

    def at(self, free: Free, vector: np.ndarray, near: Fit | None = None) -> Fit:
        self.places += 1
        return by_hand(free, vector, np.array([0.9 - 0.01 * vector[0], 0, 0]))

    def differentiated(self, now: Fit) -> Fit:
        self.jacobians += 1
        return replace(now, jacobian=np.array([[0.9, 0.0], [0.0, 0.0], [0.0, 0.0]]))


def test_a_descent_goes_no_further_than_models_are_told_apart():
    """Of 12.1 a step along the valley's floor promises 9: not worth taking where another model has explained 1e4."""
    costs = []
    for explained in (0.0, 1e4):
        valley = Banana(explained=explained)
        begun = valley.differentiated(valley.at(valley.free, np.array((-2.0, 4.0))))
        costs.append(descend(valley, begun).cost)
    assert costs[0] < 0.01 and costs[1] == 9


def test_a_descent_ends_where_derivatives_computed_there_promise_little_that_does_not_come_true():
    """0.81 is promised, and 0.018 comes: the next derivatives would say the same."""
    flat = Flat()
    found = descend(flat, flat.differentiated(flat.at(flat.free, np.zeros(2))))
    assert (flat.jacobians, flat.places) == (1, 2)
    assert found.cost == 0.81 and found.jacobian[0, 0] == 0.9


@pytest.mark.parametrize(("end", "same"), [((0.5, 0.2), True), ((-0.5, -0.2), False)])
def test_another_place_is_in_the_same_valley_where_its_residual_follows_from_the_derivatives(end, same):
    """From (0, 0) to (1, 2) a residual of (0.1, 0) becomes (0.5, 0.2) to first order."""
    free = Banana().free
    found = by_hand(free, np.zeros(2), np.array([0.1, 0.0]), np.array([[-0.4, 0.0], [0.0, -0.1]]))
    assert fitting._leads_to(found, by_hand(free, np.array([1.0, 2.0]), np.array(end))) == same


@pytest.mark.parametrize(
    ("end", "promise", "lower"), [(0.4, 0.0, True), (10.0, 60.0, True), (10.0, 40.0, False), (-8.0, 60.0, False)]
)
def test_another_place_is_descended_from_where_it_is_lower_or_may_become_so(end, promise, lower):
    """Of 100, twice 60 leads below the 1 that is found; and a residual that follows to first order is on its way."""
    free = Banana().free
    found = by_hand(free, np.zeros(2), np.array([1.0]), np.array([[9.0, 0.0]]))
    other = replace(by_hand(free, np.array([1.0, 0.0]), np.array([end])), promise=promise)
    assert fitting._may_be_lower(Banana(), other, found) == lower


@pytest.mark.parametrize("start", [(-1.2, 1.0), (-4.0, 16.0), (3.0, 9.0)])
def test_a_bent_valley_is_not_crawled_along(start):
    """The way over the flank takes a few steps; along the floor alone, up to 13 Jacobians and 37 places."""
    valley = Banana()
    begun = valley.differentiated(valley.at(valley.free, np.array(start)))
    found = descend(valley, begun, gain=1e-5, steps=20)
    np.testing.assert_allclose(found.vector, 1, atol=3e-3)
    assert valley.jacobians <= 5 and valley.places <= 9


class TestStep:
    def test_is_that_of_least_squares(self):
        rng = np.random.default_rng(0)
        free = Free(ParameterSet(), ("u", "v"), np.array([-50.0, -50.0]), np.array([50.0, 50.0]))
        matrix, residual = rng.normal(size=(60, 2)), rng.normal(size=60)
        place, promised = _step(by_hand(free, np.zeros(2), residual, matrix), 0.0)
        expected, left, *_ = np.linalg.lstsq(matrix, residual, rcond=None)
        np.testing.assert_allclose(place, expected, atol=1e-9)
        assert promised == pytest.approx(residual @ residual - left[0])

    def test_on_the_border_both_height_factors_move_as_one(self):
        """The nearest place to (1.1, 0.9) with κ_min ≤ κ_max is (1, 1)."""
        here, wanted = np.array([0.7, 0.95]), np.array([1.1, 0.9])
        fit = by_hand(choose(ParameterSet(), free=KAPPAS), here, wanted - here, np.eye(2))
        np.testing.assert_allclose(_step(fit, 0.0)[0], 1.0, atol=1e-9)

    def test_an_updated_jacobian_explains_the_last_step(self):
        rng = np.random.default_rng(1)
        free = choose(ParameterSet(), free=KAPPAS)
        old = by_hand(free, np.array([0.7, 0.9]), rng.normal(size=60), rng.normal(size=(60, 2)))
        new = by_hand(free, np.array([0.75, 1.0]), rng.normal(size=60))
        moved = _broyden(old, new) @ (new.vector - old.vector)
        np.testing.assert_allclose(moved, old.residual - new.residual, atol=1e-12)


class TestDescent:
    def test_finds_the_height_factors(self, air, printed):
        found = descended(objective_of(air, printed, known={}), choose(LOW, free=KAPPAS))
        np.testing.assert_allclose(found.vector, [0.74, 0.96], atol=1e-6)

    def test_stops_at_the_bound_that_is_in_the_way(self, air, printed):
        base = ParameterSet(paper=replace(TRUTH.paper, shrinkage_min=0.8), bounds={"shrinkage_min": (0.77, 0.9)})
        found = descended(objective_of(air, printed), choose(base, free=KAPPAS))
        assert found.vector[0] == 0.77

    def test_least_height_factor_never_passes_the_largest(self, air, printed):
        taller = printed.with_heights(air.heights_um * 0.8 + 0.02 * (printed.heights_um < 5.8))
        low, high = descended(objective_of(air, taller), choose(TRUTH, free=KAPPAS)).vector
        assert low <= high

    @pytest.mark.slow
    def test_never_climbs(self, air, printed):
        costs: list[float] = []
        work = Work(seen=lambda fit: costs.append(fit.cost))
        objective = objective_of(air, printed, 0.01, work=work)
        free = choose(ParameterSet())
        assert descended(objective, free).cost == min(costs) < costs[0]


def recorded(target: HeightMap, truth: ParameterSet, rng: np.random.Generator) -> Objective:
    heights = predict(target, truth).heights_um + NOISE.simulate(target.shape, rng)
    return Objective((Whitened.of(prepare(target, target.with_heights(heights)), Uneven(NOISE)),))


@dataclass(frozen=True)
class Quick:
    """What a contest keeps of a fit."""

    cost: float
    promise: float = 0.0
    rows: Rows | None = None
    free: SimpleNamespace | None = None
    vector: np.ndarray | None = None
    data: tuple = ()

    @property
    def light(self):
        return self


class TestFitter:
    @pytest.mark.slow
    @pytest.mark.parametrize("seed", [20, 21, 25])
    def test_comes_to_rest_where_one_from_the_truth_does(self, seed):
        """From the paper's defaults, along valleys that bend: crawling along them, two ended 15 and 37 higher."""
        rng = np.random.default_rng(seed)
        ranges = ((0.4, 0.8), (1, 2.5), (0.3, 0.6), (4, 9), (4, 9), (0.6, 0.75), (0.85, 1))
        truth = ParameterSet(paper=Paper(*(rng.uniform(*limits) for limits in ranges)))
        objective = recorded(designs.cin(size_um=20, pitch_um=0.5, margin_um=3), truth, rng)
        found, best = (Fitter(objective, choose(ParameterSet())).best(Start(s)) for s in (ParameterSet(), truth))
        assert found.cost == pytest.approx(best.cost, abs=1)
        error = (found.vector - np.array(list(vars(truth.paper).values()))) / np.linalg.norm(found.estimators, axis=0)
        assert np.abs(error).max() < 4
        assert found.cost / found.rows.data == pytest.approx(1, abs=0.1)

    @pytest.mark.parametrize(
        ("data", "explained", "promises", "limit", "renewed"),
        [
            (20, 0.0, [5.0], 30, 0),
            (20, 0.0, [7.0, 5.0], 30, 1),
            (20, 0.0, [7.0, 7.0], 30, 2),
            (20, 0.0, [9.0] * 9, 30, 2),
            (20, 0.0, [9.0] * 9, 1.5, 2),
            (20, 0.0, [9.0, 7.0], 1.5, 1),
            (20, 0.0, [9.0] * 9, 0.5, 0),
            (-9990, 0.0, [9.0] * 9, 30, 0),
            (20, 1e4, [9.0] * 9, 30, 0),
        ],
    )
    def test_a_quick_fit_goes_on_with_derivatives_anew_while_it_may_matter(
        self, monkeypatch, data, explained, promises, limit, renewed
    ):
        """While its tangent promises more than 6, or than a thousandth of what the model is or was wrong by, here 10.

        And while twice that promise leads below the limit: from 19 by 9 to 1.
        """
        rows, known = Rows((data,), (0,), 0), SimpleNamespace(names=("curl.rise_um",), base=ParameterSet())
        left, hurried = iter([*promises, promises[-1]]), []

        fit = partial(Quick, rows=rows, free=known)
        monkeypatch.setattr(fitting, "promised", lambda fit: next(left))
        monkeypatch.setattr(fitting, "recorded", lambda fit: {})
        monkeypatch.setattr(fitting, "_begun", lambda objective, start, like: fit(start.cost))
        monkeypatch.setattr(fitting, "_hurried", lambda o, begun: hurried.append(begun.cost) or fit(begun.cost - 1))
        monkeypatch.setattr(Fitter, "free", lambda self, parameters: known)
        monkeypatch.setattr(Objective, "at", lambda self, free, vector, near: near)
        monkeypatch.setattr(Objective, "differentiated", lambda self, fit: fit)
        fitter = Fitter(Objective(()), choose(ParameterSet()), explained=explained)
        starts = [SimpleNamespace(cost=cost, parent=None, parameters=ParameterSet()) for cost in (30.0, 20.0)]
        (found,) = fitter.contest([starts]).values()
        assert (found.cost, found.promise) == (19, promises[0])
        (nearer,) = fitter.nearer([found], [limit])
        assert nearer.cost == 19 - renewed and fitter.quick == {key_of(known): nearer}
        assert nearer.promise == promises[min(renewed, len(promises) - 1)], "what it still promises is kept"
        assert hurried == [30, 20, 19, 18][: 2 + renewed], "of several starts the lowest goes on"

    @pytest.mark.parametrize("angle_deg, quick", [(72.0, True), (65.0, False), (50.0, False)])
    def test_a_fit_goes_on_past_the_end_of_a_range_that_nature_does_not_end(self, air, angle_deg, quick):
        """Beside the axis at 0° begins what lies at -18°, which is 72° with the axes exchanged.

        The few steps of a quick fit, with the derivatives of its start, lead there from no farther than that.
        """
        kind = library()["astigmatism"]
        turned, begun = (replace(TRUTH, effects=(kind(*one),)) for one in ((-0.3, angle_deg), (0.2, 1.0)))
        objective = objective_of(air, predict(air, turned))
        fitter = Fitter(objective, choose(TRUTH, free=KAPPAS))
        (hurried,) = fitter.contest([[Start(begun)]]).values()
        assert hurried.parameters.effects[0].log_ratio < 0, "past the end, if not all the way"
        for found, least in ((hurried, 0.03), (fitter.best(Start(begun)), 0.003))[0 if quick else 1 :]:
            (effect,) = found.parameters.effects
            assert effect.log_ratio == pytest.approx(-0.3, abs=least)
            assert effect.angle_deg == pytest.approx(angle_deg, abs=100 * least)

    def test_past_such_an_end_moves_what_has_moved(self, air):
        """An effect whose switch a descent has put to nothing is in the model all the same."""
        known = library()
        begun = replace(TRUTH, effects=(known["astigmatism"](0.2, 0.0), known["vignetting"]()))
        switches = [f"{effect.name}.{name}" for effect in begun.effects for name in effect.switches()]
        free = choose(begun, free=(*KAPPAS, *switches, "astigmatism.angle_deg"))
        objective = objective_of(air, predict(air, TRUTH))
        found = objective.at(free, free.start)
        other = fitting._elsewhere(objective, found, lambda fit: replace(fit, residual=fit.residual / 2))
        assert other.parameters.effects[0] == known["astigmatism"](-0.2, 90.0)
        assert key_of(other.free) == key_of(found.free)

    def test_what_is_said_in_the_end_is_known_to_its_own_accuracy(self, air, printed):
        """Whatever others explain; and where nothing is left to gain, nothing is computed."""
        objective = objective_of(air, printed)
        rough = Fitter(objective, choose(LOW, free=KAPPAS), explained=1e8)
        coarse = rough.best(Start(LOW))
        fine = rough.polished(coarse)
        assert coarse.cost > fine.cost + 1
        np.testing.assert_allclose(fine.vector, [0.74, 0.96], atol=1e-3)
        assert rough.best(Start(LOW)) is fine
        spent = objective.work.predictions
        assert rough.polished(fine) is fine and objective.work.predictions == spent

    def test_only_what_is_asked_for_is_converged(self, monkeypatch):
        costs, converged = {"shrinkage_min": 9.0, "shrinkage_max": 8.0, "threshold": 60.0}, []
        frees = {name: choose(ParameterSet(), free=(name,)) for name in costs}

        def fit(name, cost):
            residual, free = np.array([np.sqrt(cost)]), frees[name]
            return Fit((), free, free.start, (), Rows((1,), (0,), 0), residual, None, (), np.zeros((1, 1))), 1.0

        def best(objective, like, starts, begun):
            converged.append(starts[0].parameters)
            return fit(starts[0].parameters, begun.cost - 1)

        def quickly(objective, like, own):
            return fit(own[0].parameters, costs[own[0].parameters])

        best.__name__, quickly.__name__ = "_best", "_quick"
        monkeypatch.setattr(fitting, "_quick", quickly)
        monkeypatch.setattr(fitting, "_best", best)
        monkeypatch.setattr(fitting, "recorded", lambda found: {})
        monkeypatch.setattr(Fitter, "free", lambda self, name: frees[name])
        contestant = Fitter(Objective(()), choose(ParameterSet()))
        ends = contestant.contest([[SimpleNamespace(parameters=name, parent=None)] for name in costs])
        assert [end.cost for end in ends.values()] == pytest.approx([9, 8, 60])
        quick = list(ends.values())[:2]
        monkeypatch.setattr(Fit, "parameters", property(lambda self: self.free.names[0]))
        assert not converged and not contestant.settled(quick[0])
        assert [end.cost for end in contestant.settle(quick)] == pytest.approx([8, 7])
        assert converged == ["shrinkage_min", "shrinkage_max"] and contestant.settled(quick[0])
        assert contestant.objective.work.predictions == 5

    @pytest.mark.parametrize("quick", [False, True])
    def test_a_stored_fit_is_taken_up(self, air, printed, quick):
        free, stored = choose(LOW, free=KAPPAS), {}

        def fitted(fitter):
            if quick:
                return fitter.contest([[Start(LOW)]])[key_of(free)]
            return fitter.best(Start(LOW))

        first, second = (Fitter(objective_of(air, printed, 0.01), free, stored=stored) for _ in range(2))
        fit = fitted(first)
        assert json.loads(json.dumps(stored)) == stored
        kind = "quick" if quick else "best"
        values = stored[" ".join((kind, *key_of(free)))]["values"]
        assert values == dict(zip(fit.free.names, fit.vector, strict=True))
        again = fitted(second)
        np.testing.assert_array_equal(again.vector, fit.vector)
        assert again.promise == fit.promise and bool(again.promise) is quick
        assert quick or again.jacobian.any(), "with derivatives, from which the search goes on"
        assert again.cost == pytest.approx(fit.cost, abs=1e-3)
        assert second.objective.work.predictions <= first.objective.work.predictions

    @pytest.mark.parametrize("settled", [False, True])
    def test_another_valley_is_looked_for_unless_the_fit_was_the_best_before(self, air, printed, monkeypatch, settled):
        looked = []
        monkeypatch.setattr(fitting, "from_paper", lambda free, vector: looked.append(vector))
        Fitter(objective_of(air, printed, 0.01), choose(LOW, free=KAPPAS)).best(Start(LOW, settled=settled))
        assert len(looked) == (not settled)

    @pytest.mark.slow
    def test_so_it_does_with_an_effect(self):
        rng, drying = np.random.default_rng(21), library()["edge-drying"]
        truth = ParameterSet(paper=Paper(0.6, 1.8, 0.4, 6.0, 7.0, 0.7, 0.95), effects=(drying(depth_um=0.4),))
        objective = recorded(designs.cin(size_um=30, pitch_um=0.5, margin_um=4), truth, rng)
        begun = ParameterSet(effects=(drying(depth_um=0.1),))
        found, best = (Fitter(objective, choose(ParameterSet())).best(Start(s)) for s in (begun, truth))
        assert found.cost == pytest.approx(best.cost, abs=1)

    def test_a_parent_that_has_kept_no_derivatives_is_a_place_to_begin(self, air, printed):
        objective, free = objective_of(air, printed, 0.01), choose(LOW, free=KAPPAS)
        parent = descended(objective, free)
        quick = [fitting._quick(objective, free, [Start(LOW, near)])[0] for near in (parent, parent.light)]
        assert quick[1].cost == pytest.approx(quick[0].cost, abs=0.1)

    @pytest.mark.slow
    def test_a_model_costs_no_more_than_one_that_it_holds(self, air, printed):
        """A start that an answer to first order has thrown far away ends no higher than the parent all the same."""
        objective, free = objective_of(air, printed, 0.01), choose(LOW)
        parent = descended(objective, free)
        lost = replace(parent.parameters, paper=Paper(0.05, 0.4, 0.95, 1.5, 1.5, 0.3, 1.0))
        lost = replace(lost, effects=(library()["curl"](rise_um=0.01),))
        steps = descend(objective, fitting._begun(objective, Start(lost, parent), free), secant=True, steps=5)
        found = fitting._quick(objective, free, [Start(lost, parent)])[0]
        assert found.cost < parent.cost + 1 < steps.cost  # a thousandth of what noise gives

    def test_a_model_is_fitted_once(self, air, printed):
        fitter = Fitter(objective_of(air, printed, 0.01), choose(LOW, free=KAPPAS))
        assert not fitter.has(Start(LOW))
        found = fitter.best(Start(LOW))
        spent = fitter.objective.work.predictions
        assert fitter.has(Start(TRUTH)) and fitter.best(Start(TRUTH)) is found
        assert fitter.objective.work.predictions == spent > 0

    def test_a_quick_fit_above_a_model_that_it_holds_has_not_found_its_own(self, air, printed):
        """It is fitted again from that one; no other start gives it up."""
        objective, begun = objective_of(air, printed, 0.01), replace(LOW, effects=(library()["curl"](rise_um=0.01),))
        fitter = Fitter(objective, choose(LOW, free=KAPPAS))
        parent = fitter.best(Start(LOW))
        (quick,) = fitter.contest([[Start(begun)]]).values()
        for above, known in [(1.0, True), (10.0, False)]:
            scale = np.sqrt((parent.cost + above) / quick.cost)
            fitter.quick[key_of(quick.free)] = replace(quick, residual=scale * quick.residual)
            assert fitter.has(Start(begun))
            assert fitter.has(Start(begun, parent)) is known
        (again,) = fitter.contest([[Start(begun, parent)]]).values()
        assert again.cost < parent.cost + 1 and fitter.opened[key_of(quick.free)] == 1

    def test_an_effect_that_a_quick_fit_has_brought_to_nothing_is_still_a_model_of_its_own(self, air, printed):
        """By its parameters it would be the process alone; by what moves it is not."""
        fitter = Fitter(objective_of(air, printed, 0.01), choose(LOW, free=KAPPAS))
        begun = replace(LOW, effects=(library()["edge-drying"](depth_um=0.2),))
        (quick,) = fitter.contest([[Start(begun)]]).values()
        vector = np.where([name == "edge-drying.depth_um" for name in quick.free.names], 0.0, quick.vector)
        off = replace(quick, vector=vector)
        fitter.quick[key_of(off.free)] = off
        alone = fitter.best(Start(LOW))
        (settled,) = fitter.settle([off])
        assert settled.free.names == off.free.names != alone.free.names and settled.cost <= alone.cost + 0.1

    def test_a_quick_fit_that_was_given_up_is_made_anew(self, air, printed, monkeypatch):
        """From its new start; an interrupted run takes up both, in their order."""
        begun, stored = [], {}

        def quickly(objective, like, own):
            begun.append(own[0].parameters.paper.shrinkage_max)
            free = choose(own[0].parameters, free=KAPPAS)
            return objective.at(free, free.start), 1.0

        quickly.__name__ = "_quick"
        monkeypatch.setattr(fitting, "_quick", quickly)
        starts = [Start(replace(LOW, paper=replace(LOW.paper, shrinkage_max=value))) for value in (0.9, 0.8)]
        for _ in range(2):
            fitter = Fitter(objective_of(air, printed, 0.01), choose(LOW, free=KAPPAS), stored=stored)
            (first,) = fitter.contest([[starts[0]]]).values()
            assert fitter.reopened(starts[1]) and not fitter.has(starts[1])
            (second,) = fitter.contest([[starts[1]]]).values()
            assert (first.parameters.paper.shrinkage_max, second.parameters.paper.shrinkage_max) == (0.9, 0.8)
        assert begun == [0.9, 0.8]

    def test_the_lowest_of_its_starts_wins(self, air, printed):
        free = choose(LOW, free=["exposure_fwhm_z_um", "threshold"])
        far = replace(LOW, paper=replace(TRUTH.paper, exposure_fwhm_z_um=8.0, threshold=0.1))
        alone, both = (
            Fitter(objective_of(air, printed, 0.01), free).best(*map(Start, starts))
            for starts in ((TRUTH,), (far, TRUTH))
        )
        assert both.cost <= alone.cost + 0.1

    def test_what_was_chosen_moves_and_nothing_else(self, air, printed):
        """Of the start's own effects too: one that is off, and one that is held."""
        drying, memory = library()["edge-drying"](depth_um=0.2), library()["dose-memory"]()
        start = replace(LOW, effects=(drying, memory))
        free = choose(start, free=["shrinkage_max", "dose-memory.gain", "edge-drying.depth_um"])
        found = Fitter(objective_of(air, printed, 0.01, known=PARAMETERS), free).best(Start(start))
        assert found.free.names == free.names
        assert found.parameters.paper.shrinkage_min == 0.6
        assert found.parameters.effects[0].depth_um < 0.1
