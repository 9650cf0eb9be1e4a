"""The broker collates tracks of all agents without needless waiting."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_world import PERIOD_NS, Bench, tiny, tracks

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.errors import ConfigurationError

COLLATED = "cc/collated"
AGENTS = ("ego", "infra_1", "infra_2")
BOTH = AGENTS[:2]
STATUS = {"mobile": np.array([0]), "detections": np.array([0]), "tracks": np.array([0])}


@pytest.fixture(scope="module")
def resolved():
    return tiny()


def bench(resolved, **config: Any) -> Bench:
    return Bench(resolved, "broker", **config)


def send_track(broker: Bench, agent: str, frame: int, *, step: int | None = None, x: float = 0.0, **more: Any):
    """Send one track of an agent, at its own position."""
    place = (x, 10.0 * AGENTS.index(agent))
    return broker.send("tracks", tracks(place, **more), frame, subject=agent, step=step)


def play(broker: Bench, frame: int, agents: tuple[str, ...] = AGENTS, **more: Any):
    """A frame with tracks of some agents; returns what the broker publishes."""
    published = broker.clock(frame)
    for agent in agents:
        published += send_track(broker, agent, frame, **more)
    return published


def summary(messages: Any) -> list[tuple[int, dict[str, float]]]:
    """(frame, age in ms of each agent in the batch)."""
    batches = []
    for _, message in messages:
        ages = message.body["age_ns"] * 1e-6
        batches.append((message.header.frame, dict(zip(message.body["agents"], ages.tolist(), strict=True))))
    return batches


def test_a_batch_is_emitted_when_all_agents_have_sent_their_tracks(resolved) -> None:
    broker = bench(resolved)
    assert broker.clock(0) == []
    assert send_track(broker, "infra_2", 0) == []
    assert send_track(broker, "ego", 0) == []
    ((key, message),) = send_track(broker, "infra_1", 0)
    assert key == COLLATED
    assert message.body["agents"].tolist() == sorted(AGENTS)
    assert message.body["agent"].tolist() == [0, 1, 2]
    np.testing.assert_array_equal(message.body["position"][:, 1], [0.0, 10.0, 20.0])
    assert message.body["age_ns"].tolist() == [0, 0, 0]


def test_collated_tracks_are_in_the_world_frame(resolved) -> None:
    broker = bench(resolved)
    play(broker, 0, BOTH)
    turned = {"origin": np.array([100.0, 0.0, 0.0]), "rotation": quaternion_from_rotation(rotation_from_yaw(np.pi / 2))}
    body = tracks((10.0, 0.0), velocity=(5.0, 0.0)) | turned
    ((_, message),) = broker.send("tracks", body, 0, subject="infra_2")
    np.testing.assert_allclose(message.body["position"][2], [100.0, 10.0, 0.8], atol=1e-9)
    np.testing.assert_allclose(message.body["velocity"][2], [0.0, 5.0, 0.0], atol=1e-9)
    assert message.body["yaw"][2] == pytest.approx(np.pi / 2)


def test_the_broker_waits_for_a_silent_agent_until_the_next_clock(resolved) -> None:
    broker = bench(resolved)
    play(broker, 0, BOTH)
    assert summary(broker.clock(1)) == [(0, {"ego": 0.0, "infra_1": 0.0})]
    assert send_track(broker, "infra_2", 0, step=1) == [], "too late"
    results = broker.host.finish()["collation"]
    assert (results["complete"], results["overdue"], results["late"]) == (0, 1, {"infra_2": 1})


@pytest.mark.parametrize("leaves", [False, True])
def test_the_last_tracks_of_a_silent_or_dead_agent_are_propagated_until_too_old(resolved, leaves: bool) -> None:
    broker = bench(resolved, max_age_s=0.25)
    play(broker, 0, velocity=(10.0, 0.0))
    if leaves:
        broker.send("status", STATUS, 0, subject="infra_2")  # which does not bring it back
        broker.left("infra_2", "agent")
    for frame in range(1, 6):
        play(broker, frame, BOTH)
    batches = [message for message in broker.heard(COLLATED) if 0 < message.header.frame < 5]
    ages = [ages_by_agent.get("infra_2") for _, ages_by_agent in summary((COLLATED, batch) for batch in batches)]
    assert ages == [100.0, 200.0, None, None]
    carried = [message.body["position"][message.body["agent"] == 2, 0] for message in batches[:2]]
    np.testing.assert_allclose(carried, [[1.0], [2.0]], err_msg="moved at 10 m/s")
    spread = [message.body["covariance"][-1, 0, 0] for message in batches[:2]]
    assert 0.1 < spread[0] < spread[1], "and less certain"
    assert broker.host.finish()["collation"]["overdue"] == (0 if leaves else 4)


def test_late_tracks_are_in_the_next_batch_predicted_and_less_certain(resolved) -> None:
    broker = bench(resolved)
    for frame in range(4):
        play(broker, frame, BOTH)
        if frame >= 2:
            send_track(broker, "infra_2", frame - 2, step=frame, velocity=(10.0, 0.0))
    broker.clock(4)
    batches = {message.header.frame: message.body for message in broker.heard(COLLATED)}
    assert [batches[frame]["age_ns"].tolist() for frame in (1, 2, 3)] == [[0, 0], [0, 0, 2 * 10**8], [0, 0, 2 * 10**8]]
    late = batches[3]["agent"] == 2
    assert batches[3]["position"][late, 0] == pytest.approx(2.0), "0.2 s at 10 m/s"
    punctual = batches[3]["covariance"][0]
    assert (np.diag(batches[3]["covariance"][late][0]) > np.diag(punctual)).all()
    assert broker.host.finish()["collation"]["late"] == {"infra_2": 2}


def test_the_broker_does_not_wait_for_an_agent_that_has_left_until_it_returns(resolved) -> None:
    broker = bench(resolved)
    play(broker, 0, BOTH)
    assert summary(broker.left("infra_2", "agent")) == [(0, {"ego": 0.0, "infra_1": 0.0})]
    assert summary(play(broker, 1, BOTH)) == [(1, {"ego": 0.0, "infra_1": 0.0})]
    broker.host.joined("infra_2", "agent")
    assert play(broker, 2, BOTH) == []
    published = broker.send("tracks", tracks(), 2, subject="infra_2")
    assert summary(published) == [(2, dict.fromkeys(sorted(AGENTS), 0.0))], "an empty message counts"


def test_an_unannounced_agent_is_expected_from_the_frame_after_its_first_status(resolved) -> None:
    broker = bench(resolved)
    broker.node.agents.discard("infra_2")  # not yet visible on the mesh
    for frame in (0, 1):
        broker.clock(frame)
        send_track(broker, "ego", frame)
        if frame == 0:
            broker.send("status", STATUS, frame, subject="infra_2")
        published = send_track(broker, "infra_1", frame)
        assert len(published) == (1 if frame == 0 else 0)
    assert summary(send_track(broker, "infra_2", 1)) == [(1, dict.fromkeys(AGENTS, 0.0))]


def test_the_tracks_of_a_new_agent_count_from_the_frame_after_its_first_ones(resolved) -> None:
    for newcomer_first in (True, False):
        broker = bench(resolved)
        broker.node.agents.discard("infra_2")
        published = []
        for frame in (0, 1):
            published += play(broker, frame, ("infra_2", *BOTH) if newcomer_first else AGENTS)
        assert summary(published) == [(0, dict.fromkeys(("ego", "infra_1"), 0.0)), (1, dict.fromkeys(AGENTS, 0.0))]


def test_with_latency_the_batch_is_of_the_earlier_time(resolved) -> None:
    broker = bench(resolved, latency_s=0.2)
    published = [summary(play(broker, frame, x=float(frame))) for frame in range(5)]
    whole = dict.fromkeys(sorted(AGENTS), 0.0)
    assert published == [[], [], [(0, whole)], [(1, whole)], [(2, whole)]]
    batch = broker.heard(COLLATED)[-1]
    assert batch.header.time_ns == 2 * PERIOD_NS
    np.testing.assert_array_equal(batch.body["position"][:, 0], [2.0, 2.0, 2.0])


@pytest.mark.parametrize(("config", "clocks"), [(dict(latency_s=0.1), 1), (dict(patience=2), 2)])
def test_latency_and_patience_wait_for_more_clocks(resolved, config: dict[str, Any], clocks: int) -> None:
    for arrives in (True, False):
        broker = bench(resolved, **config)
        play(broker, 0, BOTH)
        for frame in range(1, clocks + 1):
            assert broker.clock(frame) == []
        if arrives:
            assert summary(send_track(broker, "infra_2", 0, step=clocks)) == [(0, dict.fromkeys(AGENTS, 0.0))]
        else:
            assert summary(broker.clock(clocks + 1)) == [(0, {"ego": 0.0, "infra_1": 0.0})]


def test_frames_are_emitted_in_order_even_if_a_later_one_is_complete_first(resolved) -> None:
    broker = bench(resolved, patience=3)
    for frame in (0, 1):
        play(broker, frame, BOTH)
    assert send_track(broker, "infra_2", 1) == [], "frame 0 still waits"
    assert [frame for frame, _ in summary(send_track(broker, "infra_2", 0, step=1))] == [0, 1]


def test_overflowing_and_late_messages_are_counted(resolved) -> None:
    broker = bench(resolved, latency_s=0.5, capacity=2)
    for frame in range(4):
        play(broker, frame, ("ego",))
    assert broker.host.finish()["collation"] == {"complete": 0, "overdue": 0, "late": {}, "overflowed": 2, "absurd": 0}


@pytest.mark.parametrize("column", ["position", "velocity", "size", "covariance", "origin"])
def test_an_implausible_track_is_rejected_without_affecting_the_batch(resolved, column: str) -> None:
    broker = bench(resolved, max_age_s=1.0)
    for frame in range(4):
        play(broker, frame, ("ego",))
        if frame < 2:
            body = tracks((1.0, 0.0), (2.0, 0.0), (3.0, 0.0))
            body[column] = body[column].copy()
            body[column][0] = 9.9e8
            broker.send("tracks", body, frame, subject="infra_1")
        send_track(broker, "infra_2", frame)
    broker.clock(4)
    batches = broker.heard(COLLATED)
    assert [message.header.frame for message in batches] == [0, 1, 2, 3], "each is a valid message"
    kept = 0 if column == "origin" else 2
    assert [np.count_nonzero(message.body["agent"] == 1) for message in batches] == [kept] * 4
    assert broker.host.finish()["collation"]["absurd"] == 2 * (3 - kept)


def say_at(broker: Bench, agent: str, frame: int, offset_s: float, **more: Any):
    """Send tracks of an agent with a wrong clock."""
    key = broker.key("tracks", agent)
    time_ns = frame * PERIOD_NS + round(offset_s * 1e9)
    return broker.deliver(key, broker.message(key, tracks((0.0, 0.0), **more), frame, time_ns=time_ns))


@pytest.mark.parametrize("offset_s", [-0.2, -0.03, 0.03, 0.2])
def test_an_agent_with_a_wrong_clock_completes_its_batch_at_the_time_it_reports(resolved, offset_s: float) -> None:
    broker = bench(resolved, max_age_s=0.25)
    for frame in range(4, 8):
        play(broker, frame, BOTH)
        ((_, batch),) = say_at(broker, "infra_2", frame, offset_s, velocity=(10.0, 0.0))
        assert batch.header.frame == frame
        assert batch.body["age_ns"].tolist() == [0, 0, round(-offset_s * 1e9)]
        assert batch.body["position"][2, 0] == pytest.approx(-10.0 * offset_s), "brought to the batch's time"
        assert (np.linalg.eigvalsh(batch.body["covariance"][2]) > 0.0).all()
    assert broker.host.finish()["collation"]["complete"] == 4


@pytest.mark.parametrize("offset_s", [-0.3, 0.3, 1e6])
def test_a_clock_error_beyond_max_age_excludes_only_that_agent(resolved, offset_s: float) -> None:
    broker = bench(resolved, max_age_s=0.25)
    for frame in range(4, 7):
        play(broker, frame, BOTH)
        assert summary(say_at(broker, "infra_2", frame, offset_s)) == [(frame, {"ego": 0.0, "infra_1": 0.0})]
    assert summary(play(broker, 7)) == [(7, dict.fromkeys(AGENTS, 0.0))], "a corrected clock is accepted again"


@given(st.data())
def test_every_delivery_order_gives_the_same_batches(resolved, data: st.DataObject) -> None:
    """Random order, loss and lateness within frames, delivered as on a mesh."""
    configs = [{}, {"latency_s": 0.1}, {"latency_s": 0.2, "patience": 1}, {"patience": 1}, {"max_age_s": 0.1}]
    config = data.draw(st.sampled_from(configs))
    fates = st.sampled_from(["in time", "in time", "in time", "late", "lost"])
    fate = {(agent, frame): data.draw(fates) for frame in range(5) for agent in AGENTS}
    presents_itself = data.draw(st.integers(0, 4))

    def play(shuffle: Any) -> list[bytes]:
        broker = bench(resolved, **config)
        broker.node.agents.discard("infra_2")
        for frame in range(5):
            broker.clock(frame)
            due = [(agent, frame) for agent in AGENTS if fate[agent, frame] == "in time"]
            if presents_itself == frame:
                due.append(("status", frame))
            queues: dict[str, list] = {}
            for agent in AGENTS:  # the order on one key is kept
                queues[agent] = [(agent, frame - 1)] if frame and fate[agent, frame - 1] == "late" else []
            for agent, about in due:
                queues.setdefault(agent, []).append((agent, about))
            order = shuffle([name for name, queue in queues.items() for _ in queue])
            for name in order:
                agent, about = queues[name].pop(0)
                if agent == "status":
                    broker.send("status", STATUS, about, subject="infra_2")
                else:
                    send_track(broker, agent, about, step=frame, x=float(about), velocity=(about, 0.0))
        assert not broker.host.failures
        agents = [message.body["agents"].tolist() for message in broker.heard(COLLATED)]
        assert agents == [sorted(each) for each in agents]
        return broker.payloads

    assert play(lambda order: data.draw(st.permutations(order))) == play(list)


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ({"latency_s": -0.1}, "broker: Broker: latency_s"),
        ({"patience": -1}, r"patience.*-1.*0"),
        ({"capacity": 0}, r"capacity.*0.*1"),
        ({"max_age_s": -1.0}, r"max_age_s.*-1.0.*0"),
    ],
)
def test_invalid_parameters_are_refused(resolved, config: dict, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        bench(resolved, **config)
