"""Every defence against every adversary: what each defence is worth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.study_results import (
    DEFENCE_MEASURES,
    AgentTrustSeries,
    DefenceMatrix,
    Measured,
    Row,
    TrustPanel,
)
from mast_zenoh.report.tables.defences import defence_tables
from mast_zenoh.report.tables.text_table import ResultTables
from mast_zenoh.study.defences import intervals, kinds
from mast_zenoh.study.defences.cells import UNDEFENDED, Cell
from mast_zenoh.study.defences.matrix_records import (
    NO_LIES,
    SCORES,
    TrialRecord,
    alarms_per_hour,
    attacked_share,
    characteristic,
    delay_curve,
    judges,
    lies_detected,
    median_delay,
    shares_of_runs,
    state_shares,
)
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.runs.run import Run

#: Panels of trust over time.
MAX_PANELS = 12
#: Agents in a panel.
MAX_AGENTS = 5


class Collection(kinds.Collection):
    """A row for each cell, and a summary for each defence."""

    name = "defences"
    drawn: ClassVar[Sequence[str]] = (
        "defence_matrix",
        "damage_over_adversaries",
        "detection_delay",
        "roc",
        "trust_over_time",
    )
    #: Messages have the sizes of false objects, which decide how many agents would see them. Without a recording, every
    #: false object counts as a car (`runs.observability`): under `coordinated`, this changes `outnumbered`.
    recorded = True
    without_lies = NO_LIES

    def __init__(self, cells: Mapping[str, Cell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        super().__init__(cells, scenes, seeds)
        #: of the first trial of each cell that has a trace
        self._traces: dict[Cell, tuple[TrialKey, Mapping[str, Any]]] = {}
        self._doubting: set[str] = set()
        #: defences that suspended an agent in any run
        self._suspending: set[str] = set()

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        from mast_zenoh.study.defences import matrix_trial  # PyArrow is slow to load

        return matrix_trial.evaluate(run, compromised)

    def record(self, cell: Cell, outcome: Outcome) -> TrialRecord:
        key, content = outcome.trial.key, outcome.metrics["defence"].get("trust")
        if content is not None:
            if cell not in self._traces or self.order[key] < self.order[self._traces[cell][0]]:
                self._traces[cell] = key, content
            if doubts(content):
                self._doubting.add(cell.defence)
        result = TrialRecord.of(outcome.metrics)
        if any(states.get("suspended") for states in result.state_seconds.values()):
            self._suspending.add(cell.defence)
        return result

    def tables(self, table: DefenceMatrix) -> ResultTables:
        return defence_tables(table)

    def figures(self, table: DefenceMatrix) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.report.figures.defences import figures_of_defences

        return figures_of_defences(table)

    def table(self) -> DefenceMatrix:
        """The rows of all cells, each with the budget that does the most damage."""
        groups: dict[tuple[str, str, int, str], list[Cell]] = {}
        for cell in self.records:
            groups.setdefault((cell.defence, cell.attack, cell.n_adversaries, cell.placement), []).append(cell)
        worst = [(max(cells, key=self._mean_damage), len(cells)) for cells in groups.values()]
        worst_cells = [cell for cell, _ in worst]
        every = list(dict.fromkeys(cell.defence for cell in worst_cells))
        defences = [name for name in every if name != UNDEFENDED]
        cells_of = {name: [cell for cell in self.records if cell.defence == name] for name in every}
        trials = {name: self._by_trial(cells) for name, cells in cells_of.items()}
        delays = {name: delay_curve(trials[name]) for name in defences if name in self._suspending}
        curves = [characteristic(name, self._by_trial(cells_of[name], idle=False)) for name in defences]
        panels, unshown = self._panels(worst_cells)
        return DefenceMatrix(
            rows=[self._row(cell, budgets) for cell, budgets in worst],
            rocs=[curve for curve in curves if curve is not None],
            delays={name: delay for name, delay in delays.items() if delay is not None},
            summaries=[
                self._summary(name, [each for each in worst_cells if each.defence == name]) for name in defences
            ],
            size=self.size,
            own=[self._own(cell, budgets) for cell, budgets in worst],
            state_shares={name: state_shares(each) for name, each in trials.items()},
            panels=panels,
            unshown=unshown,
            not_suspending=[name for name in defences if name not in self._suspending and judges(trials[name])],
        )

    def _mean_damage(self, cell: Cell) -> float:
        added = self._added(cell, "fn") + self._added(cell, "fp")
        known = added[~np.isnan(added)]
        return float(known.mean()) if known.size else -math.inf

    def _added(self, cell: Cell, name: str) -> Floats:
        """A score minus that without attack and without defence, of the same scene and seed."""
        return self.values(cell, name) - self.values(cell.undefended.alone, name)

    def _row(self, cell: Cell, budgets: int) -> Row:
        values = {f"{_stem(name)}_added{_unit(name)}": self._added(cell, name) for name in SCORES}
        values["damage"] = values["fn_added"] + values["fp_added"]
        for name in SCORES:
            difference = self.values(cell, name) - self.values(cell.undefended, name)
            values[f"{_stem(name)}_vs_undefended{_unit(name)}"] = difference
        measures = {name: self.mean(each, paired=True) for name, each in values.items()}
        for name in ("fp_identifiable", "fp_unidentifiable"):
            measures[name] = self.mean(self.values(cell, name), (0.0, math.inf))
        majority = self.values(cell, "honest_majority")
        # Where nobody lies because agents are faulty, there is no bound.
        measures["honest_majority"] = Measured() if cell.is_fault else self.mean(majority, (0.0, 1.0))
        measures["identifiable_removed"] = self._removed([cell])
        groups = self._by_trial([cell])
        measures["lies_detected"] = lies_detected(groups)
        measures["median_delay_s"] = median_delay(groups) if cell.defence in self._suspending else Measured()
        measures["honest_suspended_per_hour"] = alarms_per_hour(groups)
        measures["faulty_suspended_per_hour"] = alarms_per_hour(groups, faulty=True)
        measures |= shares_of_runs(groups)
        measures["attacked"] = attacked_share(groups) if cell.lies else Measured()
        delay = delay_curve(groups)
        counts = {
            "liars_watched": delay.watched if delay else 0,
            "liars_suspended": delay.detections if delay else 0,
            "suspended_before": sum(record.suspended_before for group in groups for record in group),
        }
        seconds = _sum_seconds(record.state_seconds for record in self.records[cell].values())
        measures |= {name: Measured(float(each), trials=len(groups)) for name, each in (counts | seconds).items()}
        return Row(_of(cell, budgets), len(groups), {name: measures[name] for name in (*DEFENCE_MEASURES, *seconds)})

    def _own(self, cell: Cell, budgets: int) -> Row:
        records = self.records[cell].values()
        numbers = {}
        for name in dict.fromkeys(name for record in records for name in record.own):
            numbers[name] = self.mean(self.values(cell, name))
            numbers[f"{name} difference"] = self.mean(self._added(cell, name), paired=True)
        return Row(_of(cell, budgets), len(records), numbers)

    def _summary(self, defence: str, cells: Sequence[Cell]) -> Row:
        """cells: of the rows of this defence."""
        alone, attacked = cells[0].alone, [cell for cell in cells if cell.lies]
        lying, faulty = self._by_trial(attacked), self._by_trial(cell for cell in cells if cell.is_fault)
        quiet = self._by_trial([alone] if alone in self.records else [])
        alarms = alarms_per_hour(quiet)
        frames = sum(record.frames for group in quiet for record in group if record.hours)
        numbers = {
            "lies_detected": lies_detected(lying),
            "median_delay_s": median_delay(lying) if defence in self._suspending else Measured(),
            "identifiable_removed": self._removed(attacked),
            "alarms_per_hour": alarms,
            "frames": Measured(float(frames), trials=alarms.trials),
            "fn_added": self.mean(self._added(alone, "fn"), paired=True),
            "fp_added": self.mean(self._added(alone, "fp"), paired=True),
            "faults_suspended": shares_of_runs(faulty)["wrongly_suspended"],
            "framed_by_minority": shares_of_runs(lying)["framed_by_minority"],
        }
        return Row({"defence": defence}, len(lying), numbers)

    def _removed(self, cells: Sequence[Cell]) -> Measured:
        """Share of identifiable inserted objects of the undefended runs that are not in the defended ones.

        cells: added up by scene and seed, without runs in which the adversaries did not lie to this defence; a cell
        without a defence has none to remove
        """
        attacked = [cell for cell in cells if cell.lies and cell.defence != UNDEFENDED]
        if not attacked:
            return Measured()
        pairs = np.array(
            [
                [self._where_attacked(cell, self.values(each, "fp_identifiable")) for each in (cell, cell.undefended)]
                for cell in attacked
            ]
        )
        pairs[np.isnan(pairs).any(axis=1)[:, None].repeat(2, axis=1)] = np.nan
        missing = np.isnan(pairs).all(axis=(0, 1))
        remaining, inserted = (np.where(missing, np.nan, np.nansum(pairs[:, index], axis=0)) for index in (0, 1))
        return intervals.one_minus(intervals.share(remaining, inserted))

    def _where_attacked(self, cell: Cell, values: Floats) -> Floats:
        """(trials,) the values of those trials of a cell in which its adversaries lied; NaN: they did not."""
        attacked = {key for key, record in self.records.get(cell, {}).items() if record.attacked}
        return np.where([key in attacked for key in self.order], values, np.nan)

    def _by_trial(self, cells: Iterable[Cell], *, idle: bool = True) -> list[list[TrialRecord]]:
        """The records of cells, grouped by scene and seed; idle: also those whose adversaries never lied."""
        groups: dict[TrialKey, list[TrialRecord]] = {}
        for cell in cells:
            for key, record in self.records[cell].items():
                if idle or record.attacked or not cell.lies:
                    groups.setdefault(key, []).append(record)
        return [groups[key] for key in sorted(groups, key=self.order.__getitem__)]

    def _panels(self, cells: Sequence[Cell]) -> tuple[list[TrustPanel], int]:
        """The first trial of each defence that doubts agents, under each adversary; and the number of other such pairs.

        cells: of the rows
        """
        first: dict[tuple[str, str], Cell] = {}
        for cell in cells:
            if cell.attack and cell.defence in self._doubting and cell in self._traces:
                first.setdefault((cell.attack, cell.defence), cell)
        attacks = list(dict.fromkeys(cell.attack for cell in cells))
        pairs = sorted(first, key=lambda pair: attacks.index(pair[0]))  # the defences of one adversary side by side
        panels = [panel(self._traces[first[pair]][1], _title(first[pair])) for pair in pairs[:MAX_PANELS]]
        return panels, len(pairs) - len(panels)


def _title(cell: Cell) -> str:
    return f"{cell.defence} against {cell.attack} ({cell.n_adversaries}, {cell.placement})"


def _of(cell: Cell, budgets: int) -> dict[str, Any]:
    names = ("defence", "attack", "n_adversaries", "placement", "budget")
    return {name: getattr(cell, name) for name in names} | {"budgets": budgets}


def _sum_seconds(parts: Iterable[Mapping[str, Mapping[str, float]]]) -> dict[str, float]:
    """The sums of s by conduct and state."""
    total: dict[str, float] = {}
    for part in parts:
        for conduct, states in part.items():
            for state, seconds in states.items():
                name = f"seconds {conduct} {state}"
                total[name] = total.get(name, 0.0) + seconds
    return total


def _stem(name: str) -> str:
    return name.removesuffix("_m")


def _unit(name: str) -> str:
    return "_m" if name.endswith("_m") else ""


def panel(content: Mapping[str, Any], title: str) -> TrustPanel:
    """The panel of a trace; of many agents, those that lied, were faulty or were judged to be so come first."""
    agents = [_agent_series(name, each) for name, each in content["agents"].items()]
    uneventful = [not (agent.lies or agent.faults or any(agent.states.values())) for agent in agents]
    chosen = sorted(np.argsort(uneventful, kind="stable")[:MAX_AGENTS].tolist())
    return TrustPanel(title, [agents[index] for index in chosen], len(agents) - len(chosen), content["end_s"])


def doubts(content: Mapping[str, Any]) -> bool:
    """Whether a trace has an agent that is suspended or undecided."""
    return any(agent["states"][state] for agent in content["agents"].values() for state in ("suspended", "undecided"))


def _agent_series(name: str, content: Mapping[str, Any]) -> AgentTrustSeries:
    return AgentTrustSeries(
        name,
        np.array(content["time_s"], np.float64),
        np.array([math.nan if value is None else value for value in content["log_odds"]], np.float64),
        {state: [(start, stop) for start, stop in spans] for state, spans in content["states"].items()},
        [(start, stop) for start, stop in content["lies"]],
        [(kind, start, stop) for kind, start, stop in content["faults"]],
    )
