# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 5, second half: candidates that survive are re-fitted together with the base, compared, and chosen forward and back."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.noise import Noise, shortened
from trackres_ros.diagnosis.inference.threads import side_by_side
from trackres_ros.diagnosis.selection.screening import Screened, screen
from trackres_ros.diagnosis.selection.visibility import Sensitivity, Separability, separability
from trackres_ros.effects.effect import Effect

Array = NDArray[np.float64]

MOST_EFFECTS = 3
MOST_REFITTED = 6
FAR_BEHIND = 15.0  # in log-likelihood, to first order: no refit makes that good
BORNE_OUT = 0.25  # of its gain to first order: a fit that gains less does not bear it out
THROUGH_TEMPERATURE = ("heat", "cooling")  # but for what is far from linear
ALIKE_WITHIN = 3.0  # in log-likelihood
STABLE_SHARE = 0.8
RESAMPLES = 10_000  # of laps: a vote near the line is the same with any seed
LEAST_WEIGHT = 0.05
LEAST_SHARE = 0.005  # of the torque, root mean square: what adds less hardly matters
MODEL_ERROR = 0.004  # of the torque, root mean square and slow: what a re-fitted base is off by where nothing is missing


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect fitted together with the base.

    Attributes
    ----------
    name, fit
        The effect, and the fit with it.
    gain
        In log-likelihood over the fit without.
    criterion
        The same in log-evidence: less what its parameters cost.
    bic_gain
        Twice the gain less the logarithm of the effective sample for each parameter that the data settle; for comparison.
    kept, d_prime
        See `visibility.Sensitivity`.
    share
        Of the torque that it adds, root mean square.
    form_error_gain
        What other forms of the effects beside it take of the gain, see `form_error.other_forms`.
    """

    name: str
    fit: Fit
    gain: float
    criterion: float
    bic_gain: float
    kept: float
    d_prime: float
    share: float
    form_error_gain: float

    @property
    def effect(self) -> Effect:
        """The effect itself."""
        return next(a.effect for a in self.fit.effects if a.effect.name == self.name)

    @property
    def net_gain(self) -> float:
        """The gain beyond what other forms of the effects beside it take."""
        return self.gain - self.form_error_gain

    @property
    def net_evidence(self) -> float:
        """The same in log-evidence."""
        return self.criterion - self.form_error_gain

    def counts(self, threshold: float) -> bool:
        """Whether it deserves a name."""
        return self.matters and self.net_gain > threshold and self.net_evidence > 0.0

    @property
    def matters(self) -> bool:
        """Whether it adds enough to be worth a name."""
        return self.share >= LEAST_SHARE


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the forward choice.

    Attributes
    ----------
    before
        The fit it began with.
    separability, screened
        What could be seen, and the gains to first order.
    by_noise, threshold
        The gain that noise alone reaches once in twenty; and the one that counts, which is also more than the model's own
        error may give.
    candidates
        Those re-fitted, best first.
    chosen
        The best, if it counts; else None.
    members, weights
        Effects that explain it as well, and how likely each is.
    stability
        Share of resampled laps in which the class wins.
    """

    before: Fit
    separability: Separability
    by_noise: float
    threshold: float
    screened: tuple[tuple[str, float], ...]
    candidates: tuple[Candidate, ...]
    chosen: Candidate | None
    members: tuple[str, ...]
    weights: Mapping[str, float]
    stability: float

    @property
    def hint(self) -> str:
        """The effect that would be named if the model were exact; empty where none would, or one was."""
        if self.chosen is not None:
            return ""
        beyond = [c for c in self.candidates if c.net_gain > self.by_noise and c.net_evidence > 0.0]
        return max(beyond, key=lambda c: c.net_evidence).name if beyond else ""


def choose(
    base_fit: Fit,
    effects: Mapping[str, Effect],
    replicates: int,
    rng: np.random.Generator,
    on_stage: Callable[[str], None] = lambda _: None,
) -> tuple[list[Step], Fit]:
    """Choose at most `MOST_EFFECTS` effects, each only if it gains more than noise would; then drop what others made needless,
    and compare each with its rivals again, now that the others are there.

    Returns
    -------
    steps, fit
        All rounds, the last of them without a choice unless the limit was reached; and the final fit.
    """
    steps: list[Step] = []
    current = base_fit
    for round_ in range(MOST_EFFECTS + 1):
        on_stage(f"naming, round {round_ + 1}: {', '.join(current.effect_names) or 'base alone'}")
        step = one_round(current, effects, replicates, rng)
        steps.append(step)
        if step.chosen is None or round_ == MOST_EFFECTS:
            break
        current = step.chosen.fit
    if len(current.effects) > 1:
        current, steps = _drop(current, steps)
        current, steps = _compared_again(current, steps, rng)
    return [_apart(s, current.effect_names) for s in steps], current


def _apart(step: Step, chosen: Sequence[str]) -> Step:
    """A round without those members of its class that another round chose: both are there, so they were told apart."""
    if step.chosen is None:
        return step
    kept = {m: w for m, w in step.weights.items() if m == step.chosen.name or m not in chosen}
    total = sum(kept.values())
    return replace(step, members=tuple(kept), weights={m: w / total for m, w in kept.items()})


def one_round(current: Fit, effects: Mapping[str, Effect], replicates: int, rng: np.random.Generator, least: float = 0.0) -> Step:
    """Which effect, if any, explains most of what a fit leaves; of one name there may be several, of which the best counts. One
    that gains less than `least` to first order is none.
    """
    seen = separability(effects, current)
    screened = screen(current, seen.visible, replicates, rng, least)
    gains = tuple((s.effect.name, gain) for s, gain in screened.gains)
    threshold = max(screened.threshold, spurious_gain(current))
    candidates = _refitted(current, screened)
    if not candidates:
        return Step(current, seen, screened.threshold, threshold, gains, (), None, (), {}, 0.0)
    candidates.sort(key=lambda c: (not c.matters, -c.net_evidence))
    first = candidates[0]
    weights = _class_of(first, [c for c in candidates if c is first or (c.matters and c.net_gain > screened.threshold)], seen)
    wins = _wins(current, [c for c in candidates if c is first or c.matters], rng)
    members, weights, stability = _widened(weights, wins)
    chosen = first if first.counts(threshold) and stability >= STABLE_SHARE else None
    return Step(current, seen, screened.threshold, threshold, gains, tuple(candidates), chosen, members, weights, stability)


def _refitted(current: Fit, screened: Screened) -> list[Candidate]:
    """Effects that may gain most to first order, fitted.

    The others are measured by the best; but not by one whose fit does not bear out its gain to first order: a delay, whose
    likeness to the lag that any sensor has is far from linear, would keep what is there from being looked at.
    """
    fitted, misleading = dict[str, Candidate](), set[str]()
    while True:
        looked_at = _may_be_best(screened, misleading)
        new = [name for name in looked_at if name not in fitted][: MOST_REFITTED + len(misleading) - len(fitted)]
        if not new:
            return list(fitted.values())
        tasks = [(looked_at[name], screened.form_error_gain.get(name, 0.0)) for name in new]
        fitted.update(
            zip(new, side_by_side(lambda task: _refit(current, *task), tasks, "fits of those that may explain it"), strict=True)
        )
        first_order = {name: max(gain for s, gain in screened.gains if s.effect.name == name) for name in fitted}
        misleading = {name for name, c in fitted.items() if c.gain < BORNE_OUT * first_order[name]}


def _may_be_best(screened: Screened, misleading: Collection[str]) -> dict[str, list[Sensitivity]]:
    """By name the sensitivities that are to be fitted, of effects the best of which is no misleading one."""
    best = max((gain for s, gain in screened.gains if s.effect.name not in misleading), default=0.0)
    if best < 0.5 * screened.threshold or best < 1.0:
        return {}
    within = max(FAR_BEHIND, 0.5 * best)
    worth = dict[str, list[Sensitivity]]()
    for s, gain in screened.gains:
        near = gain > best - within or (s.effect.acts_on in THROUGH_TEMPERATURE and gain > screened.threshold)
        if near and gain > 0.25 * screened.threshold:
            worth.setdefault(s.effect.name, []).append(s)
    return worth


def spurious_gain(current: Fit) -> float:
    """Log-likelihood that an effect can gain by mending the model's own error.

    That error does not average out: the longer a recording and the smaller its noise, the more it looks like physics.
    """
    torque = rms([s.torque for s in current.problem.sessions], current)
    samples = sum(int(mask.sum()) for mask in current.problem.masks)
    return 0.5 * samples * (MODEL_ERROR * torque * current.noise.dc_gain / current.noise.std) ** 2


def _refit(current: Fit, found: Sequence[Sensitivity], form_error_gain: float) -> Candidate:
    """The best of the fits from each start."""
    active = [a.effect for a in current.effects]
    fits = (
        fit(current.problem, [*active, s.effect], {**current.at, **_begin(s)}, noises)
        for s in found
        for noises in begun_with(current)
    )
    best = max(fits, key=lambda f: f.log_likelihood)
    strongest = max(found, key=lambda s: s.d_prime)
    return compared(current, best, strongest.effect.name, strongest.kept, strongest.d_prime, form_error_gain)


def begun_with(current: Fit) -> list[Mapping[str, Noise]]:
    """Noises that a fit with one more effect may begin with: see `noise.shortened`."""
    short = shortened(current.noise)
    return [current.noises] if short is None else [current.noises, {**current.noises, "torque": short}]


def compared(current: Fit, found: Fit, name: str, kept: float, d_prime: float, form_error_gain: float) -> Candidate:
    """What a fit with one more effect gains over the one without."""
    gain = found.log_likelihood - current.log_likelihood
    bic = 2.0 * gain - np.log(effective_samples(found)) * effective_parameters(found, name)
    criterion = found.log_evidence - current.log_evidence
    share = rms(found.contribution(name), found) / max(rms([s.torque for s in found.problem.sessions], found), 1e-12)
    return Candidate(name, found, gain, criterion, bic, kept, d_prime, share, form_error_gain)


def rms(series: Sequence[Array], found: Fit) -> float:
    """Root mean square over the samples that count."""
    used = np.concatenate([x[m] for x, m in zip(series, found.problem.masks, strict=True)])
    return float(np.sqrt(np.mean(used[np.isfinite(used)] ** 2)))


def _begin(sensitivity: Sensitivity) -> dict[tuple[str, str], float]:
    """Values to begin a fit at: a fifth of the typical effect, so that its sign may turn and its shape can be felt."""
    values = dict(sensitivity.start)
    for q in sensitivity.effect.parameters:
        if q.off is not None:
            values[q.name] = q.off + 0.2 * (q.start - q.off)
    return {(sensitivity.effect.name, parameter): value for parameter, value in values.items()}


def effective_parameters(found: Fit, effect: str) -> float:
    """How many parameters of an effect the data settle: one as unsure as its bounds allow is none."""
    of = [f for f in found.free if f.key[0] == effect]
    return float(sum(1.0 - min(1.0, (found.std_of(*f.key) / f.std) ** 2) for f in of))


def effective_samples(found: Fit) -> float:
    """Samples that autocorrelated residuals are worth for a constant."""
    torque = [(r, g.mask) for r, g in zip(found.residuals, found.problem.segments, strict=True) if g.kind == "torque"]
    variance = float(np.var(np.concatenate([r[m] for r, m in torque])))
    samples = sum(int(m.sum()) for _, m in torque)
    return max(10.0, samples * min(1.0, found.noise.dc_gain**2 * variance / found.noise.std**2))


def _class_of(first: Candidate, candidates: Sequence[Candidate], seen: Separability) -> dict[str, float]:
    """Weights of the candidates that explain as much as the first: by BIC, or by the likelihood alone where they look alike."""
    alike = set(seen.alike(first.name)) if first.name in seen.names else {first.name}
    near = [
        c
        for c in candidates
        if c.net_evidence > first.net_evidence - ALIKE_WITHIN or (c.name in alike and c.gain > first.gain - ALIKE_WITHIN)
    ]
    raw = np.exp(np.array([c.net_evidence for c in near]) - first.net_evidence)
    weights = raw / raw.sum()
    kept = [(c.name, float(w)) for c, w in zip(near, weights, strict=True) if w >= LEAST_WEIGHT or c.name in alike]
    total = sum(w for _, w in kept)
    return {name: w / total for name, w in kept}


def _widened(weights: Mapping[str, float], wins: Mapping[str, float]) -> tuple[tuple[str, ...], dict[str, float], float]:
    """The class with the rivals that other laps would have named, until it wins in `STABLE_SHARE` of them; and how often."""
    widened = dict(weights)
    for name, share in sorted(wins.items(), key=lambda pair: -pair[1]):
        if sum(wins[m] for m in widened) >= STABLE_SHARE or share < LEAST_WEIGHT:
            break
        widened.setdefault(name, share)
    total = sum(widened.values())
    return tuple(widened), {m: w / total for m, w in widened.items()}, sum(wins[m] for m in widened)


def _wins(current: Fit, candidates: Sequence[Candidate], rng: np.random.Generator) -> dict[str, float]:
    """Share of resamples of the laps in which each candidate is the best, and better than nothing."""
    blocks = np.unique(np.concatenate([g.block[g.mask] for g in current.problem.segments]))
    table = np.zeros((len(candidates), len(blocks)))
    _, null = _log_density(current)
    for i, candidate in enumerate(candidates):
        block, density = _log_density(candidate.fit)
        table[i] = np.bincount(np.searchsorted(blocks, block), weights=density - null, minlength=len(blocks))
    draws = rng.multinomial(len(blocks), np.full(len(blocks), 1.0 / len(blocks)), size=RESAMPLES)
    penalty = np.array([c.gain - c.net_evidence for c in candidates])
    by_priors = np.array([c.gain for c in candidates]) - table.sum(axis=1)  # the same on whatever laps
    scores = draws @ table.T + by_priors - penalty
    best = np.argmax(scores, axis=1)
    better = scores.max(axis=1) > 0.0
    return {c.name: float(np.mean((best == i) & better)) for i, c in enumerate(candidates)}


def _log_density(found: Fit) -> tuple[NDArray[np.int64], Array]:
    """Block and log-density of each whitened residual."""
    blocks, densities = [], []
    for segment, white in zip(found.problem.segments, found.white, strict=True):
        valid = np.isfinite(white)
        blocks.append(segment.block[valid])
        densities.append(found.noises[segment.kind].log_density(white[valid]))
    return np.concatenate(blocks), np.concatenate(densities)


def _drop(current: Fit, steps: list[Step]) -> tuple[Fit, list[Step]]:
    """Leave out what gains less than its threshold once the others are there."""
    needed = {s.chosen.name: s.threshold + s.chosen.form_error_gain for s in steps if s.chosen}
    for name in current.effect_names:
        others = [a.effect for a in current.effects if a.effect.name != name]
        if others:
            reduced = fit(current.problem, others, current.at, current.noises)
            gain = current.log_likelihood - reduced.log_likelihood
            if gain < needed.get(name, 0.0) or current.log_evidence < reduced.log_evidence:
                current = reduced
    return current, [s for s in steps if s.chosen is None or s.chosen.name in current.effect_names]


def _compared_again(current: Fit, steps: list[Step], rng: np.random.Generator) -> tuple[Fit, list[Step]]:
    """Each effect against its rivals beside the others: the first was chosen when what the others explain was still left."""
    for i, step in enumerate(steps):
        chosen = step.chosen
        if chosen is None:
            break
        others = [a.effect for a in current.effects if a.effect.name != chosen.name]
        taken = {effect.name for effect in others}
        rivals = [
            c
            for c in step.candidates
            if c.name not in taken
            and c.matters
            and c.net_gain > step.threshold
            and c.net_evidence > chosen.net_evidence - FAR_BEHIND
        ]
        if len(rivals) < 2:
            continue
        without = fit(current.problem, others, current.at, current.noises)
        again = sorted((_beside(without, others, c) for c in rivals), key=lambda c: -c.net_evidence)
        first = again[0]
        weights = _class_of(first, again, step.separability)
        members, widened, stability = _widened(weights, _wins(without, again, rng))
        rest = [c for c in step.candidates if c.name not in {a.name for a in again}]
        steps[i] = replace(
            step, before=without, candidates=(*again, *rest), chosen=first, members=members, weights=widened, stability=stability
        )
        current = first.fit
    return current, steps


def _beside(without: Fit, others: Sequence[Effect], before: Candidate) -> Candidate:
    """A candidate fitted again, with other effects beside it than at first."""
    own = {key: value for key, value in before.fit.at.items() if key[0] == before.name}
    effect = before.effect
    found = fit(without.problem, [*others, effect], {**without.at, **own}, without.noises)
    return compared(without, found, before.name, before.kept, before.d_prime, before.form_error_gain)
