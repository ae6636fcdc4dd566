"""A recording made on the spot, read into a Recording, and through the estimator to a table."""

from pathlib import Path

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.recording import Recording
from trackres_ros.replay import replay, result_writer
from trackres_ros.resources import config_dir
from trackres_ros.sample import write_sample
from trackres_ros.sources import open_source
from trackres_ros.topics import Topics
from trackres_ros.vehicle import load

vehicle = load("xgd24d")
bag, table = Path("laps.mcap"), Path("estimate.csv")
write_sample(bag, vehicle, speed_kmh=10.0, laps_driven=2)

topics = Topics.load(config_dir() / "topics" / "sample.yaml")
for line in Recording.from_source(open_source([bag], topics)).report():
    print(line)

estimator = Estimator(vehicle)
with result_writer(table, estimator) as write:
    result = replay(open_source([bag], topics), estimator, write)
last = dict(zip(estimator.columns, result.last, strict=True))
print(f"{result.messages} messages, {result.steps} steps over {result.duration_s:.0f} s, written to {table}")
print(f"At the end: {last['resistance_torque_nm']:.0f} Nm, front left belt {last['belt_degc/front_left']:.1f} degC")
