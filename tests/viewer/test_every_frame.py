"""Every frame of a running run comes out once, in order, as soon as it is whole; what is missing is counted."""

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from recorded_observer import RecordedObserver

import mast_zenoh as mast
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live import observer as observers
from mast_zenoh.runs.live.measurement import FrameMeter
from mast_zenoh.runs.live.observer import (
    MOST_PER_KEY,
    PATIENCE,
    SETTLING,
    SETTLING_AT_MOST,
    FrameAssembler,
    Observer,
    Tally,
    patience_for,
    room_for,
)
from mast_zenoh.runs.live.reception import ArrivedMessage, Sample
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.wiring.model import Wiring

KEYS = ("clock", "a", "b")


@pytest.fixture
def assembler() -> FrameAssembler:
    return FrameAssembler(KEYS, "clock", Tally())


def added(assembler: FrameAssembler, frame: int, *keys: str, step: int | None = None) -> list[int]:
    """Add messages about a frame; returns the numbers of the frames that are whole now."""
    for key in keys:
        assembler.add(key, frame, Sample(frame if step is None else step, key.encode()))
    return [number for number, _ in assembler.whole()]


def test_a_frame_comes_out_when_every_key_has_been_heard_of_it_whatever_the_order(assembler: FrameAssembler) -> None:
    assert added(assembler, 0, "clock", "b") == []
    assert added(assembler, 1, "b", "clock") == []
    assert added(assembler, 0, "a") == [0]
    assert added(assembler, 2, "a", "clock") == [1], "a later message of a key: none about frame 1 comes any more"
    assert assembler.tally == Tally(frames=2)


def test_a_silent_key_is_waited_for_only_for_some_frames_and_then_no_more(assembler: FrameAssembler) -> None:
    out = [added(assembler, frame, *KEYS[: 3 if frame == 0 else 2]) for frame in range(3 * PATIENCE)]
    assert out[0] == [0]
    assert out[1 : PATIENCE + 1] == [[]] * PATIENCE, "b may be late"
    assert out[PATIENCE + 1] == [*range(1, PATIENCE + 2)], "b has gone"
    assert out[PATIENCE + 2 :] == [[frame] for frame in range(PATIENCE + 2, 3 * PATIENCE)]
    assert assembler.tally == Tally(frames=3 * PATIENCE)


def test_a_key_whose_node_is_down_is_not_waited_for(assembler: FrameAssembler) -> None:
    added(assembler, 0, *KEYS)
    assert added(assembler, 1, "clock", "a") == []
    assert [number for number, _ in assembler.whole(silent={"b"})] == [1]


def test_one_who_joins_late_begins_when_every_key_has_been_heard(assembler: FrameAssembler) -> None:
    for frame in range(100, 100 + 3 * PATIENCE):
        assert added(assembler, frame, "clock", "a") == [], "b's publisher may not know of the subscription yet"
    begun = 100 + 3 * PATIENCE
    out = [added(assembler, frame, *KEYS) for frame in range(begun, begun + 6)]
    assert [number for numbers in out for number in numbers] == [begun + SETTLING, begun + SETTLING + 1, begun + 5]
    assert assembler.tally == Tally(frames=3)


def test_a_key_on_which_nothing_comes_delays_the_beginning_for_some_frames_only(assembler: FrameAssembler) -> None:
    out = [number for frame in range(100, 400) for number in added(assembler, frame, "clock", "a")]
    assert out == [*range(100 + SETTLING_AT_MOST + SETTLING, 400)]
    assert assembler.tally == Tally(frames=len(out))


def test_a_frame_without_its_clock_is_lost_and_the_next_ones_come_out(assembler: FrameAssembler) -> None:
    assert added(assembler, 0, *KEYS) == [0]
    assert added(assembler, 1, "a", "b") == []
    assert added(assembler, 2, "a", "b") == []
    assert added(assembler, 3, *KEYS) == [3]
    assert assembler.tally == Tally(frames=2, lost=2)


def test_one_who_joins_late_begins_with_a_whole_frame(assembler: FrameAssembler) -> None:
    out = [added(assembler, frame, *KEYS) for frame in range(50, 56)]
    assert out == [[]] * SETTLING + [[50 + SETTLING], [51 + SETTLING], [52 + SETTLING]]
    assert assembler.tally == Tally(frames=3)


def test_late_repeated_and_forged_messages_are_counted_and_take_no_memory(assembler: FrameAssembler) -> None:
    added(assembler, 0, *KEYS)
    added(assembler, 0, "a", "b")
    assert assembler.tally == Tally(frames=1, late=2)
    for _ in range(MOST_PER_KEY + 5):
        added(assembler, 1, "a")
    assert assembler.tally.refused == 5
    for frame in range(PATIENCE + 1, 10**6, 1000):
        added(assembler, frame, "a")
    assert assembler.tally.refused == 5 + 1000
    assert len(assembler._frames) == 1
    assert added(assembler, 10**9, "clock") == [10**9], "a forged clock costs no time"
    assert assembler.tally.lost == 10**9 - 1


def test_at_the_end_what_has_begun_comes_out_as_it_is(assembler: FrameAssembler) -> None:
    added(assembler, 0, "clock", "a")
    added(assembler, 1, "clock")
    assert [number for number, _ in assembler.whole(over=True)] == [0, 1]


class FrameByFrame(Observer):
    """An observer that takes the messages of a recording, as much as is asked for."""

    def __init__(self, folder: Path, batches: list[list[ArrivedMessage]]) -> None:
        of_recording: Any = RecordedObserver(folder, (9,))
        run: Any = SimpleNamespace(**vars(of_recording.address), roles=of_recording.roles, credentials="none")
        run.current_wiring = lambda session: (of_recording.wiring, of_recording.roles)
        self.batches = batches
        super().__init__(run, MagicMock(), every=True)

    def keep_up(self) -> list[ArrivedMessage]:
        return self.batches.pop(0)

    def is_over(self) -> bool:
        return len(self.batches) == 1


def received(content: bytes) -> Any:
    """A payload as Zenoh has it."""
    return SimpleNamespace(to_bytes=lambda: content)


def arrivals(folder: Path) -> list[ArrivedMessage]:
    """The messages of a recording, of those keys that frames need."""
    resolved = Resolved.read(folder)
    keys = FrameMeter(resolved).keys(Wiring.from_json(resolved.wiring))
    return [ArrivedMessage(each.key, each.step, received(each.payload)) for each in read(folder) if each.key in keys]


def all_frames(folder: Path, batches: list[list[ArrivedMessage]], monkeypatch: pytest.MonkeyPatch, **words: Any) -> Any:
    """The frames of a running run that has these messages, and what was counted."""
    monkeypatch.setattr(observers, "EVERY_POLL_S", 0.0)
    observer = FrameByFrame(folder, batches)
    return list(observer.frames(threading.Event(), **words)), observer.tally


def assert_recorded(live: list[Frame], folder: Path, *, measured: bool) -> None:
    for frame, other in zip(live, frames_of(open_recorded(folder)), strict=True):
        assert (frame.index, frame.time_ns) == (other.index, other.time_ns)
        assert frame.objects.keys() == other.objects.keys()
        assert frame.poses.keys() == other.poses.keys()
        assert sorted(frame.changes.sentences) == sorted(other.changes.sentences) or not measured
        for series, score in frame.scores.items():
            assert score[:3] == other.scores[series][:3], series
        for series, states in other.objects.items():
            assert np.array_equal(frame.objects[series].id, states.id)
            assert np.array_equal(frame.objects[series].position, states.position)
            names = other.outcomes[series].names if measured else ["unevaluated"] * len(states)
            assert frame.outcomes[series].names == names


def test_all_frames_of_a_run_are_those_of_its_recording(recorded: mast.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    messages = arrivals(recorded.path)
    batches = [messages[k : k + 40] for k in range(0, len(messages), 40)]
    frames, tally = all_frames(recorded.path, [*batches, []], monkeypatch)
    assert_recorded(frames, recorded.path, measured=True)
    assert tally == Tally(frames=30)
    assert tally.sentences() == []


def test_where_there_is_no_time_frames_come_without_outcomes_which_is_told(
    recorded: mast.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames, tally = all_frames(recorded.path, [arrivals(recorded.path), []], monkeypatch)
    assert_recorded(frames, recorded.path, measured=False)
    assert tally == Tally(frames=30, unmeasured=30)
    assert tally.sentences()[0].startswith("30 frames were")


def test_invalid_messages_of_a_run_are_counted(recorded: mast.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    messages = arrivals(recorded.path)
    key = next(each.key for each in messages if each.key.endswith("ego/tracks"))
    rubbish = received(b"\x93rubbish")
    broken = received(next(each for each in messages if each.key == key).payload.to_bytes()[:-3])
    more = [ArrivedMessage(key, 3, rubbish), ArrivedMessage("stranger", 3, rubbish), ArrivedMessage(key, 0, broken)]
    frames, tally = all_frames(recorded.path, [[*more, *messages], []], monkeypatch)
    assert len(frames) == 30
    assert tally.refused == 3


@pytest.mark.parametrize(
    ("mode", "rate", "room"), [("lockstep", 1.0, 512), ("realtime", 1.0, 200), ("realtime", 2.0, 400)]
)
def test_queues_have_room_for_twenty_seconds_within_limits(
    recorded: mast.Run, mode: str, rate: float, room: int
) -> None:
    observer: Any = RecordedObserver(recorded.path, (9,))
    resolved = observer.address.resolved
    assert room_for(replace(resolved, mode=mode, rate=rate)) == room
    assert room_for(replace(resolved, mode="realtime", rate=0.01)) == 64
    assert room_for(replace(resolved, mode="realtime", rate=100.0)) == 512
    assert patience_for(replace(resolved, mode="lockstep")) == 100, "frames"
    assert patience_for(replace(resolved, mode="realtime", rate=2.0)) == 100, "5 s"
