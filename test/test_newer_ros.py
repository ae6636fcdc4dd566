# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The package uses nothing that Kilted, Lyrical or Python 3.14 removed or deprecated since Jazzy (docs/stability.md)."""

import ast
import configparser

import pytest

OUTDATED = {
    "QoSHistoryPolicy": "rclpy.qos.HistoryPolicy",
    "QoSReliabilityPolicy": "rclpy.qos.ReliabilityPolicy",
    "QoSDurabilityPolicy": "rclpy.qos.DurabilityPolicy",
    "QoSLivelinessPolicy": "rclpy.qos.LivelinessPolicy",
    "QoSEventHandler": "rclpy.event_handler.EventHandler",
    "rclpy.qos_event": "rclpy.event_handler",
    "logger.warn": "logger.warning",
    "LaunchConfigurationEquals": "launch.substitutions.EqualsSubstitution",
    "LaunchConfigurationNotEquals": "launch.substitutions.NotEqualsSubstitution",
    "LaunchDescriptionArgument": "launch.actions.DeclareLaunchArgument",
    "rmw_serialization_format": "input_serialization_format of rosbag2_py.RecordOptions",
    "pkg_resources": "importlib.metadata",
    "distutils": "setuptools",
    "imp": "importlib",
    "utcnow": "datetime.now(UTC)",
    "tests_require": "extras_require",
    "test_suite": "pytest",
}
"""Names of rclpy, launch, rosbag2_py, Python and setuptools, each with its successor."""
PREFIX = "RMW_QOS_POLICY_"
POOLS = {"multiprocessing", "concurrent.futures.ProcessPoolExecutor"}
"""Processes that Python 3.14 starts by forkserver instead of fork: they see nothing that was changed after an import."""


def used(tree):
    """Modules, names, attributes and arguments of a file, each with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
            yield from ((name, node.lineno) for name in (node.module or "", *names, *(f"{node.module}.{name}" for name in names)))
        elif isinstance(node, ast.Attribute):
            logger = node.attr == "warn" and ast.unparse(node.value) != "warnings"
            yield ("logger.warn" if logger else node.attr), node.lineno
        elif isinstance(node, ast.Name):
            yield node.id, node.lineno
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value.lineno


def outdated(names):
    """What should not be used, of names with their lines."""
    return [
        f"{line}: {name}: use {OUTDATED.get(name, 'the name without it')}"
        for name, line in names
        if name in OUTDATED or name.startswith(PREFIX)
    ]


@pytest.fixture(scope="module")
def sources(repository):
    """What each file uses."""
    files = [repository / "setup.py"]
    files += [path for room in ("trackres_ros", "launch", "examples") for path in sorted((repository / room).rglob("*.py"))]
    return {path.relative_to(repository).as_posix(): [*used(ast.parse(path.read_text(encoding="utf-8")))] for path in files}


def test_nothing_that_a_newer_ros_dropped_is_used(sources):
    assert len(sources) > 100
    assert not [f"{path}:{one}" for path, names in sources.items() for one in outdated(names)]


@pytest.mark.parametrize(
    "line",
    [
        "import rclpy.qos_event",
        "from rclpy import qos_event; rclpy.qos_event",
        "from rclpy.qos import QoSReliabilityPolicy",
        "policy = rclpy.qos.ReliabilityPolicy.RMW_QOS_POLICY_RELIABILITY_RELIABLE",
        "node.get_logger().warn('x')",
        "setup(tests_require=['pytest'])",
        "from launch.conditions import LaunchConfigurationEquals",
    ],
)
def test_each_kind_of_use_is_found(line):
    assert outdated(used(ast.parse(line)))
    assert not outdated(used(ast.parse("import warnings\nwarnings.warn('x')\nnode.get_logger().warning('x')")))


def test_nothing_starts_processes_by_a_pool(sources):
    assert not {path for path, names in sources.items() if POOLS & {name for name, _ in names}}


def test_setup_cfg_has_keys_with_underscores_only(repository):
    text = (repository / "setup.cfg").read_text(encoding="utf-8")
    sections = configparser.ConfigParser(interpolation=None)
    sections.read_string(text)
    assert not [key for section in ("develop", "install") for key in sections[section] if "-" in key]


def test_the_example_in_cpp_uses_no_macro_that_lyrical_removed(repository):
    text = (repository / "examples" / "ros2_feedforward" / "CMakeLists.txt").read_text(encoding="utf-8")
    assert "ament_target_dependencies" not in text
