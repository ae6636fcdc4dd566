# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Looks at the values of guessed channels: one whose values are all missing, impossible or the same is no guess."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from trackres_ros.recording.channel_file import CHUNK_ROWS, ChannelFile, ChosenChannel
from trackres_ros.recording.roles import PLAUSIBLE, POSITION, ROLES
from trackres_ros.recording.samples import BoundSource, FloatArray
from trackres_ros.text import figures


@dataclass(slots=True)
class SeenValues:
    """The values of a candidate for a role, as far as they were read."""

    role: str
    values: int = 0
    possible: int = 0
    lowest: float = inf  # of the possible values, if there are any
    highest: float = -inf

    def take(self, values: FloatArray) -> None:
        """Take more values, in the unit of the role; nan is none."""
        values = values[np.isfinite(values)]
        low, high = (-inf, inf) if self.role in POSITION else PLAUSIBLE.get(self.role, (-inf, inf))  # rad or degrees
        possible_values = values[(values >= low) & (values <= high)]
        if len(possible_values) and not self.possible:
            self.lowest, self.highest = inf, -inf
        self.values, self.possible = self.values + len(values), self.possible + len(possible_values)
        new_values = possible_values if self.possible else values
        self.lowest = min(self.lowest, float(new_values.min(initial=inf)))
        self.highest = max(self.highest, float(new_values.max(initial=-inf)))

    @property
    def is_proven(self) -> bool:
        """Whether no further value makes a fault of it."""
        must_vary = ROLES[self.role].is_lively or self.role in POSITION
        return self.possible > 0 and (not must_vary or self.lowest < self.highest)

    @property
    def fault(self) -> str:
        """Why it is no guess; empty if it may be one."""
        unit = ROLES[self.role].unit
        if not self.values:
            return "it has no value that is available"
        if not self.possible:
            return f"its values, {figures(self.lowest)} to {figures(self.highest)} {unit}, are impossible"
        if not self.is_proven and self.possible > 1:
            return f"it is always {figures(self.lowest)} {unit}"
        return ""


def faults_of(
    file: ChannelFile, time: ChosenChannel | None, candidates: Mapping[str, Sequence[ChosenChannel]]
) -> dict[tuple[str, str], str]:
    """Why candidates for roles are no guess, by role and name.

    It reads until the best candidate of each role is proven. Until then, an alternative without a value is no guess either.

    `file`: to read from its beginning; `time`: the column of the time of a table; `candidates`: by role, the best one first.
    """
    channels = list(itertools.chain.from_iterable(candidates.values()))
    seen = [SeenValues(channel.role) for channel in channels]
    best = [seen[channels.index(of_role[0])] for of_role in candidates.values()]
    if not channels:
        return {}
    file.settle(time, channels)
    for parts in itertools.zip_longest(*file.streams()):
        for rows in parts:
            for column, (channel, values) in enumerate(zip(channels, seen, strict=True)):
                if rows is not None and rows.has_value[:, column].any():
                    raw = rows.cells[rows.has_value[:, column], column]
                    values.take(channel.binding.directions(channel.binding.scale * raw + channel.binding.offset))
        if all(values.is_proven for values in best):
            break
    return {(channel.role, channel.name): values.fault for channel, values in zip(channels, seen, strict=True) if values.fault}


def faults_of_topics(source: BoundSource) -> dict[tuple[str, str], str]:
    """The same for the guessed topics of a bag, by role and topic. It reads until each is proven."""
    seen = {role: SeenValues(role) for role in source.roles}
    for block in source.blocks(CHUNK_ROWS):
        for place, values in enumerate(seen.values()):
            values.take(block.value[block.role == place])
        if all(values.is_proven for values in seen.values()):
            break
    return {(role, source.bindings[role].topic): values.fault for role, values in seen.items() if values.fault}
