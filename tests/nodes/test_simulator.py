"""The simulator replays a scene frame by frame; truth goes to the evaluator."""

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, Run, TinyScene, tiny

from mast_zenoh.arrays import geometry
from mast_zenoh.wiring.model import Wiring


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


def test_the_truth_is_on_one_key_that_only_the_evaluator_receives() -> None:
    for name in ("baseline", "uncoordinated", "coordinated", "passthrough"):
        wiring = Wiring.from_json(tiny(name).wiring)
        carrying = [leg for wire, leg in wiring.legs() if wire.message == "truth"]
        assert [leg.key for leg in carrying] == ["scene/truth"]
        assert not carrying[0].subscribers
        assert [end.node for end in wiring.overhearers] == ["evaluator"]


def test_messages_to_agents_do_not_depend_on_the_truth(resolved) -> None:
    """Messages to agents depend on recorded detections, not on the truth."""
    recording = TinyScene(n_infrastructure=2).record(0, 5)
    blank = type(recording)(
        **{
            **{name: getattr(recording, name) for name in recording.__dataclass_fields__},
            "truth": recording.truth.select(slice(0, 0)),
            "truth_start": np.zeros(6, np.int64),
            "points": recording.points[:0],
        }
    )
    simulators = [Bench(resolved, "simulator", recording=scene) for scene in (recording, blank)]
    for _ in range(5):
        payloads = []
        for simulator in simulators:
            simulator.payloads.clear()
            published = advance(simulator)[1]
            payloads.append(
                [p for p, (key, _) in zip(simulator.payloads, published, strict=True) if key != "scene/truth"]
            )
        assert payloads[0] == payloads[1]


def test_a_run_plays_the_requested_number_of_frames() -> None:
    for frames in (1, 3):
        run = Run(tiny(frames=frames))
        assert len(run.messages["clock"]) == frames
        assert run.results["evaluator"]["metrics"]["frames"] == frames
