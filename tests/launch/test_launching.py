"""The launcher's loop continues whatever happens."""

import os
import signal
import threading
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
import zenoh
from tiny_world import tiny

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.launch import mesh_run, run, stop_signals
from mast_zenoh.launch.context import Mesh
from mast_zenoh.launch.launcher_protocol import Endings, RunState, churn_of
from mast_zenoh.launch.mesh_run import MeshLauncher
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.mesh.protocol.traffic import stamp

WAIT_S = 0.05


@pytest.fixture
def launcher(tmp_path: Path) -> MeshLauncher:
    """A launcher without a run."""
    context = MagicMock(folder=tmp_path, frame=-1)
    launcher = MeshLauncher(context, Mesh(MagicMock(), MagicMock()), MagicMock())
    launcher._protocol = MagicMock()
    return launcher


@pytest.mark.parametrize(("planned", "frame", "newest"), [(10, 9, 9), (10, 10, -1), (None, 25, 25), (None, -2, -1)])
def test_a_frame_beyond_the_scene_is_believed_only_of_a_simulator_of_the_user(
    launcher: MeshLauncher, planned: int | None, frame: int, newest: int
) -> None:
    launcher._context.resolved.timespan = planned and MagicMock(frames=planned)
    launcher._on_clock(MagicMock(attachment=zenoh.ZBytes(stamp("clock", 1, frame))))
    assert launcher._context.frame == newest


def test_the_error_of_a_node_that_did_not_start_has_the_last_line_of_its_log(launcher: MeshLauncher) -> None:
    (launcher._context.folder / "logs").mkdir()
    (launcher._context.folder / "logs" / "ego.log").write_bytes(b"importing\nno licence \xff\n\n")
    (launcher._context.folder / "logs" / "hub.log").touch()
    assert [launcher.last_log_line(name) for name in ("ego", "hub")] == ["no licence \ufffd", ""]


def test_a_slow_signal_handler_does_not_block_the_launcher(launcher: MeshLauncher) -> None:
    with stop_signals.collected() as received:

        def note(number: int, _: object) -> None:
            threading.Event().wait(2 * WAIT_S)
            received.append(number)

        signal.signal(signal.SIGINT, note)
        threading.Timer(WAIT_S / 5, os.kill, (os.getpid(), signal.SIGINT)).start()
        launcher.advance()
    assert received == [signal.SIGINT]


@pytest.mark.parametrize(("allowed", "status"), [(False, "node_lost"), (True, "ok")])
def test_a_lost_node_fails_a_run_in_lock_step_unless_that_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, allowed: bool, status: str
) -> None:
    lost = {"frame": 3, "node": "infra_1", "what": "lost"}
    monkeypatch.setattr(mesh_run, "run", lambda context, *_: context.record.update(churn=[lost]))
    ended = run.run(tiny(), tmp_path / "run", allow_churn=allowed)
    assert ended.record["status"] == status
    assert ("before frame 3" in ended.record["message"]) == (not allowed)


class Ended(Child):
    """A process that has ended."""

    exit = None

    def where(self) -> dict[str, Any]:
        return {}


@pytest.mark.parametrize(
    ("exit", "handed_in", "expected", "frame", "on_exit", "consequence"),
    [
        (0, True, False, 5, "fail", ""),
        (-9, False, True, 5, "fail", ""),
        (0, False, False, -1, "continue", "StartError: ego ended before the first frame: exit code 0, but it handed"),
        (1, False, False, -1, "restart", "StartError: ego ended before the first frame: exit code 1: no licence"),
        (0, False, False, 5, "fail", "NodeDied: ego exit code 0, but it handed in no results at frame 5; see"),
        (9, True, False, 5, "fail", "NodeDied: ego exit code 9 at frame 5; see logs/ego.log: no licence"),
        (-9, False, False, 5, "continue", "ego killed by signal 9 (SIGKILL) at frame 5; continuing without it"),
        (-9, False, False, 5, "restart", "ego killed by signal 9 (SIGKILL) at frame 5; restarted"),
        (-9, True, False, 5, "restart", "ego killed by signal 9 (SIGKILL) at frame 5; its results had been taken"),
    ],
)
def test_the_end_of_a_process_has_the_consequence_that_its_node_asks_for(
    exit: int, handed_in: bool, expected: bool, frame: int, on_exit: str, consequence: str
) -> None:
    shown: list[str] = []
    state = RunState(MagicMock(), shown.append, lambda: 0.0)
    state.frame = frame
    child = Ended("ego", NodeSpec("agent", "", "", {}, on_exit))
    child.exit, child.handed_in, child.exit_expected = exit, handed_in, expected
    actions = MagicMock(last_log_line=lambda node: "no licence")
    endings = Endings(state, MagicMock(), MagicMock(leaving={}), actions)
    endings._handle_exit(child)
    problem = state.stop.problem
    told = "".join(shown).removeprefix("[yellow]") if problem is None else f"{type(problem).__name__}: {problem}"
    assert told.startswith(consequence)
    assert bool(told) == bool(consequence)
    assert state.stop.requested == (problem is not None)
    assert state.restarted == ({"ego"} if consequence.endswith("restarted") else set())


def test_a_node_whose_insertion_was_given_up_is_not_told_as_lost() -> None:
    state = RunState(MagicMock(), print, lambda: 0.0)
    state.given_up.add("eve")
    losses = [{"frame": 3, "node": name, "what": "lost"} for name in ("eve", "ego")]
    assert churn_of({"sim": {"sent_ns": {}, "churn": losses, "frames": 9}}, state) == losses[1:]
