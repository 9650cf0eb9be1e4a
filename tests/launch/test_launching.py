"""The launcher's loop continues whatever happens."""

import os
import signal
import threading
from pathlib import Path
from unittest.mock import MagicMock

from mast_zenoh.launch import stop_signals
from mast_zenoh.launch.context import Mesh
from mast_zenoh.launch.mesh_run import MeshLauncher

WAIT_S = 0.05


def test_a_slow_signal_handler_does_not_block_the_launcher(tmp_path: Path) -> None:
    launcher = MeshLauncher(MagicMock(folder=tmp_path), Mesh(MagicMock(), MagicMock()), MagicMock())
    launcher._protocol = MagicMock()
    with stop_signals.collected() as received:

        def note(number: int, _: object) -> None:
            threading.Event().wait(2 * WAIT_S)
            received.append(number)

        signal.signal(signal.SIGINT, note)
        threading.Timer(WAIT_S / 5, os.kill, (os.getpid(), signal.SIGINT)).start()
        launcher.advance()
    assert received == [signal.SIGINT]
