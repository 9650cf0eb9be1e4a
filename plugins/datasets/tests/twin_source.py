"""One small recording, which is written into the layouts of data sets and read back."""

from functools import cache

import numpy as np
from mast_datasets.traffic import HEIGHT_OF_CLASS

from mast_zenoh.scenes import Intersection
from mast_zenoh.scenes.making.assembly import Boxes, assemble
from mast_zenoh.scenes.making.virtual_agents import vehicle
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector


@cache
def twin_source() -> Recording:
    """An ego and two other cars on a generated junction, 12 frames; no poles."""
    return Intersection(scene_index=0, n_infrastructure=0, n_mobile=2, detector=CleanDetector()).record(0, 12)


@cache
def flat_twin_source() -> Recording:
    """The same with the height of each object by its class, for layouts without heights."""
    source = twin_source()
    truth = source.truth
    height = HEIGHT_OF_CLASS[truth.class_id]
    boxes = Boxes(
        frame=np.repeat(np.arange(len(source)), np.diff(source.truth_start)),
        id=truth.id,
        position=np.column_stack([truth.position[:, :2], height / 2]),
        size=np.column_stack([truth.size[:, :2], height]),
        yaw=truth.yaw,
        class_id=truth.class_id,
        velocity=truth.velocity,
    )
    paths = [vehicle(agent.name, boxes, agent.object_id) for agent in source.agents]
    return assemble(
        source.name,
        source.times_ns,
        boxes,
        paths,
        CleanDetector(),
        seed=0,
        buildings=source.buildings,
        building_height=source.building_height,
    )


def assert_equal_truth(recording: Recording, source: Recording, tolerance: float = 1e-6) -> None:
    """Assert that the objects and the vehicles of a source were read back, up to a shift of the origin.

    Objects may have other ids, but one each; agents are compared by their objects.
    """
    assert recording.times_ns.tolist() == source.times_ns.tolist()
    assert np.diff(recording.truth_start).tolist() == np.diff(source.truth_start).tolist()
    shift = np.array([*source.agent_position[0, 0, :2], 0.0])
    number = matching_ids(recording, source, shift)
    for frame in range(len(source)):
        truth, expected = recording.truth_at(frame), source.truth_at(frame)
        rows = np.searchsorted(truth.id, [number[k] for k in expected.id.tolist()])
        np.testing.assert_allclose(truth.position[rows], expected.position - shift, atol=tolerance)
        np.testing.assert_allclose(truth.size[rows], expected.size, atol=tolerance)
        np.testing.assert_allclose(np.angle(np.exp(1j * (truth.yaw[rows] - expected.yaw))), 0.0, atol=tolerance)
        assert truth.class_id[rows].tolist() == expected.class_id.tolist()
        objects = [agent.object_id for agent in recording.agents]
        for column, agent in enumerate(source.agents):
            mine = objects.index(number[agent.object_id])
            np.testing.assert_allclose(
                recording.agent_position[frame, mine], source.agent_position[frame, column] - shift, atol=tolerance
            )
            np.testing.assert_allclose(
                recording.agent_rotation[frame, mine], source.agent_rotation[frame, column], atol=tolerance
            )


def matching_ids(recording: Recording, source: Recording, shift: np.ndarray) -> dict[int, int]:
    """The id in a recording of each object of its source, by their positions in the first frame."""
    first, expected = recording.truth_at(0), source.truth_at(0)
    distance = np.linalg.norm(first.position[None] - (expected.position - shift)[:, None], axis=2)
    return dict(zip(expected.id.tolist(), first.id[distance.argmin(axis=1)].tolist(), strict=True))


def returns_of(recording: Recording, source: Recording) -> np.ndarray:
    """Lidar returns (N, A) in a recording, of the rows and agents of its source."""
    number = matching_ids(recording, source, np.array([*source.agent_position[0, 0, :2], 0.0]))
    objects = [agent.object_id for agent in recording.agents]
    columns = [objects.index(number[agent.object_id]) for agent in source.agents]
    parts = []
    for frame in range(len(source)):
        rows = np.searchsorted(recording.truth_at(frame).id, [number[k] for k in source.truth_at(frame).id.tolist()])
        parts.append(recording.points_at(frame)[rows][:, columns])
    return np.concatenate(parts)
