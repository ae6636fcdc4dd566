# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Everything the live node can notice, with its level: one table for status, diagnostics and docs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from trackres_ros.estimator import columns as at
from trackres_ros.node.transport import Level


@dataclass(frozen=True, slots=True)
class NoticeKind:
    """A kind of notice."""

    level: Level
    meaning: str
    awaited: bool = False  # present at every start until the inputs have arrived
    of_start: bool = False  # about the start of the node: the log has it once, the diagnostics in the entry of the state


@dataclass(frozen=True, slots=True)
class Notice:
    """A present notice: its name in `KINDS`, and a sentence with the particulars."""

    name: str
    text: str

    @property
    def level(self) -> Level:
        """Level of its kind."""
        return KINDS[self.name].level


LIVE_KINDS = {
    "NO_SPEED": NoticeKind(Level.STALE, "no speed was accepted since the start: only the status is published", awaited=True),
    "SPEED_OLD": NoticeKind(
        Level.STALE,
        "the last accepted speed is older than `speed_max_age_s`: the outputs keep the last stamp and values, "
        "and the feed-forward fades to zero",
    ),
    "INACTIVE": NoticeKind(
        Level.STALE, "the node is deactivated, or ends by request: the feed-forward goes to zero, then nothing is published"
    ),
    "NO_CLOCK": NoticeKind(
        Level.STALE, "`use_sim_time` is set and no /clock message has arrived, or it shows a time before 0", awaited=True
    ),
    "TWO_SPEEDS": NoticeKind(
        Level.STALE, "publishers of the speed disagree: none is used, and the feed-forward goes to zero; the text names them"
    ),
    "TORQUE_CONTESTED": NoticeKind(
        Level.STALE,
        "another node publishes on a topic of the feed-forward: ours goes to zero, or was never begun; the text names the node",
    ),
    "INTERNAL_ERROR": NoticeKind(
        Level.ERROR,
        "a bug made a message, a step or an output fail (details in the log): do not use the estimate",
    ),
    "PART_FAILED": NoticeKind(
        Level.WARN, "a bug made another part fail (details in the log); the estimate and its outputs continue"
    ),
    "NOT_RECORDED": NoticeKind(
        Level.WARN, "`--record` cannot write fast enough, or not at all; the text names the file and the losses"
    ),
    "OUTPUT_FAILED": NoticeKind(Level.ERROR, "the middleware rejected a message of an output topic; the others continue"),
    "REFUSED": NoticeKind(Level.WARN, "more than 10 % of an input's messages were rejected in the last second"),
    "OVERRUN": NoticeKind(
        Level.WARN, "messages arrived faster than they could be processed: the oldest were dropped and counted as `dropped`"
    ),
    "NO_PUBLISHER": NoticeKind(Level.WARN, "nobody publishes on the topic of an input", awaited=True),
    "WRONG_TYPE": NoticeKind(
        Level.WARN,
        "a publisher uses another message type on the topic of an input, or another definition; no message of the topic is used",
    ),
    "INCOMPATIBLE_QOS": NoticeKind(
        Level.WARN,
        "a publisher's quality of service is below what the input requests, or without ROS its definition of the type differs; "
        "it never connects",
    ),
    "NOT_LATCHED": NoticeKind(
        Level.WARN,
        "a publisher of load, ambient or passengers has sent nothing since the start, and keeps nothing for those who join later",
    ),
    "SEVERAL_PUBLISHERS": NoticeKind(
        Level.WARN,
        "more than one publisher on the topic of an input; of a speed one is used at a time, of others all, by their arrival",
    ),
    "CLOCK_OFFSET": NoticeKind(Level.WARN, "the stamps of the speed differ from this machine's time by more than a second"),
    "MISMATCH": NoticeKind(Level.WARN, "measured and expected torque differ by more than the estimate's uncertainty"),
    "DISTURBANCE": NoticeKind(
        Level.OK, "the vehicle file's intermittent torque is present now; the estimate does not include it"
    ),
    "LEARNING_FROZEN": NoticeKind(
        Level.OK, "learning from the measured torque is paused, or skips many samples; its text says why"
    ),
    "STATE_NOT_SAVED": NoticeKind(
        Level.WARN, "the state file could not be written: a restart would use an older state or start cold"
    ),
    "STATE_SHARED": NoticeKind(
        Level.WARN, "another running node has this state file: this one does not write it until that one has ended"
    ),
    "STATE_NOT_USED": NoticeKind(
        Level.OK, "the state file could not be used: cold start; its text says where the file is kept", of_start=True
    ),
}
AWAITED = (
    at.Reason.LOAD_NOMINAL
    | at.Reason.AMBIENT_NOMINAL
    | at.Reason.EFFECT_LEFT_OUT
    | at.Reason.PLACE_UNKNOWN
    | at.Reason.ENABLE_OLD
)
KINDS: Mapping[str, NoticeKind] = MappingProxyType(
    {
        **LIVE_KINDS,
        **{
            str(reason.name): NoticeKind(Level.OK if reason & at.HARMLESS else Level.WARN, text, bool(reason & AWAITED))
            for reason, text in at.REASON_TEXT.items()
        },
    }
)


def of_reasons(reasons: at.Reason) -> list[Notice]:
    """The notices of an estimate."""
    return [Notice(str(reason.name), text) for reason, text in at.REASON_TEXT.items() if reason & reasons]


def level_of(notices: Sequence[Notice]) -> Level:
    """The heaviest level."""
    return max((notice.level for notice in notices), default=Level.OK)
