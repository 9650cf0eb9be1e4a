"""Computes the metrics and tables of a run from its messages. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools
from mast_zenoh.effects import Effects, effects_of, reports
from mast_zenoh.evaluation import trust
from mast_zenoh.evaluation.from_effects import (
    cut_off_objects,
    displaced_by_links,
    effects_of_absence,
    manipulations,
    without_unseen,
)
from mast_zenoh.evaluation.poses import add_pose_manipulations
from mast_zenoh.evaluation.run_data import RunData
from mast_zenoh.evaluation.tables import attacks
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.links import WIRES
from mast_zenoh.metrics import (
    AttributionLimits,
    Attributor,
    Consistency,
    CutOff,
    Driving,
    Manipulations,
    Metric,
    Scorer,
    Scores,
    achievement,
    achievement_summary,
    cause_names,
    causes_of,
    consequences,
    user_metrics,
)
from mast_zenoh.metrics.ranking import rankings
from mast_zenoh.metrics.record import TruthTable
from mast_zenoh.metrics.scores import COLUMNS
from mast_zenoh.metrics.trust import Fault
from mast_zenoh.metrics.withheld import Withheld
from mast_zenoh.wiring.subjects import agent_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The settings of an evaluation.

    scorer:  compares estimates with the truth
    metrics: user-defined metrics
    driving: settings for the driving consequences of an estimate
    skip_first, skip_last: frames left out of the summary at the beginning and at the end, because tracks need some
             frames to begin with; kept when they would be more than half of the run
    picture_age_s: s, for how long an agent uses a picture when no newer one arrives; picture_ages_s: by agent
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
        user_metrics.check(self.metrics, COLUMNS)

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
        truth, agents = scores.pairs.truth, data.record.agents
        effects = _measured(data, scores)
        from_absence = effects_of_absence(effects, data.presence.absences(scores.frames), scores.frames)
        interposed = manipulations(
            effects,
            data.roles,
            scores.series,
            truth.boxes.in_group(scores.frames[truth.boxes.group]),
            data.period_s,
            from_absence,
            self.attribution,
        )
        spoofs = [meter.effects.spoofs for meter in data.meter.meters]
        duration = round(self.attribution.coast_s / data.period_s)
        interposed = add_pose_manipulations(
            interposed, effects, spoofs, truth, agents, scores.frames, self.scorer.min_points, duration
        )
        updates = [data.trust[frame] for frame in sorted(data.trust)]
        displaced = displaced_by_links(interposed, effects, agents, truth, scores.frames)
        begin = round(self.attribution.begin_s / data.period_s)
        attributor = Attributor(
            self.attribution,
            scores,
            without_unseen(interposed, effects, agents, truth, scores.frames, self.scorer.min_points, begin),
            truth,
            agents,
            data.period_s,
            cut_off_objects(self.cut_off, data, scores, truth, effects, displaced, self.scorer.min_points),
            self.scorer.min_points,
            Withheld.of(updates, agents, scores.frames, SUSPENDED),
            np.asarray(displaced.any(axis=1)),
        )
        return _Results(self, data, scores, truth, effects, from_absence, interposed, attributor.labels())

    def scored(self, frames: int) -> slice:
        """The scored ones among `frames` frames."""
        first, last = (self.skip_first, self.skip_last) if self.settled(frames) else (0, 0)
        return slice(first, frames - last)

    def settled(self, frames: int) -> bool:
        """Whether a run is long enough to leave frames out of the summary."""
        return self.skip_first + self.skip_last <= frames // 2


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
    truth: TruthTable
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
            "metrics": scores.per_frame(),
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
        targets = achievement.targets(
            scores,
            labels.cause,
            labels.by,
            manipulations,
            self.truth,
            data.record.agents,
            data.ego,
            self._victims(),
            self.settings.scorer.range_m,
            self.settings.scorer.min_points,
        )
        drives = consequences.drives(self.settings.driving, data.record, scores, labels, self.truth)
        summary, per_frame, failed_metrics = self._scored(scored)
        integrity, trust_tables = self._trust(scored)
        return {
            "metrics": {
                "frames": len(frames),
                "scored_frames": [int(frame) for frame in frames[scored][[0, -1]]] if len(frames) else [],
                "settled": self.settings.settled(len(frames)),
                "agents": summary,
                "same_as": _nested(scores.same_as),
                "achieved": achievement_summary.summary(
                    targets, manipulations.culprits, scores, labels.switch_by, data.ego, data.period_s, scored
                ),
                "driving": consequences.summary(drives, scored),
                "consistency": self.settings.consistency.summary(
                    scores.pairs, scores.series, data.ego, scored, data.period_s
                ),
                "interposers": reports.summary(self.effects, agreement, data.roles, last, self.from_absence),
                "picture_age_s": data.picture_age_s(frames[scored].tolist()),
                "latency_ms": {"sim_to_picture": data.latency_percentiles_ms()},
                "frames_per_second": 1e9 / times[1] if {0, 1} <= times.keys() else None,
                **integrity,
            },
            "tables": {
                "metrics": per_frame,
                "objects": self._objects(),
                "attacks": attacks(self.effects, agreement, data.roles, data.period_s),
                "targets": targets.table(manipulations.culprits),
                "driving": consequences.table(drives, frames),
                **trust_tables,
            },
            "failed_metrics": failed_metrics,
        }

    def _scored(
        self, scored: slice
    ) -> tuple[dict[str, dict[str, dict[str, Any]]], dict[str, Any], dict[str, BaseException]]:
        """The summary, the table per frame, and errors of user-defined metrics by name.

        The summary is by agent and estimator.
        """
        data, scores, labels = self.data, self.scores, self.labels
        summary, per_frame = scores.summary(scored), scores.per_frame()
        causes = causes_of(scores, labels.cause, labels.switch_cause, scores.frames[scored])
        ranked = rankings(scores, scored)
        for (agent, estimator), row in scores.every_series.items():
            summary[agent][estimator] |= ranked[row] | causes[row]
        counts = np.zeros(len(scores.frames), bool)
        counts[scored] = True
        per_frame["scored"] = np.tile(counts, len(scores.every_series))
        agents, metrics = data.record.agents, self.settings.metrics
        values, failed = user_metrics.values(metrics, scores, labels, self.truth, agents, counts, data.period_s)
        user_metrics.add_to(summary, per_frame, scores, values, counts)
        return summary, per_frame, failed

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
            updates, lies, settings.faults, agents, frames, data.times_ns, data.period_s, settings.attribution.coast_s
        )
        part["withheld"] = trust.withheld(
            tables["trust_objects"], self.truth, frames, scored, settings.scorer.min_points
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
