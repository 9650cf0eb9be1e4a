"""An invalid control message is refused, counted and logged once."""

import stat
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import msgpack
import pytest
from hosted import Hosted

from mast_zenoh.config.resolved import NodeSpec, ProcessStep, Resolved
from mast_zenoh.errors import ImplausibleCounts, ServiceDied
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.launcher_protocol import Report
from mast_zenoh.launch.live_interception import SECRET_FILE, InterceptionServer, seal
from mast_zenoh.launch.mesh_run import MeshLauncher
from mast_zenoh.launch.reports import Reports
from mast_zenoh.mesh.control import CONTROLS, flow
from mast_zenoh.mesh.control.codec import MAX_KEYS, OTHERS, InvalidMessages, encode
from mast_zenoh.mesh.security.access import rights
from mast_zenoh.mesh.security.credentials import LAUNCHER
from mast_zenoh.node import Node, Source
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

RUBBISH = [b"", b"\xc1", b"\xff\xfe", msgpack.packb(7), msgpack.packb([]), msgpack.packb([1, 2]), msgpack.packb({})]
WIRING = Wiring(
    (
        Wire("clock", "", "clock", (Leg("clock", Endpoint("sim", "clock"), (Endpoint("ego", "clock"),)),)),
        Wire(
            "agent/ego/status",
            "ego",
            "status",
            (Leg("agent/ego/status", Endpoint("ego", "status"), (Endpoint("watch", "status"),)),),
        ),
    )
)
ROLES = {"sim": "simulator", "ego": "agent", "watch": "broker"}
RESOLVED = Resolved(
    name="small",
    seed=1,
    mode="lockstep",
    rate=1.0,
    frames=10,
    period_ns=100_000_000,
    nodes={name: NodeSpec(role, f"/nowhere/{name}.py", "Any", {}, "continue") for name, role in ROLES.items()},
    wiring=WIRING.to_json(),
    scene={},
    steps=(ProcessStep(3, "kill", "ego"), ProcessStep(5, "start", "ego")),
)


class Ego(Node):
    """A node that receives the clock and publishes nothing."""

    role = "agent"
    inputs = {"clock": "clock"}
    outputs = {"status": "status"}

    def on_clock(self, received: Any, context: Any) -> None:
        """Do nothing."""


class Eve(Node):
    """An interposer that forwards nothing."""

    role = "adversary"
    inputs = {"heard": "status"}
    outputs = {"status": "status"}

    def on_heard(self, received: Any, context: Any) -> None:
        """Do nothing."""


class Sim(Source):
    """A node that drives a scene that never ends."""

    role = "simulator"
    outputs = {"clock": "clock"}

    def advance(self, context: Any) -> bool:
        """Publish nothing but the clock."""
        return True


class Query:
    """A query like Zenoh's that keeps its reply."""

    def __init__(self, key: str, payload: bytes) -> None:
        self.key_expr = f"mast/x/@control/{key}"
        self.payload = MagicMock(to_bytes=lambda: payload, to_string=payload.decode)
        self.attachment = None
        self.answers: list[tuple[str, bytes]] = []
        self.dropped = False

    def reply(self, key: str, payload: bytes) -> None:
        self.answers.append(("ok", payload))

    def reply_err(self, payload: bytes) -> None:
        self.answers.append(("error", payload))

    def drop(self) -> None:
        self.dropped = True


def sample(key: str, payload: bytes) -> Any:
    return MagicMock(key_expr=f"mast/x/@control/{key}", payload=MagicMock(to_bytes=lambda: payload))


@pytest.fixture
def ego() -> Hosted:
    return Hosted("ego", Ego(), WIRING)


@pytest.fixture
def driver() -> Hosted:
    """A driver that has begun an epoch with all nodes, none of which has reported in it."""
    driver = Hosted("sim", Sim(), WIRING, nodes=RESOLVED.nodes)
    driver.protocol.stall_timeout_s = 5.0
    driver.protocol.start()
    for name in ("ego", "watch"):
        driver.protocol.receive_presence(name, True)
    driver.handle_all()
    assert driver.protocol.epoch == 1
    driver.protocol.pacer.heard |= {"ego", "watch"}  # both have taken part
    return driver


def counts(driver: Hosted, node: str, sent: dict[str, int], handled: dict[str, int]) -> None:
    """Report a node's counts to the driver."""
    driver.protocol.receive_counts(f"counts/{node}", flow.encode_counts(1, sent, handled))
    driver.handle_all()


def test_a_token_that_goes_before_its_node_was_heard_is_no_loss(driver: Hosted) -> None:
    driver.protocol.pacer.heard.discard("ego")
    presence(driver, False)
    driver.handle_all()
    assert "ego" not in driver.protocol.membership.alive
    assert driver.protocol.membership.churn == []


@pytest.fixture
def context(tmp_path: Path) -> RunContext:
    return RunContext(RESOLVED, lambda line: None, time.monotonic, folder=tmp_path, record={"id": "x"})


# -- nodes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", RUBBISH)
def test_a_malformed_epoch_costs_a_node_one_message(ego: Hosted, payload: bytes) -> None:
    ego.protocol.receive_epoch("epoch", payload)
    assert (ego.protocol.epoch, ego.protocol.invalid.counts) == (0, {"epoch": 1})
    assert not ego.items
    ego.protocol.receive_epoch("epoch", flow.encode_epoch(1, {"ego": "agent"}, None))
    ego.handle_all()
    assert (ego.protocol.epoch, ego.protocol.stop_reason) == (1, None)


@pytest.mark.parametrize("key", ["stop", "leave/ego"])
def test_a_stop_that_is_not_text_costs_a_node_one_message(ego: Hosted, key: str) -> None:
    ego.protocol.receive_stop(key, b"\xff\xfe")
    assert (ego.protocol.stop_reason, ego.protocol.invalid.counts) == (None, {key: 1})
    assert not ego.items
    ego.protocol.receive_stop(key, b"end")
    ego.handle_all()
    assert ego.protocol.stop_reason == "end"


TAP = "agent/ego/status/@tap/0"


@pytest.fixture
def eve() -> Hosted:
    """A node on the wire of ego's status."""
    legs = (Leg(TAP, Endpoint("ego", "status"), (Endpoint("eve", "heard"),)),)
    legs += (Leg("agent/ego/status", Endpoint("eve", "status"), (Endpoint("watch", "status"),)),)
    return Hosted("eve", Eve(), Wiring((WIRING.wires[0], Wire("agent/ego/status", "ego", "status", legs))))


def begin_removal(hosted: Hosted) -> None:
    """Begin a wiring change that removes the node."""
    name = hosted.protocol.name
    update = flow.WiringUpdate(WIRING, False, (name,))
    hosted.protocol.receive_epoch("epoch", flow.encode_epoch(1, {name: "adversary"}, update))
    hosted.handle_all()


@pytest.mark.parametrize("payload", [b"\xff\xfe", b"", b"a//b", b"**", b"agent/other/status", b"x" * 5000, b"clock"])
def test_a_drain_for_a_foreign_key_is_refused_at_once(eve: Hosted, payload: bytes) -> None:
    begin_removal(eve)
    eve.protocol.receive_drain("query", payload)
    eve.actions.answer.assert_called_once_with("query", None)
    assert not eve.items
    assert eve.protocol.invalid.counts == {"drain/eve": 1}


def test_only_a_departing_node_answers_a_drain(eve: Hosted) -> None:
    eve.protocol.receive_drain("early", TAP.encode())
    eve.actions.answer.assert_called_once_with("early", None)
    assert eve.protocol.invalid.counts == {"drain/eve": 1}
    begin_removal(eve)
    eve.protocol.receive_drain("due", TAP.encode())
    eve.handle_all()
    eve.actions.answer.assert_called_with("due", b"")


# -- the driver ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", RUBBISH)
@pytest.mark.parametrize(("node", "key"), [("ego", "counts/ego"), ("nobody", "counts/*")])
def test_malformed_counts_cost_the_driver_one_message(driver: Hosted, node: str, key: str, payload: bytes) -> None:
    driver.protocol.receive_counts(f"counts/{node}", payload)
    assert driver.protocol.invalid.counts == {key: 1}
    assert not driver.items
    assert driver.protocol.stop_reason is None


@pytest.mark.parametrize("payload", [*RUBBISH, msgpack.packb({"wiring": {"wires": [[]]}, "join": {}, "leave": []})])
def test_a_malformed_wiring_change_costs_the_driver_one_message(driver: Hosted, payload: bytes) -> None:
    driver.protocol.receive_rewire("query", payload)
    driver.actions.answer.assert_called_once_with("query", None)
    assert driver.protocol.invalid.counts == {"rewire": 1}


def test_a_node_that_reports_more_messages_than_were_sent_ends_the_run_by_name(driver: Hosted) -> None:
    driver.protocol.scene.sent["clock"] = 3
    driver.protocol.report()
    counts(driver, "watch", {}, {})
    counts(driver, "ego", {}, {"clock": 10**9})
    driver.wait()
    assert "ego reports 1000000000" in driver.protocol.stop_reason
    assert driver.now_ns < driver.protocol.stall_timeout_s * 1e9, "at once, not only when the stall timeout expires"


def test_a_node_that_reports_too_few_messages_stalls_the_run(driver: Hosted) -> None:
    driver.protocol.scene.sent["clock"] = 3
    driver.protocol.report()
    for name in ("ego", "watch"):
        counts(driver, name, {}, {})
    while driver.protocol.stop_reason is None:
        driver.wait()
    assert "0 of 3" in driver.protocol.stop_reason
    assert driver.now_ns == 5 * 10**9


def test_the_driver_believes_nobody_about_what_it_has_sent_itself(driver: Hosted) -> None:
    driver.protocol.scene.sent["clock"] = 1
    driver.protocol.report()
    for name in ("ego", "watch", "sim"):
        counts(driver, name, {}, {})
    assert not driver.protocol.pacer.quiet(), "nobody has handled the clock"
    assert driver.protocol.invalid.counts == {"counts/sim": 1}


def test_the_driver_sends_no_counts_that_return_after_later_ones(driver: Hosted) -> None:
    driver.protocol.rewiring.update = flow.WiringUpdate(WIRING, True)
    presence(driver, False, True)
    driver.handle_all()
    assert driver.controls("counts/sim") == []
    assert driver.protocol.pacer._reports["sim"] == ({}, {})


def presence(driver: Hosted, *there: bool) -> None:
    """Report a sequence of presence changes of ego's token to the driver."""
    for each in there:
        driver.protocol.receive_presence("ego", each)


def test_repeated_losses_queue_only_one_event(driver: Hosted) -> None:
    presence(driver, *[False, True] * 1000)
    assert len(driver.items) == 1
    driver.handle_all()
    assert "ego" in driver.protocol.membership.alive
    assert [each["what"] for each in driver.protocol.membership.churn] == ["lost", "back"]


def test_a_node_that_repeatedly_leaves_and_returns_ends_the_run_by_name(driver: Hosted) -> None:
    for _ in range(60):
        presence(driver, False, True)
        driver.handle_all()
        for name in ("watch", "ego", "watch"):  # in the epoch without ego, and in that with it
            driver.protocol.receive_counts(f"counts/{name}", flow.encode_counts(driver.protocol.epoch, {}, {}))
            driver.handle_all()
    assert "ego was lost" in driver.protocol.stop_reason


# -- the launcher ----------------------------------------------------------------------------------------------------


def launcher_of(context: RunContext) -> MeshLauncher:
    """A launcher with no node and no mesh."""
    return MeshLauncher(context, Mesh(MagicMock(), MagicMock(children={}, newly_ended=list, running=list)), MagicMock())


def act(launcher: MeshLauncher, payload: bytes) -> None:
    """Have a request for process steps arrive."""
    launcher._on_act(MagicMock(payload=MagicMock(to_bytes=lambda: payload)))


@pytest.mark.parametrize(
    "payload",
    [
        *RUBBISH,
        flow.encode_act(3, [("start", "nobody")]),
        flow.encode_act(3, [("start", "ego")]),
        flow.encode_act(4, [("kill", "ego")]),
        flow.encode_act(3, [("kill", "ego"), ("kill", "ego")]),
        flow.encode_act(3, [("kill", "sim")]),
    ],
)
def test_an_act_that_is_not_in_the_scenario_costs_the_launcher_one_message(context: RunContext, payload: bytes) -> None:
    launcher = launcher_of(context)
    act(launcher, payload)
    launcher.advance()
    assert context.invalid.counts == {"act": 1}
    assert launcher._protocol.steps.done == []
    assert launcher._supervisor.method_calls == []


def test_a_step_of_the_scenario_is_carried_out_once(context: RunContext) -> None:
    launcher = launcher_of(context)
    for _ in range(2):
        act(launcher, flow.encode_act(5, [("start", "ego")]))
        launcher.advance()
    assert launcher._protocol.steps.done == [{"frame": 5, "action": "start", "node": "ego"}]
    assert context.invalid.counts == {"act": 1}


def test_a_request_of_the_driver_is_ignored_when_the_run_is_stopping(context: RunContext) -> None:
    launcher = launcher_of(context)
    act(launcher, flow.encode_act(5, [("start", "ego")]))
    context.stop.request()
    launcher.advance()
    assert launcher._protocol.steps.done == []


def take_result_of_driver(context: RunContext, stop_reason: str) -> None:
    """Have the launcher receive the driver's result with the reason for its stop."""
    launcher = launcher_of(context)
    launcher._reports = MagicMock(take=lambda: [Report("sim", stop_reason=stop_reason)])
    launcher.advance()


def test_the_drivers_reason_becomes_an_error_that_names_the_node(context: RunContext) -> None:
    take_result_of_driver(context, "implausible: ego reports too much")
    assert isinstance(context.stop.problem, ImplausibleCounts)
    assert "reports too much" in str(context.stop.problem)
    assert context.stop.requested


@pytest.mark.parametrize(("reason", "fails"), [("end", False), ("forged", True), ("", True)])
def test_a_run_stopped_from_outside_is_not_ok(context: RunContext, reason: str, fails: bool) -> None:
    take_result_of_driver(context, reason)
    assert (context.stop.problem is not None) == fails
    assert context.stop.requested


def test_a_run_stopped_by_the_launcher_keeps_its_own_error(context: RunContext) -> None:
    context.stop.fail(ServiceDied("the depot has ended"), "a service has ended")
    take_result_of_driver(context, "a service has ended")
    assert isinstance(context.stop.problem, ServiceDied)


@pytest.fixture
def file_server(tmp_path: Path, context: RunContext) -> Any:
    (tmp_path / "scenario.json").write_text("{}")
    server = FileServer(MagicMock(), context)
    server._contents["ego"] = {"mine": b"content", "file": tmp_path / "scenario.json"}
    yield server
    server.close()


def answered(file_server: FileServer, what: str, node: str, payload: bytes) -> tuple[str, Any]:
    query = Query(f"{what}/{node}", payload)
    file_server._on_query(query)  # type: ignore[arg-type]
    deadline = time.monotonic() + 10.0
    while not query.dropped and time.monotonic() < deadline:
        assert not file_server.died, "the file server's thread has ended"
    kind, answer = query.answers[0]
    return kind, msgpack.unpackb(answer)


PIECES = [
    {"do": "piece", "path": path, "offset": offset}
    for path in ("mine", "file")
    for offset in (float("inf"), float("nan"), -1, 1 << 63, "0", None, [])
]


@pytest.mark.parametrize(
    "payload", [*RUBBISH, *map(encode, PIECES), encode({"do": "piece", "path": "../x", "offset": 0})]
)
def test_a_malformed_query_is_answered_with_an_error_and_the_file_server_continues(
    file_server: FileServer, context: RunContext, payload: bytes
) -> None:
    for what in ("fetch", "file"):
        kind, (error, _) = answered(file_server, what, "ego", payload)
        assert (kind, error) == ("error", "MessageError")
    assert context.invalid.counts == {"fetch/ego": 1, "file/ego": 1}
    assert answered(file_server, "fetch", "ego", encode({"do": "piece", "path": "mine", "offset": 3})) == (
        "ok",
        {"piece": b"tent"},
    )


def test_an_unexpected_error_costs_one_query(file_server, context, monkeypatch) -> None:
    def fail(*_: object) -> None:
        raise OverflowError("no such number")

    monkeypatch.setattr(file_server, "_answer", fail)
    kind, (_, error) = answered(file_server, "fetch", "ego", encode({"do": "clock"}))
    assert (kind, error.partition(":")[0]) == ("error", "OverflowError")
    assert context.invalid.counts == {"fetch/ego": 1}
    monkeypatch.undo()
    assert answered(file_server, "fetch", "ego", encode({"do": "clock"}))[0] == "ok"


def test_unknown_nodes_get_no_answer_and_share_one_count(file_server: FileServer, context: RunContext) -> None:
    for name in ("a", "b"):
        assert answered(file_server, "fetch", name, encode({"do": "clock"}))[0] == "error"
    assert context.invalid.counts == {"fetch/*": 2}


def test_a_dead_file_server_ends_the_run_and_is_named(file_server, context, monkeypatch) -> None:
    watch = launcher_of(context)
    watch._file_server = file_server
    watch._check_file_server()
    assert context.stop.problem is None
    monkeypatch.setattr(file_server, "_refuse", MagicMock(side_effect=SystemExit))
    file_server._requests.put((MagicMock(key_expr="mast/x/@control/file/ego"), None, 0))
    file_server._thread.join(10.0)
    watch._check_file_server()
    assert isinstance(context.stop.problem, ServiceDied)
    assert "ended: SystemExit" in str(context.stop.problem)
    assert context.stop.requested


# -- counting, and the table of rights -------------------------------------------------------------------------------


def test_the_first_refusal_on_each_key_is_logged_and_the_number_of_keys_is_limited() -> None:
    logged: list[str] = []
    invalid = InvalidMessages(logged.append)
    for i in range(MAX_KEYS + 50):
        for _ in range(3):
            invalid.note(f"key {i}", f"why\n{'x' * 1000}")
    assert len(logged) == MAX_KEYS + 1
    assert invalid.counts["key 0"] == 3
    assert invalid.counts[OTHERS] == 150
    assert all("\n" not in line and len(line) < 400 for line in logged)


@pytest.mark.parametrize("name", sorted(set(CONTROLS) - {"rewire", "drain", "intercept", "describe"}))
def test_the_routers_rules_grant_no_more_than_the_table(name: str) -> None:
    def may(node: str, verbs: tuple[str, ...]) -> set[str]:
        granted = rights(WIRING, node, driver="sim")
        keys = {right.key for right in granted if (right.flow, right.message) in [("ingress", verb) for verb in verbs]}
        return {key for key in keys if key.startswith(f"@control/{name}") and key.split("/")[1] == name}

    sending: Callable[[str], set[str]] = lambda node: may(node, ("put", "query"))  # noqa: E731
    control = CONTROLS[name]
    own = f"@control/{name}/ego" if control.own else f"@control/{name}"
    assert sending("ego") == ({own} if "node" in control.senders else set())
    assert bool(sending("sim") - sending("ego") if not control.own else sending("sim")) == (
        "driver" in control.senders or "node" in control.senders
    )
    assert bool(sending(LAUNCHER)) == ("launcher" in control.senders)


def test_the_driver_queues_only_the_newest_counts_of_each_node(driver: Hosted) -> None:
    for count in range(1000):
        driver.protocol.receive_counts("counts/ego", flow.encode_counts(1, {}, {"clock": count}))
        driver.protocol.receive_counts("counts/watch", flow.encode_counts(1, {}, {"agent/ego/status": 1}))
    driver.protocol.receive_counts("counts/ego", b"rubbish")
    assert [event.node for event, _, _ in driver.items] == ["ego", "watch"]
    driver.handle_all()
    assert driver.protocol.pacer._reports["ego"] == ({}, {"clock": 999})
    assert driver.protocol.invalid.counts == {"counts/ego": 1}, "malformed messages count for nothing"


@pytest.mark.parametrize("what", ["fetch", "file"])
def test_oversized_queries_are_not_queued_at_the_file_server(file_server, context, what, monkeypatch) -> None:
    waits = MagicMock()
    monkeypatch.setattr(file_server, "_requests", MagicMock(put=waits))
    query = Query(f"{what}/ego", bytes(CONTROLS[what].max_bytes + 1))
    file_server._on_query(query)  # type: ignore[arg-type]
    assert query.dropped
    assert context.invalid.counts == {f"{what}/ego": 1}
    monkeypatch.undo()
    assert not waits.called


def test_queries_that_do_not_fit_the_queue_are_counted_by_kind(file_server: FileServer, context: RunContext) -> None:
    file_server._waiting["ego"] = 16
    file_server._on_query(Query("file/ego", encode({"path": "a", "offset": 0, "piece": b""})))  # type: ignore[arg-type]
    assert context.invalid.counts == {"file/ego": 1}


def test_an_oversized_failure_is_not_queued_at_the_launcher(context: RunContext) -> None:
    reports = Reports(MagicMock(), "mast/x/@control", {"ego": MagicMock()}, context.invalid, MagicMock())
    reports._on_failed(sample("failed/ego", bytes(CONTROLS["failed"].max_bytes + 1)))
    assert context.invalid.counts == {"failed/ego": 1}
    assert reports._queue.empty()


# -- malformed messages fill no queue ---------------------------------------------------------------------------------


def test_malformed_steps_leave_room_for_valid_ones(context: RunContext) -> None:
    launcher = launcher_of(context)
    for payload in [*RUBBISH * 50, flow.encode_act(5, [("start", "ego")])]:
        act(launcher, payload)
    launcher.advance()
    assert launcher._protocol.steps.done == [{"frame": 5, "action": "start", "node": "ego"}]
    assert context.invalid.counts == {"act": len(RUBBISH) * 50}


def test_malformed_requests_leave_room_for_valid_ones(context: RunContext) -> None:
    interceptions, launcher = MagicMock(), launcher_of(context)
    server = InterceptionServer(context.folder, "mast/x", MagicMock(), interceptions, launcher)
    assert stat.S_IMODE((context.folder / SECRET_FILE).stat().st_mode) == 0o600
    sound = Query("intercept", seal({"do": "release", "name": "eve", "wire": None}, server._secret))
    forged = [Query("intercept", payload) for payload in [*RUBBISH * 20, seal({"do": "release"}, b"guessed")]]
    for query in [*forged, sound]:
        server._on_query(query)  # type: ignore[arg-type]
    assert context.invalid.counts == {"intercept": len(forged)}
    assert all(query.answers[0][0] == "error" and query.dropped for query in forged)
    (added,) = interceptions.add.call_args_list
    assert added.args[0] is sound


def test_malformed_queries_leave_room_for_valid_ones(file_server, context, monkeypatch) -> None:
    go_on, give = threading.Event(), file_server._answer
    monkeypatch.setattr(file_server, "_answer", lambda *asked: go_on.wait(10.0) and give(*asked))
    clock = encode({"do": "clock"})
    asked = [Query(f"{what}/ego", payload) for what in ("fetch", "file") for payload in [clock, *RUBBISH * 4]]
    for query in [*asked, last := Query("fetch/ego", clock)]:
        file_server._on_query(query)  # type: ignore[arg-type]
    go_on.set()
    deadline = time.monotonic() + 10.0
    while not last.dropped and time.monotonic() < deadline:
        go_on.wait(0.01)
    assert last.answers[0][0] == "ok"
    assert context.invalid.counts == {"fetch/ego": len(RUBBISH) * 4, "file/ego": len(RUBBISH) * 4 + 1}
