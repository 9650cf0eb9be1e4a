"""Whose tracks did not reach the broker in time, and which objects nobody else could tell of. Pure; docs/metrics.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.metrics.lookup import find, occurs
from mast_zenoh.metrics.record import LOCAL, TruthTable
from mast_zenoh.metrics.scores import MATCHED, Scores

#: Roles without which no agent's tracks become a picture.
CENTRE = ("broker", "command_center")


@dataclass(frozen=True, slots=True)
class Severed:
    """n objects, each in one frame, that only agents could have told of whose tracks did not get through.

    truth_id, frame: (n,) int64; tracked: (n,) whether such an agent's own tracks hold it, not only its sensor sees it
    """

    truth_id: Ints
    frame: Ints
    tracked: Bools

    @classmethod
    def nothing(cls) -> Severed:
        """All tracks got through."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, bool))

    def has(self, truth_id: Ints, frame: Ints, tracked: Bools | None = None) -> Bools:
        """(m,) which of m objects in frames are among these; where (m,) `tracked` is set, only those in tracks."""
        row = find((truth_id, frame), (self.truth_id, self.frame))
        found = row >= 0
        return found if tracked is None else found & (~tracked | np.append(self.tracked, False)[row])


@dataclass(frozen=True, slots=True, kw_only=True)
class CutOff:
    """When an agent's tracks count as missing from the picture.

    max_age_s:  s, how long the broker goes on with an agent's newest tracks: in a scenario its parameter of that name
    recovery_s: s, how long tracks of an agent that was missing for longer than that need to become tracks of the
                picture
    Raises ValueError for a value below 0.
    """

    max_age_s: float = MAX_AGE_S
    recovery_s: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (("max_age_s", self.max_age_s), ("recovery_s", self.recovery_s)):
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name}: found {value}, expected 0 or more")

    def severed(
        self,
        scores: Scores,
        truth: TruthTable,
        agents: Sequence[str],
        frames: Ints,
        period_s: float,
        silent: Bools,
        unheard: Bools,
        min_points: int = 5,
    ) -> Severed:
        """The objects that an agent which is missing from the picture knows of, and that no other agent tracks.

        What an agent knows of are the objects in its own tracks. Of one that nobody hears, and in the second after it,
        these are not known: there it is what its sensor sees.

        scores:     of it the agents' own tracks
        truth:      of (f,) `frames`, ascending
        period_s:   s from frame to frame
        silent:     (f, a) of a agents: its tracks did not reach the broker, or not in time
        unheard:    (f, a) nobody has heard its tracks in time, the evaluator neither
        min_points: lidar points with which an agent sees an object
        """
        missing = self.missing(silent, unheard, period_s)
        if not missing.any():
            return Severed.nothing()
        ids, row = truth.boxes.id, truth.boxes.group
        judged = scores.judged
        tracked = np.zeros((len(ids), len(agents)), bool)
        for k, agent in enumerate(agents):
            series = scores.every_series.get((agent, LOCAL), -1)
            own = (judged.series == series) & ~judged.is_track & (judged.outcome == MATCHED)
            tracked[:, k] = occurs((ids, frames[row]), (judged.id[own], judged.frame[own]))
        gone, mute = missing[row], self._extend_through_recovery(unheard, period_s)[row]
        tells = np.asarray((gone & tracked).any(axis=1))
        sees = (gone & mute & (truth.points >= min_points)).any(axis=1)
        lost = (tells | sees) & ~(~gone & tracked).any(axis=1)
        return Severed(ids[lost], frames[row[lost]], tells[lost])

    def missing(self, silent: Bools, unheard: Bools, period_s: float) -> Bools:
        """(f, a) bool: in these frames an agent's tracks are not in the picture, whatever it knows.

        Being unheard counts when it lasts longer than the broker goes on with the agent's last word: until then its
        tracks may only be late.
        """
        return self._extend_through_recovery(silent | (_runs(unheard) > self._keep(period_s)), period_s)

    def _keep(self, period_s: float) -> int:
        """Frames for which an agent's last word lasts."""
        return int(self.max_age_s / period_s + 1e-6)

    def _extend_through_recovery(self, mask: Bools, period_s: float) -> Bools:
        """(f, a) the mask, and after each run in it that outlasts an agent's last word another `recovery_s`."""
        recovery = round(self.recovery_s / period_s)
        frame = np.arange(len(mask))[:, None]
        forgotten = np.where(_runs(mask) > self._keep(period_s), frame, -recovery - 1)
        return np.asarray(mask | (frame - np.maximum.accumulate(forgotten, axis=0) <= recovery))


def _runs(mask: Bools) -> Ints:
    """(f, a) how long the run of set values in its column is that each value belongs to; 0 where it is not set."""
    result = np.zeros(mask.shape, np.int64)
    for k, column in enumerate(mask.T):
        edge = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(np.int8)))
        for begin, end in edge.reshape(-1, 2):
            result[begin:end, k] = end - begin
    return result


class Presence:
    """Which nodes came and went while a run went on; one that came after its beginning was not there before."""

    def __init__(self) -> None:
        self._changes: dict[str, list[tuple[int, bool]]] = {}
        self._roles: dict[str, str] = {}

    def note(self, node: str, role: str, frame: int, there: bool) -> None:
        """From a frame on a node is there, or is not."""
        self._changes.setdefault(node, []).append((frame, there))
        self._roles[node] = role

    def idle(self, frames: Ints) -> dict[str, Bools]:
        """By node, (f,) bool: in which of (f,) frames it was not there."""
        result = {}
        for node, changes in self._changes.items():
            away = np.full(len(frames), changes[0][1])
            for frame, there in changes:
                away[frames >= frame] = not there
            result[node] = away
        return result

    def absent(self, agents: Sequence[str], frames: Ints) -> Bools:
        """(f, a) bool: the agent's process is not there in these frames, or that of the broker or the centre."""
        result = np.zeros((len(frames), len(agents)), bool)
        for node, away in self.idle(frames).items():
            if self._roles[node] in CENTRE:
                result |= away[:, None]
            elif node in agents:
                result[:, list(agents).index(node)] |= away
        return result
