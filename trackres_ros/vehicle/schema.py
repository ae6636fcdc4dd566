# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the content of a vehicle file: its quantities by section, and its choices."""

from __future__ import annotations

from trackres_ros.vehicle.description import (
    Axle,
    Beam,
    Belt,
    Chassis,
    Drift,
    QuantityLimits,
    RoadWheels,
    Rubber,
    Spells,
    Track,
    WrappedWheel,
    limits_of,
)

RUBBER, CHASSIS, TRACK, BELT, ROAD_WHEELS = map(limits_of, (Rubber, Chassis, Track, Belt, RoadWheels))
WRAPPED_WHEEL, BEAM, AXLE_LOAD = limits_of(WrappedWheel), limits_of(Beam), limits_of(Axle)["load"]
DISTURBANCES = {kind.form: limits_of(kind) for kind in (Spells, Drift)}
FILM_SPEED_UNITS = ("m/s", "km/h")
WHEEL_KINDS = ("sprocket", "tensioner", "guide")
MODEL_CHOICES = {"hysteresis": ("spectral", "rainflow"), "thermal": ("lumped", "core_surface")}

# The temperature sweep. A rubber is glassy at some GPa at most, and at the warm end no rubber above 1 GPa; filled or not its
# loss over storage modulus stays within tan delta (Mark, Erman, Roland: The Science and Technology of Rubber, 4th ed., ch. 3).
SWEEP_DEGC = QuantityLimits("degC", -150.0, 300.0, "temperature of a row")
SWEEP_STORAGE = QuantityLimits("MPa", 0.05, 2e4, "storage modulus")
SWEEP_LOSS = QuantityLimits("MPa", 1e-4, 1e4, "loss modulus")
SWEEP_TAN_DELTA = QuantityLimits("1", 1e-4, 5.0, "loss over storage modulus")
WARM_STORAGE = QuantityLimits("MPa", 0.05, 1e3, "storage modulus at the warm end, where it is a rubber")

ROAD_LOAD = {
    "rolling_coefficient": QuantityLimits("1", 0.0, 0.5, "rolling resistance over weight"),
    "rolling_rise": QuantityLimits("s/m", -0.01, 0.05, "growth of the rolling coefficient with speed"),
    "drag_area": QuantityLimits("m^2", 0.0, 30.0, "drag coefficient times frontal area"),
    "air_density": QuantityLimits("kg/m^3", 0.3, 2.0, "air density"),
    "mass": QuantityLimits("kg", 0.5, 1e6, "mass with driver and load"),
    "rotating_mass_factor": QuantityLimits("1", 1.0, 3.0, "effective over true mass in acceleration"),
    "wheel_radius": QuantityLimits("m", 0.01, 3.0, "rolling radius of the driven wheels"),
    "torque_scale": QuantityLimits(
        "1", 0.01, 100.0, "measured over true torque at the wheels, for example from a motor constant"
    ),
    "efficiency": QuantityLimits("1", 0.75, 1.0, "of the gears between the measured torque and the wheels"),
    "torque_delay": QuantityLimits("s", 0.0, 1.0, "delay of the measured torque"),
    "contact_length": QuantityLimits("m", 0.01, 10.0, "length of the ground contact, or the wheelbase of a skid-steered vehicle"),
    "track_width": QuantityLimits("m", 0.02, 10.0, "effective track width for turning", optional=True),
    "max_speed": QuantityLimits("m/s", 0.1, 100.0, "greatest speed"),
    "ambient": QuantityLimits("degC", -60.0, 60.0, "ambient temperature used if none is given"),
    "coulomb_friction": QuantityLimits("N", 0.0, 1e6, "Coulomb friction", optional=True),
    "viscous_friction": QuantityLimits("N s/m", 0.0, 1e8, "viscous friction over speed", optional=True),
    "torque_offset": QuantityLimits("Nm", -1e5, 1e5, "reading at zero torque, over the scale", optional=True),
}
