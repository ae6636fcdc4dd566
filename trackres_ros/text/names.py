# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes names of files for people: no longer than it takes to tell them apart."""

import re
from collections.abc import Sequence
from pathlib import PurePath


def told_apart(paths: Sequence[str]) -> list[str]:
    """Name of each file, with the folders before it that tell it from the others."""
    every = [PurePath(path).parts for path in paths]
    different = set(every)

    def shortest(parts: tuple[str, ...]) -> str:
        lengths = (n for n in range(1, len(parts)) if sum(other[-n:] == parts[-n:] for other in different) == 1)
        return str(PurePath(*parts[-next(lengths, len(parts)) :]))

    return [shortest(parts) for parts in every]


def words(topic: str) -> str:
    """Return the words of a topic name, lower case with spaces: of ``/vehicleSpeed_kmh`` "vehicle speed kmh"."""
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", topic).lower()
    return " ".join(re.split(r"[^a-z0-9]+", spaced))
