# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Law: if anything but the step fails, the torque continues unchanged, and the status names the part."""

import importlib
import itertools
import re
import sys
import threading
import time
from pathlib import Path

import pytest

import trackres_ros
from trackres_ros.files.resources import shipped_topics
from trackres_ros.node import record
from trackres_ros.node.record import MB, Recorder, RecordLimits
from trackres_ros.node.transport import Level
from trackres_ros.output import mcap
from trackres_ros.tasks.live import recording_picture

pytest.importorskip("rosbags")

PACKAGE = Path(trackres_ros.__file__).parent
STEP = {  # what makes an estimate and brings it out: without one of them there is none; and the values of checked parameters
    "Session.feed", "InputReader.read", "InputReader.samples",
    "SpeedSources.takes", "FeedforwardFilter.take", "FeedforwardFilter.course", "FeedforwardFilter.move",
    "FeedforwardFilter.age_s", "FeedforwardFilter.max_age_s", "FeedforwardFilter.share",
    "OutputPublisher.take", "OutputPublisher.publish",
}  # fmt: skip
LOOP = "Application", "MessageHandler", "NodeClock", "Guard"
SILENT = {"OutputPublisher.publish_statuses", "bare_status", "Notice.level"}  # without which no status can say what fails
SHAFT = "torque: {topic: shaft, type: geometry_msgs/msg/WrenchStamped, field: wrench.torque.y}\n"


class Failure(BaseException):
    """As a library raises that wants to end the program."""


@pytest.fixture
def node(desk, tmp_path):
    """A node that does everything: it learns, saves its state, and records its inputs and outputs."""
    number = itertools.count()

    def start(rate_hz=50.0):
        d = desk(
            shipped_topics()["default"].read_text() + SHAFT,
            state_file=str(tmp_path / f"state{next(number)}.json"),
            learning="on",
            output_rate_hz=rate_hz,
            save_period_s=1.0,
        )
        d.app.record(lambda *_: None)
        d.app.on_estimate = lambda *_: None
        return d

    return start


def driven(d, seconds=2.0):
    for _ in range(round(seconds)):
        d.drive(1.0, load=250e3, ambient=12.0, torque=3000.0)
        d.app.messages.keep(0, b"raw")
    return [(name, values) for name, _, values in d.published if name.startswith("feedforward")]


def is_of_loop(code):
    return Path(code.co_filename).parent == PACKAGE / "node" and code.co_qualname.partition(".")[0] in LOOP


def called_by_the_application(d):
    """The functions of this package that a drive calls right out of the node's loop, by module and name; without the step."""
    result = set()

    def profile(frame, event, _):
        code, caller = frame.f_code, frame.f_back
        path = Path(code.co_filename)
        if event != "call" or caller is None or not is_of_loop(caller.f_code):
            return
        if path.is_relative_to(PACKAGE) and not is_of_loop(code) and "<" not in code.co_qualname:
            module = ".".join(["trackres_ros", *path.relative_to(PACKAGE).with_suffix("").parts])
            result.add((module, code.co_qualname))

    sys.setprofile(profile)
    try:
        driven(d)
    finally:
        sys.setprofile(None)
    return {(module, name) for module, name in result if name not in STEP and not name.startswith("Parameters.")}


def failing(*_, **__):
    raise Failure("injected")


def put_fault(monkeypatch, d, module, name):
    """Have a function or method fail from now on."""
    home = importlib.import_module(module)
    owner, _, attribute = name.rpartition(".")
    if owner:
        kind = getattr(home, owner)
        broken = property(failing) if isinstance(vars(kind).get(attribute), property) else failing
        monkeypatch.setattr(kind, attribute, broken)
    else:
        application = importlib.import_module("trackres_ros.node.application")
        monkeypatch.setattr(application, attribute, failing)


@pytest.mark.parametrize("rate_hz", [50.0, 0.0])
def test_no_call_besides_the_step_can_change_the_torque(node, monkeypatch, rate_hz):
    total = driven(node(rate_hz))
    calls = called_by_the_application(node(rate_hz))
    assert {"Comparison.take", "LiveLearning.take", "StateKeeper.save_soon", "Watch.every_second", "statuses"} <= {
        n for _, n in calls
    }
    for module, name in sorted(calls):
        d = node(rate_hz)
        with monkeypatch.context() as broken:
            put_fault(broken, d, module, name)
            assert driven(d) == total, name
            if name not in SILENT:
                status = [result[0] for topic, result in d.statuses if topic == "status"][-1]
                assert status.level == Level.WARN, name
                assert "failed because of a bug" in status.message, name
                assert "Failure: injected" in status.message, name
            d.app.close()


@pytest.mark.parametrize("what", ["log", "peers", "publish_status", "keep", "on_estimate"])
def test_no_edge_and_no_recorder_can_change_the_torque(node, monkeypatch, what):
    total, d = driven(node()), node()
    target = d.app if what == "on_estimate" else d
    if what == "keep":
        d.app.record(failing)
    else:
        monkeypatch.setattr(target, what, failing)
    assert driven(d) == total
    monkeypatch.undo()
    if what not in ("log", "publish_status"):  # failures that cannot be reported
        assert "PART_FAILED" in d.names()
    d.forward(7.0)
    assert not {"PART_FAILED", "INTERNAL_ERROR"} & d.names()


def test_outputs_stay_finite_when_the_learner_gives_nan(node, monkeypatch):
    d = node()
    driven(d, 2.0)

    def spoil(stamp, row, session):
        session.learned[:] = float("nan")

    monkeypatch.setattr(d.app.learning.learner, "take", spoil)
    driven(d, 2.0)
    assert d.all_finite()
    assert "PART_FAILED" in d.names()
    assert "INTERNAL_ERROR" not in d.names()


def test_a_blocked_disk_stops_no_estimate_and_losses_are_bounded(node, monkeypatch, tmp_path):
    d, answers = node(), threading.Event()
    monkeypatch.setattr(record, "WRITE_EVERY_S", 0.05)
    monkeypatch.setattr(record, "SHOWN_NS", 200_000_000)
    monkeypatch.setattr(record, "MOST_WAITING_BYTES", 200_000)
    recorder = Recorder(tmp_path / "live.mcap")
    recorder.begin(d.app)
    append = mcap.BagWriter._append
    monkeypatch.setattr(mcap.BagWriter, "_append", lambda self, data: answers.wait() and append(self, data))
    driven(d, 1.0)
    time.sleep(0.3)
    began = time.monotonic()
    driven(d, 3.0)
    assert time.monotonic() - began < 60.0
    (texts,) = [notice for notice in d.app.notices() if notice.name == "NOT_RECORDED"]
    assert texts.level is Level.WARN
    assert "live.mcap.part: the disk has not responded for" in texts.text
    assert re.search(r"lost so far: \d+ messages and [1-9]\d* estimates", texts.text)
    answers.set()
    lines = recorder.end()
    assert (tmp_path / "live.mcap").exists()
    assert any(line.startswith("not recorded: ") for line in lines)


def test_a_picture_that_fails_is_a_line_of_text(node, monkeypatch, tmp_path):
    d, recorder = node(), Recorder(tmp_path / "live.mcap")
    recorder.begin(d.app)
    driven(d, 1.0)
    recorder.end()
    monkeypatch.setattr("trackres_ros.output.plots.estimate_figure", lambda *_, **_path: 1 / 0)
    assert recording_picture(recorder) == [f"no picture {tmp_path / 'live.png'}: division by zero"]


def test_split_files_keep_the_limit_by_deleting_only_the_oldest(node, monkeypatch, tmp_path):
    monkeypatch.setattr(record, "WRITE_EVERY_S", 0.02)
    others = [tmp_path / "live_0000.csv", tmp_path / "other_0000.mcap", tmp_path / "live_0003.mcap"]
    for other_item in others:
        other_item.write_text("of somebody else")
    kept = []
    for _ in range(2):
        d, recorder = node(), Recorder(tmp_path / "live.mcap", RecordLimits(split_mb=0.3, limit_mb=1.5))
        recorder.begin(d.app)
        for _ in range(20):
            driven(d, 1.0)
            time.sleep(0.05)
        lines = recorder.end()
        files = [path for path in sorted(tmp_path.glob("live_*.mcap")) if path not in others]
        assert len(files) > 2
        assert sum(path.stat().st_size for path in files) < 1.6 * MB
        assert "of the oldest files were deleted" in " ".join(lines)
        kept.append([path.name for path in files])
    assert kept[0][0] >= "live_0004.mcap"
    assert kept[1][0] > kept[0][-1] or set(kept[1]) & set(kept[0])
    assert kept[1][-1] > kept[0][-1]
    assert all(other_item.read_text() == "of somebody else" for other_item in others)
