"""The launcher's loop continues whatever happens."""

import os
import signal
import threading
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import zenoh
from tiny_world import tiny

from mast_zenoh.launch import mesh_run, run, stop_signals
from mast_zenoh.launch.context import Mesh
from mast_zenoh.launch.mesh_run import MeshLauncher
from mast_zenoh.runtime.protocol.traffic import ATTACHMENT, MARK

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
    launcher._on_clock(MagicMock(attachment=zenoh.ZBytes(ATTACHMENT.pack(MARK, 1, frame))))
    assert launcher._context.frame == newest


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
    assert ("infra_1 was lost before frame 3" in ended.record["message"]) == (not allowed)
