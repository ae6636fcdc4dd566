# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of the node to its service manager: it is reported alive only while its messages leave."""

import configparser
import socket

import pytest


@pytest.fixture
def heard(tmp_path, monkeypatch):
    """Takes the lines that were sent since the last call."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))

        def take():
            results = []
            while True:
                try:
                    results += manager.recv(4096).decode().splitlines()
                except BlockingIOError:
                    return results

        yield take


def test_it_is_ready_and_alive_once_a_message_has_left(heard, desk):
    made = desk()
    assert heard() == []
    made.forward(0.1)
    assert {"READY=1", "WATCHDOG=1"} <= set(heard())
    made.drive(2.0)
    statement = heard()
    assert statement.count("WATCHDOG=1") in range(8, 12)
    assert "READY=1" not in statement
    assert any(line.startswith("STATUS=warn: ") and "nominal load" in line for line in statement)
    made.app.close()
    assert "STOPPING=1" not in heard()  # a lifecycle's cleanup ends no process


def test_a_node_whose_messages_do_not_leave_is_not_alive(heard, wild_desk):
    made = wild_desk(output_rate_hz=50.0)
    made.drive(1.0)
    made.broken = {"publish", "publish_status"}
    made.drive(0.3)  # earlier messages are still reported
    heard()
    made.drive(3.0)
    assert "WATCHDOG=1" not in heard()
    made.broken = set()
    made.drive(1.0)
    assert "WATCHDOG=1" in heard()


def test_a_node_that_is_inactive_by_request_is_alive(heard, desk):
    made = desk()
    made.app.deactivate()
    made.forward(1.0)
    assert heard().count("WATCHDOG=1") in range(4, 7)


@pytest.mark.parametrize("path", ["/nowhere/notify", "@nobody", ""])
def test_a_manager_that_does_not_listen_disturbs_nothing(path, desk, monkeypatch):
    monkeypatch.setenv("NOTIFY_SOCKET", path)
    made = desk()
    made.drive(0.5)
    assert made.last("feedforward_torque_nm")
    assert "INTERNAL_ERROR" not in made.names()


def test_the_unit_starts_the_command_as_it_is_documented(repository, trackres):
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(repository / "examples" / "systemd" / "trackres.service")
    service = unit["Service"]
    assert (service["Type"], service["Restart"]) == ("notify", "always")
    assert float(service["WatchdogSec"]) >= 2.0  # before the first speed a status a second is all that leaves
    command, *words = service["ExecStart"].split()
    assert command.endswith("/trackres")
    outcome = trackres(*[word.replace("/etc/trackres", "/nowhere") for word in words])
    assert outcome.returncode == 2
    assert "/nowhere/params.yaml" in outcome.stderr  # its options are known, its files are the user's
