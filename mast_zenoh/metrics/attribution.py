"""Why each false track of the picture is there, and why each missed object is missing. Pure; see docs/metrics.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.metrics.lies import SAME_M, Hidden, Places, nearest, shown
from mast_zenoh.metrics.lookup import find, occurs
from mast_zenoh.metrics.record import PICTURE
from mast_zenoh.metrics.scores import Table
from mast_zenoh.metrics.severed import Severed
from mast_zenoh.states import Bools, Floats, Ints

#: Causes of false (FP) and missed (FN) objects, the adversaries' first.
CAUSES = (
    "injected",
    "removed",
    "moved",
    "duplicate",
    "lag",
    "occlusion or range",
    "clutter",
    "fusion",
    "link or fault",
)
INJECTED, REMOVED, MOVED, DUPLICATE, LAG, SIGHT, CLUTTER, FUSION, FAULT = range(len(CAUSES))
_UNKNOWN = -1
#: Who is to blame, and for which causes; what neither is to blame for is natural.
ATTACK_CAUSES, FAULT_CAUSES = CAUSES[INJECTED : MOVED + 1], CAUSES[FAULT:]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """How near and how recent a cause must be.

    lie_m:     m, from a false track to the object that an adversary shows there
    hidden_m:  m, from where an object was hidden or displaced to the truth object that it is
    object_m:  m, from a false track to the truth object that it is a second track of, or one of an object not evaluated
    astray_m:  m, from a false track to the missed truth object that it is taken to be the inaccurate track of
    coast_s:   s, how long a track may outlive what it was a track of
    begin_s:   s, how long an object that has come into view may go without a track
    """

    lie_m: float = 5.0
    hidden_m: float = 4.0
    object_m: float = 3.0
    astray_m: float = 6.0
    coast_s: float = 4.0
    begin_s: float = 1.0

    def label(
        self, objects: Table, attacks: Table, truth: Boxes, period_s: float, severed: Severed | None = None
    ) -> tuple[Texts, Texts]:
        """`cause` and `by` of each row of `objects`, both (n,) str: empty unless the row is a false track or a missed
        object of the picture.

        objects:  `Scores.objects`: of all agents, their own tracks (estimator "local") included
        attacks:  the adversaries' reports, a row per change: adversary, frame, action, target, before_x … after_z, vx …
        truth:    all objects, evaluated or not, world frame; group = frame
        period_s: s from frame to frame
        severed:  objects that only agents could have told of whose tracks did not get through; None: all got through

        `by` names the adversaries, joined by "+" where several told the same lie; empty for other causes.
        """
        return _Case(self, objects, attacks, truth, period_s, severed or Severed.nothing()).labels()


Texts = NDArray[np.str_]


class _Rows(NamedTuple):
    """Rows of the picture of one kind, sorted by agent, id and frame."""

    row: Ints  #: in `objects`
    agent: Ints
    frame: Ints
    id: Ints
    match: Ints
    outcome: Texts
    position: Floats

    def places(self, mask: Bools | Ints) -> Places:
        return Places(self.frame[mask], self.position[mask])


class _Case:
    """One run under investigation."""

    def __init__(
        self, how: Attribution, objects: Table, attacks: Table, truth: Boxes, period_s: float, severed: Severed
    ) -> None:
        self.how, self.objects, self.truth, self.period_s = how, objects, truth, period_s
        self.severed = severed
        self.coast = round(how.coast_s / period_s)
        self.names, self.adversary = np.unique(np.asarray(attacks["adversary"], str), return_inverse=True)
        self.action = np.asarray(attacks["action"], str)
        picture = np.flatnonzero(objects["estimator"] == PICTURE)
        agent, is_track = _numbered(objects["agent"][picture]), objects["kind"][picture] == "track"
        self.tracks = self._rows(picture[is_track], agent[is_track])
        self.truths = self._rows(picture[~is_track], agent[~is_track])
        self.attacks = attacks
        self.hidden = [
            (code, adversary, Hidden.of(attacks, self._reports(adversary, action), truth, how.hidden_m))
            for action, code in (("removed", REMOVED), ("moved", MOVED))
            for adversary in range(len(self.names))
        ]

    def _rows(self, rows: Ints, agent: Ints) -> _Rows:
        table = {name: self.objects[name][rows] for name in ("frame", "id", "match_id", "outcome", "x", "y", "z")}
        order = np.lexsort((table["frame"], table["id"], agent))
        position = np.column_stack([table[axis] for axis in "xyz"])[order]
        frame, id_, match, outcome = (table[name][order] for name in ("frame", "id", "match_id", "outcome"))
        return _Rows(rows[order], agent[order], frame, id_, match, outcome, position)

    def labels(self) -> tuple[Texts, Texts]:
        n = len(self.objects["frame"])
        cause, by = np.full(n, _UNKNOWN), np.zeros((n, len(self.names)), bool)
        false, missed = self.tracks.outcome == "false", self.truths.outcome == "missed"
        track_cause, track_by = self._lies(false)
        self._honest_tracks(false, track_cause)
        cause[self.tracks.row], by[self.tracks.row] = track_cause, track_by
        truth_cause, truth_by = self._missed(missed, track_cause, track_by)
        cause[self.truths.row], by[self.truths.row] = truth_cause, truth_by
        words = np.array(CAUSES)
        named = np.zeros(n, words.dtype)
        known = np.flatnonzero(cause >= 0)
        named[known] = words[cause[known]]
        return named, self._joined(by)

    def _joined(self, by: Bools) -> Texts:
        """(n,) the names in each row of (n, a)."""
        some = np.flatnonzero(by.any(axis=1))
        kind = np.zeros(len(some), np.int64)
        for column in by[some].T:
            _, first, kind = np.unique(2 * kind + column, return_index=True, return_inverse=True)
        words = ["+".join(self.names[each]) for each in by[some[first]]] if len(some) else []
        result = np.zeros(len(by), dtype=f"<U{max(map(len, words), default=1)}")
        result[some] = np.array(words or [""])[kind]
        return result

    def _reports(self, adversary: int, action: str) -> Bools:
        return np.asarray((self.adversary == adversary) & (self.action == action))

    def _lies(self, false: Bools) -> tuple[Ints, Bools]:
        """Of each track row, cause and adversaries if it is the track of a lie; else unknown."""
        t, how = self.tracks, self.how
        cause, by = np.full(len(t.row), _UNKNOWN), np.zeros((len(t.row), len(self.names)), bool)
        if not len(self.names):
            return cause, by
        at = np.flatnonzero(false)
        places = t.places(at)
        columns = [(action, a) for action in ("added", "moved") for a in range(len(self.names))]
        distance = np.column_stack(
            [
                nearest(places, shown(self.attacks, self._reports(a, action), self.period_s, how.coast_s), how.lie_m)[1]
                for action, a in columns
            ]
        )
        best = distance.argmin(axis=1)
        least = distance[np.arange(len(at)), best]
        told = np.isfinite(least)
        moved = best >= len(self.names)
        cause[at[told]] = np.where(moved, MOVED, INJECTED)[told]
        same = (distance <= least[:, None] + SAME_M) & told[:, None]
        half = len(self.names)
        by[at] = np.where(moved[:, None], same[:, half:], same[:, :half])
        # A track of a lie stays one while it coasts, and was one when it began, until it meets a real object.
        for backwards in (False, True):
            found = self._carried(t, cause >= 0, (cause >= 0) | (t.outcome == "matched"), backwards)
            filled = np.flatnonzero(false & (cause < 0) & (found >= 0))
            cause[filled], by[filled] = cause[found[filled]], by[found[filled]]
        # A track of a real object that is being hidden or displaced goes astray.
        lone = np.flatnonzero(false & (cause < 0))
        matched = t.outcome == "matched"
        last = self._carried(t, matched, matched)[lone]
        lone, last = lone[last >= 0], last[last >= 0]
        self._blame_hiding(t.match[last], t.frame[lone], lone, cause, by)
        return cause, by

    def _blame_hiding(self, truth_id: Ints, frame: Ints, rows: Ints, cause: Ints, by: Bools) -> None:
        """Set cause and adversaries of `rows`, which are about these objects, where these were hidden lately."""
        for code, adversary, hidden in self.hidden:
            guilty = rows[hidden.lately(truth_id, frame, self.coast)]
            guilty = guilty[(cause[guilty] < 0) | (cause[guilty] == code)]
            cause[guilty], by[guilty, adversary] = code, True

    def _carried(self, rows: _Rows, valid: Bools, stops: Bools, backwards: bool = False) -> Ints:
        """(n,) of each row the last row of the same agent and id that `stops`, -1 unless it is `valid` and recent.

        backwards: the next one instead.
        """
        turn = slice(None, None, -1) if backwards else slice(None)
        n = len(rows.row)
        place = np.maximum.accumulate(np.where(stops[turn], np.arange(n), -1)) if n else np.zeros(0, np.int64)
        last = place[turn]
        known = last >= 0
        last = np.where(known & backwards, n - 1 - last, last)
        same = known & (rows.agent[last] == rows.agent) & (rows.id[last] == rows.id) & valid[last]
        same &= np.abs(rows.frame[last] - rows.frame) <= self.coast
        return np.where(same, last, -1)

    def _honest_tracks(self, false: Bools, cause: Ints) -> None:
        """Causes of the false tracks that no adversary is to blame for."""
        t, u, how = self.tracks, self.truths, self.how
        matched = t.outcome == "matched"
        last = self._carried(t, matched, matched)
        seen = u.outcome != "unevaluated"
        for agent in range(int(t.agent.max(initial=-1)) + 1):
            lone = np.flatnonzero(false & (cause < 0) & (t.agent == agent))
            mine = np.flatnonzero(u.agent == agent)
            places = t.places(lone)
            everything = Places(self.truth.group, self.truth.position)
            real, _ = nearest(places, everything, how.object_m)
            double, _ = nearest(places, u.places(mine[u.outcome[mine] == "matched"]), how.object_m)
            astray, _ = nearest(places, u.places(mine[u.outcome[mine] == "missed"]), how.astray_m)
            # Whether the object that the track was of is still evaluated for this agent in this frame.
            there = occurs((t.match[last[lone]], t.frame[lone]), (u.id[mine[seen[mine]]], u.frame[mine[seen[mine]]]))
            exists = occurs((t.match[last[lone]], t.frame[lone]), (self.truth.id, self.truth.group))
            coasting = last[lone] >= 0
            cause[lone] = np.select(
                [astray >= 0, double >= 0, real >= 0, coasting & exists & ~there, coasting],
                [LAG, DUPLICATE, SIGHT, SIGHT, LAG],
                CLUTTER,
            )
            # What no message can correct: the track of an object that only those can tell of who are cut off.
            missed = np.append(u.id[mine[u.outcome[mine] == "missed"]], -1)
            of = np.where(astray >= 0, missed[astray], np.where(coasting, t.match[last[lone]], -1))
            cut = np.isin(cause[lone], (LAG, DUPLICATE)) & self.severed.has(of, t.frame[lone])
            cause[lone[cut]] = FAULT

    def _missed(self, missed: Bools, track_cause: Ints, track_by: Bools) -> tuple[Ints, Bools]:
        """Causes of the missed objects."""
        t, u = self.tracks, self.truths
        cause, by = np.full(len(u.row), _UNKNOWN), np.zeros((len(u.row), len(self.names)), bool)
        rows = np.flatnonzero(missed)
        self._blame_hiding(u.id[rows], u.frame[rows], rows, cause, by)
        # The track that it had follows a lie now.
        matched = u.outcome == "matched"
        last = self._carried(u, matched, matched)
        lone = rows[(cause[rows] < 0) & (last[rows] >= 0)]
        lured = np.flatnonzero((track_cause >= 0) & (track_cause <= MOVED))
        at = find((u.agent[lone], u.match[last[lone]], u.frame[lone]), (t.agent[lured], t.id[lured], t.frame[lured]))
        lone, at = lone[at >= 0], lured[at[at >= 0]]
        cause[lone], by[lone] = track_cause[at], track_by[at]
        lone = rows[cause[rows] < 0]
        own = np.flatnonzero((self.objects["estimator"] == "local") & (self.objects["outcome"] == "matched"))
        own = own[self.objects["kind"][own] == "truth"]
        tracked = occurs((u.id[lone], u.frame[lone]), (self.objects["id"][own], self.objects["frame"][own]))
        fresh = u.frame[lone] - self._begun(u)[lone] < round(self.how.begin_s / self.period_s)
        cut = self.severed.has(u.id[lone], u.frame[lone], tracked=fresh)
        off = np.zeros(len(lone), bool)
        for agent in range(int(u.agent.max(initial=-1)) + 1):
            here = u.agent[lone] == agent
            stray = np.flatnonzero((t.agent == agent) & (t.outcome == "false") & np.isin(track_cause, (LAG, FAULT)))
            off[here] = nearest(u.places(lone[here]), t.places(stray), self.how.astray_m)[0] >= 0
        cause[lone] = np.select([cut, fresh, off, ~tracked], [FAULT, LAG, LAG, SIGHT], FUSION)
        return cause, by

    def _begun(self, rows: _Rows) -> Ints:
        """(n,) frame in which the object of each row came into view: since then it has been evaluated throughout."""
        seen = rows.outcome != "unevaluated"
        first = np.ones(len(rows.row), bool)
        first[1:] = (np.diff(rows.agent) != 0) | (np.diff(rows.id) != 0) | (np.diff(rows.frame) != 1)
        first[1:] |= seen[1:] != seen[:-1]
        start = np.maximum.accumulate(np.where(first, np.arange(len(first)), 0)) if len(first) else first.astype(int)
        return np.asarray(rows.frame[start])


def _numbered(names: Texts) -> Ints:
    """(n,) the number of each name among the different ones; quick where equal ones are next to each other."""
    first = np.ones(len(names), bool)
    first[1:] = names[1:] != names[:-1]
    heads = first.nonzero()[0]
    _, number = np.unique(names[heads], return_inverse=True)
    return np.repeat(number, np.diff(heads, append=len(names)))
