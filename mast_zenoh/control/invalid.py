"""Counts refused control messages; the first on each key is logged."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

MAX_KEYS = 256  #: counted separately; all others are counted together
OTHERS = "(others)"
_MAX_REASON = 200


class InvalidMessages:
    """Counts by key, from any thread.

    log: called with a line about the first on each key
    counts: by key; reasons: why the first of each was refused
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        self._log = log
        self._lock = threading.Lock()

    def note(self, key: str, reason: object) -> None:
        """Count a refused message on a control key."""
        line = " ".join(str(reason).split())[:_MAX_REASON]
        with self._lock:
            if key not in self.reasons and len(self.reasons) >= MAX_KEYS:
                key = OTHERS
            first = key not in self.reasons
            self.reasons.setdefault(key, line)
            self.counts[key] += 1
        if first:
            self._log(f"refused a control message on {key}: {line} (more on this key will only be counted)")

    def entry(self) -> dict[str, list[int | str]]:
        """[number of refused messages, reason of the first] by key, for run.json."""
        with self._lock:
            return {key: [count, self.reasons[key]] for key, count in self.counts.items()}
