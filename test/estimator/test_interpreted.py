"""Without numba the same numbers come out."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from trackres_ros.compiled import HAVE_NUMBA

PROGRAM = """
import json, sys
import numpy as np
from dataclasses import replace
from trackres_ros.compiled import HAVE_NUMBA
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
