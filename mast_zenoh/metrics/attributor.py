"""The attribution of one run: the cause of each error of each estimate. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.attribution_limits import AttributionLimits
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
from mast_zenoh.metrics.withheld import Withheld, reporting


class Attributor:
    """The attribution of one run.

    manipulations: those of all interposers; their series are those of `scores`
    truth:    of the frames of `scores`, with `agents` as its columns
    period_s: s, frame period
    cut_off_objects:  objects known only to disconnected agents; None: no agent was disconnected
    min_points: lidar points from which an agent sees an object
    withheld: by the command centre; None: it has no integrity stage
    displaced: (n,) rows of `truth` of which a link moved a track; None: none
    """

    def __init__(
        self,
        limits: AttributionLimits,
        scores: Scores,
        manipulations: Manipulations,
        truth: TruthTable,
        agents: Sequence[str],
        period_s: float,
        cut_off_objects: CutOffObjects | None = None,
        min_points: int = 5,
        withheld: Withheld | None = None,
        displaced: Bools | None = None,
    ) -> None:
        self.min_points, self.agents, self.withheld = min_points, tuple(agents), withheld
        self.limits, self.scores, self.manipulations, self.truth = limits, scores, manipulations, truth
        self.period_s, self.cut_off_objects = period_s, cut_off_objects or CutOffObjects.nothing()
        self.coast, self.begin = round(limits.coast_s / period_s), round(limits.begin_s / period_s)
        self.span = int(scores.frames.max(initial=0)) + 1
        self.tracks = Histories.of_wrong(scores, FALSE, self.span, tracks=True)
        self.truths = Histories.of_wrong(scores, MISSED, self.span, tracks=False)
        #: the real object that a false track followed last, and whether it is evaluated, see `_last_objects`
        self.last_id = np.full(len(self.tracks.row), -1)
        self.last_evaluated = np.zeros(len(self.tracks.row), bool)
        #: whether a series is computed from an agent's own sensor alone
        self.own = np.array([estimator in (LOCAL, RECEIVED) for _, estimator in scores.series], bool)
        self.local = np.array([estimator == LOCAL for _, estimator in scores.series], bool)
        self.column = np.array([agents.index(agent) for agent, _ in scores.series], np.int64)
        self.truth_frame = scores.frames[truth.boxes.group]
        rows = np.zeros(0, np.int64) if displaced is None else displaced.nonzero()[0]
        #: ids and frames of truth objects of which a link moved an agent's track
        self.displaced = truth.boxes.id[rows], self.truth_frame[rows]

    def labels(self) -> Labels:
        """The cause of every false track, missed object and identity switch of every estimate of the run."""
        n, names = len(self.scores.judged.frame), self.manipulations.culprits
        cause, by = np.full(n, UNKNOWN), np.zeros((n, len(names)), bool)
        false, missed = self.tracks.outcome == FALSE, self.truths.outcome == MISSED
        self.hidden = Hidden.of(self.manipulations)
        natural = self._natural_tracks(false)
        track_cause, track_by = self._attack_tracks(false, natural)
        track_cause = np.where(track_cause == UNKNOWN, natural, track_cause)
        cause[self.tracks.row], by[self.tracks.row] = track_cause, track_by
        truth_cause, truth_by = self._missed_objects(missed, track_cause, track_by)
        cause[self.truths.row], by[self.truths.row] = truth_cause, truth_by
        switch_cause, switch_by = self._switches(track_cause, track_by)
        names_by = joined_names(names, by)
        if self.withheld is not None:
            central = missed & ~self.own[self.truths.series]
            limits = self.limits.withheld_m, self.begin
            self.withheld.set_causes(self.scores, self.agents, self.truths, central, limits, cause, names_by)
        return Labels(cause, names_by, switch_cause, joined_names(names, switch_by))

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

    def _attack_tracks(self, false: Bools, natural: Ints) -> tuple[Ints, Bools]:
        """Cause and culprits of track rows that follow an object shown by an adversary.

        natural: the cause that each row would have without manipulations
        """
        tracks, manipulations = self.tracks, self.manipulations
        cause, by = np.full(len(tracks.row), UNKNOWN), np.zeros((len(tracks.row), len(manipulations.culprits)), bool)
        if not len(manipulations):
            return cause, by
        false_rows = false.nonzero()[0]
        places = tracks.places(false_rows)
        best, nearest_kind = np.full(len(false_rows), np.inf), np.full(len(false_rows), UNKNOWN)
        near: list[tuple[int, int, Floats]] = []
        seen = (self.truth.seen >= self.min_points).nonzero()[0]
        for kind in (INSERTED, MOVED):
            for culprit in range(-1, len(manipulations.culprits)):
                rows = ((manipulations.kind == kind) & (manipulations.culprit == culprit)).nonzero()[0]
                if kind == MOVED:  # what was false where it was is no more false elsewhere
                    keys = manipulations.object[rows], manipulations.frame[rows]
                    rows = rows[occurs(keys, (self.truth.boxes.id[seen], self.truth_frame[seen]))]
                if not len(rows):
                    continue
                claimed, original = claimed_positions(manipulations.select(rows), self.period_s, self.coast, self.span)
                _, distance = nearest(places, claimed, self.limits.lie_m)
                if kind == MOVED:
                    distance = self._only_as_moved(places, natural[false_rows], original, distance)
                near.append((kind, culprit, distance))
                closer = distance < best
                best[closer], nearest_kind[closer] = distance[closer], kind if culprit >= 0 else FAULT
        explained = np.isfinite(best)
        cause[false_rows[explained]] = nearest_kind[explained]
        for kind, culprit, distance in near:
            if culprit >= 0:
                same = explained & (nearest_kind == kind) & (distance <= best + self.limits.same_m)
                by[false_rows[same], culprit] = True
        local = self.local[tracks.series]
        self._extend_causes(false & local, cause, by)
        # What an agent itself reports wrongly, by no manipulation, is in the other estimates without them too.
        genuine = (false & local & (cause < 0)).nonzero()[0]
        others = (~local & (cause >= 0)).nonzero()[0]
        places = Places(tracks.frame[others], tracks.position[others])
        row, _ = nearest(places, Places(tracks.frame[genuine], tracks.position[genuine]), self.limits.lie_m)
        cause[others[row >= 0]], by[others[row >= 0]] = UNKNOWN, False
        self._extend_causes(false & ~local, cause, by)
        # A track of a real object becomes inaccurate while that object is hidden, moved or altered, if it is there.
        free = (false & (cause < 0)).nonzero()[0]
        free = free[self.last_evaluated[free]]
        self._blame_hiding(self.last_id[free], tracks.frame[free], tracks.series[free], free, cause, by)
        return cause, by

    def _extend_causes(self, false: Bools, cause: Ints, by: Bools) -> None:
        """Extend causes to rows of the track up to `coast` frames later and earlier, but not past a real object."""
        tracks, matched = self.tracks, self.tracks.outcome == MATCHED
        for later in (False, True):
            source = tracks.adjacent(cause >= 0, (cause >= 0) | matched, self.coast, later=later)
            extended = (false & (cause < 0) & (source >= 0)).nonzero()[0]
            if later:  # a cause cannot precede the manipulation
                first_shown = self.manipulations.first_shown(tracks.series[extended], by[source[extended]], self.span)
                extended = extended[tracks.frame[extended] >= first_shown]
            cause[extended], by[extended] = cause[source[extended]], by[source[extended]]

    def _only_as_moved(self, places: Places, natural: Ints, original: Places, distance: Floats) -> Floats:
        """Distances (n,) of false tracks from moved objects; inf where the track would be false without the move too.

        That is so near the original position, unless the track is beside an object that is evaluated there, and nearer
        to the claimed position.
        """
        _, unmoved = nearest(places, original, self.limits.lie_m)
        beside = np.isin(natural, (LAG, DUPLICATE)) & (distance < unmoved)
        return np.where(np.isfinite(unmoved) & ~beside, np.inf, distance)

    def _last_objects(self, rows: Ints, truths: Histories) -> tuple[Bools, Ints, Bools]:
        """The real object that each track row matched last; truths: beside the rows.

        Whether there is one within `coast` frames; its id, -1: none; whether it is evaluated in this frame: (n,) each
        """
        tracks = self.tracks
        matched = tracks.outcome == MATCHED
        last = tracks.adjacent(matched, matched, self.coast)[rows]
        id_ = np.where(last >= 0, np.append(tracks.match, -1)[last], -1)
        there = (truths.outcome != UNEVALUATED).nonzero()[0]
        keys = tracks.series[rows], id_, tracks.frame[rows]
        return last >= 0, id_, (last >= 0) & occurs(keys, (truths.series[there], truths.id[there], truths.frame[there]))

    def _blame_hiding(
        self,
        truth_id: Ints,
        frame: Ints,
        series: Ints,
        rows: Ints,
        cause: Ints,
        by: Bools,
        most: int | None = None,
        received: Bools | None = None,
    ) -> None:
        """Set cause and culprits of `rows` whose object was recently hidden; most, received: see `Hidden.recent`."""
        for code, culprit, blamed in self.hidden.recent(truth_id, frame, series, self.own, most, received):
            selected = rows[blamed]
            selected = selected[(cause[selected] < 0) | (cause[selected] == code)]
            cause[selected] = code
            if culprit >= 0:
                by[selected, culprit] = True

    def _natural_tracks(self, false: Bools) -> Ints:
        """Causes (n,) of false tracks without an adversary; UNKNOWN: not false."""
        tracks, limits = self.tracks, self.limits
        cause = np.full(len(tracks.row), UNKNOWN)
        free = false.nonzero()[0]
        if not len(free):
            return cause
        truths = Histories.of_truths_beside(self.scores, tracks.row[free], self.span)
        coasting, last_id, evaluated = self._last_objects(free, truths)
        self.last_id[free], self.last_evaluated[free] = last_id, evaluated
        places = tracks.places(free)
        all_objects = Places(self.truth_frame, self.truth.boxes.position)
        real, _ = nearest(Places(tracks.frame[free], tracks.position[free]), all_objects, limits.object_m)
        double, _ = nearest(places, truths.places(truths.outcome == MATCHED), limits.object_m)
        missed = (truths.outcome == MISSED).nonzero()[0]
        astray, _ = nearest(places, truths.places(missed), limits.astray_m)
        exists = occurs((last_id, tracks.frame[free]), (self.truth.boxes.id, self.truth_frame))
        cause[free] = np.select(
            [astray >= 0, double >= 0, real >= 0, coasting & exists & ~evaluated, coasting],
            [LAG, DUPLICATE, SIGHT, SIGHT, LAG],
            CLUTTER,
        )
        # Tracks of objects known only to disconnected agents.
        truth_id = np.where(astray >= 0, np.append(truths.id[missed], -1)[astray], last_id)
        disconnected = np.isin(cause[free], (LAG, DUPLICATE)) & ~self.own[tracks.series[free]]
        disconnected &= self.cut_off_objects.contains(truth_id, tracks.frame[free])
        cause[free[disconnected]] = FAULT
        return cause

    def _missed_objects(self, missed: Bools, track_cause: Ints, track_by: Bools) -> tuple[Ints, Bools]:
        """Causes of the missed objects."""
        tracks, truths = self.tracks, self.truths
        cause = np.full(len(truths.row), UNKNOWN)
        by = np.zeros((len(truths.row), len(self.manipulations.culprits)), bool)
        rows = missed.nonzero()[0]
        received = ~self.own[truths.series[rows]]
        if len(self.manipulations):
            received &= reporting(self.scores, self.agents, truths.id[rows], truths.frame[rows]).any(axis=1)
        self._blame_hiding(
            truths.id[rows], truths.frame[rows], truths.series[rows], rows, cause, by, self.begin, received
        )
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
        is_new = truths.frame[free] - truths.period_start()[free] < self.begin
        own = self.own[truths.series[free]]
        id_frame = truths.id[free], truths.frame[free]
        disconnected = ~own & self.cut_off_objects.contains(*id_frame, tracked=is_new)
        disturbed = ~own & tracked & occurs(id_frame, self.displaced)
        false, places = tracks.outcome == FALSE, truths.places(free)
        near_inaccurate, near_faulty = (
            nearest(places, tracks.places(false & (track_cause == code)), self.limits.astray_m)[0] >= 0
            for code in (LAG, FAULT)
        )
        cause[free] = np.select(
            [disconnected, is_new, near_faulty, near_inaccurate, ~tracked, own, disturbed],
            [FAULT, LAG, FAULT, LAG, SIGHT, TRACKING, FAULT],
            FUSION,
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
