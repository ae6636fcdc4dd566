# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Joins the packets of the J1939 transport protocol to messages of more than 8 bytes (SAE J1939-21).

Libraries that do this talk to a live bus and wait by the clock of the machine; a log has its own.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

CONNECTION, PACKET = 0xEC, 0xEB
"""PDU formats of TP.CM, which announces a message, and of TP.DT, which carries it."""
REQUEST_TO_SEND, ACKNOWLEDGED, BROADCAST, ABORT = 16, 19, 32, 255
"""Control bytes of TP.CM that are read; the receiver's CTS (17) is not needed."""
SMALLEST, LARGEST = 9, 1785
"""Bytes of a message: one more than a frame holds, 255 packets."""
OF_A_PACKET = 7
LONGEST_PAUSE_NS = 1_250_000_000
"""T2 and T3 of the standard: time after which a receiver gives up."""
EVERYONE = 255
"""Receiver of a broadcast."""
MOST_TRANSFERS = 1024
"""At once; a damaged log may begin any number."""


class Frame(NamedTuple):
    """A data frame, or a joined message: stamp [ns], identifier, whether it has 29 bits, number of the bus, and bytes."""

    stamp_ns: int
    id: int
    extended: bool
    bus: int | None
    data: bytes


@dataclass(slots=True)
class _Transfer:
    """A message under way: its group, its content, the packets that are missing, and the stamp of the newest one."""

    group: int
    content: bytearray
    missing: set[int]
    newest_ns: int


def is_transport(frame: Frame) -> bool:
    """Whether a frame belongs to the protocol."""
    return frame.extended and frame.id >> 16 & 0x3FF in (CONNECTION, PACKET)


def with_joined(frames: Iterator[Frame], met: Counter[str]) -> Iterator[Frame]:
    """Yield all frames, and each joined message after its last packet, with the stamp of that packet.

    A sender has at most one broadcast in progress, and one transfer to each receiver. Packets may be repeated or reordered, as a
    receiver requests them again; nobody requests those of a broadcast that is complete.

    `frames`: in the order of the log; `met`: counts losses: `incomplete` messages, and `stray` packets of messages that were not
    announced.
    """
    transfers: dict[tuple[int | None, int, int], _Transfer] = {}

    def end(key: tuple[int | None, int, int]) -> None:
        ended = transfers.pop(key, None)
        met["incomplete"] += bool(ended and ended.missing)

    for frame in frames:
        yield frame
        if not is_transport(frame):
            continue
        sender, receiver = frame.id & 0xFF, frame.id >> 8 & 0xFF
        key = (frame.bus, sender, receiver)
        if frame.id >> 16 & 0xFF == CONNECTION:
            control = frame.data[0] if frame.data else None
            if control in (REQUEST_TO_SEND, BROADCAST):
                end(key)
                announced = _announced(frame)
                if announced is None:
                    met["incomplete"] += 1
                    continue
                if len(transfers) >= MOST_TRANSFERS:
                    end(next(iter(transfers)))
                transfers[key] = announced
            elif control == ACKNOWLEDGED:  # by the receiver
                end((frame.bus, receiver, sender))
            elif control == ABORT:  # by the sender, or by the receiver
                end(key)
                end((frame.bus, receiver, sender))
            continue
        transfer = transfers.get(key)
        if transfer and frame.stamp_ns - transfer.newest_ns > LONGEST_PAUSE_NS:
            end(key)
            transfer = None
        if transfer is None or not _take(frame, transfer):
            met["stray"] += 1
        elif not transfer.missing and transfer.content:
            yield Frame(frame.stamp_ns, _identifier(frame.id, transfer.group), True, frame.bus, bytes(transfer.content))
            transfer.content.clear()
            if receiver == EVERYONE:
                end(key)  # others are kept, for packets that the receiver requests again
    for key in list(transfers):
        end(key)


def _announced(frame: Frame) -> _Transfer | None:
    """The transfer that TP.CM begins; None if it is inconsistent."""
    size, packets = int.from_bytes(frame.data[1:3], "little"), frame.data[3] if len(frame.data) == 8 else 0
    if not SMALLEST <= size <= LARGEST or packets != -(-size // OF_A_PACKET):
        return None
    group = int.from_bytes(frame.data[5:8], "little") & 0x3FFFF
    return _Transfer(group, bytearray(size), set(range(1, packets + 1)), frame.stamp_ns)


def _take(frame: Frame, transfer: _Transfer) -> bool:
    """Store a packet; return whether it belongs to the transfer."""
    number = frame.data[0] if frame.data else 0
    transfer.newest_ns = frame.stamp_ns
    if not transfer.content:
        return True  # a repetition, in a complete message
    start = (number - 1) * OF_A_PACKET
    packet = frame.data[1 : 1 + min(OF_A_PACKET, len(transfer.content) - start)]
    if number == 0 or start >= len(transfer.content) or len(packet) < min(OF_A_PACKET, len(transfer.content) - start):
        return False
    transfer.content[start : start + len(packet)] = packet
    transfer.missing.discard(number)
    return True


def _identifier(packet: int, group: int) -> int:
    """The identifier of the message: priority and sender of its packets and, if the group has one, their receiver."""
    with_receiver = group >> 8 & 0xFF < 240  # PDU1
    return packet & 0x1C0000FF | group << 8 | (packet & 0xFF00 if with_receiver else 0)
