"""Objects known only to disconnected agents.

Their tracks did not reach the broker in time.
Pure; docs/explanation-metrics-and-causes.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.metrics.assignment import find, occurs
from mast_zenoh.metrics.estimates import LOCAL
from mast_zenoh.metrics.scores import MATCHED, Scores

#: Roles needed to compute a picture.
CENTRE = ("broker", "command_center")


@dataclass(frozen=True, slots=True)
class CutOffObjects:
    """n objects, each in one frame, that only disconnected agents could have reported.

    truth_id, frame: (n,) int64; tracked: (n,) whether such an agent tracks it, as opposed to only sensing it
    """

    truth_id: Ints
    frame: Ints
    tracked: Bools

    @classmethod
    def nothing(cls) -> CutOffObjects:
        """The result without disconnected agents."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, bool))

    def contains(self, truth_id: Ints, frame: Ints, tracked: Bools | None = None) -> Bools:
        """Whether m objects in frames are among these: (m,).

        tracked: (m,) where set, only tracked objects count; None: all count
        """
        row = find((truth_id, frame), (self.truth_id, self.frame))
        is_cut_off = row >= 0
        return is_cut_off if tracked is None else is_cut_off & (~tracked | np.append(self.tracked, False)[row])


@dataclass(frozen=True, slots=True, kw_only=True)
class CutOff:
    """Conditions under which an agent's tracks are missing from the picture.

    useful_age_s: s, older tracks count as missing, even if the broker still uses them: they show where objects were
    recovery_s:   s, how long it takes until tracks of an agent that was missing for longer appear in the picture
    Raises ValueError for a value below 0.
    """

    useful_age_s: float = 0.25
    recovery_s: float = 1.0

    def __post_init__(self) -> None:
        check("0 or more, finite", useful_age_s=self.useful_age_s, recovery_s=self.recovery_s)

    def objects(
        self,
        scores: Scores,
        period_s: float,
        silent: Bools,
        undelivered: Bools,
        min_points: int = 5,
        displaced: Bools | None = None,
    ) -> CutOffObjects:
        """Objects known only to agents that are missing from the picture.

        No other agent tracks them.
        An agent knows the objects in its own tracks. If these were not received, and during the recovery after that,
        the objects that its sensor sees are used instead.

        scores:     the scores of f frames, for the agents' own tracks
        period_s:   s, frame period
        silent:     (f, a) of a agents: its tracks did not reach the broker in time
        undelivered:    (f, a) its tracks were not received in time by any node, including the evaluator
        min_points: lidar points from which an agent sees an object
        displaced:  (n, a) the agent's tracks of the object of n rows of the truth arrived elsewhere; None: nowhere
        """
        missing = self.missing(silent, undelivered, period_s)
        if not missing.any() and (displaced is None or not displaced.any()):
            return CutOffObjects.nothing()
        judged, truth = scores.judged, scores.truth
        ids, row, frame = truth.boxes.id, truth.boxes.group, scores.truth_frame
        tracked = np.zeros((len(ids), len(scores.agents)), bool)
        for k, agent in enumerate(scores.agents):
            series = scores.every_series.get((agent, LOCAL), -1)
            own = (judged.series == series) & ~judged.is_track & (judged.outcome == MATCHED)
            tracked[:, k] = occurs((ids, frame), (judged.id[own], judged.frame[own]))
        disconnected = missing[row] if displaced is None else missing[row] | displaced
        undelivered_rows = self._extend_through_recovery(undelivered, period_s)[row]
        tracked_by_missing = np.asarray((disconnected & tracked).any(axis=1))
        seen_by_missing = (disconnected & undelivered_rows & (truth.points >= min_points)).any(axis=1)
        only_missing = (tracked_by_missing | seen_by_missing) & ~(~disconnected & tracked).any(axis=1)
        return CutOffObjects(ids[only_missing], frame[only_missing], tracked_by_missing[only_missing])

    def missing(self, silent: Bools, undelivered: Bools, period_s: float) -> Bools:
        """Whether an agent's tracks are missing from the picture: (f, a).

        Undelivered frames count if they last longer than the broker uses the agent's last tracks; until then the
        tracks may only be late.
        """
        return self._extend_through_recovery(silent | (_runs(undelivered) > self._age_frames(period_s)), period_s)

    def _age_frames(self, period_s: float) -> int:
        """Number of frames for which an agent's last tracks are used."""
        return int(self.useful_age_s / period_s + 1e-6)

    def _extend_through_recovery(self, mask: Bools, period_s: float) -> Bools:
        """Extend long runs of a mask (f, a) by `recovery_s`.

        Runs are long if they outlast the use of the agent's last tracks.
        """
        recovery_frames = round(self.recovery_s / period_s)
        frame = np.arange(len(mask))[:, None]
        last_outage = np.where(_runs(mask) > self._age_frames(period_s), frame, -recovery_frames - 1)
        return np.asarray(mask | (frame - np.maximum.accumulate(last_outage, axis=0) <= recovery_frames))


def _runs(mask: Bools) -> Ints:
    """Length (f, a) of the run of set values that contains each value; 0 if not set."""
    result = np.zeros(mask.shape, np.int64)
    for k, column in enumerate(mask.T):
        edge = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(np.int8)))
        for begin, end in edge.reshape(-1, 2):
            result[begin:end, k] = end - begin
    return result


class Presence:
    """Joining and leaving of nodes; a node that joined later was absent before."""

    def __init__(self) -> None:
        self._changes: dict[str, list[tuple[int, bool]]] = {}
        self._roles: dict[str, str] = {}

    def note(self, node: str, role: str, frame: int, present: bool) -> None:
        """Record that a node is present, or absent, from a frame onwards."""
        self._changes.setdefault(node, []).append((frame, present))
        self._roles[node] = role

    def absences(self, frames: Ints) -> dict[str, Bools]:
        """By node, (f,) bool: whether it was absent in each of (f,) frames."""
        result = {}
        for node, changes in self._changes.items():
            away = np.full(len(frames), changes[0][1])
            for frame, present in changes:
                away[frames >= frame] = not present
            result[node] = away
        return result

    def absent(self, agents: Sequence[str], frames: Ints) -> Bools:
        """Whether the agent, broker or command centre is absent in each frame: (f, a)."""
        result = np.zeros((len(frames), len(agents)), bool)
        for node, away in self.absences(frames).items():
            if self._roles[node] in CENTRE:
                result |= away[:, None]
            elif node in agents:
                result[:, list(agents).index(node)] |= away
        return result
