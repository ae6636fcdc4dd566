# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from trackres_ros.diagnosis.prepare.refuse import Refusal


@dataclass(frozen=True, eq=False)
class DiagnosisOptions:
    """Options of a diagnosis.

    Attributes
    ----------
    hide
        Roles that are not read.
    holdout
        See `gate.split`.
    seed
        Seed of all random draws: equal seeds give equal results.
    quick
        Fewer draws.
    effects_dir
        Folder with user effects.
    keep_suspected
        Whether to keep suspected effects, which fit but are not confirmed on hold-out laps.
    on_stage
        Callback with the name of each stage.
    unread
        Recordings that could not be read.
    """

    hide: Sequence[str] = ()
    holdout: int | Sequence[str] | None = None
    seed: int = 1
    quick: bool = False
    effects_dir: Path | None = None
    keep_suspected: bool = False
    on_stage: Callable[[str], None] = lambda _: None
    unread: Sequence[Refusal] = ()


BY_DEFAULT = DiagnosisOptions()
