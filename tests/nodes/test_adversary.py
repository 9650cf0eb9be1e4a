"""An adversary makes its intended changes and has no other effect."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_world import PERIOD_NS, Bench, Run, detections, pose, states, tiny, tracks

from mast_zenoh.arrays.states import DETECTION_COLUMNS, STATE_COLUMNS
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.wiring.model import Wiring

PLACES = ((10.0, 0.0), (20.0, 5.0), (15.0, -8.0), (30.0, 2.0), (5.0, 12.0))
WIRES = {"detections": ("uncoordinated", DETECTION_COLUMNS), "tracks": ("coordinated", STATE_COLUMNS)}
ATTACK = dict(
    type="UncoordinatedAttack",
    start_s=0.1,
    selection=dict(type="UncoordinatedSelection", n_false_positives=5.0, fraction_false_negatives=0.4),
)


@pytest.fixture(scope="module")
def worlds():
    settings_ = ("n_adversaries=1", "attack_start_s=0.1")
    return {wire: tiny(name, *settings_) for wire, (name, _) in WIRES.items()}


def bench(worlds, wire: str, **attack: Any) -> Bench:
    """The adversary of the world for this wire, with changed attack parameters."""
    return Bench(worlds[wire], "adversary_1", attack=ATTACK | attack)


def body_on(wire: str, *places: tuple[float, float]) -> dict[str, np.ndarray]:
    return (detections if wire == "detections" else tracks)(*places)


def out_key(wire: str) -> str:
    return f"agent/infra_1/{wire}"


def play(adversary: Bench, wire: str, frames: int, places=PLACES) -> list[tuple[Message, list[Message]]]:
    """(input, output on the wire in the same frame) of some frames."""
    pairs = []
    for frame in range(frames):
        adversary.play(frame, pose=pose())
        key = adversary.key(wire)
        message = adversary.message(key, body_on(wire, *places), frame)
        published = adversary.deliver(key, message)
        pairs.append((message, [sent for out, sent in published if out == out_key(wire)]))
    return pairs


def rows(message: Message, columns: tuple[str, ...]) -> list[bytes]:
    """Each row of a message as bytes."""
    table = [np.ascontiguousarray(message.body[name]) for name in columns]
    return [b"|".join(column[i].tobytes() for column in table) for i in range(len(table[0]))]


@pytest.mark.parametrize("wire", WIRES)
def test_every_message_is_forwarded_once_and_only_attacked_rows_change(worlds, wire: str) -> None:
    whole = {"detections": ("mount_position", "mount_rotation"), "tracks": ("origin", "rotation")}[wire]
    adversary = bench(worlds, wire, start_s=0.3)
    added = removed = 0
    for frame, (message, sent) in enumerate(play(adversary, wire, 12)):
        (out,) = sent
        assert out.header == message.header
        assert out.header.source == ("simulator" if wire == "detections" else "infra_1")
        for name in whole:
            assert out.body[name].tobytes() == message.body[name].tobytes()
        before, after = (rows(each, WIRES[wire][1]) for each in (message, out))
        kept = [row for row in after if row in before]
        assert kept == [row for row in before if row in after], "in their order"
        assert after[: len(kept)] == kept, "inserted rows come last"
        added += len(after) - len(kept)
        removed += len(before) - len(kept)
        assert (codec.encode(out) == codec.encode(message)) == (frame < 3), "until the attack begins"
    assert added > 0
    assert removed > 0
    assert len(adversary.heard("attack/adversary_1/report")) == 9, "nothing is reported before it begins"


@pytest.mark.parametrize("wire", WIRES)
def test_a_pass_through_forwards_the_same_payload_at_once(worlds, wire: str) -> None:
    adversary = Bench(worlds[wire], "adversary_1", attack=dict(type="PassThrough"))
    key = adversary.key(wire)
    adversary.clock(0)
    payload = codec.encode(adversary.message(key, body_on(wire, *PLACES), 0))
    adversary.host.deliver(key, payload, 0)
    (out,) = adversary.outbox
    assert out.key == out_key(wire)
    assert out.payload is payload


@pytest.mark.parametrize("wire", WIRES)
def test_a_message_without_a_pose_is_forwarded_unchanged_at_the_next_clock(worlds, wire: str) -> None:
    adversary = bench(worlds, wire)
    play(adversary, wire, 3)
    adversary.clock(3)
    key = adversary.key(wire)
    payload = codec.encode(adversary.message(key, body_on(wire, *PLACES), 3))
    adversary.host.deliver(key, payload, 3)
    assert adversary.outbox == []
    adversary.host.deliver("clock", codec.encode(adversary.message("clock", {}, 4)), 4)
    (out,) = adversary.outbox
    assert (out.key, out.payload, out.step) == (out_key(wire), payload, 4)


@pytest.mark.parametrize("wire", WIRES)
def test_messages_do_not_overtake_each_other(worlds, wire: str) -> None:
    """Messages behind one without a pose wait as well."""
    adversary = bench(worlds, wire)
    adversary.clock(0)
    adversary.clock(1)
    adversary.send(wire, body_on(wire, *PLACES), 0, step=1)
    adversary.send("pose", pose(), 1)
    assert adversary.send(wire, body_on(wire, *PLACES), 1) == []
    adversary.clock(2)
    assert [message.header.frame for message in adversary.heard(out_key(wire))] == [0, 1]


@given(st.data())
@pytest.mark.parametrize("wire", WIRES)
def test_the_order_of_pose_and_message_does_not_matter(worlds, wire: str, data: st.DataObject) -> None:
    """The output on each key is a function of the input of each frame."""
    fates = st.sampled_from(["in time", "in time", "late", "lost"])
    fate = {(port, frame): data.draw(fates) for frame in range(5) for port in ("pose", wire)}

    def run(shuffle: Any) -> dict[str, list[Message]]:
        adversary = bench(worlds, wire)
        for frame in range(6):
            adversary.clock(frame)
            queues = {
                port: [f for f in (frame - 1, frame) if fate.get((port, f)) == ("late" if f < frame else "in time")]
                for port in ("pose", wire)
            }
            for port in shuffle([port for port, queue in queues.items() for _ in queue]):
                about = queues[port].pop(0)
                body = pose(x=float(about)) if port == "pose" else body_on(wire, *PLACES)
                adversary.send(port, body, about, step=frame)
        adversary.clock(6)
        assert not adversary.host.failures
        keys = {key for key, _ in adversary.said}
        return {key: [codec.encode(message) for message in adversary.heard(key)] for key in keys}

    plain = run(list)
    assert run(lambda order: data.draw(st.permutations(order))) == plain
    arrived = [frame for frame in range(5) if fate[wire, frame] != "lost"]
    sent = [codec.decode(payload, wire).header.frame for payload in plain.get(out_key(wire), [])]
    assert sorted(sent) == arrived, "nothing is held back"


def test_only_the_evaluator_receives_reports_and_the_truth_and_it_publishes_nothing() -> None:
    for name in ("baseline", "uncoordinated", "coordinated", "passthrough"):
        wiring = Wiring.from_json(tiny(name).wiring)
        for wire, leg in wiring.legs():
            if wire.message in ("attack_report", "truth"):
                assert not leg.subscribers
                assert not wire.interposers
        assert [leg.key for wire, leg in wiring.legs() if wire.message == "truth"] == ["scene/truth"]
        assert [end.node for end in wiring.overhearers] == ["evaluator"]
        assert not wiring.ports("evaluator").outputs


def on_picture(attack: dict[str, Any]) -> Any:
    """A scenario change: one adversary on the picture's downlink to the ego."""

    def change(scenario: dict) -> None:
        scenario["adversaries"] = {"adversary_1": dict(agent="ego", attack=attack)}
        scenario["keyexpr"] = dict(rewrites=["on_picture.toml"])

    return change


def test_an_attack_on_the_downlink_changes_only_the_picture_of_its_agent() -> None:
    leg = "cc/picture/@tap/ego/0"
    run, plain = Run(tiny(edit=on_picture(ATTACK | dict(start_s=0.4)))), Run(tiny())
    assert not run.failures
    assert run.messages["cc/picture"] == plain.messages["cc/picture"]
    sent, forged = run.decoded("cc/picture", "picture"), run.decoded(leg, "picture")
    assert [message.header for message in forged] == [message.header for message in sent]
    inserted = removed = 0
    for before, after in zip(sent, forged, strict=True):
        known = dict(zip(before.body["id"].tolist(), before.body["support"].tolist(), strict=True))
        ids = after.body["id"].tolist()
        assert [known[i] for i in ids if i in known] == [
            s for i, s in zip(ids, after.body["support"].tolist(), strict=True) if i in known
        ]
        assert np.all(after.body["support"] > 0)
        inserted += len(set(ids) - set(known))
        removed += len(set(known) - set(ids))
    assert inserted > 0
    assert removed > 0
    missions = [run.messages["agent/ego/mission"], plain.messages["agent/ego/mission"]]
    assert missions[0] != missions[1]
    assert run.messages["agent/infra_1/mission"] == plain.messages["agent/infra_1/mission"]


# -- coordinated ---------------------------------------------------------------------------------------------------


def directive(*add: tuple[float, float]) -> dict[str, np.ndarray]:
    """Columns of a directive for cars at these positions."""
    columns: dict[str, np.ndarray] = {"move_offset": np.zeros((0, 3))}
    for prefix, objects in (("add_", states(*add)), ("remove_", states()), ("move_", states())):
        for name in ("id", "position", "velocity", "size", "yaw", "class_id"):
            columns[prefix + name] = getattr(objects, name)
    return columns


def coordinated(worlds) -> Bench:
    return Bench(
        worlds["tracks"],
        "adversary_1",
        attack=dict(type="CoordinatedAttack", start_s=0.0, imitation=dict(type="Exact")),
    )


@pytest.mark.parametrize("directive_first", [True, False])
@pytest.mark.parametrize("about", [2, 1], ids=["in time", "late"])
def test_a_directive_is_followed_from_the_frame_after_its_arrival(worlds, about: int, directive_first: bool) -> None:
    adversary = coordinated(worlds)
    counts = []
    for frame in range(5):
        adversary.clock(frame)
        if frame == 2 and directive_first:
            adversary.send("directive", directive((12.0, 12.0)), about, step=2)
        adversary.send("pose", pose(), frame)
        adversary.send("tracks", tracks(*PLACES), frame)
        if frame == 2 and not directive_first:
            adversary.send("directive", directive((12.0, 12.0)), about, step=2)
        counts.append(len(adversary.heard(out_key("tracks"))[-1].body["id"]) - len(PLACES))
    assert counts == [0, 0, 0, 1, 1]


def test_observations_show_the_objects_before_any_change(worlds) -> None:
    adversary = coordinated(worlds)
    for frame in range(3):
        adversary.play(frame, directive=directive((12.0, 12.0)), pose=pose(x=3.0), tracks=tracks(*PLACES))
    seen = adversary.heard("attack/adversary_1/observation")
    assert [message.header.frame for message in seen] == [0, 1, 2]
    assert [message.header.time_ns for message in seen] == [0, PERIOD_NS, 2 * PERIOD_NS]
    for message in seen:
        np.testing.assert_array_equal(message.body["position"][:, :2], PLACES)
        np.testing.assert_array_equal(message.body["agent_position"], [3.0, 0.0, 0.0])


def test_forged_tracks_are_in_the_frame_of_reference_of_the_message(worlds) -> None:
    adversary = coordinated(worlds)
    reference = {"origin": np.array([100.0, 0.0, 0.0]), "rotation": np.array([0.0, 0.0, 0.0, 1.0])}  # half a turn
    for frame in range(2):
        adversary.play(frame, directive=directive((90.0, 5.0)), pose=pose(x=100.0))
        adversary.send("tracks", tracks((20.0, 0.0)) | reference, frame)
    body = adversary.heard(out_key("tracks"))[-1].body
    np.testing.assert_allclose(body["position"][1, :2], [10.0, -5.0], atol=1e-9)
    np.testing.assert_array_equal(body["origin"], reference["origin"])
