# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The controller of docs/export.md, compiled as it stands there, through inputs that go stale and a step that gives nothing."""

import re
import subprocess

import numpy as np
import pytest
from built import STRICT, have, write

import trackres_ros as tr

pytestmark = pytest.mark.skipif(not have("cc"), reason="no C compiler is installed")

# Calls the function of the page with speeds from its input, "-" for a state that the step refuses; prints what is added, and what
# the step gives to a second state.
PROGRAM = """
#define main page_main
#include "controller.c"
#undef main
#include <stdlib.h>

int main(void)
{
    static trackres_state state, other;
    static trackres_inputs inputs;
    static trackres_outputs outputs;
    char word[64];
    double added_nm = 0.0;
    trackres_init(&state);
    trackres_init(&other);
    while (scanf("%63s", word) == 1) {
        const uint32_t version = state.version;
        const double speed_mps = word[0] == '-' ? NAN : strtod(word, NULL);
        state.version = word[0] == '-' ? 0 : version;
        added_nm = torque_to_add(&state, speed_mps, added_nm);
        state.version = version;
        trackres_no_inputs(&inputs);
        inputs.speed_mps = speed_mps;
        (void)trackres_step(&other, &inputs, period_s, &outputs);
        printf("%.17g %.17g %d\\n", added_nm, outputs.feedforward_torque_nm, outputs.level);
    }
    return 0;
}
"""
PERIOD_S, RAMP_NM_PER_S, STALE = 0.001, 5000.0, 3
DRIVEN, SILENT = ["8.0", *["nan"] * 19] * 200, ["nan"] * 3000


@pytest.fixture(scope="module")
def folder(tmp_path_factory, repository):
    """The export of a vehicle with the page's controller, itself and in the program above."""
    result = tmp_path_factory.mktemp("page")
    write(tr.load_vehicle("xgd24d"), result)
    page = (repository / "docs" / "export.md").read_text(encoding="utf-8")
    (result / "controller.c").write_text(re.search(r'```c title="controller.c"\n(.*?)```', page, re.DOTALL)[1])
    (result / "driven.c").write_text(PROGRAM)
    for name in ("controller", "driven"):
        command = ["cc", *STRICT, "-Wno-unused-function", f"{name}.c", "trackres.c", "-o", name, "-lm"]
        process = subprocess.run(command, cwd=result, capture_output=True, text=True)
        assert process.returncode == 0, process.stderr
    return result


def driven(folder, words):
    """Added torque, feed-forward of the step, and its level: a column each."""
    process = subprocess.run([folder / "driven"], input="\n".join(words), capture_output=True, text=True, check=True)
    return np.array([line.split() for line in process.stdout.splitlines()], dtype=float).T


def test_a_stale_speed_fades_the_added_torque_as_the_step_does(folder):
    added, given_values, level = driven(folder, DRIVEN + SILENT)
    assert added[len(DRIVEN) - 1] > 2000.0
    assert np.abs(np.diff(added, prepend=0.0)).max() <= RAMP_NM_PER_S * PERIOD_S + 1e-9
    faded = slice(len(DRIVEN), None)
    assert added[faded] == pytest.approx(given_values[faded], abs=1e-9)
    assert ((level[faded] == STALE) & (added[faded] > 500.0)).sum() > 500
    assert added[-1] == 0.0


def test_a_step_that_gives_nothing_ends_by_the_ramp_of_the_page(folder):
    added, _, _ = driven(folder, DRIVEN + ["-"] * 2000 + DRIVEN)
    assert np.abs(np.diff(added, prepend=0.0)).max() <= RAMP_NM_PER_S * PERIOD_S + 1e-9
    begin = added[len(DRIVEN) - 1]
    assert begin > 2000.0
    assert added[len(DRIVEN) : len(DRIVEN) + 2000] == pytest.approx(
        np.maximum(0.0, begin - RAMP_NM_PER_S * PERIOD_S * np.arange(1, 2001)), abs=1e-6
    )
    assert added[-1] > 2000.0


def test_the_program_of_the_page_fades_while_its_sensor_rests(folder):
    process = subprocess.run([folder / "controller"], capture_output=True, text=True, check=True)
    added = [float(line.split()[2]) for line in process.stdout.splitlines()]
    assert len(added) == 4
    assert added[2] == 0.0
    assert min(added[0], added[1], added[3]) > 1000.0
