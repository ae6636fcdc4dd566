# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first start on a machine: a torque at once, the same numbers after it has compiled, and an orderly end meanwhile."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest

PROGRAM = """
import json, os, sys
sys.path[:0] = sys.argv[1:3]
from conftest import Desk
from waiting import Pace, wait_for
desk = Desk()
first = desk.app.estimator.entries.compiled
desk.drive(1.0)
early, said = dict(desk.app.overview().values), "COMPILING" in desk.names()
def change_over():
    desk.steady_s += 1.0
    desk.app.tick()
    return desk.app.estimator.entries.compiled
if sys.argv[3] == "wait":
    wait_for(change_over, working=os.getpid(), meanwhile=Pace(5.0).next)
compiled = desk.app.estimator.entries.compiled
again = Desk()
again.drive(1.0)
late = dict(again.app.overview().values)
again.app.close()
desk.app.close()
pairs = [(early[name], late[name]) for name in early if early[name] == early[name]]
print(json.dumps([first, said, compiled, max(abs(a - b) for a, b in pairs)]))
"""


def run(cache, repository, how):
    """Run it; `wait` until it has changed over, as long as the compiling process computes, or not."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", PROGRAM, *(str(repository / "test" / of) for of in ("node", "processes")), how]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.long
@pytest.mark.skipif(not find_spec("numba"), reason="numba is not installed: nothing is compiled")
def test_the_first_start_computes_at_once_and_compiles_beside(tmp_path, repository, warm_code):
    for path in warm_code("rest.entry"):
        path.unlink()
    compiled_at_first, said, compiled_at_last, difference = run(tmp_path, repository, "wait")
    assert not compiled_at_first
    assert said
    assert compiled_at_last
    assert difference == 0.0
    assert run(tmp_path, repository, "at once")[0]


@pytest.mark.skipif(not find_spec("numba"), reason="numba is not installed: nothing is compiled")
def test_it_ends_in_order_while_it_compiles(tmp_path, repository):
    compiled_at_first, said, compiled_at_last, _ = run(tmp_path, repository, "at once")
    assert (compiled_at_first, said, compiled_at_last) == (False, True, False)
