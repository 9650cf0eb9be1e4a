"""Counts control messages that were refused: each costs one message, and is said once for each key."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

MAX_KEYS = 256  #: counted each by itself; all further ones together
OTHERS = "(others)"
_MAX_REASON = 200


class InvalidMessages:
    """Counts by key, from any thread.

    say: told of the first on each key, in a line
    counts: by key; reasons: why the first of each was refused
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        self._say = say
        self._lock = threading.Lock()

    def note(self, key: str, reason: object) -> None:
        """A message on a control key was refused."""
        why = " ".join(str(reason).split())[:_MAX_REASON]
        with self._lock:
            if key not in self.reasons and len(self.reasons) >= MAX_KEYS:
                key = OTHERS
            first = key not in self.reasons
            self.reasons.setdefault(key, why)
            self.counts[key] += 1
        if first:
            self._say(f"refused a control message on {key}: {why} (further ones on this key are only counted)")

    def entry(self) -> dict[str, list[int | str]]:
        """By key how many were refused, and why the first was; for run.json."""
        with self._lock:
            return {key: [count, self.reasons[key]] for key, count in self.counts.items()}
