# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The controllers in C++, built and run against the node or with the exported step, where ROS 2 is."""

import os
import shutil
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from built import EQUAL, write
from conftest import ESTIMATE, FLOAT, Node, environment, why_not
from test_in_process import Vehicle
from waiting import wait_for

from trackres_ros.vehicle import load

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
    write(load("xgd24d"), folder / "export")
    build = ["colcon", "build", "--merge-install", "--cmake-args", "-DCMAKE_CXX_FLAGS=-Werror"]
    build += [f"-DTRACKRES_EXPORT={folder / 'export'}"]
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


@pytest.fixture
def manager():
    """Folder of the programs of controller_manager."""
    prefixes = [Path(prefix) for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)]
    found = next((p / "lib" / "controller_manager" for p in prefixes if (p / "lib" / "controller_manager").is_dir()), None)
    if found is None:
        pytest.skip("ros2_control is not installed: its controller_manager is in none of AMENT_PREFIX_PATH")
    return found


def spawned(manager, built, folder, working, *words):
    """Spawn a controller, or change the state of one."""
    with running([manager / "spawner", *words], built, folder) as (spawner, said):
        assert wait_for(lambda: spawner.poll() is not None, working=working.pid), said.read_text()
        assert spawner.returncode == 0, said.read_text()


def test_the_controller_of_ros2_control_adds_the_feedforward(built, manager, tmp_path, wire, repository):
    example = repository / "examples" / "ros2_feedforward" / "config"
    described = wire.publisher("/robot_description", TEXT, depth=1, latched=True)
    described.publish(data=(example / "carrier.urdf").read_text())
    node = Node("ros", tmp_path, wire).started()
    added = wire.subscribe("/feedforward/added_torque", FLOAT)
    parameters = ["--ros-args", "--params-file", example / "controllers.yaml"]
    try:
        with running([manager / "ros2_control_node", *parameters], built, tmp_path) as (process, log):
            spawned(manager, built, tmp_path, process, "feedforward")
            follows_and_lets_go(node, added, log)
            assert process.poll() is None
    finally:
        node.close()
        described.close()


SPEEDS = '<state_interface name="velocity"/>'
STEP = ("speed_mps", "elapsed_s", "enable", "feedforward_torque_nm", "added_torque_nm")


def steps_of(heard):
    """Speed, elapsed time, whether enabled, feed-forward and added torque of each update."""
    groups = [dict(zip(g.interface_names, g.values, strict=True)) for g in (one.message.interface_values[0] for one in heard)]
    return np.array([[group[name] for name in STEP] for group in groups]).reshape(-1, len(STEP))


@pytest.mark.parametrize("speed_mps", [5.0, 0.0])
def test_the_exported_step_in_a_controller_is_the_replay(built, manager, tmp_path, wire, repository, cyclone, speed_mps):
    example = repository / "examples" / "ros2_feedforward" / "config"
    velocity = f'<state_interface name="velocity"><param name="initial_value">{speed_mps / 0.4}</param></state_interface>'
    described = wire.publisher("/robot_description", TEXT, depth=1, latched=True)
    described.publish(data=(example / "carrier.urdf").read_text().replace(SPEEDS, velocity))
    estimate = wire.subscribe("/in_process/estimate", ESTIMATE)
    command = [manager / "ros2_control_node", "--ros-args", "--params-file", example / "in_process.yaml"]
    try:
        with running(command, built, tmp_path) as (process, log):
            spawned(manager, built, tmp_path, process, "in_process", "--inactive")
            assert wait_for(lambda: estimate.matched == 1, working=process.pid), log.read_text()
            spawned(manager, built, tmp_path, process, "in_process")
            assert wait_for(lambda: len(estimate.update()) >= 150, working=process.pid), log.read_text()
            cyclone.environment["ROS_DOMAIN_ID"] = environment("ros", tmp_path)["ROS_DOMAIN_ID"]
            assert "successful" in cyclone.ros2("param", "set", "/in_process", "enable", "false", "--no-daemon")
            assert wait_for(lambda: (steps := steps_of(estimate.update()))[-1, 2] == 0.0 and steps[-1, 4] == 0.0), log.read_text()
    finally:
        described.close()
    speed, elapsed, enabled, given, added = steps_of(estimate.update()).T
    lines = "".join(f"{v!r} {dt!r} {int(on)}\n" for v, dt, on in zip(speed.tolist(), elapsed.tolist(), enabled, strict=True))
    step = Vehicle(tmp_path / "replay", repository).folder / "step"
    done = subprocess.run([step], input=lines, capture_output=True, text=True, check=True)
    replayed = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert np.abs(added - replayed[:, 0]).max() <= EQUAL * max(1.0, np.abs(replayed[:, 0]).max())
    assert np.abs(given - replayed[:, 1]).max() <= EQUAL * max(1.0, np.abs(replayed[:, 1]).max())
    assert added.max() > 1000.0 if speed_mps else not added.any()


def test_the_export_of_another_vehicle_is_refused(built, manager, tmp_path, wire, repository):
    example = repository / "examples" / "ros2_feedforward" / "config"
    described = wire.publisher("/robot_description", TEXT, depth=1, latched=True)
    described.publish(data=(example / "carrier.urdf").read_text())
    parameters = tmp_path / "other.yaml"
    parameters.write_text((example / "in_process.yaml").read_text().replace("xgd24d", "agri3t"))
    command = [manager / "ros2_control_node", "--ros-args", "--params-file", parameters]
    try:
        with running(command, built, tmp_path) as (process, log):
            with running([manager / "spawner", "in_process"], built, tmp_path) as (spawner, _):
                assert wait_for(lambda: spawner.poll() is not None, working=process.pid), log.read_text()
            assert spawner.returncode != 0
            assert "'agri3t', but the export is of 'xgd24d'" in log.read_text()
            assert process.poll() is None
    finally:
        described.close()
