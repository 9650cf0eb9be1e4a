"""What an agent has heard from others: the newest tracks of each, at any later time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates, concatenate
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.tracking.kalman import predicted


class _Message(NamedTuple):
    """Tracks as they were heard. arrived: frame of arrival; time_ns: of the tracks"""

    arrived: int
    time_ns: int
    states: ObjectStates


class HeardTracks:
    """The newest tracks of each sender.

    A message is used from the frame after the one in which it arrived. Others of that frame may arrive before or after
    it, and the result must not depend on that; a radio message takes about as long.

    memory_s: how long an object is kept that a newer message of its sender left out, as generation rules do; 0: not at
        all, a message has all objects of its sender
    max_age_s: the greatest age of a track that is used
    """

    def __init__(self, memory_s: float = 0.0, max_age_s: float = MAX_AGE_S) -> None:
        for name, value in (("memory_s", memory_s), ("max_age_s", max_age_s)):
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"{name}: found {value}, expected 0 or more")
        self._memory_ns, self._max_age_ns = round(memory_s * 1e9), round(max_age_s * 1e9)
        self._waiting: dict[str, list[_Message]] = {}
        self._known: dict[str, tuple[ObjectStates, Ints]] = {}  # by sender: n tracks, and the time of each, ns
        self._newest_ns: dict[str, int] = {}

    def add(self, sender: str, arrived: int, time_ns: int, states: ObjectStates) -> None:
        """Add a message. arrived: frame of arrival; states: n tracks at `time_ns`, world frame, with different ids"""
        self._waiting.setdefault(sender, []).append(_Message(arrived, time_ns, states))

    def at(self, frame: int, time_ns: int) -> dict[str, ObjectStates]:
        """The tracks of each sender, predicted to `time_ns`, from messages that arrived before a frame; by name."""
        self._take(frame)
        result = {}
        for sender in sorted(self._known):
            states, times = self._known[sender]
            young = np.abs(time_ns - times) <= self._max_age_ns
            if not young.all():
                states, times = states.select(young), times[young]
                self._known[sender] = states, times
            if abs(time_ns - self._newest_ns[sender]) > self._max_age_ns:
                del self._known[sender], self._newest_ns[sender]
            else:
                result[sender] = _at(time_ns, states, times)
        return result

    def _take(self, frame: int) -> None:
        """Use the messages that arrived before a frame."""
        for sender, messages in list(self._waiting.items()):
            ready = sorted((each for each in messages if each.arrived < frame), key=_order)
            self._waiting[sender] = [each for each in messages if each.arrived >= frame]
            if not self._waiting[sender]:
                del self._waiting[sender]
            for message in ready:
                self._update(sender, message)

    def _update(self, sender: str, message: _Message) -> None:
        if message.time_ns <= self._newest_ns.get(sender, message.time_ns - 1):
            return  # late, or one more message about the same time
        self._newest_ns[sender] = message.time_ns
        states, times = message.states, np.full(len(message.states), message.time_ns)
        if self._memory_ns and sender in self._known:
            before, before_ns = self._known[sender]
            kept = ~np.isin(before.id, states.id) & (message.time_ns - before_ns <= self._memory_ns)
            states, times = concatenate([states, before.select(kept)]), np.concatenate([times, before_ns[kept]])
        self._known[sender] = states, times


def _order(message: _Message) -> tuple[int, bytes]:
    """By time; of two messages about the same time, one that does not depend on which arrived first."""
    return message.time_ns, message.states.position.tobytes()


def _at(time_ns: int, states: ObjectStates, times: Ints) -> ObjectStates:
    """n tracks with times (n,) ns, predicted to one."""
    distinct = np.unique(times)
    parts = [predicted(states.select(times == each), (time_ns - int(each)) * 1e-9) for each in distinct]
    return concatenate(parts)
