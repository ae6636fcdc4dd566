# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The controller's rules in C++: compiled with every warning, laws of its added torque, and equal to the example in Python."""

import itertools
import math
import shutil
import subprocess

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

COMPILER = shutil.which("g++") or shutil.which("clang++")
if not COMPILER:
    pytest.skip("no C++ compiler", allow_module_level=True)

# Reads lines of: stamp, torque, level, now, elapsed; "none" for a message without a level. Prints the torque to add.
PROGRAM = """
#include <cstdlib>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>
#include "trackres_feedforward/feedforward.hpp"

struct Stamp { int sec; unsigned nanosec; };
struct Header { Stamp stamp; };
struct Group { std::vector<std::string> interface_names; std::vector<double> values; };
struct Message { Header header; std::vector<std::string> interface_groups; std::vector<Group> interface_values; };

int main()
{
  trackres_feedforward::Feedforward feedforward;
  trackres_feedforward::Sample sample;
  std::string line, torque, level;
  while (std::getline(std::cin, line)) {
    std::istringstream words(line);
    int sec; unsigned nanosec; double now_s; std::string elapsed;
    words >> sec >> nanosec >> torque >> level >> now_s >> elapsed;
    const double elapsed_s = std::strtod(elapsed.c_str(), nullptr);  // a stream reads no "nan"
    Group group{{"resistance_std_nm", "feedforward_torque_nm"}, {100.0, std::strtod(torque.c_str(), nullptr)}};
    if (level != "none") {
      group.interface_names.push_back("level");
      group.values.push_back(std::strtod(level.c_str(), nullptr));
    }
    Message message{{{sec, nanosec}}, {"reasons", "vehicle"}, {{{}, {}}, group}};
    trackres_feedforward::read(message, sample);
    std::cout.precision(17);
    std::cout << feedforward.torque(sample, now_s, elapsed_s) << "\\n";
  }
}
"""
START = 1_700_000_000
AGES = st.sampled_from([-3600.0, -0.1, -0.04, 0.0, 0.02, 1.9, 2.1, 3600.0]) | st.floats(-1.0, 3.0)
TORQUES = st.floats(-30000.0, 30000.0) | st.sampled_from([0.0, math.nan, math.inf, -math.inf])
LEVELS = st.sampled_from([0.0, 1.0, 2.0, 3.0, math.nan, -1.0, 0.5, None])
STEPS = st.lists(st.tuples(AGES, TORQUES, LEVELS, st.floats(0.001, 0.05)), min_size=1, max_size=60)
USUAL = st.lists(
    st.tuples(AGES, st.floats(-15000.0, 15000.0), st.sampled_from([0.0, 1.0, 2.0, 3.0]), st.floats(0.001, 0.05)), max_size=60
)
RAMP, BOUND = 5000.0, 20000.0


@pytest.fixture(scope="module")
def program(tmp_path_factory, repository):
    folder = tmp_path_factory.mktemp("cpp")
    (folder / "main.cpp").write_text(PROGRAM)
    include = repository / "examples" / "ros2_feedforward" / "include"
    command = [COMPILER, "-std=c++17", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{include}"]
    done = subprocess.run([*command, "main.cpp", "-o", "main"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "main"


@pytest.fixture(scope="module")
def python(imported):
    return imported("examples/07_controller.py")


def timed(steps):
    """Stamp as seconds and nanoseconds, torque, level, now and elapsed of each step."""
    now = 0.0
    for age, torque, level, elapsed in steps:
        now += elapsed
        stamp_ns = round((START + now - age) * 1e9)
        yield stamp_ns // 10**9, stamp_ns % 10**9, torque, level, START + now, elapsed


def used(program, steps):
    return run(program, timed(steps))


def run(program, rows):
    """What the program adds at each row of `timed`."""
    lines = "".join(
        f"{sec} {nanosec} {torque!r} {'none' if level is None else repr(level)} {now!r} {elapsed!r}\n"
        for sec, nanosec, torque, level, now, elapsed in rows
    )
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    return [float(line) for line in done.stdout.split()]


@settings(max_examples=60, deadline=None)
@given(STEPS)
def test_whatever_comes_it_is_finite_bounded_and_never_jumps(program, steps):
    given_ = used(program, steps)
    assert all(math.isfinite(torque) and abs(torque) <= BOUND for torque in given_)
    for before, after, (*_, elapsed) in zip([0.0, *given_], given_, steps, strict=False):
        assert abs(after - before) <= RAMP * elapsed + 1e-6


@settings(max_examples=40, deadline=None)
@given(USUAL)
def test_it_adds_what_the_example_in_python_adds(program, python, steps):
    drive = python.Drive()
    drive.last_s = START
    for (sec, nanosec, torque, level, now, _), found in zip(timed(steps), used(program, steps), strict=True):
        drive.on_estimate(sec + nanosec * 1e-9, torque, level)
        drive.torque(now, 0.0, 0.0)
        assert found == pytest.approx(drive.used, abs=0.01)


@pytest.mark.parametrize("level", [2.0, math.nan, 7.0, 0.5])
def test_what_is_not_to_be_trusted_goes_to_zero(program, level):
    steps = [(0.01, 3000.0, 0.0, 0.02)] * 100 + [(0.01, 3000.0, level, 0.02)] * 100
    found = used(program, steps)
    assert found[99] == 3000.0
    assert found[-1] == 0.0


def test_what_the_node_fades_is_added_on_its_way(program):
    fading = [max(0.0, 3000.0 * (1.5 - 0.02 * i)) for i in range(100)]
    steps = [(0.01, 3000.0, 0.0, 0.02)] * 100 + [(0.02 * i, min(t, 3000.0), 3.0, 0.02) for i, t in enumerate(fading)]
    assert used(program, steps)[100:] == pytest.approx([min(t, 3000.0) for t in fading])


@pytest.mark.parametrize("elapsed", [math.nan, math.inf, -math.inf, -5.0])
def test_a_time_that_is_none_counts_as_the_last_one(program, elapsed):
    steps = [(0.01, 3000.0, 0.0, 0.02)] * 100
    rows = [*timed(steps), *[(START, 0, 3000.0, None, START + 2.0, elapsed)] * 100]  # and nothing comes any more
    found = run(program, rows)
    assert found[99] == 3000.0
    assert found[-1] == 0.0
    assert all(abs(b - a) <= RAMP * 0.02 + 1e-6 for a, b in itertools.pairwise(found))


def test_an_incomplete_message_is_none_and_the_silence_ends_it(program):
    steps = [(0.01, 3000.0, 1.0, 0.02)] * 100 + [(0.01, 9000.0, None, 0.02)] * 100
    found = used(program, steps)
    assert max(found) == 3000.0
    assert found[108] == 3000.0
    assert found[111] < 3000.0
    assert found[-1] == 0.0
    assert all(b <= a for a, b in itertools.pairwise(found[100:]))
