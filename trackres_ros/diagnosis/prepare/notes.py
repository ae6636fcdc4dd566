# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Marks the notes on recordings that the user should act on."""

from __future__ import annotations


class WarningNote(str):
    """A note on which the user should act: a recording or a channel is not used, or two inputs contradict each other.

    Any other note states an assumption or a correction.
    """

    __slots__ = ()


class SensorFinding(WarningNote):
    """A warning on a sensor that another input contradicts. The verdict has it too, so that the two never disagree.

    Parameters
    ----------
    text
        The warning.
    says
        The same as a sentence of the verdict.
    effect, value
        The error as an effect of the catalogue, with the value of its first parameter; empty where there is none.
    """

    says: str
    effect: str
    value: float

    def __new__(cls, text: str, says: str, effect: str = "", value: float = 0.0) -> SensorFinding:
        """A string with attributes."""
        found = super().__new__(cls, text)
        found.says, found.effect, found.value = says, effect, value
        return found
