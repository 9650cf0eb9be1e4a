"""Callbacks for Zenoh's threads."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

_thread = threading.local()


def keeping_state(callback: Callable[[T], None]) -> Callable[[T], None]:
    """The callback, for threads that Python has not started.

    Python makes a state for such a thread at each call, and deletes it afterwards: mapping and unmapping its 16 KiB
    costs more than taking a sample. A thread that has called this keeps its state.
    """

    def call(argument: T) -> None:
        if not hasattr(_thread, "state"):
            _thread.state = ctypes.pythonapi.PyGILState_Ensure()  # never released
        callback(argument)

    return call
