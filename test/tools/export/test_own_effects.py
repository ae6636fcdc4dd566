# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An effect of the user's own gives the same numbers as machine code, in plain Python and in C, whatever it is given."""

import ctypes
import itertools
import math
import subprocess
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from built import STRICT, have, write

from trackres_ros.effects import Active, Terms, calls, catalogue
from trackres_ros.effects.effect import ALL_KNOWN, conditions
from trackres_ros.estimator import constants
from trackres_ros.model.track import vehicle_constants

HEAD = """
import math
from math import floor

from trackres_ros.effects import Effect, Parameter, Terms

TABLE = (1.0, 2.0, 4.0)
"""
EFFECT = """

class Own{number}(Effect):
    name = "own_{number}"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "some expressions"
    parameters = (Parameter("size", "1", 0.0, 9.0, 3.0, "one", off=0.0), Parameter("shape", "1", 0.0, 9.0, 7.0, "two"))

    def terms(self, at, p):
        x, y, z = at.speed, at.accel, at.heading
        exp = x * 0.5
        return Terms({said})
"""
VALUES = (0.0, 0.3, -2.5, 5.7, -60.0, 1e200, math.inf, math.nan)
FAILING = (  # where there is no such whole number or place
    "2 ** int(y)", "TABLE[int(x) - 1]", "float(int(y) // 2 + floor(z))", "float(math.ceil(x * y) % 3)", "TABLE[int(z) % 4]",
)  # fmt: skip
SPECIAL = (
    "p.size * (1.0 - 1.0 / (1.0 + math.exp((x - 3.0) / 0.01)))", "math.exp(-1.0 / abs(y))", "p[-1] * TABLE[-3]", "x // 0.1",
    "exp + math.exp(y)", "x or y or 0.5", "(x and y) * z", "(-abs(x)) ** 0.5", "math.log(x) + math.log(-y)", "x // y + x % y",
    "math.sin(x) - math.hypot(y, z)", "x ** z", "1.0 if x and (y or z) else 2.0",
    "pow(x, y)", "min(pow(abs(x), z), 2.0)",
)  # fmt: skip
FORMS = (
    "({a} + {b})", "({a} - {b})", "({a} * {b})", "({a} / {b})", "({a} // {b})", "({a} % {b})", "({a} or {b})", "({a} and {b})",
    "({a} if {b} < {c} else {d})", "({a} if {b} and not {c} else {d})", "abs({a})", "-{a}", "({a} ** 2)", "math.exp({a})",
    "math.sqrt({a})", "math.log({a})", "math.atan2({a}, {b})", "(1.0 if {a} < {b} <= {c} else {d})",
)  # fmt: skip
LEAVES = ("x", "y", "z", "0.1", "-0.3", "2.5", "TABLE[1]", "p.size", "p[-1]")


def expression(random, depth):
    if depth == 0:
        return random.choice(LEAVES)
    return random.choice(FORMS).format(**{name: expression(random, random.randrange(depth)) for name in "abcd"})


def effects(folder):
    """Each with up to as many expressions as it has terms."""
    random, most = Random(1), len(Terms._fields)
    drawings = [expression(random, 3) for _ in range(most - 1)]
    several = [("1.0", *SPECIAL), ("1.0", *drawings), *((item,) for item in FAILING)]
    texts = [", ".join(f"{name}={item}" for name, item in zip(Terms._fields, ones, strict=False)) for ones in several]
    text = HEAD + "".join(EFFECT.format(number=number, said=item) for number, item in enumerate(texts))
    (folder / "own.py").write_text(text)
    result = catalogue(folder)
    return [result[f"own_{number}"] for number in range(len(several))]


def answers(effect, at):
    """An effect's answer to some numbers by a function at an address."""
    given_valuess = [np.array(numbers) for numbers in ([*at.facts, *at[1:]], Active(effect, effect.values()).numbers, Terms())]

    def by(call):
        call(*(numbers.ctypes.data for numbers in given_valuess))
        return [math.nan] if math.isnan(given_valuess[2][0]) else given_valuess[2].tolist()

    return by


@pytest.mark.skipif(not have("gcc", "cc"), reason="no C compiler is installed")
def test_each_way_of_an_own_effect_gives_the_same_numbers(tmp_path, xgd24d, monkeypatch):
    monkeypatch.setattr(constants, "check_own_effects", lambda vehicle: None)  # which refuses these
    own = effects(tmp_path)
    assert all(map(calls.is_compiled, own))
    write(replace(xgd24d, effects=tuple(Active(item, item.values()) for item in own)), tmp_path)
    with (tmp_path / "trackres.c").open("a") as file:
        file.write("void call(int64_t n, const double *x, const double *p, double *y);\n")
        file.write("void call(int64_t n, const double *x, const double *p, double *y)\n{\n    tr_call_effect(n, x, p, y);\n}\n")
    subprocess.run(["gcc", *STRICT, "-O1", "-shared", "-fPIC", "trackres.c", "-o", "all.so", "-lm"], cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "all.so"))
    facts = vehicle_constants(xgd24d)
    for number, effect in enumerate(own, 1):
        machine, python = (calls.C_FUNCTION(calls.number_of(effect, "terms", way)) for way in (True, False))
        for x, y, z in itertools.product(VALUES, repeat=3):
            conditions_of_x = conditions(facts, **{**ALL_KNOWN, "speed": x, "accel": y, "heading": z})
            by = answers(effect, conditions_of_x)
            expectation = by(machine)
            of_c = by(lambda *given, n=number: library.call(ctypes.c_int64(n), *map(ctypes.c_void_p, given)))
            np.testing.assert_allclose(of_c, expectation, rtol=1e-12, err_msg=f"{effect.name} in C at {x, y, z}")
            np.testing.assert_allclose(by(python), expectation, rtol=1e-12, err_msg=f"{effect.name} in Python at {x, y, z}")
