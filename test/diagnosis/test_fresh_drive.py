# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A written vehicle file, alone and without a saved state, on a drive that the diagnosis has not seen."""

from dataclasses import replace

import numpy as np
import pytest

import trackres_ros as tr
from proofs.sealed.drives import drive
from proofs.sealed.recordings import (
    APART_S,
    FASTEST_MPS,
    START_S,
    VEHICLE,
    refit,
    weight_and_radius,
    write_vehicle,
)
from proofs.sealed.truth import Build, Sensors, record, simulate_truth
from trackres_ros.files.resources import find_vehicle

MINUTES, SECOND = 8.0, 10  # of a drive; samples
LOADS, AIRS_DEGC = (1.0, 0.8, 1.25), (5.0, 15.0, 25.0)  # of the drives that a file is fitted to
NO_WORSE = 1.02

CHATTER = 400.0, 90.0, 120.0  # Nm; s on and off, in the mean
DRIFT = 200.0, 300.0  # Nm, s


def spells(n, step, rng):
    """A torque that comes and goes."""
    size, on_s, off_s = CHATTER
    acts, i = np.zeros(n), int(rng.exponential(off_s) / step)
    while i < n:
        held = int(rng.exponential(on_s) / step) + 1
        acts[i : i + held] = size
        i += held + int(rng.exponential(off_s) / step) + 1
    return acts


def drift(n, step, rng):
    """A torque that wanders about zero."""
    size, seconds = DRIFT
    keep, time_now, result = np.exp(-step / seconds), rng.normal(0.0, size), np.empty(n)
    for i, shock in enumerate(rng.normal(0.0, size * np.sqrt(1.0 - keep**2), n)):
        time_now = keep * time_now + shock
        result[i] = time_now
    return result


HIDDEN = {
    "a new belt": ({"mullins": {"excess": 0.25, "distance": 3000.0}}, None),
    "a speed at which it shakes": ({"vibration": {"torque": 400.0, "speed": 7.0, "width": 1.0}}, None),
    "spells": ({}, spells),
    "drift": ({}, drift),
}


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    """Makes recordings of a vehicle with hidden physics, the last one of a fresh drive, and its vehicle file: the data sheet,
    with a passing torque fitted to earlier drives, as users do, so that it has the mean of that.
    """

    def make(name, seed=4):
        hidden, passing = HIDDEN[name]
        rng, folder, (weight, radius) = np.random.default_rng(seed), tmp_path_factory.mktemp("sealed"), weight_and_radius()
        earlier = 0 if passing is None else len(LOADS)
        conditions = [*zip(LOADS, AIRS_DEGC, strict=True)] * (2 if earlier else 1) + [(1.0, 10.0)]
        driven = [drive(MINUTES, g * weight, air, FASTEST_MPS, rng) for g, air in conditions]
        paths = []
        for i, (value, true) in enumerate(
            zip(driven, simulate_truth(find_vehicle(VEHICLE), Build(), hidden, driven), strict=True)
        ):
            acts = 0.0 if passing is None else passing(len(value), value.step, rng) * np.tanh(value.speed / 0.05)
            paths.append(folder / f"drive_{i + 1}.csv")
            record(paths[-1], value, replace(true, shown=true.shown + acts), Sensors(), radius, START_S + i * APART_S, rng)
        file = write_vehicle(folder / "vehicle.yaml", lumped=False)
        return paths[earlier:], refit(paths[:earlier], file, file, "fitted to earlier drives") if earlier else file

    return make


def error_alone(recording, vehicle):
    """Mean error of a replay that begins without a state, over means of a second [Nm]."""
    replay_result = tr.replay(recording, vehicle)
    error = replay_result["measured_torque_nm"] - replay_result["drive_torque_nm"]
    error = error[: len(error) // SECOND * SECOND].reshape(-1, SECOND).mean(axis=1)
    return float(np.nanmean(np.abs(error)))


@pytest.mark.long
@pytest.mark.parametrize("name", HIDDEN)
def test_a_written_file_is_no_worse_alone_on_a_fresh_drive(sealed, name):
    (*paths, fresh), file = sealed(name)
    diagnosis_result = tr.diagnose(paths, file, quick=True)
    result_after, result_before = (error_alone(fresh, vehicle) for vehicle in (diagnosis_result.vehicle, file))
    assert result_after <= NO_WORSE * result_before, diagnosis_result.as_dict()["written"]
    if name == "a new belt":
        assert "mullins" in {e["name"] for e in diagnosis_result.as_dict()["effects"]}
        assert all(a.effect.name != "mullins" or a.values["excess"] < 0.05 for a in diagnosis_result.vehicle.effects)
