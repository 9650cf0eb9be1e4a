"""What an interposer does not touch stays as it was sent; what it alters, removes or adds is all that differs."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mast_ros2 import type_store
from mast_ros2.altered_objects import ALTERABLE, altered
from mast_ros2.object_messages import detection_array, tracked_objects
from mast_ros2.received_objects import received_tracks
from ros2_messages import plain, random_message, random_states

from mast_zenoh.arrays.states import ObjectStates, concatenate

N = 6
of_both = pytest.mark.parametrize("kind", ALTERABLE)


def objects(message: Any) -> list[Any]:
    return list(message.objects if message.__msgtype__ == type_store.TRACKED_OBJECTS else message.detections)


def sent(kind: str) -> Any:
    """A message with fields that our own ones do not have: other UUIDs, classes of others, covariances, rates."""
    states = random_states(np.random.default_rng(1), N)
    if kind == type_store.DETECTIONS:
        message = detection_array(states, 5, "map")
        named = [replace(each, id=f"track-{row}") for row, each in enumerate(message.detections)]
        return replace(message, detections=named)
    message = tracked_objects(states, 5, "map")
    random = np.random.default_rng(2)
    own = [
        replace(
            each,
            object_id=replace(each.object_id, uuid=random.integers(1, 255, 16).astype(np.uint8)),
            classification=[
                *each.classification,
                random_message("autoware_perception_msgs/msg/ObjectClassification", random),
            ],
        )
        for each in message.objects
    ]
    return replace(message, objects=own)


def with_states(states: ObjectStates, row: int, **values: Any) -> ObjectStates:
    """States with values of one row changed."""
    columns = {name: getattr(states, name).copy() for name in values}
    for name, value in values.items():
        columns[name][row] = value
    return replace(states, **columns)


@of_both
def test_a_message_in_which_nothing_is_altered_is_the_same(kind: str) -> None:
    message = sent(kind)
    received = received_tracks(message)
    assert plain(altered(message, received, received.objects)) == plain(message)


@of_both
def test_a_moved_object_differs_in_its_position_alone(kind: str) -> None:
    message = sent(kind)
    received = received_tracks(message)
    wanted = with_states(received.objects, 2, position=[1.0, 2.0, 3.0])
    result, row = altered(message, received, wanted), int(received.rows[2])
    before, after = objects(message), objects(result)
    assert [plain(each) for k, each in enumerate(after) if k != row] == [
        plain(each) for k, each in enumerate(before) if k != row
    ]
    place = {"__typename": "geometry_msgs/msg/Point", "x": 1.0, "y": 2.0, "z": 3.0}
    expected, found = plain(before[row]), plain(after[row])
    if kind == type_store.DETECTIONS:
        expected["bbox"]["center"]["position"] = place
        for each in expected["results"]:
            each["pose"]["pose"]["position"] = place
    else:
        expected["kinematics"]["pose_with_covariance"]["pose"]["position"] = place
    assert found == expected


def test_a_turned_and_faster_object_says_so_in_its_own_axes() -> None:
    message = sent(type_store.TRACKED_OBJECTS)
    received = received_tracks(message)
    wanted = with_states(received.objects, 0, yaw=0.25, velocity=[3.0, 0.0, 0.0])
    again = received_tracks(altered(message, received, wanted))
    np.testing.assert_allclose(again.objects.yaw[0], 0.25)
    np.testing.assert_allclose(again.objects.velocity[0], [3.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(again.objects.velocity[1:], received.objects.velocity[1:])


@of_both
def test_a_removed_object_is_gone_and_a_new_one_has_an_id_of_the_senders_form(kind: str) -> None:
    message = sent(kind)
    received = received_tracks(message)
    new = random_states(np.random.default_rng(3), 1)
    wanted = concatenate([received.objects.select(np.arange(N) != 1), new])
    result = objects(altered(message, received, wanted))
    gone = int(received.rows[1])
    assert [plain(each) for each in result[:-1]] == [plain(e) for k, e in enumerate(objects(message)) if k != gone]
    if kind == type_store.DETECTIONS:
        assert len(result[-1].id) == len("track-0")
        assert not result[-1].id.lstrip("-").isdecimal()
    else:
        assert any(result[-1].object_id.uuid[:8])
    np.testing.assert_allclose(
        received_tracks(altered(message, received, wanted)).objects.position[-1], new.position[0]
    )


def test_numbers_stay_numbers_in_detections() -> None:
    states = random_states(np.random.default_rng(1), N)
    message = detection_array(states, 5, "map")
    received = received_tracks(message)
    wanted = concatenate([received.objects, replace(random_states(np.random.default_rng(3), 1), id=np.array([77]))])
    assert objects(altered(message, received, wanted))[-1].id == "77"


@of_both
def test_an_object_that_cannot_be_received_is_passed_on(kind: str) -> None:
    message = sent(kind)
    broken = objects(message)[3]
    if kind == type_store.DETECTIONS:
        broken.bbox.size.x = float("nan")
    else:
        broken.shape.dimensions.x = float("nan")
    received = received_tracks(message)
    assert len(received.objects) == N - 1
    result = objects(altered(message, received, received.objects.select(np.zeros(N - 1, bool))))
    assert len(result) == 1
    assert result[0] is broken
