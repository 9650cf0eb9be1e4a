"""Rows beyond what the sensors of a scene can see are dropped by rule, counted and told."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tiny_world import Bench, tiny, tracks

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.launch import notices
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages import limits as row_limits
from mast_zenoh.messages.limits import OVERHEARD, RowChoice, RowLimits
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.wiring.model import Input
from mast_zenoh.wiring.received import Overheard


def flood(n: int, *, score: Any = 1.0) -> dict[str, Any]:
    """Columns of n tracks in a row."""
    body = dict(tracks(*((float(x), 0.0) for x in range(n))))
    body["score"] = np.broadcast_to(np.asarray(score, float), n).copy()
    return body


def message(body: dict[str, Any]) -> Message:
    return codec.conform(Header("tracks", "infra_1", 3, 3 * 10**8, 3), body)


def test_the_kept_rows_have_the_highest_scores_then_the_lowest_ids_in_any_order() -> None:
    limits = RowLimits({"tracks": 5})
    score = np.repeat([0.2, 0.9, 0.5], 4)
    body = flood(12, score=score)
    kept = codec.decode(codec.encode(message(body)), "tracks", limits).body
    assert kept["id"].tolist() == sorted([*body["id"][4:8], body["id"][8:].min()])
    order = np.random.default_rng(0).permutation(12)
    rows = ("id", "position", "velocity", "size", "yaw", "covariance", "score", "class_id")
    shuffled = body | {name: np.asarray(body[name])[order] for name in rows}
    other = codec.decode(codec.encode(message(shuffled)), "tracks", limits).body
    assert sorted(other["id"].tolist()) == sorted(kept["id"].tolist())
    assert row_limits.excess(kept).startswith("rows: found 12")


def test_of_a_message_with_far_too_many_rows_only_the_first_are_looked_at() -> None:
    limits = RowLimits({"tracks": 2})
    sent = message(flood(200, score=np.arange(200) / 1000.0))  # the last have the highest scores
    for kept in (codec.decode(codec.encode(sent), "tracks", limits), codec.limited(sent, limits)):
        assert kept.body["id"].tolist() == sent.body["id"][98:100].tolist()
        assert kept.body.found == 200

    def last(ids: Any, score: Any, rows: int) -> Any:
        assert len(ids) == len(score) == 100
        return np.arange(len(ids) - rows, len(ids))

    assert chosen(sent, RowChoice(2, last), limits) == [sent.body["id"][98:100].tolist()] * 2


def test_dropped_rows_are_not_checked_and_kept_rows_are() -> None:
    limits = RowLimits({"tracks": 5})
    score = np.arange(10) / 10.0
    body = flood(10, score=score)
    body["position"] = np.array(body["position"])
    body["position"][0, 0] = np.nan  # of the lowest score
    codec.check_values(message(body), limits)
    assert len(codec.decode(codec.encode(message(body)), "tracks", limits).body["id"]) == 5
    body["position"][9, 0] = np.nan
    with pytest.raises(MessageError, match="position"):
        codec.decode(codec.encode(message(body)), "tracks", limits)
    with pytest.raises(MessageError, match="position"):
        codec.check_values(message(body), limits)


def test_overheard_tracks_have_the_rows_that_receivers_use_and_mission_estimates_those_of_the_picture_too() -> None:
    limits = RowLimits({"tracks": 50, OVERHEARD: 120})
    sent = message(flood(200))
    for content in (sent, codec.encode(sent)):
        for output, rows in (("tracks", 50), ("mission", 120)):
            wire = Input("everything", "infra_1", "tracks", "infra_1", output)
            assert len(Overheard("key", wire, content, 3, limits=limits).body["id"]) == rows


@pytest.mark.parametrize("schema", ["tracks", "detections", "picture"])
def test_a_long_message_is_never_unpacked(schema: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def unpack(*arguments: object, **options: object) -> None:
        pytest.fail("unpacked")

    limits = RowLimits({schema: 5})
    monkeypatch.setattr(codec.msgpack, "unpackb", unpack)
    with pytest.raises(MessageError, match=r"rows.*bytes.*another"):
        codec.decode(bytes(1 << 20), schema, limits)
    if schema == "tracks":
        payload = codec.encode(message(flood(1234)))
        assert len(codec.decode(payload, schema, limits).body["id"]) == 5
        with pytest.raises(MessageError, match="rows: "):
            codec.decode(payload + b"\0", schema, limits)


def test_a_message_in_any_order_is_unpacked_if_all_its_rows_are_looked_at() -> None:
    limits, longest = RowLimits({"tracks": 200}), len(codec.encode(message(flood(50 * 200))))
    limits.check_length("tracks", longest)
    with pytest.raises(MessageError, match="rows"):
        limits.check_length("tracks", longest * 5 // 4)


def chosen(sent: Message, choice: RowChoice, limits: RowLimits) -> list[Any]:
    """Ids, or the error, of a message with and without encoding, by a receiver with a choice of rows."""
    results: list[Any] = []
    try:
        codec.check_values(sent, limits)
        flaw = ""
    except MessageError as error:
        flaw = str(error)
    for receive in (
        lambda: codec.decode(codec.encode(sent), "tracks", limits, choice=choice),
        lambda: codec.received(sent, limits, flaw, choice),
    ):
        try:
            results.append(receive().body["id"].tolist())
        except MessageError as error:
            results.append(str(error))
    return results


def test_a_receiver_may_choose_its_rows_and_only_these_are_checked_with_and_without_encoding() -> None:
    def last(ids: Any, score: Any, rows: int) -> Any:
        return np.arange(len(ids) - rows, len(ids))

    limits, choice = RowLimits({"tracks": 5}), RowChoice(3, last)
    body = flood(10, score=np.arange(10)[::-1] / 10.0)
    body["position"] = np.array(body["position"])
    ids = np.asarray(body["id"]).tolist()
    assert chosen(message(body), choice, limits) == [ids[-3:]] * 2
    body["position"][0, 0] = np.nan  # of the highest score
    assert chosen(message(body), choice, limits) == [ids[-3:]] * 2
    body["position"][9, 0] = np.nan
    encoded, plain = chosen(message(body), choice, limits)
    assert encoded == plain
    assert "position" in encoded
    few = flood(3)
    few["position"] = np.full((3, 3), np.nan)
    encoded, plain = chosen(message(few), choice, limits)
    assert encoded == plain
    assert "position" in encoded


def test_a_node_counts_the_messages_that_it_shortened_and_a_notice_tells_them() -> None:
    broker = Bench(tiny(), "broker")
    broker.host.limits = RowLimits({"tracks": 3})
    broker.clock(0)
    broker.send("tracks", flood(20), 0, subject="infra_1")
    rejected = broker.host.rejected
    ((key, kind),) = rejected
    assert (kind, rejected[key, kind]) == ("rows", 1)
    (found,) = notices.of_rejected(
        {"broker": {"rejected": {f"{key}: rows": 1}, "first_rejected": broker.host.first_rejected}}
    )
    assert (found.who, found.value, found.where) == (("broker",), 1, key)
    assert "20 rows, expected" in found.cause[0]


@pytest.fixture(scope="module")
def baseline():
    return scenario.resolve(*scenario.load("baseline", []), frames=12)


def test_the_limit_comes_from_what_the_sensors_detect_or_from_the_scenario(baseline) -> None:
    recording = baseline.recording
    most = int(np.diff(recording.detection_start).max())
    assert baseline.max_rows["tracks"] == baseline.max_rows["detections"] == 16 + 2 * most
    path, loaded = scenario.load("baseline", [])
    assert scenario.resolve(path, loaded, frames=2, max_rows=7).max_rows["tracks"] == 7
    with pytest.raises(ConfigurationError, match=r"run\.max_rows.*0.*number"):
        scenario.resolve(path, loaded, frames=2, max_rows=0)


def test_the_limits_of_one_run_hold_in_no_other_run_or_reader_of_the_process(baseline, monkeypatch) -> None:
    messages: list[list[Any]] = []
    for resolved in (baseline, replace(baseline, max_rows={"tracks": 1}), baseline):
        played: list[Any] = []
        InProcess(resolved, tap=played.append).run()
        messages.append([(each.key, codec.encode(each.payload)) for each in played])
    unlimited, limited, afterwards = messages
    assert unlimited == afterwards != limited
    assert all(
        len(codec.decode(payload, "tracks").body["id"]) > 1 for key, payload in limited[-40:] if key.endswith("/tracks")
    )
