"""Attempts are validated before a study starts; the tables show what each achieved."""

from __future__ import annotations

import io
import json
import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.config import loading
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, HandlerFailed, Interrupted
from mast_zenoh.messages import codec
from mast_zenoh.messages.limits import Timespan
from mast_zenoh.study import attacked_run, definition
from mast_zenoh.study.attacked_run import STRAY, Detour, Outcome

INJECT = "Attempt('a', act, wire='cc/picture')"
SECOND = INJECT.replace("'a'", "'b'")


def written(folder: Path, entries: str, act: str = "pass") -> definition.Study:
    """A study of the run of scenarios/baseline.py with these entries."""
    content = f"name='s', runs=dict(a=dict(scenario='baseline')), {entries}"
    lines = ["from mast_zenoh.study.definition import Attempt", "def act(run, attempt):", f"    {act}"]
    (folder / "s.py").write_text("\n".join([*lines, "def study():", f"    return dict({content})", ""]))
    return definition.load(str(folder / "s.py"))


def test_shipped_outsider_makes_every_attempt_of_the_threat_model() -> None:
    attempts = definition.load("rogue").attempts
    assert {attempt.shows for attempt in attempts} >= {"nothing", "foreign", "expired", "infra_1"}
    functions = {getattr(attempt.act, "func", attempt.act).__name__ for attempt in attempts}
    assert functions == {"inject", "eavesdrop", "ask_router", "rogue_router"}
    assert [attempt.lures for attempt in attempts if attempt.lures] == ["infra_2"]


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ("security=['acl']", "attempts: expected together with `security`"),
        (f"attempts=[{INJECT}]", "attempts: expected together with `security`"),
        ("security=['acl'], attempts=7", "attempts: found 7, expected a list of Attempt"),
        ("security=['acl'], attempts=[dict(name='a', act=act)]", "expected a list of Attempt"),
        (f"security=['acl'], attempts=[{INJECT}, {INJECT}]", "attempts: found 'a' twice"),
        (f"security=['acl'], attempts=[{INJECT}, {SECOND}]", "attempts: found 'cc/picture' twice"),
        (f"security=['acl'], attempts=[{INJECT.replace('wire', 'wires')}]", "unexpected keyword argument 'wires'"),
    ],
)
def test_missing_invalid_or_ambiguous_attempts_are_rejected(tmp_path: Path, entries: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        written(tmp_path, entries)


def test_interrupted_study_keeps_its_rows_and_status(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"

    def attack(resolved: Resolved, folder: Path, level: str, attempts: object) -> dict[str, Outcome]:
        if level != "open":
            raise KeyboardInterrupt
        assert json.loads((out / "study.json").read_text())["status"] == "running"
        return {"inject": Outcome(True, 20, 40, 40)}

    monkeypatch.setattr(attacked_run, "attack", attack)
    with pytest.raises(Interrupted, match=r"results so far are in .*study\.json"):
        attacked_run.compare(definition.load("rogue"), out)
    content = json.loads((out / "study.json").read_text())
    assert content["status"] == "interrupted"
    counts = dict(admitted=True, sent=20, reached=40, expected=40, heard=0, lured=0, succeeded=True)
    assert content["rows"] == [dict(run="rogue", level="open", attempt="inject") | counts]


def test_error_in_an_attackers_code_names_file_and_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = written(tmp_path, f"security=['open'], attempts=[{INJECT}]", "return 1 / 0")
    resolved = scenario.resolve(*scenario.load("baseline"), frames=1)
    monkeypatch.setattr(attacked_run, "AttackedRun", lambda *_: nullcontext())
    with pytest.raises(HandlerFailed, match=r"the attacker 'a' failed: ZeroDivisionError.*s\.py:3"):
        attacked_run.attack(resolved, tmp_path / "run", "open", study.attempts)


def test_study_levels_are_validated() -> None:
    assert definition.load("rogue").security == ("open", "tls", "mtls", "acl")
    with pytest.raises(ConfigurationError, match="'mtls'"):
        definition.load("rogue", ["levels=open,mtsl"])
    assert definition.load("case_study").security == definition.load("case_study").attempts == ()


def test_attempt_succeeds_if_any_message_was_injected_overheard_or_diverted() -> None:
    assert not any(each.succeeded for each in (Outcome(), Outcome(admitted=True, sent=20, expected=20)))
    assert all(each.succeeded for each in (Outcome(reached=1), Outcome(heard=1), Outcome(lured=1)))


OUTCOMES = {
    "open": {
        "inject": Outcome(True, 20, 40, 40),
        "listen": Outcome(True, heard=68),
        "lure": Outcome(True, 20, 40, 40, 2, 1),
        STRAY: Outcome(),
    },
    "acl": {
        "inject": Outcome(True, 20, 0, 40),
        "listen": Outcome(True),
        "lure": Outcome(False, 0, 0, 40),
        STRAY: Outcome(reached=3),
    },
}


def test_tables_have_a_line_per_attempt_and_a_column_per_level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attacked_run, "attack", lambda resolved, folder, level, attempts: OUTCOMES[level])
    folder, tables = attacked_run.compare(definition.load("rogue", ["levels=open,acl"]), tmp_path / "out")
    assert (folder / "attempts.md").read_text().splitlines()[-6:] == [
        "| attempt | open | acl |",
        "| --- | --- | --- |",
        "| inject | succeeds (in 40/40) | no effect (in 0/40) |",
        "| listen | succeeds (out 68) | no effect (out 0) |",
        "| lure | succeeds (in 40/40, out 2, lured 1) | refused (in 0/40) |",
        "| (anything else) | none (in 0) | succeeds (in 3) |",
    ]
    header, first, *others = (folder / "attempts.csv").read_text().splitlines()
    assert header == "run,level,attempt,admitted,sent,reached,expected,heard,lured,succeeded"
    assert first == "rogue,open,inject,1,20,40,40,0,0,1"
    assert len(others) == 7
    text = Console(width=100, file=io.StringIO(), record=True)
    text.print(tables.as_rich())
    assert " (in 40/40)" in text.export_text()


def test_the_tracks_of_an_invented_agent_pass_every_check_of_their_receivers() -> None:
    tracks = loading.module(definition.load("sybil").path).tracks
    for number, frame in enumerate((7, 8, 9)):
        message = codec.decode(codec.encode(tracks("infra_3", frame, 100_000_000, number)), "tracks")
        assert message.header == ("tracks", "infra_3", frame, frame * 100_000_000, number)
        assert Timespan(20, 100_000_000, 0).refusal(message.header, frame) == ""
        assert len(message.body["id"]) == 3
        assert np.abs(message.body["position"][:, :2]).max() <= 30.0


def test_two_invented_agents_claim_different_places() -> None:
    tracks = loading.module(definition.load("sybil").path).tracks
    places = [tracks(name, 0, 1, 0).body["position"] for name in ("infra_3", "infra_4", "infra_3")]
    assert not np.array_equal(places[0], places[1])
    assert np.array_equal(places[0], places[2])


def test_the_agents_that_the_outsider_plays_are_absent_at_first() -> None:
    resolved = scenario.resolve(*scenario.load("sybil"))
    absent = {step.node for step in resolved.steps if step.action == "start" and step.frame > 60}
    played = {attempt.wire.split("/")[1] for attempt in definition.load("sybil").attempts}
    assert played - {"ghost"} == absent


class Echo(socketserver.StreamRequestHandler):
    """Answers each line with the word of its server before it."""

    def handle(self) -> None:
        for line in self.rfile:
            self.wfile.write(self.server.word + line)  # type: ignore[attr-defined]


@contextmanager
def echo(word: bytes) -> Iterator[str]:
    """The endpoint of a server that echoes lines with a prefix."""
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Echo) as server:
        server.word = word  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever).start()
        yield f"tcp/127.0.0.1:{server.server_address[1]}"
        server.shutdown()


@contextmanager
def connected(detour: Detour) -> Iterator[socket.socket]:
    """A connection through a detour, which is closed afterwards."""
    with socket.create_connection(detour.server_address[:2], 5) as link:
        yield link
        assert link.recv(100) == b"", "the detour closes it"


def reply(link: socket.socket) -> bytes:
    link.sendall(b"?\n")
    return link.recv(100)


def test_connections_go_to_the_target_except_while_redirected() -> None:
    with echo(b"true") as endpoint, echo(b"rogue") as other, Detour(lambda: endpoint) as detour:
        for target, word in ((other, b"true"), (endpoint, b"rogue"), (endpoint, b"true")):
            with connected(detour) as link:
                assert reply(link) == word + b"?\n"
                detour.redirect(target)
        detour.shutdown()


def test_connection_to_a_closed_port_is_closed() -> None:
    with echo(b"") as endpoint:
        pass
    with Detour(lambda: endpoint) as detour:
        with connected(detour):
            pass
        detour.shutdown()
