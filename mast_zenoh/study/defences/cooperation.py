"""How far a lie reaches where tracks are fused in one centre, in regional ones, or on board of every agent.

Every trial under attack is paired with the one without of the same place, number of agents, scene and seed. An agent is
deceived in a frame if its picture has a false or a missed object that an adversary caused.
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
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.study_results import NAN, CooperationRow, CooperationTable
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.study.defences import kinds
from mast_zenoh.study.defences.intervals import mean
from mast_zenoh.study.numbers import ego, scored_frames
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.report.tables.text_table import ResultTables

#: What agents send to others: to a centre, or to each other.
SENT = ("agent/*/tracks", "agent/*/broadcast")
#: Classes of cars that could carry sensors.
_CARS = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]
_ROUNDING_S = 1e-6


@dataclass(frozen=True, slots=True)
class CooperationCell(kinds.DefenceCell):
    """A place of fusion and a number of agents, the ego included.

    lied_to: whether some of them lie;  attack_start_s: s of scene time, from which trials count, with lies or without
    """

    kind = "cooperation"

    place: str
    agents: int
    lied_to: bool
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{self.place} {self.agents} agents{' lied to' if self.lied_to else ''}"


@dataclass(frozen=True, slots=True)
class CooperationRecord:
    """What the table needs of one trial, from the start of the attack on.

    errors:      missed and false objects per frame in the ego's picture
    deceived:    mean share of the agents that are deceived;  most: the greatest share in a frame
    nees:        normalised error squared of the positions in a picture, mean over agents; 2 is consistent
    gospa_m:     m, between the pictures of two agents; NaN where all have the same
    kb_per_s:    kB/s that an agent sends to others
    busy:        channel busy ratio; NaN without a channel
    penetration: share of the cars that are agents
    """

    errors: float
    deceived: float
    most: float
    nees: float
    gospa_m: float
    kb_per_s: float
    busy: float
    penetration: float


class Collection(kinds.Collection):
    """Lies and their reach, by place of fusion and number of agents."""

    name = "cooperation"
    drawn = ("cooperation",)
    recorded = True

    @staticmethod
    def evaluate(folder: Path, metrics: Mapping[str, Any], compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        frames_s:    s of scene time of each frame
        deceived:    by frame, the share of the agents that are deceived
        kb_per_s:    kB/s that an agent sends to others, mean
        penetration: share of the cars that are agents
        """
        from mast_zenoh.api.runs import Run  # PyArrow is slow to load
        from mast_zenoh.messagelog.reader import read

        recording = Recording.load(folder / RECORDING)
        times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
        objects = Run(folder).objects.select(["frame", "agent", "estimator", "outcome", "by"])
        frame, agent, estimator, outcome, by = (column.to_numpy(zero_copy_only=False) for column in objects.columns)
        wrong = (estimator == PICTURE) & np.isin(outcome, ("false", "missed")) & np.isin(by, _adversaries(metrics))
        names = sorted(metrics["agents"])
        deceived = np.zeros((len(names), len(times_s)), bool)
        deceived[np.searchsorted(names, agent[wrong].astype(str)), frame[wrong]] = True
        sent = dict.fromkeys(SENT, 0)
        for message in read(folder, lambda wire: any(fnmatchcase(wire, each) for each in SENT)):
            if not message.tap:
                sent[next(each for each in SENT if fnmatchcase(message.wire, each))] += len(message.payload)
        bytes_sent = sent[SENT[1]] or sent[SENT[0]]  # peers get the tracks of their own agents only
        duration_s = len(times_s) * recording.period_ns * 1e-9
        cars = len(np.unique(recording.truth.id[np.isin(recording.truth.class_id, _CARS)]))
        sensing = sum(each.kind == "mobile" for each in recording.agents)
        return {
            "frames_s": np.round(times_s, 9).tolist(),
            "deceived": np.round(deceived.mean(axis=0), 9).tolist(),
            "kb_per_s": round(bytes_sent * 1e-3 / (duration_s * len(recording.agents)), 6),
            "penetration": round(sensing / cars, 6),
        }

    def record(self, cell: CooperationCell, outcome: Outcome) -> CooperationRecord:
        metrics, part = outcome.metrics, outcome.metrics["defence"]
        first, last = scored_frames(metrics)
        start = max(first, int(np.searchsorted(part["frames_s"], cell.attack_start_s - _ROUNDING_S)))
        table = outcome.per_frame
        rows = (table["agent"] == ego(metrics)) & (table["estimator"] == PICTURE)
        rows &= (table["frame"] >= start) & (table["frame"] <= last)
        deceived = np.array(part["deceived"][start : last + 1])
        nees = [agent[PICTURE]["position"]["nees"] for agent in metrics["consistency"].values() if PICTURE in agent]
        channel = metrics.get("channel", {})
        return CooperationRecord(
            errors=float((table["fn"][rows] + table["fp"][rows]).mean()),
            deceived=float(deceived.mean()) if len(deceived) else NAN,
            most=float(deceived.max()) if len(deceived) else NAN,
            nees=float(np.mean([each for each in nees if each is not None])) if nees else NAN,
            gospa_m=metrics.get("between", {}).get("difference_gospa_m", {}).get("mean", NAN),
            kb_per_s=part["kb_per_s"],
            busy=channel["busy_ratio"]["mean"] if channel else NAN,
            penetration=part["penetration"],
        )

    def table(self) -> CooperationTable:
        """A row for each place and number of agents; the first place is what the others are compared with."""
        places = list(dict.fromkeys(cell.place for cell in self.records))
        rows = []
        for agents in sorted({cell.agents for cell in self.records}):
            harm = {place: self._harm(place, agents) for place in places}
            rows += [self._row(place, agents, harm[place], harm[places[0]]) for place in places]
        return CooperationTable([row for row in rows if row.trials], self.size)

    def _of(self, place: str, agents: int, lied_to: bool) -> Mapping[TrialKey, CooperationRecord]:
        """The trials of a cell that are done, in the order of the study."""
        for cell, records in self.records.items():
            if (cell.place, cell.agents, cell.lied_to) == (place, agents, lied_to):
                return {key: records[key] for key in self.order if key in records}
        return {}

    def _harm(self, place: str, agents: int) -> dict[TrialKey, float]:
        """By trial, how many more errors the ego's picture has when agents lie."""
        honest, lied_to = (self._of(place, agents, lie) for lie in (False, True))
        return {key: each.errors - honest[key].errors for key, each in lied_to.items() if key in honest}

    def _row(
        self, place: str, agents: int, harm: Mapping[TrialKey, float], of_first: Mapping[TrialKey, float]
    ) -> CooperationRow:
        honest, lied_to = (list(self._of(place, agents, lie).values()) for lie in (False, True))
        means = {
            name: mean([getattr(each, name) for each in honest])
            for name in ("errors", "nees", "gospa_m", "kb_per_s", "busy", "penetration")
        }
        shares = {name: mean([getattr(each, name) for each in lied_to], (0.0, 1.0)) for name in ("deceived", "most")}
        return CooperationRow(
            place=place,
            agents=agents,
            trials=len(harm),
            harm=mean(list(harm.values())),
            more=mean([value - of_first[key] for key, value in harm.items() if key in of_first]),
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


def _adversaries(metrics: Mapping[str, Any]) -> list[str]:
    """Names of the adversaries of a run."""
    interposers = metrics.get("interposers", {})
    return [name for name, each in interposers.items() if each["role"] == "adversary"]
