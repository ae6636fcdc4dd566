# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names the types of arrays; imports nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Mask = NDArray[np.bool_]
