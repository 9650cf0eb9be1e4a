"""Describes a running run to observers that have no access to its folder."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import zenoh

from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.control import prefix
from mast_zenoh.control.description import DESCRIBE, WITHOUT_SCENE, encode_description
from mast_zenoh.launch.context import RunContext


def declare(context: RunContext, session: zenoh.Session) -> Any:
    """Answer queries for a description of the run; returns the queryable.

    On a mesh with access rights no viewer may query: observers there need the run folder.
    """
    key = f"{prefix(context.run_id)}/{DESCRIBE}"

    def answer(query: zenoh.Query) -> None:
        resolved = context.resolved
        file = context.folder / RECORDING
        asked = query.payload.to_bytes() if query.payload else b""
        scene = b""
        if asked != WITHOUT_SCENE:
            with suppress(OSError):  # a user's simulator has no prepared scene
                scene = file.read_bytes()
        content = encode_description(context.run_id, resolved.to_json(), resolved.wiring, scene)
        with suppress(zenoh.ZError):
            # In a queue of its own: a client that does not read its reply blocks the queue, and this thread.
            query.reply(key, content, priority=zenoh.Priority.DATA_LOW)

    handler: Any = zenoh.handlers.Callback(answer, indirect=True)
    return session.declare_queryable(key, handler)
