# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learns the vehicle while it drives: rows of results in, departures from the vehicle file out, and how sure they are.

Once a second of driving that counts, a Kalman filter takes in the mean of what measured and expected torque differ by. What is
learned acts on the step only where it is covered, sure, and better than the file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.learning.blocks import (
    BLOCK_S,
    CONFIRMED,
    LEAST_BLOCKS,
    STEP_SHARE,
    STEP_STDS,
    Block,
    Contest,
    Wandering,
)
from trackres_ros.learning.buckets import Buckets
from trackres_ros.learning.filter import aged, corrected, expected, given_others, spread
from trackres_ros.learning.gate import AGAINST, OUTLYING, TEXTS, Gate, Row
from trackres_ros.learning.parameters import (
    GAIN,
    OFFSET,
    SLOW,
    STATES,
    STEP,
    VEHICLES_OWN,
    WANDERING_SHARE,
    learnables,
    make_prior,
)
from trackres_ros.units import SECOND_NS
from trackres_ros.vehicle import Spells

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MODES = ("off", "watch", "on")
SLOW_S = 180.0  # memory of what wanders
STEP_S = 4 * 3600.0  # of what came at once, in driving
LEAST_BELT_STD_K = 0.1
BELT_S = 900.0  # of a belt's temperature: its heat capacity over what cools it
WALK_PER_HOUR = 0.02  # of a prior standard deviation, per root of an hour of driving: rubber wears
AGES_S = 365 * 86400.0  # assumed: time off in which what was learned is half forgotten
RATE_PER_HOUR = 1.0  # of the file's value: what acts follows no faster
FASTEST = np.full(at.LEARNABLE, RATE_PER_HOUR / 3600.0)  # in a second
FASTEST[at.OF_BELT] = 1.0  # K
AIMS_EVERY_S = 5.0
DEGREES_OF_FREEDOM = 4.0  # of Student's t
FIRST_NOISE_SHARE = 0.03  # of what rolling takes, of the mean over a second
LEAST_NOISE_SHARE = 0.005
NOISE_MEMORY_S = 120.0
INERTIA_SHARE = 0.2  # of the inertia: an acceleration that is filtered from a speed lags
ROLLING_MEMORY_S = 600.0
LEAST_WANDERING_SHARE, MOST_WANDERING_SHARE = 0.015, 0.1  # beyond, ground or drive differ by what nothing is known of
STEP_HOLDS_S = 600.0  # driving after a step in which nothing is learned of the vehicle
GAIN_STEP_STD = 0.05  # of a sensor that was replaced
OVER_SHARE = 0.02  # of what rolling takes: so little is left of a step that is over
DISAGREES_SHARE, DISAGREES_S = 0.08, 60.0  # of the samples of a minute that disagree with the others
ALIKE_SHARE = 0.3  # by which a step may differ from a spell that the vehicle file tells of
LASTS_S = 60.0  # before a disturbance is fed forward
LASTING_SHARE = 0.02  # of what rolling takes: no more of it is, whatever it is
FADES = 0.5  # of it is left a second later where no torque comes


@dataclass
class Learned:
    """What is known, and what it is known by; all of it is kept over a restart.

    Attributes
    ----------
    mean, covariance
        Of the filter's states, shapes (STATES,) and (STATES, STATES).
    recent_mean, recent_covariance, before_mean, before_covariance
        The same at the end of the last block without a suspicion, and of the one before it: a step is found a block late, and may
        have come within one.
    aim, applied
        Departures that are to act, and those that do or would, shape (LEARNABLE,).
    """

    mean: Array
    covariance: Array
    recent_mean: Array
    recent_covariance: Array
    before_mean: Array
    before_covariance: Array
    aim: Array
    applied: Array
    second: int = -1  # the filter is of this one
    seconds: float = 0.0  # driven and learned from
    rolling: float = 0.0  # size of the torque that rolling takes [Nm]
    noise: float = 0.0  # variance of a second's mean [Nm^2]
    last_left: float = math.nan  # what the last second left [Nm]
    disagrees: float = 0.0  # share of samples of late that disagree with the others
    suspect: float = 0.0  # a step that is not yet confirmed [Nm]
    suspect_level: float = 0.0  # from which [Nm]
    step_s: float = math.inf  # driving since a step
    step_nm: float = 0.0
    step_second: int = -1
    lasting_s: float = 0.0
    lasting_nm: float = 0.0
    blocks: int = 0  # since the estimate began: while belts warm up at first, what is left changes without a step
    block: Block = field(default_factory=Block)
    last_block: Block = field(default_factory=Block)
    wandering: Wandering = field(default_factory=Wandering)
    contest: Contest = field(default_factory=Contest)


class Learner:
    """What one session learns; `take` after each of its steps.

    Parameters
    ----------
    estimator
        Of the session.
    mode
        `watch` learns and moves nothing; `on` moves the session's steps by what was learned.
    """

    def __init__(self, estimator: Estimator, mode: str = "watch") -> None:
        self.mode = mode
        self.learnables = learnables(estimator.vehicle)
        self.prior = make_prior(estimator)
        self._known = estimator.vehicle.disturbance
        self._belts = [estimator.column_index[f"belt_degc/{name}"] for name in estimator.assemblies]
        weight = float(estimator.constants.assembly[:, at.NOMINAL_LOAD].sum())
        self.buckets = Buckets(estimator.vehicle.chassis.max_speed, weight)
        self.reset()

    def reset(self) -> None:
        """Forget all that was learned."""
        self.gate = Gate(self._belts, self.prior.rolling_nm)
        self.buckets.clear()
        mean, covariance = np.zeros(STATES), self.prior.covariance.copy()
        rolling = self.prior.rolling_nm
        recent, before = (mean.copy(), covariance.copy()), (mean.copy(), covariance.copy())
        self.learned = Learned(
            mean, covariance, *recent, *before, np.zeros(at.LEARNABLE), np.zeros(at.LEARNABLE), rolling=rolling
        )
        self.learned.noise = (FIRST_NOISE_SHARE * rolling) ** 2

    def restart(self) -> None:
        """The estimate starts anew: belts and what wanders are as unknown as at the beginning, the vehicle stays known."""
        s = self.learned
        self.gate.restart()
        s.second, s.last_left, s.suspect, s.disagrees, s.blocks = -1, math.nan, 0.0, 0.0, 0
        s.lasting_s = s.lasting_nm = 0.0
        s.block.begin()
        s.last_block.begin()
        for state in (at.OF_BELT, SLOW):
            self._forget(state)
        self._keep_before()
        self._keep_before()

    def age(self, seconds: float) -> None:
        """Some time passed unseen [s]: what was learned is less sure."""
        forgotten = 1.0 - 0.5 ** (max(seconds, 0.0) / AGES_S)
        s = self.learned
        variances, prior = np.diag(s.covariance), np.diag(self.prior.covariance)
        gained = forgotten * np.maximum(prior - variances, 0.0)
        aged(s.mean, s.covariance, np.ones(STATES), gained)
        self.restart()

    def take(self, stamp_ns: int, row: Row, session: Session) -> None:
        """Take a step of the session; once a second learn from those before it, and let that act from the next step on."""
        if int(row[at.OUT_REASONS]) & int(at.Reason.TIME_RESET):
            self.restart()
        number = stamp_ns // SECOND_NS
        second = self.gate.second
        if number != second.number:
            if second.number >= 0:
                self._close(session)
            second.begin(number)
        self.gate.take(stamp_ns, row, session)

    # Once a second

    def _close(self, session: Session) -> None:
        s, second = self.learned, self.gate.second
        all_of_it = second.taken + float(second.refused.sum())
        if second.taken or second.refused[OUTLYING] or second.refused[AGAINST]:
            odd = float(second.refused[OUTLYING] + second.refused[AGAINST]) / all_of_it
            s.disagrees += (odd - s.disagrees) / DISAGREES_S
        if second.counts:
            self._learn(session)
        self._let_last(second.counts)
        self._act(session, second.counts)

    def _learn(self, session: Session) -> None:
        s, second = self.learned, self.gate.second
        n = float(second.taken)
        residual, drive, inertia, speed = second.residual / n, second.drive / n, second.inertia / n, second.speed / n
        sign = math.copysign(1.0, speed)
        looks = np.zeros(STATES)
        looks[: at.LEARNABLE] = second.by / n
        looks[OFFSET], looks[GAIN], looks[SLOW], looks[STEP] = 1.0, drive, sign, sign
        passed = 1.0 if s.second < 0 or second.number <= s.second else float(second.number - s.second)
        s.second = second.number
        s.rolling += (abs(second.resisting / n) - s.rolling) / max(min(s.seconds + 1.0, ROLLING_MEMORY_S), 30.0)
        s.seconds += 1.0
        s.step_s += 1.0
        self._pass(passed, session)
        left = residual - expected(s.mean, looks)
        moved = float((s.applied * looks[: at.LEARNABLE]).sum())
        self._hear(residual - moved, passed)
        variance = s.noise + (INERTIA_SHARE * inertia) ** 2
        _, known = spread(s.covariance, looks)
        total = known + variance
        weight = (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + left * left / total)
        corrected(s.mean, s.covariance, looks, left, total / min(weight, 1.0) - known, self._free())
        np.clip(s.mean, self.prior.low, self.prior.high, out=s.mean)
        self.buckets.count(speed, second.belt_degc / n, second.weight / n, second.accel / n)
        s.block.add(residual, moved, sign, looks, s.noise / variance)
        if s.block.seconds >= BLOCK_S:
            self._close_block()

    def _pass(self, seconds: float, session: Session) -> None:
        """Time passes: what wanders decays, what wears is less sure, a belt is as unsure as the estimate says."""
        s = self.learned
        keep, gained = np.ones(STATES), np.zeros(STATES)
        slow, step = math.exp(-seconds / SLOW_S), math.exp(-seconds / STEP_S)
        keep[SLOW], gained[SLOW] = slow, self.slow_std**2 * (1.0 - slow * slow)
        keep[STEP] = step
        prior = np.diag(self.prior.covariance)
        for state in VEHICLES_OWN:
            gained[state] = WALK_PER_HOUR**2 * prior[state] * min(seconds, 1.0) / 3600.0
        gained[at.OF_BELT] = session.estimator.constants.number.process_noise**2 * seconds
        noise = session.belts[:, 0, at.NOISE_1] ** 2 + session.belts[:, 0, at.NOISE_2] ** 2
        belt = math.exp(-seconds / BELT_S)
        keep[at.OF_BELT] = belt
        aged(s.mean, s.covariance, keep, gained)
        known = max(float(noise.mean()), LEAST_BELT_STD_K**2)
        over = s.covariance[at.OF_BELT, at.OF_BELT]
        if over > known:  # what was measured of a belt is in the estimate already
            share = math.sqrt(known / over)
            s.covariance[at.OF_BELT, :] *= share
            s.covariance[:, at.OF_BELT] *= share

    def _hear(self, left: float, passed: float) -> None:
        """Noise of a second's mean, by what differs from one to the next."""
        s = self.learned
        if passed <= 2.0 and math.isfinite(s.last_left):
            least = (LEAST_NOISE_SHARE * s.rolling) ** 2
            seen = min(0.5 * (left - s.last_left) ** 2, 16.0 * max(s.noise, least))
            s.noise += (seen - s.noise) / NOISE_MEMORY_S
            s.noise = max(s.noise, least)
        s.last_left = left

    def _close_block(self) -> None:
        s = self.learned
        s.blocks += 1
        block, before = s.block, s.last_block
        level = (block.residual - expected(s.mean[:SLOW], block.looks[:SLOW])) * block.sign
        if before.seconds:
            last = (before.residual - expected(s.mean[:SLOW], before.looks[:SLOW])) * before.sign
            self._judge(level, last)
        s.contest.see(abs(block.residual) - abs(block.residual - block.learned))
        s.last_block.take(block)
        block.begin()
        self._keep_before()

    def _judge(self, level: float, last: float) -> None:
        """Whether what is left came at once."""
        s = self.learned
        least = (LEAST_NOISE_SHARE * s.rolling) ** 2
        threshold = max(STEP_SHARE * s.rolling, STEP_STDS * s.wandering.std(least))
        if s.suspect:
            still = (level - s.suspect_level) / s.suspect
            if still > CONFIRMED:
                self._step_found(level - s.suspect_level)
            else:
                s.wandering.see(s.suspect, least)
            s.suspect = 0.0
            return
        difference = level - last
        if min(s.wandering.blocks, s.blocks) >= LEAST_BLOCKS and abs(difference) > threshold:
            s.suspect, s.suspect_level = difference, last
            return
        s.wandering.see(difference, least)

    def _step_found(self, size: float) -> None:
        """Take it for a disturbance, or for another sensor: go back to before it, and let those two take it up."""
        s = self.learned
        s.mean[:], s.covariance[:] = s.before_mean, s.before_covariance
        s.covariance[STEP, STEP] += max(size * size, (LASTING_SHARE * s.rolling) ** 2)
        s.covariance[GAIN, GAIN] += GAIN_STEP_STD**2
        s.mean[STEP] += size
        s.step_s, s.step_nm, s.step_second = 0.0, size, s.second
        for array, now in ((s.recent_mean, s.mean), (s.recent_covariance, s.covariance)):
            array[:] = now

    def _keep_before(self) -> None:
        """What is known now is what a step that is found later goes back to."""
        s = self.learned
        if s.suspect:
            return
        s.before_mean[:], s.before_covariance[:] = s.recent_mean, s.recent_covariance
        s.recent_mean[:], s.recent_covariance[:] = s.mean, s.covariance

    def _forget(self, state: int) -> None:
        s = self.learned
        s.mean[state] = 0.0
        s.covariance[state, :] = s.covariance[:, state] = 0.0
        s.covariance[state, state] = self.prior.covariance[state, state]

    # What counts

    @property
    def slow_std(self) -> float:
        """Standard deviation of what wanders [Nm]."""
        s = self.learned
        if s.wandering.blocks < LEAST_BLOCKS:
            return WANDERING_SHARE * s.rolling
        least = (LEAST_NOISE_SHARE * s.rolling) ** 2
        white = 2.0 * s.noise / BLOCK_S
        differs = max(s.wandering.variance - white, least) / (2.0 * (1.0 - math.exp(-BLOCK_S / SLOW_S)))
        return min(max(math.sqrt(differs), LEAST_WANDERING_SHARE * s.rolling), 0.5 * s.rolling)

    @property
    def frozen(self) -> str:
        """Why nothing is learned of the vehicle now; empty where it is."""
        s = self.learned
        if s.disagrees > DISAGREES_SHARE:
            return f"{100.0 * s.disagrees:.0f} % of the measured torques disagree with the others"
        if s.suspect:
            return f"a step of {s.suspect:+.0f} Nm is looked at"
        if s.step_s < STEP_HOLDS_S:
            return f"{self.disturbance}: a sensor, a brake, a load or the ground, not the belts"
        if self.slow_std > MOST_WANDERING_SHARE * s.rolling:
            return f"what is left wanders by {self.slow_std:.0f} Nm: hills or ground of which nothing is known"
        return ""

    @property
    def disturbance(self) -> str:
        """The last step that was found, in words."""
        s = self.learned
        since = max(self.gate.second.number - s.step_second, 0)
        kind = ""
        if isinstance(self._known, Spells):
            size = self._known.level - self._known.rest
            kind = ", of the kind seen before (spells)" if abs(abs(s.step_nm) - abs(size)) < ALIKE_SHARE * abs(size) else ""
        return f"a disturbance of {s.step_nm:+.0f} Nm since {since} s{kind}"

    def _free(self) -> Mask:
        free = np.ones(STATES, dtype=bool)
        if self.frozen:
            free[list(VEHICLES_OWN)] = False
        if self.learned.step_s == math.inf:
            free[STEP] = False
        return free

    @property
    def counted(self) -> Mask:
        """Which departures of the vehicle count as learned: covered, and known twice as well as by its file; (LEARNABLE,)."""
        variances = np.diag(self.learned.covariance)[: at.LEARNABLE]
        sure = variances < 0.25 * np.diag(self.prior.covariance)[: at.LEARNABLE]
        return np.asarray(self.buckets.covered() & sure)

    def counts(self, state: int) -> bool:
        """Whether one departure of the vehicle counts as learned."""
        return bool(self.counted[state])

    @property
    def acts(self) -> bool:
        """Whether what was learned is used, or would be: something counts, and it fits better than the file."""
        return self.learned.contest.better

    def _let_last(self, compared: bool) -> None:
        """Of what wanders that which lasts, within a bound; it fades where no torque comes."""
        s = self.learned
        if not compared:
            s.lasting_nm *= FADES
            s.lasting_s = 0.0
            return
        there = s.mean[SLOW] + s.mean[STEP]
        sure = abs(there) > 2.0 * math.sqrt(max(s.covariance[SLOW, SLOW] + s.covariance[STEP, STEP], 0.0))
        s.lasting_s = s.lasting_s + 1.0 if sure and there * s.lasting_nm >= 0.0 else 0.0
        most = LASTING_SHARE * s.rolling
        aim = min(max(there, -most), most) if s.lasting_s > LASTS_S else 0.0
        s.lasting_nm += 0.1 * (aim - s.lasting_nm)

    def _aim(self) -> Array:
        """What is to act: all that counts, with the rest as the file has it."""
        s, of_vehicle = self.learned, self.counted
        if not of_vehicle.any():
            return np.zeros(at.LEARNABLE)
        of_vehicle[at.OF_BELT] = True
        aim = given_others(s.mean[: at.LEARNABLE], s.covariance[: at.LEARNABLE, : at.LEARNABLE], of_vehicle)
        return np.clip(aim, self.prior.low[: at.LEARNABLE], self.prior.high[: at.LEARNABLE])

    def _act(self, session: Session, learned_now: bool) -> None:
        """What acts follows what counts, no faster than it may."""
        s = self.learned
        if learned_now and s.seconds % AIMS_EVERY_S == 0.0 and not self.frozen:
            s.aim[:] = self._aim()
        s.applied += np.minimum(np.maximum(s.aim - s.applied, -FASTEST), FASTEST)
        if self.mode != "on":
            return
        learned = session.learned
        if not (self.acts and s.applied.any()):
            learned[at.LEARNED_ON] = 0.0
            learned[at.DEPARTURES : at.LEARNED_TORQUE] = 0.0
            learned[at.LEARNED_TORQUE] = 0.0
            return
        learned[at.LEARNED_ON] = 1.0
        learned[at.DEPARTURES : at.LEARNED_TORQUE] = s.applied
        learned[at.LEARNED_TORQUE] = s.lasting_nm
        unexplained = s.mean[STEP] - s.lasting_nm if s.step_s < math.inf else 0.0
        learned[at.LEARNED_SLOW] = math.sqrt(self.slow_std**2 + unexplained**2)
        learned[at.LEARNED_FACTOR : at.SENSITIVITIES] = self.factor().ravel()

    def factor(self) -> Array:
        """Lower factor of the covariance about what acts, shape (LEARNABLE, LEARNABLE)."""
        s = self.learned
        off = s.mean[: at.LEARNABLE] - s.applied
        covariance = s.covariance[: at.LEARNABLE, : at.LEARNABLE] + off[:, None] * off[None, :]
        covariance[np.diag_indices_from(covariance)] += 1e-12
        return np.asarray(np.linalg.cholesky(covariance))

    # What is shown

    def state_of(self, state: int) -> str:
        """One word on a departure: learning, learned or frozen."""
        if self.frozen:
            return "frozen"
        return "learned" if self.counts(state) else "learning"

    @property
    def text(self) -> str:
        """What is going on, in a sentence."""
        s = self.learned
        if self.frozen:
            return f"frozen: {self.frozen}"
        second = self.gate.second
        if not s.seconds and second.number >= 0:
            return f"nothing to learn from yet: {TEXTS[second.mostly]}"
        count = int(self.counted.sum())
        if not count:
            return f"learning: {100.0 * self.buckets.share:.0f} % of what is needed has been driven"
        if not self.acts:
            return "learned, but no better than the vehicle file so far: the file is used"
        using = "used" if self.mode == "on" else "not used, as it only watches"
        return f"learned {count} of {len(VEHICLES_OWN)}, {self.learned.contest.gain:.0f} Nm better than the vehicle file; {using}"
