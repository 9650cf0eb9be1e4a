"""Which tracks of each agent a node fuses: an input limit on messages and on the frame; counts what is left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from mast_zenoh.arrays.states import Ints
from mast_zenoh.fusion.input_limit import ClaimedObjects, InputLimit, Kept, NoInputLimit
from mast_zenoh.gather import LatestBefore
from mast_zenoh.messages.limits import RowChoice, Shortened
from mast_zenoh.messages.schemas import Body


class Admission:
    """Applies an input limit; None: NoInputLimit().

    A message with more rows than can be used is cut before its rows are checked, by what was kept until two frames
    before it was sent: a message may arrive before the clock of its frame, and must not depend on that.
    """

    def __init__(self, limit: InputLimit | None = None) -> None:
        self.left_out: Counter[str] = Counter()  # number of rows, by agent
        self._limit = limit or NoInputLimit()
        self._kept: LatestBefore[Kept] = LatestBefore()

    def begin(self, frame: int) -> None:
        """Open a frame: call it first of all in each."""
        self._kept.add(frame, self._limit.kept)

    def choice(self, agent: str, step: int) -> RowChoice | None:
        """Which rows of an agent's message are used; see `Node.choice`."""
        limit = self._limit
        if limit.rows is None:
            return None
        return RowChoice(limit.rows, lambda ids, score, rows: self._cut(agent, step, ClaimedObjects(ids, score), rows))

    def _cut(self, agent: str, step: int, objects: ClaimedObjects, rows: int) -> Ints:
        latest = self._kept.get(step)
        return self._limit.cut({} if latest is None else latest[1].get(agent, {}), objects, rows)

    def note(self, agent: str, body: Body) -> int:
        """Number of rows that a message of an agent had beyond those that are used; they count as left out."""
        beyond = body.found - len(body["score"]) if type(body) is Shortened else 0
        self.left_out[agent] += beyond
        return beyond

    def select(self, objects: Mapping[str, ClaimedObjects]) -> dict[str, Ints]:
        """Rows to fuse in a frame, of each agent of which some are left out. objects: by agent"""
        selected = self._limit.select(objects)
        for name, rows in selected.items():
            self.left_out[name] += len(objects[name].ids) - len(rows)
        return selected

    def counts(self) -> dict[str, int]:
        """Number of rows that were left out, by agent."""
        return {name: count for name, count in sorted(self.left_out.items()) if count}
