# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live table: every number in common notation, for any row of results."""

import re
from dataclasses import replace

import pytest
from rich.console import Console

from trackres_ros.tasks.live_display import line, table


@pytest.mark.parametrize("value", [-0.0, -0.04, -1e-9, 0.04])
def test_no_zero_has_a_sign(desk, value):
    d = desk()
    d.drive(1.5)
    seen = d.app.overview()
    seen = replace(
        seen, values=dict.fromkeys(seen.values, value), inputs=tuple(replace(input, value=value) for input in seen.inputs)
    )
    console = Console(width=200)
    with console.capture() as printed_text:
        console.print(table("live", seen))
    for text in (printed_text.get(), line(seen)):
        assert not re.search(r"(?<![\w.])-0(\.0*)?(?![\d.])", text), text
        assert "e+" not in text
