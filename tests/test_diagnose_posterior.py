"""Sets of effects: the enumeration against brute force, what is refitted, what is named, and how wide classes are."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from dlwpredict.diagnosis import policy
from dlwpredict.diagnosis.classes import named_in, strengths
from dlwpredict.diagnosis.library.candidates import Bent, Candidate
from dlwpredict.diagnosis.library.process_form import Standing
from dlwpredict.diagnosis.library.score import Linearised, Thresholds
from dlwpredict.diagnosis.posterior import Sets, Subset
from dlwpredict.diagnosis.search import Search
from dlwpredict.diagnosis.starts import FARTHEST, LEAST, START_SHARE
from dlwpredict.effects import library
from dlwpredict.infer.free import choose
from dlwpredict.infer.model import freed, key_of, switched
from dlwpredict.parameters import ParameterSet

THRESHOLDS = Thresholds(12.0, 7.0, 5.0)


def price(effects):
    return THRESHOLDS.first + (effects - 1) * THRESHOLDS.next if effects else 0.0


def typical(name):
    """Return an effect with its first switch on."""
    kind = library()[name]
    return kind(**dict([*kind.switches().items()][:1]))


def screen_of(columns, residual, names=None, signs=None, named=(), own=0, answers=None, switches=None):
    """Return columns of length 1 beside the process; the first `own` of them belong to the named effect."""
    columns = columns / np.linalg.norm(columns, axis=0)
    count = columns.shape[1] - own
    names = names or [f"effect-{k}" for k in range(count)]
    signs = [0] * count if signs is None else signs
    each = zip(names, signs, switches or ["switch"] * count, strict=True)
    chosen = [SimpleNamespace(name=name, sign=sign, switch=switch) for name, sign, switch in each]
    one, model = np.ones(count), SimpleNamespace(parameters=ParameterSet(effects=tuple(map(typical, named))))
    return Linearised(
        model, named, chosen, (slice(0, own),) if named else (), columns.T @ columns, columns.T @ residual, one, one,
        one, np.ones(len(named)), answers or [{} for _ in chosen], float(residual @ residual),
    )  # fmt: skip


def brute_force(screen):
    """Return the gain of every allowed set of up to three columns of different effects, by least squares."""
    found = {}
    for size in (1, 2, 3):
        for own in combinations(range(len(screen.chosen)), size):
            columns = list(own)
            strength = np.linalg.solve(screen.products[np.ix_(columns, columns)], screen.raw[columns])
            signs = screen.signs[columns]
            allowed = (signs == 0) | (np.sign(strength) == signs)
            if len({screen.names[k] for k in own}) == size and allowed.all():
                found[own] = float(strength @ screen.raw[columns])
    return found


def toy(seed, **kinds):
    """Return 12 columns of 60 rows, three of them there."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(60, 12)) + 0.7 * rng.normal(size=(60, 1))
    return screen_of(columns, columns[:, [1, 4, 9]] @ [0.5, -0.7, 0.6] + rng.normal(size=60), **kinds)


class TestEnumeration:
    @pytest.mark.parametrize("seed", range(4))
    def test_is_that_of_brute_force(self, seed):
        signs = np.random.default_rng(seed).integers(-1, 2, 12)
        names = [f"effect-{k // 2}" for k in range(12)]  # two shapes each
        screen = toy(seed, names=names, signs=list(signs))
        best = {}
        for own, gain in brute_force(screen).items():
            key = frozenset(screen.names[k] for k in own)
            best[key] = max(best.get(key, 0.0), gain)
        costs = sorted((screen.cost - gain + price(len(key)), sorted(key)) for key, gain in best.items())
        costs = sorted([*costs, (screen.cost, [])])[:12]
        found = [(one.cost, sorted(one.names)) for one in Sets.of(screen, price).ranked[:12]]
        assert [names for _, names in found] == [names for _, names in costs]
        np.testing.assert_allclose([cost for cost, _ in found], [cost for cost, _ in costs])

    def test_opposed_effects_that_mask_each_other_are_found(self):
        """Alone each explains a gain of 5; together 100, more than any other pair."""
        rng = np.random.default_rng(0)
        columns, _ = np.linalg.qr(rng.normal(size=(80, 12)))
        columns[:, 1] = 0.95 * columns[:, 0] + np.sqrt(1 - 0.95**2) * columns[:, 1]
        screen = screen_of(columns, 32 * (columns[:, 0] - columns[:, 1]) + 0.1 * rng.normal(size=80))
        best = Sets.of(screen, price).ranked[0]
        assert screen.raw[0] ** 2 < 5
        assert best.names == {"effect-0", "effect-1"} and best.gain > 90
        np.testing.assert_allclose(Sets(screen, price, []).strengths(best), [32, -32], atol=1.0)

    @pytest.mark.parametrize(("correlation", "found"), [(0.97, True), (0.98, False)])
    def test_columns_that_are_one_are_no_pair(self, correlation, found):
        """Their joint variance is inflated by 1/(1 − ρ²): 16.9 and 25.3 times."""
        columns, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(40, 2)))
        columns[:, 1] = correlation * columns[:, 0] + np.sqrt(1 - correlation**2) * columns[:, 1]
        ranked = Sets.of(screen_of(columns, 200 * (columns[:, 0] - columns[:, 1])), price).ranked
        assert any(len(one.names) == 2 for one in ranked) is found

    @pytest.mark.parametrize("sign", [1, -1])
    def test_a_strength_that_is_not_physical_gains_nothing(self, sign):
        columns, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(40, 3)))
        screen = screen_of(columns, -9 * columns[:, 0] + 8 * columns[:, 1], signs=[sign, 0, 0])
        gain = {one.names: one.gain for one in Sets.of(screen, price).ranked}
        assert gain[frozenset({"effect-0"})] == pytest.approx(81 if sign < 0 else 0)
        assert gain[frozenset({"effect-0", "effect-1"})] == pytest.approx(145 if sign < 0 else 0)

    def test_beside_a_named_effect_are_its_own_columns_and_sets_without_it(self):
        """The named one has a block of two; without it, all of what it explains is open to the others."""
        rng = np.random.default_rng(3)
        columns = rng.normal(size=(50, 6))
        columns /= np.linalg.norm(columns, axis=0)
        residual = columns @ [5.0, 3.0, 6.0, 0.0, 0.0, 0.0] + 0.5 * rng.normal(size=50)
        screen = screen_of(columns, residual, named=("curl",), own=2)
        found = {one.names: one.gain for one in Sets.of(screen, price).ranked}

        def gain(*own):
            part = columns[:, list(own)]
            return residual @ part @ np.linalg.lstsq(part, residual, rcond=None)[0]

        assert found[frozenset({"curl"})] == pytest.approx(gain(0, 1))
        assert found[frozenset({"curl", "effect-0"})] == pytest.approx(gain(0, 1, 2))
        assert found[frozenset({"effect-0", "effect-1"})] == pytest.approx(gain(2, 3))
        sets = Sets.of(screen, price)
        assert all(one.cost == pytest.approx(screen.cost - one.gain + price(len(one.names))) for one in sets.ranked)
        both = next(one for one in sets.ranked if one.names == {"curl", "effect-0"})
        expected = np.linalg.lstsq(columns[:, :3], residual, rcond=None)[0][2]
        assert sets.strengths(both) == pytest.approx([expected])

    def test_each_switch_that_comes_in_is_a_model_of_its_own_and_each_further_one_is_paid_for(self):
        """Of two shapes of one switch the better; beside the model's own, or in its place."""
        columns, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(40, 5)))
        names, switches = ["field-curvature"] * 3 + ["substrate-tilt"], ["sag", "sag", "coma", "tilt"]
        residual = columns @ [9.0, 5.0, 6.0, 7.0, 8.0]
        new = Sets.of(screen_of(np.delete(columns, 0, 1), residual, names, switches=switches), price).ranked
        assert [one.added for one in new if one.names == {"field-curvature"}] == [(2,), (1,)]
        assert [one.added for one in new if one.names == {"field-curvature", "substrate-tilt"}] == [(2, 3), (1, 3)]
        screen = screen_of(columns, residual, names, switches=switches, named=("field-curvature",), own=1)
        sets = Sets.of(screen, price).ranked
        own = {(one.kept, one.added): one.cost for one in sets if one.names == {"field-curvature"}}
        kept = ("field-curvature",)
        expected = {
            (kept, ()): 81,
            ((), (1,)): 36,
            ((), (2,)): 49,
            (kept, (1,)): 81 + 36 - 7,
            (kept, (2,)): 81 + 49 - 7,
        }
        whole = screen.cost + price(1)
        assert own == pytest.approx({key: whole - gain for key, gain in expected.items()})
        more = [(one.kept, one.added) for one in sets if one.names == {"field-curvature", "substrate-tilt"}]
        assert more == [(kept, (3,))], "one change of the model's own at a time"


def sets_of(gains, cost=1000.0):
    """Return sets by their names' first letters and gains."""
    ranked = [Subset((), (), frozenset(names), gain, cost - gain + price(len(names))) for names, gain in gains.items()]
    return Sets(SimpleNamespace(cost=cost), price, sorted(ranked, key=lambda one: one.cost))


def led(gains, model, reach=20.0):
    return ["".join(sorted(one.names)) for one in sets_of(gains).leading(frozenset(model), reach)]


class TestLeading:
    def test_first_are_singles_near_the_best_and_pairs_that_beat_all_of_them(self):
        gains = {"": 0.0, "a": 100.0, "b": 60.0, "c": 49.0, "de": 140.0, "df": 130.0, "dg": 125.0, "ae": 105.0}
        assert led(gains, "") == ["a", "b", "de", "df"]

    def test_nothing_is_refitted_where_nothing_promises_half_of_what_it_needs(self):
        assert led({"": 0.0, "a": 5.9}, "") == [] and led({"": 0.0, "a": 6.1}, "") == ["a"]

    def test_then_one_more_one_instead_and_one_less(self):
        gains = {"": 0.0, "a": 100.0, "b": 90.0, "ab": 130.0, "ac": 103.0, "bc": 140.0, "c": 20.0}
        assert led(gains, "a") == ["ab", "b"]
        assert led(gains, "ab") == ["bc", "b", "a"]

    def test_in_the_place_of_an_effect_is_what_brings_half_of_what_it_does(self):
        gains = {"": 0.0, "a": 400.0, "b": 210.0, "c": 190.0}
        assert led(gains, "a") == ["b"]
        assert led(gains, "a", reach=250.0) == ["b", "c"]

    def test_of_each_the_two_switches_that_promise_most(self):
        """In the place of its own where that brings half of what it does; beside it where it brings half its price."""
        sets = sets_of({"": 0.0, "a": 100.0, "b": 90.0})
        b = next(one for one in sets.ranked if one.names == {"b"})
        sets.ranked[:0] = [replace(b, added=(k,)) for k in (1, 2, 3)]
        a = next(one for one in sets.ranked if one.names == {"a"})
        own = {((), (4,)): 49.0, ((), (5,)): 51.0, (("a",), (6,)): 103.0, (("a",), (7,)): 104.0, (("a",), (8,)): 110.0}
        sets.ranked.extend(replace(a, kept=kept, added=added, gain=gain) for (kept, added), gain in own.items())
        sets.ranked[sets.ranked.index(a)] = replace(a, kept=("a",))
        found = sets.leading(frozenset("a"), 20.0)
        assert [("".join(one.names), one.added) for one in found] == [
            ("b", (1,)),
            ("b", (2,)),
            *(("a", (k,)) for k in (5, 7, 8)),
        ]


class Toy(Search):
    """A search among fits that are known."""

    def __post_init__(self):
        self.first, self.asked = SimpleNamespace(z=np.zeros(1)), THRESHOLDS

    def without(self, names, name):
        return self.fitted[names - {name}]

    def excused(self, best, rival):
        return 0.0

    def has_stood(self, names, share=1.0, doubted=0.0):
        """Let a set have been asked how it stands beside the doubts: this share of every gain."""
        self.stood[frozenset(names)] = self.fitted[frozenset(names)], Standing(dict.fromkeys(names, share), doubted)


def search(gains, cost=1000.0, **spread):
    """Return a search that has fitted these sets; names of effects by number."""

    def fit(names, gain):
        parameters = ParameterSet(effects=tuple(typical(n) for n in names))
        free = SimpleNamespace(names=names, base=parameters)
        return SimpleNamespace(cost=cost - gain, parameters=parameters, nuisances=True, promise=0.0, free=free)

    fitted = {frozenset(names): fit(names, gain) for names, gain in ({(): 0.0} | gains).items()}
    some = {name.replace("_", "-"): value for name, value in spread.items()}
    return Toy(SimpleNamespace(), None, fitted[frozenset()], {}, fitted=fitted, spread=some)


CURL, FIELD, DARK = ("curl",), ("field-curvature",), ("vignetting",)


class TestSearch:
    def test_the_best_set_costs_least_with_the_price_of_its_size(self):
        """One more must gain 7, and 3 % of what the strongest alone gains: a name may take that of an error of form."""
        assert search({CURL: 200.0, FIELD: 20.0, CURL + FIELD: 212.0}).best() == {"curl"}
        assert search({CURL: 200.0, FIELD: 20.0, CURL + FIELD: 214.0}).best() == {"curl", "field-curvature"}
        assert search({CURL: 11.9}).best() == frozenset()

    def test_every_effect_of_a_set_gains_its_own(self):
        """Together they gain enough, but one of them hardly more than the other alone."""
        found = search({CURL: 0.0, FIELD: 45.0, CURL + FIELD: 46.0, DARK: 30.0})
        found.price = lambda effects: 1.0 * bool(effects)
        found.needed = lambda names, name: 12.0
        assert found.best() == {"field-curvature"}

    def test_a_reduced_model_that_had_to_be_fitted_may_be_the_best(self):
        """Two effects stand together, one of them alone does all: it is fitted only when the other is asked for."""
        found = search({FIELD: 5.0, CURL + FIELD: 100.0})
        alone = search({CURL: 99.0}).fitted[frozenset(CURL)]
        found.without = lambda names, name: found.fitted.setdefault(names - {name}, alone)
        assert found.best() == {"curl"}

    def test_a_set_is_given_up_only_when_all_its_reduced_models_are_known(self):
        """Of three the first gains nothing, which is enough to give them up; without the last the other two do all."""
        three = frozenset(CURL + FIELD + DARK)
        found, asked = search({FIELD + DARK: 200.0, CURL + FIELD + DARK: 240.0}), []
        found.price = lambda effects: 1.0 * bool(effects)
        found.needed = lambda names, name: 30.0
        rest = search({CURL + FIELD: 239.0}).fitted

        def without(names, name):
            asked.append((names, name))
            fewer = names - {name}
            return found.fitted.setdefault(fewer, rest.get(fewer, found.fitted[frozenset()]))

        found.without = without
        found.fitted[frozenset(FIELD + DARK)].cost = 765.0  # without curl 5 are lost
        assert found.best() == frozenset(CURL + FIELD)
        assert {name for names, name in asked if names == three} == three

    def test_one_that_comes_out_better_than_it_was_known_is_weighed_anew(self):
        """The quick fit of one effect brought 10; begun at both, because the other is asked for, it brings 99."""
        found = search({CURL: 10.0, FIELD: 5.0, CURL + FIELD: 100.0})
        alone = search({CURL: 99.0}).fitted[frozenset(CURL)]
        reduced = {frozenset(CURL): alone}

        def without(names, name):
            fewer = names - {name}
            found.fitted[fewer] = reduced.get(fewer, found.fitted[fewer])
            return found.fitted[fewer]

        found.without = without
        assert found.best() == {"curl"}

    @pytest.mark.parametrize(("promise", "settled"), [(60.0, True), (40.0, False)])
    def test_what_a_quick_fit_still_promises_counts_where_it_is_asked_what_may_matter(self, promise, settled):
        """Within 2 · (6 + 5 % of 100) = 22 of 100 comes a fit of 20 that promises 60, not one that promises 40."""
        found, converged = search({CURL: 100.0, DARK: 20.0}), []
        found.fitted[frozenset(DARK)].promise = promise
        found.fitter = SimpleNamespace(
            settled=lambda fit: fit is found.fitted[frozenset(CURL)], settle=lambda fits: converged.extend(fits) or fits
        )
        found._settle_beside(frozenset(CURL))
        assert converged == [found.fitted[frozenset(DARK)]] * settled

    @pytest.mark.parametrize(
        ("names", "gain", "settled"),
        [
            (CURL + DARK, 10079.0, True),  # in the place of 100: within 2 · (6 + 5) of 10100
            (CURL + DARK, 10077.0, False),
            (FIELD + DARK, 9089.0, True),  # in that of 10000: within 2 · (6 + 500)
            (FIELD + DARK, 9087.0, False),
            (DARK, 9590.0, True),  # in that of both: within 6 + 505
            (DARK, 9588.0, False),
            (CURL, 9079.0, True),  # what the other brings beside it is asked of all that both explain
        ],
    )
    def test_what_matters_goes_with_what_it_is_in_the_place_of(self, names, gain, settled):
        found, converged = search({CURL: 10000.0, FIELD: 100.0, CURL + FIELD: 10100.0} | {names: gain}), []
        asked = found.fitted[frozenset(names)]
        found.fitter = SimpleNamespace(
            settled=lambda fit: fit is not asked, settle=lambda fits: converged.extend(fits) or fits
        )
        found.settle(frozenset(CURL + FIELD), [frozenset(names)])
        assert converged == [asked] * settled

    @pytest.mark.parametrize(("gain", "limit"), [(100.0, 921.98), (5.0, 994.0)])
    def test_quick_fits_are_gone_on_with_as_far_as_they_may_matter(self, gain, limit):
        """In the place of 100, within 2 · (6 + 5) of it; where nothing stands, from half of 12 on."""
        found = search({CURL: gain, DARK: 1.0})
        assert found._limits([found.fitted[frozenset(DARK)]]) == pytest.approx([limit])

    @pytest.mark.parametrize("settled", [False, True])
    def test_a_reduced_model_is_begun_where_the_set_was_fitted_once_unless_it_is_converged(self, settled):
        """The quick fit of one of two effects brings 10; begun at both it brings 95."""

        def named_by(parameters):
            return SimpleNamespace(names=[effect.name for effect in parameters.effects], base=parameters)

        found, begun = search({CURL: 10.0, CURL + FIELD: 100.0}), []
        better = search({CURL: 95.0, FIELD: 95.0}).fitted

        def contest(models):
            begun.extend(own[0].parent for own in models)
            return {key_of(named_by(own[0].parameters)): better[found.names(own[0].parameters)] for own in models}

        found.fitter = SimpleNamespace(
            free=named_by,
            settled=lambda fit: settled, reopened=lambda start: True, contest=contest, settle=lambda fits: fits,
            nearer=lambda fits, limits: fits,
        )  # fmt: skip
        both = frozenset(CURL + FIELD)
        costs = [Search.without(found, both, "field-curvature").cost for _ in range(2)]
        assert costs == ([990.0] * 2 if settled else [905.0] * 2)
        assert begun == ([] if settled else [found.fitted[both]])
        assert Search.without(found, both, "curl").cost == 905.0, "each of its effects in turn"

    def test_the_same_names_by_other_switches_are_another_model(self, monkeypatch):
        """Asked for again, a set that other switches fit better is linearised anew: its key is another one."""
        found = search({CURL: 100.0, CURL + FIELD: 110.0})
        monkeypatch.setattr(Toy, "linearised", lambda self, names: SimpleNamespace(model=self.fitted[names]))
        curl, first = frozenset(CURL), found.fitted[frozenset(CURL)]
        for fit, names in ((first, ("curl.sag_um",)), (better := search({CURL: 150.0}).fitted[curl], ("curl.tip_um",))):
            fit.free = SimpleNamespace(names=names, base=fit.parameters)
        key, screen = found.key(curl), found.screen(curl)
        assert screen.model is first and found.screen(curl) is screen
        found.keep([better])
        assert found.key(curl) != key and found.screen(curl).model is better

    def test_what_scatters_more_must_gain_more(self):
        assert search({CURL: 40.0}, curl=1.8).best() == {"curl"}
        assert search({CURL: 40.0}, curl=1.9).best() == frozenset()

    def test_an_effect_whose_place_was_looked_for_must_gain_what_that_costs(self):
        assert search({CURL: 40.0}).best() == {"curl"}
        for price, names in ((20.0, {"curl"}), (40.0, set())):
            found = search({CURL: 40.0})
            found.place_price = {"curl": price}
            assert found.best() == names
            assert found.priced(found.fitted[frozenset(CURL)]) == pytest.approx(960.0 + found.price(1) + price)

    def test_a_form_error_is_no_noise_and_does_not_grow_with_what_scatters(self):
        """Beside 1000, of which a name may take 30, one that scatters twice as much must gain 4 · 7 + 30."""
        for more, names in ((59.0, {"curl", "field-curvature"}), (57.0, {"curl"})):
            found = search({CURL: 1000.0, FIELD: 10.0, CURL + FIELD: 1000.0 + more}, field_curvature=2.0)
            assert found.best() == names

    def test_one_effect_alone_pays_for_no_form(self):
        found = search({CURL: 1000.0})
        assert [found.price(effects) for effects in (0, 1, 2)] == [0, 12, 12 + 7 + 30]

    def test_each_switch_of_an_effect_must_gain_its_own(self):
        """One more gains 6 or 8 beside 20, where the price of one more is 7.6."""
        for more, switches in ((6.0, 1), (8.0, 2)):
            found = search({("substrate-tilt",): 20.0})
            one = found.fitted[frozenset({"substrate-tilt"})]
            both = library()["substrate-tilt"](tilt_x_mrad=3.0, tilt_y_mrad=2.0)
            two = SimpleNamespace(**vars(one) | {"cost": one.cost - more, "parameters": ParameterSet(effects=(both,))})
            found.keep([two])
            (kept,) = found.fitted[frozenset({"substrate-tilt"})].parameters.effects
            assert len(switched(kept)) == switches
            assert found.needed(frozenset({"substrate-tilt"}), "substrate-tilt") == pytest.approx(
                12.0 + (switches - 1) * (7 + 0.03 * (20 + more))
            )

    def test_a_name_must_gain_what_the_process_itself_cannot_have(self):
        """Of 40, 12 must stand: three tenths. Else the next best is taken; what falls for this alone is doubted."""
        found = search({CURL: 40.0, FIELD: 30.0, DARK: 5.0})
        for share, best, doubted in ((0.31, {"curl"}, []), (0.29, {"field-curvature"}, [])):
            found.has_stood(CURL, share)
            assert (found.best(), found.doubted(found.best())) == (best, doubted)
        for name in (CURL, FIELD, DARK):
            found.has_stood(name, 0.1)
        assert found.best() == frozenset()
        assert found.doubted(frozenset()) == ["curl", "field-curvature"]
        found.has_stood(FIELD)
        assert found.doubted(frozenset()) == ["curl"]

    @pytest.mark.parametrize(("doubted", "best"), [(58.0, "curl"), (62.0, "field-curvature")])
    def test_what_the_doubts_explain_beside_a_set_it_does_not_cost(self, doubted, best):
        """Beside the one that costs 10 less they explain 50, beside the other 58 or 62."""
        found = search({CURL: 210.0, FIELD: 200.0})
        found.has_stood((), doubted=80.0)
        found.has_stood(CURL, doubted=50.0)
        assert found.best() == {"field-curvature"}, "not asked of yet, it may be the best"
        found.has_stood(FIELD, doubted=doubted)
        assert found.best() == {best}

    def test_a_set_that_was_not_asked_costs_no_less_than_beside_the_least_of_its_parts(self):
        found = search({CURL: 100.0, FIELD: 60.0, CURL + FIELD: 130.0})
        both, cost = frozenset(CURL + FIELD), lambda names: found.priced(found.fitted[names])
        assert found.beside_doubts(both) == cost(both)
        for names, doubted, least in (((), 80.0, 80.0), (CURL, 50.0, 50.0), (FIELD, 60.0, 50.0), (DARK, 1.0, 50.0)):
            found.fitted.setdefault(frozenset(names), found.baseline)
            found.has_stood(names, doubted=doubted)
            assert found.beside_doubts(both) == pytest.approx(cost(both) - least)
        found.has_stood(CURL + FIELD, doubted=55.0)
        assert found.beside_doubts(both) == pytest.approx(cost(both) - 55)

    @pytest.mark.parametrize(("gain", "again"), [(35.9, False), (36.1, True)])
    def test_a_set_that_does_not_stand_is_not_brought_to_convergence(self, monkeypatch, gain, again):
        """Of the 40 of one effect a tenth stands; the 30 of another stand, also where it has converged.

        That is asked where it converges farther off than two names are apart by.
        """
        found, asked = search({CURL: 40.0, FIELD: 30.0}), []
        known = dict(found.fitted)
        lower = search({FIELD: gain}).fitted[frozenset(FIELD)]

        def standing(model, named, objective):
            asked.append(model)
            return Standing({name: 0.1 if name == "curl" else 1.0 for name in named}, 0.0)

        monkeypatch.setattr("dlwpredict.diagnosis.search.standing", standing)
        found.fitter = SimpleNamespace(
            objective=SimpleNamespace(whole=lambda fit: fit), settled=lambda fit: fit is lower, best=lambda start: lower
        )
        assert found.rested() == {"field-curvature"}
        assert asked == [known[frozenset(one)] for one in ((), CURL, FIELD)] + [lower] * again
        assert found.fitted[frozenset(CURL)] is known[frozenset(CURL)]

    @pytest.mark.parametrize(("promise", "converges"), [(50.0, False), (90.0, True)])
    def test_nor_is_one_that_cannot_stand_by_all_that_it_promises(self, promise, converges):
        """Of 40 and what is promised a tenth stands, and 12 must."""
        found, converged = search({CURL: 40.0}), []
        found.fitted[frozenset(CURL)].promise = promise
        found.has_stood(CURL, 0.1)
        found.fitter = SimpleNamespace(settled=lambda fit: False, settle=lambda fits: converged.extend(fits) or fits)
        found._settle_beside(frozenset())
        assert bool(converged) == converges

    def test_what_a_form_error_may_be_is_doubted_from_the_price_of_a_first_effect_on(self):
        """Beside 1000 one more must gain 7 + 30; from 12 on noise hardly ever makes it."""
        for more, doubted in ((11.0, []), (13.0, ["field-curvature"]), (36.0, ["field-curvature"]), (38.0, [])):
            found = search({CURL: 1000.0, FIELD: 10.0, CURL + FIELD: 1000.0 + more, DARK: 20.0})
            assert found.doubted(frozenset(CURL)) == doubted
        assert search({CURL: 1000.0, DARK: 20.0}).doubted(frozenset()) == []

    def test_what_further_effects_promise_is_what_refits_have_shown(self, monkeypatch):
        found = search({CURL: 30.0, FIELD: 20.0, CURL + FIELD: 50.0})
        found.screen = lambda names: SimpleNamespace(cost=1000.0)
        ranked = [SimpleNamespace(names=frozenset(names), gain=gain)
                  for names, gain in ((CURL, 90.0), (DARK, 25.0), (CURL + DARK, 65.0))]  # fmt: skip
        monkeypatch.setattr(Sets, "of", lambda screen, price: SimpleNamespace(ranked=ranked))
        assert found.promised(frozenset()) == 65, "curl was refitted and brings 30; the pair was not"
        assert found.promised(frozenset(CURL)) == 35
        monkeypatch.setattr(policy, "MOST_EFFECTS", 1)
        assert found.promised(frozenset(CURL)) == np.inf

    def test_two_names_are_apart_by_noise_by_form_and_by_what_is_left(self):
        found = search({CURL: 100.0}, curl=2.0)
        assert found.width(0.0, "curl") == pytest.approx(4)
        expected = 4 + (policy.FORM_ERROR * 100 + 30) / policy.WIDTH
        assert found.width(100.0, "curl", left=30.0) == pytest.approx(expected)

    def test_what_another_noise_may_prefer_is_near(self):
        found = search({CURL: 100.0, FIELD: 80.0, DARK: 75.0, ("curl", "field-curvature"): 101.0})
        found.fitter = SimpleNamespace(settled=lambda fit: len(fit.parameters.effects) == 1)
        starts = [(sorted(found.names(start.parameters)), start.settled) for start in found.near(found.best())]
        both = ["curl", "field-curvature"]
        assert starts == [
            (["curl"], True),
            ([], False),
            (["field-curvature"], True),
            (["vignetting"], True),
            (both, False),
        ]

    def test_a_quick_fit_that_was_converged_already_gives_way_to_the_whole_one(self):
        found = search({CURL: 100.0})
        whole = SimpleNamespace(**vars(found.fitted[frozenset(CURL)]))
        found.keep([whole])
        assert found.fitted[frozenset(CURL)] is whole

    def test_fits_are_told_what_the_best_of_all_explains(self):
        """A descent goes no further than sets are told apart."""
        found = search({CURL: 30.0})
        better = search({FIELD: 40.0}).fitted[frozenset(FIELD)]
        found.keep([better])
        assert found.fitter.explained == 40
        found.keep([found.fitted[frozenset(CURL)]])
        assert found.fitter.explained == 40

    def test_a_set_with_an_effect_that_came_out_off_is_none(self):
        """It would be taken for the smaller set in the next search, and that one would be unknown there."""
        found = search({CURL: 100.0, CURL + FIELD: 101.0})
        found.fitter = SimpleNamespace(settled=lambda fit: True)
        pair = found.fitted[frozenset(CURL + FIELD)].parameters
        off = tuple(replace(one, sag_um=0.0) if one.name == "field-curvature" else one for one in pair.effects)
        for effects, near in ((pair.effects, 3), (off, 2)):
            found.fitted[frozenset(CURL + FIELD)].parameters = replace(pair, effects=effects)
            assert len(found.near(found.best())) == near

    def test_its_reduced_model_is_the_smaller_set(self):
        """Of curl and a field's sag, curl is nothing: without the sag nothing is left, and that is the baseline."""
        found, begun = search({FIELD: 100.0, CURL + FIELD: 101.0}), []

        def free(parameters):
            return SimpleNamespace(names=[effect.name for effect in parameters.effects], base=parameters)

        def contest(models):
            begun.extend(found.names(own[0].parameters) for own in models)
            return {key_of(free(own[0].parameters)): found.fitted[begun[-1]] for own in models}

        found.fitter = SimpleNamespace(
            free=free, settled=lambda fit: False, reopened=lambda start: True,
            contest=contest, settle=lambda fits: fits, nearer=lambda fits, limits: fits,
        )  # fmt: skip
        both = frozenset(CURL + FIELD)
        pair = found.fitted[both].parameters
        off = tuple(replace(one, rise_um=0.0) if one.name == "curl" else one for one in pair.effects)
        found.fitted[both].parameters = replace(pair, effects=off)
        assert Search.without(found, both, "field-curvature") is found.fitted[frozenset()]
        assert Search.without(found, both, "curl") is found.fitted[frozenset(FIELD)]
        assert begun == [frozenset(), frozenset(FIELD)]

        found.fitted[both].parameters = pair  # by other switches curl comes out on: without the sag it is left
        fitted = found.fitted | search({CURL: 5.0}).fitted
        found.fitter.contest = lambda models: {
            key_of(free(own[0].parameters)): fitted[found.names(own[0].parameters)] for own in models
        }
        assert Search.without(found, both, "field-curvature") is found.fitted[frozenset(CURL)]

    def test_the_quick_fit_of_a_first_effect_may_fall_short(self):
        """By a share of the gain: at 1000, 699 is not near, 701 is."""
        found = search({CURL: 1000.0, FIELD: 699.0, DARK: 701.0})
        found.fitter = SimpleNamespace(settled=lambda fit: False)
        assert [sorted(found.names(start.parameters)) for start in found.near(found.best())] == [
            ["curl"],
            [],
            ["vignetting"],
        ]

    @pytest.mark.parametrize(
        ("strength", "begun"),
        [
            (0.8, (0.4, 1.0)),
            (-0.8, (-0.4, -1.0)),
            (0.01, (LEAST, 1.0)),
            (9.0, (START_SHARE * FARTHEST,)),
        ],
    )
    def test_refits_begin_small_and_at_typical_size_and_the_process_has_answered(self, strength, begun):
        found = search({})
        found.baseline.free = choose(ParameterSet())
        found.fitter = SimpleNamespace(free=lambda parameters: freed(parameters, found.baseline.free))
        columns, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(20, 1)))
        screen = screen_of(columns, strength * columns[:, 0], answers=[{"threshold": 0.02}])
        screen.chosen[0] = Candidate(library()["curl"](), "rise_um")
        sets = Sets(screen, price, [])
        starts = found._starts(found.baseline, sets, Subset((), (0,), frozenset({"curl"}), 0.0, 0.0))
        typical = 0.2
        assert [one.parameters.effects[0].rise_um / typical for one in starts] == pytest.approx(begun)
        moved = [one.parameters.paper.threshold - ParameterSet().paper.threshold for one in starts]
        assert moved == pytest.approx([0.02 * share for share in begun])

    def test_another_switch_of_an_effect_comes_in_beside_its_own_or_in_its_place(self):
        bow = library()["field-curvature"](sag_um=0.3)
        found = search({FIELD: 100.0})
        found.baseline.free = choose(ParameterSet())
        found.fitter = SimpleNamespace(free=lambda parameters: freed(parameters, found.baseline.free))
        model = found.fitted[frozenset(FIELD)]
        model.parameters = ParameterSet(effects=(bow,))
        own, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(20, 2)))
        screen = screen_of(own, own @ [1.0, 0.8], named=FIELD, own=1)
        screen.chosen[0] = Candidate(bow, "coma_x_um")
        for kept, sag in (FIELD, 0.3), ((), 0.0):
            start = found._starts(model, Sets(screen, price, []), Subset(kept, (0,), frozenset(FIELD), 0.0, 0.0))[0]
            (begun,) = start.parameters.effects
            assert (begun.sag_um, begun.coma_x_um) == pytest.approx((sag, 0.04))

    @pytest.mark.parametrize("whole", [True, False])
    def test_in_the_place_of_an_effect_begins_where_the_others_were_fitted_without_it(self, whole):
        """Not at the model with it, whose process has answered to it; unless that fit is but a quick one."""
        found = search({DARK: 50.0, CURL + DARK: 100.0})
        found.baseline.free = choose(ParameterSet())
        found.fitter = SimpleNamespace(free=lambda parameters: freed(parameters, found.baseline.free))
        found.fitted[frozenset(DARK)].nuisances = whole
        own, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(20, 3)))
        screen = replace(screen_of(own, own[:, 0], named=("curl", "vignetting"), own=2), blocks=(slice(1), slice(1, 2)))
        screen.chosen[0] = Candidate(library()["field-curvature"](), "sag_um")
        subset = Subset(("vignetting",), (0,), frozenset({"vignetting", "field-curvature"}), 0.0, 0.0)
        model = found.fitted[frozenset(CURL + DARK)]
        (start, *_) = found._starts(model, Sets(screen, price, []), subset)
        assert start.parent is (found.fitted[frozenset(DARK)] if whole else model)
        assert {effect.name for effect in start.parameters.effects} == {"vignetting", "field-curvature"}

    def test_to_a_bend_the_process_has_answered_by_its_root(self):
        found = search({})
        found.baseline.free = choose(ParameterSet())
        found.fitter = SimpleNamespace(free=lambda parameters: freed(parameters, found.baseline.free))
        columns = np.eye(20)[:, :1]
        screen = screen_of(columns, 0.5 * columns[:, 0], answers=[{"threshold": 0.02}])
        screen.chosen[0] = Bent(library()["curl"](), "rise_um", -1.0)
        start = found._starts(found.baseline, Sets(screen, price, []), Subset((), (0,), frozenset(), 0.0, 0.0))[0]
        assert start.parameters.effects[0].rise_um == pytest.approx(-0.2 * 0.5)
        assert start.parameters.paper.threshold - ParameterSet().paper.threshold == pytest.approx(0.01)


class TestClasses:
    """Weights are exp(−Δ/2w) with the width w = spread² + form error + what is left."""

    def test_hold_95_percent(self):
        """2.5 % of one gain of 20 are form error; so the width is 1.17, and 6 behind is a probability of 7 %."""
        (near,) = named_in(search({CURL: 20.0, FIELD: 14.0}), frozenset(CURL), 0.0)
        assert near.names == ["curl", "field-curvature"]
        width = 1 + 0.05 * 20 / 5.99
        assert near.members[1].probability == pytest.approx(1 / (1 + np.exp(6 / 2 / width)))
        assert sum(member.probability for member in near.members) == pytest.approx(1)
        (far,) = named_in(search({CURL: 20.0, FIELD: 12.5}), frozenset(CURL), 0.0)
        assert far.names == ["curl"]

    def test_names_of_a_strong_effect_are_told_apart_by_no_less_than_its_form_may_be_wrong(self):
        """Of 10 000, 500 may be form: 400 behind is no exclusion, 600 is."""
        for behind, names in ((400.0, ["curl", "field-curvature"]), (600.0, ["curl"])):
            (one,) = named_in(search({CURL: 1e4, FIELD: 1e4 - behind}), frozenset(CURL), 0.0)
            assert one.names == names

    @pytest.mark.parametrize(("left", "names"), [(0.0, ["curl"]), (30.0, ["curl", "vignetting"])])
    def test_hold_what_an_unnamed_rest_may_have_put_behind(self, left, names):
        (one,) = named_in(search({CURL: 100.0, DARK: 72.0}), frozenset(CURL), left)
        assert one.names == names

    def test_hold_what_the_form_of_the_process_may_have_put_behind(self):
        """Of a gain of 100 half may be form: what is 45 behind is asked, what is 80 behind is not."""
        found, asked = search({CURL: 100.0, DARK: 55.0, FIELD: 20.0}), []
        found.has_stood(CURL, 0.5)
        found.excused = lambda best, rival: asked.append(rival) or 40.0
        (one,) = named_in(found, frozenset(CURL), 0.0)
        assert asked == [frozenset(DARK)]
        assert one.names == ["curl", "vignetting"] and one.members[1].loss == pytest.approx(5)

    def test_what_form_may_have_put_behind_is_asked_once_of_each_fit(self, monkeypatch):
        found, asked = search({CURL: 100.0, DARK: 55.0}), []
        best, rival = frozenset(CURL), frozenset(DARK)

        def standing(model, named, objective):
            asked.append(model)
            return Standing(dict.fromkeys(named, 1.0), 2.0 * len(asked))

        monkeypatch.setattr("dlwpredict.diagnosis.search.standing", standing)
        found.fitter = SimpleNamespace(objective=SimpleNamespace(whole=lambda fit: fit))
        assert [Search.excused(found, best, rival) for _ in range(2)] == pytest.approx([1.5 * 4 - 2] * 2)
        assert asked == [found.fitted[best], found.fitted[rival]]
        found.fitted[rival] = found.fitted[frozenset()]
        assert Search.excused(found, best, rival) == pytest.approx(1.5 * 6 - 2)
        assert asked[2:] == [found.fitted[frozenset()]]

    def test_a_slot_holds_what_stands_in_its_place_alone(self):
        found = search(
            {CURL: 100.0, DARK: 60.0, FIELD: 95.0, CURL + DARK: 160.0, FIELD + DARK: 158.0, FIELD + CURL: 159.0}
        )
        first, second = named_in(found, frozenset(CURL + DARK), 0.0)
        assert (first.effect.name, second.effect.name) == ("curl", "vignetting")
        assert (first.gain, second.gain) == pytest.approx((100, 60))
        assert first.names == ["curl", "field-curvature"] and second.names == ["vignetting", "field-curvature"]
        assert [member.loss for member in first.members] == pytest.approx([0, 2])

    def test_sides_share_what_the_members_have(self):
        (one,) = named_in(search({CURL: 50.0, FIELD: 50.0}), frozenset(CURL), 0.0)
        assert one.sides == pytest.approx({"print": 0.5, "measurement": 0.5})
        assert [member.effect.name for member in one.others] == ["field-curvature"]

    def test_something_is_there_as_surely_as_it_gains_more_than_noise(self):
        even, sure = (
            named_in(search({CURL: gain}), frozenset(CURL), 0.0)[0].probability for gain in (12.0, 12.0 + 9.19)
        )
        assert (even, sure) == pytest.approx((0.5, 0.99), abs=1e-3)
        (scattered,) = named_in(search({CURL: 48.0}, curl=2.0), frozenset(CURL), 0.0)
        assert scattered.probability == pytest.approx(0.5)
        (doubtful,) = named_in(search({CURL: 12.0 + 9.19}), frozenset(CURL), 59.9)
        assert doubtful.probability == pytest.approx(1 / (1 + np.exp(-9.19 / 11 / 2))), "what is left may be what it is"
        assert scattered.p_value == pytest.approx(THRESHOLDS.p_value(12.0))

    def test_a_rival_refitted_lower_is_no_gain(self):
        """A quick fit may undercut the best set by a hair; it is its equal."""
        (one,) = named_in(search({CURL: 50.0, FIELD: 50.2}), frozenset(CURL), 0.0)
        assert [member.loss for member in one.members] == [0, 0]


def test_strengths_are_those_of_the_effect_and_what_it_shares():
    effect = library()["curl"](rise_um=0.3)
    found = strengths(effect, {"curl.rise_um": (0.2, 0.4), "threshold": (0.1, 0.2)})
    assert found == {"rise_um": {"value": 0.3, "low": 0.2, "high": 0.4, "unit": "µm"}}
