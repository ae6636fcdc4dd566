# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Without numba the same numbers come out."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.effects import Active, catalogue, stepping
from trackres_ros.estimator.entry_points import interpreted_entries
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.jit.compiled import HAVE_NUMBA
from trackres_ros.vehicle import load

PROGRAM = """
import json, sys
import numpy as np
from dataclasses import replace
from trackres_ros.jit.compiled import HAVE_NUMBA
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load
out = []
for thermal in ("lumped", "core_surface"):
    estimator = Estimator(replace(load("xgd24d"), thermal=thermal))
    random = np.random.default_rng(4)
    n = 400
    channel = random.choice([0, 0, 0, 1, 3, 4, 6], n).astype(np.int16)
    stamp = 10**18 + np.cumsum(random.integers(1, 3 * 10**9, n))
    kinds = [random.normal(8, 2, n), random.normal(272e3, 1e4, n), random.normal(0, .05, n)]
    value = np.select([channel == 0, channel == 1, channel == 6], kinds, 20.0)
    rows = estimator.session().handle_block(channel, stamp, stamp, value).rows
    out.append(np.where(np.isfinite(rows), rows, -1e9).tolist())
json.dump([HAVE_NUMBA, out], sys.stdout)
"""


def run(interpreted):
    environment = {**os.environ, **({"TRACKRES_INTERPRETED": "1"} if interpreted else {})}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.skipif(not HAVE_NUMBA, reason="numba is not installed: there is nothing to compare")
def test_interpreted_equals_compiled():
    compiled, interpreted = run(False), run(True)
    assert (compiled[0], interpreted[0]) == (True, False)
    for fast, slow in zip(compiled[1], interpreted[1], strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-9)


def test_where_nothing_is_to_be_compiled_effects_are_not_either(monkeypatch):
    def refuse(*_):
        raise AssertionError("an effect is compiled")

    monkeypatch.setattr(stepping, "_machine_code", refuse)
    drag = catalogue()["drivetrain_drag"]
    vehicle = replace(load("xgd24d"), effects=(Active(drag, drag.values()),))
    estimator = Estimator(vehicle, entries=interpreted_entries())
    inputs = estimator.inputs(5.0, ambient=15.0)
    _, estimate = estimator.step(estimator.cold_start(inputs), inputs, 0.1)
    assert estimate["effects_nm"] == pytest.approx(drag.values()["drag"])
