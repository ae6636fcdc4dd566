# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The controllers in C++, built and run against the node, where ROS 2 is."""

import os
import shutil
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import FLOAT, Node, environment, why_not
from waiting import wait_for

if why_not("ros"):
    pytest.skip(why_not("ros"), allow_module_level=True)

pytestmark = pytest.mark.long
NEAR_NM = 50.0
TEXT = "std_msgs/msg/String"


@pytest.fixture(scope="module")
def built(tmp_path_factory, repository):
    """Install space of the example package, built without a warning."""
    if not shutil.which("colcon"):
        pytest.skip("colcon is not on the path")
    folder = tmp_path_factory.mktemp("controllers")
    shutil.copytree(repository / "examples" / "ros2_feedforward", folder / "src")
    build = ["colcon", "build", "--merge-install", "--cmake-args", "-DCMAKE_CXX_FLAGS=-Werror"]
    plain = {name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"}
    done = subprocess.run(build, cwd=folder, env=plain, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "install"


@contextmanager
def running(command, built, folder):
    """A process of ROS with the example package; its log."""
    prefixes = os.pathsep.join([str(built), os.environ["AMENT_PREFIX_PATH"]])
    libraries = os.pathsep.join([str(built / "lib"), os.environ.get("LD_LIBRARY_PATH", "")])
    given = environment("ros", folder) | {"AMENT_PREFIX_PATH": prefixes, "LD_LIBRARY_PATH": libraries}
    path = folder / f"{Path(command[0]).name}.log"
    with path.open("w") as log:
        process = subprocess.Popen([str(word) for word in command], env=given, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    try:
        yield process, path
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.wait()


def follows_and_lets_go(node, added, log):
    """It adds the node's torque while that drives, and nothing once it has gone."""

    def near():
        node.drive(0.3)
        heard, said = added.update(), node.torques()
        return heard and said and said[-1] > 1000.0 and abs(heard[-1].message.data - said[-1]) < NEAR_NM

    assert wait_for(near, working=node.process.pid), log.read_text()
    node.silent(2.0)
    assert wait_for(lambda: added.update() and added.heard[-1].message.data == 0.0), log.read_text()
    assert wait_for(near), log.read_text()
    assert node.stop() == 0
    assert wait_for(lambda: added.update() and added.heard[-1].message.data == 0.0), log.read_text()


def test_the_cpp_node_adds_feedforward_and_notices_a_hung_node(built, tmp_path, wire):
    node = Node("ros", tmp_path, wire).started()
    added = wire.subscribe("/drive/added_torque", FLOAT)
    try:
        with running([built / "lib" / "trackres_feedforward" / "drive"], built, tmp_path) as (process, log):
            node.drive(0.3)
            node.process.send_signal(signal.SIGSTOP)
            assert wait_for(lambda: "deadline missed" in log.read_text()), log.read_text()
            assert wait_for(lambda: added.update() and added.heard[-1].message.data == 0.0)
            node.process.send_signal(signal.SIGCONT)
            follows_and_lets_go(node, added, log)
            assert process.poll() is None
    finally:
        node.close()


def test_the_controller_of_ros2_control_adds_the_feedforward(built, tmp_path, wire, repository):
    prefixes = [Path(prefix) for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)]
    manager = next((p / "lib" / "controller_manager" for p in prefixes if (p / "lib" / "controller_manager").is_dir()), None)
    if manager is None:
        pytest.skip("ros2_control is not installed: its controller_manager is in none of AMENT_PREFIX_PATH")
    example = repository / "examples" / "ros2_feedforward" / "config"
    described = wire.publisher("/robot_description", TEXT, depth=1, latched=True)
    described.publish(data=(example / "carrier.urdf").read_text())
    node = Node("ros", tmp_path, wire).started()
    added = wire.subscribe("/feedforward/added_torque", FLOAT)
    parameters = ["--ros-args", "--params-file", example / "controllers.yaml"]
    try:
        with running([manager / "ros2_control_node", *parameters], built, tmp_path) as (process, log):
            with running([manager / "spawner", "feedforward"], built, tmp_path) as (spawner, said):
                assert wait_for(lambda: spawner.poll() is not None, working=process.pid), log.read_text()
                assert spawner.returncode == 0, said.read_text() + log.read_text()
            follows_and_lets_go(node, added, log)
            assert process.poll() is None
    finally:
        node.close()
        described.close()
