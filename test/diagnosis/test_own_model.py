# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A model of the user's own: a function is diagnosed as a vehicle is."""

import io
import re
import runpy
from contextlib import redirect_stdout
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.diagnosis.base.own import OwnBase
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.torque_checks import check_torque
from trackres_ros.effects import Active, catalogue
from trackres_ros.errors import InputError

BLOCK = re.compile(r'^```python title="(\S+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
PARAMETERS = {"inertia": (5e-4, 3e-4, 7e-4, "kg m^2"), "drag": (1e-3, 0.0, 4e-3, "Nm s")}


def motor(inputs, p):
    return p["inertia"] * inputs.accel + p["drag"] * inputs.speed


def model(**changed):
    given_valuess = {"name": "motor", "torque": motor, "parameters": PARAMETERS, "max_speed": 200.0, "max_torque": 0.6}
    return tr.OwnModel(**{**given_valuess, **changed})


@pytest.fixture(scope="module")
def page(repository, tmp_path_factory):
    """The folder in which the blocks of the page were run, what they print, and the diagnosis they make."""
    folder, printed_text = tmp_path_factory.mktemp("page"), io.StringIO()
    with pytest.MonkeyPatch.context() as changed, redirect_stdout(printed_text):
        changed.chdir(folder)
        for title, text in BLOCK.findall((repository / "docs" / "own-model.md").read_text(encoding="utf-8")):
            (folder / title).write_text(text, encoding="utf-8")
            names = runpy.run_path(title)
    return SimpleNamespace(folder=folder, printed=printed_text.getvalue(), found=names["found"])


@pytest.fixture(scope="module")
def session(page):
    """The recording of the page on its grid."""
    return gate([tr.read(page.folder / "motor.csv")], model().known).sessions[0]


def test_the_blocks_of_the_page_name_the_friction(page):
    assert "The cause is coulomb_friction" in page.printed
    assert (page.folder / "report" / "report.html").is_file()
    written = yaml.safe_load((page.folder / "report" / "vehicle.yaml").read_text())
    assert written["effects"]["coulomb_friction"]["friction"]["value"] == pytest.approx(0.08, rel=0.05)
    low, high = written["parameters"]["inertia"]["range"]
    assert low < 4e-4 < high


def test_the_found_model_lacks_nothing(page):
    assert [f.grade for f in page.found.effects] == ["confirmed"]
    assert isinstance(page.found.vehicle, tr.OwnModel)
    assert "coulomb_friction" in {a.effect.name for a in page.found.vehicle.effects}
    assert tr.diagnose(page.folder / "motor.csv", page.found.vehicle, quick=True).status == "none"


def test_a_fit_finds_the_values_that_made_the_torque(session):
    base = OwnBase(model())
    made = replace(session, torque=motor(session, {"inertia": 6e-4, "drag": 2e-3}), torque_course=None)
    result = fit(Problem(base, (made,), (made.used,)))
    assert result.base_values == pytest.approx({"inertia": 6e-4, "drag": 2e-3}, rel=0.01)


def test_an_effect_adds_to_what_the_function_says(session):
    base = OwnBase(model())
    values = base.nominal
    friction = catalogue(size=base.facts.weight)["coulomb_friction"]
    plain, (rubs,) = base.predict([session], values, ()), base.predict([session], values, [Active(friction, {"friction": 0.1})])
    assert plain[0].torque == pytest.approx(motor(session, values), abs=1e-15)
    fast = np.abs(session.speed) > 5.0
    assert (rubs.torque - plain[0].torque)[fast] == pytest.approx(0.1 * np.sign(session.speed[fast]), rel=1e-9)


def test_a_parameter_without_a_range_is_held(session):
    base = OwnBase(model(parameters={**PARAMETERS, "drag": (1e-3, 1e-3, 1e-3, "Nm s")}))
    assert [q.name for q in base.parameters] == ["inertia"]
    (result,) = base.predict([session], {"inertia": 4e-4}, ())
    assert result.torque == pytest.approx(motor(session, {"inertia": 4e-4, "drag": 1e-3}), abs=1e-15)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"parameters": {"inertia": (1.0, 2.0, 3.0, "kg m^2")}}, "inertia"),
        ({"parameters": {"inertia": 3}}, "inertia"),
        ({"parameters": {"inertia": (2.0, 1.0, float("inf"), "kg m^2")}}, "inertia"),
        ({"parameters": [("inertia", 3)]}, "parameters"),
        ({"torque": 3}, "torque"),
        ({"max_speed": 0.0}, "max_speed"),
        ({"max_speed": "x"}, "max_speed"),
        ({"max_torque": float("nan")}, "max_torque"),
    ],
)
def test_a_model_that_cannot_be_is_refused(changed, said):
    with pytest.raises(InputError, match=said):
        model(**changed)


@pytest.mark.parametrize(
    ("torque", "said"),
    [
        (lambda inputs, p: p["mass"] * inputs.accel, "KeyError"),
        (lambda inputs, _: inputs.accel[1:], "shape"),
        (lambda inputs, _: np.nan * inputs.accel, "finite"),
        (lambda inputs, _: inputs.accel + 0j, "complex"),
        (lambda inputs, _: np.multiply(inputs.time, 0.0, out=inputs.time), "read-only"),
    ],
)
def test_a_function_that_fails_is_named(session, torque, said):
    base = OwnBase(model(torque=torque))
    with pytest.raises(InputError, match=said):
        base.predict([session], {}, ())


def test_a_function_that_changes_its_inputs_changes_no_result(session):
    def careless(inputs, p):
        torque = motor(inputs, p)
        inputs.speed[:], inputs.accel[:] = 0.0, 0.0
        p["drag"] = 0.0
        return torque

    friction = Active(catalogue(size=0.6)["coulomb_friction"], {"friction": 0.1})
    values = {"inertia": 4e-4, "drag": 1e-3}
    bases = (OwnBase(model(torque=torque)) for torque in (motor, careless))
    pure, other = ([item.torque for item in base.predict([session] * 2, values, [friction])] for base in bases)
    np.testing.assert_array_equal(pure, other)


def test_a_constant_model_is_compared_without_nan_if_not_zero(session):
    nothing, session = np.zeros(len(session)), replace(session, torque=np.abs(session.torque))
    with np.errstate(invalid="raise", divide="raise"):
        check_torque([session], [nothing + 0.125], [nothing], model().known)
        with pytest.raises(InputError, match="always 0"):
            check_torque([session], [nothing], [nothing], model().known)


@pytest.mark.parametrize("name", ["surroundings", "hysteresis", "thermal"])
def test_what_belongs_to_a_vehicle_file_is_refused(name):
    with pytest.raises(InputError, match="none with a model of your own"):
        load_base(model(), **{name: "lumped"})
