"""Whatever comes from outside costs its message: nodes of ROS 2 live on, and publish valid messages alone."""

from typing import Any

import numpy as np
import pytest
from fuzzing import Fuzzing
from mast_ros2 import type_store
from ros2_flood import hostile, payload_of
from ros2_messages import RosLink, through
from tiny_world import Bench, detections, pose, tiny

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError

EVERYWHERE = {
    "ego": [
        ("/mast/ego/received_tracks", type_store.TRACKED_OBJECTS),
        ("/tf", type_store.TF_MESSAGE),
        ("/tf_static", type_store.TF_MESSAGE),
    ],
    "command_center": [("/mast/command_center/received_picture", type_store.TRACKED_OBJECTS)],
    "thief": [
        ("/mast/thief/infra_1/tracks/out", type_store.TRACKED_OBJECTS),
        ("/mast/thief/infra_1/detections/out", type_store.DETECTIONS),
    ],
}
FRAMES, MESSAGES = 8, 6


def world(**options: Any) -> Resolved:
    """The tiny world with a node of ROS 2 in each place."""

    def edit(content: dict[str, Any]) -> None:
        own = {"type": "Ros2Agent", "file": "ros2_agent.py", **options}
        content["agents"]["ego"] = {**content["agents"]["*"], **own}
        content["command_center"] = {"type": "Ros2CommandCenter", "file": "ros2_command_center.py"}
        thief = {"type": "Ros2Adversary", "file": "ros2_adversary.py", "agent": "infra_1"}
        content["adversaries"] = {"thief": thief}
        content["keyexpr"] = {"map": "testbed.toml", "rewrites": ["on_tracks.toml", "on_detections.toml"]}

    return tiny(edit=edit)


def own_message(random: np.random.Generator) -> ObjectStates:
    """Objects as other nodes of the run send them: valid messages, with values of any kind."""
    n = int(random.integers(4))
    return ObjectStates.of(
        random.normal(size=(n, 3)) * random.choice([1.0, 1e8]),
        id=random.integers(-5, 5, n),
        size=random.choice([0.0, 1.0, 1e3], (n, 3)),
        velocity=random.normal(size=(n, 3)) * random.choice([1.0, 1e8]),
        covariance=random.normal(size=(n, 9, 9)),
        score=random.random(n),
    )


def bodies(name: str, random: np.random.Generator) -> dict[str, dict[str, Any]]:
    """What a node gets in a frame, by port."""
    states = own_message(random)
    if name == "ego":
        return {"pose": pose(), "detections": detections((10.0, 2.0))}
    if name == "command_center":
        agents = {"agents": np.array(["ego", "infra_1"], object), "age_ns": np.zeros(2, np.int64)}
        return {"collated": states.columns() | {"agent": random.integers(0, 2, len(states))} | agents}
    reference = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    return {"tracks": states.columns() | reference, "detections": detections((1.0, 2.0), (3.0, 4.0))}


def flooded(resolved: Resolved, name: str, seed: int, *, waits: bool) -> Bench:
    """A node after frames in which it gets messages of all kinds from outside."""
    random = np.random.default_rng(seed)
    answers: list[tuple[str, Any]] = []
    link = RosLink(lambda topic, message: answers, waits=waits)
    bench = Bench(resolved, name, link=link)
    for frame in range(FRAMES):
        answers.clear()
        for place in range(2 * MESSAGES):
            topic, type_name = EVERYWHERE[name][int(random.integers(len(EVERYWHERE[name])))]
            message = through(hostile(type_name, random))
            if place % 2:
                answers.append((topic, message))
            else:
                link.arrive(topic, message)
        bench.play(frame, **bodies(name, random))
        bench.host.arrived()
        bench._collect()  # decodes, so checks, what it has published
    return bench


@pytest.mark.parametrize("waits", [True, False], ids=["lockstep", "realtime"])
@pytest.mark.parametrize("name", EVERYWHERE)
def test_messages_of_all_kinds_are_counted_and_the_node_lives(name: str, waits: bool, fuzzing: Fuzzing) -> None:
    resolved, used = world(), 0
    for seed in range(fuzzing.seed, fuzzing.seed + fuzzing.draws(3, 300)):
        bench = flooded(resolved, name, seed, waits=waits)
        assert bench.host.failures == {}, seed
        counts = bench.host.finish()["outside"]
        assert sum(counts["refused"].values()) > 0
        used += counts["answered"] + counts["late"]
        assert len(counts["refused"]) + len(counts["left_out"]) < 100
    assert used > 0, "some are answers"


def test_detections_of_all_kinds_are_counted_and_the_agent_lives(fuzzing: Fuzzing, monkeypatch: Any) -> None:
    topics = [
        (f"/mast/ego/received_{each}", kind)
        for each, kind in (("detections", type_store.DETECTIONS), ("pose", type_store.ODOMETRY))
    ]
    monkeypatch.setitem(EVERYWHERE, "ego", topics)
    resolved = world(receives="detections", pose="Odometry")
    for seed in range(fuzzing.seed, fuzzing.seed + fuzzing.draws(3, 300)):
        bench = flooded(resolved, "ego", seed, waits=True)
        assert bench.host.failures == {}, seed
        assert len(bench.heard("agent/ego/tracks")) == FRAMES, "one message a frame"


def test_bytes_of_all_kinds_are_a_message_or_refused(fuzzing: Fuzzing) -> None:
    random = np.random.default_rng(fuzzing.seed)
    refused = 0
    for _ in range(fuzzing.draws(60, 20_000)):
        for type_name in (type_store.TRACKED_OBJECTS, type_store.DETECTIONS, type_store.TF_MESSAGE):
            try:
                type_store.decode(type_name, payload_of(type_name, random))
            except MessageError:
                refused += 1
    assert refused > 0
