"""Nodes of ROS 2 as agent, command centre and adversary, with a link whose other end is a function."""

import importlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mast_ros2 import type_store
from mast_ros2.object_messages import detection_array, tracked_objects
from mast_ros2.received_objects import received_tracks
from mast_ros2.spatial import Transform, odometry, transform_message
from ros2_messages import RosLink, random_states, through
from tiny_world import PERIOD_NS, Bench, detections, pose, tiny

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.messages.schemas import Message
from mast_zenoh.testing.simulation.world import SimulatedWorld

AGENT, CENTER, ADVERSARY = "ros2_agent.py", "ros2_command_center.py", "ros2_adversary.py"
SENT, BACK = "/mast/ego/detections", "/mast/ego/received_tracks"
TRACKS, PICTURE = "agent/ego/tracks", "cc/picture"


def world(rewrites: tuple[str, ...] = (), **options: Any) -> Resolved:
    """The tiny world with a node of ROS 2 in each place."""

    def edit(content: dict[str, Any]) -> None:
        plain = content["agents"]["*"]
        content["agents"]["ego"] = {**plain, "type": "Ros2Agent", "file": AGENT, **options}
        content["command_center"] = {"type": "Ros2CommandCenter", "file": CENTER}
        if rewrites:
            content["adversaries"] = {"thief": {"type": "Ros2Adversary", "file": ADVERSARY, "agent": "infra_1"}}
            content["keyexpr"] = {"map": "testbed.toml", "rewrites": list(rewrites)}

    return tiny(edit=edit)


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    return world()


def answering(back: str, make: Callable[[Any], Any], sent: str = SENT) -> RosLink:
    """A link to a program that answers each message on a topic."""
    return RosLink(lambda topic, message: [(back, through(make(message)))] if topic == sent else [])


def as_tracks(message: Any) -> Any:
    """The detections of a message as tracked objects."""
    states = received_tracks(through(message)).objects
    return tracked_objects(states, stamp_of(message), message.header.frame_id)


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def play(bench: Bench, frames: int, *objects: tuple[float, float]) -> None:
    """Frames in which an agent at the origin sees objects."""
    for frame in range(frames):
        bench.play(frame, pose=pose(), detections=detections(*objects))


def counts(bench: Bench) -> dict[str, Any]:
    result = bench.host.finish()["outside"]
    return {name: result[name] for name in ("asked", "answered", "late", "unanswered")}


# -- the agent ---------------------------------------------------------------------------------------------------------


def test_an_agent_sends_its_frame_and_publishes_the_tracks_that_come_back(resolved: Resolved) -> None:
    link = answering(BACK, as_tracks)
    ego = Bench(resolved, "ego", link=link)
    play(ego, 3, (10.0, 2.0), (4.0, -3.0))
    assert [topic for topic, _ in link.sent[:4]] == ["/clock", "/mast/ego/odometry", "/tf", SENT]
    published = ego.heard(TRACKS)
    assert [message.header.frame for message in published] == [0, 1, 2]
    sent = received_tracks(through(link.sent[-1][1])).objects
    np.testing.assert_array_equal(published[-1].body["position"], sent.position)
    assert [len(message.body["id"]) for message in ego.heard("agent/ego/mission")] == [2, 2, 2]
    assert counts(ego) == {"asked": 3, "answered": 3, "late": 0, "unanswered": 0}


def test_detections_that_come_back_are_tracked_by_the_agents_own_pipeline(resolved: Resolved) -> None:
    back = "/mast/ego/received_detections"
    ego = Bench(resolved, "ego", link=answering(back, lambda message: message), receives="detections")
    own = Bench(tiny(), "ego")
    for bench in (ego, own):
        play(bench, 5, (10.0, 2.0), (4.0, -3.0))
    for ours, theirs in zip(own.heard(TRACKS), ego.heard(TRACKS), strict=True):
        np.testing.assert_allclose(theirs.body["position"], ours.body["position"], atol=1e-9)
        assert theirs.body["id"].tolist() == ours.body["id"].tolist()


def test_an_agent_without_an_answer_sends_its_tracks_when_they_come(resolved: Resolved) -> None:
    link = RosLink()
    ego = Bench(resolved, "ego", link=link)
    play(ego, 2, (10.0, 2.0))
    assert ego.heard(TRACKS) == []
    for frame in (1, 0):
        link.arrive(BACK, tracked_objects(random_states(np.random.default_rng(frame), 2), frame * PERIOD_NS, "map"))
    ego.play(2, pose=pose(), detections=detections())
    assert [(message.header.frame, message.header.time_ns) for message in ego.heard(TRACKS)] == [(1, PERIOD_NS), (0, 0)]
    assert [message.header.frame for message in ego.heard("agent/ego/mission")] == [1], "never back in time"
    assert counts(ego) == {"asked": 3, "answered": 0, "late": 2, "unanswered": 1}


def test_an_agent_without_detections_from_outside_has_detected_nothing(resolved: Resolved) -> None:
    ego = Bench(resolved, "ego", link=RosLink(), receives="detections")
    play(ego, 3, (10.0, 2.0))
    assert [len(message.body["id"]) for message in ego.heard(TRACKS)] == [0, 0, 0]


def test_in_real_time_tracks_are_published_as_they_arrive(resolved: Resolved) -> None:
    link = RosLink(waits=False)
    ego = Bench(resolved, "ego", link=link)
    play(ego, 1, (10.0, 2.0))
    assert ego.heard(TRACKS) == []
    link.arrive(BACK, as_tracks(link.sent[-1][1]))
    ego.host.arrived()
    ego._collect()
    assert [len(message.body["id"]) for message in ego.heard(TRACKS)] == [1]


def test_tracks_in_the_agents_frame_are_transformed(resolved: Resolved) -> None:
    def in_agent_frame(message: Any) -> Any:
        states = ObjectStates.of(np.array([[2.0, 0.0, 0.0]]), size=np.ones((1, 3)))
        return tracked_objects(states, stamp_of(message), "ego")

    ego = Bench(resolved, "ego", link=answering(BACK, in_agent_frame))
    ego.play(0, pose=pose(x=5.0), detections=detections())
    assert ego.heard(TRACKS)[0].body["position"].tolist() == [[7.0, 0.0, 0.0]]


def test_a_skewed_stamp_is_predicted_to_the_frame(resolved: Resolved) -> None:
    def early(message: Any) -> Any:
        states = ObjectStates.of(np.zeros((1, 3)), size=np.ones((1, 3)), velocity=np.array([[10.0, 0.0, 0.0]]))
        return tracked_objects(states, stamp_of(message) - 40_000_000, "map")

    ego = Bench(resolved, "ego", link=answering(BACK, early))
    for frame in (0, 1):
        ego.play(frame, pose=pose(), detections=detections())
    (message,) = ego.heard(TRACKS)
    assert (message.header.frame, message.header.time_ns) == (1, PERIOD_NS)
    np.testing.assert_allclose(message.body["position"][0], [0.4, 0.0, 0.0])


@pytest.mark.parametrize("skew_s", [0.04, -0.04])
def test_detections_with_a_skewed_stamp_are_tracked_at_their_time(resolved: Resolved, skew_s: float) -> None:
    def seen_at_its_stamp(message: Any) -> Any:
        time_ns = stamp_of(message) + round(skew_s * 1e9)
        states = ObjectStates.of(np.array([[10e-9 * time_ns, 3.0, 0.8]]), size=np.full((1, 3), 2.0))
        return detection_array(states, max(0, time_ns), "map")

    link = answering("/mast/ego/received_detections", seen_at_its_stamp)
    ego = Bench(resolved, "ego", link=link, receives="detections")
    play(ego, 20)
    last = ego.heard(TRACKS)[-1]
    np.testing.assert_allclose(last.body["position"][0, :2], [10e-9 * last.header.time_ns, 3.0], atol=0.05)


def test_velocities_of_detections_with_ids_are_those_of_their_positions() -> None:
    def moving(message: Any) -> Any:
        time_ns = stamp_of(message)
        states = ObjectStates.of(np.array([[20e-9 * time_ns, 0.0, 0.0]]), id=np.array([8]), size=np.ones((1, 3)))
        return detection_array(states, time_ns, "map")

    ego = Bench(world(message="Detection3DArray"), "ego", link=answering(BACK, moving))
    play(ego, 3)
    velocities = [message.body["velocity"][0].tolist() for message in ego.heard(TRACKS)]
    np.testing.assert_allclose(velocities, [[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    assert {int(message.body["id"][0]) for message in ego.heard(TRACKS)} == {8}


def with_ids(*states: tuple[int, float, int]) -> RosLink:
    """Answers with one object each, as (id, x, ns by which the stamp is late)."""
    left = list(states)

    def next_one(message: Any) -> Any:
        number, x, skew_ns = left.pop(0)
        objects = ObjectStates.of(np.array([[x, 0.0, 0.0]]), id=np.array([number]), size=np.ones((1, 3)))
        return detection_array(objects, stamp_of(message) + skew_ns, "map")

    return answering(BACK, next_one)


def test_velocities_are_kept_when_stamps_are_too_close_for_new_ones() -> None:
    link = with_ids((8, 0.0, 0), (8, 3.0, 49_999_999), (8, 3.001, -49_999_999), (8, 6.0, 0))
    ego = Bench(world(message="Detection3DArray"), "ego", link=link)
    play(ego, 4)
    velocities = [message.body["velocity"][0, 0] for message in ego.heard(TRACKS)]
    np.testing.assert_allclose(velocities, [0.0, 20.0, 20.0, 20.0], rtol=1e-6)


def test_tracks_that_jump_are_left_out_and_counted() -> None:
    link = with_ids((8, 0.0, 0), (8, 1e7, 0), (8, 1e7, 0))
    ego = Bench(world(message="Detection3DArray"), "ego", link=link)
    play(ego, 3)
    assert [message.body["velocity"][:, 0].tolist() for message in ego.heard(TRACKS)] == [[0.0], [], [0.0]]
    assert ego.host.finish()["outside"]["left_out"] == {"velocity: beyond 150 m/s": 1}


def pose_message(kind: str, time_ns: int, x: float) -> Any:
    """A pose on the x axis, in a message of a type."""
    place = {"position": np.array([x, 0.0, 0.0]), "rotation": np.array([1.0, 0, 0, 0]), "velocity": np.zeros(3)}
    whole = odometry(place, time_ns, "map", "base_link")
    if kind == "Odometry":
        return whole
    if kind == "TransformStamped":
        moved = Transform("map", "base_link", time_ns, place["position"], place["rotation"])
        return transform_message([moved]).transforms[0]
    pose = whole.pose.pose if kind == "PoseStamped" else whole.pose
    return type_store.TYPES[f"geometry_msgs/msg/{kind}"](whole.header, pose)


@pytest.mark.parametrize("kind", ["Odometry", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"])
def test_the_pose_can_come_from_outside(kind: str) -> None:
    def program(topic: str, message: Any) -> list[tuple[str, Any]]:
        if topic != SENT:
            return []
        return [
            ("/mast/ego/received_pose", through(pose_message(kind, stamp_of(message), 50.0))),
            ("/mast/ego/received_detections", through(message)),
        ]

    ego = Bench(world(receives="detections", pose=kind, tracks_from="agent"), "ego", link=RosLink(program))
    ego.play(0, pose=pose(), detections=detections((10.0, 2.0)))
    assert ego.heard(TRACKS)[0].body["origin"].tolist() == [50.0, 0.0, 0.0]


# -- the command centre ------------------------------------------------------------------------------------------------

IN, OUT = "/mast/command_center/infra_2/tracks", "/mast/command_center/received_picture"


def batch(frame: int, *agents: tuple[str, float]) -> dict[str, Any]:
    """A batch with one track of each agent at (x, 0)."""
    states = ObjectStates.of(
        np.array([[x, 0.0, 0.0] for _, x in agents]).reshape(-1, 3), size=np.ones((len(agents), 3))
    )
    names = np.array([name for name, _ in agents], object)
    return states.columns() | {
        "agent": np.arange(len(agents)),
        "agents": names,
        "age_ns": np.zeros(len(agents), np.int64),
    }


def center_of(resolved: Resolved, link: RosLink, **config: Any) -> Bench:
    return Bench(resolved, "command_center", link=link, **config)


def test_a_centre_sends_each_agents_tracks_and_publishes_the_picture_that_comes_back(resolved: Resolved) -> None:
    link = answering(OUT, lambda message: message, IN)
    center = center_of(resolved, link)
    center.play(0, collated=batch(0, ("ego", 1.0), ("infra_2", 1.5)))
    topics = [topic for topic, _ in link.sent]
    assert topics == [f"/mast/command_center/{name}/tracks" for name in ("ego", "infra_1", "infra_2")]
    assert len(link.sent[1][1].objects) == 0, "infra_1 is not in the batch"
    (message,) = center.heard(PICTURE)
    assert message.body["position"].tolist() == [[1.5, 0.0, 0.0]]
    assert message.body["support"].tolist() == [2]


def test_a_centre_without_an_answer_predicts_the_last_picture_and_forgets_it_when_it_is_old(resolved: Resolved) -> None:
    def first(message: Any) -> Any:
        states = ObjectStates.of(np.zeros((1, 3)), size=np.ones((1, 3)), velocity=np.array([[10.0, 0.0, 0.0]]))
        return tracked_objects(states, stamp_of(message), "map")

    link = answering(OUT, first, IN)
    center = center_of(resolved, link, picture_age_s=0.2)
    center.play(0, collated=batch(0))
    link.program = lambda topic, message: []
    for frame in range(1, 4):
        center.play(frame, collated=batch(frame))
    pictures = center.heard(PICTURE)
    assert [message.header.frame for message in pictures] == [0, 1, 2, 3]
    assert [message.body["position"][:, 0].tolist() for message in pictures] == [[0.0], [1.0], [2.0], []]
    assert center.host.finish()["outside"]["predicted"] == 2


def test_in_real_time_a_centre_gives_a_frame_up_when_the_next_begins(resolved: Resolved) -> None:
    link = RosLink(waits=False)
    center = center_of(resolved, link)
    center.play(0, collated=batch(0, ("ego", 1.0)))
    assert center.heard(PICTURE) == []
    center.clock(1)
    assert [len(message.body["id"]) for message in center.heard(PICTURE)] == [0]
    link.arrive(OUT, tracked_objects(random_states(np.random.default_rng(0), 2), 0, "map"))
    center.host.arrived()
    center.send("collated", batch(1), 1)
    center.clock(2)
    assert [message.header.frame for message in center.heard(PICTURE)] == [0, 1], "one a frame"
    assert len(center.heard(PICTURE)[1].body["id"]) == 2, "predicted from the late one"


def test_a_centre_refuses_too_many_agents_at_its_start_and_counts_those_that_come_later(resolved, monkeypatch) -> None:
    exchanges = importlib.import_module("mast_ros2.node_exchanges")
    monkeypatch.setattr(exchanges, "MOST_AGENTS", 3)
    center = center_of(resolved, RosLink())
    center.play(0, collated=batch(0, ("ego", 1.0), ("late_1", 2.0), ("late_2", 3.0)))
    assert center.host.finish()["outside"]["left_out"] == {"agent: beyond 3": 2}
    monkeypatch.setattr(exchanges, "MOST_AGENTS", 2)
    with pytest.raises(ConfigurationError, match="agents: found 3, expected at most 2"):
        center_of(resolved, RosLink())


# -- the adversary -----------------------------------------------------------------------------------------------------

WIRES = {
    "tracks": ("/mast/thief/infra_1/tracks/in", "/mast/thief/infra_1/tracks/out"),
    "detections": ("/mast/thief/infra_1/detections/in", "/mast/thief/infra_1/detections/out"),
}


@pytest.fixture(scope="module")
def attacked() -> Resolved:
    return world(("on_tracks.toml", "on_detections.toml"))


def body_of(port: str, n: int = 4) -> dict[str, Any]:
    """A message of random objects."""
    states = random_states(np.random.default_rng(9), n)
    if port == "tracks":
        return states.columns() | {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    return detections(*states.position[:, :2].tolist())


def intercepted(attacked: Resolved, port: str, change: Callable[[Any], Any], body: dict[str, Any]) -> list[Message]:
    """What the adversary forwards of three equal messages."""
    sent, back = WIRES[port]
    thief = Bench(attacked, "thief", link=answering(back, change, sent))
    for frame in range(3):
        thief.play(frame, **{port: body})
    assert thief.host.failures == {}
    return thief.heard(f"agent/infra_1/{port}")


def edited(edit: Callable[[list[Any]], None]) -> Callable[[Any], Any]:
    """A change of the objects of a message, after the way through its bytes."""

    def change(message: Any) -> Any:
        message = through(message)
        edit(message.objects if hasattr(message, "objects") else message.detections)
        return message

    return change


@pytest.mark.parametrize("n", [0, 1, 5])
@pytest.mark.parametrize("port", WIRES)
def test_an_echo_leaves_no_trace(attacked: Resolved, port: str, n: int) -> None:
    body = body_of(port, n)
    thief = Bench(attacked, "thief", link=answering(WIRES[port][1], lambda message: message, WIRES[port][0]))
    thief.clock(0)
    message = thief.message(thief.key(port), body, 0)
    ((_, forwarded),) = thief.deliver(thief.key(port), message)
    assert forwarded.header == message.header
    for name, column in message.body.items():
        assert forwarded.body[name].tobytes() == column.tobytes()


@pytest.mark.parametrize("port", WIRES)
def test_a_removed_object_is_gone_and_the_others_keep_their_bytes(attacked: Resolved, port: str) -> None:
    body = body_of(port)
    first, *_ = intercepted(attacked, port, edited(lambda objects: objects.__delitem__(1)), body)
    for name in ("position", "size", "yaw", "score", "covariance"):
        np.testing.assert_array_equal(first.body[name], np.asarray(body[name])[[0, 2, 3]])


def test_rows_that_ros_cannot_express_are_forwarded_as_they_are(attacked: Resolved) -> None:
    body = body_of("tracks")
    body["size"] = np.asarray(body["size"]).copy()
    body["size"][1] = 0.0
    for message in intercepted(attacked, "tracks", lambda message: message, body):
        np.testing.assert_array_equal(message.body["size"], body["size"])


def test_a_picture_keeps_the_support_of_the_objects_that_come_back() -> None:
    def edit(content: dict[str, Any]) -> None:
        content["adversaries"] = {"thief": {"type": "Ros2Adversary", "file": ADVERSARY, "agent": "ego"}}
        content["keyexpr"] = {"map": "testbed.toml", "rewrites": ["on_picture.toml"]}

    states = random_states(np.random.default_rng(9), 3)
    body = states.columns() | {"support": np.array([1, 2, 3])}
    added = ObjectStates.of(np.zeros((1, 3)), id=np.array([777]), size=np.ones((1, 3)))

    def change(objects: list[Any]) -> None:
        objects[:] = [objects[2], objects[0], *tracked_objects(added, 0, "x").objects]

    sent, back = "/mast/thief/picture/in", "/mast/thief/picture/out"
    thief = Bench(tiny(edit=edit), "thief", link=answering(back, edited(change), sent))
    thief.play(0, picture=body)
    ((_, forwarded),) = thief.said
    assert forwarded.body["id"].tolist() == [states.id[2], states.id[0], 777]
    assert forwarded.body["support"].tolist() == [3, 1, 2]
    np.testing.assert_array_equal(forwarded.body["covariance"][:2], states.covariance[[2, 0]])


def test_no_object_gets_the_id_of_one_that_ros_cannot_express(attacked: Resolved) -> None:
    body = body_of("tracks")
    body["size"] = np.asarray(body["size"]).copy()
    body["size"][1] = 0.0
    twin = ObjectStates.of(np.zeros((1, 3)), id=np.asarray(body["id"])[1:2], size=np.ones((1, 3)))

    def add(objects: list[Any]) -> None:
        objects += tracked_objects(twin, 0, "x").objects

    for message in intercepted(attacked, "tracks", edited(add), body):
        assert sorted(message.body["id"].tolist()) == sorted(np.asarray(body["id"]).tolist())


@pytest.mark.parametrize("waits", [True, False])
def test_a_message_without_an_answer_is_forwarded_unchanged(attacked: Resolved, waits: bool) -> None:
    thief = Bench(attacked, "thief", link=RosLink(waits=waits))
    for frame in range(3):
        thief.play(frame, tracks=body_of("tracks"))
    thief.clock(3)
    forwarded = thief.heard("agent/infra_1/tracks")
    assert [message.header.frame for message in forwarded] == [0, 1, 2]
    assert [message.header.seq for message in forwarded] == [0, 1, 2]
    assert counts(thief)["unanswered"] == 3


# -- scenarios ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"ros2": {"router": "nowhere"}}, "ros2.router: found 'nowhere', expected a form such as"),
        ({"wait_s": 60.0}, "wait_s: found 60.0, expected 0 to 5"),
        ({"message": "DetectedObjects"}, "message: found 'DetectedObjects', expected one of TrackedObjects, "),
        ({"clock": "a clock"}, "clock: topic 'a clock': expected /name"),
        ({"world": "/map"}, "world: found '/map', expected the name of a frame"),
        ({"receives": "radar"}, "receives: found 'radar'"),
    ],
)
def test_a_wrong_parameter_is_refused_before_the_run(options: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        world(**options)


def test_a_simulated_mesh_refuses_nodes_with_topics_outside(resolved: Resolved) -> None:
    with pytest.raises(ConfigurationError, match="ego: Ros2Agent exchanges messages with programs outside the run"):
        SimulatedWorld.of(replace(resolved, modules=()))
