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
    """What a user chooses of a diagnosis.

    Attributes
    ----------
    hide
        Roles that are not to be read.
    holdout
        See `gate.split`.
    seed
        Of all that is drawn: equal seeds give equal results.
    quick
        Fewer draws.
    effects_dir
        Folder with effects of the user's own.
    keep_suspected
        Whether effects that fit and that held-out laps do not confirm are kept too.
    on_stage
        Takes the name of each stage.
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
