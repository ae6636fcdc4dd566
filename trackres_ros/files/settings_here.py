# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps libraries from settings that lie in the current folder by chance or by intent, such as among unpacked recordings."""

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def unread(name: str) -> Iterator[None]:
    """Import a library that reads a file of this name in the current folder, from the root folder if there is one.

    An older matplotlib can be made to run code by such a file. It has no option to leave it out.
    """
    if not os.path.lexists(name):
        yield
        return
    here = os.open(".", os.O_PATH)
    os.chdir("/")
    try:
        yield
    finally:
        os.fchdir(here)
        os.close(here)
