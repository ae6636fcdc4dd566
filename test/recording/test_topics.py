# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The topics file: accepted and refused keys, texts, and guesses without one."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import FieldStep, TopicBinding, Topics, field_steps
from trackres_ros.recording.channel_file import Channel
from trackres_ros.recording.guessing import guess, guess_channels
from trackres_ros.recording.roles import ROLES, UNITS, conversion
from trackres_ros.units import GRAVITY

SPEED = {"topic": "/vehicle/speed", "type": "geometry_msgs/msg/TwistStamped", "field": "twist.linear.x"}


def load(folder: Path, text: str) -> Topics:
    path = folder / "topics.yaml"
    path.write_text(text, encoding="utf-8")
    return Topics.load(path)


def test_one_line_a_role(tmp_path: Path) -> None:
    topics = load(
        tmp_path,
        """
speed: {topic: /vehicle/speed, type: geometry_msgs/TwistStamped, field: twist.linear.x, scale: 1e-3, offset: 2}
load/front: {topic: /axle, type: std_msgs/msg/Float64, field: data, stamp: log, max_age_s: 0.5}
belt/rear_left: {topic: /belt, type: sensor_msgs/msg/Temperature, field: temperature, sensor: mean, std_k: 1.5}
torque: {column: "Torque [kNm]", scale: 1000}
""",
    )
    assert list(topics) == ["speed", "load/front", "belt/rear_left", "torque"]
    assert topics["speed"] == TopicBinding(
        "/vehicle/speed", "geometry_msgs/msg/TwistStamped", "twist.linear.x", scale=1e-3, offset=2.0, converts=True
    )
    assert topics["load/front"].stamp == "log"
    assert topics["load/front"].max_age_s == 0.5
    assert (topics["belt/rear_left"].sensor, topics["belt/rear_left"].std_k) == ("mean", 1.5)
    assert topics["torque"].column == "Torque [kNm]"
    assert "speed" in topics


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sped: {column: a}", ["sped", "did you mean speed?"]),
        ("speed/left: {column: a}", ["speed/left", "load, torque, belt, wheel_speed"]),
        ("load/: {column: a}", ["load/", "load/NAME"]),
        ("speed: {colum: a}", ["speed: colum", "did you mean column?"]),
        ("speed: {column: a, scale: 0}", ["speed: scale", "not 0"]),
        ("speed: {column: a, scale: .nan}", ["speed: scale", "nan", "finite"]),
        ("speed: {column: a, offset: .inf}", ["speed: offset", "inf"]),
        ("speed: {column: a, scale: yes}", ["speed: scale", "True"]),
        ("speed: {column: a, scale: '2'}", ["speed: scale", "'2'"]),
        ("speed: {column: a, topic: /b}", ["speed: key", "either column"]),
        ("speed: {column: a, sensor: mean}", ["sensor", "only for belt"]),
        ("speed: {column: ''}", ["speed: column", "not empty"]),
        ("speed: {topic: /a, field: data}", ["speed", "no type"]),
        ("speed: {topic: /a, type: Float64, field: data}", ["speed: type", "Float64", "package/msg/Name"]),
        ("speed: {topic: /a, type: std_msgs/msg/Float64, field: data.}", ["speed: field", "data.", "twist.linear.x"]),
        ("speed: {topic: /a, type: std_msgs/msg/Float64, field: data, stamp: heade}", ["stamp", "did you mean header?"]),
        ("speed: {topic: /a, type: std_msgs/msg/Float64, field: data, max_age_s: 0}", ["max_age_s", "positive"]),
        ("speed: {column: v, delay_s: 0.1}", ["delay_s", "only for torque"]),
        ("torque: {column: m, delay_s: -0.1}", ["delay_s", "0 to 10"]),
        ("belt: {column: a, std_k: -1}", ["belt: std_k", "positive"]),
        ("speed: {column: a, derivative: true, unit: km/h}", ["speed: unit", "km/h", "m, km, cm"]),
        ("speed: {column: a, unit: deg}", ["speed: unit", "deg", "m/s, km/h, mph"]),
        ("latitude: {column: a, unit: gon}", ["latitude: unit", "gon", "rad, deg"]),
        ("load: {column: a, kg_each: 70}", ["kg_each only for passengers"]),
        ("passengers: {column: a, kg_each: 0}", ["passengers: kg_each", "1"]),
        ("brake: {column: a, threshold: -1}", ["brake: threshold", "a positive number"]),
        ("time: {topic: /clock}", ["time", "column, and if need be unit, scale"]),
        ("time: {column: a, scale: -1}", ["time: scale", "positive"]),
        ("{position: {topic: /gps}, latitude: {column: a}}", ["position and latitude", "either"]),
        ("position: {column: a}", ["position", "column", "latitude and longitude"]),
        ("position: {topic: /gps, scale: 2.0}", ["position", "scale"]),
        ("position: /gps", ["position", "/gps", "topic: /fix"]),
        ("position: {type: sensor_msgs/msg/NavSatFix}", ["position", "no topic"]),
        ("positon: {topic: /gps}", ["positon", "position"]),
        ("speed: 3", ["speed", "a mapping"]),
        ("[speed]", ["a mapping with one line per role"]),
        ("", ["a mapping with one line per role"]),
        ("speed: {column: a", ["YAML"]),
        ("speed: {column: a}\nspeed: {column: b}", ["given twice: speed"]),
        ("speed: {column: a, column: b}", ["given twice: column"]),
    ],
)
def test_refused_with_file_role_key_and_what_is_allowed(tmp_path: Path, text: str, says: list[str]) -> None:
    with pytest.raises(InputError) as error_info:
        load(tmp_path, text)
    for part in [str(tmp_path / "topics.yaml"), *says]:
        assert part in str(error_info.value)
    assert "\n" not in str(error_info.value)


def test_field_paths() -> None:
    assert field_steps("twist.linear.x") == (FieldStep("twist"), FieldStep("linear"), FieldStep("x"))
    assert field_steps("effort[left.motor 1]") == (FieldStep("effort", element="left.motor 1"),)
    assert field_steps("a.data[3].b") == (FieldStep("a"), FieldStep("data", index=3), FieldStep("b"))
    for path in ("", ".a", "a.", "a..b", "a[", "a[]", "a[1]b", "1a", "a b"):
        with pytest.raises(ValueError, match="no field path"):
            field_steps(path)


def test_a_binding_reads_a_message() -> None:
    joints = SimpleNamespace(name=["a", "b"], effort=[1.0, 2.0])
    binding = TopicBinding("/t", "sensor_msgs/msg/JointState", "effort[b]", scale=3.0, offset=1.0)
    assert binding.read(joints) == 7.0
    for field, reason in (("effort[c]", "its names are a, b"), ("effort[2]", "the array effort has only 2 elements")):
        with pytest.raises(LookupError, match=reason):
            TopicBinding("/t", "sensor_msgs/msg/JointState", field).read(joints)
    assert TopicBinding("/t", "x/msg/Y", "effort[0]").read(joints) == 1.0
    nested = SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=4)))
    assert TopicBinding(**SPEED).read(nested) == 4.0


def test_guess_prefers_types_and_names_the_rest() -> None:
    topics, text = guess(
        {
            "/odom": "nav_msgs/msg/Odometry",
            "/robot/odom_filtered": "nav_msgs/msg/Odometry",
            "/cmd_vel": "geometry_msgs/msg/TwistStamped",
            "/twist": "geometry_msgs/msg/TwistStamped",
            "/chassis/load_kn": "std_msgs/msg/Float64",
            "/payload": "std_msgs/msg/Float64",
            "/drive/torque": "std_msgs/msg/Float64",
            "/feedforward_torque": "std_msgs/msg/Float64",
            "/track/ambient_temperature": "sensor_msgs/msg/Temperature",
            "/track/temperature": "sensor_msgs/msg/Temperature",
            "/imu": "sensor_msgs/msg/Imu",
            "/image": "sensor_msgs/msg/Image",
        }
    )
    assert {role: (topics[role].topic, topics[role].field, topics[role].scale) for role in topics} == {
        "speed": ("/odom", "twist.twist.linear.x", 1.0),
        "load": ("/chassis/load_kn", "data", 1000.0),
        "torque": ("/drive/torque", "data", 1.0),
        "ambient": ("/track/ambient_temperature", "temperature", 1.0),
        "belt": ("/track/temperature", "temperature", 1.0),
        "yaw_rate": ("/imu", "angular_velocity.z", 1.0),
        "specific_force": ("/imu", "linear_acceleration.x", 1.0),
    }
    assert text[0] == (
        "speed: guessed from /odom (nav_msgs/msg/Odometry, twist.twist.linear.x) in m/s; "
        "also possible: /robot/odom_filtered, /twist"
    )
    assert not any(sentence.startswith("accel") or "cmd_vel" in sentence for sentence in text)


NUMBER = "std_msgs/msg/Float64"
NAMES = {"speed": "speed", "load": "weight", "torque": "torque", "brake": "brake_pressure"}
IN_NAMES = [*(one for units in UNITS.values() for one in units if len(one) > 1 and one != "ms"), "percent"]


def guessed(role: str, topic: str) -> TopicBinding | None:
    """The binding of a role in a bag with one bare number."""
    try:
        return guess({topic: NUMBER} | ({} if role == "speed" else {"/odom": "nav_msgs/msg/Odometry"}))[0].bindings.get(role)
    except InputError:  # without a speed
        return None


@pytest.mark.parametrize("role", NAMES)
@pytest.mark.parametrize("unit", IN_NAMES)
def test_a_unit_in_a_name_is_used_or_forbids_the_guess(role: str, unit: str) -> None:
    topic, known = f"/vehicle/{NAMES[role]}_{re.sub('[ /]', '_', unit)}", conversion(unit, ROLES[role].unit)
    of_file = guess_channels([Channel(topic, "")], ()).bindings.get(role)
    assert [item and (item.scale, item.offset) for item in (guessed(role, topic), of_file)] == [known, known]


LETTERS = [("load", "weight_t", 1e3 * GRAVITY), ("load", "weight_f", 1.0), ("speed", "speed_ms", 1.0), ("speed", "speed_m", 1.0)]


@pytest.mark.parametrize(("role", "topic", "scale"), [*LETTERS, ("load", "load_kn_raw", 1e3)])
def test_one_letter_is_a_unit_only_of_its_own_role(role: str, topic: str, scale: float) -> None:
    result = guessed(role, f"/{topic}")
    assert result is not None
    assert result.scale == scale


OF_PARTS = ["drive/{}/torque", "torque_{}", "Trq_{}", "axle/{}/load", "load_{}_kn"]


@pytest.mark.parametrize("named", OF_PARTS)
@pytest.mark.parametrize(
    "parts", [("left", "right"), ("L", "R"), ("front", "rear"), ("FL", "FR", "RL", "RR"), ("axle1", "axle2")]
)
def test_a_part_of_a_torque_or_load_is_not_guessed(named: str, parts: tuple[str, ...]) -> None:
    role, unit = ("load", "kN") if "load" in named else ("torque", "Nm")
    names = [named.format(part) for part in parts]
    for there in (names, names[:1]):
        topics, notes = guess({"/speed": SPEED["type"], **{f"/{name}": NUMBER for name in there}})
        assert set(topics) == {"speed"}
        line = yaml.safe_load(next(note for note in notes if note.startswith(role)).rpartition("topics file: ")[2])
        assert len(Topics.parse(line).bindings[role].sources) == len(there)
        result = guess_channels([Channel(name, unit) for name in there], ())
        assert (result.bindings, [item.column for item in result.parts[role]]) == ({}, there)
    total = guess_channels([Channel(name, unit) for name in (*names, role)], ())
    assert (total.bindings[role].column, total.alternatives[role], total.parts) == (role, [], {})


TORQUES = ("torque_nm", "torque_knm", "drive/torque", "chassis/torque_nm")


@settings(max_examples=30)
@given(
    vehicles=st.lists(st.sampled_from(["truck1", "truck2", "rover", "fleet/a", "fleet/b"]), min_size=1, max_size=3, unique=True),
    torques=st.permutations(TORQUES),
    speed=st.sampled_from(["speed", "base/odom"]),
)
def test_all_guesses_are_of_one_vehicle(vehicles: list[str], torques: list[str], speed: str) -> None:
    number, kind = "std_msgs/msg/Float64", SPEED["type"]
    vehicles = [vehicle for vehicle in vehicles if len(vehicle.split("/")) == len(vehicles[0].split("/"))]
    bag = {f"/{vehicle}/{speed}": kind for vehicle in vehicles} | {
        f"/{vehicle}/{name}": number for vehicle, torque in zip(vehicles, torques, strict=False) for name in (torque, "load_kn")
    }
    topics, _ = guess(bag)
    of_vehicle = topics["speed"].topic.removesuffix(speed)
    assert set(topics) == {"speed", "torque", "load"}
    assert all(topics[role].topic.startswith(of_vehicle) for role in topics)


WANTED = ("TrqReq", "torque_request", "requested_torque", "DrvTrqDmd", "torque_demand", "demandedTorque", "TrqSoll", "cmd/torque")
OF_A_PART = ("EngTrq", "MotTrq", "eMotTrq", "emot1_torque", "engine/torque", "ENG_TRQ", "vehicle/mot/torque", "BrakeTorque",
             "BremsTrq", "SteeringTorque", "RetarderTrq")  # fmt: skip
RIGHT = ("torque", "DrvTrq", "TrqSprocket", "drive/torque", "torque_frequency_domain", "trq_engaged", "TrqMotion")
OF_LOAD = ("PayloadWeight", "pay_load", "Cargo_load", "CargoWeight", "TrailerWeight", "EmptyWeight", "tare/weight", "EngLoad")
OF_AIR = ("AirInletTemp", "EngIntakeAirTemp", "charge_air_temperature", "cabin/air_temperature", "CargoAmbientTemperature",
          "air_conditioner/air_temp", "AirConditionTemp", "AcAirTemp", "AmbientConditions/RoadSurfaceTemp")  # fmt: skip
WRONG = [
    *(("torque", one) for one in (*WANTED, *OF_A_PART)),
    *(("load", one) for one in OF_LOAD),
    *(("ambient", one) for one in OF_AIR),
]
RIGHT_OF = {
    "torque": RIGHT,
    "load": ("load", "GrossVehicleWeight", "weight_total", "CombinationVehicleWeight/PoweredVehicleWeight"),
    "ambient": (
        "AmbientAirTemperature",
        "air_temp",
        "AmbientConditions/AmbientAirTemp",
        "weather_conditions/outside_temperature",
        "j1939/ambient_conditions/ambient_air_temperature",
        "cab/outside_temperature",
        "CabOutsideTemp",
    ),
}


@pytest.mark.parametrize(("role", "wrong"), WRONG)
def test_nothing_wanted_or_of_another_part_is_guessed(role: str, wrong: str) -> None:
    for right in (None, *RIGHT_OF[role]):
        names = [wrong, *([right] if right else [])]
        by_unit, *_ = guess_channels([Channel(name, ROLES[role].unit) for name in names], ())
        kind = "sensor_msgs/msg/Temperature" if role == "ambient" else NUMBER
        by_type, _ = guess({"/speed": SPEED["type"], **{f"/{name}": kind for name in names}})
        assert (by_unit[role].column if role in by_unit else None) == right
        assert (by_type[role].topic if role in by_type else None) == (right and f"/{right}")


J1939 = {
    "km/h": "WheelBasedVehicleSpeed CruiseControlSetSpeed AdaptiveCruiseControlSetSpeed SpeedOfForwardVehicle FrontAxleSpeed "
    "RelativeSpeedFrontAxleLeftWheel MaximumVehicleSpeedLimit CruiseControlHighSetLimitSpeed",
    "rpm": "EngineSpeed TransmissionOutputShaftSpeed TachographOutputShaftSpeed EnginesDesiredOperatingSpeed",
    "Nm": "EngineReferenceTorque ReferenceRetarderTorque EngineMaximumContinuousTorque",
    "%": "ActualEnginePercentTorque EnginePercentLoadAtCurrentSpeed ActualRetarderPercentTorque BrakePedalPosition",
    "kg": "AxleWeight TrailerWeight CargoWeight PoweredVehicleWeight GrossCombinationVehicleWeight",
    "deg C": "CabInteriorTemperature AmbientAirTemperature AirInletTemperature EngineAirInletTemperature CargoAmbientTemperature "
    "EngineIntakeManifold1AirTemperature EngineChargeAirCoolerOutletTemperature EngineTurbocharger1CompressorIntakeTemperature "
    "RoadSurfaceTemperature TireTemperature EngineExhaustGasTemperature TransmissionOilTemperature1",
    "kPa": "ServiceBrakeCircuit1AirPressure BrakePrimaryPressure ParkingAndOrTrailerAirPressure BarometricPressure",
    "m": "HighResolutionTotalVehicleDistance DistanceToForwardVehicle Altitude",
    "rad": "SteeringWheelAngle",
    "rad/s": "YawRate",
    "m/s2": "LateralAcceleration LongitudinalAcceleration",
}
"""Names of SAE J1939-71, by unit."""
OF_J1939 = {
    "speed": "WheelBasedVehicleSpeed", "load": "PoweredVehicleWeight", "ambient": "AmbientAirTemperature", "yaw_rate": "YawRate",
    "altitude": "Altitude",
}  # fmt: skip
GROUPS = {
    "CruiseControlVehicleSpeed1": "WheelBasedVehicleSpeed CruiseControlSetSpeed",
    "CruiseControlVehicleSpeedSetup": "MaximumVehicleSpeedLimit CruiseControlHighSetLimitSpeed",
    "AdaptiveCruiseControl1": "AdaptiveCruiseControlSetSpeed SpeedOfForwardVehicle DistanceToForwardVehicle",
    "AmbientConditions": "CabInteriorTemperature AmbientAirTemperature AirInletTemperature RoadSurfaceTemperature "
    "BarometricPressure",
    "CombinationVehicleWeight": "PoweredVehicleWeight GrossCombinationVehicleWeight",
    "VehicleWeight": "AxleWeight TrailerWeight CargoWeight",
}
"""Names by their group."""


@pytest.mark.parametrize("mark", ["", ".", "/"])
@pytest.mark.parametrize("missing", [None, *OF_J1939])
def test_of_a_truck_bus_only_the_right_signals_are_guessed(missing: str | None, mark: str) -> None:
    """With and without their groups."""
    grouped = {name: f"{group}{mark}{name}" for group, names in GROUPS.items() for name in names.split() if mark}
    wanted = OF_J1939 | ({missing: {"speed": "FrontAxleSpeed"}.get(missing)} if missing else {})
    there = [(name, unit) for unit, names in J1939.items() for name in names.split() if not missing or name != OF_J1939[missing]]
    result, others, _ = guess_channels([Channel(grouped.get(name, name), unit) for name, unit in there], ())
    assert {role: value.column for role, value in result.items()} == {
        role: grouped.get(name, name) for role, name in wanted.items() if name
    }
    assert {role: [one.column for one in options] for role, options in others.items() if options} == (
        {} if missing == "speed" else {"speed": ["FrontAxleSpeed"]}
    )


BETTER = ["torque_measured", "ActualDriveTorque", "DrvTrqAct", "TrqIst"]
TEMPERATURE = "sensor_msgs/msg/Temperature"


@pytest.mark.parametrize(
    ("role", "unit", "kind", "better", "other"),
    [*(("torque", "Nm", NUMBER, *pair) for pair in product(BETTER, RIGHT)), ("ambient", "degC", TEMPERATURE, "ambient", "air")],
)
def test_a_measured_torque_and_an_ambient_air_are_preferred(role: str, unit: str, kind: str, better: str, other: str) -> None:
    by_unit, others, _ = guess_channels([Channel(name, unit) for name in (other, better)], ())
    by_type, _ = guess({"/speed": SPEED["type"], f"/{other}": kind, f"/{better}": kind})
    assert (by_unit[role].column, [one.column for one in others[role]], by_type[role].topic) == (better, [other], f"/{better}")


@pytest.mark.parametrize("name", [
    "VehicleSpeed", "VehSpd_Eng", "mot/vehicle_speed", "speed_actual", "emotion/speed", "VehSpd_CruiseCtrl",
    "CruiseControlVehicleSpeed", "cruise_control/vehicle_speed_kmh", "VehicleSpeedRelativeToGround",
    "j1939/cruise_control_vehicle_speed/wheel_based_vehicle_speed_kmh", "VehicleSpeedKph", "velocity_km_h",
])  # fmt: skip
def test_the_speed_of_the_vehicle_is_guessed_from_any_unit(name: str) -> None:
    assert guess_channels([Channel(name, "km/h")], ())[0]["speed"].column == name
    topics, (text,) = guess({f"/{name}": NUMBER})
    assert topics["speed"].topic == f"/{name}"
    of_kmh = name.endswith(("kmh", "Kph", "km_h"))
    assert ("in km/h" in text, topics["speed"].scale) == (of_kmh, 1 / 3.6 if of_kmh else 1.0)


def test_a_second_speed_alone_is_no_second_vehicle() -> None:
    odometry, imu = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
    topics, _ = guess({"/wheel/odom": odometry, "/visual/odom": odometry, "/wheel/imu_raw": imu, "/imu": imu})
    assert (topics["speed"].topic, topics["yaw_rate"].topic) == ("/wheel/odom", "/imu")


@pytest.mark.parametrize(
    "wrong",
    ["engine_speed_rpm", "cruise_set_vehicle_speed", "cruise_control/speed", "cruise_control_vehicle_speed/cruise_speed",
     "cruise_control_vehicle_speed/brake_switch"],
)  # fmt: skip
def test_nothing_tells_the_speed(wrong: str) -> None:
    number = "std_msgs/msg/Float64"
    with pytest.raises(InputError) as error_info:
        guess({"/cmd_vel": "geometry_msgs/msg/TwistStamped", f"/{wrong}": number, "/imu": "sensor_msgs/msg/Imu"})
    for part in ("/cmd_vel (geometry_msgs/msg/TwistStamped)", f"/{wrong}", "/imu (sensor_msgs/msg/Imu)", "topics file"):
        assert part in str(error_info.value)
