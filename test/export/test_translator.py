# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The translator's C computes the same as Python, and untranslatable source is refused with the line."""

import ctypes
import math
import subprocess

import numpy as np
import pytest
from built import STRICT, have
from hypothesis import given
from hypothesis import strategies as some

from trackres_ros.errors import InputError
from trackres_ros.export.c_source import TEMPLATES, filled
from trackres_ros.export.flow import translate_body
from trackres_ros.export.functions import Translator
from trackres_ros.export.kinds import INT, REAL, ArrayOf
from trackres_ros.jit.rows import Real, Reals, Row

STEPS = (2.0, -1.0, 0.25)


def whole_numbers(a, b, out):
    out[0] = a // b
    out[1] = a % b
    out[2] = (a << 2) ^ (b & 5) | 8
    out[3] = abs(a) + int(-2.5) + math.floor(a / 2) + (1 if a > b else -1)


def branches(a, b, out):
    low, high = (a, b) if a <= b else (b, a)
    a, b = b, a
    out[0], out[1] = low - high, a * 2 - b
    found = 0.0
    for i in range(5, -3, -2):
        if i == b:
            continue
        if i * 3 == a:
            break
        found += STEPS[i % 3] * i
    else:
        found += 100.0
    out[2] = found
    count = 0
    while count < 4 and not ((low > 0 and high < 10) or count == 3):
        count += 1
    out[3] = count if -5 < a <= b < 50 else -count


def views(a, b, out):
    whole = out[0:2]
    whole[0], whole[1] = float(a), float(b)
    whole[0], whole[1] = whole[1], whole[0]
    out[0], whole[0] = whole[1], out[0]
    for step in (1.5, 2.5):
        out[2] += step * whole[0]
    out[3] = max(whole[0], math.nan, 1.0) + min(math.inf, whole[1]) if a != b else -(a**2) + 2.0**b


class Numbered(Row):
    first = Real()
    several = Reals(2)
    last = Real()


def rows(a, b, out):
    row, several = Numbered(out), Numbered(out).several
    row.first = row.last = a / b
    row.several[0], several[1] = row.first + 1.0, row.last - 2.0
    several[1] += b * row.last
    row.last *= 2.0
    row.first, Numbered(out).last = row.last, row.first


FUNCTIONS = (whole_numbers, branches, views, rows)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    folder, translator = tmp_path_factory.mktemp("translated"), Translator(translate_body)
    ones = [translator.instance(function, [INT, INT, ArrayOf(REAL, (4,))]) for function in FUNCTIONS]
    helpers = (TEMPLATES / "helpers.c").read_text().replace("static ", "static inline ")
    values = {"REAL": "double", "REAL_LEAST": "-9.2e18", "REAL_MOST": "9.2e18", "FLOOR": "floor", "FMOD": "fmod"}
    functions = translator.text_of_functions(ones)
    head = "#include <math.h>\n#include <stdint.h>\n#include <stdbool.h>\n"
    entries = ""
    for one in ones:
        given = ", ".join(name for name, _ in one.given)
        entries += f"void run_{one.function.__name__}(int64_t a, int64_t b, double *out) {{ {one.name}({given}); }}\n"
    text = (
        head + filled(helpers, values) + translator.text_of_structs(functions) + translator.text_of_tables() + functions + entries
    )
    (folder / "all.c").write_text(text)
    subprocess.run(["gcc", *STRICT, "-O1", "-shared", "-fPIC", "all.c", "-o", "all.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "all.so"))


@pytest.mark.skipif(not have("gcc"), reason="gcc is not installed")
@pytest.mark.parametrize("function", FUNCTIONS)
@given(a=some.integers(-40, 40), b=some.integers(-40, 40).filter(bool))
def test_c_does_what_python_does(compiled, function, a, b):
    expected, found = np.zeros(4), np.zeros(4)
    function(a, b, expected)
    pointer = found.ctypes.data_as(ctypes.c_void_p)
    getattr(compiled, f"run_{function.__name__}")(ctypes.c_int64(a), ctypes.c_int64(b), pointer)
    np.testing.assert_array_equal(found, expected)


def of_text(x):
    return x if x == "a" else 0.0


def of_list(x):
    found = [x, 2.0]
    return found[0]


def of_two_kinds(x):
    y = x
    y = (x, x)
    return y[0]


def endless(x):
    return endless(x)


def half_an_answer(x):  # noqa: RET503
    if x > 0.0:
        return 1.0


def printed(x):
    print(x)
    return x


def of_nothing_known(x):
    return x + unknown  # noqa: F821


def handled(x):
    try:
        return 1.0 / x
    except ZeroDivisionError:
        return 0.0


REFUSED = {of_text: 1, of_list: 1, of_two_kinds: 2, endless: 0, half_an_answer: 0, printed: 1, of_nothing_known: 1, handled: 1}


@pytest.mark.parametrize("function", REFUSED)
def test_what_c_cannot_say_is_refused_with_its_line(function):
    line = function.__code__.co_firstlineno + REFUSED[function]
    with pytest.raises(InputError, match=rf"test_translator\.py:{line}: given "):
        Translator(translate_body).instance(function, [REAL])
