# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings as tables, and copies of them with something changed."""

import numpy as np


def written(path, columns, fmt="%.6f"):
    """A table of columns by name."""
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt=fmt)
    return path


def columns_of(path):
    """The columns of a table by name."""
    header = path.read_text().splitlines()[0].split(",")
    return dict(zip(header, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def rewritten(path, folder, change, name=""):
    """A copy of a table; `change` gets its columns by name and may alter, add or cut them."""
    columns = columns_of(path)
    change(columns)
    return written(folder / (name or path.name), columns)


def changed(path, folder, **columns):
    """A copy of a table with columns changed by functions."""
    return rewritten(path, folder, lambda of: of.update({name: change(of[name]) for name, change in columns.items()}))
