"""Messages recorded earlier, with fresh headers."""

from __future__ import annotations

from collections import deque

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints, ObjectStates
from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment


class Replay(AdaptiveAttack):
    """Shows the objects as they were `delay_s` before, in messages with today's header.

    An object with the same track id then and now is moved back to where it was; one that has left since is shown again;
    one that has come since is hidden. Objects with the lowest ids come first, up to the budget; with a budget above the
    number of objects the whole message is old. Detections have no ids: those of now are hidden and the old ones shown.
    Source: replay in V2X, ETSI TR 102 893.

    delay_s: s, the age of what is shown
    budget:  lies per second, so the number of objects
    start_s: s of scene time at which the attack begins; at least `delay_s` after the first message
    """

    def __init__(self, *, delay_s: float = 3.0, budget: float = 2.0, start_s: float = 4.0) -> None:
        super().__init__(budget=budget, start_s=start_s)
        if not 0.0 < delay_s <= 60.0:
            raise ValueError(f"delay_s: found {delay_s}, expected more than 0 and at most 60")
        self._delay_ns = round(delay_s * 1e9)
        self._recorded: deque[tuple[int, ObjectStates]] = deque()
        self._told: set[int] = set()  # numbers of the lies in the last message
        self._number_of: dict[int, int] = {}  # by track id

    def observe(self, moment: Moment) -> None:
        self._recorded.append((moment.time_ns, moment.seen))
        while len(self._recorded) > 1 and self._recorded[1][0] <= moment.time_ns - self._delay_ns:
            self._recorded.popleft()

    def rest(self) -> None:
        self._told = set()

    def lie(self, moment: Moment) -> Lies:
        time_ns, old = self._recorded[0]
        if time_ns > moment.time_ns - self._delay_ns:
            return Lies()
        now = moment.seen
        old_row, row = _same_ids(old, now)
        gone, new = np.ones(len(old), bool), np.ones(len(now), bool)
        gone[old_row], new[row] = False, False
        kind = np.repeat([0, 1, 2], [len(row), int(gone.sum()), int(new.sum())])
        index = np.concatenate([np.arange(len(row)), np.flatnonzero(gone), np.flatnonzero(new)])
        ids = np.concatenate([now.id[row], old.id[gone], now.id[new]])
        order = np.lexsort([index, kind, ids])
        numbers = self._numbers_of(kind[order], index[order], ids[order])
        begun = np.isin(numbers, list(self._told))
        first = order[np.argsort(~begun, kind="stable")]
        chosen = first[: self.budget.admit(int(begun.sum()), len(first))]
        numbers_by_lie = np.empty(len(order), np.int64)
        numbers_by_lie[order] = numbers
        self._told = set(numbers_by_lie[chosen].tolist())
        chosen = np.sort(chosen)
        moved, shown, hidden = (chosen[kind[chosen] == each] for each in (0, 1, 2))
        return Lies(
            inserted=old.select(index[shown]).with_(id=numbers_by_lie[shown]),
            hidden=index[hidden],
            hidden_number=numbers_by_lie[hidden],
            changed=row[index[moved]],
            claims=old.select(old_row[index[moved]]),
            changed_number=numbers_by_lie[moved],
        )

    def _numbers_of(self, kind: Ints, index: Ints, ids: Ints) -> Ints:
        """The number of each lie: one for each track id; detections are numbered in order."""
        keys = np.where(ids >= 0, ids, -1 - (2 * index + (kind == 2)))
        for key in keys.tolist():
            if key not in self._number_of:
                self._number_of[key] = int(self.numbers(1)[0])
        return np.array([self._number_of[key] for key in keys.tolist()], np.int64)


def _same_ids(old: ObjectStates, now: ObjectStates) -> tuple[Ints, Ints]:
    """Rows (k,) of objects of two messages with the same track id."""
    if len(old) == 0 or len(now) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, first_old = np.unique(old.id, return_index=True)
    _, first_now = np.unique(now.id, return_index=True)
    old_row, now_row = first_old[old.id[first_old] >= 0], first_now[now.id[first_now] >= 0]
    same: Bools = old.id[old_row][:, None] == now.id[now_row]
    i, j = same.nonzero()
    return old_row[i], now_row[j]
