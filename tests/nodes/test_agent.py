"""An agent publishes its own sensors' estimates, then merges the picture."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_world import PERIOD_NS, Bench, Run, detections, picture, pose, tiny, tracks

from mast_zenoh.arrays import geometry
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.pipelines import MissionEstimator

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


def test_sensor_data_that_arrive_after_the_next_clock_are_ignored(resolved) -> None:
    ego = bench(resolved)
    for frame in range(4):
        frame_of(ego, frame)
    frame_of(ego, 4, "clock", "pose")
    ego.clock(5)
    assert ego.send("detections", detections(*[(5.0, 5.0)] * 3), 4) == []


def test_duplicate_sensor_data_count_once(resolved) -> None:
    ego = bench(resolved)
    frame_of(ego, 0)
    ego.send("detections", detections((5.0, 5.0)), 0)
    frame_of(ego, 1)
    assert frames_of(ego.heard(TRACKS)) == [0, 1]


@given(st.data())
@settings(max_examples=40)
def test_the_order_within_a_frame_does_not_matter(resolved, data: st.DataObject) -> None:
    def play(order: list[list[str]]) -> list[bytes]:
        ego = bench(resolved)
        bodies = {"pose": pose(x=1.0), "detections": detections((10.0, 2.0)), "picture": picture(FAR)}
        for frame, ports in enumerate(order):
            ego.clock(frame)
            for port in ports:
                ego.send(port, bodies[port], frame)
        return sorted(ego.payloads)

    plain = [["pose", "detections", "picture"]] * 4
    assert play([data.draw(st.permutations(ports)) for ports in plain]) == play(plain)


def test_tracks_are_in_the_world_frame(resolved) -> None:
    ego = bench(resolved)
    for frame in range(5):
        ego.play(frame, pose=pose(x=100.0, y=50.0, yaw=np.pi / 2), detections=detections((10.0, 0.0)))
    last = ego.heard(TRACKS)[-1].body
    np.testing.assert_allclose(last["position"], [[100.0, 60.0, 0.8]], atol=1e-6)
    np.testing.assert_array_equal(last["origin"], np.zeros(3))
    np.testing.assert_array_equal(last["rotation"], [1.0, 0.0, 0.0, 0.0])


def test_tracks_in_the_body_frame_include_its_origin_and_rotation(resolved) -> None:
    body_frame = {**resolved.nodes["ego"].config["pipeline"], "frame": "body"}
    ego = bench(resolved, pipeline=body_frame)
    where = pose(x=100.0, y=50.0, yaw=np.pi / 2)
    for frame in range(5):
        ego.play(frame, pose=where, detections=detections((10.0, 0.0)))
    last = ego.heard(TRACKS)[-1].body
    np.testing.assert_allclose(last["position"], [[10.0, 0.0, 0.8]], atol=1e-6)
    np.testing.assert_array_equal(last["origin"], where["position"])
    np.testing.assert_array_equal(last["rotation"], where["rotation"])
    world = geometry.states_to_world(ObjectStates.from_columns(last), last["origin"], last["rotation"])
    np.testing.assert_allclose(world.position, [[100.0, 60.0, 0.8]], atol=1e-6)
    mission = ego.heard(MISSION)[-1].body
    np.testing.assert_allclose(mission["position"], [[100.0, 60.0, 0.8]], atol=1e-6, err_msg="in the world frame")
    np.testing.assert_array_equal(mission["rotation"], [1.0, 0.0, 0.0, 0.0])


def test_in_the_body_frame_of_a_turning_agent_a_parked_car_appears_to_move(resolved) -> None:
    """The cost of the original MAST's behaviour."""
    speed = {}
    for frame_of_reference in ("world", "body"):
        config = {**resolved.nodes["ego"].config["pipeline"], "frame": frame_of_reference}
        ego = bench(resolved, pipeline=config)
        for frame in range(12):
            yaw = 0.04 * frame
            ego.play(frame, pose=pose(yaw=yaw))
            seen = detections((30 * np.cos(yaw), -30 * np.sin(yaw)))
            ego.send("detections", seen | {"yaw": np.array([-yaw])}, frame)
        body = ego.heard(TRACKS)[-1].body
        world = geometry.states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])
        speed[frame_of_reference] = np.hypot(*world.velocity[0, :2])
    assert speed["world"] < 0.1 < 1.0 < speed["body"]


def test_the_mission_uses_only_pictures_from_earlier_frames(resolved) -> None:
    ego = bench(resolved)
    for frame in range(4):
        ego.clock(frame)
        if frame == 2:
            ego.send("picture", picture(FAR), frame)
        ego.send("pose", pose(), frame)
        ego.send("detections", detections(), frame)
    assert [len(message.body["id"]) for message in ego.heard(MISSION)] == [0, 0, 0, 1]
    assert [len(message.body["id"]) for message in ego.heard(TRACKS)] == [0, 0, 0, 0]


def test_a_late_picture_is_used_from_the_frame_after_its_arrival(resolved) -> None:
    """Otherwise the order of picture and detections would affect the mission."""
    outcomes = []
    for picture_first in (True, False):
        ego = bench(resolved)
        for frame in range(5):
            ego.clock(frame)
            if picture_first and frame == 2:
                ego.send("picture", picture(FAR), 1, step=2)
            ego.send("pose", pose(), frame)
            ego.send("detections", detections(), frame)
            if not picture_first and frame == 2:
                ego.send("picture", picture(FAR), 1, step=2)
        outcomes.append([len(message.body["id"]) for message in ego.heard(MISSION)])
    assert outcomes == [[0, 0, 0, 1, 1]] * 2


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


def test_a_picture_from_the_future_is_not_used(resolved) -> None:
    ego = bench(resolved)
    for frame in range(3):
        if frame == 1:
            ego.send("picture", picture(FAR), 50, step=-1)
        ego.play(frame, pose=pose(), detections=detections())
    assert [len(message.body["id"]) for message in ego.heard(MISSION)] == [0, 0, 0]


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
        ({"status_every": 0}, "ego: Agent: status_every: found 0, expected 1 or more"),
        ({"picture_age_s": -1.0}, "ego: Agent: picture_age_s: found -1.0, expected 0 or more"),
        ({"unsupported_std_m": 0.0}, "ego: Agent: unsupported_std_m: found 0.0, expected more than 0"),
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
def test_objects_in_both_estimates_are_merged(name: str) -> None:
    own, common = states(tracks((0.0, 0.0), (20.0, 0.0)), 10), states(picture((0.5, 0.0), (40.0, 0.0)), 30)
    mission = estimator(name).estimate(0, own, common)
    assert len(set(mission.id.tolist())) == 3
    assert sorted(mission.position[:, 0].round().tolist()) == [0.0, 20.0, 40.0]


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize(("own", "common"), [(0, 2), (2, 0), (0, 0)])
def test_either_estimate_may_be_empty(name: str, own: int, common: int) -> None:
    places = [(10.0 * i, 0.0) for i in range(2)]
    mission = estimator(name).estimate(0, states(tracks(*places[:own])), states(picture(*places[:common])))
    assert len(mission) == own + common


def test_picture_first_keeps_the_picture_and_the_other_averages() -> None:
    own, common = states(tracks((0.0, 0.0))), states(picture((1.0, 0.0)))
    assert estimator("PictureFirst").estimate(0, own, common).position[0, 0] == 1.0
    assert estimator("OwnAndPicture").estimate(0, own, common).position[0, 0] == pytest.approx(1.0 / 1.3), (
        "of the picture's variance, 0.3 counts"
    )


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_scenario_can_choose_either_estimator(name: str) -> None:
    def choose(scenario: dict) -> None:
        scenario["agents"]["*"]["pipeline"]["mission"] = ESTIMATORS[name]

    run = Run(tiny(edit=choose))
    assert not run.failures
    assert len(run.messages[MISSION]) == 12
    assert len(run.decoded(MISSION, "tracks")[-1].body["id"]) >= 4, "it sees itself through the picture"


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
    """Tracks payloads of an agent with recorded sensor data and foreign pictures."""
    alone = Bench(resolved, agent)
    own = [("clock", "clock"), (f"agent/{agent}/pose", "pose"), (f"agent/{agent}/detections", "detections")]
    payloads = []
    for frame in range(12):
        places = pictures(frame)
        for position, (key, _) in enumerate(own):
            for place, payload in places:
                if place == position:
                    alone.host.deliver("cc/picture", payload, -1, counted=False)
            alone.host.deliver(key, recorded.messages[key][frame], frame)
        for place, payload in places:
            if place == len(own):
                alone.host.deliver("cc/picture", payload, frame)
        payloads += [out.payload for out in alone.outbox if out.key == f"agent/{agent}/tracks"]
        alone.outbox.clear()
    return payloads, alone


def hostile(kind: str, seed: int) -> Any:
    """Pictures that an attacker might send: (position in the frame, bytes)."""
    rng = np.random.default_rng(seed)

    def sound(frame: int, n: int, scale: float, at: int | None = None, definite: bool = True) -> bytes:
        root = rng.normal(size=(n, 9, 9))
        square = root @ np.swapaxes(root, 1, 2) if definite else root - rng.integers(0, 2) * root
        body = ObjectStates.of(
            rng.normal(size=(n, 3)) * scale,
            id=rng.permutation(n) - (n // 2) * (1 if n % 2 else -(2**40)),
            velocity=rng.normal(size=(n, 3)) * scale,
            size=rng.normal(size=(n, 3)) * scale,
            yaw=rng.normal(size=n) * scale,
            covariance=square * min(scale, 1e6) + 0.1 * definite * np.eye(9),
            score=rng.normal(size=n) * 10,
            class_id=rng.integers(0, 7, n).astype(np.uint8),
        ).columns() | {"support": rng.integers(-5, 5, n)}
        at = frame if at is None else at
        header = codec.Header("picture", "command_center", at, at * PERIOD_NS, frame)
        return codec.encode(codec.conform(header, body))

    def of(frame: int) -> list[tuple[int, bytes]]:
        place = int(rng.integers(0, 4))
        if kind == "none":
            return []
        if kind == "random":
            return [(place, sound(frame, int(rng.integers(0, 30)), 10.0 ** rng.integers(0, 3)))]
        if kind == "no covariance":
            return [(place, sound(frame, 8, 100.0, definite=False))]
        if kind == "huge numbers":
            return [(place, sound(frame, 5, 1e7))]
        if kind == "many objects":
            return [(place, sound(frame, 400, 50.0))]
        if kind == "of other frames":
            return [(p, sound(frame, 5, 30.0, at)) for p, at in ((0, frame + 1000), (1, 2**50 // PERIOD_NS), (3, 0))]
        if kind == "many a frame":
            return [(int(p), sound(frame, 3, 30.0)) for p in rng.integers(0, 4, 20)]
        assert kind == "malformed"
        whole = sound(frame, 4, 10.0)
        return [(0, b""), (1, whole[:-1]), (2, rng.bytes(200)), (3, whole.replace(b"picture", b"pictura"))]

    return of


@pytest.mark.parametrize("agent", ["ego", "infra_1"])
@pytest.mark.parametrize(
    "kind",
    [
        *("none", "random", "no covariance", "huge numbers", "many objects"),
        *("of other frames", "many a frame", "malformed"),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_messages_from_outside_never_change_the_safety_critical_estimate(resolved, recorded, agent, kind, seed) -> None:
    payloads, alone = replayed(resolved, recorded, agent, hostile(kind, seed))
    assert payloads == recorded.messages[f"agent/{agent}/tracks"]
    assert not alone.host.failures, "and has no other effect on it"


def test_attacks_on_other_agents_do_not_change_an_agents_own_tracks(resolved, recorded) -> None:
    for name in ("uncoordinated", "coordinated"):
        attacked = Run(tiny(name, "n_adversaries=1", "attack_start_s=0.2"))
        assert attacked.messages["attack/adversary_1/report"], "an attack took place"
        assert attacked.messages["cc/picture"] != recorded.messages["cc/picture"], "and it had an effect"
        for key in ("agent/ego/tracks", "agent/infra_2/tracks"):
            assert attacked.messages[key] == recorded.messages[key]
