"""The catalogue: what each effect declares, and laws that all obey."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from click.testing import CliRunner

from trackres_ros.cli.main import cli
from trackres_ros.effects import Active, Conditions, Terms, catalogue, check_effects, together
from trackres_ros.effects.effect import ACTS_ON, BELONGS_TO, REFERENCE_NM
from trackres_ros.effects.facts import facts_of
from trackres_ros.errors import InputError
from trackres_ros.vehicle import load

NAMES = [
    "grade", "grade_profile", "turning_scrub", "cornering", "rotating_inertia", "drivetrain_efficiency", "drivetrain_drag",
    "viscous_bearing", "stribeck", "headwind", "air_drag", "payne", "mullins", "frequency", "compound_temperature",
    "core_surface", "convection", "ground_conduction", "still_air", "solar", "rain", "tension_torque", "lug_friction",
    "roadwheel_tyres", "soft_ground", "vibration", "warmup", "torque_offset", "torque_gain", "speed_scale", "delay",
]  # fmt: skip
BOTH_WAYS = ("grade", "grade_profile", "headwind", "rotating_inertia")
OF_SURROUNDINGS = {"grade", "grade_profile", "headwind", "rain", "soft_ground", "solar"}
OF_SENSORS = {"delay", "speed_scale", "torque_gain", "torque_offset"}
CATALOGUE = catalogue()


def conditions(**changed):
    known = {"speed": 5.0, "accel": 0.2, "weight": 250e3, "ambient": 10.0, "yaw_rate": 0.1, "heading": 0.5, "distance": 900.0}
    return Conditions(facts_of(load("xgd24d")), **{**known, "drive_torque": 3000.0, "own": 12.0, **changed})


def same(a, b):
    names = [f.name for f in fields(Terms) if f.name != "sink" or a.conductance or b.conductance]
    return all(np.allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=1e-9) for name in names)


def test_the_catalogue_holds_what_was_agreed():
    assert sorted(CATALOGUE) == sorted(NAMES)


def test_each_effect_says_what_it_belongs_to():
    by_kind = {kind: {n for n, e in CATALOGUE.items() if e.belongs_to == kind} for kind in BELONGS_TO}
    assert by_kind["surroundings"] == OF_SURROUNDINGS
    assert by_kind["sensor"] == OF_SENSORS == {n for n, e in CATALOGUE.items() if e.acts_on == "sensor"}
    assert by_kind["vehicle"] == set(NAMES) - OF_SURROUNDINGS - OF_SENSORS
    assert {e.belongs_to for e in CATALOGUE.values() if vars(type(e)).get("belongs_to") is None} == set()


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_that_is_off_does_nothing(name):
    effect = CATALOGUE[name]
    assert same(effect.terms(conditions(), effect.values(off=True)), Terms())


@pytest.mark.parametrize("name", NAMES)
def test_a_typical_effect_does_what_it_says_it_acts_on(name):
    effect = CATALOGUE[name]
    # Away from the points where an effect is nothing by its definition.
    at = conditions(weight=310e3, speed=0.4 if name == "still_air" else 7.0)
    terms = effect.terms(at, effect.values())
    changed = {f.name for f in fields(Terms) if not np.allclose(getattr(terms, f.name), getattr(Terms(), f.name), rtol=1e-12)}
    by_action = {
        "torque": {"torque", "drive_gain"},
        "heat": {"loss_factor", "softening"},
        "cooling": {"film_offset_factor", "film_slope_factor", "conductance", "sink", "heat", "inner_resistance"},
        "sensor": {"speed_factor", "sensor_gain", "sensor_offset", "sensor_delay"},
    }
    assert effect.acts_on in ACTS_ON
    assert changed
    assert changed <= by_action[effect.acts_on]


@pytest.mark.parametrize("name", NAMES)
def test_a_series_is_as_good_as_one_number_after_the_other(name):
    effect = CATALOGUE[name]
    speeds = np.array([-3.0, 0.0, 0.2, 6.0, 13.0])
    whole = effect.terms(conditions(speed=speeds), effect.values())
    for i, speed in enumerate(speeds):
        one = effect.terms(conditions(speed=float(speed)), effect.values())
        for f in fields(Terms):
            assert np.broadcast_to(getattr(whole, f.name), speeds.shape)[i] == pytest.approx(
                float(getattr(one, f.name)), rel=1e-12
            )


@pytest.mark.parametrize(
    "name",
    [
        n
        for n in NAMES
        if CATALOGUE[n].acts_on == "torque" and n not in ("grade", "grade_profile", "headwind", "rotating_inertia")
    ],
)
def test_friction_turns_with_the_direction_and_vanishes_at_rest(name):
    effect = CATALOGUE[name]
    forward, back = (effect.terms(conditions(speed=v, drive_torque=np.sign(v) * 3000.0), effect.values()) for v in (4.0, -4.0))
    still = effect.terms(conditions(speed=0.0), effect.values())
    assert float(forward.torque) == pytest.approx(-float(back.torque), rel=1e-9)
    assert float(still.torque) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("strain", [0.1, 1.0, 10.0])
def test_a_loss_that_depends_on_strain_is_positive_and_as_steep_as_its_peak(strain):
    payne, nominal = CATALOGUE["payne"], conditions().facts.weight
    shares = np.linspace(0.5, 1.5, 21)
    loss = payne.terms(conditions(weight=nominal * shares), {"height": 10.0, "strain": strain}).loss_factor
    assert loss[10] == pytest.approx(1.0, abs=1e-15)
    assert np.all(loss > 0.0)
    # Kraus' peak goes as strain^(+-p) far from itself, and strain as load^(2/3); the loss beside the peak holds it back.
    slope = np.diff(np.log(loss)) / np.diff(np.log(shares))
    assert np.all(np.abs(slope) < 2.0 * payne.EXPONENT / 3.0)
    # Known of filled rubber: a fifth to a third of the hysteresis over the loads driven.
    assert (np.ptp(loss) > 0.2) == (strain != 1.0)


def test_terms_add_and_multiply_and_two_sinks_are_one_between_them():
    both = together(
        [
            Terms(torque=2.0, loss_factor=1.1, conductance=10.0, sink=0.0),
            Terms(torque=3.0, loss_factor=2.0, conductance=30.0, sink=40.0),
        ]
    )
    assert (both.torque, both.loss_factor, float(both.conductance), float(both.sink)) == pytest.approx((5.0, 2.2, 40.0, 30.0))


def test_values_of_a_vehicle_file_are_checked():
    good = {"warmup": {"torque": 100.0, "time_constant": 200.0, "cooling": 5000.0}}
    (active,) = check_effects(good, "vehicle.yaml: effects", CATALOGUE, "vehicle")
    assert isinstance(active, Active)
    assert not active.ranges
    for bad, said in (
        ({"warmpu": {}}, "did you mean warmup"),
        ({"warmup": {"torque": 1.0}}, "time_constant"),
        ({"warmup": {**good["warmup"], "torque": -1.0}}, "0 to 2500 Nm"),
        ([], "a mapping"),
        (with_torque({"value": 100.0}), "range: "),
        (with_torque({"value": 100.0, "range": 50.0}), "two numbers"),
        (with_torque({"value": 100.0, "range": [150.0, 50.0]}), "low <= high"),
        (with_torque({"value": 100.0, "range": [110.0, 150.0]}), "from 110 to 150 Nm"),
        (with_torque({"value": 100.0, "range": [50.0, 9e9]}), "from 0 to 2500 Nm"),
        (with_torque({"value": float("nan"), "range": [50.0, 150.0]}), "from 50 to 150 Nm"),
    ):
        with pytest.raises(InputError, match=said):
            check_effects(bad, "vehicle.yaml: effects", CATALOGUE, "vehicle")


def with_torque(given):
    return {"warmup": {"torque": given, "time_constant": 200.0, "cooling": 5000.0}}


def test_a_range_goes_with_its_value():
    (active,) = check_effects(with_torque({"value": 100.0, "range": [60.0, 140.0]}), "effects", CATALOGUE, "vehicle")
    assert active.values["torque"] == 100.0
    assert active.ranges == {"torque": (60.0, 140.0)}
    (moved,) = active.shifted()
    assert moved.values == {**active.values, "torque": 120.0}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("place", ["vehicle", "surroundings"])
def test_what_belongs_elsewhere_is_refused_with_where_it_goes(name, place):
    effect = CATALOGUE[name]
    if effect.belongs_to == place:
        assert check_effects({name: effect.values()}, "file", CATALOGUE, place)
        return
    remedy = {"vehicle": "vehicle file", "surroundings": "--surroundings", "sensor": "topics file"}[effect.belongs_to]
    with pytest.raises(InputError, match=remedy):
        check_effects({name: effect.values()}, "file", CATALOGUE, place)


def test_what_is_typical_grows_with_the_vehicle():
    whole, half = (catalogue(size=size)["warmup"].parameters[0] for size in (REFERENCE_NM, 0.5 * REFERENCE_NM))
    assert (half.low, half.start, half.high) == (0.5 * whole.low, 0.5 * whole.start, 0.5 * whole.high)
    assert catalogue(size=REFERENCE_NM)["warmup"].values() == CATALOGUE["warmup"].values()
    on_tyres = catalogue(size=4600.0, on_tyres=True)["roadwheel_tyres"].parameters[0]
    assert on_tyres.start == pytest.approx(46.0)
    assert catalogue(size=0.5 * REFERENCE_NM)["headwind"].parameters == CATALOGUE["headwind"].parameters


def test_an_effect_of_the_users_own_joins_the_catalogue(tmp_path, squeak):
    (tmp_path / "squeak.py").write_text(squeak)
    assert set(catalogue(tmp_path)) == {*NAMES, "squeak"}
    (tmp_path / "again.py").write_text(squeak.replace('"squeak"', '"grade"'))
    with pytest.raises(InputError, match="no other effect"):
        catalogue(tmp_path)
    with pytest.raises(InputError, match="Python files"):
        catalogue(tmp_path / "nowhere")
    assert catalogue(files=[tmp_path / "squeak.py"])["squeak"].source == tmp_path / "squeak.py"


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ('    belongs_to = "vehicle"\n', "", "vehicle, surroundings, sensor"),
        ('"vehicle"', '"driver"', "vehicle, surroundings, sensor"),
        ('"vehicle"', '"sensor"', "both sensor, or neither"),
        ("0.0, 100.0, 10.0", "0.0, float('inf'), 10.0", "finite"),
        ("off=0.0", "off=None", "without effect"),
        ('"squeak"', "7", "two texts"),
        ("(Parameter", "[(Parameter", "SyntaxError"),
        ('parameters = (Parameter("torque", "Nm", 0.0, 100.0, 10.0, "of it", off=0.0),)', "parameters = (1,)", "Parameter"),
        ("class Squeak", "raise SystemExit(0)\n\nclass Squeak", "SystemExit"),
    ],
)
def test_an_effect_of_the_users_own_that_is_not_right_is_refused(tmp_path, squeak, was, becomes, said):
    assert was in squeak
    (tmp_path / "squeak.py").write_text(squeak.replace(was, becomes))
    with pytest.raises(InputError, match=said):
        catalogue(tmp_path)


def test_the_command_lists_them():
    done = CliRunner().invoke(cli, ["effects", "--json"])
    listed = {e["name"]: e for e in json.loads(done.output)["effects"]}
    assert sorted(listed) == sorted(NAMES)
    assert listed["warmup"]["parameters"]["torque"]["unit"] == "Nm"
    assert "warmup (torque, of the vehicle)" in CliRunner().invoke(cli, ["effects"]).output


def test_conditions_bound_the_curvature_on_the_spot():
    at = conditions(speed=0.0, yaw_rate=1.0)
    assert 0.0 < at.curvature <= 1.0 / at.facts.contact_length
    assert replace(at, speed=50.0).curvature == pytest.approx(1.0 / 50.0, rel=1e-2)
