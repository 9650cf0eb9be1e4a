"""The frames of a running run for all pages that are open: a short queue for each, which drops the oldest frames."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

#: Frames that wait for a page, and pages at a time.
QUEUED, MOST_PAGES = 3, 8


class Listener:
    """What waits for one page: messages, of which frames (bytes) may be dropped."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._texts: deque[str] = deque()
        self._frames: deque[tuple[int, bytes]] = deque()
        self._lasting = 0  # version of the lasting header that the page has
        self._dropped = 0
        self._notes = ""
        self._last_words = ""

    def put(self, version: int, lasting: str, frame: bytes) -> None:
        """Add a frame. version, lasting: of the part of the header that it lacks"""
        with self._changed:
            if version != self._lasting:
                self._frames.clear()  # of another header
                self._texts = deque([lasting])
                self._lasting = version
            self._frames.append((version, frame))
            while len(self._frames) > QUEUED:
                self._frames.popleft()
                self._dropped += 1
            self._changed.notify()

    @property
    def has_room(self) -> bool:
        """Whether the page has taken what was sent before."""
        return len(self._frames) < QUEUED

    def note(self, text: str) -> None:
        """Set what is to be said of the view."""
        with self._changed:
            self._notes = text
            self._changed.notify()

    def close(self, text: str) -> None:
        """End with a last message."""
        with self._changed:
            self._last_words = text
            self._changed.notify()

    def take(self, most: int, timeout_s: float) -> tuple[list[str | bytes], bool]:
        """Wait for messages; returns them, with at most so many frames, and whether more may come."""
        with self._changed:
            if not (self._texts or self._frames or self._notes or self._last_words):
                self._changed.wait(timeout_s)
            messages: list[str | bytes] = [*self._texts, *([self._notes] if self._notes else [])]
            if self._dropped:
                messages.append(json.dumps({"kind": "dropped", "count": self._dropped}))
            messages += [self._frames.popleft()[1] for _ in range(min(most, len(self._frames)))]
            self._texts.clear()
            self._dropped = 0
            self._notes = ""
            over = bool(self._last_words) and not self._frames
            return [*messages, self._last_words] if over else messages, not over


class Feed:
    """Distributes frames to the listeners; never waits for one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: list[Listener] = []
        self._lasting: dict[str, Any] = {}
        self._version = 0
        self._newest: bytes | None = None
        self._notes: list[str] = []
        self._last_words = ""

    @property
    def is_wanted(self) -> bool:
        """Whether a page is open that reads its frames."""
        return any(listener.has_room for listener in tuple(self._listeners))

    @contextmanager
    def listener(self) -> Iterator[Listener | None]:
        """A listener for one page; None: there are too many already."""
        listener = Listener()
        with self._lock:
            accepted = len(self._listeners) < MOST_PAGES
            if accepted:
                self._listeners.append(listener)
                if self._newest is not None:
                    listener.put(self._version, self._lasting_text, self._newest)
                if self._notes:
                    listener.note(self._notes_text)
                if self._last_words:
                    listener.close(self._last_words)
        try:
            yield listener if accepted else None
        finally:
            if accepted:
                with self._lock:
                    self._listeners.remove(listener)

    def publish(self, lasting: Mapping[str, Any], frame: bytes) -> None:
        """Give a frame to all listeners. lasting: the part of its header that rarely changes"""
        with self._lock:
            if lasting != self._lasting:
                self._lasting = dict(lasting)
                self._version += 1
            self._newest = frame
            for listener in self._listeners:
                listener.put(self._version, self._lasting_text, frame)

    def note(self, notes: Sequence[str]) -> None:
        """Give all listeners what is to be said of the view, if it has changed: frames may fail to say it."""
        with self._lock:
            if self._notes != [*notes]:
                self._notes = [*notes]
                for listener in self._listeners:
                    listener.note(self._notes_text)

    def close(self, *, reload: bool) -> None:
        """Tell all pages that the run is over. reload: whether the page then shows all of it"""
        with self._lock:
            self._last_words = json.dumps({"kind": "over", "reload": reload})
            for listener in self._listeners:
                listener.close(self._last_words)

    @property
    def _notes_text(self) -> str:
        return json.dumps({"kind": "notes", "notes": self._notes})

    @property
    def _lasting_text(self) -> str:
        return json.dumps({"kind": "lasting", "header": self._lasting}, separators=(",", ":"))
