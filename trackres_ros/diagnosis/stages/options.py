# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.prepare.refuse import Refusal


@dataclass(frozen=True, eq=False)
class DiagnosisOptions:
    """See `pipeline.diagnose`."""

    vehicle: LoadedBase
    hide: Sequence[str] = ()
    holdout: int | Sequence[str] | None = None
    seed: int = 1
    quick: bool = False
    effects_dir: Path | None = None
    keep_suspected: bool = False
    on_stage: Callable[[str], None] = lambda _: None
    unread: Sequence[Refusal] = ()
