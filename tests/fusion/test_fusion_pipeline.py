"""From the tracks of many agents to the picture."""

import numpy as np
import pytest
from tracked_objects import INVALID_COVARIANCES, assert_same_bits, cars, centre, nanoseconds

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.fusion import (
    BestMemberFusion,
    CovarianceIntersectionFusion,
    GroupTracker,
    GroupTrackerWrapper,
    InformationMatrixGroupTracker,
    UnfilteredGroupTracker,
)
from mast_zenoh.tracking import KalmanBoxTracker3D

NAMES = ("ego", "infra_1", "infra_2")


def wrapper() -> GroupTracker:
    return GroupTrackerWrapper(fusion=CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())


def information() -> GroupTracker:
    return InformationMatrixGroupTracker(fusion=CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())


def unfiltered() -> GroupTracker:
    return UnfilteredGroupTracker(fusion=BestMemberFusion())


def tracks(xy, variance: float = 0.05, speed: float = 0.0) -> ObjectStates:
    """Tracks of cars at `xy` (n, 2) m that drive along x."""
    return cars(xy, (speed, 0.0), variance * np.eye(9))


def of_agents(*parts: ObjectStates) -> tuple[ObjectStates, np.ndarray]:
    return concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])


@pytest.mark.parametrize("group", [wrapper, information, unfiltered])
def test_an_object_seen_by_three_agents_has_one_id_and_support_three(group):
    pipeline = centre(group())
    ids = set()
    for frame in range(10):
        x = 3.0 * frame
        seen = of_agents(
            tracks([[x, 0], [x + 50, 9]], speed=30.0), tracks([x + 0.3, 0.2], speed=30.0), tracks([x, -0.4], speed=30.0)
        )
        picture, support = pipeline.step(nanoseconds(frame), *seen, NAMES)
        if frame > 1:
            ids.add(tuple(picture.id.tolist()))
            assert sorted(support.tolist()) == [1, 3]
    assert len(ids) == 1


@pytest.mark.parametrize("group", [wrapper, information, unfiltered])
@pytest.mark.parametrize("covariance", INVALID_COVARIANCES.values(), ids=INVALID_COVARIANCES)
def test_invalid_covariances_do_not_spoil_the_picture(group, covariance):
    pipeline = centre(group())
    for frame in range(6):
        honest, hostile = tracks([[10, 0], [30, 0]]), tracks([[10.2, 0], [50, 0]])
        hostile.covariance[:] = covariance
        picture, _ = pipeline.step(nanoseconds(frame), *of_agents(honest, hostile), NAMES)
        assert all(np.isfinite(column).all() for column in picture.columns().values())
    assert np.isclose(picture.position[:, 0], 30.0, atol=0.1).any()


@pytest.mark.parametrize("group", [wrapper, information])
def test_an_object_has_less_support_after_an_agent_falls_silent(group):
    pipeline = centre(group())
    for frame in range(5):
        pipeline.step(nanoseconds(frame), *of_agents(tracks([10, 0]), tracks([10, 0.3])), NAMES)
    picture, support = pipeline.step(nanoseconds(5), *of_agents(tracks([10, 0])), NAMES)
    assert len(picture) == 1
    assert support.tolist() == [1]


@pytest.mark.parametrize("group", [wrapper, information])
def test_an_unreported_object_leaves_the_picture_within_half_a_second(group):
    pipeline = centre(group())
    for frame in range(5):
        pipeline.step(nanoseconds(frame), *of_agents(tracks([10, 0])), NAMES)
    for frame in range(5, 10):
        picture, support = pipeline.step(nanoseconds(frame), ObjectStates.empty(), np.zeros(0, np.int64), NAMES)
        assert (support == 0).all()
    assert len(picture) == 0


@pytest.mark.parametrize("group", [wrapper, information, unfiltered])
def test_an_untrusted_agents_object_does_not_reach_the_picture(group):
    pipeline = centre(group())
    states, agent = of_agents(tracks([10, 0]), tracks([[10, 0.2], [60, 0]]))
    for frame in range(5):
        picture, support = pipeline.step(nanoseconds(frame), states, agent, NAMES, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(picture.position[:, :2], [[10.0, 0.0]], atol=1e-6)
    assert support.tolist() == [1]


@pytest.mark.parametrize("group", [wrapper, information, unfiltered])
def test_the_order_of_rows_and_agents_does_not_matter(group):
    random = np.random.default_rng(0)
    a, b = centre(group()), centre(group())
    for frame in range(12):
        parts = [tracks(random.uniform(0, 8, (4, 2))) for _ in NAMES]
        states, agent = of_agents(*parts)
        rows, order = random.permutation(len(states)), random.permutation(len(NAMES))
        one = a.step(nanoseconds(frame), states, agent, NAMES)
        names = tuple(NAMES[k] for k in order)
        other = b.step(nanoseconds(frame), states.select(rows), np.argsort(order)[agent][rows], names)
        assert one[1].tobytes() == other[1].tobytes()
        assert_same_bits(one[0], other[0])


def test_an_unfiltered_object_returns_under_its_id_at_its_predicted_position():
    pipeline = centre(unfiltered())
    first, _ = pipeline.step(0, *of_agents(tracks([0, 0], speed=20.0)), NAMES)
    none, _ = pipeline.step(nanoseconds(4), ObjectStates.empty(), np.zeros(0, np.int64), NAMES)
    again, _ = pipeline.step(nanoseconds(8), *of_agents(tracks([16, 0], speed=20.0)), NAMES)
    late, _ = pipeline.step(nanoseconds(30), *of_agents(tracks([60, 0], speed=20.0)), NAMES)
    assert len(none) == 0
    np.testing.assert_array_equal(again.id, first.id)
    assert late.id[0] != first.id[0]


@pytest.mark.parametrize("group", [wrapper, information, unfiltered])
def test_reset_restores_the_initial_state_of_the_pipeline(group):
    pipeline = centre(group())
    runs = []
    for _ in range(2):
        for frame in range(4):
            picture, _ = pipeline.step(nanoseconds(frame), *of_agents(tracks([[frame, 0], [30, 5]])), NAMES)
        runs.append(picture)
        pipeline.reset()
    np.testing.assert_array_equal(runs[0].id, runs[1].id)
    np.testing.assert_array_equal(runs[0].position, runs[1].position)
