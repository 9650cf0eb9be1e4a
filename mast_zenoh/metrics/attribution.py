"""Why each false track is there and each missed object missing, in every estimate. Pure; see docs/metrics.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.causes import (
    CLUTTER,
    DUPLICATE,
    FAULT,
    FUSION,
    LAG,
    SIGHT,
    TRACKING,
    UNKNOWN,
    Hidden,
    claimed_positions,
    joined,
)
from mast_zenoh.metrics.cut_off import Severed
from mast_zenoh.metrics.histories import Histories
from mast_zenoh.metrics.lookup import find, latest, occurs
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, MOVED, Manipulations
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.record import LOCAL, RECEIVED, TruthTable
from mast_zenoh.metrics.scores import FALSE, MATCHED, MISSED, UNEVALUATED, Scores, Texts


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """How near and how recent the cause of an error must be.

    lie_m:     m, from a false track to the object that an adversary shows there
    same_m:    m, two adversaries whose false objects are this near each other show the same object
    object_m:  m, from a false track to the truth object that it is a second track of, or one of an object not evaluated
    astray_m:  m, from a false track to the missed truth object that it is taken to be the inaccurate track of
    hidden_m:  m, from where an object was removed, moved or altered to the truth object that it is
    least_move_m: m, an object that was displaced by less counts as where it was: the metrics cannot tell
    coast_s:   s, how long a track may outlive what it was a track of, and an estimate may be wrong after a manipulation
    begin_s:   s, how long an object that has come into view may go without a track
    late_picture_s: s, how long an estimate may be wrong after a link held back a picture
    Raises ValueError for a value below 0.
    """

    lie_m: float = 5.0
    same_m: float = 0.25
    object_m: float = 3.0
    astray_m: float = 6.0
    hidden_m: float = 4.0
    least_move_m: float = 0.5
    coast_s: float = 4.0
    begin_s: float = 1.0
    late_picture_s: float = 0.5

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0.0 <= (value := getattr(self, field.name)) < np.inf:
                raise ValueError(f"{field.name}: found {value}, expected 0 or more")

    def label(
        self,
        scores: Scores,
        done: Manipulations,
        truth: TruthTable,
        agents: Sequence[str],
        period_s: float,
        severed: Severed | None = None,
        min_points: int = 5,
    ) -> Labels:
        """The cause of every false track, missed object and identity switch in every estimate.

        done:     what interposers did to objects; its series are those of `scores`
        truth:    of the frames of `scores`, of which `agents` are the columns
        period_s: s from frame to frame
        severed:  objects that only agents could have reported whose tracks did not get through; None: all got through
        min_points: lidar points with which an agent's own sensor sees an object
        """
        return _Case(self, scores, done, truth, agents, period_s, severed or Severed.nothing(), min_points).labels()


class Labels(NamedTuple):
    """What the errors of a run are due to.

    cause: (n,) of each row of `Scores.judged`, an index into CAUSES; UNKNOWN: it is no error
    by:    (n,) str, the adversaries, joined by "+" where several showed the same object; empty where it is no attack
    switch_cause, switch_by: (k,) the same of each of `Scores.switches`
    """

    cause: Ints
    by: Texts
    switch_cause: Ints
    switch_by: Texts


class _Case:
    """One run under investigation."""

    def __init__(
        self,
        how: Attribution,
        scores: Scores,
        done: Manipulations,
        truth: TruthTable,
        agents: Sequence[str],
        period_s: float,
        severed: Severed,
        min_points: int,
    ) -> None:
        self.min_points = min_points
        self.how, self.scores, self.done, self.truth = how, scores, done, truth
        self.period_s, self.severed = period_s, severed
        self.coast = round(how.coast_s / period_s)
        self.span = int(scores.frames.max(initial=0)) + 1
        self.tracks = Histories.of_wrong(scores, FALSE, self.span, tracks=True)
        self.truths = Histories.of_wrong(scores, MISSED, self.span, tracks=False)
        #: what is made from an agent's own sensor alone
        own = [estimator in (LOCAL, RECEIVED) for _, estimator in scores.series]
        self.own = np.array(own, bool)
        self.column = np.array([agents.index(agent) for agent, _ in scores.series], np.int64)
        self.truth_frame = scores.frames[truth.boxes.group]

    def labels(self) -> Labels:
        n = len(self.scores.judged.frame)
        cause, by = np.full(n, UNKNOWN), np.zeros((n, len(self.done.culprits)), bool)
        false, missed = self.tracks.outcome == FALSE, self.truths.outcome == MISSED
        self.hidden = Hidden.of(self.done)
        track_cause, track_by = self._shown(false)
        self._natural_tracks(false, track_cause)
        cause[self.tracks.row], by[self.tracks.row] = track_cause, track_by
        truth_cause, truth_by = self._missed(missed, track_cause, track_by)
        cause[self.truths.row], by[self.truths.row] = truth_cause, truth_by
        switch_cause, switch_by = self._switches(track_cause, track_by)
        names = self.done.culprits
        return Labels(cause, joined(names, by), switch_cause, joined(names, switch_by))

    def _switches(self, track_cause: Ints, track_by: Bools) -> tuple[Ints, Bools]:
        """Causes of the identity switches: the object was hidden lately, or one of its two tracks was shown; else it is
        the tracking's own."""
        t, switches = self.tracks, self.scores.switches
        frame = self.scores.frames[switches.frame]
        cause, by = np.full(len(frame), UNKNOWN), np.zeros((len(frame), len(self.done.culprits)), bool)
        rows = np.arange(len(frame))
        self._blame_hiding(switches.truth_id, frame, switches.series, rows, cause, by)
        blamed = np.isin(track_cause, (INSERTED, MOVED, FAULT)).nonzero()[0]
        for id_ in (switches.before, switches.after):
            last = latest((switches.series, id_), frame, (t.series[blamed], t.id[blamed]), t.frame[blamed])
            recent = (last >= 0) & (frame - np.append(t.frame[blamed], 0)[last] <= self.coast)
            recent &= cause == UNKNOWN
            cause[recent], by[recent] = track_cause[blamed[last[recent]]], track_by[blamed[last[recent]]]
        return np.where(cause == UNKNOWN, TRACKING, cause), by

    def _shown(self, false: Bools) -> tuple[Ints, Bools]:
        """Of each track row, cause and culprits if it is the track of an object that somebody shows; else unknown."""
        t, done = self.tracks, self.done
        cause, by = np.full(len(t.row), UNKNOWN), np.zeros((len(t.row), len(done.culprits)), bool)
        if not len(done):
            return cause, by
        at = false.nonzero()[0]
        places = t.places(at)
        best, whose = np.full(len(at), np.inf), np.full(len(at), UNKNOWN)
        near: list[tuple[int, int, Floats]] = []
        for kind in (INSERTED, MOVED):
            for culprit in range(-1, len(done.culprits)):
                rows = ((done.kind == kind) & (done.culprit == culprit)).nonzero()[0]
                if not len(rows):
                    continue
                lies = claimed_positions(done.select(rows), self.period_s, self.coast, self.span)
                _, distance = nearest(places, lies, self.how.lie_m)
                near.append((kind, culprit, distance))
                closer = distance < best
                best[closer], whose[closer] = distance[closer], kind if culprit >= 0 else FAULT
        hit = np.isfinite(best)
        cause[at[hit]] = whose[hit]
        for kind, culprit, distance in near:
            if culprit >= 0:
                by[at[hit & (whose == kind) & (distance <= best + self.how.same_m)], culprit] = True
        # Such a track stays one while it coasts, and was one when it began, until it meets a real object.
        for later in (False, True):
            found = t.adjacent(cause >= 0, (cause >= 0) | (t.outcome == MATCHED), self.coast, later=later)
            filled = (false & (cause < 0) & (found >= 0)).nonzero()[0]
            if later:  # nothing is due to what began after it
                filled = filled[t.frame[filled] >= self._begun(t.series[filled], by[found[filled]])]
            cause[filled], by[filled] = cause[found[filled]], by[found[filled]]
        # A track of a real object that is being hidden, moved or altered goes astray.
        matched = t.outcome == MATCHED
        lone = (false & (cause < 0)).nonzero()[0]
        last = t.adjacent(matched, matched, self.coast)[lone]
        lone, last = lone[last >= 0], last[last >= 0]
        self._blame_hiding(t.match[last], t.frame[lone], t.series[lone], lone, cause, by)
        return cause, by

    def _begun(self, series: Ints, by: Bools) -> Ints:
        """(n,) frame in which the first of some culprits (n, c) first showed an object that can be seen in a series.

        Where there is no culprit: the first of all links.
        """
        done = self.done
        begun = np.full((len(done.culprits) + 1, len(self.scores.series)), self.span)  # links come last
        shows = np.isin(done.kind, (INSERTED, MOVED))
        for culprit in range(-1, len(done.culprits)):
            rows = (shows & (done.culprit == culprit)).nonzero()[0]
            if len(rows):
                frame = np.where(done.reach[done.passage[rows]], done.frame[rows, None], self.span)
                begun[culprit] = frame.min(axis=0)
        whose = np.column_stack([by, ~by.any(axis=1)])
        return np.asarray(np.where(whose, begun[:, series].T, self.span).min(axis=1))

    def _blame_hiding(self, truth_id: Ints, frame: Ints, series: Ints, rows: Ints, cause: Ints, by: Bools) -> None:
        """Set cause and culprits of `rows`, which are about these objects, where these were hidden lately."""
        for code, culprit, guilty in self.hidden.lately(truth_id, frame, series):
            mine = rows[guilty]
            mine = mine[(cause[mine] < 0) | (cause[mine] == code)]
            cause[mine] = code
            if culprit >= 0:
                by[mine, culprit] = True

    def _natural_tracks(self, false: Bools, cause: Ints) -> None:
        """Causes of the false tracks that nobody shows."""
        t, how = self.tracks, self.how
        matched = t.outcome == MATCHED
        lone = (false & (cause < 0)).nonzero()[0]
        if not len(lone):
            return
        u = self._truths_beside(t.row[lone])
        last = t.adjacent(matched, matched, self.coast)[lone]
        places = t.places(lone)
        everything = Places(self.truth_frame, self.truth.boxes.position)
        real, _ = nearest(Places(t.frame[lone], t.position[lone]), everything, how.object_m)
        double, _ = nearest(places, u.places(u.outcome == MATCHED), how.object_m)
        missed = (u.outcome == MISSED).nonzero()[0]
        astray, _ = nearest(places, u.places(missed), how.astray_m)
        # Whether the object that the track was of is still evaluated in this series and frame.
        seen = (u.outcome != UNEVALUATED).nonzero()[0]
        wanted = t.match[last], t.frame[lone]
        there = occurs((t.series[lone], *wanted), (u.series[seen], u.id[seen], u.frame[seen]))
        exists = occurs(wanted, (self.truth.boxes.id, self.truth_frame))
        coasting = last >= 0
        cause[lone] = np.select(
            [astray >= 0, double >= 0, real >= 0, coasting & exists & ~there, coasting],
            [LAG, DUPLICATE, SIGHT, SIGHT, LAG],
            CLUTTER,
        )
        # What no message can correct: the track of an object that only disconnected agents can report.
        of = np.where(astray >= 0, np.append(u.id[missed], -1)[astray], np.where(coasting, t.match[last], -1))
        cut = (
            np.isin(cause[lone], (LAG, DUPLICATE))
            & ~self.own[t.series[lone]]
            & self.severed.contains(of, t.frame[lone])
        )
        cause[lone[cut]] = FAULT

    def _truths_beside(self, rows: Ints) -> Histories:
        """The truth rows of the series and frames of some rows of `scores.judged`."""
        judged = self.scores.judged
        group = judged.boxes.group
        involved = np.zeros(int(group.max(initial=0)) + 1, bool)
        involved[group[rows]] = True
        return Histories.of(self.scores, np.flatnonzero(~judged.is_track & involved[group]), self.span)

    def _missed(self, missed: Bools, track_cause: Ints, track_by: Bools) -> tuple[Ints, Bools]:
        """Causes of the missed objects."""
        t, u = self.tracks, self.truths
        cause, by = np.full(len(u.row), UNKNOWN), np.zeros((len(u.row), len(self.done.culprits)), bool)
        rows = missed.nonzero()[0]
        self._blame_hiding(u.id[rows], u.frame[rows], u.series[rows], rows, cause, by)
        # The track that it had follows something that somebody shows now.
        matched = u.outcome == MATCHED
        last = u.adjacent(matched, matched, self.coast)
        lone = rows[(cause[rows] < 0) & (last[rows] >= 0)]
        lured = ((track_cause >= INSERTED) & (track_cause <= ALTERED)).nonzero()[0]
        wanted = u.series[lone], u.match[last[lone]], u.frame[lone]
        at = find(wanted, (t.series[lured], t.id[lured], t.frame[lured]))
        lone, at = lone[at >= 0], lured[at[at >= 0]]
        cause[lone], by[lone] = track_cause[at], track_by[at]
        lone = rows[cause[rows] < 0]
        tracked = self._tracked(u, lone)
        fresh = u.frame[lone] - u.begun()[lone] < round(self.how.begin_s / self.period_s)
        own = self.own[u.series[lone]]
        cut = ~own & self.severed.contains(u.id[lone], u.frame[lone], tracked=fresh)
        stray = (t.outcome == FALSE) & np.isin(track_cause, (LAG, FAULT))
        off = nearest(u.places(lone), t.places(stray), self.how.astray_m)[0] >= 0
        cause[lone] = np.select([cut, fresh, off, ~tracked, own], [FAULT, LAG, LAG, SIGHT, TRACKING], FUSION)
        return cause, by

    def _tracked(self, rows: Histories, lone: Ints) -> Bools:
        """Whether the input of each row's estimate has its object: an agent's sensor, or any agent's own tracks."""
        judged = self.scores.judged
        own = [row for (_, estimator), row in self.scores.every_series.items() if estimator == LOCAL]
        local = np.flatnonzero(np.isin(judged.series, own) & ~judged.is_track & (judged.outcome == MATCHED))
        by_any = occurs((rows.id[lone], rows.frame[lone]), (judged.id[local], judged.frame[local]))
        at = find((rows.id[lone], rows.frame[lone]), (self.truth.boxes.id, self.truth_frame))
        points = self.truth.points[at, self.column[rows.series[lone]]]
        by_itself = (at >= 0) & (points >= self.min_points)
        return np.where(self.own[rows.series[lone]], by_itself, by_any)
