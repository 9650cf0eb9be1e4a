"""The attribution of one run: the cause of each error of each estimate. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.assignment import Places, find, latest, nearest, occurs
from mast_zenoh.metrics.causes import (
    ALTERED,
    CLUTTER,
    DUPLICATE,
    FAULT,
    FUSION,
    INSERTED,
    LAG,
    MOVED,
    SIGHT,
    TRACKING,
    UNKNOWN,
    WITHHELD,
    CauseLabels,
    Hidden,
    Manipulations,
    claimed_positions,
    joined_names,
)
from mast_zenoh.metrics.cut_off import CutOffObjects
from mast_zenoh.metrics.estimates import LOCAL, RECEIVED
from mast_zenoh.metrics.scores import FALSE, MATCHED, MISSED, UNEVALUATED, Scores, Texts
from mast_zenoh.metrics.trust import TrustHistory, TrustUpdate, lasting


@dataclass(frozen=True, slots=True, kw_only=True)
class AttributionLimits:
    """How near and how recent the cause of an error must be.

    lie_m:     m, maximum distance from a false track to the object that an adversary inserted or moved there; the gate
               of the scorer: a track that is farther away is of something else
    same_m:    m, adversaries whose false objects are this near each other show the same object
    object_m:  m, maximum distance from a duplicate track, or the track of an unevaluated object, to the truth object,
               and from the middle of inserted or removed points to what is detected there
    astray_m:  m, maximum distance from an inaccurate track to its missed truth object, and from a false track to the
               object that it comes to follow later
    hidden_m:  m, maximum distance from where an object was removed, moved or altered to its truth object
    least_move_m: m, smaller displacements do not count, because the metrics cannot detect them
    withheld_m: m, maximum distance from a missed truth object to the object that the command centre withheld
    coast_s:   s, how long a track may coast, and an estimate may be wrong after a manipulation
    begin_s:   s, how long an object may have no track after it has come into view, was hidden or was withheld
    late_picture_s: s, how long an estimate may be wrong after a link delayed a picture
    Raises ValueError for a value below 0.
    """

    lie_m: float = 2.0
    same_m: float = 0.25
    object_m: float = 3.0
    astray_m: float = 6.0
    hidden_m: float = 4.0
    least_move_m: float = 0.5
    withheld_m: float = 2.0
    coast_s: float = 4.0
    begin_s: float = 1.0
    late_picture_s: float = 0.5

    def __post_init__(self) -> None:
        check("0 or more, finite", **asdict(self))


#: Smaller ids are used directly; an adversary may send any.
_PLAIN_IDS = 1 << 32


class Histories(NamedTuple):
    """n rows of `Scores.judged`, all tracks or all truth objects.

    Sorted by series, id and frame.

    row:      (n,) of `Scores.judged`;  series, frame, id, match, outcome: (n,), see `Judged`
    position: (n, 3) m, world frame
    group:    (n,) a number of series and frame
    """

    row: Ints
    series: Ints
    frame: Ints
    id: Ints
    match: Ints
    outcome: Ints
    position: Floats
    group: Ints

    @classmethod
    def of(cls, scores: Scores, rows: Ints, span: int) -> Histories:
        """The given rows of `scores.judged`; span: greater than any frame number."""
        judged = scores.judged
        series, frame = judged.series[rows], judged.frame[rows]
        id_, position = judged.id[rows], judged.boxes.position[rows]
        group = series * span + frame
        return cls(rows, series, frame, id_, judged.match_id[rows], judged.outcome[rows], position, group)

    @classmethod
    def of_wrong(cls, scores: Scores, outcome: int, span: int, *, tracks: bool) -> Histories:
        """All rows of the tracks or truth objects that ever have a given outcome.

        In any frame of a series.
        """
        judged = scores.judged
        ids = judged.id
        if len(ids) and not (ids.min() >= 0 and ids.max() < _PLAIN_IDS):
            ids = np.unique(ids, return_inverse=True)[1].reshape(-1)
        key = judged.series * (int(ids.max(initial=0)) + 1) + ids
        rows = np.flatnonzero(judged.is_track == tracks)
        row_keys = key[rows]
        rows = rows[np.isin(row_keys, row_keys[judged.outcome[rows] == outcome])]
        return cls.of(scores, rows[np.lexsort((judged.frame[rows], key[rows]))], span)

    @classmethod
    def of_truths_beside(cls, scores: Scores, rows: Ints, span: int) -> Histories:
        """The truth objects in the series and frames of these rows of `scores.judged`."""
        judged = scores.judged
        group = judged.boxes.group
        involved = np.zeros(int(group.max(initial=0)) + 1, bool)
        involved[group[rows]] = True
        return cls.of(scores, np.flatnonzero(~judged.is_track & involved[group]), span)

    def places(self, rows: Bools | Ints) -> Places:
        """The positions of some rows; rows of different series or frames are never paired."""
        return Places(self.group[rows], self.position[rows])

    def adjacent(self, valid: Bools, stops: Bools, max_frames: int, *, later: bool = False) -> Ints:
        """The last row (n,) with `stops` up to each row, in its series and id.

        later: the first one at or after each row instead

        -1 if there is none, if it is not `valid`, or if it is more than `max_frames` frames away.
        """
        direction = slice(None, None, -1) if later else slice(None)
        n = len(self.row)
        stop_row = np.maximum.accumulate(np.where(stops[direction], np.arange(n), -1)) if n else np.zeros(0, np.int64)
        last = stop_row[direction]
        known = last >= 0
        last = np.where(known & later, n - 1 - last, last)
        same = known & (self.series[last] == self.series) & (self.id[last] == self.id) & valid[last]
        same &= np.abs(self.frame[last] - self.frame) <= max_frames
        return np.where(same, last, -1)

    def period_start(self, holds: Bools) -> Ints:
        """First frame (n,) of the period of each row in which something (n,) holds, or in which it does not."""
        first = np.ones(len(self.row), bool)
        first[1:] = (np.diff(self.series) != 0) | (np.diff(self.id) != 0) | (np.diff(self.frame) != 1)
        first[1:] |= holds[1:] != holds[:-1]
        start = np.maximum.accumulate(np.where(first, np.arange(len(first)), 0)) if len(first) else first.astype(int)
        return np.asarray(self.frame[start])


@dataclass(frozen=True, slots=True, eq=False)
class Withheld:
    """The objects that were kept out of the picture, and the agents whose tracks were.

    places:    the objects that the centre tracked and withheld; group = frame
    suspended: (span, a) whether agent a is suspended, by frame number
    """

    places: Places
    suspended: Bools

    @classmethod
    def of(cls, updates: Sequence[TrustUpdate], agents: Sequence[str], frames: Ints, state: int) -> Withheld | None:
        """What messages about trust tell; None without any.

        frames: (f,) ascending; state: index of the state of suspended agents
        """
        if not updates or not len(frames):
            return None
        rows = [np.flatnonzero(update.columns["withheld"]) for update in updates]
        frame = np.repeat(np.array([update.frame for update in updates], np.int64), [len(row) for row in rows])
        parts = [update.columns["position"][row] for update, row in zip(updates, rows, strict=True)]
        suspended = np.zeros((int(frames[-1]) + 1, len(agents)), bool)
        suspended[frames] = TrustHistory.of(updates, agents, frames).state == state
        return cls(Places(frame, np.concatenate(parts)), suspended)

    def set_causes(
        self,
        scores: Scores,
        truths: Histories,
        missed: Bools,
        limits: tuple[float, int],
        cause: Ints,
        by: Texts,
    ) -> None:
        """Set the cause of missed objects that were withheld, and the agents that reported them.

        That comes before all other causes: the centre had the object.
        missed: (n,) rows of `truths` that the command centre's estimates lack;  cause, by: of `scores.judged`
        limits: m, distance from a withheld object, and number of frames for which a suspension counts after its end
        """
        rows, (radius, lasts) = missed.nonzero()[0], limits
        frame = truths.frame[rows]
        tracked = nearest(Places(frame, truths.position[rows]), self.places, radius)[0] >= 0
        by_agent = reporting(scores, truths.id[rows], frame)
        suspended = lasting(self.suspended, lasts)[frame]
        chosen = tracked | (by_agent.any(axis=1) & ~(by_agent & ~suspended).any(axis=1))
        cause[truths.row[rows[chosen]]] = WITHHELD
        by[truths.row[rows[chosen]]] = joined_names(scores.agents, by_agent[chosen])


def reporting(scores: Scores, truth_id: Ints, frame: Ints) -> Bools:
    """Whether the broker received a good track of each of n objects in frames from each agent: (n, a)."""
    judged, series = scores.judged, scores.every_series
    result = np.zeros((len(truth_id), len(scores.agents)), bool)
    matched = np.flatnonzero(~judged.is_track & (judged.outcome == MATCHED))
    for column, agent in enumerate(scores.agents):
        received = series.get((agent, RECEIVED), series.get((agent, LOCAL), -1))
        own = matched[judged.series[matched] == received]
        result[:, column] = occurs((truth_id, frame), (judged.id[own], judged.frame[own]))
    return result


class Attributor:
    """The attribution of one run.

    manipulations: those of all interposers; their series are those of `scores`
    period_s: s, frame period
    cut_off_objects:  objects known only to disconnected agents; None: no agent was disconnected
    min_points: lidar points from which an agent sees an object
    withheld: by the command centre, or by a peer; None: it has no integrity stage
    displaced: (n,) rows of the truth of which a link moved a track; None: none
    judged: agents from whose pictures it withheld objects; None: all
    cut_off_peers: by agent, objects known only to agents that are disconnected from its peer
    """

    def __init__(
        self,
        limits: AttributionLimits,
        scores: Scores,
        manipulations: Manipulations,
        period_s: float,
        cut_off_objects: CutOffObjects | None = None,
        min_points: int = 5,
        withheld: Withheld | None = None,
        displaced: Bools | None = None,
        judged: Collection[str] | None = None,
        cut_off_peers: Mapping[str, CutOffObjects] = MappingProxyType({}),
    ) -> None:
        self.cut_off_peers = cut_off_peers
        self.min_points, self.withheld = min_points, withheld
        self.limits, self.scores, self.manipulations, self.truth = limits, scores, manipulations, scores.truth
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
        self.judged = np.array([judged is None or agent in judged for agent, _ in scores.series], bool)
        self.column = np.array([scores.agents.index(agent) for agent, _ in scores.series], np.int64)
        self.truth_frame = scores.truth_frame
        rows = np.zeros(0, np.int64) if displaced is None else displaced.nonzero()[0]
        #: ids and frames of truth objects of which a link moved an agent's track
        self.displaced = self.truth.boxes.id[rows], self.truth_frame[rows]

    def labels(self) -> CauseLabels:
        """The cause of every false track, missed object and identity switch of every estimate of the run."""
        n, names = len(self.scores.judged.frame), self.manipulations.culprits
        cause, by = np.full(n, UNKNOWN), np.zeros((n, len(names)), bool)
        false, missed = self.tracks.outcome == FALSE, self.truths.outcome == MISSED
        self.hidden = Hidden.of(self.manipulations, found=True)
        natural = self._natural_tracks(false)
        track_cause, track_by = self._attack_tracks(false, natural)
        track_cause = np.where(track_cause == UNKNOWN, natural, track_cause)
        cause[self.tracks.row], by[self.tracks.row] = track_cause, track_by
        truth_cause, truth_by = self._missed_objects(missed, track_cause, track_by)
        cause[self.truths.row], by[self.truths.row] = truth_cause, truth_by
        switch_cause, switch_by = self._switches(track_cause, track_by)
        names_by = joined_names(names, by)
        if self.withheld is not None:
            central = missed & (self.judged & ~self.own)[self.truths.series]
            limits = self.limits.withheld_m, self.begin
            self.withheld.set_causes(self.scores, self.truths, central, limits, cause, names_by)
        return CauseLabels(cause, names_by, switch_cause, joined_names(names, switch_by))

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
        about = np.zeros(len(tracks.row), bool)  # rows with something shown so near that they may come to follow it
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
                _, distance = nearest(places, claimed, self.limits.astray_m)
                about[false_rows] |= np.isfinite(distance)
                distance = np.where(distance <= self.limits.lie_m, distance, np.inf)
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
        # What was false before the lie can have reached the estimate is not the lie's, as long as such errors last.
        blamed = false_rows[explained]
        first_shown = manipulations.first_shown(tracks.series[blamed], by[blamed], self.span)
        before = tracks.period_start(false)[blamed] < first_shown
        before &= tracks.frame[blamed] < first_shown + self.begin
        cause[blamed[before]], by[blamed[before]] = UNKNOWN, False
        extended = false.copy()
        extended[blamed[before]] = False
        local = self.local[tracks.series]
        self._extend_causes(extended & local, about, cause, by)
        # What an agent itself reports wrongly, by no manipulation, is in the other estimates without them too.
        others = (~local & (cause >= 0)).nonzero()[0]
        others = others[self._near(others, false & local & (cause < 0))]
        cause[others], by[others] = UNKNOWN, False
        self._extend_causes(extended & ~local, about, cause, by)
        # A track of a real object becomes inaccurate while that object is hidden, moved or altered, if it is there.
        free = (false & (cause < 0) & self.last_evaluated).nonzero()[0]
        at = find((self.last_id[free], tracks.frame[free]), (self.truth.boxes.id, self.truth_frame))
        astray_m = np.linalg.norm(self.truth.boxes.position[at] - tracks.position[free], axis=1)
        since = tracks.period_start(false)

        def blame(rows: Ints) -> None:
            ids, frame, series = self.last_id[rows], tracks.frame[rows], tracks.series[rows]
            self._blame_hiding(ids, frame, series, rows, cause, by, since=since[rows])

        blame(free[local[free] & (astray_m <= self.limits.astray_m)])
        others = free[~local[free]]
        blame(others[~self._near(others, false & local & (cause < 0))])
        return cause, by

    def _near(self, rows: Ints, among: Bools) -> Bools:
        """Whether track rows are where some others are in the same frame, of any series."""
        tracks = self.tracks
        places, others = (Places(tracks.frame[each], tracks.position[each]) for each in (rows, among))
        return np.asarray(nearest(places, others, self.limits.lie_m)[0] >= 0)

    def _extend_causes(self, false: Bools, about: Bools, cause: Ints, by: Bools) -> None:
        """Extend causes to rows of the track up to `coast` frames later and earlier, but not past a real object.

        about: rows beside something that is shown: what is far from it does not follow it yet
        """
        tracks, matched = self.tracks, self.tracks.outcome == MATCHED
        for later in (False, True):
            source = tracks.adjacent(cause >= 0, (cause >= 0) | matched, self.coast, later=later)
            extended = (false & (cause < 0) & (source >= 0)).nonzero()[0]
            if later:  # a cause cannot precede the manipulation
                first_shown = self.manipulations.first_shown(tracks.series[extended], by[source[extended]], self.span)
                extended = extended[(tracks.frame[extended] >= first_shown) & about[extended]]
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
        since: Ints | None = None,
    ) -> None:
        """Set cause and culprits of `rows` whose object was recently hidden; the last three: see `Hidden.recent`."""
        recent = self.hidden.recent(truth_id, frame, series, self.own, most, received, since, self.begin)
        for code, culprit, blamed in recent:
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
        disconnected &= self._cut_off(tracks.series[free], truth_id, tracks.frame[free])
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
            received &= reporting(self.scores, truths.id[rows], truths.frame[rows]).any(axis=1)
        self._blame_hiding(
            truths.id[rows],
            truths.frame[rows],
            truths.series[rows],
            rows,
            cause,
            by,
            self.begin,
            received,
            truths.period_start(missed)[rows],
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
        is_new = truths.frame[free] - truths.period_start(truths.outcome != UNEVALUATED)[free] < self.begin
        own = self.own[truths.series[free]]
        id_frame = truths.id[free], truths.frame[free]
        disconnected = ~own & self._cut_off(truths.series[free], *id_frame, tracked=is_new)
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

    def _cut_off(self, series: Ints, truth_id: Ints, frame: Ints, tracked: Bools | None = None) -> Bools:
        """Whether objects (m,) in estimates of m series are known only to agents that are disconnected from them."""
        result = self.cut_off_objects.contains(truth_id, frame, tracked)
        for agent, cut_off in self.cut_off_peers.items():
            own = self.column[series] == self.scores.agents.index(agent)
            result |= own & cut_off.contains(truth_id, frame, tracked)
        return result

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
