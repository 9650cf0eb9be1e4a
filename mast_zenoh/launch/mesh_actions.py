"""Carries out what the launcher's protocol asks for, on a Zenoh mesh and in the run folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh

from mast_zenoh.config.resolved import Resolved, joining_files
from mast_zenoh.control import control_prefix, files
from mast_zenoh.control.failures import described
from mast_zenoh.errors import MastError, MessageError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.protocol.actions import DRIVER_TIMEOUT_S, LauncherActions
from mast_zenoh.launch.supervisor import Supervisor


class MeshActions(LauncherActions):
    """The actions of a launcher that has joined the mesh with this session."""

    def __init__(self, context: RunContext, session: zenoh.Session, supervisor: Supervisor[Any]) -> None:
        self._context = context
        self._session = session
        self._supervisor = supervisor
        self._control = control_prefix(context.run_id)
        self._changes: list[dict[str, Any]] = context.record.setdefault("interceptions", [])
        self._adopted = context.resolved
        self._joining: str | None = None

    def stop(self, reason: str) -> None:
        self._put("stop", reason)

    def leave(self, node: str, reason: str) -> None:
        self._put(f"leave/{node}", reason)

    def _put(self, key: str, text: str) -> None:
        self._session.put(f"{self._control}/{key}", self._context.signatures.sign(key, text.encode()))

    def rewire(self, payload: bytes, answered: Callable[[bytes | None], None]) -> None:
        replies: list[zenoh.Reply] = []

        def finish() -> None:
            answered(next((reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None), None))

        handler: Any = zenoh.handlers.Callback(replies.append, finish, indirect=False)
        self._session.get(f"{self._control}/rewire", handler, payload=payload, timeout=DRIVER_TIMEOUT_S)

    def answer(self, query: zenoh.Query, payload: bytes) -> None:
        query.reply(query.key_expr, payload)
        query.drop()

    def refuse(self, query: zenoh.Query, error: Exception) -> None:
        if not isinstance(error, MastError) or isinstance(error, MessageError):
            self._context.invalid.note("intercept", described(error))
        with suppress(zenoh.ZError):
            query.reply_err(files.encode_refusal(error))
        query.drop()

    def adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None) -> None:
        if joining is not None:
            self._joining = joining[0]
            self._write(joining[1], *joining_files(joining[0]))
        if resolved is not self._adopted:
            self._adopted = resolved
            self._write(resolved)
        if joining is None and self._joining is not None:
            for name in joining_files(self._joining):
                (self._context.folder / name).unlink(missing_ok=True)

    def _write(self, resolved: Resolved, scenario: str = "scenario.json", wiring: str = "wiring.json") -> None:
        run_folder.write_json(self._context.folder / wiring, resolved.wiring)
        run_folder.write_json(self._context.folder / scenario, resolved.to_json())

    def record(self, change: dict[str, Any]) -> None:
        self._changes.append(change)
        self._context.record["nodes"] = self._supervisor.to_json({})
        run_folder.write_json(self._context.folder / "run.json", self._context.record)

    def last_log_line(self, node: str) -> str:
        log = self._context.folder / "logs" / f"{node}.log"
        lines = log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""
