"""Attackers are validated before a study starts; the table shows their effects."""

from __future__ import annotations

import io
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
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
from mast_zenoh.study import definition
from mast_zenoh.study.outsider import comparison
from mast_zenoh.study.outsider.attacked_run import Detour, attacker_errors
from mast_zenoh.study.outsider.attempts import Outcome, RogueRouter, Sybil
from mast_zenoh.study.outsider.comparison import STRAY

BASELINE = "loading.function('scenarios', 'baseline', 'scenario')"
INJECT = "dict(type='Inject', name='a', wire='cc/picture')"
SECOND = INJECT.replace("'a'", "'b'")


def test_shipped_outsider_makes_every_attempt_of_the_threat_model() -> None:
    attempts = {attempt.name: attempt for attempt in comparison.load("rogue")}
    assert {attempt.shows for attempt in attempts.values()} >= {"nothing", "foreign", "expired", "infra_1"}
    kinds = {type(attempt).__name__ for attempt in attempts.values()}
    assert kinds == {"Inject", "Eavesdrop", "AskRouter", "DuplicateSession", "RogueRouter"}
    assert [a.detour_node for a in attempts.values() if isinstance(a, RogueRouter)] == ["infra_2"]


@pytest.mark.parametrize(
    ("outsider", "message"),
    [
        ("", "lists no attempts: expected a function `outsider`"),
        ("7", "returned int, expected a list of dicts"),
        (f"[{INJECT}, {INJECT}]", "two attempts have the name 'a'"),
        (f"[{INJECT}, {SECOND}]", "two attempts have the key 'cc/picture'"),
        ("[dict(type='Injekt')]", "'Inject'"),
        (f"[{INJECT.replace('wire', 'wires')}]", "'wire'"),
    ],
)
def test_missing_invalid_or_ambiguous_attempts_are_rejected(tmp_path: Path, outsider: str, message: str) -> None:
    function = f"def outsider():\n    return {outsider}" if outsider else ""
    (tmp_path / "mine.py").write_text(f"from mast_zenoh.config import loading\n_, scenario = {BASELINE}\n{function}\n")
    content = f"dict(name='s', runs=dict(a=dict(scenario={str(tmp_path / 'mine.py')!r})), security=['acl'])"
    (tmp_path / "s.py").write_text(f"def study():\n    return {content}\n")
    with pytest.raises(ConfigurationError, match=message):
        comparison.run(definition.load(str(tmp_path / "s.py")), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_interrupted_study_keeps_its_rows_and_status(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"

    def run_outsider(resolved: Resolved, folder: Path, level: str, attempts: object) -> dict[str, Outcome]:
        if level != "open":
            raise KeyboardInterrupt
        assert json.loads((out / "study.json").read_text())["status"] == "running"
        return {"inject": Outcome(True, "clock", 20, 40, 40)}

    monkeypatch.setattr(comparison, "run_outsider", run_outsider)
    with pytest.raises(Interrupted, match=r"results so far are in .*study\.json"):
        comparison.run(definition.load("rogue"), out)
    written = json.loads((out / "study.json").read_text())
    assert written["status"] == "interrupted"
    counts = dict(admitted=True, sent=20, reached=40, expected=40, heard=0, lured=0, succeeded=True)
    assert written["rows"] == [dict(run="rogue", level="open", attempt="inject") | counts]


def test_error_in_an_attackers_code_names_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def act():\n    return 1 / 0\n")
    act = loading.module(file).act
    named = r"the attacker 'a' failed: ZeroDivisionError.*mine\.py:2"
    with pytest.raises(HandlerFailed, match=named), attacker_errors("a", act):
        act()


def test_study_levels_are_validated(tmp_path: Path) -> None:
    assert definition.load("rogue").security == ("open", "tls", "mtls", "acl")
    with pytest.raises(ConfigurationError, match="'mtls'"):
        definition.load("rogue", ["levels=open,mtsl"])
    assert definition.load("case_study").security == ()


def test_attempt_succeeds_if_any_message_was_injected_overheard_or_diverted() -> None:
    assert not any(each.succeeded for each in (Outcome(), Outcome(admitted=True, sent=20, expected=20)))
    assert all(each.succeeded for each in (Outcome(reached=1), Outcome(heard=1), Outcome(lured=1)))


EFFECTS = comparison.Effects(
    Path("out"),
    {
        ("rogue", "open", "inject"): Outcome(True, "clock", 20, 40, 40),
        ("rogue", "open", "listen"): Outcome(True, heard=68),
        ("rogue", "open", "lure"): Outcome(True, "clock", 20, 40, 40, 2, 1),
        ("rogue", "open", STRAY): Outcome(),
        ("rogue", "acl", "inject"): Outcome(True, "clock", 20, 0, 40),
        ("rogue", "acl", "listen"): Outcome(True),
        ("rogue", "acl", "lure"): Outcome(False, "clock", 0, 0, 40),
        ("rogue", "acl", STRAY): Outcome(reached=3),
    },
)


def test_table_has_a_line_per_attempt_and_a_column_per_level() -> None:
    assert EFFECTS.as_markdown().splitlines() == [
        "| attempt | open | acl |",
        "| --- | --- | --- |",
        "| inject | succeeds (in 40/40) | no effect (in 0/40) |",
        "| listen | succeeds (out 68) | no effect (out 0) |",
        "| lure | succeeds (in 40/40, out 2, lured 1) | refused (in 0/40) |",
        "| (anything else) | none (in 0) | succeeds (in 3) |",
        "",
        f"{comparison.CAPTION}.",
    ]
    text = Console(width=100, file=io.StringIO(), record=True)
    text.print(EFFECTS.as_rich())
    assert "(in 40/40)" in text.export_text()


def test_csv_has_every_count() -> None:
    lines = EFFECTS.as_csv().splitlines()
    assert lines[0] == "run,level,attempt,admitted,sent,reached,expected,heard,lured,succeeded"
    assert lines[1] == "rogue,open,inject,1,20,40,40,0,0,1"
    assert len(lines) == 1 + len(EFFECTS.outcomes)


def test_the_tracks_of_an_invented_agent_pass_every_check_of_their_receivers() -> None:
    sybil = Sybil("a", "infra_3", objects=4)
    for number, frame in enumerate((7, 8, 9)):
        message = codec.decode(codec.encode(sybil.message(frame, 100_000_000, number)), "tracks")
        assert message.header == ("tracks", "infra_3", frame, frame * 100_000_000, number)
        assert Timespan(20, 100_000_000, 0).refusal(message.header, frame) == ""
        assert len(message.body["id"]) == 4
        assert np.abs(message.body["position"][:, :2]).max() <= 30.0


def test_two_invented_agents_claim_different_places() -> None:
    places = [Sybil("a", name).message(0, 1, 0).body["position"] for name in ("infra_3", "infra_4", "infra_3")]
    assert not np.array_equal(places[0], places[1])
    assert np.array_equal(places[0], places[2])


def test_impossible_numbers_are_refused() -> None:
    for wrong in (dict(objects=-1), dict(messages=0)):
        with pytest.raises(ValueError, match="objects, messages"):
            Sybil("a", "infra_3", **wrong)


def test_the_agents_that_the_outsider_plays_are_absent_at_first() -> None:
    path, loaded = scenario.load("sybil")
    resolved = scenario.resolve(path, loaded)
    absent = {step.node for step in resolved.steps if step.action == "start" and step.frame > 60}
    identities = {attempt.identity for attempt in comparison.load("sybil") if isinstance(attempt, Sybil)}
    assert identities - {"ghost"} == absent


@contextmanager
def echo(word: bytes) -> Iterator[int]:
    """The port of a server that echoes data with a prefix."""
    listening = socket.create_server(("127.0.0.1", 0))
    served: list[socket.socket] = []

    def serve() -> None:
        while True:
            try:
                served.append(listening.accept()[0])
            except OSError:
                return
            threading.Thread(target=answer, args=(served[-1],), daemon=True).start()

    def answer(link: socket.socket) -> None:
        while data := link.recv(100):
            link.sendall(word + data)
        link.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listening.getsockname()[1]
    finally:
        listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        thread.join()


def reply(link: socket.socket) -> bytes:
    link.sendall(b"?")
    return link.recv(100)


def test_connections_go_to_the_target_except_while_redirected() -> None:
    with echo(b"true") as port, echo(b"rogue") as other, closing(Detour(lambda: port)) as detour:
        first = socket.create_connection(("127.0.0.1", detour.port), 5)
        assert reply(first) == b"true?"
        for override, word in ((other, b"rogue?"), (None, b"true?")):
            detour.redirect(override)
            assert first.recv(100) == b"", "existing connections are closed"
            first.close()
            first = socket.create_connection(("127.0.0.1", detour.port), 5)
            assert reply(first) == word
        first.close()
    relays = [thread for thread in threading.enumerate() if thread.name == "detour"]
    for thread in relays:
        thread.join(5)
    assert not any(thread.is_alive() for thread in relays)


def test_connection_to_a_closed_port_is_closed() -> None:
    with echo(b"") as port:
        pass
    with closing(Detour(lambda: port)) as detour, socket.create_connection(("127.0.0.1", detour.port), 5) as link:
        assert link.recv(1) == b""
