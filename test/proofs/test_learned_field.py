# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values learned from the drives of a real car, if its recordings are present."""

from pathlib import Path

import pytest

from proofs.field.live import taught
from proofs.field.trials import car, trips
from trackres_ros.vehicle import load_any

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"


@pytest.mark.skipif(not (REAL / "bmw_i3" / "trips.csv").is_file(), reason="the car's recordings are not here")
def test_half_of_the_winter_trips_improves_the_other(tmp_path):
    winter = [car(REAL, name, tmp_path, False, "altitude_m") for name in trips(REAL) if name.startswith("TripB")]
    result = taught("winter", load_any("bmw_i3"), "default", winter[::2], winter[1::2])
    assert result.learned_nm < 0.8 * result.file_nm
