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
    """Options of a diagnosis."""

    hide: Sequence[str] = ()  # roles that are not read
    holdout: int | Sequence[str] | None = None  # see `split.split`
    seed: int = 1  # of all random draws: equal seeds give equal results
    quick: bool = False  # fewer draws
    effects_dir: Path | None = None  # folder with user effects
    keep_suspected: bool = False  # keep effects that fit but are not confirmed on hold-out laps
    on_stage: Callable[[str], None] = lambda _: None  # callback with the name of each stage
    unread: Sequence[Refusal] = ()  # recordings that could not be read


BY_DEFAULT = DiagnosisOptions()
