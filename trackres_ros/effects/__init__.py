# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The catalogue of missing-physics effects, one file each. The same object is fitted, runs live and is named in the report."""

from trackres_ros.effects.effect import Active, Conditions, Effect, Lag, Parameter, Terms, VehicleConstants, together
from trackres_ros.effects.registry import catalogue, check_effects

__all__ = [
    "Active", "Conditions", "Effect", "Lag", "Parameter", "Terms", "VehicleConstants", "catalogue", "check_effects", "together",
]  # fmt: skip
