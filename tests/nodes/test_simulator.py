"""The simulator replays a scene frame by frame; truth goes to the evaluator."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, TinyScene, tiny

from mast_zenoh.arrays import geometry


def advance(bench: Bench):
    more = bench.node.advance(bench.host)
    return more, bench._collect()


@pytest.fixture(scope="module")
def resolved():
    return tiny(frames=5)


def test_a_frame_is_a_clock_then_the_truth_and_all_poses_and_detections(resolved) -> None:
    simulator = Bench(resolved, "simulator")
    for frame in range(5):
        more, published = advance(simulator)
        assert more
        keys = [key for key, _ in published]
        assert keys[0] == "clock"
        assert sorted(keys[1:]) == [
            *(f"agent/{agent}/{what}" for agent in ("ego", "infra_1", "infra_2") for what in ("detections", "pose")),
            "scene/truth",
        ]
        assert {message.header.frame for _, message in published} == {frame}
        assert {message.header.time_ns for _, message in published} == {frame * PERIOD_NS}
        assert {message.header.seq for _, message in published} == {frame}
        assert {message.header.source for _, message in published} == {"simulator"}


def test_the_simulator_ends_with_the_scene_or_after_the_requested_frames(resolved) -> None:
    for limit, expected in ((None, 5), (3, 3), (5, 5), (9, 5)):
        simulator = Bench(resolved, "simulator", frames=limit)
        frames = 0
        while advance(simulator)[0]:
            frames += 1
        assert frames == expected
        assert advance(simulator) == (False, [])


def test_the_simulator_publishes_the_recorded_data(resolved) -> None:
    recording = TinyScene(n_infrastructure=2).record(0, 5)
    simulator = Bench(resolved, "simulator")
    for frame in range(5):
        published = dict(advance(simulator)[1])
        truth = published["scene/truth"].body
        np.testing.assert_array_equal(truth["position"], recording.truth_at(frame).position)
        np.testing.assert_array_equal(truth["points"], recording.points_at(frame))
        assert truth["agents"].tolist() == list(recording.agent_names)
        assert truth["agent_object"].tolist() == [0, -1, -1]
        for i, agent in enumerate(recording.agent_names):
            pose, detections = published[f"agent/{agent}/pose"].body, published[f"agent/{agent}/detections"].body
            np.testing.assert_array_equal(pose["position"], recording.agent_position[frame, i])
            np.testing.assert_allclose(
                geometry.rotation_from_quaternion(pose["rotation"]), recording.agent_rotation[frame, i], atol=1e-12
            )
            for name, column in recording.detections_at(frame, i).columns().items():
                np.testing.assert_array_equal(detections[name], column)


def test_a_scene_with_a_late_start_begins_at_time_zero(resolved) -> None:
    recording = TinyScene().record(0, 5)
    recording.times_ns[:] += 7_000_000_000
    simulator = Bench(resolved, "simulator", recording=recording)
    assert [advance(simulator)[1][0][1].header.time_ns for _ in range(3)] == [0, PERIOD_NS, 2 * PERIOD_NS]


def test_messages_to_agents_do_not_depend_on_the_truth(resolved) -> None:
    """Messages to agents depend on recorded detections, not on the truth."""
    recording = TinyScene(n_infrastructure=2).record(0, 5)
    nothing = dict(truth=recording.truth.select(slice(0, 0)), points=recording.points[:0])
    blank = replace(recording, **nothing, truth_start=np.zeros(6, np.int64))
    sent = []
    for scene in (recording, blank):
        simulator = Bench(resolved, "simulator", recording=scene)
        while advance(simulator)[0]:
            pass
        keys = [key for key, _ in simulator.said]
        sent.append([p for p, key in zip(simulator.payloads, keys, strict=True) if key != "scene/truth"])
    assert sent[0] == sent[1]
    assert len(sent[0]) == 5 * 7
