from pathlib import Path

import numpy as np
import pytest

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.trial import drives, write_recordings
from trackres_ros.effects import Active, catalogue


@pytest.fixture(scope="session")
def loaded():
    return load_base("xgd24d")


@pytest.fixture(scope="session")
def effects():
    return catalogue()


@pytest.fixture(scope="session")
def recorded(loaded, effects, tmp_path_factory):
    """Makes recordings with effects at their typical values; the same ones are made once."""
    made: dict[tuple, list[Path]] = {}

    def make(*names, seed=1, count=3, minutes=10.0):
        key = (*names, seed, count, minutes)
        if key not in made:
            rng = np.random.default_rng(seed)
            sessions = drives(loaded.base, loaded.known.max_speed, count, minutes, rng)
            active = [Active(effects[name], effects[name].values()) for name in names]
            made[key] = write_recordings(loaded.base, tmp_path_factory.mktemp("recorded"), sessions, active, rng)
        return made[key]

    return make
