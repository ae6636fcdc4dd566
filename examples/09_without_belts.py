# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bus on tyres: what its torque is made of, and the same step as in a control loop, on a slope and with passengers."""

import trackres_ros as tr

bus = tr.load_vehicle("ztbus_hess19")
print(tr.explain(bus, speed_kmh=50))

estimator = tr.Estimator(bus)
for what, known in (("level", {}), ("up 3 %", {"grade": 0.03}), ("60 passengers more", {"weight": bus.weight + 60 * 70 * 9.81})):
    inputs = estimator.inputs(speed=50 / 3.6, acceleration=0.0, **known)
    _, estimate = estimator.step(estimator.cold_start(inputs), inputs, dt=0.1)
    print(f"{what:20} {estimate['drive_torque_nm']:5.0f} Nm, of it against resistance {estimate.resistance_torque_nm:5.0f} Nm")
