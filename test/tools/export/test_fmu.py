# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The FMU is valid, and FMPy drives it to the numbers of a replay; its state can be kept and its parameters tuned."""

import re
from dataclasses import replace

import numpy as np
import pytest
from built import EQUAL, difference, have

import trackres_ros as tr
from trackres_ros.estimator.columns import Reason
from trackres_ros.tools.export import fmu
from trackres_ros.tools.export.c_source import CSource
from trackres_ros.tools.export.parts import Parts

fmpy = pytest.importorskip("fmpy", reason="fmpy, which reads FMUs, is not installed")
validation = pytest.importorskip("fmpy.validation")
fmi3 = pytest.importorskip("fmpy.fmi3")
pytestmark = pytest.mark.skipif(not have("cc"), reason="no C compiler is installed")

STEP_S = 0.02


@pytest.fixture(scope="module")
def model(tmp_path_factory, good):
    folder = tmp_path_factory.mktemp("fmu")
    good("vehicle", "new", "mine", "--like", "agri3t", cwd=folder)
    text = re.sub("(name|axle): frame", r"\1: main-frame", (folder / "mine.yaml").read_text())
    effects = "effects:\n  drivetrain_drag: {drag: {value: 10.0, range: [5.0, 15.0]}}\n  air_drag: {share: 0.5}\n"
    effects += "  compound_temperature: {slope: 0.0}\n"
    (folder / "mine.yaml").write_text(text + effects)
    good("export", "fmu", "mine.yaml", "-o", "model.fmu", cwd=folder)
    return folder / "model.fmu"


def speeds(count):
    """A drive, one speed a step."""
    time = np.arange(count) * STEP_S
    return time, np.clip(2.0 * np.sin(time / 7.0) + 1.5, 0.0, None)


@pytest.fixture
def instance(model, tmp_path):
    """An instance after its initialization, with `get` and `put` by name."""
    description = fmpy.read_model_description(str(model))
    slave = fmi3.FMU3Slave(
        guid=description.guid, unzipDirectory=fmpy.extract(str(model), str(tmp_path)),
        modelIdentifier=description.coSimulation.modelIdentifier, instanceName="one",
    )  # fmt: skip
    number = {v.name: v.valueReference for v in description.modelVariables}
    slave.get = lambda name: slave.getFloat64([number[name]])[0]
    slave.put = lambda name, value: slave.setFloat64([number[name]], [value])
    slave.is_quantised = lambda: slave.getUInt32([number["reasons"]])[0] & Reason.SPEED_QUANTISED
    slave.instantiate()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    yield slave
    slave.terminate()
    slave.freeInstance()


def test_fmpy_finds_nothing_wrong(model):
    assert validation.validate_fmu(str(model)) == []
    description = fmpy.read_model_description(str(model))
    assert description.coSimulation.canGetAndSetFMUstate
    units = {v.name: v.unit for v in description.modelVariables}
    assert (units["inputs.speed_mps"], units["resistance_torque_nm"], units["belt_degc.left"]) == ("m/s", "N.m", "degC")
    assert "inputs.weight_n.main_frame" in units
    assert units["effects.compound_temperature.slope"] is None  # 1/K is not the unit 1
    tunable = {v.name: float(v.start) for v in description.modelVariables if v.variability == "tunable"}
    assert tunable["effects.drivetrain_drag.drag"] == 10.0
    assert tunable["bearing_friction"] == tr.load_vehicle(model.parent / "mine.yaml").chassis.bearing_friction


def test_fmpy_drives_it_to_the_numbers_of_a_replay(model):
    time, speed = speeds(1500)
    given_values = np.zeros(len(time), dtype=[("time", float), ("inputs.speed_mps", float), ("inputs.ambient_degc", float)])
    given_values["time"], given_values["inputs.speed_mps"], given_values["inputs.ambient_degc"] = time, speed, 12.0
    vehicle = tr.load_vehicle(model.parent / "mine.yaml")
    names = [name for name in tr.Estimator(vehicle).columns if name != "reasons"]
    shown = [name.replace("/", ".") for name in names]
    stop = (len(time) - 1) * STEP_S
    result = fmpy.simulate_fmu(
        str(model), input=given_values, stop_time=stop, output_interval=STEP_S, step_size=STEP_S, output=[*shown, "reasons"]
    )
    result_here = np.stack([result[name] for name in shown], axis=1)
    # A step takes the inputs of its beginning to its end: the first speed counts twice.
    lines = [f"{t:.6f},{v!r},12.0" for t, v in zip(time, [float(speed[0]), *speed.tolist()], strict=False)]
    (model.parent / "drive.csv").write_text("time_s,speed_mps,ambient_degc\n" + "\n".join(lines) + "\n")
    expectation = tr.replay(model.parent / "drive.csv", vehicle)
    assert difference(result_here, np.stack([expectation[name] for name in names], axis=1)).max() <= EQUAL
    assert (result["reasons"] == expectation["reasons"]).all()


def drive(slave, first, count):
    """Steps from the number `first` on; the torque of each."""
    torques = []
    _, speed = speeds(first + count)
    for i in range(first, first + count):
        slave.put("inputs.speed_mps", speed[i])
        slave.doStep(i * STEP_S, STEP_S)
        torques.append(slave.get("resistance_torque_nm"))
    return torques


def test_a_long_step_feeds_forward_what_short_steps_do(instance):
    instance.put("feedforward_rate", 2000.0)
    state, result = instance.getFMUState(), []
    for step in (STEP_S, 2.0):
        instance.setFMUState(state)
        for i in range(round(20.0 / step)):
            instance.put("inputs.speed_mps", min(3.0, (i + 1) * step))
            instance.doStep(i * step, step)
            assert not instance.is_quantised()
        result.append(instance.get("feedforward_torque_nm"))
    assert result[0] > 100.0
    assert result[1] == pytest.approx(result[0], rel=1e-3)
    instance.freeFMUState(state)


def test_a_call_moves_by_its_time_and_at_a_speed_by_20_ms_more(instance):
    rate, short = 1000.0, 0.005
    instance.put("feedforward_rate", rate)
    moves, result_before = [], 0.0
    for i in range(200):
        instance.put("inputs.speed_mps", 2.0 + 0.01 * i if i % 9 == 0 else np.nan)
        instance.doStep(i * short, short)
        moves.append(instance.get("feedforward_torque_nm") - result_before)
        result_before += moves[-1]
    at_speed = np.arange(200) % 9 == 0
    assert np.max(np.array(moves)[at_speed]) == pytest.approx(rate * (short + STEP_S))
    assert np.max(np.array(moves)[~at_speed]) == pytest.approx(rate * short)


@pytest.mark.parametrize("step", [0.0, -0.02, np.nan, np.inf, -np.inf, 604800.1, 1e300])
def test_a_step_that_is_no_time_changes_nothing(step, instance):
    drive(instance, 0, 100)
    state = instance.getFMUState()
    with pytest.raises(Exception, match="fmi3DoStep"):
        instance.doStep(100 * STEP_S, step)
    result_after = instance.getFMUState()
    assert bytes(instance.serializeFMUState(result_after)) == bytes(instance.serializeFMUState(state))
    instance.freeFMUState(state)
    instance.freeFMUState(result_after)


def test_a_state_that_was_kept_goes_on_as_before(instance):
    drive(instance, 0, 200)
    state = instance.getFMUState()
    packed = instance.serializeFMUState(state)
    once = drive(instance, 200, 100)
    instance.setFMUState(state)
    assert drive(instance, 200, 100) == once
    repetition = instance.deserializeFMUState(packed)
    instance.setFMUState(repetition)
    assert drive(instance, 200, 100) == once
    instance.freeFMUState(state)
    instance.freeFMUState(repetition)


def test_a_damaged_state_is_refused_whatever_byte_differs(instance):
    drive(instance, 0, 50)
    state = instance.getFMUState()
    packed = bytes(instance.serializeFMUState(state))
    for place in (*range(0, len(packed), 997), *range(len(packed) - 300, len(packed))):
        with pytest.raises(Exception, match="fmi3DeserializeFMUState"):
            instance.deserializeFMUState(packed[:place] + bytes([packed[place] ^ 1]) + packed[place + 1 :])
    instance.freeFMUState(state)


@pytest.mark.parametrize("name", ["drag_area", "air_density"])
def test_a_tuned_drag_is_that_of_effects_too(name, instance):
    drive(instance, 0, 100)
    state, result = instance.getFMUState(), []
    for factor in (1.0, 1.5):
        instance.setFMUState(state)
        instance.put(name, factor * instance.get(name))
        instance.doStep(100 * STEP_S, STEP_S)
        result.append([instance.get("wind_nm"), instance.get("effects_nm")])
    (wind, effects), (more_wind, more_effects) = result
    assert more_wind == pytest.approx(1.5 * wind)
    assert more_effects - effects == pytest.approx(0.5 * (more_wind - wind))  # which is its share
    instance.freeFMUState(state)


def test_a_tuned_parameter_moves_the_torque_by_what_it_says(instance):
    drive(instance, 0, 100)
    result_before = instance.get("resistance_torque_nm")
    state, std = instance.getFMUState(), instance.get("resistance_std_nm")
    instance.doStep(100 * STEP_S, STEP_S)
    plain = instance.get("resistance_torque_nm")
    instance.setFMUState(state)
    instance.put("effects.drivetrain_drag.drag", 25.0)
    instance.doStep(100 * STEP_S, STEP_S)
    assert instance.get("resistance_torque_nm") - plain == pytest.approx(15.0, rel=1e-6)
    assert instance.get("resistance_std_nm") == pytest.approx(std, rel=1e-2)
    assert result_before > 0.0
    instance.freeFMUState(state)


def test_outputs_are_known_before_the_initialization_ends(instance):
    instance.reset()
    instance.enterInitializationMode()
    for speed in (0.0, 2.0):
        instance.put("inputs.speed_mps", speed)
        early = [instance.get(name) for name in ("belt_degc.left", "resistance_torque_nm")]
    instance.exitInitializationMode()
    assert early == [instance.get("belt_degc.left"), instance.get("resistance_torque_nm")]
    assert early[0] == instance.get("nominal_ambient")
    assert early[1] > 0.0


def test_an_output_cannot_be_set_and_an_input_may_be_unknown(instance):
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        instance.put("resistance_torque_nm", 1.0)
    instance.put("inputs.weight_n", np.nan)


def tunable(model):
    """Each tunable parameter with its lowest and highest value."""
    known = [v for v in fmpy.read_model_description(str(model)).modelVariables if v.variability == "tunable"]
    return {v.name: (float(v.min), float(v.max)) for v in known}


def test_a_parameter_takes_values_from_its_min_to_its_max_only(model, instance):
    assert len(tunable(model)) == 10
    for name, (low, high) in tunable(model).items():
        assert low <= instance.get(name) <= high
        for value in (low, high):
            instance.put(name, value)
        for value in (np.nextafter(low, -np.inf), np.nextafter(high, np.inf), np.nan, np.inf, -np.inf):
            with pytest.raises(Exception, match="fmi3SetFloat64"):
                instance.put(name, value)
        assert instance.get(name) == high


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("over", [{"inputs.speed_mps": 0.0}, {"inputs.enable": 0.0}])
def test_no_parameter_pushes_while_standing_or_disabled(over, end, model, instance):
    for name, limits in tunable(model).items():
        instance.put(name, limits[end])
    drive(instance, 0, 200)
    assert abs(instance.get("feedforward_torque_nm")) > 1.0
    for name, value in over.items():
        instance.put(name, value)
    for i in range(200, 260):
        instance.doStep(i * STEP_S, STEP_S)
    assert instance.get("feedforward_torque_nm") == 0.0


@pytest.mark.parametrize(
    ("name", "least", "changed"),
    [("ztbus_hess19", 0.001, {"rolling_coefficient": 0.002, "rolling_rise": -0.001 / 25.0, "max_speed": 25.0}),
     ("emps", 0.0, {"viscous_friction": 1e7})],
)  # fmt: skip
def test_limits_are_those_of_the_vehicle_file(name, least, changed):
    vehicle = tr.load_vehicle(name)
    estimator = tr.Estimator(replace(vehicle, values={**vehicle.values, **changed}))
    variables = [v for v in fmu._variables(CSource(Parts(estimator), "", ())) if v.limits]
    assert all(v.limits[0] <= v.start <= v.limits[1] for v in variables)
    assert variables[0].limits[0] == pytest.approx(least, rel=1e-4)  # of the rolling resistance, as the vehicle reaches 25 m/s
