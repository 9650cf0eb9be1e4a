"""Attribution: the cause of every error of every estimate.

Pure; see docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

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
    Labels,
    claimed_positions,
    joined_names,
)
from mast_zenoh.metrics.cut_off import CutOffObjects
from mast_zenoh.metrics.histories import Histories
from mast_zenoh.metrics.lookup import find, latest, occurs
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, MOVED, Manipulations
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.record import LOCAL, RECEIVED, TruthTable
from mast_zenoh.metrics.scores import FALSE, MATCHED, MISSED, UNEVALUATED, Scores


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """How near and how recent the cause of an error must be.

    lie_m:     m, maximum distance from a false track to the object that an adversary inserted or moved there
    same_m:    m, adversaries whose false objects are this near each other show the same object
    object_m:  m, maximum distance from a duplicate track, or the track of an unevaluated object, to the truth object
    astray_m:  m, maximum distance from an inaccurate track to its missed truth object
    hidden_m:  m, maximum distance from where an object was removed, moved or altered to its truth object
    least_move_m: m, smaller displacements do not count, because the metrics cannot detect them
    coast_s:   s, how long a track may coast, and an estimate may be wrong after a manipulation
    begin_s:   s, how long an object that has come into view may have no track
    late_picture_s: s, how long an estimate may be wrong after a link delayed a picture
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
        manipulations: Manipulations,
        truth: TruthTable,
        agents: Sequence[str],
        period_s: float,
        cut_off_objects: CutOffObjects | None = None,
        min_points: int = 5,
    ) -> Labels:
        """The cause of every false track, missed object and identity switch.

        Covers every estimate of the run.
        manipulations: those of all interposers; their series are those of `scores`
        truth:    of the frames of `scores`, with `agents` as its columns
        period_s: s, frame period
        cut_off_objects:  objects known only to disconnected agents; None: no agent was disconnected
        min_points: lidar points from which an agent sees an object
        """
        return _Attributor(
            self, scores, manipulations, truth, agents, period_s, cut_off_objects or CutOffObjects.nothing(), min_points
        ).labels()


class _Attributor:
    """The attribution of one run."""

    def __init__(
        self,
        limits: Attribution,
        scores: Scores,
        manipulations: Manipulations,
        truth: TruthTable,
        agents: Sequence[str],
        period_s: float,
        cut_off_objects: CutOffObjects,
        min_points: int,
    ) -> None:
        self.min_points = min_points
        self.limits, self.scores, self.manipulations, self.truth = limits, scores, manipulations, truth
        self.period_s, self.cut_off_objects = period_s, cut_off_objects
        self.coast = round(limits.coast_s / period_s)
        self.span = int(scores.frames.max(initial=0)) + 1
        self.tracks = Histories.of_wrong(scores, FALSE, self.span, tracks=True)
        self.truths = Histories.of_wrong(scores, MISSED, self.span, tracks=False)
        #: whether a series is computed from an agent's own sensor alone
        own = [estimator in (LOCAL, RECEIVED) for _, estimator in scores.series]
        self.own = np.array(own, bool)
        self.column = np.array([agents.index(agent) for agent, _ in scores.series], np.int64)
        self.truth_frame = scores.frames[truth.boxes.group]

    def labels(self) -> Labels:
        n = len(self.scores.judged.frame)
        cause, by = np.full(n, UNKNOWN), np.zeros((n, len(self.manipulations.culprits)), bool)
        false, missed = self.tracks.outcome == FALSE, self.truths.outcome == MISSED
        self.hidden = Hidden.of(self.manipulations)
        track_cause, track_by = self._attack_tracks(false)
        self._natural_tracks(false, track_cause)
        cause[self.tracks.row], by[self.tracks.row] = track_cause, track_by
        truth_cause, truth_by = self._missed_objects(missed, track_cause, track_by)
        cause[self.truths.row], by[self.truths.row] = truth_cause, truth_by
        switch_cause, switch_by = self._switches(track_cause, track_by)
        names = self.manipulations.culprits
        return Labels(cause, joined_names(names, by), switch_cause, joined_names(names, switch_by))

    def _switches(self, track_cause: Ints, track_by: Bools) -> tuple[Ints, Bools]:
        """Causes of the identity switches: hiding, a false object, otherwise tracking."""
        tracks, switches = self.tracks, self.scores.switches
        frame = self.scores.frames[switches.frame]
        cause, by = np.full(len(frame), UNKNOWN), np.zeros((len(frame), len(self.manipulations.culprits)), bool)
        rows = np.arange(len(frame))
        self._blame_hiding(switches.truth_id, frame, switches.series, rows, cause, by)
        blamed = np.isin(track_cause, (INSERTED, MOVED, FAULT)).nonzero()[0]
        for id_ in (switches.before, switches.after):
            last = latest(
                (switches.series, id_), frame, (tracks.series[blamed], tracks.id[blamed]), tracks.frame[blamed]
            )
            recent = (last >= 0) & (frame - np.append(tracks.frame[blamed], 0)[last] <= self.coast)
            recent &= cause == UNKNOWN
            cause[recent], by[recent] = track_cause[blamed[last[recent]]], track_by[blamed[last[recent]]]
        return np.where(cause == UNKNOWN, TRACKING, cause), by

    def _attack_tracks(self, false: Bools) -> tuple[Ints, Bools]:
        """Cause and culprits of track rows that follow an object shown by an adversary."""
        tracks, manipulations = self.tracks, self.manipulations
        cause, by = np.full(len(tracks.row), UNKNOWN), np.zeros((len(tracks.row), len(manipulations.culprits)), bool)
        if not len(manipulations):
            return cause, by
        false_rows = false.nonzero()[0]
        places = tracks.places(false_rows)
        best, nearest_kind = np.full(len(false_rows), np.inf), np.full(len(false_rows), UNKNOWN)
        near: list[tuple[int, int, Floats]] = []
        for kind in (INSERTED, MOVED):
            for culprit in range(-1, len(manipulations.culprits)):
                rows = ((manipulations.kind == kind) & (manipulations.culprit == culprit)).nonzero()[0]
                if not len(rows):
                    continue
                claimed = claimed_positions(manipulations.select(rows), self.period_s, self.coast, self.span)
                _, distance = nearest(places, claimed, self.limits.lie_m)
                near.append((kind, culprit, distance))
                closer = distance < best
                best[closer], nearest_kind[closer] = distance[closer], kind if culprit >= 0 else FAULT
        explained = np.isfinite(best)
        cause[false_rows[explained]] = nearest_kind[explained]
        for kind, culprit, distance in near:
            if culprit >= 0:
                same = explained & (nearest_kind == kind) & (distance <= best + self.limits.same_m)
                by[false_rows[same], culprit] = True
        # A cause extends to rows of the track up to `coast` frames later and earlier, but not past a real object.
        for later in (False, True):
            source = tracks.adjacent(cause >= 0, (cause >= 0) | (tracks.outcome == MATCHED), self.coast, later=later)
            extended = (false & (cause < 0) & (source >= 0)).nonzero()[0]
            if later:  # a cause cannot precede the manipulation
                first_shown = self._first_shown(tracks.series[extended], by[source[extended]])
                extended = extended[tracks.frame[extended] >= first_shown]
            cause[extended], by[extended] = cause[source[extended]], by[source[extended]]
        # A track of a real object becomes inaccurate while that object is hidden, moved or altered.
        matched = tracks.outcome == MATCHED
        free = (false & (cause < 0)).nonzero()[0]
        last = tracks.adjacent(matched, matched, self.coast)[free]
        free, last = free[last >= 0], last[last >= 0]
        self._blame_hiding(tracks.match[last], tracks.frame[free], tracks.series[free], free, cause, by)
        return cause, by

    def _first_shown(self, series: Ints, by: Bools) -> Ints:
        """First frame (n,) in which any of the culprits (n, c) showed an object.

        The object must be visible in the series. For rows without a culprit, links are used.
        """
        manipulations = self.manipulations
        # The last row is for links.
        first_frame = np.full((len(manipulations.culprits) + 1, len(self.scores.series)), self.span)
        shows = np.isin(manipulations.kind, (INSERTED, MOVED))
        for culprit in range(-1, len(manipulations.culprits)):
            rows = (shows & (manipulations.culprit == culprit)).nonzero()[0]
            if len(rows):
                reach = manipulations.reach[manipulations.passage[rows]]
                frame = np.where(reach, manipulations.frame[rows, None], self.span)
                first_frame[culprit] = frame.min(axis=0)
        responsible = np.column_stack([by, ~by.any(axis=1)])
        return np.asarray(np.where(responsible, first_frame[:, series].T, self.span).min(axis=1))

    def _blame_hiding(self, truth_id: Ints, frame: Ints, series: Ints, rows: Ints, cause: Ints, by: Bools) -> None:
        """Set cause and culprits of `rows` whose object was recently hidden."""
        for code, culprit, blamed in self.hidden.recent(truth_id, frame, series):
            selected = rows[blamed]
            selected = selected[(cause[selected] < 0) | (cause[selected] == code)]
            cause[selected] = code
            if culprit >= 0:
                by[selected, culprit] = True

    def _natural_tracks(self, false: Bools, cause: Ints) -> None:
        """Causes of the false tracks that no adversary shows."""
        tracks, limits = self.tracks, self.limits
        matched = tracks.outcome == MATCHED
        free = (false & (cause < 0)).nonzero()[0]  # rows without a cause yet
        if not len(free):
            return
        truths = self._truths_beside(tracks.row[free])
        last = tracks.adjacent(matched, matched, self.coast)[free]
        places = tracks.places(free)
        all_objects = Places(self.truth_frame, self.truth.boxes.position)
        real, _ = nearest(Places(tracks.frame[free], tracks.position[free]), all_objects, limits.object_m)
        double, _ = nearest(places, truths.places(truths.outcome == MATCHED), limits.object_m)
        missed = (truths.outcome == MISSED).nonzero()[0]
        astray, _ = nearest(places, truths.places(missed), limits.astray_m)
        # Whether the object of the track is still evaluated in this series and frame.
        rows = (truths.outcome != UNEVALUATED).nonzero()[0]
        keys = tracks.match[last], tracks.frame[free]
        evaluated = occurs((tracks.series[free], *keys), (truths.series[rows], truths.id[rows], truths.frame[rows]))
        exists = occurs(keys, (self.truth.boxes.id, self.truth_frame))
        coasting = last >= 0
        cause[free] = np.select(
            [astray >= 0, double >= 0, real >= 0, coasting & exists & ~evaluated, coasting],
            [LAG, DUPLICATE, SIGHT, SIGHT, LAG],
            CLUTTER,
        )
        # Tracks of objects known only to disconnected agents.
        last_id = np.where(coasting, tracks.match[last], -1)
        truth_id = np.where(astray >= 0, np.append(truths.id[missed], -1)[astray], last_id)
        disconnected = np.isin(cause[free], (LAG, DUPLICATE)) & ~self.own[tracks.series[free]]
        disconnected &= self.cut_off_objects.contains(truth_id, tracks.frame[free])
        cause[free[disconnected]] = FAULT

    def _truths_beside(self, rows: Ints) -> Histories:
        """The truth rows in the series and frames of these rows of `scores.judged`."""
        judged = self.scores.judged
        group = judged.boxes.group
        involved = np.zeros(int(group.max(initial=0)) + 1, bool)
        involved[group[rows]] = True
        return Histories.of(self.scores, np.flatnonzero(~judged.is_track & involved[group]), self.span)

    def _missed_objects(self, missed: Bools, track_cause: Ints, track_by: Bools) -> tuple[Ints, Bools]:
        """Causes of the missed objects."""
        tracks, truths = self.tracks, self.truths
        n = len(truths.row)
        cause, by = np.full(n, UNKNOWN), np.zeros((n, len(self.manipulations.culprits)), bool)
        rows = missed.nonzero()[0]
        self._blame_hiding(truths.id[rows], truths.frame[rows], truths.series[rows], rows, cause, by)
        # The previous track of the object now follows a manipulated object.
        matched = truths.outcome == MATCHED
        last = truths.adjacent(matched, matched, self.coast)
        free = rows[(cause[rows] < 0) & (last[rows] >= 0)]
        diverted = ((track_cause >= INSERTED) & (track_cause <= ALTERED)).nonzero()[0]
        keys = truths.series[free], truths.match[last[free]], truths.frame[free]
        at = find(keys, (tracks.series[diverted], tracks.id[diverted], tracks.frame[diverted]))
        free, at = free[at >= 0], diverted[at[at >= 0]]
        cause[free], by[free] = track_cause[at], track_by[at]
        free = rows[cause[rows] < 0]
        tracked = self._tracked(truths, free)
        is_new = truths.frame[free] - truths.period_start()[free] < round(self.limits.begin_s / self.period_s)
        own = self.own[truths.series[free]]
        disconnected = ~own & self.cut_off_objects.contains(truths.id[free], truths.frame[free], tracked=is_new)
        inaccurate = (tracks.outcome == FALSE) & np.isin(track_cause, (LAG, FAULT))
        near_inaccurate = nearest(truths.places(free), tracks.places(inaccurate), self.limits.astray_m)[0] >= 0
        cause[free] = np.select(
            [disconnected, is_new, near_inaccurate, ~tracked, own], [FAULT, LAG, LAG, SIGHT, TRACKING], FUSION
        )
        return cause, by

    def _tracked(self, rows: Histories, selected: Ints) -> Bools:
        """Whether the input of each row's estimate contains its object.

        The input is the agent's sensor for an estimate from its own sensor, else the local tracks of all agents.
        """
        judged = self.scores.judged
        own = [row for (_, estimator), row in self.scores.every_series.items() if estimator == LOCAL]
        local = np.flatnonzero(np.isin(judged.series, own) & ~judged.is_track & (judged.outcome == MATCHED))
        by_any = occurs((rows.id[selected], rows.frame[selected]), (judged.id[local], judged.frame[local]))
        at = find((rows.id[selected], rows.frame[selected]), (self.truth.boxes.id, self.truth_frame))
        points = self.truth.points[at, self.column[rows.series[selected]]]
        by_itself = (at >= 0) & (points >= self.min_points)
        return np.where(self.own[rows.series[selected]], by_itself, by_any)
