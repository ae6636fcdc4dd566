"""The first start on a machine: a torque at once, the same numbers after it has compiled, and an orderly end meanwhile."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest

PROGRAM = """
import json, sys, time
sys.path.insert(0, sys.argv[1])
from conftest import Desk
desk = Desk()
first = desk.app.estimator.entries.compiled
desk.drive(1.0)
early, said = dict(desk.app.overview().values), "COMPILING" in desk.names()
until = time.monotonic() + float(sys.argv[2])
while not desk.app.estimator.entries.compiled and time.monotonic() < until:
    time.sleep(0.2)
    desk.steady_s += 1.0
    desk.app.tick()
compiled = desk.app.estimator.entries.compiled
again = Desk()
again.drive(1.0)
late = dict(again.app.overview().values)
again.app.close()
desk.app.close()
pairs = [(early[name], late[name]) for name in early if early[name] == early[name]]
print(json.dumps([first, said, compiled, max(abs(a - b) for a, b in pairs)]))
"""


def run(cache, repository, wait_s):
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", PROGRAM, str(repository / "test" / "live"), str(wait_s)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=200)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.long
@pytest.mark.skipif(not find_spec("numba"), reason="numba is not installed: nothing is compiled")
def test_the_first_start_computes_at_once_and_compiles_beside(tmp_path, repository):
    compiled_at_first, said, compiled_at_last, difference = run(tmp_path, repository, 120.0)
    assert not compiled_at_first
    assert said
    assert compiled_at_last
    assert difference < 1e-9
    assert run(tmp_path, repository, 0.0)[0]


@pytest.mark.skipif(not find_spec("numba"), reason="numba is not installed: nothing is compiled")
def test_it_ends_in_order_while_it_compiles(tmp_path, repository):
    compiled_at_first, said, compiled_at_last, _ = run(tmp_path, repository, 0.0)
    assert (compiled_at_first, said, compiled_at_last) == (False, True, False)
