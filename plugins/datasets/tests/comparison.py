"""Generated recordings to write into the layouts of data sets, and their comparison with what is read back."""

from collections.abc import Collection
from functools import cache

import numpy as np
from mast_datasets.traffic import HEIGHT_OF_CLASS

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX
from mast_zenoh.scenes import Intersection
from mast_zenoh.scenes.making.assembly import SceneBoxes, assemble, vehicle
from mast_zenoh.scenes.making.observe import World, lidar_visibility
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector, sensor_pose

FRAMES = 12


@cache
def junction(*, n_infrastructure: int = 2, n_mobile: int = 1, frames: int = FRAMES) -> Recording:
    """A junction with the ego, other mobile agents and poles."""
    scene = Intersection(
        scene_index=0, n_infrastructure=n_infrastructure, n_mobile=n_mobile, dense=False, detector=CleanDetector()
    )
    return scene.record(0, frames)


@cache
def flat_junction() -> Recording:
    """An ego and two other cars; the height of each object is that of its class, for layouts without heights."""
    source = junction(n_infrastructure=0, n_mobile=2)
    boxes = boxes_of(source)
    height = HEIGHT_OF_CLASS[boxes.class_id]
    boxes.position[:, 2], boxes.size[:, 2] = height / 2, height
    return assemble(
        source.name,
        source.times_ns,
        boxes,
        [vehicle(agent.name, boxes, agent.object_id) for agent in source.agents],
        CleanDetector(),
        seed=0,
        buildings=source.buildings,
        building_height=source.building_height,
    )


def boxes_of(recording: Recording) -> SceneBoxes:
    """The objects of all frames."""
    truth = recording.truth
    frame = np.repeat(np.arange(len(recording)), np.diff(recording.truth_start))
    columns = truth.position.copy(), truth.size.copy(), truth.yaw, truth.class_id, truth.velocity
    return SceneBoxes(frame, truth.id, *columns)


def lidar_pose(recording: Recording, frame: int, agent: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of an agent's lidar in the world."""
    mount = recording.agents[agent].sensor
    pose = recording.agent_position[frame, agent], recording.agent_rotation[frame, agent]
    return sensor_pose(*pose, mount.mount_position, mount.mount_rotation)


def matrix(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """A 4 x 4 matrix."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation, position
    return result


def assert_same(
    read: Recording,
    source: Recording,
    shift: object = 0.0,
    *,
    listed: np.ndarray | None = None,
    added: Collection[int] = (),
    kept_ids: bool = True,
    bodies: bool = True,
    all_cars: bool = False,
) -> tuple[np.ndarray, dict[int, int]]:
    """Assert that times, poses and objects of a recording are those of its source.

    Returns the row in the truth of `read` of each listed one of the source, and the column in the source of each agent
    (column) of `read`; one of them may have further agents.

    shift: (3,) m, where the origin of `read` is in the source; listed: (N,) rows of the source's truth that the data
    has, None: all; added: ids of the objects of which `read` may have further boxes; kept_ids: objects have the ids of
    the source, but for the agents' own; bodies: whether agents are where they are in the source, otherwise their lidars
    all_cars: whether the class of all objects is a car
    """
    frames, starts = len(read), source.truth_start
    assert read.times_ns.tolist() == (source.times_ns[:frames] - source.times_ns[0]).tolist()
    agents = range(len(source.agents))
    distance = [
        [np.linalg.norm(lidar_pose(source, 0, k)[0] - shift - lidar_pose(read, 0, own)[0]) for k in agents]
        for own in range(len(read.agents))
    ]
    columns = {own: int(np.argmin(row)) for own, row in enumerate(distance) if min(row) < 1e-6}
    assert len(columns) in (len(read.agents), len(source.agents))
    for own, k in columns.items():
        assert read.agents[own].kind == source.agents[k].kind
        for frame in range(frames):
            (position, rotation), found = lidar_pose(source, frame, k), lidar_pose(read, frame, own)
            np.testing.assert_allclose(found[0], position - shift, atol=1e-6)
            np.testing.assert_allclose(found[1], rotation, atol=1e-6)
        if bodies:
            np.testing.assert_allclose(
                read.agent_position[:, own], source.agent_position[:frames, k] - shift, atol=1e-6
            )
            np.testing.assert_allclose(read.agent_rotation[:, own], source.agent_rotation[:frames, k], atol=1e-6)
    there = np.arange(starts[frames]) if listed is None else np.flatnonzero(listed[: starts[frames]])
    rows = np.concatenate([_nearest(read, source, frame, there, shift) for frame in range(frames)])
    further = np.setdiff1d(np.arange(len(read.truth)), rows)
    assert set(read.truth.id[further].tolist()) <= set(added)
    truth, expected = read.truth.select(rows), source.truth.select(there)
    np.testing.assert_allclose(truth.position, expected.position - shift, atol=1e-6)
    np.testing.assert_allclose(truth.size, expected.size, atol=1e-6)
    np.testing.assert_allclose(wrap_angle(truth.yaw - expected.yaw), 0.0, atol=1e-6)
    classes = np.full_like(expected.class_id, CLASS_INDEX["car"]) if all_cars else expected.class_id
    assert truth.class_id.tolist() == classes.tolist()
    ids = set(zip(truth.id.tolist(), expected.id.tolist(), strict=True))
    assert len(ids) == len({one for one, _ in ids}) == len({other for _, other in ids}), "ids last"
    own = {agent.object_id for agent in read.agents}
    assert not kept_ids or all(one == other or one in own for one, other in ids)
    return rows, columns


def _nearest(read: Recording, source: Recording, frame: int, rows: np.ndarray, shift: object) -> np.ndarray:
    """Rows of `read` in a frame that are nearest to rows of its source."""
    rows = rows[(rows >= source.truth_start[frame]) & (rows < source.truth_start[frame + 1])]
    offset = read.truth_at(frame).position[:, None] - (source.truth.position[rows] - shift)
    return read.truth_start[frame] + np.linalg.norm(offset, axis=2).argmin(axis=0)


def assert_seen_without_buildings(read: Recording, source: Recording, columns: list[int]) -> None:
    """The lidars of `read` see what they would see at the agents' places in the source without its buildings."""
    frames = len(read)
    start = source.truth_start[: frames + 1]
    position = source.agent_position[:frames, columns]
    world = World(
        name="expected",
        agents=read.agents,
        period_ns=source.period_ns,
        times_ns=source.times_ns[:frames],
        truth=source.truth.select(slice(0, int(start[-1]))),
        truth_start=start,
        agent_position=position,
        agent_rotation=source.agent_rotation[:frames, columns],
        agent_velocity=np.zeros_like(position),
    )
    expected = lidar_visibility(world)
    np.testing.assert_array_equal(read.points >= 5, expected >= 5)
    np.testing.assert_allclose(read.points, expected, rtol=0.02, atol=2)
    assert (expected >= 5).any(axis=0).all(), "every agent sees something"
