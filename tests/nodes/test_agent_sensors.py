"""An agent with several sensors, or sensors at times of their own, publishes tracks at the times of the frames."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, Run, detections, pose, tiny

from mast_zenoh.config import bundle
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, WiringError
from mast_zenoh.messages.schemas import Message
from mast_zenoh.wiring import maps

FRAMES = 10
LATE = dict(type="Lidar", rate_hz=5.0, phase_s=0.07)
SENSORS = {
    "ego": [dict(type="Lidar", rate_hz=10.0, phase_s=0.03)],
    "infra_*": [LATE],
    "infra_1": [LATE, dict(type="Radar", rate_hz=10.0, phase_s=0.05), dict(type="ObjectCamera", rate_hz=2.5)],
}
SCENE = dict(type="Intersection", n_vehicles=8, n_pedestrians=2, n_bicycles=0, n_infrastructure=2, sensors=SENSORS)
RADAR = "agent/infra_1/detections/radar"
SPEED, AGE_NS = 10.0, 50_000_000


def rates(name: str = "baseline", **parts: Any) -> Resolved:
    """A shipped scenario with sensors at different rates."""
    return tiny(name, frames=FRAMES, edit=lambda content: content.update(scene=SCENE, **parts))


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    return rates()


@pytest.fixture(scope="module")
def played(resolved: Resolved) -> Run:
    return Run(resolved)


def test_each_sensor_has_a_wire_of_its_own_and_sends_only_what_it_measured(played: Run) -> None:
    sent = {key: played.decoded(key, "detections") for key in played.messages if "/detections" in key}
    assert sorted(sent) == [
        *("agent/ego/detections", "agent/infra_1/detections", "agent/infra_1/detections/camera"),
        *(RADAR, "agent/infra_2/detections"),
    ]
    due = {
        "agent/ego/detections": [(k + 1, 30 + 100 * k) for k in range(9)],
        "agent/infra_1/detections": [(2 * k + 1, 70 + 200 * k) for k in range(5)],
        "agent/infra_1/detections/camera": [(0, 0), (4, 400), (8, 800)],
        RADAR: [(k + 1, 50 + 100 * k) for k in range(9)],
    }
    for key, expected in due.items():
        headers = [message.header for message in sent[key]]
        assert [(header.frame, header.time_ns) for header in headers] == [(f, ms * 1_000_000) for f, ms in expected]
        assert [header.seq for header in headers] == list(range(len(expected)))


def test_every_agent_publishes_one_message_of_tracks_a_frame_at_its_time(played: Run) -> None:
    for agent in ("ego", "infra_1", "infra_2"):
        headers = [message.header for message in played.decoded(f"agent/{agent}/tracks", "tracks")]
        assert [(header.frame, header.time_ns) for header in headers] == [(f, f * PERIOD_NS) for f in range(FRAMES)]
    assert not played.rejected
    assert not played.failures


def under_attack(*wires: str) -> Resolved:
    """An adversary on detections of infra_1, on each of these wires."""
    selection = dict(type="UncoordinatedSelection", n_false_positives=5.0)
    attack = dict(type="UncoordinatedAttack", start_s=0.3, selection=selection)
    inserts = [dict(wire=wire, role="adversary", input="detections", output="detections_out") for wire in wires]
    return rates(
        adversaries={"adversary_1": dict(type="Adversary", agent="infra_1", attack=attack)},
        keyexpr=dict(map="testbed.toml", rewrites=[{"insert": inserts}]),
    )


def test_an_attack_on_one_sensor_changes_no_other_sensors_messages(played: Run) -> None:
    attacked = Run(under_attack(RADAR))
    assert not attacked.failures
    of_sensors = [key for key in played.messages if key.split("/")[-1] in ("detections", "camera", "pose")]
    assert len(of_sensors) == 7
    for key in of_sensors:
        assert attacked.messages[key] == played.messages[key], key
    assert attacked.messages[f"{RADAR}/@tap/0"] == played.messages[RADAR]
    assert attacked.messages[RADAR] != played.messages[RADAR]
    metrics = attacked.results["evaluator"]["metrics"]["interposers"]["adversary_1"]
    assert metrics["effects"]["inserted"] > 0
    assert metrics["agreement"] == "agrees"
    assert set(attacked.results["evaluator"]["tables"]["attacks"]["wire"]) == {RADAR}


def test_a_fault_of_one_sensor_changes_no_other_sensors_messages(played: Run) -> None:
    """The radar is blind for some frames; the pole's own lidar is not."""
    blind = dict(type="BlindSector", node=RADAR, at=0.2, until=0.6, azimuth_min_deg=-180.0, azimuth_max_deg=180.0)
    faulty = Run(rates(faults=[blind]))
    assert not faulty.failures
    assert faulty.messages["agent/infra_1/detections"] == played.messages["agent/infra_1/detections"]
    assert faulty.messages[f"{RADAR}/@tap/0"] == played.messages[RADAR]
    rows = {message.header.frame: len(message.body["score"]) for message in faulty.decoded(RADAR, "detections")}
    assert [rows[frame] for frame in (2, 3, 4, 5)] == [0] * 4
    assert min(rows[1], rows[6]) > 0
    with pytest.raises(ConfigurationError, match=r"no wire .*detections/radar"):
        rates(faults=[blind | dict(node=f"{RADAR}s")])


def test_an_adversary_attacks_each_sensor_by_itself_in_any_order_of_delivery() -> None:
    on_both = under_attack("agent/infra_1/detections", RADAR)
    attacked = Run(on_both)
    assert set(attacked.results["evaluator"]["tables"]["attacks"]["wire"]) == {"agent/infra_1/detections", RADAR}
    assert Run(on_both, shuffle=3).messages == attacked.messages


def test_a_map_without_wires_of_further_sensors_is_refused() -> None:
    old = maps.load(bundle.ROOT / "keyexpr_maps" / "testbed.toml")
    wires = [wire for wire in old["wire"] if "{sensor}" not in wire["key"]]
    with pytest.raises(WiringError, match=r"sensor 'radar'.*infra_1"):
        rates(keyexpr=dict(map={"wire": wires}, rewrites=[]))


# -- one agent, played by hand -----------------------------------------------------------------------------------------


def sensor(name: str, frames: str = "", **limits: float) -> dict[str, Any]:
    still = dict(mount_position=[0.0, 0.0, 0.0], mount_rotation=[1.0, 0.0, 0.0, 0.0])
    return dict(name=name, lidar=limits, frames=frames, **still)


def bench(resolved: Resolved, *sensors: dict[str, Any], agent: str = "infra_1", **more: Any) -> Bench:
    return Bench(resolved, agent, sensors=list(sensors), **more)


def measured(agent: Bench, frame: int, body: dict[str, np.ndarray], part: str = "", age_ns: int = 0) -> None:
    """Deliver a measurement of the first sensor, or of `part`."""
    subject = "infra_1" + (f"/{part}" if part else "")
    key = agent.key("detections", subject)
    agent.deliver(key, agent.message(key, body, frame, time_ns=frame * PERIOD_NS - age_ns))


def begin(agent: Bench, frame: int) -> None:
    agent.play(frame, pose=pose())


def tracks_of(agent: Bench) -> list[Message]:
    return agent.heard("agent/infra_1/tracks")


def oncoming(time_s: float) -> dict[str, np.ndarray]:
    return detections((10.0 + SPEED * time_s, 2.0))


def last_error_m(resolved: Resolved, **more: Any) -> float:
    """Distance of a track from where its car is at the time of the last frame; measured 50 ms before each frame."""
    agent = bench(resolved, sensor("lidar", "0" + "1" * 11), **more)
    begin(agent, 0)
    for frame in range(1, 12):
        begin(agent, frame)
        measured(agent, frame, oncoming(0.1 * frame - AGE_NS * 1e-9), age_ns=AGE_NS)
    (message,) = [message for message in tracks_of(agent) if message.header.frame == 11]
    return float(abs(message.body["position"][0, 0] - 10.0 - SPEED * 1.1))


def test_tracks_are_predicted_from_the_measurement_to_the_frame(resolved: Resolved) -> None:
    assert last_error_m(resolved) < 0.1
    assert last_error_m(resolved, measurement_times=False) == pytest.approx(SPEED * AGE_NS * 1e-9, abs=0.1)


def test_between_measurements_tracks_move_on_and_become_less_certain(resolved: Resolved) -> None:
    agent = bench(resolved, sensor("lidar", "10" * 8))
    for frame in range(16):
        begin(agent, frame)
        if frame % 2 == 0:
            measured(agent, frame, oncoming(0.1 * frame))
    messages = tracks_of(agent)
    assert [message.header.frame for message in messages] == list(range(16))
    *_, before, after = [message.body for message in messages]
    np.testing.assert_allclose(after["position"][0, 0] - before["position"][0, 0], SPEED * 0.1, atol=0.05)
    assert after["covariance"][0, 0, 0] > before["covariance"][0, 0, 0]


def test_an_object_outside_of_a_narrow_sensors_view_is_not_missed_by_it(resolved: Resolved) -> None:
    """It has as much evidence as without that sensor; in the sensor's view, it has less."""
    scores = {}
    for width_deg in (0.0, 20.0, 170.0):
        narrow = sensor("radar", azimuth_min_deg=-width_deg, azimuth_max_deg=width_deg or 1.0)
        agent = bench(resolved, sensor("lidar"), *([narrow] if width_deg else []))
        for frame in range(12):
            begin(agent, frame)
            measured(agent, frame, detections((0.5, 12.0)))
            if width_deg:
                measured(agent, frame, detections(), "radar")
        message = tracks_of(agent)[-1]
        scores[width_deg] = float(message.body["score"][0]) if len(message.body["score"]) else 0.0
    assert scores[0.0] == scores[20.0] > scores[170.0]


@pytest.mark.parametrize("age_ns", [-1, PERIOD_NS, 3 * PERIOD_NS], ids=["after the frame", "before it", "old"])
def test_a_measurement_at_an_impossible_time_costs_one_message(resolved: Resolved, age_ns: int) -> None:
    outcomes = []
    for damaged in (True, False):
        agent = bench(resolved, sensor("lidar"), sensor("radar"))
        for frame in range(10):
            begin(agent, frame)
            measured(agent, frame, oncoming(0.1 * frame))
            if frame != 6:
                measured(agent, frame, oncoming(0.1 * frame), "radar")
            elif damaged:
                measured(agent, frame, oncoming(0.1 * frame), "radar", age_ns)
                assert len(tracks_of(agent)) == frame + 1, "the other sensor's data do not wait"
        counted = Counter({kind: n for (_, kind), n in agent.host.rejected.items()})
        assert counted == ({"measured": 1} if damaged else {})
        outcomes.append(agent.payloads)
    assert outcomes[0] == outcomes[1], "as if that message had been lost"


def test_a_measurement_of_a_frame_that_has_not_begun_costs_one_message(resolved: Resolved) -> None:
    """Its time could not be judged yet, and would stop the tracker."""
    agent = bench(resolved, sensor("lidar"))
    for frame in range(8):
        begin(agent, frame)
        if frame == 3:
            key = agent.key("detections", "infra_1")
            agent.deliver(key, agent.message(key, oncoming(0.0), 4, time_ns=PERIOD_NS), step=3)
        measured(agent, frame, oncoming(0.1 * frame))
    assert [message.header.frame for message in tracks_of(agent)] == list(range(8))
    assert {kind: n for (_, kind), n in agent.host.rejected.items()} == {"early": 1}
    assert not agent.host.failures


def test_a_measurement_in_a_frame_without_one_is_refused_whenever_it_arrives(resolved: Resolved) -> None:
    agent = bench(resolved, sensor("lidar"), sensor("radar", "10" * 5))
    for frame in range(10):
        begin(agent, frame)
        if frame == 5:
            measured(agent, frame, oncoming(0.5), "radar")
        measured(agent, frame, oncoming(0.1 * frame))
        if frame % 2 == 0:
            measured(agent, frame, oncoming(0.1 * frame), "radar")
    assert [message.header.frame for message in tracks_of(agent)] == list(range(10))
    assert {kind: n for (_, kind), n in agent.host.rejected.items()} == {"unexpected": 1}


@pytest.mark.parametrize(
    ("change", "message"), [(dict(frames="102"), "frames: found '102'"), (dict(detection_probability=0.0), "between 0")]
)
def test_an_invalid_sensor_is_refused(resolved: Resolved, change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        bench(resolved, sensor("lidar") | change)
