# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Summarises a fleet's rows, ready for JSON: types, vehicles, changes over months, and dates of reaching limits."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from trackres_ros.checks import one_of
from trackres_ros.errors import InputError, nearest
from trackres_ros.text import figures, number_of, some_of
from trackres_ros.tools.fleet.changes import (
    DAY_S,
    FALSE_ALARMS,
    RAMP,
    STEP,
    TORQUE_GAIN,
    TORQUE_OFFSET,
    TWO_SIDED_95,
    YEAR_S,
    TrendLine,
    VehicleChange,
    levels,
    vehicle_changes,
)
from trackres_ros.tools.fleet.dataset import LOAD_RECORDED, OF_FILE, FleetDataset
from trackres_ros.tools.fleet.pooling import Pooled, Vehicles, pool, type_of
from trackres_ros.tools.fleet.run import present_values
from trackres_ros.tools.fleet.task import FIRST_DAY_S, NO_DAY

SHOWN = "bearing_friction", "loss_modulus_scale"  # over time, changed or not
OVERLAP_S = 1.0  # allowed overlap of two recordings: their clocks differ
LEFT_OUT = {
    "copies": "not used because another recording has the same content",
    "overlapping": "not used because their clocks overlap",
    "outdated": "not used because their vehicle's file has changed since",
    "undated": "not searched for changes because their clocks give no day",
}
OUTDATED = "its vehicle file has other values than the present one: analyse it again to compare it"
UNDATED = "its clock gives no day: it is used for the values of vehicle and type, not for changes"
MOSTLY = 0.5  # of a vehicle's recordings: where so many have no load, its payload may have changed
PAYLOAD = "payload"
FARTHEST_YEARS = 20.0  # limit of a forecast
TEXTS = ("url", "vehicle", "day", "status", "reason", "copy_of", "vehicle_values", "names", "units", "findings")
NUMBERS = (
    "start_s", "duration_s", "distance_m", "mismatch", "mean_torque", "mean_ambient", "residual_std", "held_out_file",
    "held_out_refit", "resistance_mj", "nominal", "std", "precision", "linear", LOAD_RECORDED, OF_FILE,
)  # fmt: skip


def day_of(time_s: float) -> str:
    """A day as people write it [UTC]."""
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d")


def _has_day(row: Mapping[str, Any]) -> bool:
    return bool(row["start_s"] > FIRST_DAY_S)


def without_copies(rows: Sequence[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[dict[str, str]]]:
    """Rows without those that the run marked as copies of another one, and the excluded ones, with the reason."""
    urls = {row["url"] for row in rows}
    copies = [row for row in rows if row["copy_of"] in urls]
    left_out = [_left_out(row, f"it has the same content as {row['copy_of']}, which is used") for row in copies]
    return [row for row in rows if row["copy_of"] not in urls], left_out


def _left_out(row: Mapping[str, Any], reason: str) -> dict[str, str]:
    return {"url": row["url"], "vehicle": row["vehicle"], "reason": reason}


def without_overlaps(rows: Iterable[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[dict[str, str]]]:
    """Rows without overlapping times of a vehicle, and the excluded ones, with the reason.

    Of recordings that begin at the same time, the longest stays.
    """
    separate: list[Mapping[str, Any]] = []
    left_out: list[dict[str, str]] = []
    last: Mapping[str, Any] | None = None  # the vehicle's last good one with a day
    for row in sorted(rows, key=lambda row: (row["vehicle"], row["start_s"] or 0.0, -(row["duration_s"] or 0.0), row["url"])):
        is_timed = row["status"] == "good" and row["day"] != NO_DAY
        if last is not None and last["vehicle"] != row["vehicle"]:
            last = None
        if last is not None and is_timed and row["start_s"] < last["start_s"] + last["duration_s"] - OVERLAP_S:
            left_out.append(_left_out(row, f"its clock overlaps with {last['url']}: of one vehicle only one can be right"))
        else:
            separate.append(row)
            last = row if is_timed else last
    return separate, left_out


def of_one_file(row: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Whether the vehicle file had the same values for both; in rows of earlier versions only the fitted ones are known."""
    values, second_values = row["vehicle_values"], second["vehicle_values"]
    return type_of(row) == type_of(second) and (values == second_values or None in (values, second_values))


def of_present_files(
    rows: Iterable[Mapping[str, Any]], present: Mapping[str, str]
) -> tuple[list[Mapping[str, Any]], list[dict[str, str]]]:
    """Rows with the present values of the vehicle file, and the excluded ones, with the reason.

    `rows`: good ones, of each vehicle in the order of time, as `without_overlaps` returns them; `present`: digests of the values,
    see `run.present_values`. For a vehicle that is not in it, the file of its latest recording is the present one.
    """
    rows = list(rows)
    latest = {}
    for row in sorted(rows, key=lambda row: row["vehicle_values"] is not None):  # those of earlier versions have no digest
        if None in (digest := present.get(row["vehicle"]), row["vehicle_values"]) or row["vehicle_values"] == digest:
            latest[row["vehicle"]] = row

    def is_present(row: Mapping[str, Any]) -> bool:
        return row["vehicle"] in latest and of_one_file(row, latest[row["vehicle"]])

    return list(filter(is_present, rows)), [_left_out(row, OUTDATED) for row in rows if not is_present(row)]


def trends(
    dataset: FleetDataset,
    limits: Mapping[str | None, Mapping[str, float]],
    rate: float = FALSE_ALARMS,
    vehicle: str | None = None,
) -> dict[str, Any]:
    """All findings in a dataset.

    `limits`: by vehicle and parameter, value for maintenance: for forecasts; those by None are of all vehicles, in place of their
    own; `rate`: of false alarms, per vehicle and year; `vehicle`: the
    only one to report; by default all. Raises InputError if there is nothing to compare, a limit of all vehicles of an unknown
    parameter, or no such vehicle.
    """
    all_rows = dataset.rows([*TEXTS, *NUMBERS])
    rows, copies = without_copies(all_rows)
    separate, overlapping = without_overlaps(rows)
    good, outdated = of_present_files((row for row in separate if row["status"] == "good"), present_values(dataset.folder))
    if not good:
        reasons = Counter(row["reason"] for row in [*outdated, *rows] if row["reason"]).most_common(1)
        raise InputError(str(dataset.folder), "no comparable recording", "one at least", reasons[0][0] if reasons else "")
    names = sorted({row["vehicle"] for row in good})
    if vehicle is not None and vehicle not in names:
        reason = next((row["reason"] for row in outdated if row["vehicle"] == vehicle), nearest(vehicle, names))
        raise InputError("--name", vehicle, f"one of {some_of(names)}", reason)
    types = [pool(data) for data in Vehicles.by_type(good)]
    parameters = sorted({name for pooled in types for name in pooled.data.names})
    for name in limits.get(None, {}):  # `run.check_limits` checks a vehicle's own ones, also of one without a usable recording
        one_of(name, "--limit", parameters)
    by_vehicle: dict[str, list[Mapping[str, Any]]] = {}
    for row in good:
        by_vehicle.setdefault(row["vehicle"], []).append(row)
    vehicles = {
        name: _vehicle(pooled, name, by_vehicle[name], {**limits.get(name, {}), **limits.get(None, {})}, rate)
        for pooled in types
        for name in pooled.by_vehicle
        if vehicle in (None, name)
    }

    def own(pooled: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        return [row for row in pooled if vehicle in (None, row["vehicle"])]

    bad = [row for row in own(rows) if row["status"] != "good"]
    return {
        "recordings": len(own(all_rows)),
        "compared": len(own(good)),
        "broken": [_left_out(row, row["reason"]) for row in bad],
        "copies": own(copies),
        "overlapping": own(overlapping),
        "outdated": own(outdated),
        "undated": [_left_out(row, UNDATED) for row in own(good) if not _has_day(row)],
        "false_alarms_per_vehicle_year": rate,
        "expected_false_alarms": sum(v["expected_false_alarms"] for v in vehicles.values()),
        "vehicle_years": sum(v["years"] for v in vehicles.values()),
        "types": [_type(pooled) for pooled in types],
        "vehicles": dict(sorted(vehicles.items())),
        "months": _months(own(good), vehicles),
    }


def _type(pooled: Pooled) -> dict[str, Any]:
    parameters = {}
    for i, name in enumerate(pooled.data.names):
        value, std = pooled.value(None, name)
        scale = float(pooled.data.std[i])
        parameters[name] = {
            "unit": pooled.data.units[i],
            "file": float(pooled.data.nominal[i]),
            "value": value,
            "std": std,
            "between_vehicles": scale * float(pooled.vehicle_scatter[i, i] ** 0.5),
            "between_recordings": scale * float(pooled.recording_scatter[i, i] ** 0.5),
            "per_10_k_of_air": scale * float(pooled.follows[i]),
        }
    return {"vehicles": sorted(pooled.by_vehicle), "recordings": len(pooled.data), "parameters": parameters}


def _vehicle(
    pooled: Pooled, name: str, rows: Sequence[Mapping[str, Any]], limits: Mapping[str, float], rate: float
) -> dict[str, Any]:
    values = {}
    for i, parameter in enumerate(pooled.data.names):
        value, std = pooled.value(name, parameter)
        typical = pooled.value(None, parameter)[0]
        unusual = float((pooled.by_vehicle[name][0][i] - pooled.mean[i]) / max(float(pooled.vehicle_scatter[i, i] ** 0.5), 1e-9))
        values[parameter] = {"value": value, "std": std, "beyond_type": value - typical, "in_stds_of_type": unusual}
    changes, threshold_gain, allowed = vehicle_changes(pooled, name, rate)
    in_file = {n: (u, float(x)) for n, u, x in zip(pooled.data.names, pooled.data.units, pooled.data.nominal, strict=True)}
    unloaded, torque = sum(map(without_load, rows)), float(np.mean([row["mean_torque"] for row in rows]))
    starts = [row["start_s"] for row in rows if _has_day(row)]
    years = (max(starts) - min(starts)) / YEAR_S if starts else 0.0
    parameters_shown = sorted({*(c.parameter for c in changes), *limits, *SHOWN} & set(pooled.data.names)) if starts else []
    return {
        "recordings": len(rows),
        "first_day": day_of(min(starts)) if starts else None,
        "last_day": day_of(max(starts)) if starts else None,
        "years": years,
        "distance_km": sum(row["distance_m"] or 0.0 for row in rows) / 1000.0,
        "without_load": unloaded,
        "mismatch": _mean_mismatch(rows, False),
        "values": values,
        "changes": [
            _change(c, unloaded >= MOSTLY * len(rows), torque, *in_file[c.parameter])
            | {"forecast": forecast(c, max(starts), limits.get(c.parameter), in_file[c.parameter][1])}
            for c in changes
        ],
        "least_gain": threshold_gain
        if np.isfinite(threshold_gain)
        else None,  # None with too few recordings to look for a change
        "expected_false_alarms": allowed * years,
        "levels": {
            parameter: [[float(x) for x in series] for series in levels(pooled, name, parameter)]
            for parameter in parameters_shown
        },
    }


def _change(change: VehicleChange, unloaded: bool, torque: float, unit: str, in_file: float) -> dict[str, Any]:
    """A change; `torque`: the mean one of the vehicle [Nm], to which an error of its sensor is compared."""
    over = {TORQUE_GAIN: 1.0, TORQUE_OFFSET: max(torque, 1e-9)}.get(change.parameter)
    return {
        "parameter": change.parameter,
        "alike": [*change.rivals, *([PAYLOAD] if unloaded else [])],
        "kind": change.kind,
        "since": day_of(change.since_s),
        "known": day_of(change.known_s),
        "since_s": change.since_s,
        "known_s": change.known_s,
        "ended": None if change.ended_s is None else day_of(change.ended_s),
        "ended_s": change.ended_s,
        "recordings_until_known": change.recordings,
        "before": change.level,
        "size": change.size,
        "size_std": change.size_std,
        "unit": unit,
        "file": in_file,
        "percent_of_file": 100.0 * change.size / abs(in_file) if in_file else None,
        "percent_of_torque": 100.0 * change.size / over if over else None,
        "gain": change.gain,
    }


def forecast(change: VehicleChange, last_s: float, limit: float | None, in_file: float) -> dict[str, Any] | None:
    """When a trend reaches its limit: the day, and its 95 % interval; None without a limit,
    or without a trend towards it.

    It has reached the limit if that is between its present value and the one before, or the vehicle file's, `in_file`: it may
    begin beyond. The present slope is assumed to continue. The interval has the uncertainty of the present value, the slope
    and the beginning.
    """
    if limit is None or not change.lines:
        return None
    line = change.lines[0]
    if (limit - line.value) * change.size <= 0.0:
        is_reached = any((limit - begin) * change.size > 0.0 for begin in (change.level, in_file))
        return {"limit": limit, "reached": True, "day": None, "from": None, "to": None} if is_reached else None
    if line.slope * change.size <= 0.0:  # another change has ended it
        return None
    spans = [_span(line, limit) for line in change.lines if line.deficit <= 0.5 * TWO_SIDED_95**2]
    ends = (limit - line.value) / line.slope, min(first for first, _ in spans), max(last for _, last in spans)
    horizon = FARTHEST_YEARS * 365.25
    days_shown = [day_of(last_s + end * DAY_S) if end < horizon else None for end in ends]
    return {"limit": limit, "reached": False, "day": days_shown[0], "from": days_shown[1], "to": days_shown[2]}


def _span(line: TrendLine, limit: float) -> tuple[float, float]:
    """First and last day from now on which the limit is within the line's 95 % interval: E. C. Fieller, Journal of the Royal
    Statistical Society B 16 (1954) 175.
    """
    away, wide = limit - line.value, TWO_SIDED_95**2 - 2.0 * line.deficit
    # (away - slope t)^2 <= wide (now_var + 2 both t + slope_var t^2), as a square in t
    square, constant = line.slope**2 - wide * line.slope_var, away**2 - wide * line.value_var
    half = away * line.slope + wide * line.covariance
    top = half + float(np.sqrt(max(half**2 - square * constant, 0.0)))
    first = 0.0 if constant <= 0.0 or top <= 0.0 else constant / top
    return first, max(top / square, 0.0) if square > 0.0 else np.inf


def without_load(row: Mapping[str, Any]) -> bool:
    """Whether the vehicle file's weight was assumed, as no load was recorded: the mismatch may be that of the payload."""
    return row[LOAD_RECORDED] is False


def _months(rows: Iterable[Mapping[str, Any]], vehicles: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """By vehicle and month: number of recordings, their strongest change, and their mean mismatch; separately for those without
    a load.
    """
    groups: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    for row in rows:
        groups.setdefault(row["vehicle"], {}).setdefault(row["day"][:7], []).append(row)
    result: dict[str, dict[str, dict[str, Any]]] = {}
    for vehicle, months in sorted(groups.items()):
        starts = [row["start_s"] for group in months.values() for row in group]
        result[vehicle] = {month: _month(group, starts, vehicles[vehicle]["changes"]) for month, group in sorted(months.items())}
    return result


def _month(rows: Sequence[Mapping[str, Any]], starts: Sequence[float], changes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    parts = [part for c in changes for row in rows if (part := _part(c, starts, row["start_s"])) is not None]
    return {
        "recordings": len(rows),
        "change": max(parts, key=strength, default=None),
        "mismatch": _mean_mismatch(rows, False),
        "without_load": sum(map(without_load, rows)),
        "mismatch_without_load": _mean_mismatch(rows, True),
    }


def _part(change: Mapping[str, Any], starts: Sequence[float], time_s: float) -> dict[str, Any] | None:
    """The part of a change at one recording of its vehicle, whose recordings begin at `starts`, see `changes.shapes`; None before
    it and after its end.
    """
    end_s = np.inf if change["ended_s"] is None else change["ended_s"]
    if not change["since_s"] <= time_s < end_s:
        return None
    share = 1.0
    if change["kind"] != STEP:
        before = max((t for t in starts if FIRST_DAY_S < t < change["since_s"]), default=change["since_s"] - DAY_S)
        share = (time_s - before) / (max(t for t in starts if t < end_s) - before)
    sizes = ((key, change[key]) for key in ("size", "percent_of_file", "percent_of_torque"))
    scaled = {key: None if size is None else share * size for key, size in sizes}
    return {key: change[key] for key in ("parameter", "unit", "alike")} | scaled


def strength(change: Mapping[str, Any]) -> float:
    """Size of a change in per cent of the file's value, of an error of the torque sensor in per cent of the mean torque."""
    return abs(float(next((x for key in ("percent_of_torque", "percent_of_file") if (x := change[key]) is not None), 0.0)))


def ranked(vehicles: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Names of vehicles: those with a lasting change, the strongest first, then those whose change ended, then the others."""

    def rank(name: str) -> tuple[bool, bool, float, str]:
        changes = vehicles[name]["changes"]
        lasting = [c for c in changes if not c["ended"]]
        return not lasting, not changes, -max(map(strength, lasting or changes), default=0.0), name

    return sorted(vehicles, key=rank)


def _mean_mismatch(rows: Sequence[Mapping[str, Any]], unloaded: bool) -> float | None:
    """Of those without a load, or of the others."""
    values = [row["mismatch"] for row in rows if without_load(row) is unloaded]
    return float(np.mean(values)) if values else None


def amount(change: Mapping[str, Any]) -> tuple[float, str]:
    """Size of a change as people write it, and its unit: per cent of the file's value; without one the parameter's own unit."""
    if change["percent_of_file"] is not None:
        return change["percent_of_file"], "%"
    if change["parameter"] == TORQUE_GAIN:
        return change["percent_of_torque"], "% of the reading"
    return change["size"], "" if change["unit"] == "1" else change["unit"]


def change_sentence(vehicle: str, c: Mapping[str, Any]) -> str:
    """A change in a sentence."""
    past_verb, verb = ("rose", "rises") if c["size"] > 0 else ("fell", "falls")
    phrase = f"{c['parameter']} {past_verb} at once on {c['since']}"
    if c["kind"] == RAMP:
        phrase = f"{c['parameter']} {past_verb if c['ended'] else verb} gradually since {c['since']}"
    size, unit = amount(c)
    reach = TWO_SIDED_95 * abs(size / c["size"]) * c["size_std"]
    of_file = "" if c["percent_of_file"] is None else " of the file's value"
    text = f"{vehicle}: {phrase}, by {figures(abs(size))} +- {figures(reach, 2)} {unit}".rstrip()
    text += f"{of_file} (95 %), known on {c['known']}"
    if c["ended"]:
        text += f", and came back by {c['ended']}"
    if c["alike"]:
        text += f"; {' or '.join(c['alike'])} would also explain it"
    f = c["forecast"]
    if f and f["reached"]:
        text += f"; already beyond its limit {figures(f['limit'])}"
    elif f:
        ends = f"{f['from'] or 'later'} to {f['to'] or 'not within 20 years'}"
        text += f"; reaches {figures(f['limit'])} on {f['day'] or 'no day within 20 years'} ({ends})"
    return text


def sentences(result: Mapping[str, Any]) -> list[str]:
    """Findings as lines of text."""
    changes = [change_sentence(name, c) for name in ranked(result["vehicles"]) for c in result["vehicles"][name]["changes"]]
    count = len(result["vehicles"])
    head = [f"{result['compared']} of {result['recordings']} recordings of {number_of(count, 'vehicle')} compared"]
    short = sum(v["least_gain"] is None for v in result["vehicles"].values())
    if not changes and short < count:
        head.append("No vehicle has changed significantly")
    rate, expected = figures(result["false_alarms_per_vehicle_year"]), figures(result["expected_false_alarms"], 2)
    lines = [*head, *changes, f"Expected false alarms: at most {rate} per vehicle and year, {expected} here"]
    if short:
        lines.append(f"{number_of(short, 'vehicle has', 'vehicles have')} too few recordings to look for a change")
    for name in sorted({row["vehicle"] for row in result["outdated"]} - result["vehicles"].keys()):
        lines.append(f"{name}: not compared, as none of its recordings was analysed with its present file")
    unloaded = sum(v["without_load"] for v in result["vehicles"].values())
    if unloaded:
        have = number_of(unloaded, "recording has", "recordings have")
        lines.append(f"{have} no load: their mismatch may come from the payload")
    for kind, reason in LEFT_OUT.items():
        if result[kind]:
            lines.append(f"{number_of(len(result[kind]), 'recording')} {reason}: {result[kind][0]['url']}")
    if result["broken"]:
        lines.append(f"{number_of(len(result['broken']), 'unusable recording')}, the first: {result['broken'][0]['reason']}")
    return lines
