"""A generated recording to write into the layouts of data sets, and its comparison with what is read back."""

import contextlib
import json
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.scenes.making.observe import World, lidar_visibility
from mast_zenoh.scenes.recording import Recording

FRAMES = 12


@cache
def source() -> Recording:
    """A junction with the ego, one other mobile agent and two poles."""
    return Intersection(scene_index=0, n_infrastructure=2, n_mobile=1).record(0, FRAMES)


def lidar_pose(recording: Recording, frame: int, agent: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of an agent's lidar in the world."""
    sensor, rotation = recording.agents[agent].sensor, recording.agent_rotation[frame, agent]
    position = recording.agent_position[frame, agent] + rotation @ sensor.mount_position
    return position, rotation @ sensor.mount_rotation


def matrix(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """A 4 x 4 matrix."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation, position
    return result


def assert_same(read: Recording, columns: list[int]) -> None:
    """The recording read back is the source, but for a shift of the world.

    columns: agents of the source that are agents of `read`, in order
    """
    original = source()
    shift = original.agent_position[0, 0]  # the middle of the ego's underside
    assert read.times_ns.tolist() == (original.times_ns[: len(read)] - original.times_ns[0]).tolist()
    for frame in range(len(read)):
        expected, found = original.truth_at(frame), read.truth_at(frame)
        assert found.id.tolist() == expected.id.tolist()
        assert found.class_id.tolist() == expected.class_id.tolist()
        np.testing.assert_allclose(found.position, expected.position - shift, atol=1e-6)
        np.testing.assert_allclose(found.size, expected.size, atol=1e-9)
        np.testing.assert_allclose(wrap_angle(found.yaw - expected.yaw), 0.0, atol=1e-6)
        for column, agent in enumerate(columns):
            position, rotation = lidar_pose(original, frame, agent)
            np.testing.assert_allclose(lidar_pose(read, frame, column)[0], position - shift, atol=1e-6)
            np.testing.assert_allclose(lidar_pose(read, frame, column)[1], rotation, atol=1e-6)
            np.testing.assert_allclose(
                read.agent_position[frame, column], original.agent_position[frame, agent] - shift, atol=1e-6
            )
    assert [agent.object_id for agent in read.agents] == [original.agents[k].object_id for k in columns]
    assert [agent.kind for agent in read.agents] == [original.agents[k].kind for k in columns]
    _assert_same_visibility(read, columns)


def _assert_same_visibility(read: Recording, columns: list[int]) -> None:
    """The lidars of `read`, at the agents' places in the source and without its buildings, see the same."""
    original = source()
    position = original.agent_position[: len(read), columns]
    rotation = original.agent_rotation[: len(read), columns]
    rows = slice(0, int(original.truth_start[len(read)]))
    world = World(
        name="expected",
        agents=read.agents,
        period_ns=original.period_ns,
        times_ns=original.times_ns[: len(read)],
        truth=original.truth.select(rows),
        truth_start=original.truth_start[: len(read) + 1],
        agent_position=position,
        agent_rotation=rotation,
        agent_velocity=np.zeros_like(position),
    )
    expected = lidar_visibility(world)
    np.testing.assert_array_equal(read.points >= 5, expected >= 5)
    np.testing.assert_allclose(read.points, expected, rtol=0.02, atol=2)
    assert (expected >= 5).any(axis=0).all(), "every agent sees something"


EXTREME = [None, True, 0, -1, 1e308, -1e308, 10**400, float("nan"), float("inf"), "", "\x00", "\ud800", "1", [], {}]
ANYTHING = st.sampled_from(EXTREME) | st.recursive(
    st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=17) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=20,
)
#: Changes of a file: bytes at places, its end cut off, or a value of its JSON replaced.
DAMAGE = (
    st.tuples(st.just("bytes"), st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=4))
    | st.tuples(st.just("cut"), st.floats(0, 1))
    | st.tuples(st.just("value"), st.tuples(st.floats(0, 0.999), ANYTHING))
    | st.tuples(st.just("value"), st.tuples(st.floats(0, 0.999), ANYTHING))
)


def damaged(content: bytes, damage: tuple[str, Any]) -> bytes:
    """The content of a file with a change."""
    kind, change = damage
    if kind == "cut":
        return content[: int(len(content) * change)]
    if kind == "value":
        with contextlib.suppress(ValueError):
            places: list[tuple[Any, Any]] = []
            whole = json.loads(content)
            _collect(whole, places)
            holder, key = places[int(len(places) * change[0])]
            holder[key] = change[1]
            return json.dumps(whole).encode()
        return content
    changed = bytearray(content)
    for place, byte in change:
        changed[int(len(content) * place)] = byte
    return bytes(changed)


def _collect(value: Any, places: list[tuple[Any, Any]]) -> None:
    """All holders and keys of values in decoded JSON."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        places.append((value, key))
        _collect(inner, places)
