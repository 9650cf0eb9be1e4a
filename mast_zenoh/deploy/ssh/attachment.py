"""The launcher's connections to wardens: one that stays, and single commands."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import secrets
import shlex
import signal
import threading
from collections.abc import Callable, Mapping
from typing import Any

from mast_zenoh.deploy.ssh.connection import connected, messages_of
from mast_zenoh.deploy.ssh.hostsfile import SshHost
from mast_zenoh.deploy.ssh.warden import NOT_THERE
from mast_zenoh.errors import EngineError

LEAVE_S = 20.0  #: for a host to end what it still runs and to remove its folder

_ALIVE_EVERY_S = 2.0
_AGAIN_S = 0.5
_NOT_STARTED = 127  # as from a shell


def attaching(place: Mapping[str, Any]) -> str:
    """The command that attaches to a warden; place: the host's entry in run.json."""
    words = [place["python"], "-m", "mast_zenoh.deploy.ssh.warden", place["run_folder"]]
    return shlex.join(["env", f"PYTHONPATH={place['release']}", *words])


async def ask_warden(host: SshHost, place: Mapping[str, Any], do: str, **more: Any) -> dict[str, Any] | None:
    """The warden's answer; None without a warden or installation. Raises EngineError."""
    import asyncssh

    answer: dict[str, Any] | None = None
    try:
        async with connected(host) as ssh, ssh.create_process(attaching(place)) as process:
            process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": do, **more}) + "\n")
            async with asyncio.timeout(LEAVE_S):
                async for message in messages_of(process):
                    answer = message if "answer" in message else answer
                    if answer and do != "leave":  # a leaving warden ends the connection itself, at its end
                        break
                else:
                    await process.wait()
                    if process.exit_status is None:
                        raise EngineError(f"{host.called}: the connection was lost")
            return answer
    except (asyncssh.Error, OSError, TimeoutError) as error:
        raise EngineError(f"{host.called}: {error or type(error).__name__}") from None


class WardenAttachment:
    """The launcher's view of one warden. Commands are repeated until it has answered; a lost connection is restored.

    command: the command from `attaching`
    changed: notified after every change of the known state; shared by all hosts of a run
    on_log:  called with new output of a process: name, offset in its log, bytes
    reattached: number of reconnections; trouble: why it is not attached, if known
    attached: whether there is a connection now; gone: there is no warden
    """

    def __init__(
        self, host: SshHost, command: str, changed: threading.Condition, on_log: Callable[[str, int, bytes], None]
    ) -> None:
        self.host = host
        self.states: dict[str, dict[str, Any]] = {}
        self.attached = self.gone = False
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

    # From the launcher's thread:

    def tell(self, do: str, **more: Any) -> str:
        """Queue a command for the warden; returns the command's id."""
        with self._changed:
            command_id = next(self._ids)
            self._unanswered[command_id] = {"id": command_id, "do": do, **more}
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._wake.set)
        return command_id

    def answer(self, command_id: str, seconds: float) -> dict[str, Any] | None:
        """The answer to a command; None after `seconds`, or if the warden is gone."""
        with self._changed:
            self._changed.wait_for(lambda: command_id in self._answers or self.gone, max(0.0, seconds))
            return self._answers.get(command_id)

    def leave(self, grace_s: float) -> None:
        """Command the warden to end all nodes, remove its folder, and exit."""
        self._last = self.tell("leave", grace_s=grace_s)

    def has_left(self, seconds: float) -> bool:
        """Wait until the warden is gone; False after `seconds`."""
        with self._changed:
            return self._changed.wait_for(lambda: self.gone, max(0.0, seconds))

    def state(self, name: str, start: str) -> dict[str, Any] | None:
        """The known state of a process, if the command with the id `start` has started it."""
        with self._changed:
            state = self.states.get(name)
            if state is not None and state["start"] == start:
                return state
            answer = self._answers.get(start)
        if answer is None:
            return None
        return {"pid": answer.get("pid"), "exit": _NOT_STARTED if "error" in answer else None}

    def exit(self, name: str, start: str) -> int | None:
        """Exit code of a process; killed if the host has lost its warden."""
        state = self.state(name, start)
        if state is not None and state["exit"] is not None:
            return int(state["exit"])
        return -int(signal.SIGKILL) if self.gone else None

    # In the event loop:

    async def stay(self) -> None:
        """Keep the connection until it is cancelled or the warden is gone."""
        import asyncssh

        self._loop = asyncio.get_running_loop()
        while not self.gone:
            try:
                async with connected(self.host) as ssh, ssh.create_process(self._command) as process:
                    await self._attend(process)
            except (EngineError, OSError, asyncssh.Error) as error:
                self.trouble = str(error)
            with self._changed:
                self.attached = False
                self._changed.notify_all()
            await asyncio.sleep(_AGAIN_S)

    async def _attend(self, process: Any) -> None:
        import asyncssh

        def send(*messages: dict[str, Any]) -> None:
            process.stdin.write("".join(json.dumps(message) + "\n" for message in messages))

        with self._changed:
            pending = dict(self._unanswered)
        send({"as": "launcher", "logs": self._offsets}, *pending.values())
        sending = asyncio.create_task(self._send(send, set(pending)))
        try:
            async for message in messages_of(process):
                self._take(message)
            done = await process.wait(timeout=_AGAIN_S)
            if done.exit_status == NOT_THERE or self._last in self._answers:
                with self._changed:
                    self.gone = True
                    self._changed.notify_all()
        except (asyncssh.Error, OSError, TimeoutError):
            pass
        finally:
            sending.cancel()

    async def _send(self, send: Callable[..., None], sent: set[str]) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), _ALIVE_EVERY_S)
            self._wake.clear()
            with self._changed:
                pending = {id_: command for id_, command in self._unanswered.items() if id_ not in sent}
            sent |= pending.keys()
            send(*pending.values(), {"do": "alive"})

    def _take(self, message: dict[str, Any]) -> None:
        if "log" in message:
            piece = message["text"].encode("latin-1")
            if message["offset"] == self._offsets.get(message["log"], 0):
                self._offsets[message["log"]] = message["offset"] + len(piece)
                self._on_log(message["log"], message["offset"], piece)
        with self._changed:
            if not self.attached:
                self.attached = True
                self.reattached += 1
            if "node" in message:
                self.states[message["node"]] = message
            if "answer" in message:
                self._unanswered.pop(message["answer"], None)
                self._answers[message["answer"]] = message
            self._changed.notify_all()
