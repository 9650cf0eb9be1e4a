"""Computes the metrics and tables of a run from its messages. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools
from mast_zenoh.driving import CarLimits
from mast_zenoh.driving.actuation import HOLD_S, TAKE_OVER_S
from mast_zenoh.effects import EFFECTS, Effects, Meter, Pose, effects_of, reports
from mast_zenoh.effects.reports import Agreement
from mast_zenoh.evaluation import trust
from mast_zenoh.evaluation.driven import DrivenCars, Heard
from mast_zenoh.evaluation.from_effects import (
    add_pose_manipulations,
    displaced_by_links,
    effects_of_absence,
    first_change,
    manipulations,
    stopped_by_links,
    without_unseen,
)
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.links import WIRES
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics import (
    AttributionLimits,
    Attributor,
    Consistency,
    CutOff,
    CutOffObjects,
    Driving,
    Manipulations,
    Metric,
    Presence,
    Record,
    Scorer,
    Scores,
    Table,
    achievement,
    cause_names,
    causes_of,
    driving,
)
from mast_zenoh.metrics.attributor import Withheld
from mast_zenoh.metrics.causes import ATTACK_CAUSES
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.measures import MEASURES, ScoredRun, check, estimates_of, frame_keys, measured, per_frame
from mast_zenoh.metrics.pictures import consistency_of_pictures, deceived_agents, of_pictures
from mast_zenoh.metrics.scores import mean_and_std
from mast_zenoh.metrics.trust import Fault, TrustUpdate
from mast_zenoh.wiring.model import agent_of

_PERIOD_S = 0.1  #: assumed frame period of a run with a single frame


@dataclass
class RunData:
    """Data collected from the messages of a run.

    record:   the truth and all estimates;  meter: effects of the interposers
    roles:    of the nodes;  presence: joining and leaving of nodes
    times_ns: by frame, its clock time
    poses:    by (agent, frame)
    picture_sent: by frame, the frame in which its picture was sent
    tracks_sent: by (agent, frame), the frame in which the agent's tracks were sent
    attack_reports, link_reports: (interposer, frame, sequence number, columns)
    trust:    by frame, the first message about it
    receptions: by (agent, frame), busy ratio of the channel, ns and number of its own messages, and number of
        those that it lost, all of the frame before
    relays:   whether peers relay their pictures
    heard:    what drivers received, by the agent whose car they drive
    """

    record: Record
    meter: Meter = field(default_factory=Meter)
    roles: dict[str, str] = field(default_factory=dict)
    presence: Presence = field(default_factory=Presence)
    times_ns: dict[int, int] = field(default_factory=dict)
    poses: dict[tuple[str, int], Pose] = field(default_factory=dict)
    picture_sent: dict[int, int] = field(default_factory=dict)
    tracks_sent: dict[tuple[str, int], int] = field(default_factory=dict)
    attack_reports: list[tuple[str, int, int, Body]] = field(default_factory=list)
    link_reports: list[tuple[str, int, int, Body]] = field(default_factory=list)
    trust: dict[int, TrustUpdate] = field(default_factory=dict)
    receptions: dict[tuple[str, int], tuple[float, int, int, int]] = field(default_factory=dict)
    relays: bool = False
    heard: dict[str, Heard] = field(default_factory=dict)

    @property
    def period_s(self) -> float:
        """Frame period, s."""
        first, second = self.times_ns.get(0), self.times_ns.get(1)
        return _PERIOD_S if first is None or second is None else (second - first) * 1e-9

    @property
    def ego(self) -> str:
        """The main agent of the evaluation."""
        return ego_of(self.record.agents)

    def picture_age_s(self, frames: Sequence[int]) -> dict[str, dict[str, float | int | None]]:
        """By agent: mean and maximum age in s of the picture in its mission estimates, and the `frames` without any.

        Known after `record.hold_pictures`; None without pictures.
        """
        summary: dict[str, dict[str, float | int | None]] = {}
        for agent, ages_ns in self.record.picture_ages_ns.items():
            ages_s = [ages_ns[frame] * 1e-9 for frame in frames if frame in ages_ns]
            mean, most = (sum(ages_s) / len(ages_s), max(ages_s)) if ages_s else (None, None)
            summary[agent] = {"mean": mean, "max": most, "frames_without": len(frames) - len(ages_s)}
        return summary

    def latencies_ns(self) -> list[int]:
        """ns of scene time between each frame and the one in which its picture was sent."""
        times = self.times_ns
        return [
            times[sent] - times[frame]
            for frame, sent in sorted(self.picture_sent.items())
            if {frame, sent} <= times.keys()
        ]

    def latency_percentiles_ms(self) -> dict[str, float | None]:
        """p50, p95 and p99 in ms of `latencies_ns`; None without latencies."""
        latencies = self.latencies_ns()
        names = (50, 95, 99)
        if not latencies:
            return {f"p{p}": None for p in names}
        return {f"p{p}": float(np.percentile(np.array(latencies) * 1e-6, p)) for p in names}


def ego_of(agents: Sequence[str]) -> str:
    """The main agent of an evaluation: "ego" if there is one, else the first."""
    return "ego" if "ego" in agents else next(iter(agents), "")


def attacks(effects: Effects, agreement: Agreement, roles: Mapping[str, str], period_s: float) -> Table:
    """The effects as columns of attacks.parquet.

    Sorted by interposer, wire, frame and sequence number.
    Objects of a message that was withheld, forged or reframed as a whole have no separate rows.
    """
    rows = np.flatnonzero(~effects.whole)
    passages = effects.passages
    passage_row = effects.passage[rows]

    def of_passage(values: Sequence[str]) -> np.ndarray:
        return np.array([*values, ""], object)[passage_row] if len(rows) else np.zeros(0, object)

    delay_ns = effects.frames_late[rows] * period_s * 1e9 + effects.time_ns[rows]
    return {
        "interposer": of_passage([passage.node for passage in passages]),
        "role": of_passage([roles.get(passage.node, "") for passage in passages]),
        "wire": of_passage([passage.wire for passage in passages]),
        "message": of_passage([passage.message for passage in passages]),
        "before_subscriber": of_passage([passage.before for passage in passages]),
        "frame": effects.frame[rows],
        "seq": effects.seq[rows],
        "effect": np.array(EFFECTS, object)[effects.code[rows]],
        "id": effects.id[rows],
        **{f"before_{axis}": effects.before[rows, i] for i, axis in enumerate("xyz")},
        **{f"after_{axis}": effects.after[rows, i] for i, axis in enumerate("xyz")},
        **{f"v{axis}": effects.velocity[rows, i] for i, axis in enumerate("xyz")},
        "columns": effects.columns[rows],
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
    picture_age_s: s, for how long an agent uses a picture when no newer one arrives; picture_ages_s: by agent
    estimate_ages_s: s, by agent whose car is driven, the greatest age of an estimate that its driver uses
    take_over_s, hold_s: s, of the world of driven cars: from when on, and for how long, they obey commands
    car_limits: what they can do
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

    def of(self, data: RunData) -> dict[str, Any]:
        """Evaluate a run.

        Returns {"metrics": contents of metrics.json, "tables": columns of the tables by name, "failed_metrics": errors
        of failed user-defined metrics by name}.
        """
        return self._assessed(data).results()

    def frame_tables(self, data: RunData) -> dict[str, Any]:
        """Evaluate frames without summarising them, for a view of a running run.

        Returns {"same_as": as in metrics.json, and columns by name: "metrics", "objects", "attacks"; "trust" and
        "trust_objects" with a command centre that judges agents}.
        """
        return self._assessed(data).frame_tables()

    def _assessed(self, data: RunData) -> _Results:
        ages_s = {agent: self.picture_ages_s.get(agent, self.picture_age_s) for agent in data.record.agents}
        data.record.hold_pictures({agent: round(age_s * 1e9) for agent, age_s in ages_s.items()}, data.times_ns)
        scores = self.scorer.score(data.record)
        truth, agents, min_points = scores.truth, scores.agents, self.scorer.min_points
        effects = _measured(data, scores)
        from_absence = effects_of_absence(effects, data.presence.absences(scores.frames), scores.frames)
        interposed = manipulations(
            effects,
            data.roles,
            scores.series,
            truth.boxes.in_group(scores.truth_frame),
            data.period_s,
            from_absence,
            self.attribution,
            data.relays,
            _own_pictures(data),
        )
        spoofs = [meter.effects.spoofs for meter in data.meter.meters]
        duration = round(self.attribution.coast_s / data.period_s)
        interposed = add_pose_manipulations(interposed, effects, spoofs, scores, min_points, duration)
        updates = [data.trust[frame] for frame in sorted(data.trust)]
        displaced = displaced_by_links(interposed, effects, scores)
        begin = round(self.attribution.begin_s / data.period_s)
        attributor = Attributor(
            self.attribution,
            scores,
            without_unseen(interposed, effects, scores, min_points, begin),
            data.period_s,
            cut_off_objects(self.cut_off, data, scores, effects, displaced, min_points),
            min_points,
            Withheld.of(updates, agents, scores.frames, SUSPENDED),
            np.asarray(displaced.any(axis=1)),
            [ego_of(agents)] if _own_pictures(data) else None,  # the trust of the ego's peer is evaluated
            {
                agent: cut_off_objects(self.cut_off, data, scores, effects, displaced, min_points, agent)
                for agent in _own_pictures(data)
            },
        )
        return _Results(self, data, scores, effects, from_absence, interposed, attributor.labels())

    def scored(self, frames: int) -> slice:
        """The scored ones among `frames` frames."""
        first, last = (self.skip_first, self.skip_last) if self.settled(frames) else (0, 0)
        return slice(first, frames - last)

    def settled(self, frames: int) -> bool:
        """Whether a run is long enough to leave frames out of the summary."""
        return self.skip_first + self.skip_last <= frames // 2


def _own_pictures(data: RunData) -> list[str]:
    """The agents that have a picture of their own, without a centre."""
    return [agent for agent, estimator in data.record.series() if agent and estimator == PICTURE]


def cut_off_objects(
    cut_off: CutOff,
    data: RunData,
    scores: Scores,
    effects: Effects,
    displaced: Bools,
    min_points: int,
    listener: str = "",
) -> CutOffObjects:
    """Objects known only to agents whose tracks links did not deliver, or displaced (n, a).

    listener: the agent to whose peer they did not deliver them; empty: a centre
    """
    agents, frames = scores.agents, scores.frames
    silent = data.presence.absent(agents, frames) | stopped_by_links(effects, data.roles, agents, frames, listener)
    if listener:
        displaced = displaced & (np.array(agents) != listener)
    within = cut_off.useful_age_s / data.period_s + 1e-6
    sent = [
        [data.tracks_sent.get((agent, frame), np.inf) - frame <= within for agent in agents]
        for frame in frames.tolist()
    ]
    undelivered = ~np.array(sent, bool).reshape(len(frames), len(agents))
    return cut_off.objects(scores, data.period_s, silent, undelivered, min_points, displaced)


def _measured(data: RunData, scores: Scores) -> Effects:
    """The effects of interposers, after the end of the run."""
    data.meter.close(int(scores.frames.max(initial=-1)))
    return effects_of(data.meter.meters, data.poses)


@dataclass(frozen=True, slots=True)
class _Results:
    """The intermediate results of an evaluation, converted to its output."""

    settings: Evaluation
    data: RunData
    scores: Scores
    effects: Effects
    from_absence: Bools
    manipulations: Manipulations
    labels: Any

    def frame_tables(self) -> dict[str, Any]:
        data, scores = self.data, self.scores
        agreement = reports.compare(self.effects, data.attack_reports, data.link_reports, WIRES)
        updates = [data.trust[frame] for frame in sorted(data.trust)]
        return {
            "same_as": _nested(scores.same_as),
            "metrics": per_frame(scores),
            "objects": self._objects(),
            "attacks": attacks(self.effects, agreement, data.roles, data.period_s),
            **(trust.tables(updates, data.times_ns) if updates else {}),
        }

    def _objects(self) -> dict[str, Any]:
        return {**self.scores.objects(), "cause": cause_names(self.labels.cause), "by": self.labels.by}

    def results(self) -> dict[str, Any]:
        data, scores, labels, manipulations = self.data, self.scores, self.labels, self.manipulations
        frames, times = scores.frames, data.times_ns
        scored = self.settings.scored(len(frames))
        last = int(frames.max(initial=-1))
        agreement = reports.compare(self.effects, data.attack_reports, data.link_reports, WIRES)
        scorer = self.settings.scorer
        targets = achievement.targets(
            scores, labels, manipulations, data.ego, self._victims(), scorer.range_m, scorer.min_points
        )
        drives = driving.drives(self.settings.driving, data.record, scores, labels)
        summary, per_frame, failed_metrics = self._scored(scored)
        integrity, trust_tables = self._trust(scored)
        happened, courses = self._driven().results()
        own_pictures = _own_pictures(data)
        consistency = self.settings.consistency.summary(
            scores.pairs, scores.series, own_pictures or [data.ego], scored, data.period_s
        )
        return {
            "metrics": {
                "frames": len(frames),
                "scored_frames": [int(frame) for frame in frames[scored][[0, -1]]] if len(frames) else [],
                "settled": self.settings.settled(len(frames)),
                "agents": summary,
                "same_as": _nested(scores.same_as),
                "achieved": achievement.summary(targets, scores, labels.switch_by, data.ego, data.period_s, scored),
                "driving": driving.summary(drives, scored),
                **({"driven": happened} if data.heard else {}),
                "consistency": consistency,
                "interposers": reports.summary(self.effects, agreement, data.roles, last, self.from_absence),
                "picture_age_s": data.picture_age_s(frames[scored].tolist()),
                "latency_ms": {"sim_to_picture": data.latency_percentiles_ms()},
                "frames_per_second": 1e9 / times[1] if {0, 1} <= times.keys() else None,
                **integrity,
                **(self._pictures(scored, consistency) if len(own_pictures) > 1 else {}),
                **self._channel(scored),
            },
            "tables": {
                "metrics": per_frame,
                "objects": self._objects(),
                "attacks": attacks(self.effects, agreement, data.roles, data.period_s),
                "targets": targets.table(),
                "driving": driving.table(drives, frames),
                **({"driven": courses} if data.heard else {}),
                **trust_tables,
            },
            "failed_metrics": failed_metrics,
        }

    def _driven(self) -> DrivenCars:
        """The cars that drivers drove."""
        data = self.data
        return DrivenCars(
            record=data.record,
            scores=self.scores,
            labels=self.labels,
            effects=self.effects,
            manipulations=self.manipulations,
            roles=data.roles,
            heard=data.heard,
            ages_s=self.settings.estimate_ages_s,
            take_over=round(self.settings.take_over_s / data.period_s),
            hold=round(self.settings.hold_s / data.period_s),
            limits=self.settings.car_limits,
            times_ns=data.times_ns,
            period_s=data.period_s,
            min_points=self.settings.scorer.min_points,
            look=self.settings.driving,
        )

    def _scored(
        self, scored: slice
    ) -> tuple[dict[str, dict[str, dict[str, Any]]], dict[str, Any], dict[str, BaseException]]:
        """The summary, the table per frame, and errors of user-defined metrics by name.

        The summary is by agent and estimator.
        """
        data, scores, labels = self.data, self.scores, self.labels
        counts = np.zeros(len(scores.frames), bool)
        counts[scored] = True
        own, estimates = self.settings.metrics, []
        if own:
            estimates = estimates_of(scores, labels, counts, data.period_s)
        summary, columns, failed = measured([*MEASURES.values(), *own], ScoredRun(scores, scored, estimates))
        causes = causes_of(scores, labels.cause, labels.switch_cause, scores.frames[scored])
        for (agent, estimator), row in scores.every_series.items():
            summary[agent][estimator] |= causes[row]
        table = frame_keys(scores) | columns
        table["scored"] = np.tile(counts, len(scores.every_series))
        return summary, table, failed

    def _pictures(self, scored: slice, consistency: Mapping[str, Any]) -> dict[str, Any]:
        """How the pictures of agents that do not share one differ. consistency: as in metrics.json"""
        scorer = self.settings.scorer
        lies_from = first_change(self.effects, self.data.roles, self.from_absence)
        part = of_pictures(
            self.scores, self._blamed(), scorer.range_m, scorer.distance, self.data.period_s, scored, lies_from
        )
        return {"pictures": part | {"consistency": consistency_of_pictures(consistency)} if part else part}

    def _blamed(self) -> Bools:
        """(n,) rows of `Scores.judged` that are wrong because of an adversary."""
        return np.asarray((self.labels.cause >= 0) & (self.labels.cause < len(ATTACK_CAUSES)))

    def _channel(self, scored: slice) -> dict[str, Any]:
        """The load of the channel that stations share; empty without one."""
        frames, period_ns = set((self.scores.frames[scored] + 1).tolist()), self.data.period_s * 1e9
        receptions = sorted(self.data.receptions.items())  # floating-point sums depend on the order of their terms
        rows = [state for (_, frame), state in receptions if frame in frames]
        if not rows:
            return {}
        busy, airtime_ns, sent, lost = (np.array(column, np.float64) for column in zip(*rows, strict=True))
        stations = len({agent for agent, _ in self.data.receptions})
        expected = float(sent.sum()) * (stations - 1)
        return {
            "channel": {
                "stations": stations,
                "busy_ratio": mean_and_std(busy),
                "airtime_share": float(airtime_ns.mean()) / period_ns,
                "sent": float((sent > 0).mean()),
                "arrived": 1.0 - float(lost.sum()) / expected if expected else None,
            }
        }

    def _trust(self, scored: slice) -> tuple[dict[str, Any], dict[str, Any]]:
        """The metrics and the tables of a command centre that judges agents; empty without one."""
        data, settings, frames = self.data, self.settings, self.scores.frames
        if not data.trust:
            return {}, {}
        updates = [data.trust[frame] for frame in sorted(data.trust)]
        tables = trust.tables(updates, data.times_ns)
        agents = data.record.agents
        lies = trust.lies(self.effects, data.roles, agents, frames, self.from_absence)
        part = trust.integrity(
            updates,
            lies,
            settings.faults,
            agents,
            frames,
            data.times_ns,
            data.period_s,
            settings.attribution.coast_s,
            deceived_agents(self.scores, self._blamed(), agents) if data.relays else None,
        )
        part["withheld"] = trust.withheld(
            tables["trust_objects"], self.scores.truth, frames, scored, settings.scorer.min_points
        )
        return {"integrity": part}, tables

    def _victims(self) -> dict[str, set[int]]:
        """By interposer, the columns of the agents whose wires it intercepts."""
        agents = list(self.data.record.agents)
        victims: dict[str, set[int]] = {}
        for passage in self.effects.passages:
            if (agent := agent_of(passage.subject)) in agents:
                victims.setdefault(passage.node, set()).add(agents.index(agent))
        return victims


def _nested(same_as: Mapping[tuple[str, str], tuple[str, str]]) -> dict[str, dict[str, str]]:
    """By agent and estimator, the estimator with the same messages."""
    result: dict[str, dict[str, str]] = {}
    for (agent, estimator), (_, twin) in same_as.items():
        result.setdefault(agent, {})[estimator] = twin
    return result
