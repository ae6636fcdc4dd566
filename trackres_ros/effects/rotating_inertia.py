"""Rotating parts that the vehicle file leaves out or counts too high."""

from __future__ import annotations

from trackres_ros.effects.effect import Conditions, Effect, Parameter, Terms, Values
from trackres_ros.model.belt import GRAVITY


class RotatingInertia(Effect):
    name = "rotating_inertia"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "rotating parts take torque to speed up and give it back"
    needs = ("speed", "accel")
    parameters = (Parameter("factor", "1", -0.1, 0.8, 0.1, "added to the rotating-mass factor", off=0.0),)

    def terms(self, at: Conditions, p: Values) -> Terms:
        return Terms(torque=p["factor"] * at.weight / GRAVITY * at.accel * at.facts.radius)
