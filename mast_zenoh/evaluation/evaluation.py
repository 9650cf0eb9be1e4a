"""The settings of an evaluation, and the evaluation of some frames of a run. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.driving import CarLimits
from mast_zenoh.driving.motion import HOLD_S, TAKE_OVER_S
from mast_zenoh.evaluation import trust
from mast_zenoh.evaluation.effects import EFFECTS, Effects, effects_of, reports
from mast_zenoh.evaluation.effects.reports import Agreement
from mast_zenoh.evaluation.from_effects import (
    add_pose_manipulations,
    displaced_by_links,
    effects_of_absence,
    manipulations,
    stopped_by_links,
    without_undetected,
    without_unseen,
)
from mast_zenoh.evaluation.run_data import RunData, ego_of
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.metrics import (
    AttributionLimits,
    Attributor,
    Consistency,
    CutOff,
    CutOffObjects,
    Driving,
    Manipulations,
    Metric,
    Scorer,
    Scores,
    Table,
    cause_names,
)
from mast_zenoh.metrics.attributor import Withheld
from mast_zenoh.metrics.causes import ATTACK_CAUSES, INSERTED, CauseLabels
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.measures import check, per_frame
from mast_zenoh.metrics.scores import LastMatches
from mast_zenoh.metrics.trust import Fault

#: Columns of attacks.parquet that say where an effect was measured.
_OF_PASSAGE = ("interposer", "role", "wire", "message", "before_subscriber")


def attacks(effects: Effects, agreement: Agreement, roles: Mapping[str, str], period_s: float, counted: Bools) -> Table:
    """The effects (n,) that are counted (n,), as columns of attacks.parquet.

    Sorted by interposer, wire, frame and sequence number.
    Objects of a message that was withheld, forged or reframed as a whole have no separate rows.

    Columns:
    interposer, role: the node, and its role
    wire, message: key of the wire, and its message type
    before_subscriber: the only subscriber that the interposer serves; empty: all
    frame, seq: of the message; -1 if they cannot be read
    effect: what was done, see docs/explanation-metrics-and-causes.md
    id: of the object in its message; -1: none
    before_x, before_y, before_z, after_x, after_y, after_z: m, places in the world; missing if there is no such place
    vx, vy, vz: m/s, velocity in the world
    columns: the columns that differ, separated by spaces
    points: of a lidar that were inserted or removed and make up the object; 0: not an effect on points
    delay_s: by which the message is later; missing: none
    reported: whether the interposer reported this effect
    label: number that the report gave to the target, or row of the link's rule; -1: none
    """
    rows = np.flatnonzero(~effects.whole & counted)
    of_passages = [
        (each.node, roles.get(each.node, ""), each.wire, each.message, each.before) for each in effects.passages
    ]
    of_rows = np.array([*of_passages, ("",) * len(_OF_PASSAGE)], object)[effects.passage[rows]]
    delay_ns = effects.frames_late[rows] * period_s * 1e9 + effects.time_ns[rows]
    return {
        **dict(zip(_OF_PASSAGE, of_rows.T, strict=True)),
        "frame": effects.frame[rows],
        "seq": effects.seq[rows],
        "effect": np.array(EFFECTS, object)[effects.code[rows]],
        "id": effects.id[rows],
        **{f"before_{axis}": effects.before[rows, i] for i, axis in enumerate("xyz")},
        **{f"after_{axis}": effects.after[rows, i] for i, axis in enumerate("xyz")},
        **{f"v{axis}": effects.velocity[rows, i] for i, axis in enumerate("xyz")},
        "columns": effects.columns[rows],
        "points": effects.points[rows],
        "delay_s": np.where(delay_ns != 0, delay_ns * 1e-9, np.nan),
        "reported": agreement.reported[rows],
        "label": agreement.label[rows],
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The settings of an evaluation.

    scorer:  compares estimates with the truth
    metrics: user-defined metrics
    driving: settings for the driving consequences of an estimate
    skip_first, skip_last: frames left out of the summary at the beginning and at the end, because tracks need some
             frames to begin with; kept when they would be more than half of the run
    picture_age_s: s, for how long an agent uses a picture when no newer one arrives
    picture_ages_s: s, the same by agent
    estimate_ages_s: s, by agent whose car is driven, the greatest age of an estimate that its driver uses
    take_over_s, hold_s: s, of the world of driven cars: from when on, and for how long, they obey commands
    car_limits: what driven cars can do
    attribution, cut_off: settings for the causes of errors
    consistency: settings for the comparison of errors with covariances
    faults:  of the timeline by agent, for runs with trust
    Raises ValueError for invalid values.
    """

    scorer: Scorer
    metrics: tuple[Metric, ...] = ()
    driving: Driving = field(default_factory=Driving)
    skip_first: int
    skip_last: int
    picture_age_s: float
    picture_ages_s: Mapping[str, float] = field(default_factory=dict)
    estimate_ages_s: Mapping[str, float] = field(default_factory=dict)
    take_over_s: float = TAKE_OVER_S
    hold_s: float = HOLD_S
    car_limits: CarLimits = field(default_factory=CarLimits)
    attribution: AttributionLimits = field(default_factory=AttributionLimits)
    cut_off: CutOff = field(default_factory=CutOff)
    consistency: Consistency = field(default_factory=Consistency)
    faults: Mapping[str, Sequence[Fault]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.skip_first < 0 or self.skip_last < 0:
            raise ValueError(f"skip_first, skip_last: found {self.skip_first}, {self.skip_last}, expected 0 or more")
        for age_s in (self.picture_age_s, *self.picture_ages_s.values()):
            if not 0.0 <= age_s < np.inf:
                raise ValueError(f"picture_age_s: found {age_s}, expected 0 or more")
        check(self.metrics)

    def assessed(self, data: RunData, frames: Ints, earlier: Earlier, until: float = np.inf) -> ScoredFrames:
        """Score frames (f,), and attribute their errors.

        until: effects on messages that interposers received from this frame of the run on do not count
        """
        record = data.record
        ages_s = {agent: self.picture_ages_s.get(agent, self.picture_age_s) for agent in record.agents}
        record.hold_pictures({agent: round(age_s * 1e9) for agent, age_s in ages_s.items()}, data.times_ns)
        scores = self.scorer.score(record, frames, earlier.matches)
        truth, agents, min_points = scores.truth, scores.agents, self.scorer.min_points
        effects = effects_of(data.meter.meters, data.poses).until(until)
        from_absence = effects_of_absence(effects, data.presence.absences(scores.frames), scores.frames)
        interposed = manipulations(
            effects,
            data.roles,
            scores.series,
            truth.boxes.in_group(scores.truth_frame),
            data.period_s,
            from_absence,
            self.attribution,
            data.influences,
        )
        interposed = earlier.episodes.numbered(interposed)
        interposed = without_undetected(interposed, effects, data.detected, data.poses, self.attribution.object_m)
        spoofs = [meter.effects.spoofs for meter in data.meter.meters]
        duration = round(self.attribution.coast_s / data.period_s)
        interposed = add_pose_manipulations(interposed, effects, spoofs, scores, min_points, duration)
        updates = [data.trust[int(frame)] for frame in frames if int(frame) in data.trust]
        displaced = displaced_by_links(interposed, effects, scores, data.influences)
        begin = round(self.attribution.begin_s / data.period_s)

        def cut_off(listener: str = "") -> CutOffObjects:
            """Objects known only to agents whose tracks links did not deliver to a listener, or displaced."""
            stopped = stopped_by_links(effects, data.roles, agents, scores.frames, data.influences, listener)
            silent = data.presence.absent(agents, scores.frames) | stopped
            moved = displaced & (np.array(agents) != listener)
            undelivered = ~self._in_time(data, agents, scores.frames)
            return self.cut_off.objects(scores, data.period_s, silent, undelivered, min_points, moved)

        attributor = Attributor(
            self.attribution,
            scores,
            without_unseen(interposed, effects, scores, min_points, begin),
            data.period_s,
            cut_off(),
            min_points,
            Withheld.of(updates, agents, scores.frames, SUSPENDED),
            np.asarray(displaced.any(axis=1)),
            [ego_of(agents)] if own_pictures(data) else None,  # the trust of the ego's peer is evaluated
            {agent: cut_off(agent) for agent in own_pictures(data)},
        )
        return ScoredFrames(data, scores, effects, from_absence, interposed, attributor.labels())

    def _in_time(self, data: RunData, agents: Sequence[str], frames: Ints) -> Bools:
        """(f, a) whether the tracks of an agent were sent while they were of use."""
        within = self.cut_off.useful_age_s / data.period_s + 1e-6
        sent = [[data.tracks_sent.get((name, frame), np.inf) - frame for name in agents] for frame in frames.tolist()]
        return np.asarray(np.reshape(sent, (len(frames), len(agents))) <= within)

    def frame_tables(self, data: RunData) -> dict[str, Any]:
        """Evaluate frames without summarising them, for a view of a running run.

        Returns {"same_as": as in metrics.json, and columns by name: "metrics", "objects", "attacks"; "trust" and
        "trust_objects" with a command centre that judges agents}.
        """
        frames = data.record.frames()
        data.meter.close(int(frames.max(initial=-1)))
        assessment = self.assessed(data, frames, Earlier())
        return {
            "same_as": by_agent(assessment.scores.same_as),
            "metrics": per_frame(assessment.scores),
            **assessment.tables(-np.inf, np.inf, assessment.agreement(-np.inf, np.inf)),
        }

    def take_over_frame(self, period_s: float) -> int:
        """The frame from which on cars obey commands. period_s: s, of a frame"""
        return round(self.take_over_s / period_s)

    def scored(self, frames: int) -> slice:
        """The scored ones among `frames` frames."""
        first, last = (self.skip_first, self.skip_last) if self.settled(frames) else (0, 0)
        return slice(first, frames - last)

    def settled(self, frames: int) -> bool:
        """Whether a run is long enough to leave frames out of the summary."""
        return self.skip_first + self.skip_last <= frames // 2


class Episodes:
    """Numbers of inserted objects, the same over the whole run, though some frames of it are evaluated at a time.

    Frames that are evaluated twice tell which objects are the same.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[float, ...], int] = {}
        self._count = 0

    def numbered(self, manipulations: Manipulations) -> Manipulations:
        """The manipulations, with the numbers of the inserted objects over the run."""
        rows = np.flatnonzero(manipulations.kind == INSERTED)
        keys = np.column_stack([manipulations.passage[rows], manipulations.frame[rows], manipulations.position[rows]])
        places, episodes = [tuple(key) for key in keys.tolist()], manipulations.object[rows].tolist()
        number = {
            episode: self._known[place] for place, episode in zip(places, episodes, strict=True) if place in self._known
        }
        for episode in dict.fromkeys(episodes):
            number.setdefault(episode, self._count + episode)
        objects = manipulations.object.copy()
        objects[rows] = [number[episode] for episode in episodes]
        self._known = dict(zip(places, objects[rows].tolist(), strict=True))
        self._count = max(self._count, int(objects[rows].max(initial=-1)) + 1)
        return replace(manipulations, object=objects)


@dataclass
class Earlier:
    """What the evaluation of some frames needs to know of earlier ones.

    matches:  which tracks last matched which objects before the frames
    episodes: of inserted objects
    """

    matches: LastMatches = field(default_factory=dict)
    episodes: Episodes = field(default_factory=Episodes)


def own_pictures(data: RunData) -> list[str]:
    """The agents that have a picture of their own, without a centre."""
    return [agent for agent, estimator in data.record.series() if agent and estimator == PICTURE]


def by_agent(same_as: Mapping[tuple[str, str], tuple[str, str]]) -> dict[str, dict[str, str]]:
    """By agent and estimator, the estimator with the same messages; same_as: see `FrameScores`"""
    result: dict[str, dict[str, str]] = {}
    for (agent, estimator), (_, twin) in same_as.items():
        result.setdefault(agent, {})[estimator] = twin
    return result


@dataclass(frozen=True, slots=True)
class ScoredFrames:
    """The scores of some frames, and the causes of their errors.

    from_absence: (n,) effects that are due to the absence of an interposer
    """

    data: RunData
    scores: Scores
    effects: Effects
    from_absence: Bools
    manipulations: Manipulations
    labels: CauseLabels

    @property
    def blamed(self) -> Bools:
        """(n,) rows of `Scores.judged` that are wrong because of an adversary."""
        return np.asarray((self.labels.cause >= 0) & (self.labels.cause < len(ATTACK_CAUSES)))

    def counted_effects(self, first: float, end: float) -> Bools:
        """(n,) the effects on messages that interposers received from frame `first` of the run on, before `end`."""
        return np.asarray((self.effects.step >= first) & (self.effects.step < end))

    def agreement(self, first: float, end: float) -> Agreement:
        """How reports from frame `first` on, before `end`, agree with the effects."""
        data = self.data
        return reports.compare(self.effects, data.attack_reports, data.link_reports, (first, end))

    def tables(self, first: float, end: float, agreement: Agreement, *, every_series: bool = False) -> dict[str, Table]:
        """The rows of frames from `first` on, before `end`: "objects" and "attacks", with trust those about it.

        every_series: series with the same messages as others have rows of their own

        Columns:
        cause: of an error, see docs/explanation-metrics-and-causes.md; empty: none
        by: the adversary that caused it; several are joined by `+`
        """
        data, effects = self.data, self.effects
        counted = self.counted_effects(first, end)
        updates = [data.trust[frame] for frame in sorted(data.trust) if first <= frame < end]
        return {
            "objects": self._objects(first, end, every_series),
            "attacks": attacks(effects, agreement, data.roles, data.period_s, counted & ~self.from_absence),
            **(trust.tables(updates, data.times_ns) if data.trust else {}),
        }

    def _objects(self, first: float, end: float, every_series: bool) -> Table:
        scores, judged = self.scores, self.scores.judged
        table = {**scores.objects(), "cause": cause_names(self.labels.cause), "by": self.labels.by}
        rows = np.flatnonzero((judged.frame >= first) & (judged.frame < end))
        if not every_series:
            return {name: column[rows] for name, column in table.items()}
        names = scores.every_series
        of_series = [rows[judged.series[rows] == row] for row in names.values()]
        estimators = np.array([estimator for _, estimator in names], object)
        rows = np.concatenate(of_series)
        repeated = np.repeat(estimators, [len(each) for each in of_series])
        return {name: column[rows] for name, column in table.items()} | {"estimator": repeated}
