"""What if: the same drive with another load, a warmer day, a lossier compound and a larger road wheel."""

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.simulate import ramp_and_hold, simulate
from trackres_ros.vehicle import load, variants

KMH = 1 / 3.6
drive = ramp_and_hold(50 * KMH, ramp_s=50.0, duration_s=600.0, dt=0.1)
vehicle = load("xgd24d")
variant = variants(vehicle)
wheel_radius = vehicle.tracks["triangular"].road_wheels.radius

cases = [
    ("as shipped", vehicle, {}),
    ("300 kN", vehicle, {"weight_n": 300e3}),
    ("30 degC outside", vehicle, {"ambient_degc": 30.0}),
    ("loss modulus +10 %", variant({"rubber.loss_modulus_scale": 1.1 * vehicle.rubber.loss_modulus_scale}), {}),
    ("road wheels +5 %", variant({"tracks.triangular.road_wheels.radius": 1.05 * wheel_radius}), {}),
]
print(f"{'after 600 s at 50 km/h':22} {'torque':>9} {'belt':>11}")
for name, what, conditions in cases:
    series = simulate(Estimator(what), drive, **conditions)
    print(f"{name:22} {series['resistance_torque_nm'][-1]:6.0f} Nm {series['belt_degc'][-1]:6.1f} degC")
