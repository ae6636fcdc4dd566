# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Plain data becomes annotated dataclasses, or the one error that names place, given and allowed values."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros import checks
from trackres_ros.errors import InputError
from trackres_ros.files.dataclass_reader import FILLED, DataReader, Limits, check_values, fields_of, limits_of, words_of


@dataclass(frozen=True)
class Wheel:
    name: str
    radius: Annotated[float, Limits("m", 0.1, 2.0, "radius")]
    spokes: int = field(default=3, metadata={"limits": Limits("1", 2, 9, "spokes")})


@dataclass(frozen=True)
class Steel:
    form: ClassVar[str] = "steel"
    carbon: float


@dataclass(frozen=True)
class Wood:
    form: ClassVar[str] = "wood"
    dry: bool = True


@dataclass(frozen=True)
class Cart:
    wheels: Annotated[tuple[Wheel, ...], FILLED]
    frame: Steel | Wood
    axles: Mapping[str, Wheel] = field(default_factory=dict)
    colour: Literal["red", "green"] = "red"
    mass: Annotated[float | None, checks.positive] = None
    owner: str | tuple[str, ...] | None = None
    more: Any = None


CART = {
    "wheels": [{"name": "left", "radius": 0.5}, {"name": "right", "radius": 1, "spokes": 4.0}],
    "frame": {"form": "wood", "dry": False},
    "axles": {"rear": {"radius": 0.2}},
    "owner": ["a", "b"],
}


def test_what_is_written_is_read():
    cart = DataReader("cart.yaml").part(Cart, CART)
    assert cart.wheels == (Wheel("left", 0.5), Wheel("right", 1.0, 4))
    assert cart.wheels[1].spokes == 4
    assert DataReader("cart.yaml").part(Cart, CART | {"frame": {"form": "steel", "carbon": 1}}).frame.carbon == 1.0
    assert cart.axles == {"rear": Wheel("rear", 0.2)}
    assert (cart.frame, cart.colour, cart.mass, cart.owner) == (Wood(dry=False), "red", None, ("a", "b"))


REFUSED = (
    ({"wheels": None}, "wheels", None, "a list with at least one entry"),
    ({"wheels": []}, "wheels", [], "a list with at least one entry"),
    ({"wheels": [3]}, "wheels[0]", 3, "a mapping with the keys name, radius, spokes"),
    ({"wheels": [{"radius": 1.0}]}, "wheels[0].name", "nothing", "this key is required"),
    ({"wheels": [{"name": "left", "radius": 3.0}]}, "wheels.left.radius", 3.0, "a number from 0.1 to 2 m"),
    ({"wheels": [{"name": "left", "radius": True}]}, "wheels.left.radius", True, "a number from 0.1 to 2 m"),
    ({"wheels": [{"name": "left", "radius": 1.0, "spokes": 2.5}]}, "wheels.left.spokes", 2.5, "a whole number from 2 to 9"),
    ({"frame": {}}, "frame", {}, "a mapping with a form, one of steel, wood"),
    ({"frame": {"form": "steel", "carbon": math.inf}}, "frame.carbon", math.inf, "a finite number"),
    ({"frame": {"form": "wood", "dry": 1}}, "frame.dry", 1, "true or false"),
    ({"axles": {"rear": {}}}, "axles.rear.radius", "nothing", "this key is required"),
    ({"colour": ""}, "colour", "", "one of red, green"),
    ({"mass": 0.0}, "mass", 0.0, "a positive number"),
    ({"owner": " "}, "owner", " ", "a text that is not empty"),
    ({"owner": {}}, "owner", {}, "a text or a list"),
    ({"owner": ["a", 3]}, "owner[1]", 3, "a text that is not empty"),
    ({"form": 1}, "form", "form", "one of wheels, frame, axles, colour, mass, owner, more"),
)


@pytest.mark.parametrize(("changed", "where", "value", "allowed"), REFUSED)
def test_a_refusal_names_place_given_and_allowed(changed, where, value, allowed):
    with pytest.raises(InputError) as error_info:
        DataReader("cart.yaml").part(Cart, CART | changed)
    error = error_info.value
    assert (error.where, error.given, error.allowed) == (f"cart.yaml: {where}", value, allowed)


@pytest.mark.parametrize(("changed", "near"), [({"wheel": 1}, "wheels"), ({"colour": "gren"}, "green")])
def test_a_misspelt_key_or_word_gets_a_suggestion(changed, near):
    with pytest.raises(InputError) as error_info:
        DataReader("cart.yaml").part(Cart, CART | changed)
    assert error_info.value.remedy == f"did you mean {near}?"


def test_keys_may_be_left_to_the_caller():
    reader = DataReader("cart.yaml")
    assert reader.part(Wheel, {"radius": 1.0}, "wheel", name="w") == Wheel("w", 1.0)
    assert reader.part(Wheel, {"radius": 1.0, "tyre": "x"}, "wheel", other_keys=("tyre",), name="w") == Wheel("w", 1.0)
    with pytest.raises(InputError, match=r"wheel\.spokes"):
        reader.part(Wheel, {"name": "w", "radius": 1.0, "spokes": 4}, "wheel", selection=("name", "radius"))


def test_values_of_a_dataclass_are_checked_as_if_read():
    check_values(Wheel("a", 1.0), "setting")
    with pytest.raises(InputError, match="setting spokes"):
        check_values(Wheel("a", 1.0, 20), "setting")


def test_limits_and_words_come_from_the_annotations():
    assert {name: limits.unit for name, limits in limits_of(Wheel).items()} == {"radius": "m", "spokes": "1"}
    assert {item.name: words_of(item.kind) for item in fields_of(Cart) if words_of(item.kind)} == {"colour": ("red", "green")}


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda child: st.lists(child, max_size=3) | st.dictionaries(st.sampled_from([*CART, "form", "name"]), child, max_size=3),
)


@given(anything)
def test_anything_is_read_or_refused(content):
    try:
        cart = DataReader("cart.yaml").part(Cart, content)
    except InputError:
        return
    assert set(asdict(cart)) >= set(content) - {"form"}
