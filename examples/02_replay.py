# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A recording made on the spot, read with what is wrong with it, and through the estimator to a table."""

import trackres_ros as tr

vehicle = tr.load_vehicle("xgd24d")
sample = tr.record_sample("laps.mcap", vehicle=vehicle, speed_kmh=10.0, laps=2)

recording = tr.read(sample.path, topics=sample.topics)
print(recording)

result = tr.replay(recording, vehicle)
table = result.save("estimate.csv")
print(f"{result.messages} messages, {result.steps} steps over {result.duration_s:.0f} s, written to {table}")
print(f"At the end: {result['resistance_torque_nm'][-1]:.0f} Nm, front left belt {result['belt_degc/front_left'][-1]:.1f} degC")
