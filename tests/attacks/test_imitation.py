"""False objects have the noise and miss rate of the victim's own objects."""

import numpy as np
import pytest
from attack_worlds import ORIGIN, SECOND, at, coverage_of
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates, canonical_order
from mast_zenoh.attacks import UncoordinatedAttack, UncoordinatedSelection
from mast_zenoh.attacks.imitation import Exact, VictimLike, VictimStatistics

PERIOD = SECOND // 10
PLACES = [(8.0 * i - 32.0, 8.0 * j - 32.0) for i in range(9) for j in range(9)]


def detected(frame: int, share: float, std: float, stated: bool = True) -> ObjectStates:
    """Stationary objects as a detector with this hit rate and noise reports them."""
    rng = np.random.default_rng(frame)
    seen = np.flatnonzero(rng.random(len(PLACES)) < share)
    objects = at(*PLACES, id=np.full(len(PLACES), -1))
    covariance = np.zeros((len(PLACES), 9, 9))
    covariance[:, :3, :3] = std**2 * np.eye(3) if stated else 0.0
    noisy = objects.with_(
        position=objects.position + rng.normal(0.0, std, objects.position.shape),
        size=objects.size + rng.normal(0.0, 0.15, objects.size.shape),
        yaw=rng.normal(0.0, 0.06, len(PLACES)),
        score=rng.uniform(0.6, 1.0, len(PLACES)),
        covariance=covariance,
    )
    noisy = noisy.select(seen)
    return noisy.select(canonical_order(noisy))


def tracked(frame: int) -> ObjectStates:
    """The same as a tracker reports them: no misses, slowly varying 0.3 m errors."""
    objects = detected(0, 1.0, 0.3)
    shaken = np.random.default_rng(frame).normal(0.0, 0.01, objects.position.shape)
    return objects.with_(id=np.arange(len(objects)), position=objects.position + shaken)


def learned(rows, frames: int = 30) -> VictimStatistics:
    statistics = VictimStatistics()
    for frame in range(frames):
        statistics.observe(rows(frame), frame * PERIOD, ORIGIN)
    return statistics


@pytest.mark.parametrize("share", [0.6, 0.8, 0.95])
def test_the_miss_rate_is_estimated(share):
    statistics = learned(lambda frame: detected(frame, share, 0.2))
    assert statistics.share_detected(np.array([30.0]))[0] == pytest.approx(share, abs=0.05)


def test_tracks_are_never_missed_and_have_correlated_errors():
    statistics = learned(tracked)
    assert np.all(statistics.share_detected(np.array([5.0, 45.0])) == 1.0)
    assert statistics.correlation > 0.9


def test_a_gap_in_the_messages_does_not_bias_the_estimates():
    rows = {frame: detected(frame, 0.8, 0.2) for frame in (0, 1, 5, 6, 20)}
    statistics = VictimStatistics()
    for frame, objects in rows.items():
        statistics.observe(objects, frame * PERIOD, ORIGIN)
    assert statistics.std == VictimStatistics().std


FALSE = at((10.0, 3.0), (-20.0, 5.0), (3.0, -28.0), (25.0, 20.0))


def shown(imitation: VictimLike, rows, frames: int = 400) -> list[ObjectStates]:
    imitation.bind(1, "scene", "adversary_1")
    result, where = [], coverage_of(np.array([0.0, 0.0, 40.0]))
    for frame in range(frames):
        real = rows(frame)
        imitation.observe(real, frame * PERIOD, ORIGIN)
        result.append(imitation.show(frame, FALSE, real, where, where.victims[0]))
    return result[40:]


@pytest.mark.parametrize("stated", [True, False])
def test_false_detections_have_noise_misses_and_scores_like_real_ones_with_covariances_or_without(stated):
    some = shown(VictimLike(), lambda frame: detected(frame, 0.7, 0.25, stated))
    share = sum(map(len, some)) / (len(some) * len(FALSE))
    assert share == pytest.approx(0.7, abs=0.06)
    errors = np.concatenate([each.position - FALSE.position[each.id] for each in some])
    assert errors.std(axis=0) == pytest.approx(0.25, rel=0.1)
    yaw = np.concatenate([each.yaw for each in some])
    assert yaw.std() == pytest.approx(0.06, rel=0.2)
    scores = np.concatenate([each.score for each in some])
    assert 0.6 <= scores.min() < 0.65
    assert 0.95 < scores.max() <= 1.0


def test_false_tracks_do_not_flicker_or_jitter():
    some = shown(VictimLike(), tracked)
    assert {len(each) for each in some} == {len(FALSE)}
    steps = np.diff([each.position for each in some], axis=0)
    errors = np.array([each.position - FALSE.position for each in some])
    assert steps.std() < 0.35 * errors.std()


@given(st.integers(0, 10_000))
def test_a_false_object_inside_a_real_one_is_withheld(seed):
    rng = np.random.default_rng(seed)
    real = at((10.0, 3.0), id=np.array([-1]))
    offset, yaw = rng.uniform(-1.0, 1.0, 3) * [1.5, 0.8, 0.0], rng.uniform(-3.0, 3.0, 1)
    false = real.with_(position=real.position + offset, yaw=yaw, id=np.array([4]))
    where = coverage_of(np.array([0.0, 0.0, 40.0]))
    imitation = VictimLike(misses=False, noise=False)
    assert len(imitation.show(0, false, real, where, where.victims[0])) == 0
    apart = false.with_(position=false.position + np.array([0.0, 12.0, 0.0]))
    assert len(imitation.show(0, apart, real, where, where.victims[0])) == 1


def test_exact_false_objects_have_the_victims_typical_covariance_and_score():
    real = detected(0, 1.0, 0.1).select(slice(0, 3))
    real = real.with_(score=np.array([0.6, 0.9, 0.7]), covariance=np.eye(9) * np.array([9.0, 1.0, 4.0])[:, None, None])
    where = coverage_of(ORIGIN)
    same = Exact().show(0, FALSE, real, where, where.victims[0])
    assert np.array_equal(same.position, FALSE.position)
    assert np.array_equal(same.covariance, np.tile(4.0 * np.eye(9), (4, 1, 1)))
    assert same.score.tolist() == [0.7] * 4


@pytest.mark.parametrize("imitation", [Exact(), VictimLike()])
def test_false_objects_are_plausible_without_real_objects_to_imitate(imitation):
    where = coverage_of(np.array([0.0, 0.0, 40.0]))
    added = imitation.show(0, FALSE, ObjectStates.empty(), where, where.victims[0])
    assert len(added) > 0
    assert np.all(np.linalg.eigvalsh(added.covariance) > 0.0)
    assert np.all((added.score > 0.5) & (added.score <= 1.0))


def test_false_objects_out_of_the_victims_range_are_withheld():
    selection = UncoordinatedSelection(n_false_positives=40.0, region="paper", velocity_std_mps=0.0)
    attack = UncoordinatedAttack(start_s=0.0, selection=selection, imitation=Exact(), max_range_m=30.0)
    attack.bind(1, "adversary_1")
    tampering = attack.step(0, 0, detected(0, 1.0, 0.1), ORIGIN)
    distance = np.hypot(*tampering.added.position[:, :2].T)
    assert 0 < len(distance) < len(tampering.targets.add)
    assert distance.max() <= 30.0
