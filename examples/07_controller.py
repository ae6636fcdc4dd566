# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A drive controller adds the feed-forward while messages come, ramps it to zero when they stop, and never by a jump.

`Drive` knows no middleware: `on_estimate` is called with each message, `torque` in each control step. How it is connected on
ROS 2 stands below it; here it is fed by hand.
"""

import math

OK, WARN, ERROR, STALE = range(4)
SILENCE_S = 0.2  # without a message, by this controller's own clock: the deadline that the node offers (output_deadline_s)
OLDEST_S = 2.0  # of a stamp: by then the node has faded what it feeds forward, so an older message has waited on its way
FARTHEST_AHEAD_S = 0.05  # of a stamp before this clock: more is another clock, of which no age can be told


class Drive:
    """Speed controller with feed-forward; times in seconds of the clock that stamps are made with."""

    def __init__(self, gain=8000.0, integral_gain=2000.0, limit_nm=20000.0, ramp_nm_per_s=5000.0):
        self.gain, self.integral_gain, self.limit_nm, self.ramp_nm_per_s = gain, integral_gain, limit_nm, ramp_nm_per_s
        self.stamp_s, self.feedforward, self.level, self.silent_s = 0.0, 0.0, ERROR, math.inf
        self.used, self.integral, self.last_s = 0.0, 0.0, None

    def on_estimate(self, stamp_s, torque_nm, level):
        """A message of ~/estimate: torque and level of one moment."""
        self.stamp_s, self.feedforward, self.level, self.silent_s = stamp_s, torque_nm, level, 0.0

    def usable(self, now_s):
        """Whether the feed-forward is added now. STALE is no reason against it: the node fades it to zero by itself."""
        return (
            self.silent_s <= SILENCE_S  # the watchdog
            and -FARTHEST_AHEAD_S <= now_s - self.stamp_s <= OLDEST_S
            and self.level in (OK, WARN, STALE)
            and math.isfinite(self.feedforward)
        )

    def torque(self, now_s, set_speed, speed):
        """Torque at the sprockets [Nm]; to be called in each control step."""
        passed_s = 0.0 if self.last_s is None else max(0.0, now_s - self.last_s)
        elapsed_s, self.last_s, self.silent_s = min(0.1, passed_s), now_s, self.silent_s + passed_s
        wanted = self.feedforward if self.usable(now_s) else 0.0
        room = self.ramp_nm_per_s * elapsed_s
        self.used += max(-room, min(room, wanted - self.used))
        error = set_speed - speed
        demand = self.gain * error + self.integral + self.used
        given = max(-self.limit_nm, min(self.limit_nm, demand))
        if given == demand:  # when saturated, the integral waits
            self.integral += self.integral_gain * error * elapsed_s
        return given


# On ROS 2:
#
#     class DriveNode(Node):
#         def __init__(self):
#             super().__init__("drive")
#             self.drive = Drive()
#             self.create_subscription(DynamicInterfaceGroupValues, "/trackres/estimate", self.on_estimate, 10)
#
#         def on_estimate(self, message):
#             group = message.interface_values[list(message.interface_groups).index("vehicle")]
#             found = dict(zip(group.interface_names, group.values))
#             stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
#             self.drive.on_estimate(stamp_s, found["feedforward_torque_nm"], found["level"])


if __name__ == "__main__":
    drive, now = Drive(), 1_700_000_000.0
    for what, seconds, age_s, level, torque_nm in [
        ("nothing has come yet", 0.2, None, None, None),
        ("all is well", 1.0, 0.02, OK, 3000.0),
        ("a stamp an hour ahead", 1.0, -3600.0, OK, 3000.0),
        ("all is well again", 1.0, 0.02, WARN, 3000.0),
        ("no speed, the node fades", 1.0, 1.0, STALE, 1500.0),
        ("a fault", 1.0, 0.02, ERROR, 3000.0),
        ("all is well again", 1.0, 0.02, OK, 3000.0),
        ("the node is gone", 1.0, None, None, None),
    ]:
        for _ in range(round(seconds / 0.02)):
            now += 0.02
            if level is not None:
                drive.on_estimate(now - age_s, torque_nm, level)
            drive.torque(now, set_speed=5.0, speed=5.0)
        print(f"{what:24} {drive.used:6.0f} Nm of {torque_nm or 0.0:4.0f} Nm are added")
