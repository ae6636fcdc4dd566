# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The map of residuals by regime, on constructed residuals."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.diagnosis.selection.locate import (
    FEWEST_IN_BIN,
    REGIME_BINS,
    REPLICATES,
    Bin,
    RegimeMap,
    cumulative_periodogram,
    regime_map,
)

N = 3000


def fitted(residual, speed=None, accel=0.0, yaw_rate=0.0, heading=0.0, white=None, belt=None, split=1):
    """A fit whose torque residual is given, of sessions of equal length; belts are nowhere."""
    n = len(residual)
    speed = np.ones(n) if speed is None else speed
    sessions, whites, prediction = [], [], []
    for i, part in enumerate(np.array_split(np.arange(n), split)):
        none = np.zeros(len(part))
        full = lambda x, part=part, none=none: none + (x[part] if np.ndim(x) else x)  # noqa: E731
        sessions.append(
            DriveSession(
                f"drive_{i}", 1.0, none, full(speed), full(accel), none + 2e5, none + 15.0, none, full(yaw_rate), full(heading),
                none, none, none, none == 0.0, none.astype(np.int64),
            )
        )  # fmt: skip
        whites.append((residual if white is None else white)[part])
        prediction.append(
            SimpleNamespace(torque=-residual[part], belt=np.full(len(part), np.nan) if belt is None else belt[part])
        )
    whites.append(np.full(50, 1e9))
    return SimpleNamespace(problem=SimpleNamespace(sessions=sessions), predicted=prediction, white=whites)


def mapped(*args, seed=1, **given):
    return regime_map(fitted(*args, **given), np.random.default_rng(seed))


def noise(seed=0, n=N):
    return np.random.default_rng(seed).normal(0.0, 1.0, n)


def speeds(n=N):
    return np.random.default_rng(7).permutation(np.linspace(0.0, 12.0, n))


def test_a_residual_of_one_regime_is_found_there_with_its_size():
    fast = speeds() > 10.0
    result = mapped(noise() + 0.8 * fast, speed=speeds(), yaw_rate=noise(3))
    (clearest, *_) = result.significant
    assert clearest.variable == "speed"
    assert (clearest.low, clearest.high) == pytest.approx((10.0, 12.0), abs=0.01)
    assert clearest.mean_residual == pytest.approx(0.8, abs=0.15)
    assert (clearest.unit, clearest.samples) == ("m/s", N // REGIME_BINS)
    assert result.p == clearest.p == pytest.approx(1.0 / (REPLICATES + 1.0))
    assert result.samples == N


def test_noise_alone_hardly_ever_stands_out():
    least = [mapped(noise(seed), speed=speeds(), yaw_rate=noise(seed + 100), seed=seed).p for seed in range(60)]
    assert np.mean(np.array(least) < 0.05) <= 0.12
    assert np.mean(least) == pytest.approx(0.5, abs=0.13)


def test_correlated_noise_is_significant_no_more_often():
    """What whitening left of it stays within pieces whose sign is flipped as one."""
    alike = [np.repeat(noise(seed, N // 5), 5) for seed in range(40)]
    assert np.mean([mapped(x, speed=np.repeat(speeds(N // 5), 5), seed=i).p < 0.05 for i, x in enumerate(alike)]) <= 0.15


def test_more_places_to_look_in_make_each_find_less_sure():
    residual, speed = noise() + 0.2 * (speeds() > 10.0), speeds()
    item = mapped(residual, speed=speed)
    many = mapped(residual, speed=speed, yaw_rate=noise(1), heading=noise(2), belt=noise(3))
    p = lambda found: found.likeliest("speed", 11.0, 12.0)  # noqa: E731
    assert p(many) >= p(item)
    assert {b.variable for b in many.bins} == {
        "speed", "yaw rate", "yaw rate to the left", "curvature", "heading", "belt temperature",
    }  # fmt: skip


def test_what_does_not_vary_or_is_not_known_is_not_looked_at():
    belt = noise(3)
    belt[5] = np.nan
    result = mapped(noise(), speed=speeds(), belt=belt)
    assert {b.variable for b in result.bins} == {"speed"}
    nothing = mapped(noise())
    assert (nothing.bins, nothing.p, nothing.samples) == ((), 1.0, N)


def test_bins_are_evenly_filled_and_need_enough_samples():
    result = mapped(noise(), speed=speeds())
    assert [b.samples for b in result.bins] == [N // REGIME_BINS] * REGIME_BINS
    assert [b.low for b in result.bins[1:]] == [b.high for b in result.bins[:-1]]
    few = (FEWEST_IN_BIN - 1) * REGIME_BINS
    assert mapped(noise(n=few), speed=speeds(few)).bins == ()
    assert len(mapped(noise(n=few + 2 * REGIME_BINS), speed=speeds(few + 2 * REGIME_BINS)).bins) == REGIME_BINS


def test_two_values_are_two_ends_of_one_bin():
    result = mapped(noise(), speed=np.where(speeds() > 5.0, 10.0, 5.0))
    assert [(b.low, b.high) for b in result.bins] == [(5.0, 10.0)]


def test_headings_wrap_once_around_and_turns_have_both_signs():
    result = mapped(noise(), heading=speeds() * 10.0, yaw_rate=noise(4))
    headings = [b for b in result.bins if b.variable == "heading"]
    assert min(b.low for b in headings) >= -np.pi
    assert max(b.high for b in headings) <= np.pi
    assert min(b.low for b in result.bins if b.variable == "yaw rate") >= 0.0
    assert min(b.low for b in result.bins if b.variable == "yaw rate to the left") < -1.0


def test_a_bin_does_not_depend_on_the_direction_of_travel():
    speed, turns, gains = speeds() + 1.0, noise(3), np.sin(np.arange(N) / 80.0)
    residual, back = noise() + 0.8 + 0.8 * (gains > 0.87), np.where(np.arange(N) % 400 < 200, -1.0, 1.0)
    forecast, pair = (mapped(s * residual, speed=s * speed, accel=s * gains, yaw_rate=turns) for s in (1.0, back))
    for variable, within in (("yaw rate", 1e-9), ("acceleration", 0.05)):  # an acceleration is a mean over some steps
        item, other = ([(b.mean_residual, b.p) for b in result.bins if b.variable == variable] for result in (forecast, pair))
        assert [mean for mean, _ in other] == pytest.approx([mean for mean, _ in item], abs=within)
        assert all(p < 0.05 for _, p in item + other)


def test_rows_without_a_known_past_and_belt_rows_are_not_counted():
    white = noise()
    white[:300] = np.nan
    result = mapped(noise() + 0.0, speed=speeds(), white=white, split=3)
    assert result.samples == N - 300
    assert sum(b.samples for b in result.bins) >= N - 300


def test_the_plain_residual_is_told_and_the_whitened_one_decides():
    """A level that whitening takes away is told in Nm but does not stand out."""
    plain, white = noise() + 5.0 * (speeds() > 10.0), noise()
    result = mapped(plain, speed=speeds(), white=white)
    assert result.bins[-1].mean_residual == pytest.approx(5.0, abs=0.2)
    assert result.bins[-1].p > 0.05


def test_the_clearest_bins_come_first_and_a_range_has_its_least():
    bins = tuple(
        Bin(variable, low, low + 1.0, mean, "m/s", 50, p)
        for variable, low, mean, p in (
            ("speed", 0.0, 3.0, 0.04), ("speed", 1.0, -5.0, 0.01), ("speed", 2.0, 9.0, 0.05), ("load", 0.0, -6.0, 0.01),
        )
    )  # fmt: skip
    result = RegimeMap(bins, 0.01, 200)
    assert [(b.variable, b.mean_residual) for b in result.significant] == [("load", -6.0), ("speed", -5.0), ("speed", 3.0)]
    assert result.likeliest("speed", 0.2, 0.8) == 0.04
    assert result.likeliest("speed", 0.5, 2.5) == 0.01
    assert result.likeliest("speed", 3.0, 9.0) == 1.0
    assert result.likeliest("heading", 0.0, 9.0) == 1.0


@pytest.mark.parametrize("lengths", [(400,), (300, 300, 300), (600, 120), (150, 300, 450, 150)])
@pytest.mark.parametrize("held_out", [0.0, 0.3, 1.0])
def test_whiteness_of_white_residuals_is_uniform(lengths, held_out):
    """A last recording is held out: none of it, a part, or all."""
    rng, result = np.random.default_rng(4), []
    for _ in range(200):
        white = [rng.standard_normal(n) for n in (*lengths, 300)]
        white[-1][: int(held_out * 300)] = np.nan
        result.append(cumulative_periodogram(SimpleNamespace(white=white, problem=SimpleNamespace(sessions=white))))
    assert kstest(result, "uniform").pvalue > 1e-3


def test_slow_noise_has_no_flat_spectrum():
    slow = np.convolve(noise(n=N + 4), np.full(5, 0.2), mode="valid")
    assert cumulative_periodogram(fitted(slow)) < 1e-6
