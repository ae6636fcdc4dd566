# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses a machine with published friction: a carriage on a ball screw, with a file without its dry friction and then with it.

Janot, Gautier and Brunot, "Data set and reference models of EMPS", 2019 Workshop on Nonlinear System Identification Benchmarks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from proofs.tables import Tables, number
from trackres_ros.diagnosis import Diagnosis, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.inference.fitting import Fit, with_levels
from trackres_ros.diagnosis.prepare.session import Mask
from trackres_ros.diagnosis.selection.as_used import NORMAL_95, intervals
from trackres_ros.effects.vehicle.coulomb_friction import CoulombFriction
from trackres_ros.effects.vehicle.friction_by_direction import FrictionByDirection
from trackres_ros.errors import InputError
from trackres_ros.files.resources import config_dir
from trackres_ros.recording.bindings import Topics

COULOMB, DIRECTION = CoulombFriction.name, FrictionByDirection.name
ASSUMED_FRICTION = {"value": 20.0, "unit": "N", "flag": "A", "range": [0.0, 60.0], "reason": "assumed"}
PUBLISHED_ERRORS = {"viscous": 17.3, "coulomb": 3.4, "direction": 2.0}  # percent, on this drive
PUBLISHED = {"mass": "95.1 kg", "viscous": "205 N s/m", "coulomb": "20.2 N", "offset": "-3.2 N"}
PUBLISHED_BY_DIRECTION = {"forward": "168 N s/m", "reverse": "242 N s/m", "coulomb": "20.0 and 20.4 N"}


@dataclass(frozen=True, eq=False)
class SlideTrial:
    """The diagnosis with a file that lacks dry friction, and with one that has it."""

    lacking: Diagnosis
    with_friction: Diagnosis


def try_slide(recording: Path, folder: Path) -> SlideTrial:
    """Diagnose the recording of the positioning system; InputError without one. The second vehicle file goes to `folder`."""
    if not recording.is_file():
        raise InputError("RECORDING", str(recording), "the recording of the positioning system, emps.csv.gz")
    file = yaml.safe_load((config_dir() / "emps.yaml").read_text(encoding="utf-8"))
    file["road_load"]["coulomb_friction"] = ASSUMED_FRICTION
    second = folder / "emps_coulomb.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    second.write_text(yaml.safe_dump(file, sort_keys=False), encoding="utf-8")
    drives = read_recordings([recording], Topics.load("emps"))
    return SlideTrial(diagnose(drives, load_base("emps")), diagnose(drives, load_base(second)))


def force_error(d: Diagnosis, found: Fit, held_out: bool = False) -> float:
    """Relative error: norm of measured less expected force over that of the measured one, in compared or hold-out steps."""
    errors, forces = [], []
    for session, prediction in zip(d.sessions, found.predicted, strict=True):
        steps: Mask = d.split.held_out_mask(session) if held_out else session.used
        errors.append((session.torque - prediction.torque)[steps])
        forces.append(session.torque[steps])
    return float(np.linalg.norm(np.concatenate(errors)) / np.linalg.norm(np.concatenate(forces)))


def only(d: Diagnosis, names: Sequence[str]) -> Fit:
    """The last fit with only some of its effects, all values fitted again."""
    return with_levels(d.final, removed_names=[name for name in d.final.effect_names if name not in names])


def tables_of(tried: SlideTrial) -> Tables:
    """Errors of the force and values, next to the published ones, and the verdicts."""
    first, second = tried.lacking, tried.with_friction
    dry, pair = only(first, (COULOMB,)), only(first, (COULOMB, DIRECTION))
    models = [
        ("mass, viscous friction, offset: the file re-fitted", "viscous", first, first.refitted),
        ("and Coulomb friction", "coulomb", first, dry),
        ("and friction by direction", "direction", first, pair),
        ("all that the diagnosis found", "", first, first.final),
        ("Coulomb friction in the file: re-fitted", "coulomb", second, second.refitted),
        ("Coulomb friction in the file: all that was found", "direction", second, second.final),
    ]
    errors = [
        {
            "model": what, "published_percent": number(PUBLISHED_ERRORS.get(key, np.nan), 1),
            "here_percent": number(100.0 * force_error(d, fit), 1),
            "held_out_percent": number(100.0 * force_error(d, fit, True), 1),
        }
        for what, key, d, fit in models
    ]  # fmt: skip
    values = [dict(zip(("value", "published", "here_95"), row, strict=True)) for row in (*_of_dry(dry), *_of_both(pair))]
    verdicts = [_verdict(what, d) for what, d in (("without dry friction", first), ("with it", second))]
    return {"emps_errors": errors, "emps_values": values, "emps_verdicts": verdicts}


def _verdict(file: str, d: Diagnosis) -> dict[str, str]:
    session, terms = d.sessions[0], (*d.found, *d.described)
    return {
        "file": file,
        "found": ", ".join(f"{t.name} {t.grade}" for t in terms),
        "verdict": d.verdict.sentence,
        "steps": f"of {session.step:g} s; {int(session.used.sum())} of {len(session)} are compared, {d.split.text}",
    }


def _of_dry(dry: Fit) -> list[tuple[str, str, str]]:
    """The values with Coulomb friction alike both ways."""
    places = {
        "mass": (("", "mass"), "kg"),
        "viscous": (("", "viscous_friction"), "N s/m"),
        "coulomb": ((COULOMB, "friction"), "N"),
        "offset": (("", "torque_offset"), "N"),
    }
    bounds, values = intervals(dry), dry.estimates
    return [
        (
            f"{key}, alike both ways",
            PUBLISHED[key],
            f"{values[value]:.3g} [{bounds[value].low:.3g}, {bounds[value].high:.3g}] {unit}",
        )
        for key, (value, unit) in places.items()
    ]


def _of_both(both: Fit) -> list[tuple[str, str, str]]:
    """Viscous friction forward and in reverse, and Coulomb friction, with different sides due to an offset of the force."""
    bounds, values = intervals(both), both.estimates
    viscous, forward = ("", "viscous_friction"), (DIRECTION, "forward")
    keys = [f.key for f in both.free]
    i, j = keys.index(viscous), keys.index(forward)
    results = []
    for what, sign in (("forward", 1.0), ("reverse", -1.0)):
        value = values[viscous] + sign * values[forward]
        half = bounds[forward].high - bounds[forward].low, bounds[viscous].high - bounds[viscous].low
        by_curvature = both.covariance[i, i] + both.covariance[j, j] + 2.0 * sign * both.covariance[i, j]
        wide = max(0.5 * float(np.hypot(*half)), NORMAL_95 * float(np.sqrt(by_curvature)))
        here = f"{value:.3g} [{value - wide:.3g}, {value + wide:.3g}] N s/m"
        results.append((f"viscous {what}", PUBLISHED_BY_DIRECTION[what], here))
    friction, offset = (COULOMB, "friction"), ("", "torque_offset")
    sides = " and ".join(f"{values[friction] + sign * values[offset]:.3g}" for sign in (1.0, -1.0))
    here = f"{sides} N; half of their sum {values[friction]:.3g} [{bounds[friction].low:.3g}, {bounds[friction].high:.3g}] N"
    return [*results, ("coulomb forward and reverse", PUBLISHED_BY_DIRECTION["coulomb"], here)]
