"""Malformed control messages are refused on arrival and fill no queue."""

from __future__ import annotations

import threading
import time
from unittest.mock import MagicMock

import pytest
import test_control_findings as findings
from test_control_findings import RUBBISH, Query

from mast_zenoh.control import flow
from mast_zenoh.control.codec import encode
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.live_interception import InterceptionServer, seal

context, file_server = findings.context, findings.file_server  # fixtures


def test_malformed_steps_leave_room_for_valid_ones(context: RunContext) -> None:
    launcher = findings.launcher_of(context)
    for payload in [*RUBBISH * 200, flow.encode_act(5, [("start", "ego")])]:
        findings.act(launcher, payload)
    launcher.advance()
    assert launcher._protocol.steps.done == [{"frame": 5, "action": "start", "node": "ego"}]
    assert context.invalid.counts == {"act": len(RUBBISH) * 200}


def test_malformed_requests_leave_room_for_valid_ones(context: RunContext) -> None:
    interceptions, launcher = MagicMock(), findings.launcher_of(context)
    server = InterceptionServer(context.folder, "mast/x", MagicMock(), interceptions, launcher)
    sound = Query("intercept", seal({"do": "release", "name": "eve", "wire": None}, server._secret))
    forged = [Query("intercept", payload) for payload in [*RUBBISH * 20, seal({"do": "release"}, b"guessed")]]
    for query in [*forged, sound]:
        server._on_query(query)  # type: ignore[arg-type]
    assert context.invalid.counts == {"intercept": len(forged)}
    assert all(query.answers[0][0] == "error" and query.dropped for query in forged)
    (added,) = interceptions.add.call_args_list
    assert added.args[0] is sound


def test_malformed_queries_leave_room_for_valid_ones(
    file_server: FileServer, context: RunContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, give = threading.Event(), file_server._answer
    monkeypatch.setattr(file_server, "_answer", lambda *asked: go_on.wait(10.0) and give(*asked))
    clock = encode({"do": "clock"})
    asked = [Query(f"{what}/ego", payload) for what in ("fetch", "file") for payload in [clock, *RUBBISH * 4]]
    for query in [*asked, last := Query("fetch/ego", clock)]:
        file_server._on_query(query)  # type: ignore[arg-type]
    go_on.set()
    deadline = time.monotonic() + 10.0
    while not last.dropped and time.monotonic() < deadline:
        go_on.wait(0.01)
    assert last.answers[0][0] == "ok"
    assert context.invalid.counts == {"fetch/ego": len(RUBBISH) * 4, "file/ego": len(RUBBISH) * 4 + 1}
