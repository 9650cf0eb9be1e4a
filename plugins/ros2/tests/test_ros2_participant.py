"""A node of ROS 2 publishes, receives, keeps what comes late, and refuses what is no message, with the reason."""

import queue
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from mast_ros2 import participant as ros2_participant
from mast_ros2 import type_store
from mast_ros2.attachments import MessageAttachment
from mast_ros2.liveliness_tokens import DataKey, EndpointToken, NodeToken, Qos
from mast_ros2.mesh import Connection
from mast_ros2.participant import Participant
from mast_ros2.spatial import clock

from mast_zenoh.errors import ConfigurationError, NotRunning
from mast_zenoh.mesh.session import open_client
from tests.support.launched import eventually

DEADLINE_S = 20.0
ONE_MESSAGE = Qos(transient_local=True, depth=1)
USUAL = Qos()


@pytest.fixture
def peer(router: str) -> Iterator[zenoh.Session]:
    """A session of something else, which may send anything."""
    session = open_client(router)
    yield session
    session.close()


def received(
    participant: Participant, topic: str, qos: Qos = USUAL
) -> queue.SimpleQueue[tuple[Any, MessageAttachment]]:
    """What a participant receives on a topic with clocks, as it comes."""
    arrived: queue.SimpleQueue[tuple[Any, MessageAttachment]] = queue.SimpleQueue()
    participant.subscribe(topic, type_store.CLOCK, lambda *message: arrived.put(message), qos)
    return arrived


def known(participant: Participant, topic: str) -> list[EndpointToken]:
    eventually(lambda: participant.publishers_of(topic), f"a publisher of {topic}", DEADLINE_S)
    return participant.publishers_of(topic)


def test_messages_arrive_in_order_numbered_from_1_with_the_id_of_their_publisher(router: str) -> None:
    with Participant(Connection(router), "talker") as talker, Participant(Connection(router), "listener") as listener:
        arrived = received(listener, "/clock")
        publisher = talker.publisher("/clock", type_store.CLOCK)
        eventually(lambda: publisher.is_wanted, "the subscription", DEADLINE_S)
        for second in range(100):
            publisher.publish(clock(second * 10**9))
        messages = [arrived.get(timeout=DEADLINE_S) for _ in range(100)]
    assert [message.clock.sec for message, _ in messages] == list(range(100))
    assert [attachment.sequence for _, attachment in messages] == list(range(1, 101))
    assert len({attachment.gid for _, attachment in messages}) == 1
    assert publisher.sent == 100


def test_one_who_comes_late_gets_what_was_kept(router: str) -> None:
    with Participant(Connection(router), "early") as early:
        publisher = early.publisher("/kept", type_store.CLOCK, ONE_MESSAGE)
        publisher.publish(clock(1_000_000_000))
        publisher.publish(clock(2_000_000_000))
        with Participant(Connection(router), "late") as late:
            message, _ = received(late, "/kept", ONE_MESSAGE).get(timeout=DEADLINE_S)
    assert message.clock.sec == 2


def test_nodes_and_their_topics_are_known_until_they_leave(router: str) -> None:
    with Participant(Connection(router, domain=3), "watcher") as watcher:
        with Participant(Connection(router, domain=3), "guest", "/fleet") as guest:
            guest.publisher("/fleet/clock", type_store.CLOCK)
            (token,) = known(watcher, "/fleet/clock")
            assert (token.node.name, token.node.namespace, token.type_name) == ("guest", "/fleet", type_store.CLOCK)
        eventually(lambda: not watcher.publishers_of("/fleet/clock"), "the end of the guest", DEADLINE_S)
        assert [token.name for token in watcher.graph() if isinstance(token, NodeToken)] == ["watcher"]


def test_other_domains_are_neither_heard_nor_seen(router: str) -> None:
    with Participant(Connection(router, domain=4), "here") as here, Participant(Connection(router, domain=5)) as there:
        arrived = received(here, "/clock")
        elsewhere = there.publisher("/clock", type_store.CLOCK)
        own = here.publisher("/clock", type_store.CLOCK)
        elsewhere.publish(clock(1))
        own.publish(clock(2))
        message, _ = arrived.get(timeout=DEADLINE_S)
        assert message.clock.nanosec == 2
        assert not here.publishers_of("/clock")


def test_a_peer_with_another_definition_or_type_is_told_of(router: str, peer: zenoh.Session) -> None:
    with Participant(Connection(router)) as participant:
        received(participant, "/clock")
        node = NodeToken(0, "abc", 0, "stranger")
        tokens = [
            EndpointToken(node, 1, "publisher", "/clock", type_store.CLOCK, "RIHS01_" + "0" * 64),
            EndpointToken(node, 2, "publisher", "/clock", type_store.ODOMETRY, None),
        ]
        alive = [peer.liveliness().declare_token(token.write()) for token in tokens]
        eventually(lambda: len(participant.warnings) == 2, "two warnings", DEADLINE_S)
        assert len(alive) == 2
    first, second = sorted(participant.warnings)
    assert first.startswith("/clock: the publisher of /stranger has another definition of rosgraph_msgs/msg/Clock")
    assert second.startswith("/clock: the publisher of /stranger has nav_msgs/msg/Odometry, expected rosgraph_msgs")


CLOCK_KEY = DataKey.of(0, "/clock", type_store.CLOCK).write()
SOUND = MessageAttachment(1, 0, bytes(16)).write()


@pytest.mark.parametrize(
    ("payload", "attachment", "reason"),
    [
        (type_store.encode(clock(1)), None, "attachment"),
        (type_store.encode(clock(1)), b"\x0fsequence_number" + bytes(40), "attachment with text labels"),
        (type_store.encode(clock(1)), b"short", "attachment of N bytes"),
        (b"", SOUND, type_store.CLOCK),
        (type_store.encode(clock(1))[:-1], SOUND, type_store.CLOCK),
        (bytes(ros2_participant.MOST_BYTES + 1), SOUND, "size"),
    ],
    ids=["no attachment", "an older rmw_zenoh", "short attachment", "empty", "truncated", "too large"],
)
def test_what_is_no_message_of_rmw_zenoh_is_counted_and_the_next_one_arrives(
    router: str, peer: zenoh.Session, payload: bytes, attachment: bytes | None, reason: str
) -> None:
    with Participant(Connection(router)) as participant:
        arrived = received(participant, "/clock")
        publisher = peer.declare_publisher(CLOCK_KEY, congestion_control=zenoh.CongestionControl.BLOCK)
        eventually(lambda: publisher.matching_status.matching, "the subscription", DEADLINE_S)  # type: ignore[attr-defined]
        publisher.put(payload, attachment=attachment)
        publisher.put(type_store.encode(clock(7)), attachment=SOUND)
        message, _ = arrived.get(timeout=DEADLINE_S)
    assert message.clock.nanosec == 7
    assert participant.refused == {reason: 1}


def test_tokens_that_are_none_are_counted_and_their_number_is_limited(router, peer, monkeypatch) -> None:
    monkeypatch.setattr(ros2_participant, "MOST_TOKENS", 10)
    with Participant(Connection(router, domain=6)) as participant:
        liveliness = peer.liveliness()
        tokens = [liveliness.declare_token(NodeToken(6, "abc", n, f"node_{n}").write()) for n in range(20)]
        tokens.append(liveliness.declare_token("@ros2_lv/6/abc/nonsense"))
        eventually(lambda: participant.refused["token beyond N"] >= 10, "the refused tokens", DEADLINE_S)
        assert len(participant.graph()) == 10


def test_a_flood_of_tokens_hides_no_publisher_of_own_topics(router, peer, monkeypatch) -> None:
    monkeypatch.setattr(ros2_participant, "MOST_TOKENS", 10)
    monkeypatch.setattr(ros2_participant, "MOST_TOKENS_OF_TOPIC", 3)

    def publisher(topic: str, number: int) -> str:
        node = NodeToken(7, "abc", 0, "stranger")
        return EndpointToken(node, number, "publisher", topic, type_store.CLOCK, None).write()

    with Participant(Connection(router, domain=7)) as participant:
        received(participant, "/early")
        flood = [peer.liveliness().declare_token(NodeToken(7, "abc", n, f"node_{n}").write()) for n in range(20)]
        honest = [peer.liveliness().declare_token(publisher(topic, 1)) for topic in ("/early", "/late")]
        eventually(lambda: participant.is_published("/early"), "the publisher", DEADLINE_S)
        assert not participant.is_published("/late"), "no own topic yet, and no room"
        received(participant, "/late")
        assert participant.is_published("/late")
        refused = participant.refused["token beyond N"]
        many = [peer.liveliness().declare_token(publisher("/early", n)) for n in range(2, 12)]
        eventually(lambda: participant.refused["token beyond N"] >= refused + 8, "the rest", DEADLINE_S)
        assert len(participant.publishers_of("/early")) == 3
        for token in (*honest, *many):
            token.undeclare()
        eventually(lambda: not participant.is_published("/early"), "the end of the publishers", DEADLINE_S)
        assert len(flood) == 20


def test_a_router_that_is_not_there_is_an_error_with_the_reason(router: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2_participant, "_SETTINGS", ros2_participant._SETTINGS | {"connect/timeout_ms": 300})
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
        with pytest.raises(NotRunning, match=r"nothing answers there \(Connection refused\), expected a router"):
            Participant(Connection(f"tcp/127.0.0.1:{port}"))
        silent.listen()
        with pytest.raises(NotRunning, match="something listens there, but answers as no router"):
            Participant(Connection(f"tcp/127.0.0.1:{port}"))


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        (7, r"here: found 7, expected a dict of router, domain, tls"),
        ({"routr": "tcp/x:1"}, r"here: 'routr': unknown key.*router"),
        ({"router": "localhost:7447"}, r"here.router: found 'localhost:7447', expected a form such as"),
        ({"domain": "0"}, r"here.domain: found '0', expected a whole number"),
        ({"domain": -1}, r"here.domain -1: expected 0 to"),
        ({"router": "tls/host:7447"}, r"here.router: found 'tls/host:7447', expected certificates"),
        ({"router": "tls/host:7447", "tls": {"ca": "missing.pem"}}, "here.tls.ca: found 'missing.pem', expected a"),
        ({"router": "tls/host:7447", "tls": {}}, r"here.tls: found no `ca`"),
    ],
)
def test_a_wrong_connection_is_refused_by_name(config: Any, problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        Connection.of(config, "here")


def test_certificates_need_a_router_with_tls(tmp_path: Path) -> None:
    ca = tmp_path / "ca.pem"
    ca.write_text("")
    with pytest.raises(ConfigurationError, match="expected tls/HOST:PORT, because there is `tls`"):
        Connection.of({"tls": {"ca": str(ca)}}, "here")
    with pytest.raises(ConfigurationError, match="expected both or neither"):
        Connection.of({"router": "tls/host:7447", "tls": {"ca": ca, "key": ca}}, "here")
    assert Connection.of({"router": "tls/host:7447", "tls": {"ca": ca}}, "here").tls is not None
