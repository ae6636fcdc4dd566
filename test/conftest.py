from pathlib import Path

import pytest
from hypothesis import settings

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.live.warm_up import exercise
from trackres_ros.vehicle import load

settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


@pytest.fixture(scope="session")
def reference():
    """Estimator of the reference vehicle."""
    return Estimator(load("xgd24d"))


@pytest.fixture(scope="session")
def carrier():
    """Estimator of the small carrier: another number of assemblies, wheels and axles."""
    return Estimator(load("agri3t"))


@pytest.fixture(scope="session")
def repository():
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def compiled(reference):
    """The kernels are compiled: nodes that are started then need not do so beside, each anew, while they are tested."""
    exercise(reference)
