"""An end may take as long as it makes progress: what counts is measured, and each kind of it has a limit."""

from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import pytest

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.launch import launcher_protocol as protocol
from mast_zenoh.launch import progress
from mast_zenoh.launch.launcher_protocol import LauncherProtocol, RunState
from mast_zenoh.launch.supervisor import Child

STEP_S = 0.5


class Finishing(Child):
    """A node that finishes; cpu_s, data_s: its processor time, and when it sent its last data, at a time, s."""

    exit = None
    cpu_s: Any = None

    def __init__(self, name: str, cpu_s: Callable[[float], float | None], data_s: Callable[[float], float]) -> None:
        super().__init__(name, NodeSpec("agent", "", "", {}, "fail"))
        self.cpu_at, self.data_at = cpu_s, data_s

    def where(self) -> dict[str, Any]:
        return {}


def ended_after_s(*nodes: Finishing, signals: int = 0, most_s: float = 5000.0) -> tuple[float, str]:
    """When the launcher stops waiting for these nodes, s after the end of the scene, and why; `most_s`: it does not."""
    now = 1000.0
    state = RunState(MagicMock(steps=(), nodes={}), lambda line: None, lambda: now)
    supervisor = MagicMock(children={node.name: node for node in nodes})
    supervisor.running.return_value, supervisor.newly_ended.return_value = list(nodes), []
    actions = MagicMock()
    actions.reports.return_value = ()
    actions.last_data_s.side_effect = lambda name: 1000.0 + supervisor.children[name].data_at(now - 1000.0)
    launcher = LauncherProtocol(state, supervisor, actions)
    state.stop.request()
    state.signals += [2] * signals
    while now < 1000.0 + most_s:
        for node in nodes:
            node.cpu_s = node.cpu_at(now - 1000.0)
        if launcher.advance(None):
            break
        now += STEP_S
    return now - 1000.0, str(state.stop.problem)


def nothing(now: float) -> float:
    return 0.0


IDLE = Finishing("idle", lambda now: 3.0 + 0.004 * now, nothing)


def test_a_node_that_hangs_is_waited_for_until_the_limit() -> None:
    seconds, problem = ended_after_s(IDLE)
    assert seconds == pytest.approx(protocol.LEAVE_GRACE_S, abs=1.0)
    assert problem.startswith("idle ")


def test_a_node_that_computes_is_waited_for_also_beside_many_others() -> None:
    for share in (1.0, 0.05):
        slow = Finishing("slow", lambda now, share=share: share * now, nothing)
        assert ended_after_s(slow, most_s=300.0) == (300.0, "None")


def test_computing_alone_has_a_limit() -> None:
    spinning = Finishing("spinning", lambda now: now, nothing)
    seconds, problem = ended_after_s(spinning)
    assert seconds == pytest.approx(progress.COMPUTE_LIMIT_S, abs=1.0)
    assert problem.startswith("spinning has computed")


def test_a_node_that_stops_computing_is_waited_for_until_the_limit_from_then_on() -> None:
    seconds, problem = ended_after_s(Finishing("slow", lambda now: min(now, 100.0), nothing))
    assert seconds == pytest.approx(100.0 + protocol.LEAVE_GRACE_S, abs=1.0)
    assert "s without progress" in problem


def test_data_count_wherever_a_node_lives_and_have_a_limit_too() -> None:
    sending = Finishing("sending", lambda now: None, lambda now: now - now % 15.0)
    assert ended_after_s(sending)[0] == pytest.approx(progress.END_LIMIT_S, abs=1.0)


def test_where_nothing_measures_a_node_gets_a_longer_limit() -> None:
    unmeasured = Finishing("far", lambda now: None, nothing)
    assert ended_after_s(unmeasured)[0] == pytest.approx(progress.UNMEASURED_LIMIT_S, abs=1.0)


def test_another_process_of_a_node_begins_with_little_processor_time() -> None:
    restarted = Finishing("slow", lambda now: 500.0 if now < 10.0 else now - 10.0, nothing)
    assert ended_after_s(restarted, most_s=300.0)[0] == 300.0


def test_one_node_that_makes_progress_is_enough_and_the_others_are_named_then() -> None:
    slow = Finishing("slow", lambda now: min(now, 50.0), nothing)
    seconds, problem = ended_after_s(IDLE, slow)
    assert seconds == pytest.approx(70.0, abs=1.0)
    assert problem.startswith("idle has not")


def test_after_a_signal_only_data_count_and_a_second_one_ends_at_once() -> None:
    spinning = Finishing("spinning", lambda now: now, nothing)
    assert ended_after_s(spinning, signals=1)[0] == pytest.approx(protocol.INTERRUPT_GRACE_S, abs=1.0)
    sending = Finishing("sending", lambda now: None, lambda now: min(now, 30.0))
    assert ended_after_s(sending, signals=1)[0] == pytest.approx(30.0 + protocol.INTERRUPT_GRACE_S, abs=1.0)
    assert ended_after_s(sending, signals=2)[0] == 0.0


def test_the_launcher_says_for_which_nodes_it_waits() -> None:
    now = 0.0
    state = RunState(MagicMock(steps=(), nodes={}), lambda line: None, lambda: now)
    nodes = [Finishing(f"n{i}", nothing, nothing) for i in range(6)]
    nodes[0].handed_in = True
    endings = LauncherProtocol(state, MagicMock(running=lambda: nodes), MagicMock()).endings
    assert endings.waiting == ""
    state.stop.request()
    assert endings.waiting == "", "not for long"
    now = 12.0
    assert "and 2 more:" in endings.waiting
