# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The transport without ROS alone: bytes, types and presence; its behaviour as a node is tested in test/processes."""

import importlib.util
import os

import pytest

if not importlib.util.find_spec("cyclonedds"):
    collect_ignore_glob = ["test_*.py"]
else:
    import peer

    DOMAIN = peer.domain_of_worker(73)


@pytest.fixture
def environment(tmp_path):
    """Environment of a process on the loopback interface, in a domain of its own, set up as a user would without a file."""
    dropped = ("CYCLONEDDS_URI", "ROS_LOCALHOST_ONLY")
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return {
        **kept,
        "ROS_DOMAIN_ID": str(DOMAIN),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_STATE_HOME": str(tmp_path / "state"),
        "PYTHONFAULTHANDLER": "1",  # see `waiting.exit_code`
    }


@pytest.fixture
def wire(monkeypatch):
    """An independent participant; those that the package makes in this process are in its domain."""
    monkeypatch.setenv("CYCLONEDDS_URI", peer.LOOPBACK)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    made = peer.Wire(DOMAIN)
    yield made
    made.close()
