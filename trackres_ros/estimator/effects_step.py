"""Left-out effects in the live step: their terms from what is known now, and the states of their own.

They run in plain Python before each compiled step: a vehicle file without effects pays nothing for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.effect import Active, Conditions, Facts, Terms, together
from trackres_ros.estimator import layout as at

Array = NDArray[np.float64]

# What is remembered: distance [m], speed of the last step [m/s]; then of each effect its own state, its target and time constant.
DISTANCE, LAST_SPEED, FIRST_OWN = range(3)
OWN, TARGET, TIME_CONSTANT = range(3)
EACH = 3

# Beyond these an effect of whatever kind is a mistake: an order of magnitude outside what those of the catalogue reach.
MOST_TORQUE = 10.0  # times weight times radius
LIMITS = {
    "torque": (-math.inf, math.inf),
    "drive_gain": (0.1, 10.0),
    "loss_factor": (0.01, 100.0),
    "softening": (-0.1, 0.1),  # 1/K
    "film_offset_factor": (0.01, 100.0),
    "film_slope_factor": (0.01, 100.0),
    "conductance": (0.0, 1e5),  # W/K
    "sink": (-100.0, 200.0),  # degC
    "heat": (-1e5, 1e5),  # W
    "inner_resistance": (0.0, 1.0),  # K/W
}
MOST_STATE = 1e9
LEAST_TIME_S = 1e-3
SOFTENED_OVER_K = 20.0  # assumed distance of a belt from the temperature about which a softening turns


def new_memory(count: int) -> Array:
    """Memory of so many effects at the very beginning."""
    memory = np.full(FIRST_OWN + EACH * count, math.nan)
    memory[DISTANCE] = memory[LAST_SPEED] = 0.0
    return memory


def cooled(memory: Array) -> Array:
    """Memory after a start anew: effects' own states begin as after a long rest; the distance driven stays."""
    fresh = new_memory((len(memory) - FIRST_OWN) // EACH)
    fresh[DISTANCE] = memory[DISTANCE]
    return fresh


def terms_of(active: Active, now: Conditions, own: float) -> Terms | None:
    """What an effect does now, each term one number; None if it fails, or a term is not finite or beyond all reason.

    An effect may be of the user's own: whatever it does, the estimate goes on without it.
    """
    try:
        terms = active.terms(now, own)
        values = {name: float(getattr(terms, name)) for name in LIMITS}
    except Exception:  # of any kind, as the code is not ours
        return None
    most = MOST_TORQUE * now.facts.weight * now.facts.radius
    if not abs(values["torque"]) <= most or not all(low <= values[name] <= high for name, (low, high) in LIMITS.items()):
        return None
    return Terms(**values)


class EffectsStep:
    """The effects of a vehicle and of its surroundings, for one step after the other."""

    def __init__(self, of_vehicle: Sequence[Active], of_surroundings: Sequence[Active], facts: Facts) -> None:
        self.effects, self.facts = (*of_vehicle, *of_surroundings), facts
        self._fed = len(of_vehicle)
        self._shifted = [active.shifted() for active in self.effects]
        self._reasons = at.Reason.SURROUNDINGS if of_surroundings else at.Reason.NONE

    def step(self, memory: Array, now: Conditions, dt: float, terms: Array) -> Array:
        """Fill `terms` for a step that ends now, `dt` [s] after the one before; returns the memory after it.

        An effect whose inputs are not known, or that says nothing usable, is left out, and `terms` says so.
        """
        after = memory.copy()
        after[DISTANCE] += abs(memory[LAST_SPEED]) * dt
        after[LAST_SPEED] = now.speed
        now = replace(now, distance=float(after[DISTANCE]))
        reasons, found = self._reasons, []
        fed, fed_gain, fed_inertia = 0.0, 1.0, 0.0
        variances = np.zeros(3)
        for i, active in enumerate(self.effects):
            state, one = None, None
            if not any(_unknown(getattr(now, need)) for need in active.effect.needs):
                state = _own_state(active, now, after[FIRST_OWN + EACH * i : FIRST_OWN + EACH * (i + 1)], dt)
                one = None if state is None else terms_of(active, now, state)
            if state is None or one is None:
                reasons |= at.Reason.EFFECT_LEFT_OUT
                continue
            found.append(one)
            for other in self._shifted[i]:
                moved = terms_of(other, now, state)
                if moved is not None:
                    variances += _change(one, moved) ** 2
            if i < self._fed:
                fed_gain *= float(one.drive_gain)
                if "accel" in active.effect.needs:
                    fed_inertia += float(one.torque)
                else:
                    fed += float(one.torque)
        total = together(found)
        terms[:] = (
            float(total.torque), float(total.drive_gain), float(total.loss_factor), total.softening,
            float(total.film_offset_factor), float(total.film_slope_factor), float(total.conductance), float(total.sink),
            float(total.heat), fed, fed_gain, fed_inertia, *variances, float(reasons),
        )  # fmt: skip
        return after


def _own_state(active: Active, now: Conditions, own: Array, dt: float) -> float | None:
    """An effect's own state at the end of a step, and in `own` what it tends to from now on; None if it says nothing usable."""
    try:
        lag = active.effect.lag(now, active.values)
        if lag is None:
            return 0.0
        target, time_constant, start = float(lag.target), float(lag.time_constant), float(lag.start)
    except Exception:  # as in `terms_of`
        return None
    if not (abs(target) <= MOST_STATE and abs(start) <= MOST_STATE and LEAST_TIME_S <= time_constant < math.inf):
        return None
    state = start if math.isnan(own[OWN]) else own[OWN] + (own[TARGET] - own[OWN]) * -math.expm1(-dt / own[TIME_CONSTANT])
    own[:] = state, target, time_constant
    return float(state)


def _change(one: Terms, other: Terms) -> Array:
    """What differs: torque [Nm], and relatively the loss and the driving torque."""
    of_loss = float(other.loss_factor) / float(one.loss_factor) - 1.0 + (other.softening - one.softening) * SOFTENED_OVER_K
    return np.array([float(other.torque) - float(one.torque), of_loss, float(other.drive_gain) / float(one.drive_gain) - 1.0])


def _unknown(value: object) -> bool:
    return not math.isfinite(float(value))  # type: ignore[arg-type]
