"""Reports about misbehaviour say who suspected whom, when, why, and which messages led to it."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from commands_in_process import command
from mcap.reader import make_reader

import mast_zenoh as mast
from mast_zenoh.errors import ExportError
from mast_zenoh.integrity import deviations
from mast_zenoh.integrity.agent_fault import described
from mast_zenoh.integrity.disputes import ACCUSATIONS
from mast_zenoh.messagelog.reader import Recorded, Wanted, read
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message, text
from mast_zenoh.v2x.reference_position import LocalPlane
from mast_zenoh.viewer.export import export, misbehaviour

#: States of agents in trust messages.
FAULTY, SUSPENDED = 2, 3


@pytest.fixture(scope="session")
def judged(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose peers judge each other, over a channel that loses messages; an adversary is on one wire."""
    settings = dict(n_infrastructure=4, n_mobile=1, defence="Pasac", awareness=True)
    attack = dict(n_adversaries=1, attack_start_s=0.5)
    out = tmp_path_factory.mktemp("judged") / "run"
    return mast.run("congested", frames=30, seed=3, **settings, **attack, out=out)


@pytest.fixture(scope="session")
def judged_relays(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose peers judge what others relay, too; an adversary is on one wire."""
    settings = dict(n_infrastructure=3, n_mobile=1, defence="Pasac", relays=True)
    attack = dict(n_adversaries=1, attack_start_s=0.5)
    out = tmp_path_factory.mktemp("judged") / "run"
    return mast.run("peers", frames=25, seed=3, **settings, **attack, out=out)


@pytest.fixture(scope="session")
def judged_by_centre(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose command centre judges agents; adversaries are on the wires of two."""
    settings = dict(n_infrastructure=4, defence="Pasac", attack_start_s=0.3)
    out = tmp_path_factory.mktemp("judged") / "run"
    return mast.run("defended", frames=20, seed=3, **settings, out=out)


def reports(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def recorded_by_key(run: mast.Run) -> dict[str, list[dict[str, Any]]]:
    """All messages by key, read with mcap and msgpack alone."""
    found: dict[str, list[dict[str, Any]]] = {}
    with (run.path / "messages.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if message.data[:1] and not channel.topic.startswith("@"):
                found.setdefault(channel.topic, []).append(msgpack.unpackb(message.data, strict_map_key=False))
    return {key: sorted(messages, key=lambda message: message["frame"]) for key, messages in found.items()}


def column(body: dict[str, Any], name: str) -> list[Any]:
    dtype, shape, data = body[name]
    return data if isinstance(data, list) else np.frombuffer(data, dtype).reshape(shape).tolist()


def suspicions(trust: list[dict[str, Any]], own: str = "") -> list[tuple[str, int, int, str]]:
    """(agent, frame, state, reason) of each time that an agent begins to be faulty or suspended."""
    found, before = [], dict[str, int]()
    for message in trust:
        names = ("agents", "state", "reason")
        for agent, state, reason in zip(*(column(message["body"], name) for name in names), strict=True):
            if state in (FAULTY, SUSPENDED) and state != before.get(agent, 0) and agent != own:
                found.append((agent, message["frame"], state, reason))
            before[agent] = state
    return found


def test_each_time_that_a_peer_suspends_another_agent_is_a_report(judged: mast.Run, out: Path) -> None:
    assert export(judged.path, "misbehaviour", out) == ((out,), ())
    found, messages = reports(out), recorded_by_key(judged)
    expected = [
        (frame, f"peer_{own}", agent, reason)
        for own in ("ego", "mobile_1", "infra_1", "infra_2", "infra_3", "infra_4")
        for agent, frame, _, reason in suspicions(messages[f"agent/{own}/trust"], own)
    ]
    assert sorted((r["frame"], r["reporter"], r["reported"], r["reason"]) for r in found) == sorted(expected)
    assert len(found) > 5
    assert {"infra_1"} <= {report["reported"] for report in found}
    assert [report["frame"] for report in found] == sorted(report["frame"] for report in found)
    for report in found:
        assert report["reporter_station_id"] == zlib.crc32(report["reporter"].encode())
        assert report["reported_station_id"] == zlib.crc32(f"peer_{report['reported']}".encode())
        assert report["generation_time_us"] == 100_000 * report["frame"]
        assert (report["state"], report["detector"], report["detector_class"]) == ("suspended", "disagreement", 5)
        assert report["state_before"] != "suspended"
        assert 0.0 <= report["confidence"] <= 1.0


def test_a_report_says_where_its_peer_was(judged: mast.Run, out: Path) -> None:
    export(judged.path, "misbehaviour", out)
    messages = recorded_by_key(judged)
    for report in reports(out):
        agent = report["reporter"].removeprefix("peer_")
        (pose,) = [m for m in messages[f"agent/{agent}/pose"] if m["frame"] == report["frame"]]
        place, where = column(pose["body"], "position"), report["observation_location"]
        assert [where["x_m"], where["y_m"], where["z_m"]] == place
        position = LocalPlane().to_position(np.array(place))
        assert (where["latitude"], where["longitude"]) == (position.latitude / 1e7, position.longitude / 1e7)


def test_evidence_is_what_the_reporter_had_received_from_the_reported_agent(judged: mast.Run, out: Path) -> None:
    export(judged.path, "misbehaviour", out)
    messages, kinds = recorded_by_key(judged), set()
    for report in reports(out):
        observer, agent = report["reporter"].removeprefix("peer_"), report["reported"]
        assert report["evidence"]
        for each in report["evidence"]:
            key, frame = each["key"], each["frame"]
            subject, kind = key.split("/")[1:3]
            kinds.add(kind)
            assert subject == agent
            assert "@tap" not in key, "as it arrived, behind the adversary"
            assert report["frame"] - 10 <= frame < report["frame"]
            assert [m["frame"] for m in messages[key] if m["seq"] == each["seq"]] == [frame]
            (reception,) = [m for m in messages[f"agent/{observer}/reception"] if m["frame"] == frame + 1]
            assert agent not in column(reception["body"], "lost_awareness" if kind == "awareness" else "lost")
    assert {"broadcast", "broadcast_view", "awareness"} <= kinds


def test_a_report_about_a_relay_names_the_agent_its_station_and_the_pictures_that_it_relayed(
    judged_relays: mast.Run, out: Path
) -> None:
    export(judged_relays.path, "misbehaviour", out)
    found = reports(out)
    assert {report["relayed"] for report in found} == {False, True}
    for report in found:
        assert "/" not in report["reported"]
        assert report["reporter"] != f"peer_{report['reported']}"
        assert report["reported_station_id"] == zlib.crc32(f"peer_{report['reported']}".encode())
        kinds = {each["key"].rpartition("/")[2] for each in report["evidence"]}
        assert kinds == ({"relay"} if report["relayed"] else {"broadcast", "broadcast_view"})
        assert {each["key"].split("/")[1] for each in report["evidence"]} == {report["reported"]}


def test_a_report_of_a_centre_has_no_place_and_names_what_its_broker_received(
    judged_by_centre: mast.Run, out: Path
) -> None:
    export(judged_by_centre.path, "misbehaviour", out)
    found, messages = reports(out), recorded_by_key(judged_by_centre)
    expected = [(agent, frame) for agent, frame, *_ in suspicions(messages["cc/trust"])]
    assert [(report["reported"], report["frame"]) for report in found] == expected
    assert found
    for report in found:
        assert report["reporter"] == "command_center"
        assert report["observation_location"] is None
        assert report["reported_station_id"] == zlib.crc32(report["reported"].encode())
        keys = {each["key"] for each in report["evidence"]}
        assert keys == {f"agent/{report['reported']}/{kind}" for kind in ("tracks", "view")}
        assert max(each["frame"] for each in report["evidence"]) == report["frame"]


def test_every_reason_of_the_shipped_stages_has_a_detector() -> None:
    reasons = [
        *ACCUSATIONS,
        *deviations.REASONS.values(),
        described(np.zeros(4)),
        described(np.array([1.0, 0.0, 0.1, 0.2])),
    ]
    for reason in reasons:
        assert [each for each in misbehaviour.DETECTORS if reason.startswith(each.reason)], reason
    assert {each.kind for each in misbehaviour.DETECTORS} <= {1, 2, 3, 4, 5}


def spoilt(change: Callable[[Recorded], Recorded]) -> Callable[..., Iterator[Recorded]]:
    """A function that reads a recording, with the trust messages of the ego's peer changed."""

    def reading(path: Path, *wanted: Wanted) -> Iterator[Recorded]:
        for message in read(path, *wanted):
            yield change(message) if message.wire == "agent/ego/trust" else message

    return reading


@pytest.mark.parametrize(
    "change",
    [
        lambda message: replace(message, payload=message.payload[:-1]),
        lambda message: replace(message, malformed=True),
        lambda message: replace(message, payload=b""),
    ],
    ids=["cut off", "malformed", "empty"],
)
def test_invalid_messages_are_left_out_and_counted(
    judged: mast.Run, out: Path, monkeypatch: pytest.MonkeyPatch, change: Callable[[Recorded], Recorded]
) -> None:
    monkeypatch.setattr(misbehaviour, "read", spoilt(change))
    exported = export(judged.path, "misbehaviour", out)
    assert exported.missing == ("messages.mcap: invalid messages, which receivers refuse, are left out: 30",)
    found = reports(out)
    assert found
    assert "peer_ego" not in {report["reporter"] for report in found}


def test_a_reason_of_any_characters_is_one_string_in_one_line(
    judged: mast.Run, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    evil = 'x"}\n{"reporter": "\x1b[2J\u2028'

    def change(message: Recorded) -> Recorded:
        header, body = codec.decode(message.payload, "trust")
        reasons = text([evil] * len(body["agents"]))
        return replace(message, payload=codec.encode(Message(header, {**body, "reason": reasons})))

    export(judged.path, "misbehaviour", out)
    before = reports(out)
    out.unlink()
    monkeypatch.setattr(misbehaviour, "read", spoilt(change))
    export(judged.path, "misbehaviour", out)
    assert out.read_bytes().isascii()
    after = reports(out)
    assert len(after) == len(before)
    of_ego = [report for report in after if report["reporter"] == "peer_ego"]
    assert of_ego
    assert {(report["reason"], report["detector"]) for report in of_ego} == {(evil, None)}


def test_a_run_in_which_nobody_judges_is_refused_and_the_error_says_how_to_get_some(
    recorded: mast.Run, out: Path
) -> None:
    code, _, err = command("export", str(recorded.path), "--to", "misbehaviour", "-o", str(out))
    assert code == ExportError.exit_code
    words = " ".join(err.split())
    assert "found no node that judges agents, expected" in words
    assert "--set defence=FaultOrLie" in words
    assert not out.exists()
