# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bytes changed at random, as a bad disk, a cut transfer or a hostile hand changes them."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

MOST_BYTES = 4096
"""Longest run that one change inserts, repeats, moves or removes."""
EXTREMES = tuple(
    number.to_bytes(size, order)
    for size in (1, 2, 4, 8)
    for number in (0, 1, 2 ** (8 * size - 1) - 1, 2 ** (8 * size - 1), 2 ** (8 * size) - 1)
    for order in ("little", "big")
)
"""Extreme numbers of 1, 2, 4 and 8 bytes, signed and not, in both orders."""
TEXTS = (
    *(text.encode() for text in ("nan", "inf", "-inf", "1e999", "-0", "1e308", "9" * 40, "null", "~", "true", "''", '"')),
    *(b",", b":", b"\t", b"\r", b"\n", b"\0", b"\xff\xfe", b"\xef\xbb\xbf"),
    *(b"[" * 64, b"{" * 64, b"- " * 32, b"&a *a", b"!!python/none "),
)
"""What means something to one text format or another."""


def _place(data: bytearray, dice: random.Random) -> int:
    return dice.randrange(len(data) + 1)


def _run(data: bytearray, dice: random.Random) -> tuple[int, int]:
    """Begin and end of a run, mostly a short one."""
    start = _place(data, dice)
    return start, min(len(data), start + min(MOST_BYTES, int(2 ** dice.uniform(0.0, 13.0))))


def _flip(data: bytearray, dice: random.Random) -> None:
    for _ in range(dice.choice((1, 1, 1, 4, 32))):
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)


def _noise(data: bytearray, dice: random.Random) -> None:
    start, stop = _run(data, dice)
    data[start:stop] = dice.randbytes(stop - start)


def _cut(data: bytearray, dice: random.Random) -> None:
    del data[_place(data, dice) :]


def _remove(data: bytearray, dice: random.Random) -> None:
    start, stop = _run(data, dice)
    del data[start:stop]


def _insert(data: bytearray, dice: random.Random) -> None:
    start = _place(data, dice)
    data[start:start] = dice.randbytes(min(MOST_BYTES, int(2 ** dice.uniform(0.0, 10.0))))


def _repeat(data: bytearray, dice: random.Random) -> None:
    start, stop = _run(data, dice)
    data[start:start] = data[start:stop] * dice.choice((1, 1, 2, 64))


def _move(data: bytearray, dice: random.Random) -> None:
    start, stop = _run(data, dice)
    run = data[start:stop]
    del data[start:stop]
    to = _place(data, dice)
    data[to:to] = run


def _extreme(data: bytearray, dice: random.Random) -> None:
    """Overwrite bytes with an extreme number, such as a length, a count or an offset."""
    number = dice.choice(EXTREMES)
    start = dice.randrange(len(data))
    data[start : start + len(number)] = number


def _digits(data: bytearray, dice: random.Random) -> None:
    """Put an extreme text into the place of a number in text, if there is one."""
    start = dice.randrange(len(data))
    while start < len(data) and data[start] not in b"0123456789":
        start += 1
    stop = start
    while stop < len(data) and data[stop] in b"0123456789.eE+-":
        stop += 1
    data[start:stop] = dice.choice(TEXTS)


def _text(data: bytearray, dice: random.Random) -> None:
    start = _place(data, dice)
    data[start:start] = dice.choice(TEXTS)


CHANGES: tuple[Callable[[bytearray, random.Random], None], ...] = (
    *(_flip, _flip, _flip, _flip, _extreme, _extreme, _extreme, _digits, _digits),
    *(_noise, _cut, _remove, _insert, _repeat, _move, _text),
)
"""Small changes come more often: large ones are mostly refused at the door."""


def mutations(data: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Yield changed copies of some bytes, each by one to three changes; the same for the same seed.

    Parameters
    ----------
    data : bytes
        Bytes to change; not empty.
    count : int
        Number of copies.
    seed : int
        Of the random numbers.
    """
    for number in range(count):
        dice = random.Random(f"{seed} {number}")
        changed = bytearray(data)
        for _ in range(dice.choice((1, 1, 1, 2, 3))):
            if changed:
                dice.choice(CHANGES)(changed, dice)
        yield bytes(changed)
