"""Receives requests to insert nodes into wires of a running run, and to remove them.

A client sends a query on @control/intercept, sealed with a secret in the run folder: the launcher starts processes
only for users who may read that folder.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from typing import Any

import msgpack
import zenoh

from mast_zenoh.control import fields, prefix
from mast_zenoh.control import interception as control
from mast_zenoh.errors import MessageError
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.protocol.actions import LauncherActions
from mast_zenoh.launch.protocol.interception import Interceptions

SECRET_FILE = "control.key"


def seal(request: dict[str, Any], secret: bytes) -> bytes:
    """Encode and sign a request; a random number makes it unique."""
    body: bytes = msgpack.packb(request | {"number": secrets.token_hex(8)})
    return bytes(msgpack.packb([body, hmac.digest(secret, body, hashlib.sha256)]))


def unseal(payload: bytes, secret: bytes) -> dict[str, Any]:
    """Decode a request; raises MessageError if it was not sealed with the secret."""
    body, digest = control.sealed_parts(payload)
    if hmac.compare_digest(digest, hmac.digest(secret, body, hashlib.sha256)):
        return fields.mapping(fields.unpack(body, "intercept"), "intercept")
    raise MessageError("a request that was not sealed with this run's secret")


class InterceptionServer:
    """Passes requests to change a run's wiring to `interceptions`, and refuses malformed ones."""

    def __init__(
        self, context: RunContext, session: zenoh.Session, interceptions: Interceptions, actions: LauncherActions
    ) -> None:
        self._interceptions = interceptions
        self._actions = actions
        self._secret = secrets.token_bytes(32)
        self._secret_file = context.folder / SECRET_FILE
        self._secret_file.touch(mode=0o600)
        self._secret_file.write_bytes(self._secret)
        on_query: Any = zenoh.handlers.Callback(self._on_query, indirect=False)
        presence: Any = zenoh.handlers.Callback(self._note_presence, indirect=False)
        base = prefix(context.run_id)
        self._declared: list[Any] = [
            session.declare_queryable(f"{base}/@control/intercept", on_query),
            session.liveliness().declare_subscriber(f"{base}/alive/*", presence, history=True),
        ]

    def close(self) -> None:
        """End the service: refuse the requests that have not been served."""
        self._interceptions.finish()
        for entity in self._declared:
            entity.undeclare()
        self._secret_file.unlink(missing_ok=True)

    def _on_query(self, query: zenoh.Query) -> None:
        """Receive a request, in Zenoh's thread."""
        try:
            request = unseal(query.payload.to_bytes() if query.payload else b"", self._secret)
            request_id = fields.text(request.get("number"), "intercept: number", 64)
            self._interceptions.add(query, request_id, control.request_of(request))
        except MessageError as error:
            self._actions.refuse(query, error)

    def _note_presence(self, token: zenoh.Sample) -> None:
        name = str(token.key_expr).rpartition("/")[2]
        self._interceptions.note_presence(name, token.kind == zenoh.SampleKind.PUT)
