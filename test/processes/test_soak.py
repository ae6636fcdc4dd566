"""Ten minutes of vehicle time with random faults on each edge."""

import pytest
from soak import PARAMETERS, TORQUE_TOPIC, Soak


@pytest.mark.long
def test_ten_minutes_of_faults(node, capsys):
    n = node(topics=TORQUE_TOPIC, **PARAMETERS)
    soak = Soak(n, seed=11, speedup=12.0)
    soak.run(10.0)
    assert all(soak.faults.values()), soak.faults
    assert n.stop() == 0, n.log
    with capsys.disabled():
        print(f"\n{n.edge}: {soak.told()}")
