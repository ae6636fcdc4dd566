# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped configuration, to be changed at will."""

import copy
import shutil
from pathlib import Path

import pytest

from trackres_ros.files.resources import config_dir
from trackres_ros.files.yamls import read_yaml


@pytest.fixture
def folder(tmp_path):
    """The shipped configuration in a folder of its own."""
    return Path(shutil.copytree(config_dir(), tmp_path / "config"))


@pytest.fixture(scope="session")
def shipped():
    return read_yaml(config_dir() / "xgd24d.yaml")


@pytest.fixture
def content(shipped):
    return copy.deepcopy(shipped)
