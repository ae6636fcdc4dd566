# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two minutes of vehicle time with random faults on each transport."""

import pytest
from soak import PARAMETERS, TORQUE_TOPIC, Soak

SPEEDUP = {"dds": 20.0, "ros": 12.0}  # what each takes without losing a message, on two cores


@pytest.mark.long
def test_two_minutes_of_faults(node, capsys):
    n = node(topics=TORQUE_TOPIC, **PARAMETERS)
    soak = Soak(n, seed=11, speedup=SPEEDUP[n.transport])
    soak.run(2.0)
    assert all(soak.faults.values()), soak.faults
    assert n.stop() == 0, n.log
    with capsys.disabled():
        print(f"\n{n.transport}: {soak.told()}")
