"""Effects are what subscribers see: the first message about a frame."""

from collections import Counter

import numpy as np
import pytest

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.evaluation.effects.passages import KNOWN_FRAMES, LATEST, REMEMBERED, FrameSpan, PassageMeter
from mast_zenoh.evaluation.effects.rows import ChangedMessage, changed_objects
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message, text
from mast_zenoh.metrics.causes import KINDS
from mast_zenoh.wiring.model import Input, InterposedWire
from mast_zenoh.wiring.received import Overheard

PERIOD_NS = 100_000_000
WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}


def meter(message: str = "tracks") -> PassageMeter:
    passage = InterposedWire("mallory", f"agent/a/{message}", "a", message, message, "in", "out")
    return PassageMeter(passage, FrameSpan(0))


def tracks(frame: int, *, seq: int | None = None, x: float = 0.0, time_ns: int | None = None, step: int | None = None):
    """The tracks of three objects; the first is at `x`. The second drives at 10 m/s, the others stand."""
    position = np.array([[x, 0.0, 0.0], [20.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    velocity = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    body = ObjectStates.of(position, velocity=velocity, id=np.arange(3)).columns() | WORLD
    header = Header(
        "tracks", "a", frame, frame * PERIOD_NS if time_ns is None else time_ns, frame if seq is None else seq
    )
    return Overheard("key", Input("everything", "a", "tracks", "a"), codec.conform(header, body), step or frame)


def pose(frame: int, *, seq: int, x: float = 0.0):
    body = {"position": np.array([x, 0.0, 0.0]), "rotation": WORLD["rotation"], "velocity": np.zeros(3)}
    message = codec.conform(Header("pose", "a", frame, frame * PERIOD_NS, seq), body)
    return Overheard("key", Input("everything", "a", "pose", "a"), message, frame)


def effects(metered: PassageMeter) -> Counter[str]:
    return Counter(each.effect for each in metered.effects.messages)


def changed(metered: PassageMeter) -> int:
    """The number of objects changed in any way."""
    return sum(len(each.frame) for each in metered.effects.objects)


@pytest.mark.parametrize("late", [0, 2])
def test_a_renumbered_message_is_not_forged(late: int) -> None:
    metered = meter()
    for frame in range(5):
        metered.take_received(tracks(frame))
        metered.take_sent(tracks(frame, seq=frame + 100, step=frame + late))
    metered.close(100)
    assert effects(metered) == Counter({"reframed": 5} | ({"delayed": 5} if late else {}))
    assert {each.columns for each in metered.effects.messages if each.effect == "reframed"} == {("seq",)}
    assert changed(metered) == (15 if late else 0)


def test_a_forged_message_before_the_original_changes_differing_objects() -> None:
    metered = meter()
    for frame in range(5):
        metered.take_received(tracks(frame))
        metered.take_sent(tracks(frame, seq=frame + 100, x=3.0))
    metered.close(100)
    assert effects(metered) == {"dropped": 5, "forged": 5}
    assert changed(metered) == 5, "two of three objects are unchanged"


def test_each_changed_object_is_of_its_own_message() -> None:
    whole, moved = tracks(1).body, tracks(1, x=3.0).body
    less = {name: values if name in WORLD else values[1:] for name, values in whole.items()}
    pairs = ((whole, less), (less, whole), (whole, moved))
    found, _ = changed_objects("tracks", [ChangedMessage(7 + at, at, 9, *pair) for at, pair in enumerate(pairs)])
    by_frame = {frame: KINDS[effect] for frame, effect in zip(found.frame, found.effect, strict=True)}
    assert by_frame == {7: "removed", 8: "inserted", 9: "moved"}


@pytest.mark.parametrize("passed_on", [True, False])
def test_a_pose_forged_before_the_true_one_is_a_false_pose(passed_on: bool) -> None:
    metered = meter("pose")
    for frame in range(5):
        metered.take_received(pose(frame, seq=frame))
        metered.take_sent(pose(frame, seq=frame + 100, x=15.0))
        if passed_on:
            metered.take_sent(pose(frame, seq=frame))
    metered.close(100)
    assert [(each.frame, each.position[0], each.false_position[0]) for each in metered.effects.spoofs] == [
        (frame, 0.0, 15.0) for frame in range(5)
    ]


def test_forgeries_are_measured_equally_in_runs_of_any_length() -> None:
    metered = meter()
    for frame in range(2 * REMEMBERED):
        metered.take_received(tracks(frame))
        metered.take_sent(tracks(frame, seq=frame + 1000, x=3.0))
        metered.take_sent(tracks(frame))
    metered.close(2 * REMEMBERED)
    assert effects(metered) == {"forged": 2 * REMEMBERED}
    assert changed(metered) == 2 * REMEMBERED


def test_an_old_message_sent_again_is_a_repetition() -> None:
    metered = meter()
    for frame in range(2 * REMEMBERED):
        metered.take_received(tracks(frame))
        metered.take_sent(tracks(frame))
    metered.take_sent(tracks(3, step=2 * REMEMBERED))
    metered.close(2 * REMEMBERED + KNOWN_FRAMES)
    assert effects(metered) == {"repeated": 1}
    assert changed(metered) == 0


def restamped(by_s: float) -> PassageMeter:
    metered = meter()
    metered.take_received(tracks(1))
    metered.take_sent(tracks(1, time_ns=PERIOD_NS + round(by_s * 1e9)))
    metered.close(100)
    assert effects(metered) == {"restamped": 1}
    return metered


def test_a_changed_time_moves_the_objects_of_tracks_that_drive() -> None:
    (moved,) = [each for each in restamped(-0.4).effects.objects if len(each.frame)]
    np.testing.assert_allclose(moved.before, [[20.0, 0.0, 0.0]])
    np.testing.assert_allclose(moved.after, [[24.0, 0.0, 0.0]], err_msg="predicted 0.4 s further")


def test_a_time_changed_by_more_than_a_second_withholds_all_objects_of_tracks() -> None:
    assert changed(restamped(-2.0)) == 3


def test_a_time_changed_by_a_few_milliseconds_changes_no_object() -> None:
    assert changed(restamped(0.02)) == 0


def test_a_changed_time_withholds_nothing_if_the_receiver_uses_the_frame() -> None:
    def detections(time_ns: int) -> Overheard:
        states = ObjectStates.of(np.zeros((2, 3)))
        body = {name: getattr(states, name) for name in ("position", "size", "yaw", "score", "class_id")}
        body |= {"covariance": np.zeros((2, 3, 3))}
        body |= {"mount_position": np.zeros(3), "mount_rotation": WORLD["rotation"]}
        message = codec.conform(Header("detections", "a", 1, time_ns, 1), body)
        return Overheard("key", Input("everything", "a", "detections", "a"), message, 1)

    metered = meter("detections")
    metered.take_received(detections(PERIOD_NS))
    metered.take_sent(detections(5 * PERIOD_NS))
    metered.close(100)
    assert effects(metered) == {"restamped": 1}
    assert changed(metered) == 0


def relayed(frame: int, agents: list[str], origin: list[list[int]], ids: tuple[int, ...] = (1, 2)) -> Overheard:
    """A relayed picture of objects that stand 20 m apart, with their origins among agents."""
    position = np.array([[20.0 * id_, 0.0, 0.0] for id_ in ids])
    columns = ObjectStates.of(position, id=np.array(ids)).columns()
    body = columns | {"agents": text(agents), "origin": np.array(origin, np.uint8).reshape(len(ids), len(agents))}
    message = codec.conform(Header("relayed", "a", frame, frame * PERIOD_NS, frame), body)
    return Overheard("key", Input("everything", "a", "relayed", "a"), message, frame)


@pytest.mark.parametrize("agents", [["a", "b"], ["a", "b", "nobody"], ["z"]])
def test_forged_origins_change_messages_and_no_object(agents: list[str]) -> None:
    metered = meter("relayed")
    for frame in range(3):
        heard = ["a", "b"][: frame + 1]
        metered.take_received(relayed(frame, heard, [[1] * len(heard)] * 2))
        metered.take_sent(relayed(frame, agents, [[0] * len(agents)] * 2))
    metered.close(100)
    assert effects(metered) == {"reframed": 3}
    assert {each.columns for each in metered.effects.messages} <= {("origin",), ("agents", "origin")}
    assert changed(metered) == 0


def test_a_hidden_object_of_a_relayed_picture_is_removed_whatever_its_origins() -> None:
    metered = meter("relayed")
    metered.take_received(relayed(0, ["a", "b"], [[1, 0], [1, 1]]))
    metered.take_sent(relayed(0, ["a", "b"], [[1, 0]], ids=(1,)))
    metered.close(100)
    assert effects(metered) == {}
    assert [changes.id.tolist() for changes in metered.effects.objects if len(changes.id)] == [[2]]


def test_a_message_that_is_not_sent_on_in_time_is_dropped_while_the_run_goes_on() -> None:
    metered = meter()
    for frame in (1, 2):
        metered.take_received(tracks(frame))
    metered.settle(2)
    assert [(each.effect, each.frame) for each in metered.effects.messages] == [("dropped", 1)]
    metered.take_sent(tracks(2, step=2 + LATEST))
    metered.close(500)
    assert effects(metered) == {"dropped": 1, "delayed": 1}


@pytest.mark.parametrize("settled", [True, False])
def test_a_message_that_is_sent_on_much_later_is_dropped_and_repeated_whenever_that_is_measured(settled: bool) -> None:
    metered = meter()
    metered.take_received(tracks(1))
    if settled:
        metered.settle(2)
    metered.take_sent(tracks(1, step=2 + LATEST))
    metered.close(500)
    assert effects(metered) == {"dropped": 1, "repeated": 1}


def test_forgotten_effects_are_those_on_earlier_messages() -> None:
    metered = meter()
    for frame in range(1, 5):
        metered.take_received(tracks(frame))
        metered.take_sent(tracks(frame, x=3.0, time_ns=frame * PERIOD_NS + 1))
    metered.effects.forget(3)
    assert {each.frame for each in metered.effects.messages} == {3, 4}
    assert sorted(int(frame) for part in metered.effects.objects for frame in part.frame) == [3, 4]


def test_in_one_process_a_header_that_no_message_may_have_is_refused_as_its_bytes_would_be() -> None:
    header = Header("pose", "a", 1, 2**62, 0)
    message = Message(header, {"position": np.zeros(3)})
    with pytest.raises(MessageError, match="time_ns"):
        _ = Overheard("key", Input("everything", "a", "pose", "a"), message, 1, "refused").header
