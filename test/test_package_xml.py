# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""package.xml: rosdep installs all that is imported, but for what only extras need; a release with bloom takes no keys of pip."""

import ast
import os
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from xml.etree import ElementTree

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from trackres_ros.errors import MissingExtraError
from trackres_ros.files.output_files import WRITTEN_WITH

KEYS = {"yaml": "python3-yaml"}
"""Keys that are neither the module nor ``python3-`` before it."""
FOR_DEVELOPERS = {"test", "mutation", "docs", "release", "coverage"}
MESSAGE = re.compile(r"([a-z][a-z0-9_]*)/(?:msg|srv)/[A-Z]")


@pytest.fixture(scope="module")
def package(repository):
    return ElementTree.parse(repository / "package.xml").getroot()


@pytest.fixture(scope="module")
def depended(package):
    return {one.text for kind in ("depend", "exec_depend") for one in package.findall(kind)}


def sources(repository):
    return [path for room in ("trackres_ros", "launch") for path in sorted((repository / room).rglob("*.py"))]


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.partition(".")[0]


def test_all_that_is_imported_is_a_dependency_or_of_an_extra(repository, depended, extras):
    required = (repository / "setup.py").read_text(encoding="utf-8")
    found = {name for path in sources(repository) for name in imported(path)} - sys.stdlib_module_names - {"trackres_ros"}
    assert {"rclpy", "ament_index_python", "rosbag2_py", "numpy"} <= found
    for name in sorted(found):
        if name in extras:
            assert re.search(rf'"{extras[name]}[^\w-]', required), f"{name}: no requirement {extras[name]} in setup.py"
        else:
            assert depended & {name, f"python3-{name}", KEYS.get(name)}, f"{name} is imported, and package.xml does not say so"


def installed_with(keys):
    """Modules that libraries of PyPI bring for keys of rosdep, with all that these need."""
    known, waiting = set(), [name for key in keys if (name := key.removeprefix("python3-")) and name != "yaml"]
    waiting += ["PyYAML", "setuptools", "packaging"]  # Python's own tools, which pytest needs too
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name in known:
            continue
        try:
            needed = [Requirement(text) for text in requires(name) or ()]
        except PackageNotFoundError:  # ROS' own, where there is no ROS
            continue
        known.add(name)
        waiting += [one.name for one in needed if one.marker is None or one.marker.evaluate({"extra": ""})]
    return {module for module, brought_by in packages_distributions().items() if known & set(map(canonicalize_name, brought_by))}


@pytest.mark.long
def test_tests_load_where_only_the_keys_of_package_xml_are(repository, package, depended):
    """As `colcon test` runs them after `rosdep install`: a test that needs more is skipped, none is an error."""
    there = installed_with(depended | {one.text for one in package.findall("test_depend")})
    assert {"numpy", "matplotlib", "pytest", "hypothesis", "jsonschema"} <= there
    assert not there & {"rosbags", "pyarrow", "cyclonedds", "pandas", "distributed", "threadpoolctl"}
    given = {**os.environ, "ONLY_PACKAGE_XML": " ".join(there), "PYTHONPATH": str(repository / "test")}
    given["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # of other plugins, whose libraries are hidden
    command = [sys.executable, "-m", "pytest", "-p", "only_package_xml", "-p", "no:cacheprovider", "--collect-only", "-qq"]
    done = subprocess.run([*command, "test"], cwd=repository, env=given, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr


def test_outputs_of_the_launch_examples_need_no_extra(repository):
    texts = [(repository / path).read_text(encoding="utf-8") for path in ("docs/commands.md", "launch/replay.launch.py")]
    outputs = [name for text in texts for name in re.findall(r"output:=([\w.]+)", text)]
    assert len(outputs) == 2
    assert not [name for name in outputs if name.endswith(tuple(WRITTEN_WITH))]


def test_what_an_error_says_to_install_brings_the_module(extras):
    """Some names of modules are those of other people's packages."""
    own = {module: name for module, name in extras.items() if name != "rosbags"}
    for module, name in own.items():
        assert f"pip install {name} (" in MissingExtraError("this", module, "extra").remedy


def test_the_page_of_commands_has_each_extra_of_users(repository):
    required = (repository / "setup.py").read_text(encoding="utf-8").partition("extras_require={")[2].partition("\n    },")[0]
    extras = set(re.findall(r'^        "(\w+)":', required, re.MULTILINE)) - FOR_DEVELOPERS - {"all"}
    table = (repository / "docs" / "commands.md").read_text(encoding="utf-8").partition("| Extra | For |")[2].partition("\n\n")[0]
    named = {
        name for row in table.splitlines() for name in re.findall(r"`(\w+)`", row.rpartition("|")[0].split("|")[1] if row else "")
    }
    assert named == extras


def test_message_packages_of_the_node_are_dependencies(repository, depended):
    rooms = {"node", "output", "recording"}
    files = [path for path in sources(repository) if rooms & set(path.parts) and "dds" not in path.parts]
    used = {package for path in files for package in MESSAGE.findall(path.read_text(encoding="utf-8"))} - {"package"}
    assert {"geometry_msgs", "diagnostic_msgs"} <= used
    assert used <= depended


def test_nothing_stands_in_the_way_of_a_release(repository, package, depended):
    assert not [key for key in depended if key.endswith("-pip")], "rosdistro takes no keys of pip"
    assert {url.get("type") for url in package.findall("url")} >= {"website", "repository", "bugtracker"}
    assert package.find("author").text
    assert "@" in package.find("maintainer").get("email")
    described, settings = yaml.safe_load_all((repository / "rosdoc2.yaml").read_text(encoding="utf-8"))
    assert described == {"type": "rosdoc2 config", "version": 1}
    assert settings["settings"]["python_source"] == package.find("name").text
    version = re.search(r'version="([^"]+)"', (repository / "setup.py").read_text(encoding="utf-8"))
    assert package.find("version").text == version[1]


def test_make_installs_a_tested_version_of_each_library(repository):
    lines = [one for one in (repository / "constraints.txt").read_text(encoding="utf-8").splitlines() if not one.startswith("#")]
    tested = {canonicalize_name(name): version for name, version in (one.split("==") for one in lines)}
    assert len(tested) == len(lines)
    for required in map(Requirement, requires("trackres_ros") or ()):
        if required.marker is None or any(required.marker.evaluate({"extra": extra}) for extra in ("", "test")):
            assert required.specifier.contains(tested[canonicalize_name(required.name)]), required
    assert "--constraint constraints.txt" in (repository / "Makefile").read_text(encoding="utf-8")
