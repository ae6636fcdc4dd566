# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

import pytest

from proofs.sealed.belt import read_data_sheet
from trackres_ros.files.resources import find_vehicle


@pytest.fixture(scope="session")
def sheet():
    """The data sheet of the vehicle that the proofs drive."""
    return read_data_sheet(find_vehicle("xgd24d"))
