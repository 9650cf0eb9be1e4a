"""Ctrl-C, SIGTERM and SIGHUP: they interrupt a command, except while a run is brought to its end in good order.

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
EXIT_CODE = 130  #: mast_zenoh.errors.Interrupted's; that module is not loaded yet when a signal may come


@contextmanager
def interrupting() -> Iterator[None]:
    """Have every stop signal raise KeyboardInterrupt in the main thread while the block lasts.

    Where Python would print a KeyboardInterrupt that nothing can catch, in a finaliser say, the process ends instead.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    def unraisable(error: Any) -> None:
        if isinstance(error.exc_value, KeyboardInterrupt):
            os._exit(EXIT_CODE)
        before(error)

    before = sys.unraisablehook
    sys.unraisablehook = unraisable
    try:
        with _handled_by(interrupt):
            yield
    finally:
        sys.unraisablehook = before


@contextmanager
def noted() -> Iterator[list[int]]:
    """The stop signals that come while the block lasts, instead of what they would do."""
    received: list[int] = []
    with _handled_by(lambda number, frame: received.append(number)):
        yield received


@contextmanager
def second_interrupts(received: list[int]) -> Iterator[None]:
    """Note the first stop signal in `received`, and have any other raise KeyboardInterrupt, while the block lasts."""

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            raise KeyboardInterrupt(signal.Signals(number).name)

    with _handled_by(note):
        yield


def pass_on(received: list[int]) -> None:
    """Have the first of the noted signals do what it does outside the block in which it was noted."""
    if threading.current_thread() is threading.main_thread():
        signal.raise_signal(received[0])


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # A command under nohup goes on without its terminal. SIGINT is ours also where a shell has it ignored (`mast … &`).
    numbers = [n for n in SIGNALS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
