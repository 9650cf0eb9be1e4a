"""An agent publishes its own sensors' estimates, then merges the picture."""

from typing import Any

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, Run, detections, picture, pose, tiny, tracks

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.fusion.pipelines import MissionEstimator
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message

TRACKS, MISSION, STATUS = "agent/ego/tracks", "agent/ego/mission", "agent/ego/status"
FAR = (80.0, 80.0)


@pytest.fixture(scope="module")
def resolved():
    return tiny()


def bench(resolved, **config: Any) -> Bench:
    """The ego of the tiny world with a changed configuration."""
    return Bench(resolved, "ego", **config)


def frame_of(bench: Bench, frame: int, *ports: str) -> list[tuple[str, Message]]:
    """A frame with only some of clock, pose and detections; a car is 10 m ahead."""
    published = []
    for port in ports or ("clock", "pose", "detections"):
        body = {"clock": {}, "pose": pose(x=0.5 * frame), "detections": detections((10.0, 2.0))}[port]
        published += bench.send(port, body, frame)
    return published


def frames_of(messages: list[Message]) -> list[int]:
    return [message.header.frame for message in messages]


def test_every_frame_has_one_message_of_each_estimate_even_if_empty(resolved) -> None:
    ego = bench(resolved)
    for frame in range(4):
        ego.play(frame, pose=pose(), detections=detections())
    for key in (TRACKS, MISSION):
        assert frames_of(ego.heard(key)) == [0, 1, 2, 3]
        assert [len(message.body["id"]) for message in ego.heard(key)] == [0, 0, 0, 0]


@pytest.mark.parametrize("lost", [["pose"], ["detections"], ["pose", "detections"]])
def test_a_frame_without_sensor_data_is_published_at_the_next_clock(resolved, lost: list[str]) -> None:
    ego = bench(resolved)
    for frame in range(6):
        frame_of(ego, frame)
    assert frame_of(ego, 6, "clock", *({"pose", "detections"} - set(lost))) == []
    late = ego.clock(7)
    assert [(key, message.header.frame) for key, message in late] == [(TRACKS, 6), (MISSION, 6)]
    assert late[0][1].header.time_ns == 6 * PERIOD_NS
    assert len(late[0][1].body["id"]) == 1, "it keeps its tracks"
    frame_of(ego, 7, "pose", "detections")
    assert frames_of(ego.heard(TRACKS)) == list(range(8))


def test_an_agent_without_a_pose_publishes_nothing(resolved) -> None:
    ego = bench(resolved)
    frame_of(ego, 0, "clock", "pose")
    frame_of(ego, 1, "clock", "detections")
    assert frame_of(ego, 2, "clock") == []
    frame_of(ego, 2, "pose", "detections")
    assert frames_of(ego.heard(TRACKS)) == [2]


def test_duplicate_and_late_sensor_data_are_ignored(resolved) -> None:
    ego = bench(resolved)
    for frame in range(4):
        frame_of(ego, frame)
        assert ego.send("detections", detections((5.0, 5.0)), frame) == []
    frame_of(ego, 4, "clock", "pose")
    ego.clock(5)
    assert ego.send("detections", detections(*[(5.0, 5.0)] * 3), 4) == []
    assert frames_of(ego.heard(TRACKS)) == list(range(5))


@pytest.mark.parametrize(
    ("frame_of_reference", "position", "origin", "yaw"),
    [("world", [100.0, 60.0, 0.8], [0.0, 0.0, 0.0], 0.0), ("body", [10.0, 0.0, 0.8], [100.0, 50.0, 0.0], np.pi / 2)],
)
def test_tracks_are_in_the_configured_frame_of_reference_and_the_mission_in_the_world_frame(
    resolved, frame_of_reference: str, position: list[float], origin: list[float], yaw: float
) -> None:
    config = {**resolved.nodes["ego"].config["pipeline"], "frame": frame_of_reference}
    ego = bench(resolved, pipeline=config)
    for frame in range(5):
        ego.play(frame, pose=pose(x=100.0, y=50.0, yaw=np.pi / 2), detections=detections((10.0, 0.0)))
    last, mission = (ego.heard(key)[-1].body for key in (TRACKS, MISSION))
    np.testing.assert_allclose(last["position"], [position], atol=1e-6)
    np.testing.assert_array_equal(last["origin"], origin)
    np.testing.assert_array_equal(last["rotation"], pose(yaw=yaw)["rotation"])
    np.testing.assert_allclose(mission["position"], [[100.0, 60.0, 0.8]], atol=1e-6)
    np.testing.assert_array_equal(mission["rotation"], [1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("position", range(3))
@pytest.mark.parametrize(
    ("about", "step", "sizes"), [(2, 2, [0, 0, 0, 1, 1]), (1, 2, [0, 0, 0, 1, 1]), (50, -1, [0] * 5)]
)
def test_a_picture_counts_for_the_mission_from_the_frame_after_its_arrival_unless_it_is_from_the_future(
    resolved, position: int, about: int, step: int, sizes: list[int]
) -> None:
    """Otherwise the order of picture and detections would affect the mission."""
    ego = bench(resolved)
    for frame in range(5):
        ego.clock(frame)
        arrivals = [("pose", pose(), frame, frame), ("detections", detections(), frame, frame)]
        if frame == 2:
            arrivals.insert(position, ("picture", picture(FAR), about, step))
        for port, body, of_frame, at in arrivals:
            ego.send(port, body, of_frame, step=at)
    assert [len(message.body["id"]) for message in ego.heard(MISSION)] == sizes
    assert [len(message.body["id"]) for message in ego.heard(TRACKS)] == [0] * 5


def test_the_picture_is_propagated_to_the_frame_and_dropped_when_too_old(resolved) -> None:
    ego = bench(resolved, picture_age_s=0.3)
    for frame in range(7):
        ego.play(frame, pose=pose(), detections=detections())
        if frame == 1:
            ego.send("picture", picture((50.0, 0.0), velocity=(10.0, 0.0)), frame)
    places = [message.body["position"][:, 0].tolist() for message in ego.heard(MISSION)]
    assert places == [[], [], pytest.approx([51.0]), pytest.approx([52.0]), pytest.approx([53.0]), [], []]


def test_objects_that_no_agent_supports_are_left_out_before_the_picture_loses_them(resolved) -> None:
    sizes = {}
    for support, std_m in ((0, 1.0), (1, 1.0), (0, 0.4)):
        ego = bench(resolved)
        for frame in range(3):
            frame_of(ego, frame)
            body = picture(FAR)
            body["support"][:] = support
            body["covariance"][:] = 0.5 * std_m**2 * np.eye(9)
            ego.send("picture", body, frame)
        sizes[support, std_m] = len(ego.heard(MISSION)[-1].body["id"])
    assert sizes == {(0, 1.0): 1, (1, 1.0): 2, (0, 0.4): 2}, "the car ahead, and the object of the picture"


def test_a_status_is_sent_with_the_first_frame_and_then_regularly(resolved) -> None:
    ego = bench(resolved, status_every=3)
    for frame in range(7):
        frame_of(ego, frame)
    assert frames_of(ego.heard(STATUS)) == [0, 3, 6]
    body = ego.heard(STATUS)[-1].body
    assert {name: column.tolist() for name, column in body.items()} == {"mobile": [1], "detections": [1], "tracks": [1]}


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ({"status_every": 0}, "ego: Agent: status_every"),
        ({"picture_age_s": -1.0}, "ego: Agent: picture_age_s"),
        ({"unsupported_std_m": 0.0}, "ego: Agent: unsupported_std_m"),
    ],
)
def test_invalid_parameters_are_refused(resolved, config: dict, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        bench(resolved, **config)


# -- the two mission estimators ------------------------------------------------------------------------------------

ESTIMATORS = {
    "OwnAndPicture": dict(type="OwnAndPicture", radius=2.0),
    "PictureFirst": dict(type="PictureFirst", radius=2.0),
}


def estimator(name: str) -> MissionEstimator:
    return registry.build(ESTIMATORS[name], MissionEstimator, "mission")


def states(body: dict[str, np.ndarray], first_id: int = 0) -> ObjectStates:
    objects = ObjectStates.from_columns(body)
    return objects.with_(id=objects.id + first_id)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize(
    ("own", "common", "merged"),
    [
        ([0.0, 20.0], [0.5, 40.0], [0.0, 20.0, 40.0]),
        ([], [10.0, 20.0], [10.0, 20.0]),
        ([10.0, 20.0], [], [10.0, 20.0]),
        ([], [], []),
    ],
)
def test_objects_in_both_estimates_are_merged_and_either_may_be_empty(name, own, common, merged) -> None:
    mission = estimator(name).estimate(
        0, states(tracks(*((x, 0.0) for x in own)), 10), states(picture(*((x, 0.0) for x in common)), 30)
    )
    assert len(set(mission.id.tolist())) == len(merged)
    assert sorted(mission.position[:, 0].round().tolist()) == merged


def test_picture_first_keeps_the_picture_and_the_other_averages() -> None:
    own, common = states(tracks((0.0, 0.0))), states(picture((1.0, 0.0)))
    assert estimator("PictureFirst").estimate(0, own, common).position[0, 0] == 1.0
    assert estimator("OwnAndPicture").estimate(0, own, common).position[0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize("swept", [True, False])
def test_an_estimator_that_looks_gets_the_agents_own_sweep(swept: bool) -> None:
    def veto(scenario: dict) -> None:
        pipeline = scenario["agents"]["*"]["pipeline"]
        pipeline["mission"] = dict(type="FreeSpaceVeto", mission=pipeline["mission"])
        scenario["keyexpr"]["rewrites"] = ["views.toml"] if swept else []

    ego = bench(tiny(edit=veto))
    for frame in range(3):
        ego.play(frame, pose=pose(), detections=detections())
        if swept:
            ego.send("sweep", {"free": np.full((16, 180), 100.0)}, frame)
        if frame == 0:
            ego.send("picture", picture((30.0, 0.0), (0.5, 0.0)), frame)
    counts = [len(message.body["id"]) for message in ego.heard(MISSION)]
    assert counts == ([0, 1, 1] if swept else [0, 2, 2]), "it sees through the first, and the second is itself"


# -- safety ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(resolved) -> Run:
    run = Run(resolved)
    assert not run.failures
    return run


def replayed(resolved, recorded: Run, agent: str, pictures: Any) -> tuple[list[bytes], Bench]:
    """Tracks payloads of an agent with recorded sensor data and foreign pictures; pictures: of a frame, by position."""
    alone = Bench(resolved, agent)
    for frame in range(12):
        foreign = pictures(frame)
        for position, key in enumerate(("clock", f"agent/{agent}/pose", f"agent/{agent}/detections", "")):
            for payload in foreign[position]:
                alone.host.deliver("cc/picture", payload, -1 if key else frame, counted=not key)
            if key:
                alone.host.deliver(key, recorded.messages[key][frame], frame)
    return [out.payload for out in alone.outbox if out.key == f"agent/{agent}/tracks"], alone


def hostile(seed: int) -> Any:
    """Pictures that an attacker might send in a frame, as bytes, by their position among the agent's own messages.

    Up to 400 objects, huge numbers, no valid covariances, frames of the past and the future, and malformed ones.
    """
    rng = np.random.default_rng(seed)

    def forged(frame: int) -> bytes:
        n, scale = int(rng.choice([0, 5, 30, 400])), 10.0 ** rng.integers(0, 8)
        root = rng.normal(size=(n, 9, 9))
        square = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(9) if rng.integers(2) else root
        body = ObjectStates.of(
            rng.normal(size=(n, 3)) * scale,
            id=rng.permutation(n) - (n // 2) * (1 if n % 2 else -(2**40)),
            velocity=rng.normal(size=(n, 3)) * scale,
            size=rng.normal(size=(n, 3)) * scale,
            yaw=rng.normal(size=n) * scale,
            covariance=square * min(scale, 1e6),
            score=rng.normal(size=n) * 10,
            class_id=rng.integers(0, 7, n).astype(np.uint8),
        ).columns() | {"support": rng.integers(-5, 5, n)}
        at = int(rng.choice([frame, frame, 0, frame + 1000, 2**50 // PERIOD_NS]))
        whole = codec.encode(codec.conform(codec.Header("picture", "command_center", at, at * PERIOD_NS, frame), body))
        malformed = (whole, whole, whole, b"", whole[:-1], rng.bytes(200), whole.replace(b"picture", b"pictura"))
        return malformed[rng.integers(len(malformed))]

    return lambda frame: [[forged(frame) for _ in range(rng.integers(0, 4))] for _ in range(4)]


@pytest.mark.parametrize("agent", ["ego", "infra_1"])
def test_messages_from_outside_never_change_the_safety_critical_estimate(resolved, recorded, agent: str) -> None:
    for pictures in (lambda frame: [[]] * 4, *map(hostile, range(8))):
        payloads, alone = replayed(resolved, recorded, agent, pictures)
        assert payloads == recorded.messages[f"agent/{agent}/tracks"]
        assert not alone.host.failures, "and has no other effect on it"
