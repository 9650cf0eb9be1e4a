"""Latencies do not depend on the time of day, which may be set while a run goes on."""

import time
from itertools import count
from typing import Any
from unittest.mock import MagicMock

import pytest

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.launch.conclusion import on_launcher_clock, percentiles
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.mesh.control import files
from mast_zenoh.mesh.control.codec import Signatures, encode
from mast_zenoh.mesh.control.flow import Epoch
from mast_zenoh.mesh.file_client import FileClient
from mast_zenoh.mesh.protocol.events import EpochEvent, MessageEvent
from mast_zenoh.mesh.zenoh_process import ZenohProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.node import Context, Node, Received, Source
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

JUMP_NS = 49 * 60 * 10**9
WIRING = Wiring((Wire("clock", "", "clock", (Leg("clock", Endpoint("sim", "clock"), (Endpoint("ego", "clock"),)),)),))


class Sim(Source):
    """Plays one frame."""

    outputs = {"clock": "clock"}

    def advance(self, context: Context) -> bool:
        context.publish("clock", {}, frame=0, time_ns=0)
        return True


class Ego(Node):
    """Receives the clock."""

    inputs = {"clock": "clock"}

    def on_clock(self, received: Received, context: Context) -> None: ...


@pytest.fixture(autouse=True)
def jumping_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of day is set forward by 49 minutes at each look at it."""
    now_ns, jumps = time.time_ns(), count(1)
    monkeypatch.setattr(time, "time_ns", lambda: now_ns + next(jumps) * JUMP_NS)


def process_of(name: str, node: Node) -> ZenohProcess:
    specs = {"sim": NodeSpec("simulator", "", "", {}, "fail"), "ego": NodeSpec("agent", "", "", {}, "fail")}
    resolved = Resolved("jump", 1, "realtime", 1.0, 1, 10**8, specs, WIRING.to_json(), {})
    process = ZenohProcess("x", resolved, name, node, MagicMock(), Signatures("x"))
    process.protocol.start()
    process.protocol.handle(EpochEvent(Epoch(1, {"sim": "simulator", "ego": "agent"}, None)))
    return process


def test_a_jump_of_the_time_of_day_changes_no_latency() -> None:
    begun_ns = time.monotonic_ns()
    sim: Any = process_of("sim", Sim()).protocol
    ego = process_of("ego", Ego()).protocol
    sim.scene.send(0)
    ego.handle(MessageEvent("clock", codec.encode(codec.conform(Header("clock", "sim", 0, 0, 0), {})), 1, 0))
    sent, arrived = on_launcher_clock({"sim": {"sent_ns": sim.scene.sent_ns}, "ego": {"arrived_ns": ego.arrived_ns}})
    took_ms = (time.monotonic_ns() - begun_ns) * 1e-6
    assert 0.0 <= percentiles(sent, arrived["ego"]["clock"])["p50"] <= took_ms


def test_the_clocks_of_two_hosts_are_compared_by_clocks_that_do_not_jump() -> None:
    client = FileClient(MagicMock(), "x", "ego")
    server: Any = MagicMock(_waiting={"ego": 0}, _resolved=lambda node: MagicMock(nodes={"ego": None}))
    times: list[int] = []
    server._requests.put = lambda item: times.append(item[2])

    def ask(*_: Any) -> files.LauncherTime:
        query = MagicMock(key_expr="mast/x/@control/fetch/ego", attachment=None)
        query.payload.to_bytes = lambda: encode(files.Clock())
        FileServer._on_query(server, query)
        return files.LauncherTime(times[-1])

    client.ask = ask  # type: ignore[method-assign]
    client._measure_clock_offset(1.0)
    assert abs(client.clock["offset_ms"]) <= client.clock["round_trip_ms"]
