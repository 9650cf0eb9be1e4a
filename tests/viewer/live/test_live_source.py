"""Other viewers get the same frames of a run while it is running as after it."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorded_observer import NUMBERS, RecordedObserver

import mast_zenoh as mast
from mast_zenoh.viewer.frame import FramedRun
from mast_zenoh.viewer.live.observer import Observer
from mast_zenoh.viewer.recorded import RecordedRun


@pytest.fixture(scope="module")
def source(recorded: mast.Run) -> FramedRun:
    observer: Any = RecordedObserver(recorded.path)
    return replace(observer.record, frames=Observer.frames(observer, threading.Event()))


def test_the_frames_of_a_running_run_are_those_of_the_finished_one(source: FramedRun, recorded: mast.Run) -> None:
    finished = RecordedRun.load(recorded.path)
    assert (source.agents, source.main_agent) == (finished.agents, finished.main_agent)
    assert source.topics == finished.topics
    expected = {frame.index: frame for frame in finished}
    live = list(source)
    assert [frame.index for frame in live] == list(NUMBERS)
    outcomes = 0
    for frame in live:
        other = expected[frame.index]
        assert frame.objects.keys() == other.objects.keys()
        assert frame.time_ns == other.time_ns
        for series, states in frame.objects.items():
            assert np.array_equal(states.id, other.objects[series].id)
            assert np.array_equal(states.position, other.objects[series].position)
            assert frame.outcomes[series].names == other.outcomes[series].names
            outcomes += len(states)
        for series, score in frame.scores.items():
            assert score[:3] == other.scores[series][:3], series
        assert {series.estimator for series in frame.scores} >= {"local", "picture", "mission"}
        assert sorted(frame.changes.sentences) == sorted(other.changes.sentences)
    assert outcomes > 300


def test_a_live_source_ends_when_it_is_stopped(recorded: mast.Run) -> None:
    stop = threading.Event()
    observer: Any = RecordedObserver(recorded.path)
    frames = Observer.frames(observer, stop)
    assert next(frames).index == NUMBERS[0]
    stop.set()
    assert list(frames) == []
