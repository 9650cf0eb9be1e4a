"""An invalid control message never ends or stalls a process: it is refused, counted and logged once."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import msgpack
import pytest
import zenoh
from rich.console import Console

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control import CONTROLS, flow
from mast_zenoh.control.files import encode
from mast_zenoh.control.invalid import MAX_KEYS, OTHERS, InvalidMessages
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import ImplausibleCounts, MastError, MessageError, ServiceDied
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.file_server import Depot
from mast_zenoh.launch.mesh_run import Launch
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.steps import Steps
from mast_zenoh.node import Node, Source
from mast_zenoh.runtime.lockstep.timetable import Timetable
from mast_zenoh.runtime.mesh.driver import Driver
from mast_zenoh.runtime.mesh.node import MeshNode
from mast_zenoh.security.access import rights
from mast_zenoh.security.credentials import LAUNCHER
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
    """A query like Zenoh's that keeps the answer."""

    def __init__(self, key: str, payload: bytes) -> None:
        self.key_expr = f"mast/x/@control/{key}"
        self.payload = MagicMock(to_bytes=lambda: payload, to_string=payload.decode)
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
def ego() -> MeshNode:
    return MeshNode("x", "ego", Ego(), WIRING, 1, MagicMock(), signatures=Signatures("x"), period_ns=1, lockstep=True)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    made = Driver(
        *("x", "sim", Sim(), WIRING, 1, MagicMock()),
        signatures=Signatures("x"),
        expected=dict(ROLES),
        period_ns=1,
        lockstep=True,
        rate=1.0,
        timetable=Timetable(RESOLVED, lockstep=True),
        stall_timeout_s=2.0,
    )
    monkeypatch.setattr("mast_zenoh.runtime.mesh.driver.SUSPECT_S", 0.01)
    made.alive |= {"ego", "watch"}
    made._begin_epoch()
    return made


@pytest.fixture
def launch(tmp_path: Path) -> Launch:
    display = Display(Console(quiet=True), "small", 10)
    return Launch(RESOLVED, tmp_path, {"id": "x"}, display, None, "tcp/127.0.0.1:0")


# -- nodes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", RUBBISH)
def test_a_malformed_epoch_costs_a_node_one_message(ego: MeshNode, payload: bytes) -> None:
    ego.control_came("epoch", payload)
    assert (ego.epoch, ego.invalid.counts) == (0, {"epoch": 1})
    with pytest.raises(queue.Empty):
        ego.inbox.get_nowait()
    ego.control_came("epoch", flow.encode_epoch(1, {"ego": "agent"}, None))
    ego.handle(ego.inbox.get_nowait())
    assert (ego.epoch, ego.stop_reason) == (1, None)


@pytest.mark.parametrize("key", ["stop", "leave/ego"])
def test_a_stop_that_is_not_text_costs_a_node_one_message(ego: MeshNode, key: str) -> None:
    ego.control_came(key, b"\xff\xfe")
    assert (ego.stop_reason, ego.invalid.counts) == (None, {key: 1})
    with pytest.raises(queue.Empty):
        ego.inbox.get_nowait()
    ego.control_came(key, b"end")
    ego.handle(ego.inbox.get_nowait())
    assert ego.stop_reason == "end"


TAP = "agent/ego/status/@tap/0"


@pytest.fixture
def eve() -> MeshNode:
    """A node on the wire of ego's status."""
    legs = (Leg(TAP, Endpoint("ego", "status"), (Endpoint("eve", "heard"),)),)
    legs += (Leg("agent/ego/status", Endpoint("eve", "status"), (Endpoint("watch", "status"),)),)
    wiring = Wiring((WIRING.wires[0], Wire("agent/ego/status", "ego", "status", legs)))
    more: Any = {"signatures": Signatures("x"), "period_ns": 1, "lockstep": True}
    return MeshNode("x", "eve", Eve(), wiring, 1, MagicMock(), **more)


def begin_removal(node: MeshNode) -> None:
    """Begin a change of the wiring that removes the node."""
    update = flow.WiringUpdate(WIRING, False, (node.name,))
    node.control_came("epoch", flow.encode_epoch(1, {node.name: "adversary"}, update))
    node.handle(node.inbox.get_nowait())


@pytest.mark.parametrize("payload", [b"\xff\xfe", b"", b"a//b", b"**", b"agent/other/status", b"x" * 5000, b"clock"])
def test_a_drain_for_a_key_that_the_node_is_not_on_is_refused_at_once(eve: MeshNode, payload: bytes) -> None:
    begin_removal(eve)
    query = Query("drain/eve", payload)
    eve.rewiring.take_question(query)  # type: ignore[arg-type]
    assert query.dropped
    assert query.answers == []
    assert not eve.rewiring.asked
    assert eve.invalid.counts == {"drain/eve": 1}


def test_only_a_node_that_will_leave_answers_a_drain(eve: MeshNode) -> None:
    early, due = Query("drain/eve", TAP.encode()), Query("drain/eve", TAP.encode())
    eve.rewiring.take_question(early)  # type: ignore[arg-type]
    assert (early.answers, early.dropped, eve.invalid.counts) == ([], True, {"drain/eve": 1})
    begin_removal(eve)
    eve.rewiring.take_question(due)  # type: ignore[arg-type]
    eve.handle(eve.inbox.get_nowait())
    assert due.answers == [("ok", b"")]


# -- the driver ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", RUBBISH)
@pytest.mark.parametrize(("node", "key"), [("ego", "counts/ego"), ("nobody", "counts/*")])
def test_malformed_counts_cost_the_driver_one_message(driver: Driver, node: str, key: str, payload: bytes) -> None:
    driver._on_counts(sample(f"counts/{node}", payload))
    assert driver.invalid.counts == {key: 1}
    assert not driver._wait(time.monotonic())
    assert driver.stop_reason is None


@pytest.mark.parametrize("payload", [*RUBBISH, msgpack.packb({"wiring": {"wires": [[]]}, "join": {}, "leave": []})])
def test_a_malformed_change_of_the_wiring_costs_the_driver_one_message(driver: Driver, payload: bytes) -> None:
    query = Query("rewire", payload)
    driver.rewirer.ask(query)  # type: ignore[arg-type]
    assert query.dropped
    assert driver.invalid.counts == {"rewire": 1}


def test_a_node_that_reports_more_messages_than_were_sent_ends_the_run_and_is_named(driver: Driver) -> None:
    driver._sent["clock"] = 3
    driver._report_self()
    driver._on_counts(sample("counts/watch", flow.encode_counts(1, {}, {})))
    driver._on_counts(sample("counts/ego", flow.encode_counts(1, {}, {"clock": 10**9})))
    begun = time.monotonic()
    reason = driver._await_quiet(everyone=True)
    assert reason == "implausible: ego reports 1000000000 messages of sim handled on clock, of which 3 were sent"
    assert time.monotonic() - begun < driver.stall_timeout_s, "at once, and not when the run is found to stall"


def test_a_node_that_reports_a_key_that_is_not_its_own_ends_the_run_and_is_named(driver: Driver) -> None:
    driver._on_counts(sample("counts/watch", flow.encode_counts(1, {"clock": 1}, {})))
    reason = driver._await_quiet(everyone=True)
    assert reason == "implausible: watch reports messages sent on 'clock', on which it does not speak"


def test_a_node_that_reports_too_few_messages_stalls_the_run(driver: Driver) -> None:
    driver.stall_timeout_s = 0.05
    driver._sent["clock"] = 3
    driver._report_self()
    for name in ("ego", "watch"):
        driver._on_counts(sample(f"counts/{name}", flow.encode_counts(1, {}, {})))
    assert driver._await_quiet(everyone=True) == "stall: ego has handled 0 of 3 messages of sim on clock"


def test_a_node_comes_back_only_if_it_was_lost_before(driver: Driver) -> None:
    def told(there: bool) -> None:
        driver._note_presence("ego", there)

    told(False)
    told(True)
    driver._leaving.add("ego")  # the scenario kills it, and starts it again
    told(False)
    told(True)
    assert [each["what"] for each in driver.churn] == ["lost", "back"]


def presence(driver: Driver, *there: bool) -> None:
    """Report a sequence of appearances of ego's token to the driver."""
    for each in there:
        kind = zenoh.SampleKind.PUT if each else zenoh.SampleKind.DELETE
        driver._on_presence(MagicMock(key_expr="mast/x/alive/ego", kind=kind))


def test_of_repeated_losses_only_the_loss_and_the_latest_state_are_queued(driver: Driver) -> None:
    presence(driver, *[False, True] * 1000)
    assert driver._wait(time.monotonic() + 1.0)
    assert "ego" not in driver.alive, "first it has gone, so that a new epoch begins"
    assert driver._wait(time.monotonic() + 1.0)
    assert "ego" in driver.alive
    assert [each["what"] for each in driver.churn] == ["lost", "back"]
    with pytest.raises(queue.Empty):
        driver.inbox.get_nowait()


def test_a_node_that_constantly_leaves_and_returns_ends_the_run_and_is_named(driver: Driver) -> None:
    for there in [False, True] * 60:
        driver._note_presence("ego", there)
    assert driver._over == "implausible: ego has gone and come back more than 50 times"


# -- the launcher ----------------------------------------------------------------------------------------------------


def steps_of(launch: Launch) -> Steps:
    supervisor = MagicMock(children={})
    return Steps(supervisor, RESOLVED.nodes, frozenset(), lambda name: None, RESOLVED.steps)


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
def test_an_act_that_is_not_in_the_scenario_costs_the_launcher_one_message(launch: Launch, payload: bytes) -> None:
    steps = steps_of(launch)
    launch._ask(payload)
    launch._act(steps)
    assert launch.invalid.counts == {"act": 1}
    assert steps.done == []
    assert steps._supervisor.method_calls == []


def test_a_step_of_the_scenario_is_carried_out_once(launch: Launch) -> None:
    steps = steps_of(launch)
    for _ in range(2):
        launch._ask(flow.encode_act(5, [("start", "ego")]))
        launch._act(steps)
    assert steps.done == [{"frame": 5, "action": "start", "node": "ego"}]
    assert launch.invalid.counts == {"act": 1}


def test_a_reason_of_the_driver_becomes_the_error_that_names_the_node(launch: Launch) -> None:
    launch.reports = MagicMock(take=lambda: [MagicMock(node="sim", failure=None)])
    launch.reports.outcomes = {"sim": {"stop_reason": "implausible: ego reports too much"}}
    launch._take_reports()
    assert isinstance(launch.problem, ImplausibleCounts)
    assert str(launch.problem) == "ego reports too much"
    assert launch.stopping_since is not None


@pytest.mark.parametrize(("reason", "fails"), [("end", False), ("forged", True), ("", True)])
def test_a_run_that_somebody_else_has_told_to_stop_is_not_ok(launch: Launch, reason: str, fails: bool) -> None:
    launch.reports = MagicMock(take=lambda: [MagicMock(node="sim", failure=None)])
    launch.reports.outcomes = {"sim": {"stop_reason": reason}}
    launch._take_reports()
    assert (launch.problem is not None) == fails
    assert launch.stopping_since is not None


def test_a_run_that_the_launcher_itself_stops_keeps_its_own_problem(launch: Launch) -> None:
    launch.problem = ServiceDied("the depot has ended")
    launch._stop("a service has ended")
    launch.reports = MagicMock(take=lambda: [MagicMock(node="sim", failure=None)])
    launch.reports.outcomes = {"sim": {"stop_reason": "a service has ended"}}
    launch._take_reports()
    assert isinstance(launch.problem, ServiceDied)


@pytest.fixture
def depot(tmp_path: Path, launch: Launch) -> Any:
    (tmp_path / "scenario.json").write_text("{}")
    made = Depot(MagicMock(), "x", tmp_path, lambda: RESOLVED, lambda node: [], lambda error: None, launch.invalid)
    made._kept["ego"] = {"mine": b"content", "file": tmp_path / "scenario.json"}
    yield made
    made.close()


def answered(depot: Depot, what: str, node: str, payload: bytes) -> tuple[str, Any]:
    query = Query(f"{what}/{node}", payload)
    depot._on_query(query)  # type: ignore[arg-type]
    deadline = time.monotonic() + 10.0
    while not query.dropped and time.monotonic() < deadline:
        assert not depot.died, "the depot's thread has ended"
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
def test_a_malformed_question_is_answered_with_an_error_and_the_depot_lives(
    depot: Depot, launch: Launch, payload: bytes
) -> None:
    for what in ("fetch", "file"):
        kind, (error, _) = answered(depot, what, "ego", payload)
        assert (kind, error) == ("error", "MessageError")
    assert launch.invalid.counts == {"fetch/ego": 1, "file/ego": 1}
    assert answered(depot, "fetch", "ego", encode({"do": "piece", "path": "mine", "offset": 3})) == (
        "ok",
        {"piece": b"tent"},
    )


def test_an_unexpected_error_costs_one_query(depot: Depot, launch: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OverflowError("no such number")

    monkeypatch.setattr(depot, "_give", fail)
    kind, (_, said) = answered(depot, "fetch", "ego", encode({"do": "clock"}))
    assert (kind, said) == ("error", "OverflowError: no such number")
    assert launch.invalid.counts == {"fetch/ego": 1}
    monkeypatch.undo()
    assert answered(depot, "fetch", "ego", encode({"do": "clock"}))[0] == "ok"


def test_unknown_nodes_get_no_answer_and_are_counted_together(depot: Depot, launch: Launch) -> None:
    for name in ("a", "b"):
        assert answered(depot, "fetch", name, encode({"do": "clock"}))[0] == "error"
    assert launch.invalid.counts == {"fetch/*": 2}


def test_a_depot_that_has_died_ends_the_run_and_is_named(
    depot: Depot, launch: Launch, monkeypatch: pytest.MonkeyPatch
) -> None:
    launch.depot = depot
    launch._check_depot()
    assert launch.problem is None
    monkeypatch.setattr(depot, "_refuse", MagicMock(side_effect=SystemExit))
    depot._asked.put((MagicMock(key_expr="mast/x/@control/file/ego"), None, 0))
    depot._thread.join(10.0)
    launch._check_depot()
    assert isinstance(launch.problem, ServiceDied)
    assert "the depot, which serves the nodes' files, has ended: SystemExit" in str(launch.problem)
    assert launch.stopping_since is not None


# -- counting, and the table of rights -------------------------------------------------------------------------------


def test_the_first_refusal_on_each_key_is_logged_and_the_number_of_keys_is_limited() -> None:
    said: list[str] = []
    invalid = InvalidMessages(said.append)
    for i in range(MAX_KEYS + 50):
        for _ in range(3):
            invalid.note(f"key {i}", f"why\n{'x' * 1000}")
    assert len(said) == MAX_KEYS + 1
    assert invalid.counts["key 0"] == 3
    assert invalid.counts[OTHERS] == 150
    assert all("\n" not in line and len(line) < 400 for line in said)


def test_every_error_class_survives_encoding_as_a_refusal() -> None:
    assert issubclass(MessageError, MastError)


@pytest.mark.parametrize("name", sorted(set(CONTROLS) - {"rewire", "drain", "intercept"}))
def test_the_routers_rules_grant_no_more_than_the_table(name: str) -> None:
    def may(node: str, verbs: tuple[str, ...]) -> set[str]:
        found = rights(WIRING, node, driver="sim")
        keys = {right.key for right in found if (right.flow, right.message) in [("ingress", verb) for verb in verbs]}
        return {key for key in keys if key.startswith(f"@control/{name}") and key.split("/")[1] == name}

    sending: Callable[[str], set[str]] = lambda node: may(node, ("put", "query"))  # noqa: E731
    control = CONTROLS[name]
    own = f"@control/{name}/ego" if control.own else f"@control/{name}"
    assert sending("ego") == ({own} if "node" in control.senders else set())
    assert bool(sending("sim") - sending("ego") if not control.own else sending("sim")) == (
        "driver" in control.senders or "node" in control.senders
    )
    assert bool(sending(LAUNCHER)) == ("launcher" in control.senders)


def test_of_many_counts_only_the_newest_of_each_node_is_queued_at_the_driver(driver: Driver) -> None:
    for count in range(1000):
        driver._on_counts(sample("counts/ego", flow.encode_counts(1, {}, {"clock": count})))
        driver._on_counts(sample("counts/watch", flow.encode_counts(1, {}, {"agent/ego/status": 1})))
    driver._on_counts(sample("counts/ego", b"rubbish"))
    waiting = [driver.inbox.get_nowait() for _ in range(2)]
    assert waiting == [("counts", "ego"), ("counts", "watch")]
    with pytest.raises(queue.Empty):
        driver.inbox.get_nowait()
    driver._take_counts("ego")
    assert driver.pacer._reports["ego"] == ({}, {"clock": 999})
    assert driver.invalid.counts == {"counts/ego": 1}, "what is malformed stands for nothing"


@pytest.mark.parametrize("what", ["fetch", "file"])
def test_an_oversized_query_is_not_queued(
    depot: Depot, launch: Launch, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = MagicMock()
    monkeypatch.setattr(depot, "_asked", MagicMock(put=waits))
    query = Query(f"{what}/ego", bytes(CONTROLS[what].max_bytes + 1))
    depot._on_query(query)  # type: ignore[arg-type]
    assert query.dropped
    assert launch.invalid.counts == {f"{what}/ego": 1}
    monkeypatch.undo()
    assert not waits.called


def test_queries_that_do_not_fit_the_queue_are_counted_by_kind(depot: Depot, launch: Launch) -> None:
    depot._waiting["ego"] = 16
    depot._on_query(Query("file/ego", encode({"path": "a", "offset": 0, "piece": b""})))  # type: ignore[arg-type]
    assert launch.invalid.counts == {"file/ego": 1}


def test_an_oversized_failure_is_not_queued_at_the_launcher(launch: Launch) -> None:
    reports = Reports(MagicMock(), "mast/x/@control", {"ego": MagicMock()}, launch.invalid)
    reports._on_failed(sample("failed/ego", bytes(CONTROLS["failed"].max_bytes + 1)))
    assert launch.invalid.counts == {"failed/ego": 1}
    assert reports._came.empty()
