# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defects found by a Recording, its resampling of series, and its texts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import Finding, FloatArray, SampleBlock

S = 10**9


class Given:
    """A source from a test's data: by role, stamps [s], values, and log times [s] if they differ."""

    name = "given"
    notes = ("a note",)
    findings: tuple[Finding, ...] = ()

    def __init__(self, series: Mapping[str, tuple[object, ...]], zero_is_unset: bool = True) -> None:
        self.roles = tuple(series)
        self.zero_is_unset = zero_is_unset
        self.torque_candidates = ()
        self.rows: list[tuple[int, int, int, float]] = []
        for index, (stamps, values, *logged) in enumerate(series.values()):
            stamp_ns = np.rint(np.multiply(stamps, S)).astype(np.int64)
            log_ns = np.rint(np.multiply(logged[0], S)).astype(np.int64) if logged else stamp_ns
            values = np.broadcast_to(values, stamp_ns.shape)
            self.rows += [
                (int(log), index, int(stamp), float(value)) for log, stamp, value in zip(log_ns, stamp_ns, values, strict=True)
            ]
        self.rows.sort(key=lambda row: row[0])

    def blocks(self, max_rows: int = 7) -> Iterator[SampleBlock]:
        for start in range(0, len(self.rows), 7):
            log, role, stamp, value = zip(*self.rows[start : start + 7], strict=True)
            yield SampleBlock(np.array(role, np.int16), np.array(stamp, np.int64), np.array(log, np.int64), np.array(value))


def recorded(zero_is_unset: bool = True, **series: tuple[object, ...]) -> Recording:
    return Recording.from_source(Given({role.replace("__", "/"): value for role, value in series.items()}, zero_is_unset))


def found(recording: Recording, role: str = "speed") -> dict[str, Finding]:
    return {finding.kind: finding for finding in recording.findings if finding.role == role}


def smooth(count: int, rate: float = 10.0) -> tuple[FloatArray, FloatArray]:
    time = 100.0 + np.arange(count) / rate
    return time, 5.0 + np.sin(time) + 0.1 * np.sin(37.0 * time)


def test_nothing_is_found_in_a_clean_series() -> None:
    recording = recorded(speed=smooth(2000), load=(100.0 + np.arange(200), 2e5))
    assert recording.findings == ()
    assert len(recording.series["speed"]) == 2000
    np.testing.assert_allclose(recording.time_s("speed"), np.arange(2000) / 10, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "kind", "count", "first", "says"),
    [
        (lambda t, v: (t, np.where(np.isin(np.arange(len(t)), [5, 9]), np.nan, v)), "non_finite", 2, 0.5, "2 values"),
        (lambda t, v: (np.where(np.arange(len(t)) == 50, 0.0, t), v, t), "zero_stamp", 1, 5.0, "zero"),
        (lambda t, v: (np.where(np.arange(len(t)) == 50, t - 0.1, t), v, t), "duplicate_stamp", 1, 4.9, "equal"),
        (lambda t, v: (np.where(np.arange(len(t)) >= 50, t - 3.0, t), v, t), "backward_stamp", 1, 2.0, "up to 2.9 s"),
        (lambda t, v: (np.where(np.arange(len(t)) >= 50, t + 4.0, t), v), "gap", 1, 4.9, "the longest 4.1 s"),
        (lambda t, v: (t, np.rint(v * 3.6) / 3.6), "quantised", 1, 0.0, "0.2778 m/s (1 km/h)"),
        (lambda t, v: (t, np.where(np.arange(len(t)) > 300, 4.0, v)), "stuck", 1699, 30.1, "one non-zero value"),
        (lambda t, v: (t, np.where(np.isin(np.arange(len(t)), [20, 40]), 0.0, v)), "dropout", 2, 2.0, "exactly 0"),
        (lambda t, v: (t, v * np.nan), "empty", 2000, np.nan, "none of 2000"),
        (lambda t, v: (t[:0], v[:0]), "empty", 0, np.nan, "no sample at all"),
        (lambda t, v: (np.where(np.arange(len(t)) >= 50, t + 3 * 86400, t), v, t), "stamp_jump", 1, 4.9, "by up to 3 days"),
        (lambda t, v: (t, v, t + 61.2 * 86400), "stamp_offset", 2000, 0.0, "61.2 days before log time"),
    ],
)
def test_each_kind_is_found_where_it_is(change: object, kind: str, count: int, first: float, says: str) -> None:
    assert callable(change)
    finding = found(recorded(speed=change(*smooth(2000))))[kind]
    assert finding.count == count
    assert finding.first_time_s == pytest.approx(first, abs=1e-6, nan_ok=True)
    assert says in finding.text


def test_a_jump_of_the_stamps_is_no_gap() -> None:
    time, speed = smooth(100)
    paused = time + np.where(np.arange(100) >= 50, 7.0, 0.0)
    jumped = paused + np.where(np.arange(100) >= 50, 3 * 86400.0, 0.0)
    assert "gap" not in found(recorded(speed=(jumped, speed, time)))
    assert "the longest 7.1 s" in found(recorded(speed=(jumped, speed, paused)))["gap"].text
    assert "stamp_jump" not in found(recorded(speed=(paused, speed, paused + 0.2)))


def test_findings_have_the_time_of_the_output(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which begins at the first speed that is not refused, though the clock is set back later, or lags behind the log."""
    monkeypatch.setattr("trackres_ros.tasks.replay_run.BLOCK_ROWS", 100)
    time, speed = smooth(400)
    speed[[100, 350]] = 0.0
    set_back = np.where(np.arange(400) >= 300, time - 50.0, time)
    assert found(recorded(speed=(set_back, speed, time)))["dropout"].first_time_s == pytest.approx(10.0)
    assert found(recorded(speed=(set_back, speed, time)))["backward_stamp"].first_time_s == pytest.approx(-20.0)
    speed[:20] = 999.0
    for first, begins in ((100.0, 100.0), (0.0, 105.0)):  # of a stamp that was never set the log tells the time
        stamps = np.append(first, time[1:])
        recording = recorded(speed=(stamps, speed, time + 5.0), load=([0.0, 131.0], 2.7e5, [135.0, 136.0]))
        assert found(recording, "load")["zero_stamp"].first_time_s == pytest.approx(30.0)
        assert found(recording)["dropout"].first_time_s == pytest.approx(110.0 - begins)
        result = tr.replay(recording, "xgd24d")
        assert {finding.kind: finding.first_time_s for finding in result.findings}["dropout"] == pytest.approx(8.0)
        assert result["stamp_ns"][0] == 102 * S


@pytest.mark.parametrize("delay_s", [0.1, 5.0])
def test_a_delay_of_the_torque_is_no_defect(tmp_path: Path, delay_s: float) -> None:
    rows = "".join(f"{t / 10},{5 + math.sin(t)},{1000 + t}\n" for t in range(100))
    (tmp_path / "drive.csv").write_text(f"time_s,speed_mps,torque_nm\n{rows}")
    result = tr.replay(tmp_path / "drive.csv", "xgd24d", topics={"torque": {"column": "torque_nm", "delay_s": delay_s}})
    read = tr.read(tmp_path / "drive.csv", topics={"torque": {"column": "torque_nm", "delay_s": delay_s}})
    assert list(result.findings) == list(read.findings) == []
    assert result.as_dict()["counters"]["torque"] == {"accepted": 100}


def test_what_is_normal_is_not_found() -> None:
    time = np.arange(2000) / 10.0
    ramp_and_hold = np.minimum(time, 50.0) / 3.6
    recording = recorded(
        zero_is_unset=False,
        speed=(time, ramp_and_hold),
        ambient=(time, 15.0),
        load=(time, 2e5),
        heading=(time, 1.0),
        distance=(time, 3.0),
        torque=(time, 0.0),
    )
    assert {(finding.role, finding.kind) for finding in recording.findings} == {("speed", "stuck")}


def test_zero_is_a_time_in_a_table_and_unset_in_a_bag() -> None:
    time = np.arange(100) / 10.0
    table, bag = (recorded(unset, speed=(time, np.sin(time))) for unset in (False, True))
    assert "zero_stamp" not in found(table)
    assert found(bag)["zero_stamp"].count == 1
    assert table.time_s("speed")[1] == bag.time_s("speed")[1] == 0.1
    for deviation in (0.0, -5e8):  # of a stamp from the log
        stamps = np.where(time % 0.5 < 0.01, 0.0, 1e9 + deviation + time)
        unset = recorded(speed=(stamps, np.rint(np.sin(time)), 1e9 + time), load=(0.0 * time, 2e5, 1e9 + time))
        np.testing.assert_allclose(unset.time_s("speed"), time, atol=1e-6)
        assert "100 samples at 10 Hz" in "\n".join(unset.report())
        np.testing.assert_allclose(unset.time_s("load"), time - deviation, atol=1e-6)
        assert found(unset).keys() <= {"zero_stamp", "quantised", "stamp_offset"}
    for result_before in (1e3, 1.7e9):  # a first time of 0, and then others
        late = {"speed": (np.append(0.0, result_before + time), np.append(0.0, np.sin(time)))}
        assert found(Recording.from_source(Given(late, zero_is_unset=False)))["gap"].count == 1
        assert "gap" not in found(Recording.from_source(Given(late, zero_is_unset=True)))


def test_aligned_holds_what_had_arrived() -> None:
    recording = recorded(
        speed=([1.0, 2.0, 3.0, 4.0], [1.0, np.nan, 3.0, 4.0]),
        load=([0.5, 1.5, 3.0], [10.0, 20.0, 30.0], [1.5, 2.0, 3.5]),
        belt__rear=([1.0, 2.5], [7.0, np.nan]),
        ambient=([], []),
    )
    held = recording.aligned()
    np.testing.assert_array_equal(held["time_s"], [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(held["speed"], [1.0, np.nan, 3.0, 4.0])
    np.testing.assert_array_equal(held["load"], [np.nan, 20.0, 20.0, 30.0])
    np.testing.assert_array_equal(held["belt/rear"], [7.0, 7.0, 7.0, 7.0])
    assert np.isnan(held["ambient"]).all()


@given(st.lists(st.tuples(st.integers(-2, 3), st.booleans(), st.floats(-9, 9)), max_size=40))
def test_aligned_never_sees_the_future(log: list[tuple[int, bool, float]]) -> None:
    """In the order of the log, though its time steps back."""
    source = Given({"speed": ([], []), "load": ([], [])})
    source.rows = [
        (int(sample_times), int(load), 0, value)
        for sample_times, (_, load, value) in zip(np.cumsum([s for s, *_ in log]), log, strict=True)
    ]
    held, last = iter(Recording.from_source(source).aligned()["load"]), np.nan
    for _, rows in groupby(source.rows, key=itemgetter(0)):
        together = list(rows)
        last = [last, *(value for _, load, _, value in together if load)][-1]
        for _, load, *_ in together:
            if not load:
                np.testing.assert_equal(next(held), last)


def test_the_report_says_it_all() -> None:
    time, speed = smooth(200)
    speed[7] = np.inf
    report = recorded(speed=(time, speed), load__front=(time[:3], 1e5), torque=([], [])).report()
    assert report[0] == "Recording given"
    assert "  speed [m/s]: 200 samples at 10 Hz, " in "\n".join(report)
    assert "  load/front [N]: 3 samples at 10 Hz, 100000 to 100000" in report
    assert "  a note" in report
    assert "  speed: 1 value is not finite (first at 0.70 s)" in report
    assert "  torque: no sample at all" in report


def test_no_speed_starts_with_the_first_role() -> None:
    recording = recorded(load=([5.0, 6.0], [1.0, 2.0]))
    np.testing.assert_array_equal(recording.time_s("load"), [0.0, 1.0])
