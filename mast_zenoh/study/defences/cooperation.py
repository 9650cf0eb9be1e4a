"""How far a lie reaches where tracks are fused in one centre, in regional ones, or on board of every agent.

Every trial under attack is paired with the one without of the same architecture, number of agents, scene and seed. An
agent is deceived in a frame if its picture has a false or a missed object that an adversary caused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.metrics.causes import ATTACK_CAUSES
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.study_results import NAN, CooperationRow, CooperationTable
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.study.defences import kinds
from mast_zenoh.study.numbers import ego, scored_frames
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.report.tables.text_table import ResultTables

#: What agents send to others: to a centre, or to each other.
SENT = ("agent/*/tracks", "agent/*/broadcast")
#: Classes of vehicles that could carry sensors.
_VEHICLES = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]
_ROUNDING_S = 1e-6


@dataclass(frozen=True, slots=True)
class CooperationCell(kinds.DefenceCell):
    """A fusion architecture and a number of agents, the ego included.

    attacked: whether some of them lie;  attack_start_s: s of scene time, from which trials count, with lies or without
    """

    kind = "cooperation"

    architecture: str
    agents: int
    attacked: bool
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{self.architecture} {self.agents} agents{' attacked' if self.attacked else ''}"


@dataclass(frozen=True, slots=True)
class CooperationRecord:
    """What the table needs of one trial.

    From the start of the attack on:
    errors:      missed and false objects per frame in the ego's picture
    From the first message on that an adversary changed, as `pictures.deceived` of metrics.json:
    deceived:    mean share of the agents that are deceived;  deceived_max: the greatest share in a frame
    Over the scored frames:
    nees:        normalised error squared of the positions in a picture, mean over agents; 2 is consistent
    gospa_m:     m, between the pictures of two agents; NaN where all have the same
    busy_ratio:  of the channel; NaN without one
    Over the whole run:
    kb_per_s:    kB/s that an agent sends to others
    penetration: share of the vehicles that are agents
    """

    errors: float
    deceived: float
    deceived_max: float
    nees: float
    gospa_m: float
    kb_per_s: float
    busy_ratio: float
    penetration: float


class Collection(kinds.Collection):
    """Lies and their reach, by fusion architecture and number of agents."""

    name = "cooperation"
    drawn = ("cooperation",)
    recorded = True

    @staticmethod
    def evaluate(folder: Path, metrics: Mapping[str, Any], compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        frames_s:    s of scene time of each frame
        deceived:    by frame, the share of the agents that are deceived
        lies_from_s: s, the first frame of which an adversary changed a message; None: nobody lied
        kb_per_s:    kB/s that an agent sends to others, mean
        penetration: share of the vehicles that are agents
        """
        from mast_zenoh.api.runs import Run  # PyArrow is slow to load
        from mast_zenoh.run_folder.recording.reader import read

        recording = Recording.load(folder / RECORDING)
        times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
        run = Run(folder)
        changes = run.attacks.select(["frame", "role", "effect"])
        lied_in, role, effect = (column.to_numpy(zero_copy_only=False) for column in changes.columns)
        lied_in = lied_in[(role != "link") & (effect != "unsettled") & (lied_in >= 0)]
        objects = run.objects.select(["frame", "agent", "estimator", "outcome", "cause"])
        frame, agent, estimator, outcome, cause = (column.to_numpy(zero_copy_only=False) for column in objects.columns)
        wrong = (estimator == PICTURE) & np.isin(outcome, ("false", "missed")) & np.isin(cause, ATTACK_CAUSES)
        names = sorted(metrics["agents"])
        deceived = np.zeros((len(names), len(times_s)), bool)
        deceived[np.searchsorted(names, agent[wrong].astype(str)), frame[wrong]] = True
        sent = dict.fromkeys(SENT, 0)
        for message in read(folder, lambda channel: any(fnmatchcase(channel.get("wire", ""), each) for each in SENT)):
            if not message.tap:
                sent[next(each for each in SENT if fnmatchcase(message.wire, each))] += len(message.payload)
        bytes_sent = sent[SENT[1]] or sent[SENT[0]]  # peers get the tracks of their own agents only
        duration_s = len(times_s) * recording.period_ns * 1e-9
        vehicles = len(np.unique(recording.truth.id[np.isin(recording.truth.class_id, _VEHICLES)]))
        sensing = sum(each.kind == "mobile" for each in recording.agents)
        return {
            "frames_s": np.round(times_s, 9).tolist(),
            "deceived": np.round(deceived.mean(axis=0), 9).tolist(),
            "lies_from_s": round(float(times_s[min(lied_in.min(), len(times_s) - 1)]), 9) if len(lied_in) else None,
            "kb_per_s": round(bytes_sent * 1e-3 / (duration_s * len(recording.agents)), 6),
            "penetration": round(sensing / vehicles, 6),
        }

    def record(self, cell: CooperationCell, outcome: Outcome) -> CooperationRecord:
        metrics, part = outcome.metrics, outcome.metrics["defence"]
        first, last = scored_frames(metrics)
        start = max(first, int(np.searchsorted(part["frames_s"], cell.attack_start_s - _ROUNDING_S)))
        table = outcome.per_frame
        rows = (table["agent"] == ego(metrics)) & (table["estimator"] == PICTURE)
        rows &= (table["frame"] >= start) & (table["frame"] <= last)
        lies_from_s = part.get("lies_from_s")
        lies_from = start if lies_from_s is None else int(np.searchsorted(part["frames_s"], lies_from_s - _ROUNDING_S))
        deceived = np.array(part["deceived"][max(first, lies_from) : last + 1])
        nees = [agent[PICTURE]["position"]["nees"] for agent in metrics["consistency"].values() if PICTURE in agent]
        channel = metrics.get("channel", {})
        return CooperationRecord(
            errors=float((table["fn"][rows] + table["fp"][rows]).mean()),
            deceived=float(deceived.mean()) if len(deceived) else NAN,
            deceived_max=float(deceived.max()) if len(deceived) else NAN,
            nees=float(np.mean([each for each in nees if each is not None])) if nees else NAN,
            gospa_m=metrics.get("pictures", {}).get("difference_gospa_m", {}).get("mean", NAN),
            kb_per_s=part["kb_per_s"],
            busy_ratio=channel["busy_ratio"]["mean"] if channel else NAN,
            penetration=part["penetration"],
        )

    def table(self) -> CooperationTable:
        """A row for each architecture and number of agents; the others are compared with the first architecture."""
        architectures = list(dict.fromkeys(cell.architecture for cell in self.records))
        rows = []
        for agents in sorted({cell.agents for cell in self.records}):
            harm = {name: self._harm(name, agents) for name in architectures}
            rows += [self._row(name, agents, harm[name], harm[architectures[0]]) for name in architectures]
        return CooperationTable([row for row in rows if row.trials], self.size)

    def _of(self, architecture: str, agents: int, attacked: bool) -> Mapping[TrialKey, CooperationRecord]:
        """The trials of a cell that are done, in the order of the study."""
        for cell, records in self.records.items():
            if (cell.architecture, cell.agents, cell.attacked) == (architecture, agents, attacked):
                return {key: records[key] for key in self.order if key in records}
        return {}

    def _harm(self, architecture: str, agents: int) -> dict[TrialKey, float]:
        """By trial, how many more errors the ego's picture has when agents lie."""
        honest, attacked = (self._of(architecture, agents, lie) for lie in (False, True))
        return {key: each.errors - honest[key].errors for key, each in attacked.items() if key in honest}

    def _row(
        self, architecture: str, agents: int, harm: Mapping[TrialKey, float], of_first: Mapping[TrialKey, float]
    ) -> CooperationRow:
        honest, attacked = (self._of(architecture, agents, lie) for lie in (False, True))

        def values(records: Mapping[TrialKey, Any], name: str) -> list[float]:
            return [getattr(records[key], name) if key in records else NAN for key in self.order]

        means = {
            name: self.mean(values(honest, name))
            for name in ("errors", "nees", "gospa_m", "kb_per_s", "busy_ratio", "penetration")
        }
        shares = {name: self.mean(values(attacked, name), (0.0, 1.0)) for name in ("deceived", "deceived_max")}
        return CooperationRow(
            architecture=architecture,
            agents=agents,
            trials=len(harm),
            harm=self.mean([harm.get(key, NAN) for key in self.order], paired=True),
            harm_difference=self.mean([harm.get(key, NAN) - of_first.get(key, NAN) for key in self.order], paired=True),
            **means,
            **shares,
        )

    def tables(self, table: CooperationTable) -> ResultTables:
        from mast_zenoh.report.tables.cooperation import cooperation_tables

        return cooperation_tables(table)

    def figures(self, table: CooperationTable) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.report.figures.cooperation import figure_of_cooperation

        figure = figure_of_cooperation(table)
        return {figure.name: figure}
