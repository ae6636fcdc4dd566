# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An unchanged bag of a real vehicle: the reader's result and notes."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording

pytest.importorskip("rosbags")

from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

DEFAULT = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
BAG = Path(os.environ.get("TRACKRES_REAL_DATA", DEFAULT)) / "rosbag_gps_vehicle" / "bag"

pytestmark = pytest.mark.skipif(not BAG.is_dir(), reason=f"no recording at {BAG}; set TRACKRES_REAL_DATA to its folder")


@pytest.fixture(scope="module")
def recording() -> Recording:
    return Recording.from_source(open_source([BAG]))


def test_speed_equals_decoding_each_message(recording: Recording) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    rows = []
    with Reader(BAG) as reader:
        wanted = [value for value in reader.connections if value.topic == "/odometry"]
        for value, log_ns, raw in reader.messages(wanted):
            message: Any = store.deserialize_cdr(raw, value.msgtype)
            stamp = message.header.stamp
            rows.append((stamp.sec * 10**9 + stamp.nanosec, log_ns, message.twist.twist.linear.x))
    speed = recording.series["speed"]
    assert len(rows) == 2143
    np.testing.assert_array_equal(np.stack((speed.stamp_ns, speed.arrival_ns), axis=1), [row[:2] for row in rows])
    np.testing.assert_array_equal(speed.value, [row[2] for row in rows])


def test_it_says_what_it_guessed_and_met(recording: Recording) -> None:
    assert set(recording.series) == {"speed", "latitude", "longitude", "altitude"}
    report = "\n".join(recording.report())
    assert "guessed from /odometry (nav_msgs/msg/Odometry, twist.twist.linear.x)" in report
    assert "header stamps are" in report
    assert "days before log time" in report
    kinds = {finding.kind for finding in recording.findings}
    assert {"stamp_offset", "quantised"} <= kinds


def test_it_replays_as_it_is(tmp_path: Path, good: Any) -> None:
    """Header stamps two months off, quantised speed and drops to 0: the estimate runs through, and reports them."""
    report = json.loads(good("replay", BAG, "--vehicle", "agri3t", "-o", tmp_path / "out.csv", "--json"))
    assert report["steps"] == report["counters"]["speed"]["accepted"] == 2143
    assert {"stamp_offset", "dropout"} <= {finding["kind"] for finding in report["findings"]}
    assert {reason["reason"] for reason in report["reasons"]} >= {"load_nominal", "ambient_nominal"}
    assert report["last"]["residual_nm"] is None
    assert (tmp_path / "out.png").exists()
