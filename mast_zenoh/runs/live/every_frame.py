"""Puts the messages of a running run together to frames; what comes too late or is forged is counted."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.runs.live.reception import Sample

#: Frames of which parts may be missing after every key has been heard since a subscription.
SETTLING = 3
#: For how long a silent key is waited for, whose node is there. Frames, at least, and in lock-step, in which every
#: message comes, though on a busy machine after the clocks of later frames. s, in real time, in which machines and
#: links delay messages.
PATIENCE, _LOCKSTEP_PATIENCE, _PATIENCE_S = 10, 100, 5.0
#: Frames at the beginning, for which a key that has not been heard yet is waited for at most: on a busy machine,
#: publishers learn of a subscription late.
SETTLING_AT_MOST = 100
#: Messages of one key about one frame, at most: a publisher of a run sends one, and a link may repeat it.
MOST_PER_KEY = 32
#: s of a run in real time for which messages can wait, and the fewest and most of a key.
_ROOM_S, _LEAST_ROOM, _MOST_ROOM = 20.0, 64, 512


@dataclass
class Tally:
    """Numbers of frames and messages of a running run.

    frames:     that were complete, or waited for as long as they can be;  unmeasured: of them, without outcomes
    lost:       frames that never came: there was no room, or the router dropped them
    late:       messages that came after their frame
    refused:    messages that receivers refuse as well, or that nobody sends
    """

    frames: int = 0
    unmeasured: int = 0
    lost: int = 0
    late: int = 0
    refused: int = 0

    def sentences(self) -> list[str]:
        """What is missing from the frames, in words; [] if nothing is."""
        words = {
            "frames were lost: there was no room for them, or the router dropped them; "
            "others may lack messages": self.lost,
            "messages came after their frame, and are missing from it": self.late,
            "invalid messages were left out": self.refused,
            "frames were not evaluated in time: their markers have the colour of unevaluated ones": self.unmeasured,
        }
        return [f"{number} {text}" for text, number in words.items() if number]


class FrameAssembler:
    """Puts messages together by the frame that they are about.

    A frame is whole when every key has been heard of it or of a later frame, of those that were heard in the latest
    frames. Who joins a running run begins when every key has been heard.

    keys: of messages that a frame has;  clock: the one of them that every frame has
    patience: number of these latest frames, for which a frame waits at most
    """

    def __init__(self, keys: Collection[str], clock: str, tally: Tally, patience: int = PATIENCE) -> None:
        self.tally = tally
        self._patience = patience
        self._frames: dict[int, dict[str, list[Sample]]] = {}
        self._next = -1  # the frame that is due; -1: none has begun
        self._joined = -1  # the first frame of which the clock was heard
        self._newest_clock = -1
        self.follow(keys, clock)

    def follow(self, keys: Collection[str], clock: str) -> None:
        """Go on with other keys: the wiring has changed."""
        self._clock = clock
        self._newest = dict.fromkeys(keys, -1)  # by key, the latest frame that it was heard of
        self._unheard = set(keys)
        self._heard = dict.fromkeys(keys, self._newest_clock)  # by key, the clock then

    def add(self, key: str, frame: int, sample: Sample) -> None:
        """Add a message about a frame."""
        self._unheard.discard(key)
        if key == self._clock and frame > self._newest_clock:
            if self._joined < 0:
                self._joined = frame
            self._newest_clock = frame
        if self._next < 0 <= self._joined:
            self._begin()
        if frame < self._next or self._next < 0:
            self.tally.late += key != self._clock and self.tally.frames > 0
            return
        samples = self._frames.setdefault(frame, {}).setdefault(key, []) if frame <= self._last else []
        if frame > self._last or len(samples) >= MOST_PER_KEY:
            self.tally.refused += 1
            return
        samples.append(sample)
        if key in self._newest:
            self._newest[key] = max(self._newest[key], frame)
            self._heard[key] = self._newest_clock

    def whole(
        self, *, silent: Collection[str] = (), over: bool = False
    ) -> Iterator[tuple[int, list[tuple[str, Sample]]]]:
        """The frames that are whole now, in order, with their messages.

        silent: keys on which nothing comes for now;  over: nothing more comes at all
        """
        while 0 <= self._next <= self._newest_clock and (over or self._is_whole(silent)):
            if self._clock in self._frames.get(self._next, ()):
                number, by_key = self._next, self._frames.pop(self._next)
                self._next += 1
                self.tally.frames += 1
                yield number, [(key, sample) for key, samples in by_key.items() for sample in samples]
                continue
            begun = [number for number, by_key in self._frames.items() if self._clock in by_key]
            following = min(begun, default=self._newest_clock + 1)
            self.tally.lost += following - self._next
            self._next = following
            self._frames = {number: by_key for number, by_key in self._frames.items() if number >= following}

    def _begin(self) -> None:
        """Set the first frame, if it is known by now: of those before it, parts may be missing."""
        if self._joined == 0:
            self._next = 0
        elif not self._unheard or self._newest_clock >= self._joined + SETTLING_AT_MOST:
            self._next = self._newest_clock + SETTLING
        self._heard = dict.fromkeys(self._heard, self._newest_clock)

    @property
    def _last(self) -> int:
        """The last frame about which there can be messages by now."""
        return self._newest_clock + self._patience

    def _is_whole(self, silent: Collection[str]) -> bool:
        if self._newest_clock >= self._next + self._patience:
            return True
        since = self._newest_clock - self._patience
        awaited = (key for key, heard in self._heard.items() if heard >= since and key not in silent)
        return all(self._newest[key] >= self._next for key in awaited)


def patience_for(resolved: Resolved) -> int:
    """For how many frames a silent key is waited for."""
    return max(PATIENCE, _frames_in(_PATIENCE_S, resolved)) if resolved.mode == "realtime" else _LOCKSTEP_PATIENCE


def room_for(resolved: Resolved) -> int:
    """How many messages of a key can wait: in real time those of some seconds."""
    if resolved.mode != "realtime":
        return _MOST_ROOM
    return min(max(_frames_in(_ROOM_S, resolved), _LEAST_ROOM), _MOST_ROOM)


def _frames_in(seconds: float, resolved: Resolved) -> int:
    return math.ceil(seconds * resolved.rate / (resolved.period_ns * 1e-9))
