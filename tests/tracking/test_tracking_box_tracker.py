"""Behaviour of the box tracker."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracked_objects import INVALID_COVARIANCES, assert_close, assert_same_bits, cars, nanoseconds
from tracking_worlds import detected, joined

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, ObjectStates
from mast_zenoh.tracking import FilterpyBoxTracker3D, InteractingModelsTracker3D, KalmanBoxTracker3D, SensorView

NOTHING = Detections.empty()


def view(azimuth: float = np.pi, max_range: float = 100.0) -> SensorView:
    return SensorView(np.array([0.0, 0.0, 2.0]), rotation_from_yaw(0.0), -azimuth, azimuth, -1.0, 0.5, max_range)


def settled(tracker: KalmanBoxTracker3D, xy, frames: int = 10, **kinds) -> ObjectStates:
    """The tracks after objects stood at `xy` for some frames."""
    for frame in range(frames):
        tracks = tracker.step(nanoseconds(frame), detected(xy, **kinds), view())
    return tracks


def existence(tracks: ObjectStates) -> np.ndarray:
    """Probabilities of existence (n,), from the scores, which are tempered."""
    odds = (tracks.score / (1.0 - tracks.score)) ** 8
    return odds / (1.0 + odds)


@pytest.mark.parametrize(
    ("frames", "least", "most"),
    [
        ([True] + [False] * 39, [0] * 40, [0] * 40),
        ([True] * 3, [0, 0, 1], [0, 1, 1]),
        ([True] * 30 + [False] * 10, [0, 0] + [1] * 29 + [0] * 9, [0] + [1] * 38 + [0]),
    ],
    ids=["none after one detection", "from the third detection on", "until soon after its object has left"],
)
def test_an_object_has_a_track_while_it_is_detected(frames, least, most):
    tracker = KalmanBoxTracker3D()
    seen = [detected([20.0, 5.0]) if each else NOTHING for each in frames]
    counts = [len(tracker.step(nanoseconds(frame), each, view())) for frame, each in enumerate(seen)]
    assert np.all((least <= np.array(counts)) & (np.array(counts) <= most)), counts


def test_objects_out_of_view_do_not_count_as_missed():
    tracker = KalmanBoxTracker3D()
    before = settled(tracker, [20.0, 5.0])
    narrow = view(azimuth=0.05)
    for frame in range(10, 14):
        after = tracker.step(nanoseconds(frame), NOTHING, narrow)
    assert len(after) == 1
    assert existence(after)[0] > 0.98 * existence(before)[0]


def test_objects_behind_a_lorry_do_not_count_as_missed():
    tracker = KalmanBoxTracker3D()
    lorry, car = detected([15.0, 0.0], np.pi / 2, "truck"), detected([40.0, 0.0])
    for frame in range(10):
        tracker.step(nanoseconds(frame), joined(lorry, car), view())
    low = SensorView(np.array([0.0, 0.0, 1.0]), np.eye(3), -np.pi, np.pi, -1.0, 0.5, 100.0)
    for frame in range(10, 14):
        hidden = tracker.step(nanoseconds(frame), lorry, low)
    assert len(hidden) == 2
    assert existence(hidden).min() > 0.95


def test_an_intermittently_detected_object_stays_one_track():
    tracker = KalmanBoxTracker3D()
    settled(tracker, [20.0, 5.0])
    ids = set()
    for frame in range(10, 100):
        seen = detected([20.0, 5.0]) if frame % 4 == 0 else NOTHING
        ids.update(tracker.step(nanoseconds(frame), seen, view()).id.tolist())
    assert len(ids) == 1


@pytest.mark.parametrize(("gone", "same"), [(10, True), (50, False)])
def test_an_object_that_returns_within_a_second_keeps_its_id_and_later_gets_a_new_one(gone: int, same: bool):
    tracker = KalmanBoxTracker3D()
    before = settled(tracker, [20.0, 5.0], 20)
    missed = [len(tracker.step(nanoseconds(frame), NOTHING, view())) for frame in range(20, 20 + gone)]
    assert missed[-1] == 0
    for frame in range(20 + gone, 24 + gone):
        after = tracker.step(nanoseconds(frame), detected([20.2, 5.0]), view())
    assert (after.id.tolist() == before.id.tolist()) == same
    assert same or after.id.min() > before.id.max()


@pytest.mark.parametrize(
    ("xy", "tracks"),
    [([[20.0, 5.0], [20.8, 5.1]], 1), ([[20.0, 0.0], [20.5, 3.0]], 2)],
    ids=["two detections of one object", "neighbours in adjacent lanes"],
)
def test_detections_of_one_object_are_one_track_and_neighbours_are_two(xy, tracks):
    assert len(settled(KalmanBoxTracker3D(), xy, 20)) == tracks


def test_two_detections_give_a_fast_cars_velocity():
    tracker = KalmanBoxTracker3D()
    for frame in range(4):
        tracks = tracker.step(nanoseconds(frame), detected([-40.0 + 3.3 * frame, 2.0], 0.0))
    assert len(tracks) == 1
    np.testing.assert_allclose(tracks.velocity[0, :2], [33.0, 0.0], atol=3.0)


def test_cars_move_along_their_heading_and_pedestrians_in_any_direction():
    tracker = KalmanBoxTracker3D()
    tracker.step(0, joined(detected([0.0, 0.0], np.pi / 2), detected([30.0, 0.0], 0.0, "pedestrian")))
    tracks = tracker.step(
        nanoseconds(1), joined(detected([0.0, 0.0], np.pi / 2), detected([30.0, 0.0], 0.0, "pedestrian"))
    )
    car, pedestrian = (np.sqrt(np.diagonal(one))[6:8] for one in tracks.covariance)
    assert car[1] > 3 * car[0]
    assert pedestrian.max() < 2.0


@pytest.mark.parametrize(
    ("speed", "yaw", "reversed_in"),
    [(0.0, 0.3, range(3, 20, 4)), (10.0, 0.0, range(3))],
    ids=["now and then", "at first, until it moves"],
)
def test_reversed_detections_do_not_reverse_the_heading(speed, yaw, reversed_in):
    tracker = KalmanBoxTracker3D()
    for frame in range(20):
        seen = detected([10.0 + 0.1 * speed * frame, 0.0], yaw + np.pi * (frame in reversed_in))
        tracks = tracker.step(nanoseconds(frame), seen)
        if len(tracks) and (speed == 0.0 or frame >= 14):
            assert abs(tracks.yaw[0] - yaw) < 0.1


def test_a_detection_with_a_small_covariance_has_a_large_weight():
    certain, unsure = KalmanBoxTracker3D(), KalmanBoxTracker3D()
    for frame in range(3):
        covariance = np.eye(3)[None] * 1e-3
        a = certain.step(nanoseconds(frame), detected([10.0, 0.0], covariance=covariance))
        b = unsure.step(nanoseconds(frame), detected([10.0, 0.0]))
    assert a.covariance[0, 0, 0] < 0.05 * b.covariance[0, 0, 0]


def test_errors_are_consistent_with_the_covariance():
    random = np.random.default_rng(1)
    tracker = KalmanBoxTracker3D()
    xy = np.column_stack([np.arange(20) * 15.0, np.zeros(20)])
    errors = []
    for frame in range(60):
        tracks = tracker.step(nanoseconds(frame), detected(xy + 0.4 * random.normal(size=xy.shape)))
        if frame > 20:
            error = (tracks.position - detected(xy).position)[:, :2]
            information = np.linalg.inv(tracks.covariance[:, :2, :2])
            errors.append(np.einsum("ni,nij,nj->n", error, information, error).mean())
    # Two degrees of freedom would give 2; stationary objects move less than the model allows for.
    assert 0.5 < np.mean(errors) < 2.5


detections = st.lists(
    st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-3, 3), st.sampled_from(["car", "pedestrian"])),
    max_size=8,
)


@pytest.mark.parametrize("kind", [KalmanBoxTracker3D, InteractingModelsTracker3D])
@given(st.lists(detections, min_size=2, max_size=6), st.randoms(use_true_random=False))
def test_the_order_of_detections_does_not_matter(kind, frames, random):
    a, b = kind(), kind()
    for frame, objects in enumerate(frames * 2):
        seen = joined(NOTHING, *(detected([x, y], yaw, kind) for x, y, yaw, kind in objects))
        order = random.sample(range(len(seen)), len(seen))
        one = a.step(nanoseconds(frame), seen, view())
        other = b.step(nanoseconds(frame), seen.select(np.array(order, int)), view())
        assert_same_bits(one, other)


@given(st.lists(detections, min_size=2, max_size=5))
def test_filterpy_agrees_for_any_detections(frames):
    a, b = KalmanBoxTracker3D(), FilterpyBoxTracker3D()
    for frame, objects in enumerate(frames * 2):
        seen = joined(NOTHING, *(detected([x, y], yaw, kind) for x, y, yaw, kind in objects))
        one, other = a.step(nanoseconds(frame), seen, view()), b.step(nanoseconds(frame), seen, view())
        assert_close(one, other)
        assert_close(a.step_states(nanoseconds(frame), one), b.step_states(nanoseconds(frame), other))


def test_matched_gives_the_row_used_to_update_each_track():
    tracker = KalmanBoxTracker3D()
    xy = np.array([[40.0, 0.0], [-10.0, 5.0], [20.0, -8.0]])
    tracks = settled(tracker, xy)
    np.testing.assert_allclose(xy[tracker.matched], tracks.position[:, :2], atol=0.1)
    tracks = tracker.step(nanoseconds(10), detected(xy[[2]]), view())
    assert tracker.matched.tolist() == [0 if round(x) == 20 else -1 for x in tracks.position[:, 0]]


def test_time_steps_may_have_any_length_including_zero():
    tracker = KalmanBoxTracker3D()
    for time_s in (0.0, 0.05, 0.05, 0.3, 0.31, 1.0, 1.1):
        tracks = tracker.step(round(time_s * 1e9), detected([10.0 * time_s, 0.0]))
    assert len(tracks) == 1
    assert tracks.velocity[0, 0] == pytest.approx(10.0, abs=1.5)


def test_an_earlier_time_is_refused():
    tracker = KalmanBoxTracker3D()
    tracker.step(100, NOTHING)
    with pytest.raises(ValueError, match=r"99.*least 100"):
        tracker.step(99, NOTHING)


def test_an_invalid_class_is_treated_as_unknown():
    tracker = KalmanBoxTracker3D()
    for frame in range(4):
        seen = detected([10.0, 0.0])
        seen.class_id[:] = 200
        tracks = tracker.step(nanoseconds(frame), seen)
    assert tracks.class_id.tolist() == [CLASS_INDEX["unknown"]]


def test_thousands_of_detections_are_processed():
    tracker = KalmanBoxTracker3D()
    random = np.random.default_rng(0)
    spread, pile = random.uniform(-300, 300, (2000, 2)), random.normal(size=(500, 2))
    for frame in range(4):
        tracks = tracker.step(nanoseconds(frame), detected(np.concatenate([spread, pile])), view())
        tracker.step(nanoseconds(frame), NOTHING, view())
    assert len(tracks) > 1000


def test_repeated_states_are_not_counted_as_new_evidence():
    tracker = KalmanBoxTracker3D()
    for frame in range(50):
        tracks = tracker.step_states(nanoseconds(frame), cars([10.0, 0.0], covariance=0.04 * np.eye(9)))
    # Fifty independent measurements would reduce it to a fraction of one; repeated ones must not.
    assert tracks.covariance[0, 0, 0] > 0.5 * 0.04


def test_states_contribute_their_velocity():
    tracker = KalmanBoxTracker3D()
    for frame in range(3):
        tracks = tracker.step_states(nanoseconds(frame), cars([2.0 * frame, 0.0], (20.0, 0.0), 0.04 * np.eye(9)))
    np.testing.assert_allclose(tracks.velocity[0], [20.0, 0.0, 0.0], atol=1e-6)


def test_a_state_with_a_low_score_is_not_confirmed_at_once():
    tracker = KalmanBoxTracker3D()
    assert len(tracker.step_states(0, cars([10.0, 0.0], score=np.array([0.5])))) == 0


@pytest.mark.parametrize("covariance", INVALID_COVARIANCES.values(), ids=INVALID_COVARIANCES)
def test_invalid_covariances_do_not_stop_the_tracker(covariance):
    tracker = KalmanBoxTracker3D()
    for frame in range(6):
        reported = np.stack([np.eye(3) * 0.1, covariance[:3, :3]])
        tracks = tracker.step(nanoseconds(frame), detected([[10.0, 0.0], [30.0, 0.0]], covariance=reported))
    assert all(np.isfinite(column).all() for column in tracks.columns().values())
    assert np.isclose(tracks.position[:, 0], 10.0, atol=0.1).any()
