# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Separates a torque step or drift from the vehicle's parameters: block residuals come in; the reason to pause learning goes
out.
"""

from __future__ import annotations

import math

from trackres_ros.learning.blocks import BLOCK_S, CONFIRMED, LEAST_BLOCKS, STEP_SHARE, STEP_STDS, ResidualBlock
from trackres_ros.learning.filter import expected
from trackres_ros.learning.learned import SLOW_KEEPS, LearnerState
from trackres_ros.learning.parameters import GAIN, SLOPE, SLOW, STEP
from trackres_ros.vehicle import Disturbance, Spells

FIRST_SHARE = 0.015  # of the rolling resistance: prior difference of blocks
STEP_HOLDS_S = 600.0  # driving after a step during which no vehicle parameter is learned
GAIN_STEP_STD = 0.05  # of a sensor that was replaced
DISAGREES_SHARE, DISAGREES_S = 0.08, 60.0  # of the samples of a minute that disagree with the others
ALIKE_SHARE = 0.3  # allowed difference of a step from a spell in the vehicle file
LASTS_S = 60.0  # before a disturbance is fed forward
LASTING_SHARE = 0.02  # of the rolling resistance: limit on the feed-forward of a disturbance
SAID_SHARE, SAID_STDS = 0.02, 3.0  # of the rolling resistance, and of a minute's mean: a larger unmodelled torque is reported
FADES = 0.5  # remaining share a second later without a torque


def close_block(s: LearnerState) -> None:
    """Finish a block: check for a step, and whether learned values explain more than the file."""
    s.blocks += 1
    block, before = s.block, s.last_block
    s.last_block, s.block = block, ResidualBlock()
    if before.seconds:
        _judge(s, _level(s, block), _level(s, before))
    s.past.see(_level(s, block) - float(s.mean[STEP]), SLOW_KEEPS)
    _tell(s)
    s.contest.see(block.gain)
    s.fresh.see(block.gain)
    s.keep_before()


def _level(s: LearnerState, block: ResidualBlock) -> float:
    """Residual of a block by present knowledge, without disturbances; against travel [Nm]."""
    return (block.residual - expected(s.mean[:SLOW], block.looks[:SLOW])) * block.sign


def _judge(s: LearnerState, level: float, last: float) -> None:
    """Follow the levels of the present block and of the last."""
    least = s.least_variance if s.wandering.blocks else (FIRST_SHARE * s.rolling) ** 2
    threshold = max(STEP_SHARE * s.rolling, STEP_STDS * s.wandering.std(least))
    if s.suspect:
        size, s.suspect = s.suspect, 0.0
        if (level - s.suspect_level) / size > CONFIRMED:
            _step_found(s, level - s.suspect_level)
        else:
            s.wandering.see(size, least)
        return
    difference = level - last
    if min(s.wandering.blocks, s.blocks) >= LEAST_BLOCKS and abs(difference) > threshold:
        s.suspect, s.suspect_level = difference, last
    else:
        s.wandering.see(difference, least)


def _step_found(s: LearnerState, size: float) -> None:
    """Take it for a disturbance, or for another sensor: go back to before it, and let those two take it up."""
    s.mean[:], s.covariance[:] = s.before_mean, s.before_covariance
    s.covariance[STEP, STEP] += max(size * size, (LASTING_SHARE * s.rolling) ** 2)
    s.covariance[GAIN, GAIN] += GAIN_STEP_STD**2
    s.mean[STEP] += size
    s.past.pause()
    s.ground.lost()
    s.step_s, s.step_nm = 0.0, size
    s.recent_mean[:], s.recent_covariance[:] = s.mean, s.covariance


def _tell(s: LearnerState) -> None:
    """Whether the mean residual of a minute exceeds the short disturbances and the error of the slope."""
    mean, std = s.past.of_late()
    std = math.hypot(std, math.sqrt(s.covariance[SLOPE, SLOPE]) * s.last_block.looks[SLOPE])  # a slope that is followed
    least = SAID_SHARE * s.rolling
    if not (abs(mean) > max(0.5 * least, std) and mean * s.disturbance_nm > 0.0):  # gone, or another
        s.disturbed_s = 0.0
    if s.disturbed_s or abs(mean) > max(least, SAID_STDS * std):
        s.disturbance_nm, s.disturbed_s = mean, s.disturbed_s + BLOCK_S
    else:
        s.disturbance_nm = 0.0


def let_last(s: LearnerState, compared: bool) -> None:
    """Feed a lasting disturbance forward, within a bound; it fades without a compared torque."""
    if not compared:
        s.lasting_nm *= FADES
        s.lasting_s = 0.0
        return
    there = float(s.mean[SLOW] + s.mean[STEP])
    std = math.sqrt(max(float(s.covariance[SLOW, SLOW] + s.covariance[STEP, STEP]), 0.0))
    sure = abs(there) > 2.0 * std
    s.lasting_s = s.lasting_s + 1.0 if sure and there * s.lasting_nm >= 0.0 else 0.0
    most = LASTING_SHARE * s.rolling
    aim = min(max(there, -most), most) if s.lasting_s > LASTS_S else 0.0
    s.lasting_nm += 0.1 * (aim - s.lasting_nm)


def why_frozen(s: LearnerState, known: Disturbance | None) -> str:
    """Reason why learning is paused; empty if it is not. `known` is the disturbance of the vehicle file."""
    if s.disagrees > DISAGREES_SHARE:
        return f"{100.0 * s.disagrees:.0f} % of the measured torques disagree with the others"
    if s.suspect:
        return f"a step of {s.suspect:+.0f} Nm is being checked"
    if s.step_s < STEP_HOLDS_S:
        return f"{said(s.step_nm, s.step_s, known)}: caused by a sensor, brake, load or the ground"
    return ""


def disturbance_text(s: LearnerState, known: Disturbance | None) -> str:
    """Text on an unmodelled torque outside the vehicle's parameters; empty without one. See `why_frozen`."""
    return said(s.disturbance_nm, s.disturbed_s, known) if s.disturbance_nm else ""


def said(torque_nm: float, driven_s: float, known: Disturbance | None) -> str:
    """A disturbance in words, with a remark if it is as large as the vehicle file's; `driven_s` is the driving with it."""
    kind = ""
    if isinstance(known, Spells):
        size = abs(known.level - known.rest)
        kind = f", of the kind seen before ({known.form})" if abs(abs(torque_nm) - size) < ALIKE_SHARE * size else ""
    return f"a disturbance of {torque_nm:+.0f} Nm for {driven_s:.0f} s{kind}"
