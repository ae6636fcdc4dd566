# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hundreds of hours of driving with a sensor that has its noise and nothing else: nothing drifts, and memory stays as it is."""

from __future__ import annotations

import json

import numpy as np

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.resources import find_vehicle
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import VEHICLES_OWN
from trackres_ros.learning.store import stored
from trackres_ros.vehicle import load

STEP_NS = 500_000_000
TRUE_LOSS = 0.12
NOISE_NM, WANDERS_NM, WANDERS_S = 60.0, 60.0, 300.0
START_NS = 1_700_000_000_000_000_000
Hours = list[dict[str, float]]


def age(seed: int, hours: float, vehicle: str = "xgd24d") -> Hours:
    """Drive so many hours at 2 Hz; after each return the error of the acting values [share of the torque] and the state size
    [bytes].
    """
    estimator = Estimator(load(find_vehicle(vehicle)))
    true, session, learner = estimator.session(), estimator.session(), Learner(estimator, "on")
    true.learned[at.Learned.on], at.Learned(true.learned).departures[at.OF_LOSS] = 1.0, TRUE_LOSS
    rng = np.random.default_rng([seed, 200])
    keep = np.exp(-0.5 / WANDERS_S)
    slow, found = 0.0, []
    per_hour = int(3600.0 / (STEP_NS * 1e-9))
    for hour in range(max(1, round(hours))):
        shocks = rng.normal(0.0, WANDERS_NM * np.sqrt(1.0 - keep * keep), per_hour).tolist()
        noise = rng.normal(0.0, NOISE_NM, per_hour).tolist()
        errors = []
        for i in range(per_hour):
            number = hour * per_hour + i
            stamp = START_NS + number * STEP_NS
            time = number * 0.5
            speed = max(0.0, 8.0 + 6.0 * np.sin(time / 70.0) + 2.0 * np.sin(time / 900.0))
            slow = keep * slow + shocks[i]
            torque = true.handle(at.SPEED, stamp, stamp, speed)
            assert torque is not None
            session.handle(at.TORQUE, stamp, stamp, torque["drive_torque_nm"] + slow + noise[i])
            estimate = session.handle(at.SPEED, stamp, stamp, speed)
            assert estimate is not None
            learner.take(stamp, estimate.row.tolist(), session)
            if i % 20 == 0 and speed > 1.0:
                errors.append((estimate.resistance_torque_nm - torque.resistance_torque_nm) / torque.resistance_torque_nm)
        size = float(len(json.dumps(stored(learner))))
        own = [float(learner.learned.applied[state]) for state in VEHICLES_OWN]
        found.append({"hour": hour + 1.0, "error": float(np.mean(np.abs(errors))), "bias": float(np.mean(errors)), "bytes": size,
                      "largest_departure": max(map(abs, own))})  # fmt: skip
    return found
