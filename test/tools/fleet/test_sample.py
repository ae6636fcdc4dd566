# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every simulated fleet that can be asked for can be analysed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

pytest.importorskip("fsspec")
pytest.importorskip("pyarrow")

from trackres_ros.errors import InputError
from trackres_ros.tools.fleet import sample
from trackres_ros.tools.fleet.sample import DAY_S, MOVES_MPS, MOVES_S, SAMPLE_CHANGES, draw_fleet, record_drive
from trackres_ros.tools.fleet.task import Task, analyse
from trackres_ros.tools.fleet.vehicles import one_vehicle, read_fleet


@settings(max_examples=150, deadline=None)
@given(
    vehicles=st.integers(1, 20),
    days=st.integers(1, 400),
    every=st.floats(0.1, 365.0),
    minutes=st.floats(3.0, 600.0),
    seed=st.integers(0, 2**32),
)
@example(vehicles=4, days=5, every=3.0, minutes=10.0, seed=1)
@example(vehicles=1, days=1, every=365.0, minutes=600.0, seed=1)
@example(vehicles=3, days=4, every=0.5, minutes=600.0, seed=1)
def test_a_vehicles_recordings_never_overlap_and_changes_occur(vehicles, days, every, minutes, seed):
    if minutes * 60.0 >= min(every, days) * DAY_S:
        with pytest.raises(InputError, match="--every"):
            draw_fleet(vehicles, days, every, minutes, SAMPLE_CHANGES, seed)
        return
    fleet = draw_fleet(vehicles, days, every, minutes, SAMPLE_CHANGES, seed)
    assert len(fleet) == vehicles
    for vehicle in fleet:
        begins = np.array(vehicle.days) * DAY_S
        assert np.all(np.diff(begins) >= 60.0 * minutes - 1e-3)
        assert begins[0] >= 0.0
        assert begins[-1] <= days * DAY_S
        assert vehicle.hidden is None or 0 < vehicle.hidden.first < len(begins)
    changed = sum(vehicle.hidden is not None for vehicle in fleet)
    assert changed == (min(vehicles, len(SAMPLE_CHANGES)) if len(fleet[0].days) > 1 else 0)


def test_only_a_sample_with_the_same_options_is_completed(good, refused, tmp_path):
    folder = tmp_path / "try"
    words = ("fleet", "sample", "-o", folder, "--vehicles", "1", "--days", "1", "--minutes", "3", "--every")
    good(*words, "0.25", "--seed", "2")
    assert list(read_fleet(folder / "fleet.yaml").vehicles) == ["truck-01"]
    answers = json.loads((folder / "answers.json").read_text())
    assert answers["options"] == {"vehicles": 1, "days": 1, "every": 0.25, "minutes": 3.0, "seed": 2}
    assert [one["vehicle"] for one in answers["changes"]] == ["truck-01"]
    removed = folder / "recordings" / "truck-01" / "drive_0002.csv"  # as if the first time had been interrupted
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    removed.unlink()
    good(*words, "0.25", "--seed", "2")
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before
    mine = tmp_path / "mine"
    mine.mkdir()
    for text in ("", "[]", "{}", '{"options": 1}', '{"options": {"seed": "x"}}'):
        (mine / "fleet.yaml").write_text("vehicles: {a: agri3t}")
        (mine / "answers.json").write_text(text)
        assert "other content" in refused("fleet", "sample", "-o", mine)
        assert (mine / "fleet.yaml").read_text() == "vehicles: {a: agri3t}"
    for more in (("0.25", "--seed", "1"), ("0.5", "--seed", "2")):
        assert "--vehicles 1 --days 1 --every 0.25 --minutes 3.0 --seed 2" in refused(*words, *more)
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before


def test_a_short_recording_holds_enough_driving(tmp_path, monkeypatch):
    """If a driver stands at first, that drive is drawn again, and the recording can be compared."""
    drawn, drives = [], sample.drives

    def standing_first(base, max_speed, count, minutes, rng):
        (session,) = drives(base, max_speed, count, minutes, rng)
        if not drawn:
            session.speed[:] = 0.0
        drawn.append(float((session.speed > MOVES_MPS).sum()) * session.step)
        return [session]

    monkeypatch.setattr(sample, "drives", standing_first)
    (vehicle,) = draw_fleet(1, 1, 1.0, 3.0, (), seed=1)
    record_drive((tmp_path, vehicle, 0, 3.0))
    (path,) = tmp_path.rglob("*.csv")
    assert drawn[0] < MOVES_S <= drawn[-1]
    done = analyse(Task(str(path), "1", one_vehicle("xgd24d", None).vehicles["xgd24d"]))
    assert done["status"] == "good", done["reason"]


def test_a_change_is_in_the_torque_from_its_first_recording_on(tmp_path):
    """The same drives with and without it differ from there, and by the more the later."""
    (vehicle,) = draw_fleet(1, 12, 3.0, 5.0, ((sample.BEARING, sample.RAMP, 0.4),), seed=3)
    first = vehicle.hidden.first
    means = {}
    for name, hidden in (("changed", vehicle.hidden), ("as_new", None)):
        for number in range(len(vehicle.days)):
            record_drive((tmp_path / name, replace(vehicle, hidden=hidden), number, 5.0))
        means[name] = [np.loadtxt(p, delimiter=",", skiprows=1)[:, 7].mean() for p in sorted((tmp_path / name).rglob("*.csv"))]
    more = np.subtract(means["changed"], means["as_new"])
    assert np.all(more[:first] == 0.0)
    assert np.all(np.diff(more[first - 1 :]) > 0.0)
