# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped configuration, to be changed at will."""

import copy

import pytest
import yaml

from trackres_ros.errors import InputError
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import config_dir
from trackres_ros.vehicle import load

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # in a tenth of the time


@pytest.fixture(scope="session")
def shipped():
    return read_yaml(config_dir() / "xgd24d.yaml")


@pytest.fixture
def content(shipped):
    return copy.deepcopy(shipped)


@pytest.fixture
def loaded(configuration):
    """The vehicle of a content, read from a file."""

    def load_it(content):
        path = configuration / "given.yaml"
        path.write_text(yaml.dump(content, Dumper=DUMPER), encoding="utf-8")
        return load(path)

    return load_it


@pytest.fixture
def refusal(loaded, configuration):
    """The error that a content gives when it is loaded from a file."""

    def load_refused(content):
        with pytest.raises(InputError) as error_info:
            loaded(content)
        assert "\n" not in str(error_info.value)
        assert str(configuration / "given.yaml") in error_info.value.where
        return error_info.value

    return load_refused
