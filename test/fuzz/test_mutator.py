# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of the mutator: reproducible, mostly different, never much longer than the input."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from mutator import MOST_BYTES, mutations

SEED = bytes(range(256)) * 8 + b"speed: 12.5\n" * 20


def test_the_same_for_the_same_seed() -> None:
    assert list(mutations(SEED, 50, 1)) == list(mutations(SEED, 50, 1))
    assert list(mutations(SEED, 50, 1)) != list(mutations(SEED, 50, 2))
    assert list(mutations(SEED, 80, 1))[:50] == list(mutations(SEED, 50, 1))


def test_nearly_all_copies_differ_from_the_seed_and_each_other() -> None:
    copies = list(mutations(SEED, 500, 3))
    assert sum(copy != SEED for copy in copies) > 450
    assert len(set(copies)) > 450


@given(data=st.binary(min_size=1, max_size=64), seed=st.integers(0, 10))
def test_any_bytes_can_be_changed(data: bytes, seed: int) -> None:
    for copy in mutations(data, 20, seed):
        assert len(copy) <= len(data) + 3 * 64 * MOST_BYTES
