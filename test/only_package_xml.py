# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A plugin of pytest, `-p only_package_xml`: hides each library that package.xml does not bring, as after rosdep alone.

`ONLY_PACKAGE_XML` has the names of the modules that are there.
"""

import os
from importlib.machinery import PathFinder
from importlib.metadata import packages_distributions

THERE = set(os.environ["ONLY_PACKAGE_XML"].split())
HIDDEN = packages_distributions().keys() - THERE - {"trackres_ros"}
_find = PathFinder.find_spec


def _found(name, path=None, target=None):
    return None if name.partition(".")[0] in HIDDEN else _find(name, path, target)


PathFinder.find_spec = _found
