# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Operations that Python and machine code round differently, written so that both give the same bits.

Python computes `x ** 2` by the C library's `pow` and has its own `hypot`; compiled code multiplies, and uses the C library's.
"""

from __future__ import annotations

import math

from trackres_ros.kernels.marks import kernel


@kernel
def squared(x: float) -> float:
    """X times x."""
    return x * x


@kernel
def length(x: float, y: float) -> float:
    """Length of a vector, for components whose squares neither overflow nor vanish."""
    return math.sqrt(x * x + y * y)
