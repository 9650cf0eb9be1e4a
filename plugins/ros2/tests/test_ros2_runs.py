"""Nodes of ROS 2 in a process of their own take part in runs of one process."""

import queue
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh
from mast_ros2 import participant as ros2_participant
from mast_ros2.attachments import MessageAttachment
from mast_ros2.liveliness_tokens import DataKey
from mast_ros2.mesh import Connection
from mast_ros2.participant import Participant, joined
from mast_ros2.spatial import clock
from mast_ros2.type_store import CLOCK, TF_MESSAGE, encode
from ros2_process import AGENT, Ros2Process
from ros2_worlds import with_ros2
from tiny_world import Run

from mast_zenoh.errors import NotRunning
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.outside_link import OutsideLink
from mast_zenoh.mesh.session import open_client, open_router
from mast_zenoh.outside import OutsideTopic, OutsideTopics
from tests.support.launched import eventually

DEADLINE_S = 30.0


def test_a_node_of_ros_drives_an_agent_whose_tracks_reach_the_picture(router: str) -> None:
    with Ros2Process("tracks", router, *AGENT):
        first, second = (Run(with_ros2("agent", router)) for _ in range(2))
    outside = first.results["infra_1"]["outside"]
    assert (outside["asked"], outside["answered"], outside["refused"]) == (12, 12, {})
    tracks = first.decoded("agent/infra_1/tracks", "tracks")
    assert [message.header.frame for message in tracks] == list(range(12))
    assert all(set(message.body["id"].tolist()) == {1, 2, 3, 4} for message in tracks), "ids of the node of ROS"
    picture = first.decoded("cc/picture", "picture")[-1].body
    assert picture["support"].max() == 3, "its tracks are fused with those of the other two"
    assert first.messages == second.messages, "the same program gives the same run"


@pytest.mark.parametrize("place", ["agent", "center"])
def test_a_run_goes_on_without_a_node_of_ros_and_says_so(router: str, place: str, tmp_path: Path) -> None:
    ended = launcher.run(with_ros2(place, router, start_s=0.0), tmp_path / "run", runtime="inproc")
    assert ended.error is None
    (counts,) = ended.record["outside"].values()
    assert (counts["asked"], counts["unanswered"]) == (12, 12)
    (notice,) = (each for each in ended.record["notices"] if each["kind"] == "outside")
    assert notice["value"] == 12
    assert "on which the results depend: 12 of 12 messages had no answer in time" in notice["text"]
    assert "from frame 0 on: no node of ROS 2 is in domain 0" in notice["text"]


def test_without_a_router_the_run_ends_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2_participant, "_SETTINGS", ros2_participant._SETTINGS | {"connect/timeout_ms": 200})
    with pytest.raises(NotRunning, match="expected a router of rmw_zenoh"):
        Run(with_ros2("agent", "tcp/127.0.0.1:1"))


# -- the link ----------------------------------------------------------------------------------------------------------


def link_to(router: str, depth: int = 8) -> OutsideLink:
    """A link that receives clocks on /ticks."""
    topic = OutsideTopic("/ticks", CLOCK, depth=depth, most_bytes=1000)
    return OutsideLink("node", OutsideTopics(partial(joined, Connection(router)), (topic,)), waits=True)


@pytest.fixture
def ticker(router: str) -> Iterator[zenoh.Publisher]:
    """Publishes on /ticks, without a token."""
    session = open_client(router)
    key = DataKey.of(0, "/ticks", CLOCK).write()
    yield session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    session.close()


def tick(ticker: zenoh.Publisher, second: int, gid: bytes = bytes(16)) -> None:
    ticker.put(encode(clock(second * 10**9)), attachment=MessageAttachment(1, 0, gid).write())


def in_thread(call: Any) -> queue.SimpleQueue[Any]:
    """The result of a call in a thread of its own."""
    result: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=lambda: result.put(call()), daemon=True).start()
    return result


@pytest.mark.parametrize("ending", ["stop", "router"])
def test_a_wait_ends_with_the_run_and_with_the_router(ending: str) -> None:
    session, endpoint = open_router()
    link, other = link_to(endpoint), link_to(endpoint)
    other.announce("/ticks", CLOCK)
    eventually(lambda: link.present("/ticks"), "a publisher", DEADLINE_S)
    result = in_thread(lambda: link.wait(1e6, lambda: False, ["/ticks"]))
    if ending == "stop":
        link.end()
    else:
        session.close()
    assert result.get(timeout=DEADLINE_S) is False
    for each in (link, other):
        each.close()
    if ending == "stop":
        session.close()


def test_a_link_knows_why_nothing_arrives() -> None:
    session, endpoint = open_router()
    link, known = link_to(endpoint), []

    def says(reason: str) -> None:
        eventually(lambda: link.absence("/ticks") == reason, reason, DEADLINE_S)

    says("no node of ROS 2 is in domain 0")
    with Participant(Connection(endpoint, domain=3), "far"):
        says("no node of ROS 2 is in domain 0, but in 3")
    with Participant(Connection(endpoint), "tracker") as tracker:
        says("nobody publishes it; in domain 0 there are the nodes /tracker")
        known.append(tracker.publisher("/tocks", CLOCK))
        says(f"nobody publishes it; {CLOCK} is published on /tocks")
        known.append(tracker.publisher("/ticks", TF_MESSAGE))
        says(f"/tracker publishes it with {TF_MESSAGE}, expected {CLOCK}")
        known.append(tracker.publisher("/ticks", CLOCK))
        says("")
    session.close()
    says(f"the link to the router {endpoint} has ended")
    link.close()


def test_the_newest_messages_of_a_flood_are_kept_and_the_others_counted(router: str, ticker: zenoh.Publisher) -> None:
    link = link_to(router)
    eventually(lambda: ticker.matching_status.matching, "the subscription", DEADLINE_S)  # type: ignore[attr-defined]
    for second in range(100):
        tick(ticker, second)
    eventually(lambda: link.refused.get("overtaken") == 92, "the end of the flood", DEADLINE_S)
    assert [arrival.message.clock.sec for arrival in link.take()] == list(range(92, 100))
    ticker.put(bytes(2000), attachment=MessageAttachment(1, 0, bytes(16)).write())
    eventually(lambda: link.refused.get("size") == 1, "a refusal", DEADLINE_S)
    link.close()


def test_a_flood_of_one_publisher_does_not_displace_another(router: str, ticker: zenoh.Publisher) -> None:
    link = link_to(router)
    eventually(lambda: ticker.matching_status.matching, "the subscription", DEADLINE_S)  # type: ignore[attr-defined]
    tick(ticker, 1000, b"honest".ljust(16))
    for second in range(100):
        tick(ticker, second)
    eventually(lambda: link.refused.get("overtaken") == 93, "the end of the flood", DEADLINE_S)
    assert [arrival.message.clock.sec for arrival in link.take()] == [1000, *range(93, 100)]
    link.close()


def test_a_message_proves_that_its_publisher_is_there(router: str, ticker: zenoh.Publisher) -> None:
    link = link_to(router)
    eventually(lambda: ticker.matching_status.matching, "the subscription", DEADLINE_S)  # type: ignore[attr-defined]
    assert not link.present("/ticks"), "it has no token"
    tick(ticker, 1)
    eventually(lambda: link.present("/ticks"), "the message", DEADLINE_S)
    link.close()


def test_what_a_node_publishes_itself_does_not_come_back(router: str, ticker: zenoh.Publisher) -> None:
    link = link_to(router)
    eventually(lambda: ticker.matching_status.matching, "the subscription", DEADLINE_S)  # type: ignore[attr-defined]
    link.announce("/ticks", CLOCK)
    link.send("/ticks", clock(1))
    tick(ticker, 2)
    arrivals: list[Any] = []

    def arrived() -> bool:
        arrivals.extend(link.take())
        return any(arrival.message.clock.sec == 2 for arrival in arrivals)

    assert link.wait(DEADLINE_S, arrived)
    assert [arrival.message.clock.sec for arrival in arrivals] == [2]
    link.close()


@pytest.mark.heavy
def test_a_flood_on_the_topics_of_a_run_costs_the_flooder_alone(router: str) -> None:
    flooded = (*AGENT[2:], "/tf", TF_MESSAGE, "/tf_static", TF_MESSAGE)
    with Ros2Process("tracks", router, *AGENT), Ros2Process("0", router, *flooded, file="ros2_flood.py"):
        run = Run(with_ros2("agent", router, wait_s=5.0))
    outside = run.results["infra_1"]["outside"]
    assert run.failures == {}
    assert outside["answered"] > 0
    assert {"attachment", "duplicate"} <= outside["refused"].keys()
    assert len(outside["refused"]) < 100
    frames = [message.header.frame for message in run.decoded("agent/infra_1/tracks", "tracks")]
    assert len(set(frames)) == len(frames), "at most one message a frame"
