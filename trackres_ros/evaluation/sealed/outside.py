# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds physics that no catalogue has: what a vehicle does that nobody thought of.

None of it has a tidy form: edges are soft, sizes vary from one time to the next, and what decides when is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trackres_ros.evaluation.sealed.phenomenon import Adds, Array, Journey

STANDING_MPS = 0.1
SLIP_OF_ODOMETER = 0.01  # at most, of the length of a lap


def _draws(at: Journey, p: Mapping[str, float]) -> np.random.Generator:
    """A random generator for this phenomenon in this drive."""
    return np.random.default_rng([int(p["seed"]), int(at.driven)])


def _uneven(at: Journey, rng: np.random.Generator, share: float, seconds: float) -> Array:
    """A factor that wanders about 1, by a share as its standard deviation and within some time."""
    shocks = rng.normal(0.0, share * np.sqrt(2.0 * seconds / at.step), len(at.speed))
    return 1.0 + at.lagged(shocks, seconds, 0.0)


def _spells(at: Journey, rng: np.random.Generator, off_s: tuple[float, float], on_s: tuple[float, float]) -> Array:
    """On and off in turn for times within bounds, each time at a level of its own; when the first begins is drawn too."""
    out, i = np.zeros(len(at.speed)), int(rng.uniform(0.0, off_s[1]) / at.step)
    while i < len(out):
        held = int(rng.uniform(*on_s) / at.step)
        out[i : i + held] = rng.uniform(0.88, 1.12)
        i += held + int(rng.uniform(*off_s) / at.step)
    return out


def _sticking_brake(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """A brake that stays on for spells, as it likes, and lets go slowly."""
    rng = _draws(at, p)
    on = at.lagged(_spells(at, rng, (60.0, 300.0), (40.0, 150.0)), 2.5, 0.0)
    return p["torque"] * on * _uneven(at, rng, 0.05, 20.0) * at.direction


def _pump(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """An auxiliary on the drive train that cuts in for minutes, moving or not; it surges, then its pressure wanders."""
    rng = _draws(at, p)
    on = _spells(at, rng, (60.0, 300.0), (80.0, 260.0))
    surge = np.maximum(on - at.lagged(on, 15.0, 0.0), 0.0)
    return p["torque"] * at.lagged(on + 0.15 * surge, 1.5, 0.0) * _uneven(at, rng, 0.05, 20.0)


def _brake_after_stops(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """A brake that was used to hold the vehicle and, after some stops, drags until it has worn itself free."""
    rng, out = _draws(at, p), np.zeros(len(at.speed))
    standing = at.travel < STANDING_MPS
    for begin in np.flatnonzero(standing[:-1] & ~standing[1:]) + 1:
        held, drags, size = int(rng.uniform(40.0, 150.0) / at.step), rng.random() < 0.7, rng.uniform(0.85, 1.15)
        if drags:
            out[begin : begin + held] = size * np.linspace(1.1, 0.8, held)[: len(out) - begin]
    out[standing] = 0.0
    return p["torque"] * at.lagged(out, 3.0, 0.0) * at.direction


def _mud(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """Mud that builds up with every metre until a stop shakes most of it off."""
    rng = _draws(at, p)
    carried, out = 0.0, np.empty(len(at.speed))
    for i, travel in enumerate(at.travel):
        shed = (carried - 0.05) * at.step / 1.5 if travel < STANDING_MPS else 0.0
        carried = min(carried + travel * at.step / p["distance"], 1.0) - shed
        out[i] = carried
    return p["torque"] * out * _uneven(at, rng, 0.06, 25.0) * at.direction


def _left_turns(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """Something touches when it turns left, and only then."""
    touches = 1.0 / (1.0 + np.exp(-(at.drive.yaw_rate - 0.025) / 0.006))
    return p["torque"] * touches * _uneven(at, _draws(at, p), 0.06, 10.0) * at.direction


def _backlash(at: Journey, p: Mapping[str, float], torque: Array) -> Array:
    """Teeth that lie against one flank when driving and against the other when driven: the step between is not sharp."""
    side = np.arctan(torque / p["band"]) / np.pi
    return p["torque"] * at.lagged(side, 0.3, float(side[0])) * _uneven(at, _draws(at, p), 0.04, 30.0)


def _light_resonance(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """A suspension that swings at one speed, unless a load damps it."""
    light = 1.0 / (1.0 + np.exp((at.load - p["load"]) / 0.025))
    peak = 1.0 / (1.0 + ((at.travel - p["speed"]) / (p["width"] * (1.0 + 0.15 * (at.travel > p["speed"])))) ** 2)
    swings = at.lagged(peak, 1.5, 0.0)  # it takes some turns to build up
    return p["torque"] * light * swings * _uneven(at, _draws(at, p), 0.08, 12.0) * at.direction


def _stiff_joint(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """A joint in one belt that bends hard whenever it passes a wheel."""
    angle = 2.0 * np.pi * at.distance / (p["length"] * at.sheet["track.belt.loop_length"]) + p["phase"]
    wave = np.cos(angle) + 0.25 * np.cos(2.0 * angle + 1.0) + 0.1 * np.cos(3.0 * angle + 2.0)
    return p["torque"] * wave * _uneven(at, _draws(at, p), 0.06, 40.0) * at.direction


def _zero_drift(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """The zero of the torque sensor, set before each drive, wanders over many minutes and follows nothing."""
    walk = at.lagged(np.cumsum(_draws(at, p).normal(size=len(at.speed))), 90.0, 0.0)
    return np.asarray(p["torque"] * walk / np.sqrt(np.mean(walk**2)))


# The next three were written after the grammar of descriptions was frozen, by another hand, see `cases.AFTER_FREEZE`.


def _ratchet(at: Journey, p: Mapping[str, float], torque: Array) -> Array:
    """A sprocket that slips over the lugs of its belt when it pulls hard: the drive is lost for a second or two, then the teeth
    catch with a shock that swings out. The harder it pulls, and the slacker and colder the belt is, the more often.

    The vehicle keeps its speed over it, so what is lost is made up for, and the lugs that were climbed cost a little more.
    """
    rng, out = _draws(at, p), np.zeros(len(at.speed))
    moving = at.travel > STANDING_MPS
    cold = (1.0 - at.lagged(moving.astype(float), 500.0, 0.0)) * np.clip((20.0 - at.drive.ambient) / 15.0, 0.0, 1.0)
    tight = rng.normal(1.0, 0.05) * _uneven(at, rng, 0.04, 120.0)  # as it was tensioned before this drive
    over = torque * at.direction - p["limit"] * tight * (1.0 - 0.2 * cold)
    chance = p["rate"] * at.step / (1.0 + np.exp(-over / 300.0))
    held = 0
    for begin in np.flatnonzero(moving & (rng.random(len(out)) < chance)).tolist():
        lost_s, swings_s = rng.uniform(0.6, 2.0), rng.uniform(0.8, 2.0)
        lost, shock = rng.uniform(0.7, 1.3), rng.uniform(0.9, 1.4)
        if begin < held:
            continue  # it still slips
        held = begin + int(lost_s / at.step)
        out[begin:held] = -lost
        after = np.arange(len(out) - held) * at.step
        out[held:] += lost * shock * np.exp(-after / swings_s)
    added = np.maximum(p["torque"] * at.lagged(out, 0.15, 0.0), -0.8 * np.maximum(torque * at.direction, 0.0))
    return added * moving * at.direction


def _route_places(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """Soft ground and rises that no map has, at the same places of a route that is driven lap after lap, drive after drive.

    The odometer slips by up to a percent, in each lap by another share.
    """
    route, lap = np.random.default_rng(int(p["seed"])), p["lap"]
    count = int(route.integers(2, 5))
    centres = (np.arange(count) + route.uniform(0.3, 0.7, count)) * lap / count
    halves, edges, rises = route.uniform(12.0, 30.0, count), route.uniform(4.0, 12.0, count), route.random(count) < 0.4
    sizes = route.uniform(0.5, 1.0, count)
    lengths = lap * (1.0 + route.uniform(-SLIP_OF_ODOMETER, SLIP_OF_ODOMETER, int(at.distance[-1] / (0.98 * lap)) + 2))
    ends = np.cumsum(lengths)
    laps = np.searchsorted(ends, at.distance, side="right")
    position = lap * (1.0 - (ends[laps] - at.distance) / lengths[laps])
    rng, out = _draws(at, p), np.zeros(len(at.speed))

    def between(begin: float, end: float, edge: float) -> Array:
        ahead = (position - 0.5 * (begin + end) + 0.5 * lap) % lap - 0.5 * lap
        half = 0.5 * (end - begin)
        return np.asarray(0.5 * (np.tanh((ahead + half) / edge) - np.tanh((ahead - half) / edge)))

    for centre, half, edge, rises_here, size in zip(centres, halves, edges, rises, sizes / sizes.max(), strict=True):
        passes = size * rng.normal(1.0, 0.1, len(ends))[laps]  # each on another line
        if rises_here:  # and falls as much behind, over half as many metres again; the brakes hold it where it stands
            slope = between(centre - half, centre, edge) - between(centre, centre + 1.5 * half, edge) / 1.5
            out += passes * at.load * slope * np.abs(at.direction)
        else:
            out += passes * at.load**1.4 * between(centre - half, centre + half, edge) * at.direction
    return p["torque"] * out


def _seized_bearing(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """A bearing of a road wheel that rumbles, then binds for seconds, more and more often, and at some distance seizes for good:
    from there on the wheel is dragged along, breaks loose for seconds, and slides a little more easily the longer it did.
    """
    rng, worn = _draws(at, p), at.distance / p["distance"]
    slid = np.maximum(at.distance - p["distance"], 0.0)
    seized = 1.0 / (1.0 + np.exp(-(at.distance - p["distance"]) / 60.0))
    other, held = np.zeros(len(at.speed)), 0  # binds while it still turns, turns although it has seized
    for begin in np.flatnonzero(rng.random(len(other)) < 0.015 * at.step * np.minimum(worn, 1.0) ** 3).tolist():
        for_s, size = rng.uniform(3.0, 12.0), rng.uniform(0.3, 0.8)
        if begin >= held:
            held = begin + int(for_s / at.step)
            other[begin:held] = size
    other = at.lagged(other, 0.8, 0.0)
    drags = seized * (1.0 - other) * (0.85 + 0.15 * np.exp(-slid / 3000.0)) + (1.0 - seized) * (other + 0.05 * worn)
    return p["torque"] * drags * (0.3 + 0.7 * at.load) * _uneven(at, rng, 0.06, 15.0) * at.direction


PHENOMENA: dict[str, Adds] = {
    "sticking_brake": _sticking_brake,
    "mud": _mud,
    "left_turns": _left_turns,
    "pump": _pump,
    "brake_after_stops": _brake_after_stops,
    "backlash": _backlash,
    "light_resonance": _light_resonance,
    "stiff_joint": _stiff_joint,
    "ratchet": _ratchet,
    "route_places": _route_places,
    "seized_bearing": _seized_bearing,
}
"""What adds to the torque."""
SHOWN: dict[str, Adds] = {"zero_drift": _zero_drift}
"""What adds to nothing but what the torque's sensor shows."""
