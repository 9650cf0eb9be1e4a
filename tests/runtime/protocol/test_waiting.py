"""When a node of a lock-step run reports its counts, before it waits for messages."""

from typing import Any

import pytest
from hosted import Hosted

from mast_zenoh.mesh.control.flow import Epoch
from mast_zenoh.mesh.protocol.events import EpochEvent, HandedInEvent, MatchedEvent, StopEvent
from mast_zenoh.mesh.protocol.node import HAND_IN_TIMEOUT_S, MATCH_TIMEOUT_S, State
from mast_zenoh.mesh.protocol.pacer import SETTLE_EVERY
from mast_zenoh.node import Node
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring


class Listener(Node):
    """A node that publishes nothing."""

    inputs = {"clock": "clock"}

    def on_clock(self, received: Any, context: Any) -> None:
        """Do nothing."""


class Agent(Listener):
    """A node that publishes its status."""

    outputs = {"status": "status"}


def wire(key: str, message: str, publisher: str, subscriber: str) -> Wire:
    return Wire(key, "", message, (Leg(key, Endpoint(publisher, message), (Endpoint(subscriber, message),)),))


CLOCK = wire("clock", "clock", "sim", "node")
MEMBERS = {"sim": "simulator", "node": "agent", "broker": "broker"}
FIRST = EpochEvent(Epoch(1, MEMBERS, None))
LISTENING = Wiring((CLOCK,))
PUBLISHING = Wiring((CLOCK, wire("status", "status", "node", "broker")))


@pytest.mark.parametrize(
    ("node", "wiring", "frame", "reports"),
    [(Listener(), LISTENING, 3, 0), (Listener(), LISTENING, SETTLE_EVERY - 1, 1), (Agent(), PUBLISHING, 3, 1)],
    ids=["only listens", "only listens, the driver waits for it", "publishes"],
)
def test_a_node_that_only_listens_reports_while_messages_come_only_when_the_driver_waits_for_it(
    node: Node, wiring: Wiring, frame: int, reports: int
) -> None:
    hosted = Hosted("node", node, wiring)
    hosted.protocol.handle(FIRST)
    hosted.protocol.host.frame = frame
    hosted.protocol.idle()
    assert len(hosted.controls("counts/node")) == reports
    assert hosted.protocol.dozes == (reports == 0)


def test_a_node_that_only_listens_reports_when_nothing_comes_any_more() -> None:
    hosted = Hosted("node", Listener(), LISTENING)
    hosted.protocol.handle(FIRST)
    hosted.protocol.host.frame = 3
    hosted.wait()
    assert hosted.protocol.idle() is None
    assert len(hosted.controls("counts/node")) == 1


def test_a_node_whose_publishers_have_no_subscriber_yet_does_not_report() -> None:
    hosted = Hosted("node", Agent(), PUBLISHING)
    hosted.actions.unmatched.return_value = {"status"}
    hosted.protocol.handle(FIRST)
    assert hosted.protocol.idle() == MATCH_TIMEOUT_S
    assert (hosted.protocol.state, hosted.controls("counts/node")) == (State.MATCHING, [])
    hosted.protocol.handle(MatchedEvent("status"))
    hosted.protocol.idle()
    assert (hosted.protocol.state, len(hosted.controls("counts/node"))) == (State.RUNNING, 1)


def test_a_node_whose_subscriber_does_not_come_continues_without_it(caplog: pytest.LogCaptureFixture) -> None:
    hosted = Hosted("node", Agent(), PUBLISHING)
    hosted.actions.unmatched.return_value = {"status"}
    hosted.protocol.handle(FIRST)
    assert hosted.wait() == MATCH_TIMEOUT_S
    hosted.protocol.idle()
    assert (hosted.protocol.state, len(hosted.controls("counts/node"))) == (State.RUNNING, 1)
    assert "subscriber for status" in caplog.text


def test_a_node_offers_its_results_again_as_long_as_the_launcher_does_not_answer() -> None:
    hosted = Hosted("node", Agent(), PUBLISHING)
    hosted.protocol.handle(StopEvent("end"))
    assert hosted.protocol.state is State.HANDING_IN
    assert hosted.protocol.idle() == HAND_IN_TIMEOUT_S, "the first offer is not answered yet"
    hosted.protocol.handle(HandedInEvent(None))
    hosted.now_ns += 10**8
    hosted.protocol.handle(StopEvent("end"))
    assert hosted.actions.hand_in.call_count == 2, "also if the launcher asks it to stop again and again"
    hosted.protocol.handle(HandedInEvent(""))
    assert hosted.protocol.ended


def test_a_node_ends_without_a_launcher(caplog: pytest.LogCaptureFixture) -> None:
    hosted = Hosted("node", Agent(), PUBLISHING)
    hosted.protocol.handle(StopEvent("end"))
    while not hosted.protocol.ended:
        hosted.protocol.handle(HandedInEvent(None))
        hosted.wait()
    assert hosted.now_ns == pytest.approx(HAND_IN_TIMEOUT_S * 1e9, rel=0.1)
    assert "acknowledged the results" in caplog.text
