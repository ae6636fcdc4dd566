# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One dynamics: message by message, block by block and in a fit the same functions run, so the numbers are the same."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import Active, catalogue
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import GroundSeries
from trackres_ros.learning.parameters import learnables
from trackres_ros.recording.samples import SampleBlock
from trackres_ros.tasks.replay_run import replay
from trackres_ros.vehicle import load
from trackres_ros.vehicle.belt_bulk import heat_capacity
from trackres_ros.vehicle.writing.changes import FileChanges, Interval

START_NS = 1_700_000_000_000_000_000
CHANNELS = {"load": "weight", "ambient": "ambient", "yaw_rate": "yaw_rate", "heading": "heading", "accel": "accel"}
GAPS_S = (np.inf, 600.0, 5400.0)  # the belt rests between drives, and so do the effects
AGREE = 1e-9
NAMES = [name for name, effect in catalogue().items() if effect.belongs_to != "sensor"]
SEVERAL = ("warmup", "solar", "turning_scrub")


@pytest.fixture(scope="module")
def three(loaded):
    sessions = drives(loaded.base, loaded.known.max_speed, 3, 4.0, np.random.default_rng(3))
    return [replace(s, gap=gap) for s, gap in zip(sessions, GAPS_S, strict=True)]


@pytest.fixture(scope="module")
def drive(three):
    return three[0]


@pytest.fixture(scope="module")
def two_nodes(tmp_path_factory):
    """The vehicle with a core and a surface of its belts."""
    path = tmp_path_factory.mktemp("two_nodes") / "two_nodes.yaml"
    shipped = load("xgd24d")
    (path.parent / "rubber").mkdir()
    (path.parent / "rubber" / shipped.rubber_source.name).write_bytes(shipped.rubber_source.read_bytes())
    path.write_text(shipped.source.read_text().replace("thermal: lumped", "thermal: core_surface"))
    assert load(path).thermal == "core_surface"
    return path


def stamps(session):
    return START_NS + np.round(session.time * 1e9).astype(np.int64)


class Recorded:
    """A session as a recording: all channels a moment before each speed."""

    notes = findings = ()
    zero_is_unset = True

    def __init__(self, session):
        self.name, self.session, self.roles = session.name, session, (*CHANNELS, "speed")

    def blocks(self, max_rows=65536):
        names = [*CHANNELS.values(), "speed"]
        value = np.column_stack([getattr(self.session, name) for name in names]).ravel()
        when = np.repeat(stamps(self.session), len(names))
        role = np.tile(np.arange(len(names), dtype=np.int16), len(self.session))
        for i in range(0, len(when), max_rows):
            choice = slice(i, i + max_rows)
            yield SampleBlock(role[choice], when[choice], when[choice], value[choice])


def driven(estimator, sessions, rows_of):
    """Driving torque and mean belt temperature of each session after the rest before it."""
    state, result = None, []
    for session in sessions:
        running = estimator.session()
        if state is not None:
            running.begin(estimator.rest(state, float(session.ambient[0]), session.gap))
        result.append(picked(estimator, np.concatenate(list(rows_of(running, session)))))
        state = running.state
    return result


def live(running, session):
    """Rows, all channels sent with each speed."""
    for i, time_now in enumerate(stamps(session).tolist()):
        for channel, name in CHANNELS.items():
            running.handle(running.channel(channel), time_now, time_now, float(getattr(session, name)[i]))
        yield running.handle(at.SPEED, time_now, time_now, float(session.speed[i])).row[np.newaxis]


def replayed(running, session):
    """Rows by blocks of a recording."""
    rows = []
    replay(Recorded(session), running.estimator, lambda steps: rows.append(steps.rows.copy()), running)
    return rows


def picked(estimator, rows):
    belts = [rows[:, estimator.column_index[f"belt_degc/{name}"]] for name in estimator.assemblies]
    return rows[:, at.Results.drive_torque_nm], np.mean(belts, axis=0) if belts else np.zeros(len(rows))


def simulated(base, sessions, active):
    return [(p.at_sprockets, p.belt) for p in base.predict(sessions, base.nominal, active)]


def agree(found, others):
    for (torque, belt), (torque_too, belt_too) in zip(found, others, strict=True):
        assert np.abs(torque - torque_too).max() <= AGREE * np.abs(torque).max()
        assert np.abs(belt - belt_too).max() <= AGREE * np.abs(belt).max()


@pytest.mark.parametrize("names", [(), *((name,) for name in NAMES), SEVERAL], ids="+".join)
@pytest.mark.parametrize("nodes", ["one", "two"])
def test_live_replayed_and_fitted_are_one(loaded, effects, three, two_nodes, nodes, names):
    base = loaded.base if nodes == "one" else load_base(str(two_nodes)).base
    active = tuple(Active(effects[name], effects[name].values()) for name in names)
    estimator = Estimator(replace(base.vehicle, effects=active))
    as_live = driven(estimator, three, live)
    agree(as_live, driven(estimator, three, replayed))
    agree(as_live, simulated(base, three, active))


TYRES = [(), ("warmup",), ("stribeck", "roadwheel_tyres", "turning_scrub")]


@pytest.mark.parametrize("names", TYRES, ids="+".join)
@pytest.mark.parametrize("name", ["ztbus_hess19", "bmw_i3", "husky"])
def test_live_replayed_and_fitted_are_one_without_belts(name, names):
    known = load_base(name)
    sessions = drives(known.base, known.known.max_speed, 3, 4.0, np.random.default_rng(5))
    sessions = [replace(s, gap=gap, given=s.given | {"load"}) for s, gap in zip(sessions, GAPS_S, strict=True)]
    effects = catalogue(size=known.base.vehicle.size, on_tyres=True)
    active = tuple(Active(effects[name], effects[name].values()) for name in names)
    estimator = Estimator(replace(known.base.vehicle, effects=active))
    as_live, as_replayed, in_a_fit = (
        [torque for torque, _ in result]
        for result in (*(driven(estimator, sessions, how) for how in (live, replayed)), simulated(known.base, sessions, active))
    )
    for torque, too, fit_result in zip(as_live, as_replayed, in_a_fit, strict=True):
        np.testing.assert_array_equal(torque, too)
        np.testing.assert_allclose(torque, fit_result, rtol=0.0, atol=1e-12 * np.abs(fit_result).max())


@pytest.mark.parametrize("names", [(), ("drivetrain_efficiency", "warmup")], ids="+".join)
def test_a_torque_by_place_is_the_same_live_and_in_a_fit(loaded, effects, drive, names):
    active = tuple(Active(effects[name], effects[name].values()) for name in names)
    estimator = Estimator(replace(loaded.base.vehicle, effects=active))
    soft = np.where((drive.time > 60.0) & (drive.time < 160.0), 700.0, 0.0)
    unknown = np.full(len(soft), np.nan)
    begin = estimator.cold_start(estimator.inputs(float(drive.speed[0]), ambient=float(drive.ambient[0])))
    _, rows = estimator.run(
        begin, drive.time, drive.speed, drive.weight, drive.ambient, drive.accel, math.nan, drive.yaw_rate, drive.heading,
        ground=GroundSeries(unknown, soft, unknown, np.ones_like(unknown)),
    )  # fmt: skip
    fit_result = simulated(loaded.base, [replace(drive, torque_by_place=soft)], active)
    agree([picked(estimator, rows)], fit_result)
    (bare, _), (ground, _) = *simulated(loaded.base, [drive], active), *fit_result
    assert np.abs(ground - bare).max() > 600.0


def test_belts_of_two_kinds_are_fitted_as_they_are_written(two_nodes, drive):
    """Each keeps its own share of heat at the surface and in the cords; a re-fit changes all in proportion."""
    content = yaml.safe_load(two_nodes.read_text())
    content["tracks"]["rear"] = other = copy.deepcopy(content["tracks"]["triangular"])
    for name, value, span in (("surface_share", 0.32, [0.2, 0.4]), ("cord_section", 0.0016, [0.0012, 0.002])):
        other["belt"][name].update(value=value, range=span)
    for assembly in content["assemblies"][2:]:
        assembly["track"] = "rear"
    path = two_nodes.with_name("two_kinds.yaml")
    path.write_text(yaml.safe_dump(content))
    base, estimator = load_base(path).base, Estimator(load(path))
    agree(driven(estimator, [drive], replayed), simulated(base, [drive], ()))
    bounds = next(q for q in base.parameters if q.name == "surface_share")
    for share, places in ((bounds.nominal, 12), (bounds.low, 5), (bounds.high, 5), (0.24, 5)):  # figures of a file
        values = base.nominal | {"capacity_scale": 1.1 if share == 0.24 else 1.0, "surface_share": share}
        time_now = base.as_written(values)
        (fit,), (file,) = base.predict([drive], values, ()), time_now.predict([drive], time_now.nominal, ())
        np.testing.assert_allclose(file.belt, fit.belt, rtol=10.0**-places)
    base.write(path, FileChanges(values, (), {("", "surface_share"): Interval(0.21, 0.26, True)}), "with its interval")
    front, rear = (load(path).parameters[f"tracks.{name}.belt.surface_share"] for name in ("triangular", "rear"))
    assert (rear.value, rear.low, rear.high) == pytest.approx([0.32 / 0.2 * x for x in (0.24, 0.21, 0.26)])
    assert (front.value, front.low, front.high) == pytest.approx((0.24, 0.21, 0.26))
    vehicle, rubber = estimator.vehicle, estimator.vehicle.rubber
    learned_values = next(entry for entry in learnables(vehicle) if entry.state == at.OF_CAPACITY)  # of all belts together
    warmer = replace(rubber, heat_capacity=rubber.heat_capacity * (1.0 + 0.1 * learned_values.factor))
    heat = [sum(heat_capacity(vehicle.track_of(entry).belt, item) for entry in vehicle.assemblies) for item in (rubber, warmer)]
    assert heat[1] == pytest.approx(1.1 * heat[0])


def test_at_rest_a_surface_cools_before_its_core(two_nodes):
    """600 s of rest from 60 degC at 15 degC; a fit rests alike, see `test_live_replayed_and_fitted_are_one`."""
    estimator = Estimator(load(two_nodes))
    warm = estimator.cold_start(estimator.inputs(0.0, ambient=15.0), belt_degc=60.0)
    rested = estimator.rest(warm, 15.0, 600.0).belts[0, :, at.Belt.temperature]
    assert rested[0] - rested[1] > 10.0


def test_an_effect_without_its_input_is_left_out_with_a_reason(effects):
    scrub = Active(effects["turning_scrub"], effects["turning_scrub"].values())
    session = Estimator(replace(load("xgd24d"), effects=(scrub,))).session()
    estimate = session.handle(at.SPEED, START_NS, START_NS, 5.0)
    assert at.Reason.EFFECT_LEFT_OUT in estimate.reasons
    assert estimate["effects_nm"] == 0.0
    session.handle(session.channel("yaw_rate"), START_NS + 1, START_NS + 1, 0.2)
    later = session.handle(at.SPEED, START_NS + 10**8, START_NS + 10**8, 5.0)
    assert at.Reason.EFFECT_LEFT_OUT not in later.reasons
    assert later["effects_nm"] > 10.0


def test_what_was_saved_goes_on_as_if_it_had_not_stopped(effects, tmp_path, drive):
    from trackres_ros.estimator import snapshot

    warm = Active(effects["warmup"], effects["warmup"].values())
    estimator = Estimator(replace(load("xgd24d"), effects=(warm,)))
    session = estimator.session()
    for i in range(600):
        session.handle(at.SPEED, START_NS + i * 10**8, START_NS + i * 10**8, 5.0)
    snapshot.save(session, tmp_path / "state", saved_at=0.0)
    resumed = snapshot.resume(estimator, tmp_path / "state")
    time_now = START_NS + 600 * 10**8
    np.testing.assert_array_equal(
        session.handle(at.SPEED, time_now, time_now, 5.0).row, resumed.handle(at.SPEED, time_now, time_now, 5.0).row
    )
    cold, _ = snapshot.after_time_off(estimator, tmp_path / "state", wall_s=1e6)
    result_after, result_before = (
        cold.handle(at.SPEED, time_now, time_now, 5.0),
        resumed.handle(at.SPEED, time_now + 10**8, time_now + 10**8, 5.0),
    )
    assert result_after["effects_nm"] > result_before["effects_nm"] + 10.0  # the oil has cooled too
