"""The launcher's loop goes round whatever happens."""

import os
import signal
import threading
from pathlib import Path
from typing import Any

from mast_zenoh.launch import stop_signals
from mast_zenoh.launch.mesh_run import _POLL_S, Launch


def test_a_signal_that_is_noted_slowly_does_not_hold_up_the_launcher() -> None:
    nothing: Any = None
    launch = Launch(nothing, Path(), {"id": "r"}, nothing, None, "")
    with stop_signals.noted() as received:

        def note(number: int, _: object) -> None:
            threading.Event().wait(2 * _POLL_S)
            received.append(number)

        signal.signal(signal.SIGINT, note)
        threading.Timer(_POLL_S / 5, os.kill, (os.getpid(), signal.SIGINT)).start()
        launch._act(nothing)
    assert received == [signal.SIGINT]
