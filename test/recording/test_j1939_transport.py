# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Long messages of J1939: joined messages equal the sent ones, and the others are counted."""

from collections import Counter

from drive_files import packets
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.recording.can_signals import Frame, with_joined

STEP_NS = 10_000_000
SENT = st.tuples(st.sampled_from([0xFEB0, 0xFFC0, 0x0D200]), st.binary(min_size=9, max_size=80))
SENDERS = st.dictionaries(st.tuples(st.integers(0, 9), st.sampled_from([0x21, 0x22, 0xFF])), SENT, min_size=1, max_size=6)


def frames_of(senders):
    """The frames of each transfer by sender and receiver."""
    return {(s, r): packets(group, content, s, r) for (s, r), (group, content) in senders.items()}


def joined(frames):
    """Group, sender and content of the messages joined from frames, 10 ms apart; and the counts of losses."""
    met = Counter()
    sent_messages = [Frame(STEP_NS * place, number, True, 1, data) for place, (number, data) in enumerate(frames)]
    result = list(with_joined(iter(sent_messages), met))
    assert [frame for frame in result if len(frame.data) <= 8] == sent_messages
    long = [frame for frame in result if len(frame.data) > 8]
    return [(frame.id >> 8 & 0x3FFFF, frame.id & 0xFF, frame.data) for frame in long], +met


def expected(senders):
    return sorted((group | (r if group < 0xF000 else 0), s, content) for (s, r), (group, content) in senders.items())


@given(SENDERS, st.randoms())
def test_interleaved_messages_are_joined_as_sent(senders, random):
    queues = [list(frames) for frames in frames_of(senders).values()]
    mixed = []
    while queues := [queue for queue in queues if queue]:
        mixed.append(random.choice(queues).pop(0))
    result, met = joined(mixed)
    assert sorted(result) == expected(senders)
    assert not met


@given(SENDERS, st.data())
def test_a_lost_frame_loses_one_message_and_is_counted(senders, data):
    transfers = frames_of(senders)
    hit = data.draw(st.sampled_from(sorted(transfers)))
    own = [place for place, (number, _) in enumerate(transfers[hit]) if number & 0xFF == hit[0]]
    own = [place for place in own if transfers[hit][place][1][0] != 19]
    lost = data.draw(st.sampled_from(own))
    del transfers[hit][lost]
    result, met = joined([frame for frames in transfers.values() for frame in frames])
    assert sorted(result) == expected({key: value for key, value in senders.items() if key != hit})
    assert set(met) == {"stray" if lost == 0 else "incomplete"}


@given(st.binary(min_size=9, max_size=1785), st.data())
def test_packets_sent_again_change_nothing(content, data):
    frames = packets(0xFFC0, content, 3, 0x21)
    parts = frames[2:-1]
    repetition = data.draw(st.lists(st.sampled_from(parts), max_size=4))
    result, met = joined([*frames[:2], *data.draw(st.permutations(parts)), *repetition, frames[-1]])
    assert result == [(0xFFC0, 3, content)]
    assert not met


def test_what_ends_a_message_early_is_counted():
    total = packets(0xFFC0, bytes(20), 3, 0x21)
    abort = (0x1CEC0321, bytes([255, 3, 255, 255, 255, 0xC0, 0xFF, 0]))  # from the receiver
    assert joined([*total[:3], abort]) == ([], {"incomplete": 1})
    assert joined([*total[:3], *total]) == ([(0xFFC0, 3, bytes(20))], {"incomplete": 1})
    assert joined([total[0], *[(0x100, b"")] * 200, *total[2:]]) == ([], {"incomplete": 1, "stray": 3})
    contradiction = (total[0][0], bytes([16, 20, 0, 2, 255, 0xC0, 0xFF, 0]))
    assert joined([contradiction, *total[2:]]) == ([], {"incomplete": 1, "stray": 3})


def test_a_packet_after_a_whole_broadcast_is_counted():
    frames = packets(0xFFC0, bytes(20), 3, 0xFF)
    assert joined([*frames, frames[-1]]) == ([(0xFFC0, 3, bytes(20))], {"stray": 1})


@given(st.lists(st.tuples(st.sampled_from([0x1CECFF03, 0x1CEBFF03, 0x1CEC0321]), st.binary(max_size=8)), max_size=60))
def test_any_frames_are_read(frames):
    joined(frames)
