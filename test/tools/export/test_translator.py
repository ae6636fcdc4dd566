# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The translator's C computes the same as Python, and untranslatable source is refused with the line."""

import ctypes
import math
import re
import subprocess
from contextlib import nullcontext

import numpy as np
import pytest
from built import STRICT, have
from hypothesis import given
from hypothesis import strategies as some

from trackres_ros.errors import InputError
from trackres_ros.kernels.extension import used_helpers
from trackres_ros.kernels.flow import translate_body
from trackres_ros.kernels.functions import Translator
from trackres_ros.kernels.kinds import INT, REAL, SAME_IN_C, ArrayOf
from trackres_ros.kernels.rows import Real, Reals, Row
from trackres_ros.kernels.statements import ALLOWED

STEPS = (2.0, -1.0, 0.25)
TABLE = np.arange(12.0).reshape(4, 3)


def whole_numbers(a, b, out):
    out[0] = a // b
    out[1] = a % b
    out[2] = (a << 2) ^ (b & 5) | 8
    out[3] = abs(a) + int(-2.5) + math.floor(a / 2) + (1 if a > b else -1)


def branches(a, b, out):
    low, high = (a, b) if a <= b else (b, a)
    a, b = b, a
    out[0], out[1] = low - high, a * 2 - b
    result = 0.0
    for i in range(5, -3, -2):
        if i == b:
            continue
        if i * 3 == a:
            break
        result += STEPS[i % 3] * i
    else:
        result += 100.0
    out[2] = result
    count = 0
    while count < 4 and not ((low > 0 and high < 10) or count == 3):
        count += 1
    out[3] = count if -5 < a <= b < 50 else -count


def views(a, b, out):
    total = out[0:2]
    total[0], total[1] = float(a), float(b)
    total[0], total[1] = total[1], total[0]
    out[0], total[0] = total[1], out[0]
    for step in (1.5, 2.5):
        out[2] += step * total[0]
    out[3] = max(total[0], math.nan, 1.0) + min(math.inf, total[1]) if a != b else -(a**2) + 2.0**b


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


def places(a, b, out):
    i = a % 7 - 3
    part, inner = out[-3:-1], out[:-1]
    part[-2], inner[-3] = STEPS[i], TABLE[i, b % 4 - 2] + TABLE[-1, -2]
    out[-2] = float(len(out[:-9]) + len(inner) + a // (b - 3) + a % (b + 3))
    out[-1] = STEPS[-1] if i else STEPS[0]


def pair(a):
    return a, a + 1.0


def second(given):
    return given[1]


def rounds(a, b, out):
    n, given_1 = abs(a) % 9, 0.5 * b
    for i in range(n):
        n = n - 1
        out[0] += i
    while second(pair(out[1])) < n:
        out[1] += 1.0
    if a > 9:
        out[2] = 1.0
    elif second(pair(given_1)) > 0.5 or a:
        out[2] = 2.0
    exp = exp_ = out[1]
    NAN, tr_place = exp + exp_, math.exp(-abs(exp))
    out[3] = NAN + tr_place + whole(a)


def whole(a):
    return 0.5 * a


def operands(a, b, out):
    x, y = 0.5 * a, 0.25 * b
    out[0] = (x or y) + (a and y) + (a > b or x or 7)
    out[1] = x // 0.1 + y // -0.3 + a // 0.7
    out[2] = (a - 3 and b - 3 and x) + (not (a and b - 1))
    out[3] = 1.0 if (a or y) and (x - 2.0 or b > 3) else 2.0


FUNCTIONS = (whole_numbers, branches, views, rows, places, rounds, operands)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    folder, translator = tmp_path_factory.mktemp("translated"), Translator(translate_body)
    ones = [translator.instance(function, [INT, INT, ArrayOf(REAL, (4,))]) for function in FUNCTIONS]
    functions = translator.text_of_functions(ones)
    head = "#include <math.h>\n#include <stdint.h>\n#include <stdbool.h>\n"
    entries = ""
    for item in ones:
        given_values = ", ".join([*(name for name, _ in item.given), *["&failed"] * item.has_failure])
        entries += f"bool run_{item.function.__name__}(int64_t a, int64_t b, double *out)\n"
        entries += f"{{ bool failed = false; {item.name}({given_values}); return failed; }}\n"
    own = used_helpers(translator, functions)
    text = head + own + translator.text_of_structs(functions) + translator.text_of_tables() + functions + entries
    (folder / "all.c").write_text(text)
    subprocess.run(["gcc", *STRICT, "-O1", "-shared", "-fPIC", "all.c", "-o", "all.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "all.so"))


@pytest.mark.skipif(not have("gcc"), reason="gcc is not installed")
@pytest.mark.parametrize("function", FUNCTIONS)
@given(a=some.integers(-40, 40), b=some.integers(-40, 40).filter(lambda b: b not in (0, 3, -3)))
def test_c_does_what_python_does(compiled, function, a, b):
    expectation, result = np.zeros(4), np.zeros(4)
    pointer = result.ctypes.data_as(ctypes.c_void_p)
    failed = getattr(compiled, f"run_{function.__name__}")(ctypes.c_int64(a), ctypes.c_int64(b), pointer) & 1
    with pytest.raises(IndexError) if failed else nullcontext():
        function(a, b, expectation)
    if not failed:
        np.testing.assert_array_equal(result, expectation)


def of_text(x):
    return x if x == "a" else 0.0


def of_list(x):
    results = [x, 2.0]
    return results[0]


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


def of_no_such_place(x):
    return STEPS[3] + x


def of_a_place_that_is_no_whole_number(x):
    return STEPS[x]


def of_more_numbers_than_in_c(x):
    return math.log(x, 10.0)


def shifted_by_what_it_knows_at_run_time(x):
    return 1 << int(x)


def sometimes_with_a_tuple(x):
    return x or second(pair(x))


def twice_the_same_loop(x):
    for i in range(3):
        for i in range(i):  # noqa: B020
            x += i
    return x


REFUSED = {
    of_text: 1, of_list: 1, of_two_kinds: 2, endless: 0, half_an_answer: 0, printed: 1, of_nothing_known: 1, handled: 1,
    of_no_such_place: 1, of_a_place_that_is_no_whole_number: 1, of_more_numbers_than_in_c: 1,
    shifted_by_what_it_knows_at_run_time: 1, sometimes_with_a_tuple: 1, twice_the_same_loop: 2,
}  # fmt: skip


@pytest.mark.parametrize("function", REFUSED)
def test_what_c_cannot_say_is_refused_with_its_line(function):
    line = function.__code__.co_firstlineno + REFUSED[function]
    with pytest.raises(InputError, match=rf"test_translator\.py:{line}: given "):
        Translator(translate_body).instance(function, [REAL])


@pytest.mark.parametrize("name", [name for name in re.findall(r"\w+", ALLOWED) if hasattr(math, name)])
def test_a_refusal_names_only_functions_that_are_allowed(name):
    translator = Translator(translate_body)

    def call(x):
        return x

    given_values = ", ".join(["x"] * SAME_IN_C.get(name, 1))
    translator.add_text(call, f"def call(x):\n    return 1.0 * math.{name}({given_values})")
    assert translator.instance(call, [REAL]).returns == REAL
