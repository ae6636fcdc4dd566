# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scales a hidden program to the drawn detectability, within physical limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from proofs.sealed.cases import Case
from proofs.sealed.drives import Array, SealedDrive
from proofs.sealed.programs import ENTRIES, PROGRAM, TURNS, draw_program
from proofs.sealed.truth import Build, simulate_truth

SLOW_NM, SLOW_S, WHITE_NM = 50.0, 6.0, 15.0  # a torque's noise over a second: a road that no one measured, and white
CHANGE = 0.03  # of each value of the build, to find the part absorbed by a re-fit
ROUNDS, TRIES, TRIES_OF_KIND = 3, 20, 5
LEAST = 20.0  # of d'


def sized(case: Case, sheet: Path, drives: Sequence[SealedDrive]) -> Case:
    """The case with the size of its program and its detectability; an undetectable program is replaced by another, if possible
    of its kind.
    """
    if PROGRAM not in case.hidden:
        return case
    build, wanted = Build(**case.build), case.hidden[PROGRAM]["d_prime"]
    plain = whitened([run.shown for run in simulate_truth(sheet, build, {}, drives)], drives)
    others = [replace(build, **{name: (1.0 + CHANGE) * value}) for name, value in case.build.items()]
    base = [whitened([run.shown for run in simulate_truth(sheet, other, {}, drives)], drives) - plain for other in others]
    taken = np.linalg.qr(np.column_stack([*base, plain]))[0]

    def seen(seed: float, size: float) -> float:
        runs = simulate_truth(sheet, build, {PROGRAM: {"seed": seed, "size": size}}, drives)
        added = whitened([run.added[PROGRAM] for run in runs], drives)
        return float(np.linalg.norm(added - taken @ (taken.T @ added)))

    # Drives without a long stop show no parking brake, whatever its size: then the next kind has its turn.
    others_of_kind = len(TURNS) * np.arange(TRIES_OF_KIND)
    for seed in case.hidden[PROGRAM]["seed"] + np.append(others_of_kind, np.arange(1, TRIES)):
        program, size = draw_program(int(seed)), 1.0
        for _ in range(ROUNDS):
            most = ENTRIES[program.entry].largest
            size = float(np.clip(size * wanted / max(seen(float(seed), size), 1e-6), 1e-3, most))
        d_prime = seen(float(seed), size)
        if d_prime >= LEAST:
            break
    hidden = {PROGRAM: {"seed": float(seed), "size": size, "d_prime": d_prime}}
    return replace(case, hidden=hidden, program=program.description)


def whitened(series: Sequence[Array], drives: Sequence[SealedDrive]) -> Array:
    """Torques over seconds, over the noise in them that cannot be known from the second before."""
    keep, parts = np.exp(-1.0 / SLOW_S), list[Array]()
    for torque, one in zip(series, drives, strict=True):
        n = round(1.0 / one.step)
        second = torque[: len(torque) // n * n].reshape(-1, n).mean(axis=1)
        parts.append(second - keep * np.append(0.0, second[:-1]))
    return np.asarray(np.concatenate(parts) / np.hypot(SLOW_NM * np.sqrt(1.0 - keep**2), WHITE_NM * np.sqrt(1.0 + keep**2)))
