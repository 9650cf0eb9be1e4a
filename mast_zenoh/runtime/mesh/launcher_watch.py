"""Watches the launcher's liveliness token, so that remote nodes do not outlive it."""

from __future__ import annotations

import contextlib
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh.control import control_prefix

#: A file in the folder of temporary files that exists while the launcher does: for health checks.
UP = "mast-up"


class LauncherWatch:
    """A context that watches whether the launcher is present.

    patience_s: how long it may be absent, s; then `leave` is called, once, in a thread
    arrival_s:  how long it may take to appear at the beginning, s, if not `patience_s`
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        patience_s: float,
        leave: Callable[[], None],
        *,
        arrival_s: float | None = None,
    ) -> None:
        self.limit_s = patience_s if arrival_s is None else arrival_s
        self._patience_s = patience_s
        self.gone = False
        self._leave = leave
        self._present = False
        self._changed = threading.Condition()
        self._closing = False
        handler: Any = zenoh.handlers.Callback(self._note, indirect=False)
        key = f"{control_prefix(run)}/launcher"
        self._subscriber = session.liveliness().declare_subscriber(key, handler, history=True)
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> LauncherWatch:
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._subscriber.undeclare()
        (Path(tempfile.gettempdir()) / UP).unlink(missing_ok=True)

    def _note(self, token: zenoh.Sample) -> None:
        with self._changed:
            self._present = token.kind == zenoh.SampleKind.PUT
            self.limit_s = self._patience_s
            self._changed.notify()

    def _watch(self) -> None:
        up = Path(tempfile.gettempdir()) / UP
        with self._changed:
            while not self._closing:
                with contextlib.suppress(OSError):
                    up.touch() if self._present else up.unlink(missing_ok=True)
                if self._present:
                    self._changed.wait()
                elif not self._changed.wait_for(lambda: self._present or self._closing, self.limit_s):
                    self.gone = True
                    break
        if self.gone:
            self._leave()
