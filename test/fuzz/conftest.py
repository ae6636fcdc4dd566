# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fuzzer's own files are importable, as from `run.py`."""

import sys
from pathlib import Path

if str(Path(__file__).parent) not in sys.path:
    sys.path.insert(0, str(Path(__file__).parent))
