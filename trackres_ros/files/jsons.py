# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads all JSON: it is plain data with finite numbers, or a `ValueError` gives the reason."""

import json
import math
from typing import Any

MOST_DIGITS = 300  # of an integer: a longer one fits into no float


def parse_json(data: bytes | str) -> Any:
    """Plain data of JSON in UTF-8. Raises ValueError if it is no JSON, has a number that is not finite, or nests too deep."""
    try:
        return json.loads(data, parse_constant=_finite, parse_float=_finite, parse_int=_whole)
    except RecursionError:
        raise ValueError("lists and mappings in each other without end") from None


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:20]} is not a finite number")
    return value


def _whole(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)
