"""Plays a finished run at the pace of its scene, for servers of other viewers and for ROS 2."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from enum import Enum

from mast_zenoh.viewer.frame import Frame, FramedRun


class Status(Enum):
    """What a playback is doing."""

    PLAYING, PAUSED, ENDED = "playing", "paused", "ended"


class Playback:
    """Plays frames at the pace of the scene's time; other threads may pause, seek and end it.

    run:   a finished run;  rate: s of the scene per s;  loop: begin again at the end instead of pausing there
    clock: s, monotonic

    Raises RunFolderError if the run has no frame.
    """

    def __init__(
        self, run: FramedRun, *, rate: float = 1.0, loop: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.run, self.rate, self.loop, self.clock = run, rate, loop, clock
        times = [frame.time_ns for frame in run]
        self.first_ns, self.last_ns = min(times), max(times)
        self.status = Status.PLAYING
        #: Called when the playback has ended or begun again by itself.
        self.on_change: Callable[[], None] = lambda: None
        self._changed = threading.Condition()
        self._shown_ns = self._begin_ns = self.first_ns
        self._begin_s = clock()
        self._seeks = 0
        self._stopped = False

    def position_ns(self) -> int:
        """The time of the scene that is shown, ns."""
        return self._shown_ns

    def control(self, *, play: bool | None = None, rate: float | None = None, seek_ns: int | None = None) -> None:
        """Play or pause, at another rate, from another time; None: as before."""
        with self._changed:
            if seek_ns is None and play and self.status is Status.ENDED:
                seek_ns = self.first_ns
            if seek_ns is not None:
                self._shown_ns = min(max(seek_ns, self.first_ns), self.last_ns)
                self._seeks += 1
                self.status = Status.PAUSED if self.status is Status.ENDED else self.status
            if play is not None and self.status is not Status.ENDED:
                self.status = Status.PLAYING if play else Status.PAUSED
            if rate is not None and rate > 0:
                self.rate = rate
            self._begin_ns, self._begin_s = self._shown_ns, self.clock()
            self._changed.notify_all()

    def stop(self) -> None:
        """End the iteration over the frames."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def frames(self) -> Iterator[Frame]:
        """The frames, each when it is due: again and again, also after the end, until `stop`.

        After a seek comes the latest frame that is not after the new time, also while paused.
        """
        while not self._stopped:
            seeks, begin_ns = self._seeks, self._shown_ns
            before = None
            for frame in self.run:
                if frame.time_ns <= begin_ns:
                    before = frame
                    continue
                if before is not None:
                    yield before
                    before = None
                if not self._wait_for(frame.time_ns, seeks):
                    break
                yield frame
            else:
                if before is not None:
                    yield before
                self._wait_at_end(seeks)

    def _wait_for(self, time_ns: int, seeks: int) -> bool:
        """Wait until a frame is due; False: it is not wanted any more."""
        with self._changed:
            while not self._stopped and self._seeks == seeks:
                due_s = self._begin_s + (time_ns - self._begin_ns) / 1e9 / self.rate
                left_s = due_s - self.clock()
                if self.status is Status.PLAYING and left_s <= 0:
                    self._shown_ns = time_ns
                    return True
                self._changed.wait(left_s if self.status is Status.PLAYING else None)
            return False

    def _wait_at_end(self, seeks: int) -> None:
        """Begin again, or wait for a seek."""
        with self._changed:
            if self._stopped or self._seeks != seeks:
                return
            if self.loop and self.status is Status.PLAYING:
                self._shown_ns = self._begin_ns = self.first_ns
                self._begin_s = self.clock()
            else:
                self.status = Status.ENDED
        self.on_change()
        with self._changed:
            while self.status is Status.ENDED and not self._stopped and self._seeks == seeks:
                self._changed.wait()
