"""Left-out effects in the live step: their terms from what is known now, and the states of their own.

They run in plain Python before each compiled step: a vehicle file without effects pays nothing for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.effect import Active, Conditions, Facts, together
from trackres_ros.estimator import layout as at

Array = NDArray[np.float64]

# What is remembered: distance [m], speed of the last step [m/s]; then of each effect its own state, its target and time constant.
DISTANCE, LAST_SPEED, FIRST_OWN = range(3)
OWN, TARGET, TIME_CONSTANT = range(3)
EACH = 3


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


class EffectsStep:
    """The effects of a vehicle, for one step after the other."""

    def __init__(self, effects: Sequence[Active], facts: Facts) -> None:
        self.effects, self.facts = tuple(effects), facts

    def step(self, memory: Array, now: Conditions, dt: float, terms: Array) -> Array:
        """Fill `terms` for a step that ends now, `dt` [s] after the one before; returns the memory after it.

        An effect whose inputs are not known is left out, and `terms` says so.
        """
        after = memory.copy()
        after[DISTANCE] += abs(memory[LAST_SPEED]) * dt
        after[LAST_SPEED] = now.speed
        now = replace(now, distance=float(after[DISTANCE]))
        missing = [a for a in self.effects if any(_unknown(getattr(now, need)) for need in a.effect.needs)]
        usable = [(i, a) for i, a in enumerate(self.effects) if a not in missing]
        factor = math.prod(a.terms(now, 0.0).speed_factor for _, a in usable if a.effect.acts_on == "sensor")
        now = replace(now, speed=float(now.speed) * factor)
        found = []
        for i, active in usable:
            own = after[FIRST_OWN + EACH * i : FIRST_OWN + EACH * (i + 1)]
            lag = active.effect.lag(now, active.values)
            if lag is not None:
                if math.isnan(own[OWN]):
                    own[OWN] = float(lag.start)
                else:
                    own[OWN] += (own[TARGET] - own[OWN]) * -math.expm1(-dt / own[TIME_CONSTANT])
                own[TARGET], own[TIME_CONSTANT] = float(lag.target), float(lag.time_constant)
            found.append(active.terms(now, float(own[OWN]) if lag is not None else 0.0))
        total = together(found)
        terms[:] = (
            float(total.torque), float(total.drive_gain), float(total.loss_factor), total.softening,
            float(total.film_offset_factor), float(total.film_slope_factor), float(total.conductance), float(total.sink),
            float(total.heat), total.speed_factor,
            total.sensor_gain, total.sensor_offset, float(at.Reason.EFFECT_LEFT_OUT if missing else 0),
        )  # fmt: skip
        return after


def _unknown(value: object) -> bool:
    return not math.isfinite(float(value))  # type: ignore[arg-type]
