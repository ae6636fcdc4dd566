# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learns vehicle parameters while driving: rows of results come in; departures from the vehicle file with covariance go out.

Once a second of valid driving, a Kalman filter processes the mean difference of measured and expected torque. Learned
values act on the step only where they are covered, certain, and better than the file, within limits, with their uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.guards import at_sprockets
from trackres_ros.learning.delay import DelayEstimator
from trackres_ros.learning.gate import ACCELERATES_MPS2, AGAINST, OUTLYING, SPEED_UNSURE, TEXTS, Buckets, Gate, Row
from trackres_ros.learning.parameters import (
    GAIN,
    OFFSET,
    REACH_STD,
    SLOPE,
    SLOW,
    STATES,
    STEP,
    VEHICLES_OWN,
    Prior,
    age_estimate,
    conditional_mean,
    correct_estimate,
    expected_residual,
    learnables,
    make_prior,
    rise_torques,
    spread,
    widen_covariance,
)
from trackres_ros.learning.state import (
    BLOCK_S,
    DISAGREES_S,
    SLOW_S,
    LearnerState,
    ResidualBlock,
    close_block,
    disturbance_text,
    nothing_learned,
    update_lasting,
    why_frozen,
)
from trackres_ros.units import GRAVITY, SECOND_NS

# Correction of the step

RATE_PER_HOUR = 1.0  # of the file's value: limit on the rate of acting values
FASTEST = np.full(layout.LEARNABLE, RATE_PER_HOUR / 3600.0)  # in a second
FASTEST[layout.OF_BELT] = 1.0  # K
BELT_S = 900.0  # of a belt's temperature: heat capacity over cooling
ACCEL_DOUBT = 0.04  # of an acceleration filtered out of a speed; of simulated drives a right mass comes out by so much too large
TAKE_UP_A_RISE = (layout.OF_BEARING, layout.OF_DRAG)


def reported_stds(covariance: Array, prior: Prior, own_states: Sequence[int], torque_ratios: Array) -> Array:
    """Reported standard deviations of the filter's first states, with errors that their covariance does not include.

    One is that of accelerations, for the mass. The other is that of a rolling coefficient's rise over speed: coefficient and drag
    take it up by least squares, within their bounds.

    Parameters
    ----------
    own_states
        Departures of the vehicle that are learned; the others have the file's values.
    torque_ratios
        Torques by `parameters.rise_torques` in the driving so far, over their noise, shape (3, speeds).
    """
    errors = np.zeros(len(covariance))
    errors[layout.OF_MASS] = ACCEL_DOUBT
    states = [state for state in TAKE_UP_A_RISE if state in own_states]
    torques = torque_ratios[[TAKE_UP_A_RISE.index(state) for state in states]]
    variances = np.diag(prior.covariance)[states]
    taken_up = np.abs(np.linalg.solve(torques @ torques.T + np.diag(1.0 / variances), torques @ torque_ratios[-1]))
    errors[states] = np.minimum(taken_up, REACH_STD * np.sqrt(variances))
    return np.hypot(np.sqrt(np.maximum(np.diag(covariance), 0.0)), errors)


def well_known(s: LearnerState, prior: Prior) -> Mask:
    """Which departures are known twice as well as by the vehicle file, shape (LEARNABLE,)."""
    variances = np.diag(s.covariance)[: layout.LEARNABLE]
    return np.asarray(variances < 0.25 * np.diag(prior.covariance)[: layout.LEARNABLE])


def target_departures(s: LearnerState, prior: Prior, has_evidence: Mask) -> Array:
    """Target of the acting departures, (LEARNABLE,): all accepted ones, with the file's values for the rest."""
    if not has_evidence.any():
        return np.zeros(layout.LEARNABLE)
    of_vehicle = has_evidence.copy()
    of_vehicle[layout.OF_BELT] = True
    departures = conditional_mean(s.mean[: layout.LEARNABLE], s.covariance[: layout.LEARNABLE, : layout.LEARNABLE], of_vehicle)
    return np.clip(departures, prior.low[: layout.LEARNABLE], prior.high[: layout.LEARNABLE])


def approach_target(s: LearnerState) -> None:
    """Move acting departures towards their target within the rate limit."""
    s.applied += np.minimum(np.maximum(s.aim - s.applied, -FASTEST), FASTEST)


def fade_belts(s: LearnerState, seconds: float) -> None:
    """Let the acting departure of the belts' temperature fade over a time that did not renew it: it holds for the moment only."""
    for departures in (s.aim, s.applied):
        departures[layout.OF_BELT] *= belt_share_left(seconds)


def apply_departures(s: LearnerState, is_active: bool, learned: Array, second: int, belt_variance: float) -> None:
    """Write the acting departures into the memory of a session, see `estimator.columns`.

    `second` is the present second: belts have become less certain since the last second used. `belt_variance` is that of their
    temperature without a torque measurement [K^2].
    """
    if not (is_active and s.applied.any()):
        learned[: layout.Learned.slow] = 0.0
        return
    learned[layout.Learned.on] = 1.0
    learned[layout.Learned.departures] = s.applied
    learned[layout.Learned.torque] = s.lasting_nm
    unexplained = s.mean[STEP] - s.lasting_nm if s.step_s < math.inf else 0.0
    learned[layout.Learned.slow] = math.sqrt(s.slow_std**2 + s.hills_variance + unexplained**2)
    learned[layout.Learned.factor] = covariance_factor(s, max(second - s.second, 0), belt_variance).ravel()


def use_file(learned: Array) -> None:
    """Let a session use the vehicle file, until `apply_departures` is called again; the sensitivities of its last step stay."""
    learned[: layout.Learned.sensitivities.start] = 0.0


def belt_share_left(seconds: float) -> float:
    """Remaining share of a belt's departure after some time."""
    return math.exp(-seconds / BELT_S)


def covariance_factor(s: LearnerState, unseen_s: float, belt_variance: float) -> Array:
    """Lower factor of the covariance about the acting departures, shape (LEARNABLE, LEARNABLE); see `apply_departures`."""
    share = belt_share_left(unseen_s)
    departures = s.mean[: layout.LEARNABLE] - s.applied
    departures[layout.OF_BELT] = share * s.mean[layout.OF_BELT] - s.applied[layout.OF_BELT]
    covariance = s.covariance[: layout.LEARNABLE, : layout.LEARNABLE] + departures[:, None] * departures[None, :]
    covariance[np.diag_indices_from(covariance)] += 1e-12
    covariance[layout.OF_BELT, layout.OF_BELT] += (1.0 - share**2) * max(
        belt_variance - covariance[layout.OF_BELT, layout.OF_BELT], 0.0
    )
    return np.asarray(np.linalg.cholesky(covariance))


# Learner

MODES = OFF, WATCH, ON = "off", "watch", "on"
STEP_S = 4 * 3600.0  # memory of sudden steps, in driving
LEAST_BELT_STD_K = 0.1
MOVED_K = 1.0  # belts that move farther once the air is known are learned anew
AIR_S = 3600.0  # time constant of a thermometer's error in air: sun, exhaust
WALK_PER_HOUR = 0.01  # of a prior standard deviation, per root of an hour of driving: rubber wears
AGES_PER_S = 0.5 / (365 * 86400.0)  # assumed: growth of standard deviations while off, of the file's own
PAUSE_S = 600.0  # without a usable torque: the vehicle may have been loaded or repaired
AIMS_EVERY_S = 5.0
NEAR = 1.0  # standard deviations to a bound: noise of the seconds moves a held value by up to half of one
DEGREES_OF_FREEDOM = 4.0  # of Student's t
NOISE_MEMORY_S = 120.0
INERTIA_SHARE = 0.2  # of the inertia: an acceleration that is filtered from a speed lags
ROLLING_MEMORY_S = 600.0
TIME_RESET, CLOCK_JUMPED = int(layout.Reason.TIME_RESET), int(layout.Reason.CLOCK_JUMPED)
LEFT_OUT_SHARE = 0.1  # of the invalid samples of a minute, by fault of the torque: more are reported


def belt_variances(session: Session) -> tuple[float, float]:
    """Variance of the belts' temperature in the estimate: due to the air alone, and in all [K^2].

    The torque measures it, whatever warms or cools a belt, so it is one learned state.
    """
    if not len(session.belts):
        return 0.0, 0.0
    by_air = float((session.belts[:, 0, layout.Belt.consider_ambient] ** 2).mean())
    noise = session.belts[:, 0, layout.Belt.noise_1] ** 2 + session.belts[:, 0, layout.Belt.noise_2] ** 2
    return by_air, max(float(noise.mean()) + by_air, LEAST_BELT_STD_K**2)


class Learner:
    """Learner of one session; call `take` after each of its steps.

    In mode `watch` it learns and changes nothing; in mode `on` it applies learned values to the session's steps.
    """

    def __init__(self, estimator: Estimator, mode: str = WATCH) -> None:
        self.mode = mode
        self.learnables = learnables(estimator.vehicle)
        self.own = tuple(learnable.state for learnable in self.learnables if learnable.state in VEHICLES_OWN)
        self.prior = make_prior(estimator)
        self._vehicle = estimator.vehicle
        self._belts = [estimator.column_index[f"belt_degc/{name}"] for name in estimator.assemblies]
        load = estimator.constants.assembly[:, layout.Assembly.nominal_load]
        weight = float(load.sum())
        self._arm = float(load @ estimator.constants.assembly[:, layout.Assembly.radius]) / weight
        self._inertia = self._arm * estimator.vehicle.chassis.rotating_mass_factor / GRAVITY  # torque by weight and m/s^2
        self.delay = DelayEstimator(self.prior.rolling_nm)
        self.buckets = Buckets(estimator.vehicle.chassis.max_speed, weight, bool(self._belts))
        self._rise = rise_torques(estimator.vehicle, self.buckets.middles)
        self.reset()

    def reset(self) -> None:
        """Forget all learned values."""
        self.gate = Gate(self._belts, self.prior.rolling_nm)
        self.buckets.reset()
        self.delay.reset()
        self.learned = nothing_learned(self.prior)

    def restart(self) -> None:
        """Restart the estimate: reset belts and slow disturbance to their priors, keep the vehicle's parameters."""
        self.gate.restart()
        self.delay.restart()
        self.learned.begin_anew(self.prior)

    def age_values(self, seconds: float) -> None:
        """Account for time off [s]: learned values are less certain."""
        self.add_wear(seconds)
        self.restart()

    def add_wear(self, seconds: float) -> None:
        """Add the uncertainty of a time without evidence [s], up to the file's own; the correlations stay."""
        covariance = self.learned.covariance
        stds, prior_stds = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(self.prior.covariance))
        # Wear goes one way: its possible change grows with time, not with its root, however that time is divided.
        widen_covariance(covariance, np.minimum(stds + AGES_PER_S * max(seconds, 0.0) * prior_stds, prior_stds))

    def take(self, stamp_ns: int, row: Row, session: Session) -> None:
        """Take a step of the session; once a second learn from those before it, and let that act from the next step on."""
        reasons = int(row[layout.Results.reasons])
        samples, air = self.gate.samples, float(session.motion[layout.Motion.air])
        if reasons & TIME_RESET or samples.of_air * abs(air - samples.air) > MOVED_K:
            self.restart()
            use_file(session.learned)
        self.gate.samples.air, self.gate.samples.of_air = air, session.share_of_air
        memory, constants = session.memory, session.estimator.constants
        self.delay.take(
            stamp_ns,
            row[layout.Results.speed_mps],
            row[layout.Results.drive_torque_nm] - row[layout.Results.inertia_nm],
            row[layout.Results.weight_n] * self._inertia,
            int(memory.times[layout.TORQUE, layout.Times.last_stamp]),
            at_sprockets(constants, float(memory.values[layout.TORQUE]), row[layout.Results.speed_mps])
            / constants.number.torque_scale,  # an offset delays nothing
            not reasons & SPEED_UNSURE,
        )
        self.learned.ground.drive(
            stamp_ns, row[layout.Results.speed_mps], row[layout.Results.grade_nm] / (row[layout.Results.weight_n] * self._arm)
        )
        number = stamp_ns // SECOND_NS
        second = self.gate.second
        if number != second.number:
            seconds = 1 if reasons & CLOCK_JUMPED else max(number - second.number, 0)
            if second.number >= 0:
                self._close(session, seconds)
            self.gate.next_second(number)
            if reasons & CLOCK_JUMPED and self.learned.second >= 0:
                self.learned.second += number - second.number - seconds
        self.gate.take(stamp_ns, row, session)

    # Once a second

    def _close(self, session: Session, seconds: int) -> None:
        """Finish a second. `seconds` later the next second with a step begins."""
        s, second = self.learned, self.gate.second
        all_of_it = second.taken + float(second.refused.sum())
        if second.taken or second.refused[OUTLYING] or second.refused[AGAINST]:
            odd_share = float(second.refused[OUTLYING] + second.refused[AGAINST]) / all_of_it
            s.disagrees += (odd_share - s.disagrees) / DISAGREES_S
        s.ground.close(s.mean, s.covariance, session, self._free(0.0))
        np.clip(s.mean, self.prior.low, self.prior.high, out=s.mean)  # the ground corrects all states, also in unused seconds
        if second.counts:
            self._learn_second(session)
        update_lasting(s, second.counts)
        has_update = second.counts and not self.freeze_reason
        if has_update and s.seconds % AIMS_EVERY_S == 0.0:
            s.aim[:] = target_departures(s, self.prior, self.has_evidence)
        approach_target(s)
        fade_belts(s, seconds - has_update)
        if self.mode == ON:
            self.apply_learned(session, seconds)

    def apply_learned(self, session: Session, seconds: int = 1) -> None:
        """Let the accepted values act on the session's next steps, as certain as they are then; none if they are not accepted.

        The next step comes `seconds` seconds after the present one.
        """
        next_second = self.gate.second.number + seconds - 1
        apply_departures(self.learned, self.is_active, session.learned, next_second, belt_variances(session)[1])

    def _learn_second(self, session: Session) -> None:
        s, second = self.learned, self.gate.second
        n = float(second.taken)
        residual, drive, inertia, speed = second.residual / n, second.drive / n, second.inertia / n, second.speed / n
        sign = math.copysign(1.0, speed)
        sensitivities = np.zeros(STATES)
        sensitivities[: layout.LEARNABLE] = second.by / n
        sensitivities[OFFSET], sensitivities[GAIN], sensitivities[SLOW], sensitivities[STEP] = 1.0, drive, sign, sign
        sensitivities[SLOPE] = second.weight / n * self._arm
        seconds = 1.0 if s.second < 0 or second.number <= s.second else float(second.number - s.second)
        s.second = second.number
        s.rolling += (abs(second.resisting / n) - s.rolling) / max(min(s.seconds + 1.0, ROLLING_MEMORY_S), 30.0)
        s.seconds += 1.0
        s.step_s += 1.0
        self._pass_time(seconds, session)
        freedom = self._free(second.accel / n)
        s.ground.take_force(s.mean, s.covariance, second.felt / n, second.accel / n, freedom)
        known_hill = float(s.mean[SLOPE] * sensitivities[SLOPE])  # from an altitude or an IMU, before this torque has its say
        innovation = residual - expected_residual(s.mean, sensitivities)
        applied_torque = float((s.applied * sensitivities[: layout.LEARNABLE]).sum())
        self._update_noise(residual - applied_torque, seconds)
        variance = s.second_variance + (INERTIA_SHARE * inertia) ** 2
        _, state_variance = spread(s.covariance, sensitivities)
        total = state_variance + variance
        weight = (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + innovation * innovation / total)
        correct_estimate(s.mean, s.covariance, sensitivities, innovation, total / min(weight, 1.0) - state_variance, freedom)
        np.clip(s.mean, self.prior.low, self.prior.high, out=s.mean)
        self.buckets.count(speed, second.belt_degc / n, second.weight / n, second.accel / n)
        s.block.add(residual - known_hill, applied_torque, sign, sensitivities, s.noise / variance)
        if s.block.seconds >= BLOCK_S:
            close_block(s)

    def _pass_time(self, seconds: float, session: Session) -> None:
        """Predict: the slow disturbance decays, wear adds uncertainty, a belt is as uncertain as the estimate says."""
        s = self.learned
        if seconds > PAUSE_S:
            self.add_wear(seconds)
            s.require_evidence()
            s.block = ResidualBlock()
        shares, noise = np.ones(STATES), np.zeros(STATES)
        decay, step = math.exp(-seconds / SLOW_S), math.exp(-seconds / STEP_S)
        shares[SLOW], noise[SLOW] = decay, s.slow_std**2 * (1.0 - decay * decay)
        shares[STEP] = step
        prior = np.diag(self.prior.covariance)
        for state in VEHICLES_OWN:
            noise[state] = WALK_PER_HOUR**2 * prior[state] * min(seconds, 1.0) / 3600.0
        shares[layout.OF_BELT] = belt_share_left(seconds)
        by_air, belt_variance = belt_variances(session)
        if len(session.belts):
            noise[layout.OF_BELT] = session.estimator.constants.number.process_noise**2 * seconds
            noise[layout.OF_BELT] += (1.0 - math.exp(-2.0 * seconds / AIR_S)) * by_air
        age_estimate(s.mean, s.covariance, shares, noise)
        variance = s.covariance[layout.OF_BELT, layout.OF_BELT]
        if variance > belt_variance:  # measurements of a belt are in the estimate already
            share = math.sqrt(belt_variance / variance)
            s.covariance[layout.OF_BELT, :] *= share
            s.covariance[:, layout.OF_BELT] *= share

    def _update_noise(self, innovation: float, seconds: float) -> None:
        """Noise of a second's mean, from the scatter between seconds."""
        s = self.learned
        if seconds <= 2.0 and math.isfinite(s.last_left):
            least_variance = s.least_variance
            sample = min(0.5 * (innovation - s.last_left) ** 2, 16.0 * max(s.noise, least_variance))
            s.noise += (sample - s.noise) / NOISE_MEMORY_S
            s.noise = max(s.noise, least_variance)
        s.last_left = innovation

    # Acceptance

    @property
    def freeze_reason(self) -> str:
        """Reason why learning is paused; empty if it is not."""
        return why_frozen(self.learned, self._vehicle.disturbance)

    @property
    def disturbance(self) -> str:
        """Text on an unmodelled torque outside the vehicle's parameters; empty without one."""
        return disturbance_text(self.learned, self._vehicle.disturbance)

    @property
    def left_out(self) -> str:
        """Recent defect of the measured torque, in words; empty without one."""
        reason, share = self.gate.wrong_of_late()
        return f"{reason} in {100.0 * share:.0f} % of the last minute" if share > LEFT_OUT_SHARE else ""

    def _free(self, accel: float) -> Mask:
        freedom = np.ones(STATES, dtype=bool)
        if self.freeze_reason:
            freedom[list(VEHICLES_OWN)] = False
        if abs(accel) < ACCELERATES_MPS2:  # a small one is mostly noise, which biases a mass low
            freedom[layout.OF_MASS] = False
        return freedom

    @property
    def has_evidence(self) -> Mask:
        """Accepted departures of the vehicle: covered, and known twice as well as by its file; (LEARNABLE,)."""
        return np.asarray(self.buckets.has_evidence() & well_known(self.learned, self.prior))

    @property
    def is_at_bound(self) -> Mask:
        """Accepted departures that only their bounds hold, so that their error is unknown; (LEARNABLE,)."""
        mean, margin = self.learned.mean[: layout.LEARNABLE], NEAR * np.sqrt(np.diag(self.learned.covariance)[: layout.LEARNABLE])
        is_within = (mean > self.prior.low[: layout.LEARNABLE] + margin) & (mean < self.prior.high[: layout.LEARNABLE] - margin)
        return np.asarray(self.has_evidence & ~is_within)

    def stds(self, covariance: Array, own_states: Sequence[int]) -> Array:
        """Reported standard deviations of the filter's first states by their covariance, see `reported_stds`."""
        seconds, noise = self.buckets.seconds.sum(axis=(1, 2)), max(self.learned.second_variance, 1e-12)
        return reported_stds(covariance, self.prior, own_states, self._rise * np.sqrt(seconds / noise))

    @property
    def is_active(self) -> bool:
        """Whether learned values are used, or would be by mode `on`: some are accepted, and they fit better than the file."""
        return self.learned.fresh.better and self.mode != OFF

    # Output

    @property
    def text(self) -> str:
        """Status of learning, in a sentence."""
        return f"{self._stage}; {self.left_out}" if self.left_out else self._stage

    @property
    def _stage(self) -> str:
        s = self.learned
        if self.freeze_reason:
            return f"frozen: {self.freeze_reason}"
        is_at_bound = self.is_at_bound
        if is_at_bound.any():
            names = ", ".join(
                learnable.name for learnable in self.learnables if learnable.state in self.own and is_at_bound[learnable.state]
            )
            return f"at the end of the plausible range, with an unknown error: {names}"
        second = self.gate.second
        if self.disturbance:
            return f"{self.disturbance}, separate from the vehicle's parameters"
        if not s.seconds and second.number >= 0:
            return f"no usable data yet: {TEXTS[second.main_reason]}"
        count = int(self.has_evidence.sum())
        if not count:
            return f"learning: {100.0 * self.buckets.share:.0f} % of the required driving is done"
        if not self.is_active:
            return "the learned parameters fit no better than the vehicle file so far: the file is used"
        usage = "used" if self.mode == ON else "not used in this mode"
        gain = self.learned.fresh.gain  # within its standard error they stay in use
        comparison = f"{abs(gain):.0f} Nm {'worse' if gain < 0.0 else 'better'} than the vehicle file"
        return f"{count} of {len(self.own)} parameters learned, {comparison}; {usage}"
