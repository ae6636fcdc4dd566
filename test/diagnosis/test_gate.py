# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gate: what an engineer gets wrong is said with the line that mends it, and what is healthy passes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from csv_tables import columns_of, rewritten
from hypothesis import given, settings
from hypothesis import strategies as st

from proofs.sealed.cases import CATALOGUE, OUTSIDE, Case
from proofs.sealed.recordings import make_case
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.preparation import checked_sessions
from trackres_ros.diagnosis.prepare.checks import Course, same_drive
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.torque_checks import nothing_to_conclude
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.effects.effect import Active
from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import Series


def judged(paths, loaded):
    return checked_sessions(read_recordings(paths, None), loaded)[0]


@pytest.fixture
def with_first(recorded, loaded, tmp_path):
    """Judges recordings of which the first is changed: the result, and the notes on that one."""

    def judge(change, count=2):
        first, *others = recorded(count=count)
        path = rewritten(first, tmp_path, change)
        result = judged([path, *others], loaded)
        return result, [n.removeprefix(f"{path}: ") for n in result.notes if n.startswith(f"{path}: ")]

    return judge


def filled(found):
    """Seconds in gaps that were filled."""
    return [seconds for reason, seconds in found.exclusions.items() if "filled" in reason]


def scaled(name, scale=1.0, offset=0.0):
    """A change: the column as another unit shows it."""

    def change(columns):
        columns[name] = (columns[name] - offset) / scale

    return change


def with_distance(columns):
    columns["distance_m"] = np.cumsum(columns["speed_mps"]) * 0.2
    columns["speed_mps"] *= 3.6


WRONG = {
    "ambient in kelvin": (scaled("ambient_degc", 1.0, -273.15), "ambient: {column: ambient_degc, offset: -273.15}"),
    "ambient in fahrenheit": (
        lambda c: c.update(ambient_degc=0.0 * c["ambient_degc"] + 68.0),
        "ambient: {column: ambient_degc, scale: 0.555556, offset: -17.7778}",
    ),
    "belt in kelvin": (scaled("belt_degc", 1.0, -273.15), "belt: {column: belt_degc, offset: -273.15}"),
    "load in kg": (scaled("weight_n", 9.80665), "load: {column: weight_n, scale: 9.80665}"),
    "load in kN": (scaled("weight_n", 1000.0), "load: {column: weight_n, scale: 1000.0}"),
    "load in t": (scaled("weight_n", 9806.65), "load: {column: weight_n, scale: 9806.65}"),
    "load of the payload": (lambda c: c.update(weight_n=c["weight_n"] - 0.99 * c["weight_n"].min()), "offset"),
    "yaw rate in degrees": (scaled("yaw_rate_radps", np.pi / 180.0), "yaw_rate: {column: yaw_rate_radps, scale: 0.0174533}"),
    "heading in degrees": (
        lambda c: c.update(heading_rad=np.degrees(np.angle(np.exp(1j * c["heading_rad"])))),
        "heading: {column: heading_rad, scale: 0.0174533}",
    ),
    "grade in percent": (lambda c: c.update(grade=2.0 * np.sin(c["time_s"] / 60.0)), "grade: {column: grade, scale: 0.01}"),
    "speed in km/h": (scaled("speed_mps", 1.0 / 3.6), "speed: {column: speed_mps, scale: 0.277778}"),
    "speed in km/h beside a distance": (with_distance, "speed: {column: speed_mps, scale: 0.277778}"),
    "accel in g": (scaled("accel_mps2", 9.80665), "accel: {column: accel_mps2, scale: 9.80665}"),
    "torque of one side": (scaled("torque_nm", 2.0), "torque: {column: torque_nm, scale: 2.0}"),
    "torque of one track": (scaled("torque_nm", 4.0), "torque: {column: torque_nm, scale: 4.0}"),
    "torque counted twice": (scaled("torque_nm", 0.4), "scale"),
    "torque in kNm": (scaled("torque_nm", 1000.0), "torque: {column: torque_nm, scale: 1000.0}"),
    "torque with the other sign": (scaled("torque_nm", -1.0), "torque: {column: torque_nm, scale: -1.0}"),
}


@pytest.mark.parametrize("what", ["ambient in kelvin", "speed in km/h", "torque in kNm", "torque with the other sign"])
def test_what_is_wrong_is_said_with_the_line_that_mends_it(run, recorded, tmp_path, what):
    change, text = WRONG[what]
    process = run([rewritten(path, tmp_path, change) for path in recorded()], tmp_path / "out")
    assert isinstance(process.exception, InputError)
    assert text in str(process.exception)
    assert not (tmp_path / "out" / "vehicle.yaml").exists()


@pytest.mark.parametrize(("parts", "share"), [(("load/front", "load/rear"), 0.5), (("load/rear_left",), 0.25)])
def test_a_load_in_parts_gets_the_lines_of_all_parts(parts, share, recorded, loaded):
    (recording, *_) = read_recordings(recorded(), None)
    of_all = recording.series["load"]
    part = replace(of_all, value=share * of_all.value / 9806.65)
    series = {**{role: s for role, s in recording.series.items() if role != "load"}, **dict.fromkeys(parts, part)}
    bindings = {role: TopicBinding(column=role[-4:]) for role in parts}
    with pytest.raises(InputError) as error_info:
        gate([replace(recording, series=series, bindings=bindings)], loaded.known)
    lines = [f"{role}: {{column: {bindings[role].column}, scale: 9806.65}}" for role in parts]
    assert str(error_info.value).endswith(f"in the topics file should be {' and '.join(lines)}")


def test_only_vehicles_with_belts_have_notes_on_belts(recorded, loaded):
    for name in ("xgd24d", "bmw_i3"):
        base = load_base(name)
        assert base.known.has_belt == base.base.has_belt
    recordings = read_recordings(recorded(), None)
    for has_belt in (True, False):
        notes = gate(recordings, replace(loaded.known, has_belt=has_belt)).notes
        assert any("belt" in note for note in notes) == has_belt


def test_a_slow_speed_in_kmh_is_detected_from_inertia_torque(loaded, tmp_path):
    def in_kmh(columns):
        columns.pop("accel_mps2")  # that would tell
        columns["speed_mps"] *= 3.6

    rng = np.random.default_rng(3)
    slow = drives(loaded.base, 0.9 * loaded.known.max_speed / 3.6, 2, 8.0, rng)
    paths = write_recordings(loaded.base, tmp_path, slow, [], rng)
    with pytest.raises(InputError, match=r"speed: \{column: speed_mps, scale: 0.277778\}"):
        judged([rewritten(path, tmp_path, in_kmh) for path in paths], loaded)


@pytest.mark.parametrize("name", sorted({**CATALOGUE, **OUTSIDE}))
def test_no_effect_that_nature_has_is_refused(tmp_path, name):
    rng = np.random.default_rng(3)
    hidden = {name: {key: float(x) for key, x in {**CATALOGUE, **OUTSIDE}[name](rng, 1.5).items()}}
    build = dict.fromkeys(("loss", "bearing", "drag", "film", "capacity"), 1.0)
    case = Case("case", "single", hidden, build, False, False, False, True, 5)
    make_case(tmp_path, 4.0, case)
    folder = tmp_path / "cases" / "case"
    passed = judged(sorted(folder.glob("drive*.csv")), load_base(folder / "vehicle.yaml"))
    assert len(passed.sessions) >= 3
    assert not any("filled" in reason for reason in passed.exclusions)
    assert not any("clocks overlap" in note or "unusual" in note for note in passed.notes)


def test_nothing_is_concluded_if_the_mean_beats_the_model():
    worse = {"nominal": -0.4, "refitted": -0.3, "with_effects": -0.2}
    deviations = {"nominal": 300.0, "refitted": 290.0, "with_effects": 280.0}
    refusal = nothing_to_conclude("a.csv", worse, deviations, 500.0)
    assert "R2 -0.20" in str(refusal)
    assert "no conclusion is possible" in str(refusal)
    assert nothing_to_conclude("a.csv", {**worse, "nominal": 0.1}, deviations, 500.0) is None
    assert nothing_to_conclude("steady.csv", worse, deviations, 5000.0) is None


def test_a_gap_filled_by_straight_lines_is_left_out_and_counted(with_first, recorded, loaded):
    begin, end = 200.0, 260.0

    def fill(columns):
        time = columns["time_s"] - columns["time_s"][0]
        is_inside = (time > begin) & (time < end)
        for name in columns:
            columns[name][is_inside] = np.interp(time[is_inside], time[~is_inside], columns[name][~is_inside])

    result, _ = with_first(fill)
    (count,) = filled(result)
    assert end - begin - 1 <= count <= end - begin + 2
    assert not result.sessions[0].used[round(begin) + 1 : round(end) - 1].any()
    assert not filled(judged(recorded(), loaded))


SENSORS = {"fine": (0.01 / 3.6, 1.0), "usual": (0.1 / 3.6, 5.0), "coarse": (1.0 / 3.6, 50.0)}  # resolution [m/s], [Nm]


def shown(columns, sensors):
    """Rounds speed and torque as a bus does."""
    for name, step in zip(("speed_mps", "torque_nm"), SENSORS[sensors], strict=True):
        columns[name] = np.round(columns[name] / step) * step


@pytest.mark.parametrize("sensors", ["fine", "usual"])
@pytest.mark.parametrize("of", [("speed_mps", "torque_nm"), ("speed_mps",), ("torque_nm",)])
def test_lines_in_a_gap_show_within_the_resolution_of_a_sensor(with_first, recorded, sensors, of):
    def fill(columns):
        columns["speed_mps"] += np.random.default_rng(4).normal(0.0, 0.05, len(columns["speed_mps"]))  # as of wheels on a road
        inside = np.zeros(len(columns["time_s"]), dtype=bool)
        inside[gap] = True
        for name in of:
            columns[name][inside] = np.linspace(columns[name][gap.start], columns[name][gap.stop], inside.sum())
        shown(columns, sensors)

    speed, torque = (columns_of(recorded()[0])[name] for name in ("speed_mps", "torque_nm"))
    rises = np.abs((speed[300:] - speed[:-300]) * (torque[300:] - torque[:-300]))
    gap = slice(int(np.argmax(rises)), int(np.argmax(rises)) + 300)
    result, _ = with_first(fill)
    (count,) = filled(result)
    assert 56 <= count <= 62
    assert not result.sessions[0].used[gap.start // 5 + 2 : gap.stop // 5 - 2].any()


@pytest.mark.parametrize("sensors", SENSORS)
def test_no_sensor_that_rounds_shows_a_filled_gap(recorded, loaded, tmp_path, sensors):
    result = judged([rewritten(path, tmp_path, lambda c: shown(c, sensors)) for path in recorded()], loaded)
    assert not any("filled" in reason or "repeated" in reason for reason in result.exclusions)


def test_a_last_value_that_is_repeated_is_left_out_and_counted(with_first):
    def hold(columns):
        for name in ("speed_mps", "torque_nm"):
            columns[name][1000:1200] = columns[name][1000]

    result, _ = with_first(hold)
    assert [seconds for reason, seconds in result.exclusions.items() if "repeated" in reason] == [pytest.approx(40, abs=1)]
    assert not result.sessions[0].used[201:239].any()


def since(path, seconds):
    """A change: the recording begins so long after another one."""
    begin = columns_of(path)["time_s"][0] + seconds
    return lambda c: c.update(time_s=c["time_s"] - c["time_s"][0] + begin)


def test_two_recordings_of_one_time_are_refused_by_name(loaded, recorded, tmp_path):
    item, other = recorded()
    meanwhile = rewritten(other, tmp_path, since(item, 60.0))
    with pytest.raises(InputError, match="both recordings cover") as error:
        judged([item, meanwhile], loaded)
    assert error.value.where == f"{item}, {meanwhile}"


def from_zero(columns):
    columns["time_s"] -= columns["time_s"][0]


def rounded(columns):
    from_zero(columns)
    columns["speed_mps"] = np.round(columns["speed_mps"], 4)


def days_later(columns):
    columns["time_s"] += 5 * 86400.0


def rows(choose):
    """A change: the rows that `choose` picks of so many."""
    return lambda columns: columns.update({name: x[choose(len(x))] for name, x in columns.items()})


cut, tail = rows(lambda n: np.arange(n * 2 // 3)), rows(lambda n: np.arange(n // 3, n))
repeated = rows(lambda n: np.concatenate([np.arange(n // 2), np.arange(n // 2 - 10, n)]))


@pytest.mark.parametrize("change", [None, from_zero, rounded, days_later, cut, tail, repeated])
def test_a_drive_given_twice_is_refused_with_any_clock(recorded, loaded, tmp_path, change):
    item, other = recorded()
    repetition = rewritten(item, tmp_path, change, "again.csv") if change else item
    with pytest.raises(InputError, match="each drive once") as error:
        judged([item, other, repetition], loaded)
    assert error.value.where in (f"{item}, {repetition}", f"{repetition}, {item}")


def course(seconds, speed, torque, at=slice(None), begin=1.7e9):
    """What two recordings are compared by, of some samples at 10 Hz."""
    stamp = (10**8 * np.arange(round(10 * seconds)) + int(begin * 1e9))[at]
    series = {role: Series(stamp, stamp, x[at]) for role, x in (("speed", speed), ("torque", torque))}
    return Course.of(Recording("x", series), tuple(series))


def driven(seconds, seed, speed_step=0.0, torque_step=0.0):
    """A drive in traffic, as a bus with these resolutions shows it."""
    random, n = np.random.default_rng(seed), round(10 * seconds)
    accel = np.repeat(random.uniform(-1.0, 1.0, n // 50 + 1), 50)[:n]
    speed = 8.0 + np.cumsum(accel - accel.mean()) * 0.1
    torque = 500.0 * accel + random.normal(0.0, 20.0, n)
    return [np.round(x / step) * step if step else x for x, step in ((speed, speed_step), (torque, torque_step))]


@settings(max_examples=12)
@given(st.integers(0, 1100), st.integers(800, 1900), st.sampled_from([0.0, 0.1 / 3.6]), st.integers(2, 50))
def test_any_part_of_a_drive_is_known_again(first, length, step, lacks):
    speed, torque = driven(300.0, 1, step, 10.0 * step)
    part = np.arange(first, first + length)
    repetition = course(300.0, speed, torque, part, 5e8)
    assert same_drive(course(300.0, speed, torque), repetition)
    assert same_drive(repetition, course(300.0, speed, torque))
    with_others = np.sort(np.concatenate([part, part[:lacks]]))  # an overlapping export with repeated rows
    assert same_drive(course(300.0, speed, torque, slice(0, first + length)), course(300.0, speed, torque, with_others))


def test_two_drives_are_not_one_at_any_resolution():
    for steps in ((0.0, 0.0), (0.1 / 3.6, 1.0), (1.0 / 3.6, 50.0), (1.0, 1e9)):
        assert not same_drive(course(1800.0, *driven(1800.0, 1, *steps)), course(1500.0, *driven(1500.0, 2, *steps)))


def test_a_constant_speed_in_common_is_no_proof():
    for seconds in (300.0, 310.0):
        n = round(10 * seconds)
        settling = 400.0 + 50.0 * np.exp(-np.arange(n) / 3000.0)
        for speed, torque in ((0.0, 0.0), (5.0, 400.0), (5.0, settling)):
            full = [np.broadcast_to(x, n).astype(float) for x in (speed, torque)]
            assert not same_drive(course(seconds, *full), course(seconds, *full, slice(100, None)))


def test_a_cycle_driven_twice_with_another_torque_is_two_drives(recorded, loaded, tmp_path):
    def other_torque(columns):
        from_zero(columns)
        columns["torque_nm"] *= 1.01

    item, _ = recorded()
    judged([item, rewritten(item, tmp_path, other_torque, "again.csv")], loaded)


def test_slightly_overlapping_clocks_are_noted_unless_undated(recorded, loaded, tmp_path):
    item, other = recorded()
    length = 600.0
    later = rewritten(other, tmp_path, since(item, length - 20.0), "later.csv")
    (note,) = [n for n in judged([item, later], loaded).notes if "clocks overlap by" in n]
    assert "later.csv" in note
    undated = [rewritten(path, tmp_path, from_zero) for path in recorded()]
    assert not any("clocks overlap" in n for n in judged(undated, loaded).notes)


def off_odometer(columns):
    columns["distance_m"] = np.cumsum(columns["speed_mps"]) * 0.19


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        (lambda _: None, None),
        (rows(lambda _: slice(400)), "not used: "),
        (off_odometer, "than the recorded distance implies"),
        (lambda columns: columns.update(yaw_rate_radps=0.0 * columns["yaw_rate_radps"]), "yaw_rate never changes"),
        (lambda columns: columns.update(ambient_degc=0.0 * columns["ambient_degc"] + 45.0), "air of 45 degC is unusual"),
    ],
)
def test_only_notes_to_act_on_are_warnings(with_first, change, warning):
    result, _ = with_first(change)
    assert len(result.notes) > len(result.warnings) == (warning is not None)
    assert all(warning in note for note in result.warnings), result.warnings


# One recording among others


@pytest.mark.parametrize("what", WRONG)
def test_one_wrong_recording_is_left_out_with_the_line(with_first, recorded, what):
    change, text = WRONG[what]
    result, notes = with_first(change, count=3)
    assert [s.name for s in result.sessions] == [str(path) for path in recorded(count=3)[1:]]
    (note,) = [n for n in notes if n.startswith("not used: ")]
    assert text in note
    assert [seconds for reason, seconds in result.exclusions.items() if "left out" in reason] == [pytest.approx(600, abs=1)]


def without_torque(columns):
    columns["torque_nm"] *= np.nan


def standing(columns):
    columns["speed_mps"] *= 0.0


def mostly_standing(columns):
    columns["speed_mps"][150:] = 0.0


def stuck(columns):
    columns["torque_nm"] = columns["torque_nm"] * 0.0 + 500.0


UNUSABLE = {
    without_torque: "no torque",
    standing: "a vehicle that moves",
    mostly_standing: "s of driving with a torque",
    stuck: "s torque stuck",
    rows(lambda _: slice(400)): "at least 120 s",
    rows(lambda _: slice(None, None, 300)): "record speed and torque more often",  # one in a minute
    rows(lambda _: slice(None, None, 50)): "diagnose it without the others",
}


@pytest.mark.parametrize("change", UNUSABLE, ids=UNUSABLE.values())
def test_one_unusable_recording_is_left_out_with_a_reason(with_first, recorded, change):
    result, notes = with_first(change, count=3)
    assert [s.name for s in result.sessions] == [str(path) for path in recorded(count=3)[1:]]
    assert {s.step for s in result.sessions} == {1.0}
    (note,) = [n for n in notes if n.startswith("not used: ")]
    assert UNUSABLE[change] in note


def test_where_no_recording_is_usable_the_error_has_each_reason(recorded, loaded, tmp_path):
    wrong = [rewritten(path, tmp_path, change) for path, change in zip(recorded(count=3), UNUSABLE, strict=False)]
    with pytest.raises(InputError) as error:
        judged(wrong, loaded)
    for path, text in zip(wrong, UNUSABLE.values(), strict=False):
        assert path.name in str(error.value)
        assert text in str(error.value)


def test_a_drive_that_is_left_out_has_warmed_the_next_one(recorded, loaded, tmp_path):
    item, other, last = recorded(count=3)
    begins = [float(path.read_text().splitlines()[1].split(",")[0]) for path in (item, other, last)]

    def close_behind(columns):
        columns["time_s"] += begins[0] - begins[1] + 900.0

    def left_out(columns):
        close_behind(columns)
        without_torque(columns)

    def at_last(columns):
        columns["time_s"] += begins[0] - begins[2] + 1800.0

    warmed = judged([item, rewritten(other, tmp_path, left_out), rewritten(last, tmp_path, at_last)], loaded).sessions[1]
    assert warmed.after_unseen
    assert warmed.gap == pytest.approx(300.0, abs=1.0)


# Clocks


HOUR_S = 3600.0


def late(*names, by=HOUR_S):
    """A change: what a merge of two tables gives where the clock of some columns is late; nothing stands where one has no row."""

    def change(columns):
        empty = np.full(round(by / 0.2), np.nan)
        for name, values in columns.items():
            columns[name] = np.concatenate((empty, values) if name in names else (values, empty))
        columns["time_s"] = columns["time_s"][0] + 0.2 * np.arange(len(columns["time_s"]))

    return change


def test_a_torque_an_hour_late_is_moved_and_all_of_it_compared(with_first, recorded, loaded):
    healthy = judged(recorded(), loaded)
    result, notes = with_first(late("torque_nm", "weight_n"))
    assert abs(int(result.sessions[0].used.sum()) - int(healthy.sessions[0].used.sum())) <= 2
    assert np.corrcoef(result.sessions[0].torque[20:580], healthy.sessions[0].torque[20:580])[0, 1] > 0.99
    text = " ".join(notes)
    assert "torque: its clock differs from the speed's by +3600 s; corrected" in text
    assert "load: its clock differs from the speed's by +3600 s; corrected (by the torque)" in text


def test_a_load_an_hour_late_is_not_used_and_noted(with_first):
    result, notes = with_first(late("weight_n", "ambient_degc"))
    assert "load" not in result.sessions[0].given
    assert "ambient" in result.sessions[0].given
    text = " ".join(notes)
    assert "load is recorded from 3600 s to 4200 s, the speed from 0 s to 600 s: its clock seems to be +3600 s off" in text


@pytest.mark.parametrize("change", ["late", "never", "some"])
def test_header_stamps_an_hour_late_or_never_set_are_as_the_log(recorded, loaded, change):
    (recording, other) = read_recordings(recorded(), None)
    recording, series = replace(recording, zero_is_unset=True), dict(recording.series)
    for role in ["load"] if change == "late" else series:
        stamps, third = series[role].stamp_ns, np.arange(len(series[role])) % 3 == 1
        deviation = {"late": stamps + 3_600_000_000_000, "never": 0 * stamps, "some": np.where(third, 0, stamps)}[change]
        series[role] = replace(series[role], stamp_ns=deviation)
    result, *_ = checked_sessions([replace(recording, series=series), other], loaded)
    healthy, *_ = checked_sessions([recording, other], loaded)
    corrected = [note for note in result.notes if note not in healthy.notes]
    assert [note.partition("load: ")[2] for note in corrected] == [
        "its clock differs from the speed's by +3600 s; corrected (by the log time)"
    ] * (change == "late")
    for item in ("weight", "speed", "torque", "ambient"):
        np.testing.assert_array_equal(getattr(result.sessions[0], item), getattr(healthy.sessions[0], item))


def test_an_effect_without_its_input_is_named(recorded, xgd24d, effects):
    winds = replace(xgd24d, surroundings=(Active(effects["headwind"], {"from_ahead": 5.0, "from_left": 0.0}),))
    for hidden in ((), ("yaw_rate", "heading")):
        result, *_ = checked_sessions(read_recordings(recorded(count=2), None), load_base(winds), hidden)
        named = [note for note in result.warnings if "headwind" in note]  # once for all recordings
        text = "headwind of the vehicle or its surroundings is left out, as heading is not known"
        assert named == [f"{', '.join(s.name for s in result.sessions)}: {text}"] * bool(hidden)


def test_an_unlike_torque_an_hour_late_is_left_out(with_first):
    def change(columns):
        columns["torque_nm"] = np.roll(columns["torque_nm"], 1111)
        late("torque_nm")(columns)

    (text,) = with_first(change)[1]
    for part in ("not used: torque", "from 3600 s to 4200 s", "its clock may be +3600 s off", "correct the times"):
        assert part in text


def test_a_torque_recorded_for_longer_is_noted_and_not_shifted(with_first):
    def change(columns):
        columns["torque_nm"][:1000] = np.nan
        columns["speed_mps"][-500:] = np.nan

    result, notes = with_first(change)
    assert any("torque is recorded from 200 s to 600 s" in note for note in notes)
    assert not any("moved" in note for note in result.notes)


def set_back(columns):
    columns["time_s"][1500:] -= HOUR_S


def set_back_into_what_was(columns):
    columns["time_s"][1500:] -= 100.0


def set_from_1970(columns):
    columns["time_s"][:100] -= columns["time_s"][0] - 5.0


@pytest.mark.parametrize("change", [set_back, set_back_into_what_was, set_from_1970])
def test_a_clock_that_was_set_is_left_out_with_the_place(with_first, change):
    (text,) = with_first(change)[1]
    assert "not used: speed" in text
    assert re.search("correct the (later|earlier) times", text)
    assert f"{19.8 if change is set_from_1970 else 299.8:.0f} s after the beginning" in text


def test_a_clock_set_forward_an_hour_is_noted(with_first):
    _, notes = with_first(lambda c: c.update(time_s=c["time_s"] + HOUR_S * (np.arange(len(c["time_s"])) > 1500)))
    assert "no speed for 3600 s, 300 s after the beginning; treated as a pause" in notes


def test_rows_in_any_order_are_the_same_recording(with_first, recorded, loaded):
    result, healthy = with_first(rows(lambda _: slice(None, None, -1)))[0], judged(recorded(), loaded)
    np.testing.assert_array_equal(result.sessions[0].torque, healthy.sessions[0].torque)
