# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Proposes additions to an explanation, named or as a form: the best to first order, fitted together with it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.noise import shortened
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.selection.confirm import Graded
from trackres_ros.diagnosis.selection.screening import Gain, Screened, screen
from trackres_ros.diagnosis.selection.visibility import EffectColumns, EffectSensitivity, Separability, separability
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.learned import EmpiricalEffect
from trackres_ros.progress import counted

MOST_REFITTED = {False: 6, True: 3}  # names, and forms
MOST_SLOW = 3  # names, and forms: with the largest gains under noise that stays short
HIDDEN = 2.0  # times its first-order gain: least gain under short noise of an effect that the first order hides
FAR_BEHIND = 15.0  # in log-likelihood, to first order: no re-fit recovers that
BORNE_OUT = 0.25  # of its first-order gain: least gain of a fit that confirms it
THROUGH_TEMPERATURE = ("heat", "cooling")  # except for strongly non-linear effects
ALIKE_WITHIN = 3.0  # in log-likelihood
LEAST_BEGUN = 0.05  # of the typical size
LEAST_SHARE = 0.005  # of the torque, root mean square: a smaller effect hardly matters
MODEL_ERROR = 0.004  # of the torque, root mean square and slow: error of a re-fitted base without missing physics


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect fitted together with the base."""

    name: str
    fit: Fit  # with the effect
    gain: float  # in log-likelihood over the fit without
    criterion: float  # gain in log-evidence: less the cost of its parameters
    bic_gain: float  # twice the gain less log(effective sample) for each effective parameter; for comparison
    kept: float  # see `visibility.EffectSensitivity`, as `d_prime`
    d_prime: float
    share: float  # of the torque, root mean square
    form_error_gain: float  # part of the gain that other forms of the present effects explain

    @property
    def effect(self) -> Effect:
        """The effect itself."""
        return next(a.effect for a in self.fit.effects if a.effect.name == self.name)

    @property
    def is_name(self) -> bool:
        """Whether it is in the catalogue."""
        return not isinstance(self.effect, EmpiricalEffect | ResidualPattern)

    @property
    def net_gain(self) -> float:
        """Gain beyond that of other forms of the present effects."""
        return self.gain - self.form_error_gain

    @property
    def net_evidence(self) -> float:
        """Log-evidence beyond that of other forms."""
        return self.criterion - self.form_error_gain

    def counts(self, threshold: float) -> bool:
        """Whether it is worth a name."""
        return self.matters and self.net_gain > threshold and self.net_evidence > 0.0

    @property
    def matters(self) -> bool:
        """Whether its torque is large enough for a name."""
        return self.share >= LEAST_SHARE


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the forward choice."""

    before: Fit  # the initial fit
    separability: Separability
    by_noise: float  # gain that noise alone reaches with 5 % probability
    threshold: float  # required gain, which also exceeds the model's own error
    screened: tuple[tuple[str, float], ...]  # effects and their gains to first order
    candidates: tuple[Candidate, ...]  # the fitted ones, best first
    chosen: Candidate | None = None  # the best one, if its gain suffices
    members: tuple[str, ...] = ()  # effects with an equivalent explanation
    weights: Mapping[str, float] = field(default_factory=dict)  # probability of each
    stability: float = 0.0  # share of resampled laps won by the class
    worse: tuple[str, ...] = ()  # confirmed effects that predict the hold-out laps significantly worse
    graded: Mapping[str, Graded] = field(default_factory=dict)  # of the candidates that laps left out in turn have judged

    @property
    def hint(self) -> str:
        """The best effect for an exact model; empty without one, or if one was chosen."""
        if self.chosen is not None:
            return ""
        beyond = [c for c in self.candidates if c.is_name and c.net_gain > self.by_noise and c.net_evidence > 0.0]
        return max(beyond, key=lambda c: c.net_evidence).name if beyond else ""


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates by name or form, their first-order columns about the base, and the best one's gain by noise alone."""

    effects: Mapping[str, Effect]
    columns: EffectColumns
    by_noise: float | None = None

    def without(self, taken: Collection[str]) -> dict[str, Effect]:
        """The candidates with other names."""
        return {key: effect for key, effect in self.effects.items() if effect.name not in taken}


def one_round(current: Fit, pool: Pool, replicates: int, rng: np.random.Generator) -> Step:
    """Fit the best candidates for the residual of a fit; a name may have several, the best one is used."""
    seen = separability(pool.without(current.effect_names), current, pool.columns)
    screened = screen(current, seen.visible, replicates, rng, pool.by_noise)
    gains = tuple((s.effect.name, gain.value) for s, gain in screened.gains)
    threshold = max(screened.threshold, spurious_gain(current))
    candidates = sorted(_refitted(current, screened), key=lambda c: (not c.matters, -c.net_evidence))
    return Step(current, seen, screened.threshold, threshold, gains, tuple(candidates))


def _refitted(current: Fit, screened: Screened) -> list[Candidate]:
    """Fit the effects with the largest first-order gains.

    The best one sets the limit for the others, unless its fit does not confirm its first-order gain. A delay, which is
    similar to a sensor lag only by non-linear terms, would otherwise exclude the true effect.
    """
    fitted, misleading, slow = dict[str, Candidate](), set[str](), _may_be_slow(screened)

    def refitted(name: str, starts: Sequence[tuple[EffectSensitivity, Gain]]) -> Candidate:
        return _refit(current, [*starts, *slow.pop(name, ())], screened.form_error_gain.get(name, 0.0))

    while True:
        looked_at = _may_be_best(screened, misleading)
        new = []
        for kind in (False, True):  # names, and forms
            of_kind = [name for name, starts in looked_at.items() if isinstance(starts[0][0].effect, EmpiricalEffect) is kind]
            room = MOST_REFITTED[kind] + sum(name in misleading for name in of_kind) - sum(name in fitted for name in of_kind)
            new += [name for name in of_kind if name not in fitted][: max(0, room)]
        if not new:
            break
        for name in counted(new, "fits of candidate effects", len(new)):
            fitted[name] = refitted(name, looked_at[name])
        first_order = {name: max(gain.value for s, gain in screened.gains if s.effect.name == name) for name in fitted}
        misleading = {name for name, c in fitted.items() if c.gain < BORNE_OUT * first_order[name]}
    return [*fitted.values(), *(refitted(name, ()) for name in list(slow))]


def _may_be_slow(screened: Screened) -> dict[str, list[tuple[EffectSensitivity, Gain]]]:
    """Effects that may explain a slow residual although the first order hides them, by name, with their best start.

    Under noise near a random walk a slow effect gains next to nothing until its shape is right, such as a time constant: the
    larger it is, the less. Under noise that stays short it gains all the same, and its fit finds the shape.
    """
    first_order = dict[str, float]()
    for s, gain in screened.gains:
        first_order.setdefault(s.effect.name, gain.value)
    best = {False: dict[str, list[tuple[EffectSensitivity, Gain]]](), True: dict[str, list[tuple[EffectSensitivity, Gain]]]()}
    for s, gain in screened.short_gains:
        of_kind = best[isinstance(s.effect, EmpiricalEffect)]
        if gain.value > screened.threshold and len(of_kind) < MOST_SLOW:
            of_kind.setdefault(s.effect.name, [(s, gain)])
    slow = (best[False] | best[True]).items()
    return {name: starts for name, starts in slow if starts[0][1].value > HIDDEN * first_order[name]}


def _may_be_best(screened: Screened, misleading: Collection[str]) -> dict[str, list[tuple[EffectSensitivity, Gain]]]:
    """Effects to fit by name, with their starts, near the best one that is not misleading."""
    best = max((gain.value for s, gain in screened.gains if s.effect.name not in misleading), default=0.0)
    if best < 0.5 * screened.threshold or best < 1.0:
        return {}
    within = max(FAR_BEHIND, 0.5 * best)
    worth = dict[str, list[tuple[EffectSensitivity, Gain]]]()
    for s, gain in screened.gains:
        near = gain.value > best - within or (s.effect.acts_on in THROUGH_TEMPERATURE and gain.value > screened.threshold)
        starts = worth.get(s.effect.name, [])
        as_good = not starts or gain.value > starts[0][1].value - ALIKE_WITHIN
        if near and gain.value > 0.25 * screened.threshold and as_good:
            worth.setdefault(s.effect.name, []).append((s, gain))
    return worth


def spurious_gain(current: Fit) -> float:
    """Log-likelihood that an effect can gain from the model's own error.

    That error does not average out: the longer a recording and the smaller its noise, the more it looks like physics.
    """
    torque = rms([s.torque for s in current.problem.sessions], current)
    samples = sum(int(mask.sum()) for mask in current.problem.masks)
    return 0.5 * samples * (MODEL_ERROR * torque * current.noise.dc_gain / current.noise.std) ** 2


def _refit(current: Fit, found: Sequence[tuple[EffectSensitivity, Gain]], form_error_gain: float) -> Candidate:
    """Best fit over all starts."""
    active, short = [a.effect for a in current.effects], shortened(current.noise)
    fits = []
    for s, gain in found:
        noises = {**current.noises, "torque": short} if gain.short and short is not None else current.noises
        fits.append(fit(current.problem, [*active, s.effect], {**current.at, **_begin(s, gain.moved)}, noises))
    best = max(fits, key=lambda f: f.log_likelihood)
    strongest = max((s for s, _ in found), key=lambda s: s.d_prime)
    return compared(current, best, strongest.effect.name, strongest.kept, strongest.d_prime, form_error_gain)


def compared(current: Fit, found: Fit, name: str, kept: float, d_prime: float, form_error_gain: float) -> Candidate:
    """Gain of a fit with one more effect over the one without."""
    gain = found.log_likelihood - current.log_likelihood
    bic = 2.0 * gain - np.log(effective_samples(found)) * effective_parameters(found, name)
    criterion = found.log_evidence - current.log_evidence
    share = rms(found.contribution(name), found) / max(rms([s.torque for s in found.problem.sessions], found), 1e-12)
    return Candidate(name, found, gain, criterion, bic, kept, d_prime, share, form_error_gain)


def rms(series: Sequence[Array], found: Fit) -> float:
    """Root mean square over the used samples."""
    used = np.concatenate([x[m] for x, m in zip(series, found.problem.masks, strict=True)])
    return float(np.sqrt(np.mean(used[np.isfinite(used)] ** 2)))


def _begin(sensitivity: EffectSensitivity, moved: Array) -> dict[tuple[str, str], float]:
    """Initial values: the first-order optimum, but not zero, where the shape has no influence."""
    values, of = dict(sensitivity.start), sensitivity.effect
    amplitudes = [q for q in of.parameters if q.off is not None]
    for q, share in zip(amplitudes, moved.tolist(), strict=True):
        assert q.off is not None
        share = share if len(amplitudes) > 1 or abs(share) > LEAST_BEGUN else math.copysign(LEAST_BEGUN, share)
        values[q.name] = q.off + share * (q.start - q.off)
    return {(of.name, parameter): value for parameter, value in values.items()}


def effective_parameters(found: Fit, effect: str) -> float:
    """Number of parameters of an effect that the data determine; one as uncertain as its bounds is not included."""
    of = [f for f in found.free if f.key[0] == effect]
    return float(sum(1.0 - min(1.0, (found.std_of(*f.key) / f.std) ** 2) for f in of))


def effective_samples(found: Fit) -> float:
    """Number of independent samples equivalent to the autocorrelated residuals for a constant."""
    torque = [(r, g.mask) for r, g in zip(found.residuals, found.problem.segments, strict=True) if g.kind == "torque"]
    variance = float(np.var(np.concatenate([r[m] for r, m in torque])))
    samples = sum(int(m.sum()) for _, m in torque)
    return max(10.0, samples * min(1.0, found.noise.dc_gain**2 * variance / found.noise.std**2))
