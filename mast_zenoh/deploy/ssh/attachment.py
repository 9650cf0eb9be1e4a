"""The launcher's end of one host's warden: attached as long as it can be, and again when the connection was lost."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import secrets
import shlex
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from mast_zenoh.deploy.ssh.connection import connected, heard
from mast_zenoh.deploy.ssh.hostsfile import Host
from mast_zenoh.deploy.ssh.relay import NOT_THERE
from mast_zenoh.errors import EngineError

_ALIVE_EVERY_S = 2.0
_AGAIN_S = 0.5
_NOT_STARTED = 127  # as a shell says it


def attaching(place: Mapping[str, Any]) -> str:
    """The command that attaches to a warden on its host; place: what run.json says of the run there."""
    words = [place["python"], "-m", "mast_zenoh.deploy.ssh.relay", place["run_folder"]]
    return shlex.join(["env", f"PYTHONPATH={place['release']}", *words])


class Attachment:
    """One warden, as the launcher sees it. What it is told is told again until it has answered.

    command: as `attaching` says it
    changed: notified whenever something is known that was not before; shared by all hosts of a run
    on_log:  told of what a process has said: name, offset in its log, bytes
    reattached: how often; trouble: why it is not attached, as far as that is known
    lost_since: when the connection was lost, on the monotonic clock; None while there is one; gone: no warden is there
    """

    def __init__(
        self,
        host: Host,
        command: str,
        changed: threading.Condition,
        on_log: Callable[[str, int, bytes], None],
    ) -> None:
        self.host = host
        self.states: dict[str, dict[str, Any]] = {}
        self.lost_since: float | None = time.monotonic()
        self.gone = False
        self.reattached = -1
        self.trouble = ""
        self._command = command
        self._changed = changed
        self._on_log = on_log
        self._offsets: dict[str, int] = {}
        self._ids = map("{}-{}".format, itertools.repeat(secrets.token_hex(4)), itertools.count())
        self._unanswered: dict[str, dict[str, Any]] = {}
        self._answers: dict[str, dict[str, Any]] = {}
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._last = ""

    # -- from the launcher's thread ------------------------------------------------------------------------------

    def tell(self, do: str, **more: Any) -> str:
        """Have it do something, as soon as it can be told; the id of the command."""
        with self._changed:
            which = next(self._ids)
            self._unanswered[which] = {"id": which, "do": do, **more}
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._wake.set)
        return which

    def answer(self, which: str, seconds: float) -> dict[str, Any] | None:
        """What it has answered; None when it has not within so many seconds, or cannot any more."""
        with self._changed:
            self._changed.wait_for(lambda: which in self._answers or self.gone, seconds)
            return self._answers.get(which)

    def leave(self, grace_s: float) -> None:
        """Have it end all, remove its folder, and go."""
        self._last = self.tell("leave", grace_s=grace_s)

    def has_left(self, seconds: float) -> bool:
        """Whether nothing is there any more, within so many seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: self.gone, max(0.0, seconds))

    def state(self, name: str, start: str) -> dict[str, Any] | None:
        """What is known of a process, if it is that which the command `start` has started."""
        with self._changed:
            found = self.states.get(name)
            if found is not None and found["start"] == start:
                return found
            answer = self._answers.get(start)
        if answer is None:
            return None
        return {"pid": answer.get("pid"), "exit": _NOT_STARTED if "error" in answer else None}

    @property
    def attached(self) -> bool:
        """Whether there is a connection now."""
        return self.lost_since is None

    # -- in the event loop ---------------------------------------------------------------------------------------

    async def stay(self) -> None:
        """The life of the attachment, until it is cancelled or there is nobody to be attached to."""
        import asyncssh

        self._loop = asyncio.get_running_loop()
        while not self.gone:
            try:
                async with connected(self.host) as ssh, ssh.create_process(self._command) as process:
                    await self._attend(process)
            except (EngineError, OSError, asyncssh.Error) as error:
                self.trouble = str(error)
            with self._changed:
                if self.lost_since is None:
                    self.lost_since = time.monotonic()
                self._changed.notify_all()
            await asyncio.sleep(_AGAIN_S)

    async def _attend(self, process: Any) -> None:
        import asyncssh

        def say(*said: dict[str, Any]) -> None:
            process.stdin.write("".join(json.dumps(each) + "\n" for each in said))

        with self._changed:
            waiting = dict(self._unanswered)
        say({"as": "launcher", "logs": self._offsets}, *waiting.values())
        sending = asyncio.create_task(self._send(say, set(waiting)))
        try:
            async for said in heard(process):
                self._take(said)
            done = await process.wait(timeout=_AGAIN_S)
            if done.exit_status == NOT_THERE or self._last in self._answers:
                with self._changed:
                    self.gone = True
                    self._changed.notify_all()
        except (asyncssh.Error, OSError, TimeoutError):
            pass
        finally:
            sending.cancel()

    async def _send(self, say: Callable[..., None], sent: set[str]) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), _ALIVE_EVERY_S)
            self._wake.clear()
            with self._changed:
                waiting = {which: said for which, said in self._unanswered.items() if which not in sent}
            sent |= waiting.keys()
            say(*waiting.values(), {"do": "alive"})

    def _take(self, said: dict[str, Any]) -> None:
        if "log" in said:
            piece = said["text"].encode("latin-1")
            if said["offset"] == self._offsets.get(said["log"], 0):
                self._offsets[said["log"]] = said["offset"] + len(piece)
                self._on_log(said["log"], said["offset"], piece)
        with self._changed:
            if self.lost_since is not None:
                self.lost_since = None
                self.reattached += 1
            if "node" in said:
                self.states[said["node"]] = said
            if "answer" in said:
                self._unanswered.pop(said["answer"], None)
                self._answers[said["answer"]] = said
            self._changed.notify_all()
