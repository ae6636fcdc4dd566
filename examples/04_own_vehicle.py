# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Your own vehicle: copy a shipped file, change a value, look at what it makes of it, and see a bad value refused."""

import shutil
from pathlib import Path

import yaml

from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.resources import config_dir
from trackres_ros.vehicle import load

own = Path("own.yaml")
shutil.copytree(config_dir() / "rubber", "rubber", dirs_exist_ok=True)  # the vehicle file names its rubber by this path
content = yaml.safe_load((config_dir() / "agri3t.yaml").read_text(encoding="utf-8"))
content["name"], content["title"] = "own", "my carrier with a thicker belt"
thickness = content["tracks"]["low"]["belt"]["thickness"]
thickness.update(value=0.025, reason="measured with a calliper")
own.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")

for name in ("agri3t", own):
    vehicle = load(name)
    estimator = Estimator(vehicle)
    inputs = estimator.inputs(speed=3.0, ambient=15.0)
    _, estimate = estimator.step(estimator.cold_start(inputs), inputs, 0.1)
    print(f"{vehicle.title}: {vehicle.weight / 1e3:.1f} kN, {estimate.resistance_torque_nm:.1f} Nm at 3 m/s, belts cold")

thickness["value"] = 25.0  # mm instead of m
own.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
try:
    load(own)
except InputError as error:
    print(f"Refused: {error}")
else:
    raise SystemExit("a belt 25 m thick was accepted")
