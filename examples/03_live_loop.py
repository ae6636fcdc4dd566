# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live loop without any middleware: one message at a time, some of them wrong, and what the estimate says of it."""

import math

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load

SECOND = 1_000_000_000
session = Estimator(load("xgd24d")).session()
speed, weight, ambient = (session.channel(name) for name in ("speed", "load", "ambient"))
now = 1_700_000_000 * SECOND


def show(what, channel, stamp, value):
    """Hand over one message, and print what came of it."""
    estimate = session.handle(channel, stamp, now, value)
    if estimate is None:
        print(f"{what:34} no new estimate")
        return
    texts = "; ".join(estimate.reason_texts()) or "no warnings"
    torque = f"{estimate.resistance_torque_nm:5.0f} +- {estimate.resistance_std_nm:4.0f} Nm"
    print(f"{what:34} {estimate.status:4} {torque}, belt {estimate.belt_degc()[0]:4.1f} degC: {texts}")


show("first speed, nothing else known", speed, now, 8.0)
show("air temperature", ambient, now, 12.0)
show("weight", weight, now, 280e3)
for what, seconds, value in [
    ("a speed", 0.1, 8.1),
    ("not a number", 0.1, math.nan),
    ("faster than it can", 0.1, 300.0),
    ("a pause of 5 s", 5.0, 8.2),
    ("a pause of 10 minutes", 600.0, 8.2),
]:
    now += int(seconds * SECOND)
    show(what, speed, now, value)
show("the same stamp again", speed, now, 8.3)
show("a stamp 0.5 s late", speed, now - SECOND // 2, 8.3)
show("a stamp one hour ahead", speed, now + 3600 * SECOND, 8.3)

print("\nCounted:")
for channel, count, number in session.counts():
    print(f"  {channel}: {count.name.lower()} {number}")
