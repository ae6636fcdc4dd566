# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Splits the residual of a fit by source: torque sensor, speed sensor and model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.text.numbers import figures
from trackres_ros.units import GRAVITY


@dataclass(frozen=True, slots=True)
class ResidualSources:
    """Root mean squares over steps of a session's length [Nm].

    Attributes
    ----------
    total
        The whole residual.
    torque_sensor
        Sample-to-sample noise of the torque; None where unknown.
    speed_sensor
        The inertia times the error of the smoothed acceleration; None where unknown.
    model
        Upper bound for the model: the rest, which includes slow errors of sensors.
    """

    total: float
    torque_sensor: float | None
    speed_sensor: float | None
    model: float
    step: float = 1.0  # s

    @property
    def text(self) -> str:
        """Summary in words."""

        def size(value: float | None) -> str:
            return "an unknown part" if value is None else f"{figures(value)} Nm"

        return (
            f"The residual is {figures(self.total)} Nm in steps of {self.step:g} s. The torque sensor's noise contributes "
            f"{size(self.torque_sensor)}, the speed sensor {size(self.speed_sensor)} (inertia times the error of the smoothed "
            f"acceleration). The model contributes at most {size(self.model)}: the rest, including slow errors of the sensors"
        )


def residual_sources(fit: Fit) -> ResidualSources:
    """Split the torque residual by source; squares add up."""
    base, squares, torque, speed, told = fit.problem.base, 0.0, 0.0, 0.0, [True, True]
    count = sum(int(mask.sum()) for mask in fit.problem.masks)
    for session, mask, predicted in zip(fit.problem.sessions, fit.problem.masks, fit.predicted, strict=True):
        if not mask.any():
            continue
        squares += float(((session.torque - predicted.torque)[mask] ** 2).sum()) / count
        inertia = base.torque_scale * base.facts.radius * base.rotating_mass_factor * session.weight[mask] / GRAVITY
        torque += session.torque_noise**2 * int(mask.sum()) / count
        speed += float(((inertia * session.accel_noise) ** 2).sum()) / count
        told = [told[0] and session.torque_noise > 0.0, told[1] and session.accel_noise > 0.0]
    model = float(np.sqrt(max(squares - torque - speed, 0.0)))
    return ResidualSources(
        float(np.sqrt(squares)), float(np.sqrt(torque)) if told[0] else None, float(np.sqrt(speed)) if told[1] else None, model,
        fit.problem.sessions[0].step,
    )  # fmt: skip
