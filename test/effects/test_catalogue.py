# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The catalogue: what each effect declares, and laws that all obey."""

import gc
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from trackres_ros.effects import Active, Effect, Terms, calls, catalogue, check_effects, together
from trackres_ros.effects.calls import is_compiled, reads_drag_area
from trackres_ros.effects.effect import ACTS_ON, BELONGS_TO, REFERENCE_NM
from trackres_ros.effects.effect import conditions as known_conditions
from trackres_ros.effects.stepping import FIRST_OWN, effect_table, new_memory
from trackres_ros.effects.vehicle.payne import EXPONENT
from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.kernels.compiler import compile_text
from trackres_ros.model.track import vehicle_constants
from trackres_ros.tasks.main import cli
from trackres_ros.tasks.vehicle import check_vehicle
from trackres_ros.vehicle import load

NAMES = [
    "grade", "grade_profile", "turning_scrub", "cornering", "rotating_inertia", "drivetrain_efficiency", "drivetrain_drag",
    "viscous_bearing", "stribeck", "headwind", "air_drag", "payne", "mullins", "frequency", "compound_temperature",
    "core_surface", "convection", "ground_conduction", "still_air", "solar", "rain", "tension_torque", "lug_friction",
    "roadwheel_tyres", "soft_ground", "vibration", "warmup", "torque_offset", "torque_gain", "speed_scale", "delay",
    "coulomb_friction", "viscous_friction", "friction_by_direction",
]  # fmt: skip
BOTH_WAYS = ("grade", "grade_profile", "headwind", "rotating_inertia", "friction_by_direction")
OF_SURROUNDINGS = {"grade", "grade_profile", "headwind", "rain", "soft_ground", "solar"}
OF_SENSORS = {"delay", "speed_scale", "torque_gain", "torque_offset"}
CATALOGUE = catalogue()


def conditions(**changed):
    facts = {"speed": 5.0, "accel": 0.2, "weight": 250e3, "ambient": 10.0, "yaw_rate": 0.1, "heading": 0.5, "distance": 900.0}
    return known_conditions(vehicle_constants(load("xgd24d")), **{**facts, "drive_torque": 3000.0, "own": 12.0, **changed})


def terms_of(effect, at, values=None):
    return Active(effect, effect.values() if values is None else values).terms(at, at.own)


def same(a, b):
    names = [name for name in Terms._fields if name != "sink" or a.conductance or b.conductance]
    return all(np.allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=1e-9) for name in names)


def test_each_effect_says_what_it_belongs_to():
    by_kind = {kind: {n for n, e in CATALOGUE.items() if e.belongs_to == kind} for kind in BELONGS_TO}
    assert by_kind["surroundings"] == OF_SURROUNDINGS
    assert by_kind["sensor"] == OF_SENSORS == {n for n, e in CATALOGUE.items() if e.acts_on == "sensor"}
    assert by_kind["vehicle"] == set(NAMES) - OF_SURROUNDINGS - OF_SENSORS


def test_the_film_of_a_plate_is_well_within_the_plausible_ones():
    """McAdams: 5.9 + 3.7 v W/(m^2 K), and 5 of radiation; turbulence may add a half."""
    facts, (offset, slope) = vehicle_constants(load("xgd24d")), CATALOGUE["convection"].parameters
    assert offset.low < (5.9 + 5.0) * facts.cooled_area / facts.cooling
    assert slope.high > 1.5 * 3.7 * facts.cooled_area / facts.cooling_by_speed


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_that_is_off_does_nothing(name):
    effect = CATALOGUE[name]
    assert same(terms_of(effect, conditions(), effect.values(off=True)), Terms())


@pytest.mark.parametrize("name", NAMES)
def test_a_typical_effect_does_what_it_says_it_acts_on(name):
    effect = CATALOGUE[name]
    # Away from the points where an effect is nothing by its definition.
    at = conditions(weight=310e3, speed=0.4 if name == "still_air" else 7.0)
    terms = terms_of(effect, at)
    term_names = {name for name in Terms._fields if not np.allclose(getattr(terms, name), getattr(Terms(), name), rtol=1e-12)}
    by_action = {
        "torque": {"torque", "drive_gain"},
        "heat": {"loss_factor", "softening"},
        "cooling": {"film_offset_factor", "film_slope_factor", "conductance", "sink", "heat", "inner_resistance"},
        "sensor": {"speed_factor", "sensor_gain", "sensor_offset", "sensor_delay"},
    }
    assert effect.acts_on in ACTS_ON
    assert term_names
    assert term_names <= by_action[effect.acts_on]


@pytest.mark.parametrize("name", sorted(set(NAMES) - OF_SENSORS))
def test_the_step_runs_what_the_file_says_as_machine_code(stepped, name):
    active, memory = Active(CATALOGUE[name], CATALOGUE[name].values()), new_memory(1)
    assert is_compiled(active.effect)
    for speed in (-3.0, 0.0, 0.2, 6.0, 13.0):
        at = conditions(speed=speed)
        work = stepped([active], at, memory)
        lag = active.lag(at)
        expected = active.terms(at, 0.0 if lag is None else memory[FIRST_OWN])
        assert same(Terms(*work[:10]), expected)


OWN = """
import math

from trackres_ros.effects import Effect, Parameter, Terms

CONSTANT = {constant}
TORQUE = Parameter("torque", "Nm", 0.0, 100.0, 10.0, "of it", off=0.0)
SHARE = Parameter("share", "1", 0.0, 1.0, 0.5, "of it", off=0.0)

class Own(Effect):
    name = "own"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "something"
    parameters = ({parameters})

    def terms(self, at, p):
        return Terms(torque=p.torque * CONSTANT * math.{function}(0.0){more})
"""


needs_compiler = pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler is installed")


def table_of(folder, constant=2.0, more="", function="cos", parameters="TORQUE, SHARE"):
    """The table of an effect of a user's own, which nothing else holds."""
    (folder / "own.py").write_text(OWN.format(constant=constant, more=more, function=function, parameters=parameters))
    effect = catalogue(folder)["own"]
    assert is_compiled(effect) == (not more and shutil.which("cc") is not None)
    return effect_table([Active(effect, effect.values())])


@pytest.fixture
def torque_by(stepped):
    def torque_of_table(table):
        gc.collect()
        return stepped(table, conditions())[0]

    return torque_of_table


def _air(at):
    return at.facts.drag_area


class Gust(Effect):
    def terms(self, at, p):
        return Terms(torque=_air(at))


def test_what_looks_at_the_drag_area_is_known_by_its_code():
    assert {name for name, effect in CATALOGUE.items() if reads_drag_area(effect)} == {"air_drag", "headwind"}
    assert reads_drag_area(Gust())


def test_editing_an_effect_file_changes_its_code(tmp_path, torque_by):
    assert torque_by(table_of(tmp_path, 2.0)) == 20.0
    assert torque_by(table_of(tmp_path, 3.0)) == 30.0
    assert torque_by(table_of(tmp_path, 3.0, parameters="SHARE, TORQUE")) == 30.0
    assert torque_by(table_of(tmp_path, 3.0, function="sin")) == 0.0


@needs_compiler
def test_an_effect_file_is_compiled_once_and_kept_for_us_alone(tmp_path, torque_by, monkeypatch):
    monkeypatch.setattr(calls, "cache_dir", lambda: tmp_path / "cache")
    texts = []
    monkeypatch.setattr(calls, "compile_text", lambda text: texts.append(text) or compile_text(text))
    for count, damage in ((1, None), (1, bytes), (2, lambda code: code[:-1]), (3, lambda _: b"")):
        (tmp_path / "cache").mkdir(exist_ok=True)
        for code_path in (tmp_path / "cache").rglob("*.code"):
            code_path.write_bytes(damage(code_path.read_bytes()))
        calls._library.cache_clear()  # as another process
        assert torque_by(table_of(tmp_path, 41.0)) == 410.0
        assert len(texts) == count
    (code_path,) = (tmp_path / "cache").rglob("*.code")
    assert (code_path.stat().st_mode | code_path.parent.stat().st_mode) & 0o077 == 0


def test_an_untranslatable_effect_names_its_line_and_runs(tmp_path, torque_by, caplog):
    calls._warn_of_python.cache_clear()
    tables = [table_of(tmp_path, float(i), " + len(type(self).text) - 8") for i in range(3)]
    assert [torque_by(table) for table in tables] == [1.0, 11.0, 21.0]
    line = 1 + next(i for i, text in enumerate((tmp_path / "own.py").read_text().split("\n")) if "return Terms" in text)
    assert f"own.py:{line}: given" in caplog.text or not shutil.which("cc")


def test_without_a_compiler_an_effect_runs_in_plain_python(tmp_path, torque_by, caplog, monkeypatch):
    calls._warn_of_python.cache_clear()
    monkeypatch.setattr(calls, "compiler", lambda: None)
    (tmp_path / "own.py").write_text(OWN.format(constant=43.0, more="", function="cos", parameters="TORQUE, SHARE"))
    effect = catalogue(tmp_path)["own"]
    assert torque_by(effect_table([Active(effect, effect.values())])) == 430.0
    assert "plain Python, about" in caplog.text
    assert "no C compiler" in caplog.text


@pytest.mark.parametrize(("air", "rise", "thinning"), [(-30.0, 12.0, 0.07), (-5.0, 9.0, 0.05), (40.0, 1.0, 0.03)])
def test_a_bearing_warms_until_it_gives_off_its_heat(stepped, air, rise, thinning):
    bearing, at = CATALOGUE["viscous_bearing"], conditions(speed=8.0, ambient=air)
    active, memory = Active(bearing, {**bearing.values(), "rise": rise, "thinning": thinning}), new_memory(1)
    target, constant, _ = active.lag(at)
    heat = rise * 8.0 * np.exp(-0.5 * thinning * (target - 20.0))
    assert target - air == pytest.approx(heat, rel=0.04)
    assert constant == pytest.approx(1000.0 / (1.0 + 0.5 * thinning * heat), rel=0.04)
    for i in range(100):
        stepped([active], at, memory, dt=7.0 if i else 0.0)
        assert memory[FIRST_OWN] == pytest.approx(air + (target - air) * (1.0 - np.exp(-7.0 * i / constant)), rel=1e-12, abs=1e-9)


@pytest.mark.parametrize(
    "name",
    [n for n in NAMES if CATALOGUE[n].acts_on == "torque" and n not in BOTH_WAYS],
)
def test_friction_turns_with_the_direction_and_vanishes_at_rest(name):
    effect = CATALOGUE[name]
    ahead, reverse = (terms_of(effect, conditions(speed=v, drive_torque=np.sign(v) * 3000.0)) for v in (4.0, -4.0))
    rest_terms = terms_of(effect, conditions(speed=0.0))
    assert float(ahead.torque) == pytest.approx(-float(reverse.torque), rel=1e-9)
    assert float(rest_terms.torque) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("strain", [0.1, 1.0, 10.0])
def test_strain_dependent_loss_is_positive_with_a_bounded_slope(strain):
    payne, nominal = CATALOGUE["payne"], conditions().facts.weight
    shares = np.linspace(0.5, 1.5, 21)
    values = {"height": 10.0, "strain": strain}
    loss = np.array([terms_of(payne, conditions(weight=nominal * share), values).loss_factor for share in shares])
    assert loss[10] == pytest.approx(1.0, abs=1e-15)
    assert np.all(loss > 0.0)
    # Kraus' peak goes as strain^(+-p) far from itself, and strain as load^(2/3); the loss beside the peak holds it back.
    slope = np.diff(np.log(loss)) / np.diff(np.log(shares))
    assert np.all(np.abs(slope) < 2.0 * EXPONENT / 3.0)
    # Known of filled rubber: a fifth to a third of the hysteresis over the loads driven.
    assert (np.ptp(loss) > 0.2) == (strain != 1.0)


def test_torques_add_factors_multiply_and_sinks_are_averaged():
    total = together(
        [
            Terms(torque=2.0, loss_factor=1.1, conductance=10.0, sink=0.0),
            Terms(torque=3.0, loss_factor=2.0, conductance=30.0, sink=40.0),
        ]
    )
    assert (total.torque, total.loss_factor, float(total.conductance), float(total.sink)) == pytest.approx((5.0, 2.2, 40.0, 30.0))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("before", [0.0, 700.0, 40_000.0])
def test_an_effect_acts_alike_from_a_later_first_start(name, before):
    """What a fit counts from the first recording, a replay and a live node count from their own start."""
    active = Active(catalogue()[name], catalogue()[name].values())
    late_effect = active.after(before)
    for distance in (0.0, 300.0, 5000.0):
        pairs = (effect.terms(conditions(distance=at)) for effect, at in ((active, before + distance), (late_effect, distance)))
        early_terms, late_terms = (np.array(terms) for terms in pairs)
        assert late_terms == pytest.approx(early_terms, abs=0.005)  # what is less has faded
    assert late_effect.does_nothing == (name == "mullins" and before > 20_000.0)


def test_values_of_a_vehicle_file_are_checked():
    valid = {"warmup": {"torque": 100.0, "time_constant": 200.0, "cooling": 5000.0}}
    (active,) = check_effects(valid, "vehicle.yaml: effects", CATALOGUE, "vehicle")
    assert isinstance(active, Active)
    assert not active.ranges
    for faulty, words in (
        ({"warmpu": {}}, "did you mean warmup"),
        ({"warmup": {"torque": 1.0}}, "time_constant"),
        ({"warmup": {**valid["warmup"], "torque": -1.0}}, "0 to 2500 Nm"),
        ([], "a mapping"),
        (with_torque({"value": 100.0}), "range: "),
        (with_torque({"value": 100.0, "range": 50.0}), "two numbers"),
        (with_torque({"value": 100.0, "range": [150.0, 50.0]}), "low <= high"),
        (with_torque({"value": 100.0, "range": [110.0, 150.0]}), "from 110 to 150 Nm"),
        (with_torque({"value": 100.0, "range": [50.0, 9e9]}), "from 0 to 2500 Nm"),
        (with_torque({"value": float("nan"), "range": [50.0, 150.0]}), "from 50 to 150 Nm"),
    ):
        with pytest.raises(InputError, match=words):
            check_effects(faulty, "vehicle.yaml: effects", CATALOGUE, "vehicle")


def with_torque(given):
    return {"warmup": {"torque": given, "time_constant": 200.0, "cooling": 5000.0}}


def test_a_range_goes_with_its_value():
    (active,) = check_effects(with_torque({"value": 100.0, "range": [60.0, 140.0]}), "effects", CATALOGUE, "vehicle")
    assert active.values["torque"] == 100.0
    assert active.ranges == {"torque": (60.0, 140.0)}
    (neighbour,) = active.shifted()
    assert neighbour.values == {**active.values, "torque": 120.0}


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
    full, half = (catalogue(size=size)["warmup"].parameters[0] for size in (REFERENCE_NM, 0.5 * REFERENCE_NM))
    assert (half.low, half.start, half.high) == (0.5 * full.low, 0.5 * full.start, 0.5 * full.high)
    assert catalogue(size=REFERENCE_NM)["warmup"].values() == CATALOGUE["warmup"].values()
    on_tyres = catalogue(size=4600.0, on_tyres=True)["roadwheel_tyres"].parameters[0]
    assert on_tyres.start == pytest.approx(46.0)
    assert catalogue(size=0.5 * REFERENCE_NM)["headwind"].parameters == CATALOGUE["headwind"].parameters


def test_an_effect_of_the_users_own_joins_the_catalogue(own):
    assert set(catalogue(own)) == set(catalogue(str(own))) == {*NAMES, "squeak"}
    (own / "again.py").write_text((own / "squeak.py").read_text().replace('"squeak"', '"grade"'))
    with pytest.raises(InputError, match="no other effect"):
        catalogue(own)
    with pytest.raises(InputError, match="Python files"):
        catalogue(own / "nowhere")
    assert catalogue(files=[own / "squeak.py"])["squeak"].source == own / "squeak.py"


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
        ("off=0.0),)", "off=0.0))", "one ends with a comma"),
        ('    text = "', '    needs = "speed"\n    text = "', "yaw_rate"),
        ('    text = "', '    needs = ("speed", "grade")\n    text = "', "grade.*yaw_rate"),
        ('    text = "', '    needs = None\n    text = "', "yaw_rate"),
        ('    text = "', '    only_of = "tracks"\n    text = "', "rolls"),
        ("0.0, 100.0", '"0", 100.0', "numbers"),
        ("0.0, 100.0", "float('nan'), 100.0", "finite"),
        ('Parameter("torque"', "Parameter(3", "texts"),
        ("off=0.0),)", 'off=0.0),) + (Parameter("torque", "Nm", 0.0, 1.0, 1.0, "", off=0.0),)', "each name once"),
        ('"squeak"', '"gain_while_braking"', "no other effect"),
        ("    def terms", "    def __init__(self, size):\n        pass\n\n    def terms", "Squeak.*missing 1 required"),
        ("    def terms", "    __slots__ = ()\n    __hash__ = None\n\n    def terms", "unhashable"),
        ("    def terms", "    def lag(self, at, p):\n        return 5.0\n\n    def terms", "lag.*Lag"),
        ("def terms", "def term", "no terms"),
        ("at.direction", "at.yawrate", "AttributeError.*yawrate"),
        ("at.direction", "direction", "NameError.*direction"),
        ("at.direction", "len(at.speed)", "TypeError"),
        ("p.torque", 'p["torque"]', "p.name"),
        ("return Terms", "return 0.0, Terms", "terms.*Terms"),
        ("return ", "", "given None.*Terms"),
    ],
)
def test_an_effect_of_the_users_own_that_is_not_right_is_refused(own, was, becomes, said):
    squeak = own / "squeak.py"
    assert was in squeak.read_text()
    squeak.write_text(squeak.read_text().replace(was, becomes))
    with pytest.raises(InputError, match=rf"squeak\.py.*{said}"):
        catalogue(own)


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("        return", '        raise ValueError("boo")\n        return', "ValueError: boo"),
        ("at.direction", "(1.0 / (at.speed - at.speed))", "torque inf"),
        ("p.torque", "1e300", "torque 1e[+]300"),
        ("torque=", "loss_factor=-", "loss_factor -"),
        ("    def terms", "    def lag(self, at, p):\n        return Lag(1.0, 0.0, 0.0)\n\n    def terms", "time_constant 0"),
    ],
)
def test_an_own_effect_that_never_acts_is_refused_at_the_start(own, was, becomes, said):
    squeak = own / "squeak.py"
    squeak.write_text("from trackres_ros.effects import Lag\n" + squeak.read_text().replace(was, becomes))
    effect = catalogue(own)["squeak"]
    for start in (Estimator, check_vehicle):
        with pytest.raises(InputError, match=rf"squeak\.py: effect squeak.*{said}"):
            start(replace(load("xgd24d"), effects=(Active(effect, effect.values()),)))


def test_an_abstract_class_between_is_no_effect(own):
    squeak = own / "squeak.py"
    base_class = "from abc import abstractmethod\n\nclass Between(Effect):\n    @abstractmethod\n    def extra(self): ...\n\n"
    source = squeak.read_text().replace("class Squeak(Effect)", f"{base_class}class Squeak(Between)")
    squeak.write_text(f"{source}\n    def extra(self): ...\n")
    assert set(catalogue(own)) == {*NAMES, "squeak"}


def test_the_command_lists_them():
    result = CliRunner().invoke(cli, ["effects", "--json"])
    by_name = {e["name"]: e for e in json.loads(result.output)["effects"]}
    assert sorted(by_name) == sorted(NAMES)
    assert by_name["warmup"]["parameters"]["torque"]["unit"] == "Nm"
    assert "warmup (torque, of the vehicle)" in CliRunner().invoke(cli, ["effects"]).output


def test_conditions_bound_the_curvature_on_the_spot():
    at = conditions(speed=0.0, yaw_rate=1.0)
    assert 0.0 < at.curvature <= 1.0 / at.facts.contact_length
    assert conditions(speed=50.0, yaw_rate=1.0).curvature == pytest.approx(1.0 / 50.0, rel=1e-2)
