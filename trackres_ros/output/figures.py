# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes figures that a notebook shows by itself. It needs matplotlib: import it where something is drawn."""

from __future__ import annotations

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A matplotlib figure outside of pyplot, so that nothing has to be closed, which a notebook shows as PNG."""

    def _repr_png_(self) -> bytes:
        from trackres_ros.output.plots import png_of

        return png_of(self)
