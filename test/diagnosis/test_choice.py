# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rules by which effects are chosen, on constructed candidates: no vehicle is simulated and nothing is fitted."""

import math
from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.diagnosis.selection import naming
from trackres_ros.diagnosis.selection.naming import Candidate, Step, choose
from trackres_ros.diagnosis.selection.screening import Screened
from trackres_ros.diagnosis.selection.visibility import Sensitivity, Separability
from trackres_ros.effects.effect import Parameter

LAPS, LAP = 20, 5  # laps of so many samples each
LEVEL = -300.0  # log-likelihood of a fit with no effect: only differences count
TORQUE_NM = 100.0
QUIET = 1e6  # Nm of noise, beside which the model's own error gains nothing
DRAWS = 0  # seed


class Plain:
    """Noise whose whitened residuals are log-densities themselves, so that a test can say what each sample gains."""

    dc_gain, phi = 1.0, np.empty(0)

    def __init__(self, std=QUIET):
        self.std = std

    def log_density(self, white):
        return white


class Model:
    """A fit as the choice sees it: effects, what each lap gains by them, and what they cost."""

    def __init__(self, world, effects, start=None, problem=None):
        self.world, self.effect_names = world, tuple(e.name for e in effects)
        self.effects = tuple(SimpleNamespace(effect=e, values=e.values()) for e in effects)
        self.problem = problem or world.problem
        self.at = dict(start or {})
        self.noises = {"torque": world.noise}
        self.noise = world.noise
        self.laps = world.gains_of(self.effect_names)
        # What came before the first sample of a lap is not known: it counts for nothing.
        row = np.concatenate([[np.nan, *np.full(LAP - 1, x / (LAP - 1))] for x in self.laps])
        self.white = [row]
        self.log_likelihood = LEVEL + float(self.laps.sum())
        self.log_evidence = self.log_likelihood - sum(world.costs[name] for name in self.effect_names)
        self.residuals = [np.where(np.arange(LAPS * LAP) % 2, 1.0, -1.0)]
        self.free = tuple(SimpleNamespace(key=(e.name, q.name), std=1.0) for e in effects for q in e.parameters)
        self.predicted = (SimpleNamespace(at_sprockets=np.full(LAPS * LAP, float(len(effects)))),)

    def contribution(self, name):
        return [np.full(LAPS * LAP, self.world.shares[name] * TORQUE_NM)]

    def std_of(self, effect, parameter):
        return self.world.stds[effect, parameter]


class Kind:
    """An effect of one parameter of size, or of such as are given."""

    def __init__(self, name, acts_on="torque", parameters=None):
        self.name, self.acts_on = name, acts_on
        self.parameters = parameters or (Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=0.0),)

    def values(self):
        return {q.name: q.start for q in self.parameters}


class World:
    """What nature would gain by each effect, alone and together.

    Parameters
    ----------
    gains
        Of each effect: in all, spread evenly, or of each lap.
    together
        Of sets of effects that are no sum of the others.
    """

    def __init__(self, gains, together: Mapping = {}, alike=(), costs=2.0, shares=0.1, taken=0.0, threshold=5.0, std=QUIET):
        self.gains = {name: np.broadcast_to(g if np.ndim(g) else g / LAPS, LAPS).astype(float) for name, g in gains.items()}
        self.together = {frozenset(names): value for names, value in together.items()}
        self.effects = {name: Kind(name) for name in gains}
        self.alike, self.threshold = alike, threshold
        self.costs, self.shares, self.taken = (
            {name: x.get(name, default) if isinstance(x, dict) else x for name in gains}
            for x, default in ((costs, 2.0), (shares, 0.1), (taken, 0.0))
        )
        self.stds = {(name, "size"): 0.5 for name in gains}
        self.noise = Plain(std)
        segment = SimpleNamespace(
            kind="torque", mask=np.ones(LAPS * LAP, dtype=bool), block=np.repeat(np.arange(7, 7 + LAPS), LAP)
        )
        session = SimpleNamespace(torque=np.full(LAPS * LAP, TORQUE_NM))
        self.problem = SimpleNamespace(segments=(segment,), sessions=(session,), masks=(segment.mask,))
        self.fitted = []

    def gains_of(self, names):
        if frozenset(names) in self.together:
            return np.broadcast_to(self.together[frozenset(names)] / LAPS, LAPS).astype(float)
        return sum((self.gains[name] for name in names), np.zeros(LAPS))

    def fit(self, problem, effects=(), start=None, noises=None, rounds=3):
        self.fitted.append((tuple(e.name for e in effects), dict(start or {}), rounds))
        return Model(self, effects, start, problem)

    def separability(self, effects, current):
        names = tuple(name for name in effects if name not in current.effect_names)
        cosines = np.eye(len(names))
        for a, b in self.alike:
            if a in names and b in names:
                i, j = names.index(a), names.index(b)
                cosines[i, j] = cosines[j, i] = -0.97
        visible = tuple(self.seen(name) for name in names)
        return Separability(visible, (), names, cosines)

    def seen(self, name, start=None, d_prime=5.0, kept=0.8):
        effect = self.effects[name]
        return Sensitivity(effect, start or effect.values(), ("size",), np.empty(0), kept, d_prime, 0.0, np.empty(0))

    def screen(self, current, visible, replicates, rng, least):
        assert least == 0.0
        before = self.gains_of(current.effect_names).sum()
        gains = {s.effect.name: self.gains_of((*current.effect_names, s.effect.name)).sum() - before for s in visible}
        best_first = sorted(((s, gains[s.effect.name]) for s in visible), key=lambda pair: -pair[1])
        return Screened(tuple(best_first), self.taken, self.threshold, np.zeros(replicates))


@pytest.fixture
def play(monkeypatch):
    """Chooses in a world: steps, fit, and the world."""
    monkeypatch.setattr(naming, "RESAMPLES", 2000)  # enough here

    def it(gains, effects=None, seed=DRAWS, **given):
        world = World(gains, **given)
        for name, changed in (effects or {}).items():
            world.effects[name] = changed
        return run(world, seed)

    def run(world, seed=DRAWS):
        for name in ("fit", "separability", "screen"):
            monkeypatch.setattr(naming, name, getattr(world, name))
        said = []
        steps, found = choose(Model(world, ()), world.effects, 19, np.random.default_rng(seed), said.append)
        return SimpleNamespace(steps=steps, fit=found, world=world, said=said, named=found.effect_names)

    it.run = run
    return it


def candidate(name="x", gain=10.0, criterion=8.0, taken=0.0, share=0.1, fit=None):
    return Candidate(name, fit, gain, criterion, 0.0, 0.5, 5.0, share, taken)


# What a candidate is worth


def test_a_candidate_counts_by_what_it_gains_beyond_other_forms_and_what_it_costs():
    one = candidate(gain=10.0, criterion=8.0, taken=3.0)
    assert (one.net_gain, one.net_evidence) == (7.0, 5.0)
    assert one.counts(6.9)
    assert not one.counts(7.0)
    assert not candidate(gain=10.0, criterion=3.0, taken=3.0).counts(1.0)
    assert candidate(gain=10.0, criterion=3.1, taken=3.0).counts(1.0)


def test_what_hardly_adds_to_the_torque_is_not_worth_a_name():
    assert candidate(share=0.005).counts(1.0)
    assert not candidate(share=0.00499).counts(1.0)


def test_the_hint_is_the_likeliest_of_those_above_noise_where_nothing_was_chosen():
    several = (candidate("a", 9.0, 4.0), candidate("b", 8.0, 6.0), candidate("c", 4.0, 9.0), candidate("d", 9.0, -1.0))

    def hint(candidates, chosen=None):
        return Step(None, None, 5.0, 50.0, (), candidates, chosen, (), {}, 0.0).hint

    assert hint(several) == "b"
    assert hint(several, several[0]) == ""
    assert hint(several[2:]) == ""
    assert hint((candidate("e", 5.0, 4.0),)) == ""
    assert hint((candidate("e", 9.0, 0.0),)) == ""
    assert hint((candidate("e", 9.0, 0.5),)) == "e"
    assert hint((candidate("e", 9.0, -0.5),)) == ""
    assert hint(()) == ""


# Rounds


def test_what_gains_is_named_and_the_rest_is_not(play):
    done = play({"real": 40.0, "noise": 3.0})
    assert done.named == ("real",)
    first, last = done.steps
    assert (first.chosen.name, first.members, first.weights, first.stability) == ("real", ("real",), {"real": 1.0}, 1.0)
    assert (first.chosen.gain, first.chosen.criterion, first.threshold, first.by_noise) == (40.0, 38.0, 5.0, 5.0)
    assert first.before.effect_names == ()
    assert last.chosen is None
    assert last.before.effect_names == ("real",)
    assert done.said == ["naming, round 1: base alone", "naming, round 2: real"]


def test_nothing_is_named_where_nothing_gains_more_than_noise(play):
    done = play({"a": 4.0, "b": 3.0})
    assert done.named == ()
    (only,) = done.steps
    assert only.chosen is None
    assert {c.name for c in only.candidates} == {"a", "b"}
    assert only.hint == ""


def test_at_most_three_are_named_whatever_a_fourth_round_finds(play):
    done = play({"a": 60.0, "b": 50.0, "c": 40.0, "d": 30.0})
    assert done.named == ("a", "b", "c")
    assert [s.chosen.name for s in done.steps] == ["a", "b", "c"]
    assert done.said[-1] == "naming, round 4: a, b, c"


def test_a_best_below_half_of_what_noise_gains_is_not_fitted_at_all(play):
    for gain, threshold, fitted in ((2.4, 5.0, False), (2.6, 5.0, True), (0.9, 1.0, False), (1.1, 1.0, True)):
        done = play({"a": gain}, threshold=threshold)
        assert bool(done.steps[0].candidates) == fitted
        if not fitted:
            (step,) = done.steps
            assert (step.chosen, step.members, step.weights, step.stability) == (None, (), {}, 0.0)
            assert (step.by_noise, step.threshold) == (threshold, threshold)
            assert [(s, g) for s, g in step.screened] == [("a", pytest.approx(gain))]


def test_where_no_effect_can_be_seen_nothing_is_named(play):
    done = play({}, threshold=-1.0)
    assert (done.named, len(done.steps)) == ((), 1)


def test_the_models_own_error_raises_what_counts_and_leaves_a_hint(play):
    samples, std = LAPS * LAP, 2.5
    spurious = 0.5 * samples * (naming.MODEL_ERROR * TORQUE_NM / std) ** 2
    assert spurious == pytest.approx(1.28)
    for quieter, named in ((1.0, ("a",)), (5.0, ("a",)), (5.5, ("a",)), (6.0, ())):
        done = play({"a": 40.0}, std=std / quieter)
        step = done.steps[0]
        assert step.threshold == pytest.approx(max(5.0, quieter**2 * spurious))
        assert (step.by_noise, step.hint) == (5.0, "" if named else "a")
        assert done.named == named


def test_what_whitening_leaves_of_a_constant_it_leaves_of_the_models_error():
    world = World({}, std=2.0)
    whole = naming.spurious_gain(Model(world, ()))
    assert whole == pytest.approx(0.5 * LAPS * LAP * (0.004 * TORQUE_NM / 2.0) ** 2)
    world.noise.dc_gain = 0.5
    assert naming.spurious_gain(Model(world, ())) == pytest.approx(0.25 * whole)


def test_a_gain_that_costs_more_than_it_is_worth_is_none(play):
    assert play({"a": 20.0}, costs=21.0).named == ()
    assert play({"a": 20.0}, costs=19.0).named == ("a",)


def test_what_other_forms_take_counts_off_gain_and_evidence(play):
    assert play({"a": 20.0}, taken=16.0).named == ()
    done = play({"a": 20.0}, taken=14.0)
    assert done.named == ("a",)
    assert (done.steps[0].chosen.net_gain, done.steps[0].chosen.net_evidence) == (6.0, 4.0)


def test_what_adds_next_to_nothing_stands_behind_what_matters(play):
    done = play({"large": 40.0, "tiny": 60.0}, shares={"tiny": 0.001})
    assert done.steps[0].candidates[0].name == "large"
    assert done.steps[0].candidates[1].share == pytest.approx(0.001)
    assert "tiny" not in done.named


# Who is fitted


def fitted_first(done):
    return {names[0] for names, _, rounds in done.world.fitted if len(names) == 1 and rounds != 1}


def test_those_far_behind_to_first_order_are_not_fitted(play):
    gains = {"best": 20.0, "near": 5.1, "far": 4.9, "further": 1.2}
    assert fitted_first(play(gains)) == {"best", "near"}
    # Half of the best is allowed where that is more.
    assert fitted_first(play({"best": 60.0, "near": 31.0, "far": 29.0})) == {"best", "near"}


def test_a_quarter_of_what_noise_gains_is_the_least_worth_a_fit(play):
    assert fitted_first(play({"best": 10.0, "little": 2.6, "less": 2.4}, threshold=10.0)) == {"best", "little"}


@pytest.mark.parametrize("acts_on", ["heat", "cooling"])
def test_what_acts_through_the_temperature_is_fitted_however_far_behind(play, acts_on):
    gains = {"best": 60.0, "warm": 6.0, "cold": 4.0}
    through = {name: Kind(name, acts_on) for name in ("warm", "cold")}
    assert fitted_first(play(gains, through)) == {"best", "warm"}


def test_edges_of_who_is_fitted_count_as_out(play):
    assert fitted_first(play({"best": 20.0, "edge": 5.0})) == {"best"}
    assert fitted_first(play({"best": 10.0, "edge": 2.5}, threshold=10.0)) == {"best"}
    assert fitted_first(play({"best": 60.0, "edge": 5.0}, {"edge": Kind("edge", "heat")})) == {"best"}


def test_a_best_at_half_of_what_noise_gains_is_fitted(play):
    assert fitted_first(play({"best": 2.5})) == {"best"}
    assert fitted_first(play({"best": 1.0}, threshold=1.0)) == {"best"}


def test_one_just_at_what_noise_gains_is_of_no_class(play):
    done = play({"a": 6.0, "b": 5.0}, together={("a", "b"): 6.2}, alike=[("a", "b")])
    assert done.steps[0].members == ("a",)


def test_no_more_than_six_are_fitted(play):
    gains = {f"e{i}": 20.0 - i for i in range(9)}
    assert fitted_first(play(gains)) == {"e0", "e1", "e2", "e3", "e4", "e5"}


def test_the_best_of_several_starts_counts_with_what_shows_most_of_it(play, monkeypatch):
    shape = Parameter("width", "m/s", 0.0, 9.0, 2.0, "of it", more_starts=(6.0,))
    size = Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=5.0)
    world = World({"a": 30.0})
    world.effects["a"] = Kind("a", parameters=(size, shape))
    world.stds = {("a", "size"): 0.5, ("a", "width"): 3.0}
    starts = [{"size": 10.0, "width": width} for width in (2.0, 6.0)]

    def separability(effects, current):
        names = tuple(n for n in effects if n not in current.effect_names)
        seen = [world.seen("a", start, d, k) for start, d, k in zip(starts, (4.0, 6.0), (0.3, 0.6), strict=True) if names]
        return Separability(tuple(seen), (), names, np.eye(len(names)))

    def fit(problem, effects=(), start=None, noises=None, rounds=3):
        found = World.fit(world, problem, effects, start, noises, rounds)
        if effects:
            found.log_likelihood += 7.0 if start["a", "width"] == 2.0 else 0.0
        return found

    world.separability, world.fit = separability, fit
    done = play.run(world)
    chosen = done.steps[0].chosen
    assert chosen.gain == pytest.approx(37.0)
    assert (chosen.kept, chosen.d_prime) == (0.6, 6.0)
    begun = [start for names, start, rounds in world.fitted if names == ("a",) and rounds != 1]
    # A fifth of the way from no effect to the typical one; shapes as they stand.
    assert begun == [{("a", "size"): 6.0, ("a", "width"): width} for width in (2.0, 6.0)]
    effective = 1.0 - 0.25
    assert chosen.bic_gain == pytest.approx(2.0 * 37.0 - math.log(naming.effective_samples(chosen.fit)) * effective)


def test_parameters_count_as_far_as_the_data_settle_them():
    found = SimpleNamespace(
        free=[SimpleNamespace(key=key, std=2.0) for key in (("a", "p"), ("a", "q"), ("a", "r"), ("b", "p"), ("", "base"))],
        std_of=lambda effect, name: {"p": 0.0, "q": 1.0, "r": 5.0}[name],
    )
    assert naming.effective_parameters(found, "a") == pytest.approx(1.75)
    assert naming.effective_parameters(found, "b") == 1.0


@pytest.mark.parametrize(("gain", "std", "expected"), [(1.0, 1.0, 100.0), (0.5, 1.0, 25.0), (0.1, 1.0, 10.0), (1.0, 0.5, 100.0)])
def test_samples_are_worth_less_where_residuals_resemble_each_other(gain, std, expected):
    rows = [np.where(np.arange(120) % 2, 1.0, -1.0), np.full(50, 1e9)]
    mask = np.arange(120) < 100
    segments = [SimpleNamespace(kind="torque", mask=mask), SimpleNamespace(kind="belt", mask=np.ones(50, dtype=bool))]
    noise = SimpleNamespace(dc_gain=gain, std=std)
    found = SimpleNamespace(residuals=rows, problem=SimpleNamespace(segments=segments), noise=noise)
    assert naming.effective_samples(found) == pytest.approx(expected)


def test_the_root_mean_square_is_of_what_counts():
    found = SimpleNamespace(problem=SimpleNamespace(masks=[np.array([True, True, False]), np.array([True, True])]))
    assert naming.rms([np.array([3.0, np.nan, 99.0]), np.array([4.0, 5.0])], found) == pytest.approx(math.sqrt(50.0 / 3.0))


# Classes


def class_of(first, *others, alike=()):
    seen = Separability((), (), tuple(c.name for c in (first, *others)), np.eye(1 + len(others)))
    for name in alike:
        j = seen.names.index(name)
        seen.cosines[0, j] = seen.cosines[j, 0] = 0.96
    return naming._class_of(first, [first, *others], seen)


def test_a_class_holds_those_that_are_nearly_as_likely_weighted_by_evidence():
    first, near, far = candidate("a", 20.0, 18.0), candidate("b", 20.0, 16.0), candidate("c", 20.0, 14.9)
    found = class_of(first, near, far)
    assert list(found) == ["a", "b"]
    assert found["b"] / found["a"] == pytest.approx(math.exp(-2.0))
    assert sum(found.values()) == pytest.approx(1.0)
    assert list(class_of(first, candidate("d", 20.0, 15.0))) == ["a"]


def test_a_weight_that_is_next_to_nothing_is_left_out_but_of_those_that_look_alike():
    first, unlikely = candidate("a", 20.0, 18.0), candidate("b", 20.0, 15.01)
    assert math.exp(-2.99) / (1 + math.exp(-2.99)) < 0.05
    assert list(class_of(first, unlikely)) == ["a"]
    assert class_of(first, unlikely) == {"a": 1.0}
    alike = class_of(first, unlikely, alike=["b"])
    assert list(alike) == ["a", "b"]


def test_those_that_look_alike_are_of_the_class_by_the_likelihood_alone():
    first, costly, worse = candidate("a", 20.0, 18.0), candidate("b", 17.1, 6.0), candidate("c", 16.9, 6.0)
    assert list(class_of(first, costly, worse)) == ["a"]
    assert list(class_of(first, costly, worse, alike=["b", "c"])) == ["a", "b"]


def test_a_first_that_was_not_looked_at_beforehand_is_a_class_of_its_own():
    seen = Separability((), (), ("other",), np.eye(1))
    assert naming._class_of(candidate("a"), [candidate("a")], seen) == {"a": 1.0}


def test_what_looks_alike_is_named_as_one_of_a_class(play):
    done = play({"a": 40.0, "b": 39.0}, together={("a", "b"): 40.5}, alike=[("a", "b")])
    assert done.named == ("a",)
    first = done.steps[0]
    assert first.members == ("a", "b")
    assert first.weights["b"] / first.weights["a"] == pytest.approx(math.exp(-1.0))


def test_only_those_above_noise_that_matter_are_of_a_class(play):
    done = play({"a": 6.0, "b": 4.9}, together={("a", "b"): 6.2}, alike=[("a", "b")])
    assert done.steps[0].members == ("a",)
    done = play({"a": 40.0, "b": 39.0}, together={("a", "b"): 40.5}, shares={"b": 0.001})
    assert done.steps[0].members == ("a",)


# Other laps


def test_a_class_is_widened_by_those_that_other_laps_would_name_until_it_is_stable():
    weights, wins = {"a": 0.9, "b": 0.1}, {"a": 0.5, "b": 0.1, "c": 0.15, "d": 0.1, "e": 0.05}
    members, widened, stability = naming._widened(weights, wins)
    assert members == ("a", "b", "c", "d")
    assert stability == pytest.approx(0.85)
    total = 1.0 + 0.15 + 0.1
    assert widened == pytest.approx({"a": 0.9 / total, "b": 0.1 / total, "c": 0.15 / total, "d": 0.1 / total})


def test_what_is_just_stable_enough_is_named(play, monkeypatch):
    for share, named in ((0.8, ("a",)), (0.799, ())):
        monkeypatch.setattr(naming, "_wins", lambda current, candidates, rng, share=share: {"a": share})
        assert play({"a": 40.0}).named == named


def test_a_class_that_is_stable_is_not_widened_and_those_that_hardly_ever_win_do_not_join():
    assert naming._widened({"a": 1.0}, {"a": 0.8, "b": 0.2}) == (("a",), {"a": 1.0}, 0.8)
    members, _, stability = naming._widened({"a": 1.0}, {"a": 0.5, "b": 0.06, "c": 0.04, "d": 0.04})
    assert members == ("a", "b")
    assert stability == pytest.approx(0.56)
    assert naming._widened({"a": 1.0}, {"a": 0.5, "b": 0.05})[0] == ("a", "b")


def models(**laps):
    world = World(laps)
    return world, Model(world, ()), [candidate_of(world, name) for name in laps]


def candidate_of(world, name):
    fit, gain = Model(world, [world.effects[name]]), world.gains[name].sum()
    return candidate(name, gain, gain - world.costs[name], fit=fit)


def test_wins_are_shares_of_resampled_laps():
    half = np.repeat([0.0, 4.0], LAPS // 2)
    _, base, rivals = models(a=half, b=half[::-1])
    wins = naming._wins(base, rivals, np.random.default_rng(1))
    assert sum(wins.values()) == pytest.approx(1.0)
    assert wins["a"] == pytest.approx(0.5, abs=0.09)  # where both have as many laps the first is counted
    assert naming._wins(base, rivals[:1], np.random.default_rng(1)) == {"a": 1.0}


def test_where_nothing_is_better_than_nothing_nobody_wins():
    laps = np.full(LAPS, -1.0)
    _, base, (loser,) = models(a=laps)
    assert naming._wins(base, [loser], np.random.default_rng(1)) == {"a": 0.0}
    laps = np.where(np.arange(LAPS) == 0, 60.0, -1.0)  # all of it of one lap, which a third of the draws leaves out
    _, base, (lucky,) = models(a=laps)
    assert naming._wins(base, [lucky], np.random.default_rng(1))["a"] == pytest.approx(1.0 - math.exp(-1.0), abs=0.02)


def test_costs_and_priors_weigh_the_same_on_whatever_laps():
    laps = np.full(LAPS, 1.0)
    _, base, (one,) = models(a=laps)
    for gain, worth, share in ((20.0, 0.1, 1.0), (20.0, -0.1, 0.0), (10.0, 0.1, 1.0), (30.0, -0.1, 0.0)):
        # The gain is that of the laps and of the priors; the evidence what is left of it.
        found = candidate("a", gain, worth, fit=one.fit)
        assert naming._wins(base, [found], np.random.default_rng(1)) == {"a": share}
    taken = candidate("a", 20.0, 18.0, taken=18.1, fit=one.fit)
    assert naming._wins(base, [taken], np.random.default_rng(1)) == {"a": 0.0}


def test_what_only_a_few_laps_show_is_not_named(play):
    one_lap = np.where(np.arange(LAPS) == 3, 40.0, 0.0)
    done = play({"a": one_lap})
    (step,) = done.steps
    assert step.chosen is None
    assert step.candidates[0].counts(step.threshold)
    assert step.stability == pytest.approx(1.0 - math.exp(-1.0), abs=0.02)
    assert step.hint == "a"
    three = np.where(np.arange(LAPS) < 3, 14.0, 0.0)
    assert play({"a": three}).named == ("a",)


def test_rivals_of_other_laps_join_the_class(play):
    first, last = np.repeat([4.0, 0.0], LAPS // 2), np.repeat([0.0, 3.8], LAPS // 2)
    done = play({"a": first, "b": last}, together={("a", "b"): 41.0})
    step = done.steps[0]
    assert set(step.members) == {"a", "b"}
    assert step.stability == pytest.approx(1.0)
    assert 0.05 < step.weights["b"] < step.weights["a"]


def test_what_hardly_adds_to_the_torque_is_no_rival_on_any_laps(play):
    on_some_laps = np.where(np.arange(LAPS) < 8, 9.0, -4.0)
    rivals = play({"a": np.full(LAPS, 2.0), "b": on_some_laps})
    assert set(rivals.steps[0].members) == {"a", "b"}
    alone = play({"a": np.full(LAPS, 2.0), "b": on_some_laps}, shares={"b": 0.001})
    assert (alone.steps[0].members, alone.steps[0].stability) == (("a",), 1.0)


def test_another_seed_makes_no_other_choice(play):
    first, last = np.repeat([4.0, 0.0], LAPS // 2), np.repeat([0.0, 3.8], LAPS // 2)
    made = [play({"a": first, "b": last}, together={("a", "b"): 41.0}, seed=seed) for seed in range(4)]
    assert len({(done.named, done.steps[0].members) for done in made}) == 1


# Drop


def test_what_the_others_made_needless_is_dropped(play):
    done = play(
        {"mix": 40.0, "left": 30.0, "right": 29.0},
        together={("mix", "left"): 52.0, ("mix", "left", "right"): 70.0, ("left", "right"): 68.0, ("mix", "right"): 51.0},
    )
    assert set(done.named) == {"left", "right"}
    assert [s.chosen.name for s in done.steps if s.chosen] == ["left", "right"]
    assert done.steps[-1].chosen is None


def test_what_still_gains_its_threshold_stays(play):
    done = play(
        {"a": 40.0, "b": 30.0, "c": 1.0},
        together={("a", "b"): 70.0, ("a",): 64.9, ("b",): 30.0, ("a", "b", "c"): 71.0},
    )
    assert set(done.named) == {"a", "b"}


def dropped(gains, together, **given):
    """`_drop` of two that were chosen one after the other: what is left."""
    world = World(gains, together, **given)
    both = Model(world, [world.effects[n] for n in gains])
    names = list(gains)
    steps = [Step(None, None, 5.0, 5.0, (), (), candidate_of_taken(world, n), (n,), {n: 1.0}, 1.0) for n in names] + [
        Step(None, None, 5.0, 5.0, (), (), None, (), {}, 0.0)
    ]
    return world, both, steps


def candidate_of_taken(world, name):
    return candidate(name, 40.0, 38.0, taken=world.taken[name], fit=None)


@pytest.mark.parametrize(
    ("of_a", "costs", "taken", "left"),
    [
        (5.1, 2.0, 0.0, ("a", "b")),
        (4.9, 2.0, 0.0, ("b",)),
        (7.9, 2.0, 3.0, ("b",)),  # above the threshold, but not beyond what other forms of the others take
        (8.1, 2.0, 3.0, ("a", "b")),
        (9.0, 9.5, 0.0, ("b",)),  # dearer than what it gains
        (9.6, 9.5, 0.0, ("a", "b")),
    ],
)
def test_an_effect_stays_as_long_as_it_gains_beside_the_others(monkeypatch, of_a, costs, taken, left):
    together = {("a", "b"): 40.0 + of_a, ("b",): 40.0}
    world, both, steps = dropped({"a": 30.0, "b": 30.0}, together, costs={"a": costs}, taken={"a": taken})
    monkeypatch.setattr(naming, "fit", world.fit)
    found, kept = naming._drop(both, steps)
    assert found.effect_names == left
    assert [s.chosen.name for s in kept if s.chosen] == list(left)
    assert kept[-1].chosen is None


def test_the_last_one_is_never_dropped(monkeypatch):
    world, both, steps = dropped({"a": 1.0, "b": 1.0}, {("a", "b"): 1.5})
    monkeypatch.setattr(naming, "fit", world.fit)
    found, _ = naming._drop(both, steps)
    assert found.effect_names == ("b",)


# Compare again


def test_the_first_is_compared_again_beside_what_came_later(play):
    """`near` explains a part of what `second` does, and so came before `real`; with `second` there `real` is the better."""
    done = play(
        {"near": 60.0, "real": 55.0, "second": 40.0},
        together={("near", "second"): 91.0, ("real", "second"): 95.0, ("near", "real"): 70.0, ("near", "real", "second"): 95.5},
    )
    assert done.steps[0].chosen.name == "real"
    assert set(done.named) == {"real", "second"}
    first = done.steps[0]
    assert first.before.effect_names == ("second",)
    assert first.chosen.gain == pytest.approx(55.0)
    assert first.members == ("real",)
    assert {c.name for c in first.candidates} >= {"near", "real"}
    assert first.stability == 1.0


def test_rivals_that_stay_alike_beside_the_others_stay_one_of_a_class(play):
    done = play(
        {"a": 60.0, "b": 59.0, "second": 40.0},
        together={("a", "b"): 61.0, ("a", "second"): 100.0, ("b", "second"): 101.0, ("a", "b", "second"): 102.0},
    )
    first = done.steps[0]
    assert first.chosen.name == "b"
    assert first.members == ("b", "a")
    assert first.weights["a"] / first.weights["b"] == pytest.approx(math.exp(-1.0))


@pytest.mark.parametrize(
    ("changed", "compared"),
    [
        ({}, True),
        ({"share": 0.001}, False),
        ({"gain": 5.0}, False),
        ({"criterion": 23.0}, False),
        ({"criterion": 23.1}, True),
        ({"name": "second"}, False),
        ({"taken": 35.0}, False),
    ],
    ids=str,
)
def test_only_rivals_that_come_near_are_compared_again(monkeypatch, changed, compared):
    world = World({"a": 40.0, "b": 39.0, "second": 30.0}, {("b", "second"): 100.0, ("a", "second"): 70.0})
    monkeypatch.setattr(naming, "fit", world.fit)
    chosen = candidate("a", 40.0, 38.0, fit=Model(world, [world.effects["a"]]))
    given = {"name": "b", "gain": 39.0, "criterion": 37.0, **changed}
    rival = candidate(fit=Model(world, [world.effects["b"]]), **given)
    current = Model(world, [world.effects["a"], world.effects["second"]])
    seen = world.separability(world.effects, Model(world, ()))
    step = Step(None, seen, 5.0, 5.0, (), (chosen, rival), chosen, ("a",), {"a": 1.0}, 1.0)
    last = Step(None, None, 5.0, 5.0, (), (rival,), None, (), {}, 0.0)
    found, steps = naming._compared_again(current, [step, last], np.random.default_rng(1))
    assert steps[1] is last
    if compared:
        assert steps[0].chosen.name == "b"
        assert set(found.effect_names) == {"b", "second"}
        assert [c.name for c in steps[0].candidates] == ["b", "a"]
    else:
        assert steps[0] is step
        assert found is current


def test_a_rival_begins_where_it_lay_before(monkeypatch):
    world = World({"a": 40.0, "second": 30.0})
    monkeypatch.setattr(naming, "fit", world.fit)
    before = candidate("a", taken=1.5, fit=Model(world, [world.effects["a"]], {("a", "size"): 4.0, ("", "bearing"): 9.0}))
    without = Model(world, [world.effects["second"]], {("second", "size"): 7.0, ("", "bearing"): 2.0})
    found = naming._beside(without, [world.effects["second"]], before)
    names, start, _ = world.fitted[-1]
    assert names == ("second", "a")
    assert start == {("a", "size"): 4.0, ("second", "size"): 7.0, ("", "bearing"): 2.0}
    assert (found.name, found.gain, found.form_error_gain, found.kept, found.d_prime) == ("a", pytest.approx(40.0), 1.5, 0.5, 5.0)


# Apart


def test_members_that_another_round_chose_leave_the_class(play):
    """Both are there in the end, so they were told apart, however alike they looked at first."""
    done = play({"a": 40.0, "b": 39.5, "c": 38.5}, together={("b", "c"): 79.0}, alike=[])
    assert set(done.named) == {"a", "b", "c"}
    for step in done.steps[:3]:
        assert step.members == (step.chosen.name,)
        assert step.weights == {step.chosen.name: 1.0}


def test_the_weights_of_those_that_stay_add_up_again():
    step = Step(None, None, 5.0, 5.0, (), (), candidate("a"), ("a", "b", "c"), {"a": 0.5, "b": 0.3, "c": 0.2}, 0.9)
    apart = naming._apart(step, ("a", "c"))
    assert apart.members == ("a", "b")
    assert apart.weights == pytest.approx({"a": 0.625, "b": 0.375})
    none = Step(None, None, 5.0, 5.0, (), (), None, (), {}, 0.0)
    assert naming._apart(none, ("a",)) is none
