# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A real node as a service: its messages to the service manager while it starts, runs, hangs and ends."""

import signal
import socket
from types import SimpleNamespace

import pytest
from conftest import Node, why_not
from waiting import exit_code, wait_for


def test_a_service_reports_ready_alive_and_stopping_unless_hung(tmp_path, wire, monkeypatch):
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.setblocking(False)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    told = []

    def listen():
        try:
            while True:
                told.extend(manager.recv(4096).decode().splitlines())
        except BlockingIOError:
            return told

    node = Node("dds", tmp_path, wire)
    try:
        node.until(lambda: "READY=1" in listen(), "READY=1", working=True)
        node.started()
        node.until(lambda: listen().count("WATCHDOG=1") >= 5, "signs of life", meanwhile=lambda: node.drive(0.2))
        node.until(
            lambda: any(line.startswith("STATUS=ok: ") for line in listen()), "a status", meanwhile=lambda: node.drive(0.2)
        )
        node.process.send_signal(signal.SIGSTOP)
        listen()
        told.clear()
        node.drive(1.0)
        assert listen() == []
        node.process.send_signal(signal.SIGCONT)
        node.until(lambda: "WATCHDOG=1" in listen(), "a sign of life")
        node.process.send_signal(signal.SIGTERM)
        assert exit_code(node.process) == 0
        assert "STOPPING=1" in listen()
    finally:
        node.close()
        manager.close()


@pytest.mark.skipif(bool(why_not("ros")), reason="rclpy does not import here")
def test_an_unconfigured_node_is_ready_and_alive(tmp_path, monkeypatch):
    from trackres_ros.node.ros.estimator import _spin

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        requests = SimpleNamespace(to_stop=False)

        def spin_once(timeout_sec):
            wait_for(lambda: False, timeout_sec)
            spun.append(timeout_sec)
            requests.to_stop = len(spun) > 4

        spun = []
        _spin(SimpleNamespace(spin_once=spin_once), SimpleNamespace(application=None), requests)
        assert [manager.recv(4096).decode() for _ in range(2)] == ["READY=1\nWATCHDOG=1", "WATCHDOG=1"]
