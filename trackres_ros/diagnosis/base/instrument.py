# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small errors of every torque sensor: parameters of the fit with tight priors, not findings.

Instruments have a delay of some hundredths of a second, an offset of some Nm and a gain error of up to a percent. They are
fitted together with the base, within the bounds here. Beyond these bounds, an effect of the catalogue replaces them.
"""

from __future__ import annotations

import copy
from dataclasses import replace

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.effects.effect import REFERENCE_NM, Effect
from trackres_ros.effects.sensor.delay import Delay
from trackres_ros.effects.sensor.torque_gain import TorqueGain
from trackres_ros.effects.sensor.torque_offset import TorqueOffset

PRIOR_STDS = 3.0  # from the no-effect value to the start of a parameter, see `fitting.free_parameters`
DELAY_S, MOST_DELAY_S = 0.06, 0.12  # standard deviation and bound; the delay may be negative
GAIN, MOST_GAIN = 0.005, 0.015
OFFSET_NM, MOST_OFFSET_NM = 15.0, 45.0  # of a vehicle of `REFERENCE_NM`


def instrument(base: Base) -> tuple[Effect, ...]:
    """Small sensor effects that the base does not have as parameters."""
    offset = usual_offset(base)
    limits = (
        (Delay(), DELAY_S, MOST_DELAY_S),
        (TorqueGain(), GAIN, MOST_GAIN),
        (TorqueOffset(), offset, offset * MOST_OFFSET_NM / OFFSET_NM),
    )
    return tuple(
        narrow_prior(effect, std, largest_value) for effect, std, largest_value in limits if effect.name not in base.includes
    )


def usual_offset(base: Base) -> float:
    """Prior standard deviation of a torque sensor's offset on this vehicle [Nm]."""
    return OFFSET_NM * base.facts.weight * base.facts.radius / REFERENCE_NM


def narrow_prior(effect: Effect, std: float, largest_value: float) -> Effect:
    """An effect whose parameters get this prior standard deviation and bound, in its unit, around no effect."""
    narrow_effect = copy.copy(effect)
    narrow_effect.parameters = tuple(
        replace(q, low=-largest_value, high=largest_value, start=std / PRIOR_STDS) for q in effect.parameters
    )
    return narrow_effect
