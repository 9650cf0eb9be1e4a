"""Statistics of rules over many messages match their parameters."""

import numpy as np
import pytest
from link_bench import PERIOD_NS, arrived, carry, delays
from scipy.stats import binomtest, kstest
from scipy.stats import gamma as gamma_law

N = 4000
SURE = 0.999  #: two-sided; with fixed seeds a test either always holds or never


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("p", [0.001, 0.05, 0.3, 0.9])
def test_the_loss_rate_equals_the_probability(p: float, seed: int) -> None:
    lost = int((~arrived(carry([dict(type="Loss", probability=p)], N, seed=seed))).sum())
    assert binomtest(lost, N, p).pvalue > 1.0 - SURE


def test_losses_are_independent_and_all_or_none_at_the_limits() -> None:
    for p in (0.0, 1.0):
        assert arrived(carry([dict(type="Loss", probability=p)], 500)).mean() == 1.0 - p
    lost = ~arrived(carry([dict(type="Loss", probability=0.3)], N))
    after_loss = lost[1:][lost[:-1]]
    assert binomtest(int(after_loss.sum()), len(after_loss), 0.3).pvalue > 1.0 - SURE


def bursts(lost: np.ndarray) -> np.ndarray:
    """Lengths of the runs of True, except those at the ends."""
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    starts = edges[lost[edges + 1]]
    return np.array([edges[edges > start][0] - start for start in starts if (edges > start).any()])


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("good_to_bad", "bad_to_good"), [(0.02, 0.4), (0.05, 0.1), (0.3, 0.7)])
def test_burst_lengths_and_loss_rate_match_the_channel(good_to_bad: float, bad_to_good: float, seed: int) -> None:
    n = 8000
    rule = dict(type="GilbertElliott", good_to_bad=good_to_bad, bad_to_good=bad_to_good)
    lost = ~arrived(carry([rule], n, seed=seed))
    lengths = bursts(lost)
    # Bursts of a channel that loses everything while bad are geometric: mean 1/b, variance (1 - b)/b².
    error = np.sqrt(1.0 - bad_to_good) / bad_to_good / np.sqrt(len(lengths))
    assert abs(lengths.mean() - 1.0 / bad_to_good) < 3.3 * error
    # The variance of a mean of a two-state chain is that of independent draws times (1 + λ)/(1 - λ), λ = 1 - g - b.
    rate = good_to_bad / (good_to_bad + bad_to_good)
    eigenvalue = 1.0 - good_to_bad - bad_to_good
    error = np.sqrt(rate * (1.0 - rate) / n * (1.0 + eigenvalue) / (1.0 - eigenvalue))
    assert abs(lost.mean() - rate) < 3.3 * error


def test_both_states_of_a_channel_have_the_configured_loss_rate() -> None:
    rule = dict(type="GilbertElliott", good_to_bad=0.2, bad_to_good=0.3, loss_good=0.1, loss_bad=0.6)
    expected = 0.4 * 0.6 + 0.6 * 0.1
    lost = ~arrived(carry([rule], 8000))
    assert abs(lost.mean() - expected) < 0.02
    assert lost[1:][lost[:-1]].mean() > expected + 0.02, "losses are clustered"


@pytest.mark.parametrize("seed", [0, 1])
def test_the_channel_starts_in_its_stationary_distribution(seed: int) -> None:
    rule = dict(type="GilbertElliott", good_to_bad=0.2, bad_to_good=0.2)
    lost = sum(not arrived(carry([rule], 1, seed=1000 * seed + run))[0] for run in range(600))
    assert binomtest(lost, 600, 0.5).pvalue > 1.0 - SURE


@pytest.mark.parametrize("distribution", ["normal", "gamma", "lognormal"])
@pytest.mark.parametrize(("mean", "jitter"), [(0.02, 0.004), (0.05, 0.012)])
def test_delays_have_the_configured_mean_and_deviation(distribution: str, mean: float, jitter: float) -> None:
    rule = dict(type="Delay", mean_s=mean, jitter_s=jitter, distribution=distribution)
    delays_s = delays(carry([rule], N, every_ns=20 * PERIOD_NS))  # far enough apart that none waits for another
    assert abs(delays_s.mean() - mean) < 3.3 * jitter / np.sqrt(N)
    assert abs(delays_s.std() / jitter - 1.0) < 0.08
    assert delays_s.min() >= 0.0


def test_gamma_delays_follow_a_gamma_distribution() -> None:
    delays_s = delays(carry([dict(type="Delay", mean_s=0.02, jitter_s=0.01)], N, every_ns=20 * PERIOD_NS))
    assert kstest(delays_s, gamma_law(a=4.0, scale=0.005).cdf).pvalue > 1.0 - SURE


def test_a_normal_delay_is_truncated_at_zero() -> None:
    rule = dict(type="Delay", mean_s=0.005, jitter_s=0.02, distribution="normal")
    delays_s = delays(carry([rule], N, every_ns=20 * PERIOD_NS))
    assert delays_s.min() >= 0.0
    assert (delays_s < 1e-6).mean() < 0.005


@pytest.mark.parametrize("p", [0.1, 0.5])
def test_duplication_reordering_and_corruption_rates_equal_the_probability(p: float) -> None:
    doubled = sum(len(o.leaving) == 2 for o in carry([dict(type="Duplicate", probability=p)], N))
    reordered = sum(o.leaving[0][0].overtakes for o in carry([dict(type="Reorder", probability=p, by_s=0.1)], N))
    flipped = sum(len(o.leaving[0][0].flips) == 3 for o in carry([dict(type="Corrupt", probability=p, flips=3)], N))
    for affected in (doubled, reordered, flipped):
        assert binomtest(affected, N, p).pvalue > 1.0 - SURE


def test_copies_are_lost_independently() -> None:
    rules = [dict(type="Duplicate", probability=1.0, copies=1), dict(type="Loss", probability=0.5)]
    left = np.bincount([len(outcome.leaving) for outcome in carry(rules, 2000)], minlength=3)
    assert binomtest(int(left[0]), 2000, 0.25).pvalue > 1.0 - SURE
    assert binomtest(int(left[2]), 2000, 0.25).pvalue > 1.0 - SURE


def test_pose_errors_have_the_configured_bias_and_deviation() -> None:
    rule = dict(type="PoseError", position_std_m=0.5, yaw_std_rad=0.02, bias_m=[1.0, -2.0], bias_yaw_rad=0.1)
    copies = [outcome.leaving[0][0] for outcome in carry([rule], N, referenced=True)]
    errors = np.array([[*copy.shift, copy.turn] for copy in copies])
    std = np.array([0.5, 0.5, 0.02])
    assert np.all(np.abs(errors.mean(axis=0) - [1.0, -2.0, 0.1]) < 3.3 * std / np.sqrt(N))
    assert np.all(np.abs(errors.std(axis=0) / std - 1.0) < 0.08)


@pytest.mark.parametrize("size", [1000, 15_000])
def test_throughput_is_close_to_but_below_the_bandwidth(size: int) -> None:
    rate, seconds = 1e6, 20.0
    offered = 3.0 * rate  # three times the bandwidth
    every_ns = round(8e9 * size / offered)
    rules = [dict(type="Bandwidth", bits_per_s=rate, queue_s=0.3)]
    outcomes = carry(rules, round(seconds * 1e9 / every_ns), every_ns=every_ns, size=size)
    sent = 8.0 * size * arrived(outcomes).sum()
    assert rate * seconds * 0.98 < sent <= rate * (seconds + 0.3) + 8.0 * size
    waited = delays(outcomes)
    assert waited.max() <= 0.3 + 8.0 * size / rate + 1e-9
    leaves = np.array([i * every_ns * 1e-9 + o.leaving[0][1] for i, o in enumerate(outcomes) if o.leaving])
    assert np.all(np.diff(leaves) >= 8.0 * size / rate - 1e-6), "one after the other"
