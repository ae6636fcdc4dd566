# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Common parts of the law tests: the shipped vehicles, a rubber without dispersion, and settings of hypothesis."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from trackres_ros.model.rubber import RubberModel

# The same examples on every run, and no deadline: a shared machine is slow for reasons that are not the code's.
settings.register_profile("laws", deadline=None, derandomize=True, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("laws")


@pytest.fixture(scope="session")
def track(vehicle):
    return next(iter(vehicle.tracks.values()))


@pytest.fixture(scope="session")
def triangular(xgd24d):
    return xgd24d.tracks["triangular"]


@pytest.fixture(scope="session")
def compound(xgd24d):
    return xgd24d.rubber


@pytest.fixture(scope="session")
def flat_rubber(compound):
    """Moduli that depend on neither frequency nor temperature, 20 MPa and 2 MPa: what closed forms assume."""
    return RubberModel(
        replace(compound, storage_pa=np.full_like(compound.storage_pa, 20e6), loss_pa=np.full_like(compound.loss_pa, 2e6))
    )


@pytest.fixture(scope="session")
def mirrored():
    """The track seen from the other side: the former front end of the ground run is its rear end."""

    def seen(track):
        run = track.road_wheels.ground_run
        wheels = replace(track.road_wheels, positions=tuple(run - x for x in reversed(track.road_wheels.positions)))
        return replace(track, road_wheels=wheels, wrapped_wheels=track.wrapped_wheels[::-1])

    return seen
