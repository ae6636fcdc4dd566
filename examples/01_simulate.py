# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What if: the same drive with another load, a warmer day, a lossier compound and a larger road wheel."""

import trackres_ros as tr
from trackres_ros.vehicle import variants

vehicle = tr.load_vehicle("xgd24d")
variant = variants(vehicle)
wheel_radius = vehicle.tracks["triangular"].road_wheels.radius

cases = [
    ("as shipped", vehicle, {}),
    ("300 kN", vehicle, {"weight_kn": 300.0}),
    ("30 degC outside", vehicle, {"ambient_degc": 30.0}),
    ("loss modulus +10 %", variant({"rubber.loss_modulus_scale": 1.1 * vehicle.rubber.loss_modulus_scale}), {}),
    ("road wheels +5 %", variant({"tracks.triangular.road_wheels.radius": 1.05 * wheel_radius}), {}),
]
print(f"{'after 600 s at 50 km/h':22} {'torque':>9} {'belt':>11}")
for name, what, conditions in cases:
    series = tr.simulate(what, speed_kmh=50.0, duration_s=600.0, **conditions)
    print(f"{name:22} {series['resistance_torque_nm'][-1]:6.0f} Nm {series['belt_degc'][-1]:6.1f} degC")
