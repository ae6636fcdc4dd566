# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Limits the threads of the linear algebra of numpy and scipy, as the commands do from their start."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread for matrices: they are small here, and further threads would wait more than they compute.

    Without threadpoolctl the threads stay as they are.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        yield
        return
    with threadpool_limits(1, user_api="blas"):
        yield
