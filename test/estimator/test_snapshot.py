"""Saved and taken up again."""

import json

import numpy as np
import pytest

from trackres_ros.errors import InputError
from trackres_ros.estimator import snapshot

START = 1_700_000_000_000_000_000
MS = 1_000_000


def messages(n):
    random = np.random.default_rng(2)
    stamp = START + np.arange(n, dtype=np.int64) * 20 * MS
    return np.zeros(n, dtype=np.int16), stamp, stamp, 8 + random.normal(0, 0.1, n)


def test_resumed_is_bit_equal_to_never_stopped(reference, tmp_path):
    channel, stamp, arrival, value = messages(3000)
    whole = reference.session().handle_block(channel, stamp, arrival, value)
    first = reference.session()
    before = first.handle_block(channel[:1234], stamp[:1234], arrival[:1234], value[:1234])
    snapshot.save(first, tmp_path / "state.json", saved_at=1.0)
    second = snapshot.resume(reference, tmp_path / "state.json")
    after = second.handle_block(channel[1234:], stamp[1234:], arrival[1234:], value[1234:])
    assert np.array_equal(whole.rows, np.concatenate([before.rows, after.rows]), equal_nan=True)


def test_time_off_cools_the_belt(reference, tmp_path):
    session = reference.session()
    session.handle_block(*messages(60_000))
    warm = session.belts[0, 0, 0]
    snapshot.save(session, tmp_path / "state.json", saved_at=1000.0)
    soon, off = snapshot.after_time_off(reference, tmp_path / "state.json", now=1600.0, ambient=0.0)
    late, _ = snapshot.after_time_off(reference, tmp_path / "state.json", now=1000.0 + 86400, ambient=0.0)
    assert off == 600.0
    assert 0.0 < soon.belts[0, 0, 0] < warm
    assert late.belts[0, 0, 0] == pytest.approx(0.0, abs=0.01)
    estimate = soon.handle(0, START, START, 8.0)
    assert estimate.belt_degc()[0] == pytest.approx(soon.belts[0, 0, 0], abs=1e-9)


def test_a_clock_that_went_back_counts_as_no_time_off(reference, tmp_path):
    session = reference.session()
    session.handle_block(*messages(2000))
    snapshot.save(session, tmp_path / "state.json", saved_at=1000.0)
    again, off = snapshot.after_time_off(reference, tmp_path / "state.json", now=10.0)
    assert off == 0.0
    assert again.belts[0, 0, 0] == pytest.approx(session.belts[0, 0, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda text: "", "damaged"),
        (lambda text: text[: len(text) // 2], "damaged"),
        (lambda text: "[1, 2]", "another kind"),
        (lambda text: text.replace('"version": 3', '"version": 99'), "version 99"),
        (lambda text: text.replace('"belts"', '"bolts"'), "belts"),
        (lambda text: text.replace("0x1.", "oops"), "do not fit"),
    ],
)
def test_a_file_that_is_not_right_says_why(reference, tmp_path, damage, said):
    session = reference.session()
    session.handle_block(*messages(100))
    path = tmp_path / "state.json"
    snapshot.save(session, path, saved_at=1.0)
    path.write_text(damage(path.read_text()))
    with pytest.raises(InputError, match=said):
        snapshot.resume(reference, path)
    with pytest.raises(InputError, match=said):
        snapshot.after_time_off(reference, path, now=2.0)


def test_a_state_of_another_vehicle_is_refused(reference, carrier, tmp_path):
    session = reference.session()
    session.handle_block(*messages(100))
    snapshot.save(session, tmp_path / "state.json", saved_at=1.0)
    with pytest.raises(InputError, match="xgd24d"):
        snapshot.resume(carrier, tmp_path / "state.json")


def test_a_missing_file_is_named(reference, tmp_path):
    with pytest.raises(InputError, match=r"nothing\.json"):
        snapshot.resume(reference, tmp_path / "nothing.json")


def test_a_save_that_fails_leaves_the_old_file_whole(reference, tmp_path, monkeypatch):
    session = reference.session()
    session.handle_block(*messages(100))
    path = tmp_path / "state.json"
    snapshot.save(session, path, saved_at=1.0)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(snapshot.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        snapshot.save(session, path, saved_at=2.0)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["state.json"]
    assert json.loads(before)["saved_at"] == 1.0
