# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How cold a drive began, fitted to that drive alone."""

from dataclasses import replace

import numpy as np

from proofs.field.results import start_states
from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.inference.fitting import Problem, fit, with_levels
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import Active
from trackres_ros.effects.vehicle.warmup import WarmUp


def test_cold_and_warm_starts_of_simulated_drives_are_told_apart():
    base, rng = load_base("bmw_i3").base, np.random.default_rng(6)
    effect = WarmUp().for_size(base.facts.weight * base.facts.radius, True)
    gaps = [np.inf, 10.0, 1e5, 10.0]
    sessions = [replace(s, gap=gap) for s, gap in zip(drives(base, 25.0, 4, 25.0, rng, step=1.0), gaps, strict=True)]
    values = base.nominal
    true = [Active(effect, {"torque": 60.0, "time_constant": 200.0, "cooling": 5000.0})]
    torques = [p.torque + rng.normal(0.0, 10.0, len(p.torque)) for p in base.predict(sessions, values, true)]
    used = [np.abs(s.speed) > 0.5 for s in sessions]
    sessions = [replace(s, torque=t, used=u) for s, t, u in zip(sessions, torques, used, strict=True)]
    fit_result = with_levels(fit(Problem(base, tuple(sessions), tuple(used)), [effect], rounds=2))
    states = start_states(fit_result, gaps)
    np.testing.assert_allclose(states.alone, [1.0, 0.0, 1.0, 0.0], atol=0.2)
    assert (states.alone_std < 0.2).all()
