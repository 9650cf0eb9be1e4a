"""Ctrl-C, SIGTERM and SIGHUP: interrupt a command, or end a run in an orderly way.

Imports nothing that takes time: the command line handles signals from its first moment.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
EXIT_CODE = 130  #: of mast_zenoh.errors.Interrupted; a signal may come before that module is loaded


@contextmanager
def interrupting() -> Iterator[None]:
    """Raise KeyboardInterrupt in the main thread on every stop signal in the block.

    Where nothing can catch it, in a finaliser for example, the process ends with a message, and not with a traceback.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    def unraisable(error: Any) -> None:
        if isinstance(error.exc_value, KeyboardInterrupt):
            os.write(2, f"error: Interrupted: stopped by {error.exc_value}\n".encode())
            os._exit(EXIT_CODE)
        default_hook(error)

    default_hook = sys.unraisablehook
    sys.unraisablehook = unraisable
    try:
        with _handled_by(interrupt):
            yield
    finally:
        sys.unraisablehook = default_hook


@contextmanager
def collected() -> Iterator[list[int]]:
    """Collect the stop signals that come during the block; they have no other effect."""
    received: list[int] = []
    with _handled_by(lambda number, frame: received.append(number)):
        yield received


@contextmanager
def second_interrupts(received: list[int]) -> Iterator[None]:
    """Append stop signals to `received`; from the second onwards, raise KeyboardInterrupt."""

    def collect(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            raise KeyboardInterrupt(signal.Signals(number).name)

    with _handled_by(collect):
        yield


def raise_again(received: list[int]) -> None:
    """Raise the first of the collected signals again, now outside the block."""
    if threading.current_thread() is threading.main_thread():
        signal.raise_signal(received[0])


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # A command under nohup outlives its terminal. SIGINT is handled also where a shell ignores it (`mast … &`).
    numbers = [n for n in SIGNALS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    previous_handlers = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, previous in previous_handlers.items():
            signal.signal(number, previous)
