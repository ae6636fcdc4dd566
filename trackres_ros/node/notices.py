# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Everything the live node can notice, with its level: one table for status, diagnostics and docs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from trackres_ros.estimator import columns as at
from trackres_ros.node.transport import Level


@dataclass(frozen=True, slots=True)
class NoticeKind:
    """A kind of notice.

    Attributes
    ----------
    level, meaning
        How heavy it is, and what it means.
    awaited
        Whether it holds at every start until the inputs have come.
    of_start
        Whether it is about how the node began: the log has it once, the diagnostics in the entry of the state.
    """

    level: Level
    meaning: str
    awaited: bool = False
    of_start: bool = False


@dataclass(frozen=True, slots=True)
class Notice:
    """A notice that holds now: its name in `KINDS`, and a sentence with the particulars."""

    name: str
    text: str

    @property
    def level(self) -> Level:
        """Level of its kind."""
        return KINDS[self.name].level


LIVE_KINDS = {
    "NO_SPEED": NoticeKind(
        Level.STALE, "no speed was accepted since the start: nothing but the status is published", awaited=True
    ),
    "SPEED_OLD": NoticeKind(
        Level.STALE,
        "no speed was accepted for longer than `speed_max_age_s`: the outputs keep the stamp and values of the last state, "
        "and the feed-forward fades to zero",
    ),
    "NO_CLOCK": NoticeKind(Level.STALE, "`use_sim_time` is set and no /clock has come", awaited=True),
    "INTERNAL_ERROR": NoticeKind(
        Level.ERROR,
        "a message, a step or an output failed by a fault of this program, which the log has: do not use the estimate",
    ),
    "PART_FAILED": NoticeKind(
        Level.WARN, "another part failed by a fault of this program, which the log has; the estimate and its outputs go on"
    ),
    "NOT_RECORDED": NoticeKind(
        Level.WARN, "`--record` cannot write, or not as fast as messages come; the text names the file and what is lost"
    ),
    "OUTPUT_FAILED": NoticeKind(Level.ERROR, "the middleware did not take a message of an output topic; the others go on"),
    "REFUSED": NoticeKind(Level.WARN, "more than a tenth of the messages of an input were refused in the last second"),
    "OVERRUN": NoticeKind(
        Level.WARN, "messages came faster than they could be worked off: the oldest were dropped, and are counted as `dropped`"
    ),
    "NO_PUBLISHER": NoticeKind(Level.WARN, "nobody publishes on the topic of an input", awaited=True),
    "WRONG_TYPE": NoticeKind(Level.WARN, "somebody publishes another message type on the topic of an input; it never arrives"),
    "INCOMPATIBLE_QOS": NoticeKind(
        Level.WARN, "a publisher's quality of service is less than the input asks for; it never connects"
    ),
    "SEVERAL_PUBLISHERS": NoticeKind(Level.WARN, "more than one publisher on the topic of an input: their values are mixed"),
    "CLOCK_OFFSET": NoticeKind(Level.WARN, "the stamps of the speed are more than a second away from this machine's time"),
    "MISMATCH": NoticeKind(Level.WARN, "measured and expected torque have parted by more than the estimate's own uncertainty"),
    "DISTURBANCE": NoticeKind(
        Level.OK, "a torque that comes and goes, as the vehicle file tells of, is there now; the estimate does not have it"
    ),
    "LEARNING_FROZEN": NoticeKind(
        Level.OK, "a measured torque is there and nothing is learned from it now; what was learned before goes on as it was"
    ),
    "STATE_NOT_SAVED": NoticeKind(
        Level.WARN, "the state file could not be written: a restart would begin with an older state or cold"
    ),
    "STATE_NOT_USED": NoticeKind(Level.OK, "there was a state file and it could not be used: cold start", of_start=True),
    "COMPILING": NoticeKind(
        Level.OK, "first start on a machine: steps run in plain Python until they are compiled; same numbers"
    ),
}
AWAITED = at.Reason.LOAD_NOMINAL | at.Reason.AMBIENT_NOMINAL | at.Reason.EFFECT_LEFT_OUT | at.Reason.PLACE_UNKNOWN
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


def level_of(notices: list[Notice]) -> Level:
    """The heaviest level."""
    return max((notice.level for notice in notices), default=Level.OK)
