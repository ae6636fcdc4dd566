# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the content of a vehicle file: unit and absolute limits of each quantity.

The limits here bound any track vehicle; the `range` a file gives with each value is narrower and is that vehicle's.
"""

from __future__ import annotations

from typing import NamedTuple


class QuantityLimits(NamedTuple):
    """Unit, absolute limits and meaning of a quantity."""

    unit: str
    low: float
    high: float
    meaning: str
    optional: bool = False


RUBBER = {
    "sweep_frequency": QuantityLimits("Hz", 0.001, 1e4, "frequency of the temperature sweep in the rubber file"),
    "glass_transition": QuantityLimits("degC", -130.0, 40.0, "Tg of the shift function"),
    "wlf_c1": QuantityLimits("1", 1.0, 30.0, "C1 of the WLF shift about Tg + 50 K"),
    "wlf_c2": QuantityLimits("K", 51.0, 300.0, "C2 of the WLF shift about Tg + 50 K"),
    "density": QuantityLimits("kg/m^3", 700.0, 2500.0, "rubber density"),
    "conductivity": QuantityLimits("W/m/K", 0.05, 2.0, "rubber heat conductivity"),
    "heat_capacity": QuantityLimits("J/kg/K", 700.0, 3000.0, "rubber specific heat capacity"),
    "layer_stiffening": QuantityLimits("1", 1.0, 3.0, "stiffness of the confined layer over that of the material"),
    "loss_modulus_scale": QuantityLimits("1", 0.1, 10.0, "factor on the loss modulus of the file"),
}

# The temperature sweep. A rubber is glassy at some GPa at most, and at the warm end no rubber above 1 GPa; filled or not its
# loss over storage modulus stays within tan delta (Mark, Erman, Roland: The Science and Technology of Rubber, 4th ed., ch. 3).
SWEEP_DEGC = QuantityLimits("degC", -150.0, 300.0, "temperature of a row")
SWEEP_STORAGE = QuantityLimits("MPa", 0.05, 2e4, "storage modulus")
SWEEP_LOSS = QuantityLimits("MPa", 1e-4, 1e4, "loss modulus")
SWEEP_TAN_DELTA = QuantityLimits("1", 1e-4, 5.0, "loss over storage modulus")
WARM_STORAGE = QuantityLimits("MPa", 0.05, 1e3, "storage modulus at the warm end, where it is a rubber")

CHASSIS = {
    "bearing_friction": QuantityLimits("1", 0.0, 0.2, "bearing friction coefficient"),
    "drag_coefficient": QuantityLimits("1", 0.0, 3.0, "aerodynamic drag coefficient"),
    "frontal_area": QuantityLimits("m^2", 0.0, 30.0, "frontal area"),
    "air_density": QuantityLimits("kg/m^3", 0.3, 2.0, "air density"),
    "rotating_mass_factor": QuantityLimits("1", 1.0, 3.0, "effective over true mass in acceleration"),
    "max_speed": QuantityLimits("m/s", 0.5, 60.0, "maximum speed; faster measurements are rejected"),
    "max_acceleration": QuantityLimits(
        "m/s^2", 1.0, 50.0, "maximum acceleration and braking; speeds that change faster are rejected", optional=True
    ),
    "ambient": QuantityLimits("degC", -60.0, 60.0, "ambient temperature used if none is given"),
    "motor_ratio": QuantityLimits("1", 0.1, 500.0, "motor speed over sprocket speed", optional=True),
    "motor_efficiency": QuantityLimits("1", 0.3, 1.0, "efficiency from motor to sprocket", optional=True),
}

AXLE_LOAD = QuantityLimits("N", 10.0, 1e7, "load of the axle, without its assemblies")

TRACK = {
    "own_weight": QuantityLimits("N", 1.0, 1e6, "weight of one assembly"),
    "sprocket_radius": QuantityLimits("m", 0.02, 3.0, "sprocket pitch radius"),
}

BELT = {
    "width": QuantityLimits("m", 0.02, 3.0, "belt width"),
    "thickness": QuantityLimits("m", 0.003, 0.3, "belt thickness without tread bars and lugs"),
    "cord_height": QuantityLimits("m", 0.0005, 0.2, "height of the cords above the inner face"),
    "loop_length": QuantityLimits("m", 0.3, 60.0, "length of the belt loop"),
    "lug_section": QuantityLimits("m^2", 0.0, 0.5, "section of lugs and tread bars, mean round the loop"),
    "tread_depth": QuantityLimits("m", 0.0, 0.2, "height of the tread bars"),
    "tread_land_ratio": QuantityLimits("1", 0.0, 1.0, "share of the outer face that tread bars cover"),
    "curvature_length": QuantityLimits("m", 0.001, 1.0, "length over which the belt takes up its curvature"),
    "cord_section": QuantityLimits("m^2", 1e-7, 0.1, "section of all cords"),
    "cord_modulus": QuantityLimits("Pa", 1e8, 3e11, "tensile modulus of the cords"),
    "cord_density": QuantityLimits("kg/m^3", 900.0, 9000.0, "cord density"),
    "cord_heat_capacity": QuantityLimits("J/kg/K", 300.0, 2500.0, "cord specific heat capacity"),
    "pretension": QuantityLimits("N", 0.0, 1e6, "belt tension from the spring"),
    "tooth_height": QuantityLimits("m", 0.001, 0.5, "height of the drive teeth; the sag may be half of it"),
    "sag_half_span": QuantityLimits("m", 0.01, 10.0, "half the free span that sags"),
    "exposed_share": QuantityLimits("1", 0.05, 1.0, "cooled share of 2 (width + thickness) x loop length"),
    "film_offset": QuantityLimits("W/m^2/K", 0.5, 500.0, "film coefficient at rest"),
    "film_slope": QuantityLimits("W/m^2/K per speed_unit", 0.0, 50.0, "film coefficient gained per unit of speed"),
    "surface_share": QuantityLimits("1", 0.01, 0.9, "share of heat capacity in the surface node"),
}
BELT_CHOICES = {"film_speed_unit": ("m/s", "km/h")}

ROAD_WHEELS = {
    "radius": QuantityLimits("m", 0.01, 2.0, "road-wheel radius"),
    "contact_length": QuantityLimits("m", 0.01, 3.0, "axial length of the wheel's contact"),
    "positions": QuantityLimits("m", 0.0, 60.0, "positions from the front end of the ground run"),
    "ground_run": QuantityLimits("m", 0.05, 60.0, "length of the ground run"),
}

WRAPPED_WHEEL = {
    "radius": QuantityLimits("m", 0.01, 3.0, "radius of a wheel the belt wraps"),
    "wrap_angle": QuantityLimits("rad", -3.2, 6.3, "wrap angle; negative where the belt is bent backwards"),
}
WHEEL_KINDS = ("sprocket", "tensioner", "guide")

BEAM = {
    "split": QuantityLimits("1", 0.0, 1.0, "share of the load on the beam's rear end"),
    "own_weight_split": QuantityLimits("1", 0.0, 1.0, "the same for the assembly's own weight", optional=True),
}

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

MODEL_CHOICES = {"hysteresis": ("spectral", "rainflow"), "thermal": ("lumped", "core_surface")}

# Watched disturbances. Their noise is that of blocks of `estimator.disturbance.BLOCK_S`.
_NOISE = QuantityLimits("Nm", 1e-3, 1e6, "standard deviation of 5 s means of the measured torque about the expected torque")
DISTURBANCES = {
    "spells": {
        "level": QuantityLimits("Nm", -1e6, 1e6, "torque against travel while it is present, above the expected torque"),
        "rest": QuantityLimits(
            "Nm", -1e6, 1e6, "torque against travel while it is absent; not 0 if the fitted values absorb its mean"
        ),
        "mean_there": QuantityLimits("s", 10.0, 1e5, "mean length of a spell"),
        "mean_away": QuantityLimits("s", 10.0, 1e6, "mean time between two"),
        "noise": _NOISE,
    },
    "drift": {
        "size": QuantityLimits("Nm", 1e-3, 1e6, "standard deviation of the drifting torque"),
        "time_constant": QuantityLimits("s", 10.0, 1e6, "time constant of the drift"),
        "noise": _NOISE,
    },
}
