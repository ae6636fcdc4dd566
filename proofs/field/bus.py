# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The trolley bus: channels are concealed one by one, and the findings are compared with them on a page.

Widmer, Ritter, Onder, "ZTBus: A Large Dataset of Time-Resolved City Bus Driving Missions", Scientific Data 10 (2023) 687.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from proofs.field.data import Array
from proofs.field.run import NOTHING, UPHILL, WARM, FieldTrial
from trackres_ros.diagnosis import Diagnosis, DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.empirical.payload import Payload
from trackres_ros.output.style import BLUE, GREY, VERMILION, picture
from trackres_ros.recording.bindings import Topics
from trackres_ros.route.track import Frame
from trackres_ros.text import figures
from trackres_ros.units import GRAVITY

FOLDER, VEHICLE, TOPICS = "ztbus", "ztbus_hess19", "ztbus"
SAME_PLACE_M = 15.0
SLOPE_OVER_M = 300.0
LONG_STRETCH_S = 300.0  # of driving
CLOSE = 0.08  # of the passengers' weight
SECONDS_PER_MIN = 60.0


@dataclass(frozen=True)
class PayloadFound:
    """Comparison of the found payload with the passengers: values of each stretch, masses relative to their mean [kg]."""

    begin_s: Array
    end_s: Array
    mass: Array
    std: Array
    true: Array
    correlation: float  # of the found masses with the passengers', weighted by time
    close: int  # joined stretches, see `mass_of_joined`, with a mean mass within `CLOSE` of the passengers' weight
    long: int  # all joined stretches
    longest_s: float  # driving in the longest stretch


def missions(data: Path) -> list[Path]:
    """The recordings of the bus that are there."""
    return sorted((data / FOLDER).glob("*.csv.gz"))


def try_bus(data: Path) -> list[FieldTrial]:
    """Diagnose each of the concealments; empty without missions."""
    paths = missions(data)
    if not paths:
        return []
    topics = Topics.load(TOPICS)

    def without(*hide: str) -> Diagnosis:
        return diagnose(read_recordings(paths, topics), load_base(VEHICLE).with_topics(topics), DiagnosisOptions(hide=hide))

    wanted = {
        "nothing": ((), UPHILL),
        "altitude": (("altitude",), UPHILL),
        "altitude and position": (("altitude", "latitude", "longitude"), NOTHING),
        "passengers": (("passengers",), frozenset({"payload"})),
        "steering angle": (("steering_angle",), NOTHING),
        "ambient temperature": (("ambient",), WARM),
        "brake pressure": (("brake",), NOTHING),
    }
    return [
        FieldTrial("trolley bus, a mission of 4.4 h", hidden, names, NOTHING, without(*roles), UPHILL)
        for hidden, (roles, names) in wanted.items()
    ]


def slope_found(tried: FieldTrial, given: FieldTrial) -> tuple[float, float] | None:
    """Correlation of the found slope with that of the altitude, which `given` has, averaged over all passes of a place and over
    300 m, and coefficient of its regression on that one; None without one.
    """
    final = tried.found.final
    if not UPHILL & set(final.effect_names):
        return None
    named = next(name for name in final.effect_names if name in UPHILL)
    radius = tried.found.base.facts.radius
    found, true = [], []
    for session, adds in zip(given.found.sessions, final.contribution(named), strict=True):
        surveyed = slope_by_all_passes(session.latitude, session.longitude, session.altitude, session.distance)
        there = session.used & np.isfinite(surveyed) & (np.abs(adds) > 0.0)
        found.append((adds / (session.weight * radius))[there])
        true.append(surveyed[there])
    x, y = np.concatenate(true), np.concatenate(found)
    return float(np.corrcoef(x, y)[0, 1]), float(np.polyfit(x, y, 1)[0])


def slope_by_all_passes(latitude: Array, longitude: Array, altitude: Array, distance: Array) -> Array:
    """Slope of the altitude averaged over all passes of each place, over 300 m; nan where unknown."""
    x, y = Frame.about(latitude, longitude).metres(latitude, longitude)
    known = np.isfinite(x) & np.isfinite(altitude)
    at = np.column_stack([x, y])[known]
    near = cKDTree(at).query_ball_point(at, SAME_PLACE_M)
    mean = np.array([altitude[known][rows].mean() for rows in near])
    ahead, behind = (np.interp(distance + side * 0.5 * SLOPE_OVER_M, distance[known], mean) for side in (1.0, -1.0))
    slope = np.full(len(distance), np.nan)
    inside = (distance - 0.5 * SLOPE_OVER_M > distance[known][0]) & (distance + 0.5 * SLOPE_OVER_M < distance[known][-1])
    slope[inside & known] = ((ahead - behind) / SLOPE_OVER_M)[inside & known]
    return slope


def payload_found(tried: FieldTrial, given: FieldTrial) -> PayloadFound | None:
    """Compare the found masses with the passengers, which `given` has; None without any."""
    stretches = next((t.pattern.stretches for t in tried.found.described if isinstance(t.pattern, Payload)), ())
    if not stretches:
        return None
    known = {s.name: s for s in given.found.sessions}
    driven, rows = [], []
    for stretch in stretches:
        session = known[stretch.recording]
        there = (session.time >= stretch.begin_s) & (session.time < stretch.end_s) & session.used
        if there.any():
            driven.append(float(there.sum()) * session.step)
            people = float(session.payload[there].mean()) / GRAVITY
            rows.append((stretch.begin_s, stretch.end_s, stretch.mass, stretch.std, people))
    begin, end, mass, std, true = np.array(rows).T
    weight = np.array(driven)
    mass, people = mass - np.average(mass, weights=weight), true - np.average(true, weights=weight)
    covariance = np.cov(np.stack([mass, people]), aweights=weight)
    correlation = float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    off, carried = (mass_of_joined(x, weight) for x in (mass - people, true))
    close = int((np.abs(off) < CLOSE * carried).sum())
    return PayloadFound(begin, end, mass, std, people, correlation, close, len(off), float(weight.max()))


def mass_of_joined(mass: Array, driven: Array) -> Array:
    """Means over consecutive stretches, joined until they have more than `LONG_STRETCH_S` of driving [s]; a shorter rest at the
    end is dropped.
    """
    joined, begin = list[float](), 0
    for end in range(1, len(mass) + 1):
        if driven[begin:end].sum() > LONG_STRETCH_S:
            joined.append(float(np.average(mass[begin:end], weights=driven[begin:end])))
            begin = end
    return np.array(joined)


def bus_page(tried: Sequence[FieldTrial], folder: Path, of_pictures: str = "") -> list[str]:
    """Lines of the page; pictures go to a folder, and links to them begin with `of_pictures`. None without a mission."""
    if not tried:
        return []
    given = next(t for t in tried if t.hidden == "nothing")
    lines = ["## The trolley bus, unsealed", ""]
    slopes = [(t.hidden, slope) for t in tried if (slope := slope_found(t, given)) is not None]
    if slopes:
        lines += ["The slope found, against that of the altitude averaged over all passes of a place and taken over 300 m:", ""]
        lines += ["| Concealed | Correlation | Coefficient |", "|---|---|---|"]
        lines += [f"| {hidden} | {correlation:.2f} | {coefficient:.2f} |" for hidden, (correlation, coefficient) in slopes]
        lines.append("")
    else:
        lines += ["No slope was found.", ""]
    hidden = next(t for t in tried if t.hidden == "passengers")
    payload = payload_found(hidden, given)
    if payload is None:
        return [*lines, "With the passengers concealed no payload was found.", ""]
    differ, error, stated = (
        figures(float(x)) for x in (payload.true.std(), np.sqrt(np.mean((payload.mass - payload.true) ** 2)), payload.std.mean())
    )
    lines.append(
        f"With the passengers concealed, the masses of {len(payload.mass)} stretches have a correlation of "
        f"{payload.correlation:.2f} with those of the passengers (70 kg each). These differ by {differ} kg. The masses are "
        f"{error} kg off; their stated standard deviation is {stated} kg. No stretch has more than {payload.longest_s:.0f} s of "
        f"driving. Joined until they have {LONG_STRETCH_S:.0f} s, {payload.close} of {payload.long} are within {CLOSE:.0%} of "
        "the passengers' weight."
    )
    _draw_payload(folder / "payload.png", payload)
    return [*lines, "", f"![Masses of stretches between stops, found and of passengers.]({of_pictures}payload.png)", ""]


def _draw_payload(path: Path, payload: PayloadFound) -> None:
    with picture(path, 9.0, 3.4) as figure:
        axes = figure.subplots()
        middle = 0.5 * (payload.begin_s + payload.end_s) / SECONDS_PER_MIN
        axes.errorbar(
            middle, payload.mass, 1.96 * payload.std, fmt="o", markersize=3, color=VERMILION, linewidth=1.0,
            label="found, and its 95 % interval",
        )  # fmt: skip
        axes.step(payload.begin_s / SECONDS_PER_MIN, payload.true, where="post", color=BLUE, label="passengers, 70 kg each")
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_xlabel("time [min]")
        axes.set_ylabel("mass less its mean [kg]")
        axes.legend()
