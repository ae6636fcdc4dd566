# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Marks the notes on recordings that the user should act on."""


class WarningNote(str):
    """A note on which the user should act: a recording or a channel is not used, or two inputs contradict each other.

    Any other note states an assumption or a correction.
    """

    __slots__ = ()
