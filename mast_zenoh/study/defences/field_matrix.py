"""The matrix of published and own methods: that of `matrix`, by kind of scene, with processor time and breakdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.field_results import (
    FieldBreakdown,
    FieldMatrix,
    Published,
    PublishedNumber,
)
from mast_zenoh.metrics.study_results import Measured, Row
from mast_zenoh.report.tables.field_matrix import field_tables, published_tables
from mast_zenoh.report.tables.scoreboard import scoreboard_tables
from mast_zenoh.report.tables.text_table import ResultTables
from mast_zenoh.study.defences import breakdown, intervals, matrix, matrix_records
from mast_zenoh.study.defences.breakdown import HALF, BreakdownRecord, mean_crossing
from mast_zenoh.study.defences.cells import UNDEFENDED, BreakdownCell, Cell, FieldCell
from mast_zenoh.study.defences.choices import SCENE_KINDS
from mast_zenoh.study.defences.published import BY_SUSPENSION, PUBLISHED
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.runs.run import Run

_ROUNDING = 1e-12
#: Titles of kinds of scene.
_TITLES = {"poles": "4 poles", "cars": "4 cars", "many": "8 poles, 4 cars"}


def scene_title(label: str) -> str:
    """The title of a scene of the study, by its label; the label, if it is of no kind."""
    for kind, agents in SCENE_KINDS.items():
        if label.endswith(f", {agents['n_infrastructure']}, {agents['n_mobile']}"):
            return _TITLES[kind]
    return label


class Collection(matrix.Collection):
    """The rows of the matrix, in all scenes and in each; breakdown; and published figures next to ours."""

    name = "matrix"
    drawn = (*matrix.Collection.drawn, "harm_by_scene")
    #: Without an attack, the whole run counts for the breakdown.
    without_lies = matrix_records.NO_LIES | {"compromised": [], "frames_s": []}

    def __init__(self, cells: Mapping[str, FieldCell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        super().__init__(cells, scenes, seeds)
        self._scenes = list(scenes)
        self._broken: dict[Cell, dict[TrialKey, BreakdownRecord]] = {cell: {} for cell in cells.values()}
        self._agents: dict[str, int] = {}

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The parts of `matrix` and of `breakdown`."""
        own = matrix.Collection.evaluate(run, compromised)
        return breakdown.Collection.evaluate(run, compromised) | own

    def record(self, cell: Any, outcome: Outcome) -> matrix_records.TrialRecord:
        key, agents = outcome.trial.key, len(outcome.metrics["agents"])
        of_breakdown = BreakdownCell(cell.attack, agents, cell.n_adversaries if cell.lies else 0, cell.attack_start_s)
        self._broken[cell][key] = BreakdownRecord.of(of_breakdown, outcome)
        self._agents[key.scene] = agents
        record = super().record(cell, outcome)
        cpu_ms = 1e3 * outcome.cpu_s / outcome.metrics["frames"] if outcome.cpu_s > 0.0 else math.nan
        return replace(record, scores=record.scores | {"cpu_ms": cpu_ms})

    def tables(self, table: Any) -> ResultTables:
        return field_tables(table)

    def more_tables(self, table: Any) -> Mapping[str, ResultTables]:
        return {"scoreboard": scoreboard_tables(table), "published": published_tables(table)}

    def figures(self, table: Any) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.report.figures.defences import figures_of_defences
        from mast_zenoh.report.figures.field_matrix import figures_of_field

        return figures_of_field(table) | figures_of_defences(table.matrix)

    def table(self) -> Any:
        """The FieldMatrix: the matrix with all that is computed from its trials."""
        scenes = ["", *self._scenes]
        cells = list(self.records)
        defences = list(dict.fromkeys(cell.defence for cell in cells))
        breakdowns = {
            (scene, defence): self._breakdown(scene, defence)
            for defence in defences
            for scene in scenes
            if any(cell.lies and cell.defence == defence for cell in cells)
        }
        return FieldMatrix(
            matrix=super().table(),
            scenes=[scene_title(scene) for scene in self._scenes],
            rows=[self._field_row(cell, scene) for scene in scenes for cell in cells],
            breakdowns=list(breakdowns.values()),
            summaries=[
                self._field_summary(defence)
                for defence in defences
                if defence != UNDEFENDED and ("", defence) in breakdowns
            ],
            published=list(self._published()),
        )

    # -- rows ----------------------------------------------------------------------------------------------------------

    def _in_scene(self, values: Floats, scene: str) -> Floats:
        """The values of the trials of a scene; "": all."""
        return values[[not scene or key.scene == scene for key in self.order]]

    def _field_row(self, cell: Cell, scene: str) -> Row:
        keys = [key for key in self.order if key in self.records[cell] and scene in ("", key.scene)]
        groups = [[self.records[cell][key]] for key in keys]
        cpu_ms, scenes = self._in_scene(self._processor(cell), scene), 1 if scene else self.scenes
        damages = [self._in_scene(self._damage(each), scene) for each in (cell, cell.alone, cell.undefended)]
        differences = (damages[0], damages[0] - damages[1], damages[0] - damages[2])
        damage, by_attack, harm = (intervals.mean(each, scenes=scenes, paired=True) for each in differences)
        numbers = {
            "damage": damage,
            "by_attack": by_attack,
            "harm": harm,
            "attacked": matrix_records.attacked_share(groups) if cell.lies else Measured(),
            "honest_suspended": matrix_records.shares_of_runs(groups)["honest_suspended"],
            "cpu_ms": intervals.mean(cpu_ms, scenes=scenes),
            "cpu_ratio": ratio(cpu_ms, self._in_scene(self._processor(cell.undefended), scene), scenes=scenes),
        }
        of = {name: getattr(cell, name) for name in ("defence", "attack", "n_adversaries", "placement")}
        return Row({"scene": scene_title(scene)} | of, len(keys), numbers)

    def _damage(self, cell: Cell) -> Floats:
        """(trials,) missed and false objects per frame, minus those without attack and without defence."""
        return self._added(cell, "fn") + self._added(cell, "fp")

    def _processor(self, cell: Cell) -> Floats:
        """(trials,) ms of processor time per frame, NaN where it is not known."""
        return self.values(cell, "cpu_ms")

    # -- breakdown -----------------------------------------------------------------------------------------------------

    def _breakdown(self, scene: str, defence: str) -> FieldBreakdown:
        """Broken trials of one defence, by number of adversaries; without any, the same run counts for all attacks."""
        keys = [key for key in self.order if scene in ("", key.scene)]
        cells = [cell for cell in self.records if cell.defence == defence and not cell.is_fault]
        attacks = dict.fromkeys(cell.attack for cell in cells if cell.lies)
        counts = sorted({cell.n_adversaries for cell in cells})
        shares = {
            attack: np.stack(
                [
                    self._broken_share([each for each in cells if each.attack in ("", attack)], count, keys)
                    for count in counts
                ],
                axis=1,
            )
            for attack in attacks
        }
        every = _mean_known(np.stack(list(shares.values())))  # (trials, counts)
        points = {attack: _crossing(counts, values) for attack, values in shares.items()}
        reached = {attack: point for attack, point in points.items() if math.isfinite(point)}
        most_broken = {attack: np.nanmax(_mean_known(shares[attack])) for attack in reached}
        weakest = min(reached, key=lambda attack: (reached[attack], -most_broken[attack]), default="")
        point = intervals.pooled(lambda rows: _crossing(counts, every[rows]), len(keys))
        if _is_single(counts):
            point = Measured(point.value, trials=point.trials)
        scenes = 1 if scene else self.scenes
        sizes = {self._agents[key.scene] for key in keys if key.scene in self._agents}
        return FieldBreakdown(
            scene=scene_title(scene),
            defence=defence,
            agents=sizes.pop() if len(sizes) == 1 else 0,
            broken={
                count: intervals.mean(every[:, index], (0.0, 1.0), scenes=scenes) for index, count in enumerate(counts)
            },
            point=point,
            weakest=weakest,
            weakest_at=reached.get(weakest, math.inf),
        )

    def _broken_share(self, cells: Iterable[Cell], count: int, keys: Sequence[TrialKey]) -> Floats:
        """(trials,) the share of broken runs of the cells with a number of adversaries, NaN without a run."""
        runs = [[self._is_broken(cell, key) for key in keys] for cell in cells if cell.n_adversaries == count]
        return _mean_known(np.array(runs, np.float64).reshape(-1, len(keys)))

    def _is_broken(self, cell: Cell, key: TrialKey) -> float:
        """Whether a run is broken, in the sense of `breakdown`; NaN if it failed."""
        record = self._broken[cell].get(key)
        if record is None:
            return math.nan
        return float(record.worse or record.honest_first(self._broken.get(cell.alone, {}).get(key)))

    # -- summaries and published figures -------------------------------------------------------------------------------

    def _field_summary(self, defence: str) -> Row:
        attacked = [cell for cell in self.records if cell.defence == defence and cell.lies]
        pairs = [(self._processor(cell), self._processor(cell.undefended)) for cell in attacked]
        alone = attacked[0].alone
        numbers = {
            "harm_removed": self._harm_removed(attacked),
            "cpu_ratio_alone": ratio(self._processor(alone), self._processor(alone.undefended), scenes=self.scenes),
            "cpu_ratio_attacked": ratio(*(np.stack(part) for part in zip(*pairs, strict=True)), scenes=self.scenes),
        }
        return Row({"defence": defence}, len(self.order), numbers)

    def _harm_removed(self, cells: Sequence[Cell]) -> Measured:
        """1 minus what the attacks of all cells add with the defence over what they add without it.

        Each is relative to the same run without the attack, so that neither the cost of a defence nor what it removes
        of the sensors' own errors counts. NaN if attacks add nothing without the defence. Runs in which the adversaries
        did not lie to this defence are left out.
        """
        damage = np.array(
            [
                [
                    self._where_attacked(cell, self._damage(each) - self._damage(each.alone))
                    for each in (cell, cell.undefended)
                ]
                for cell in cells
            ]
        )
        damage = np.where(np.isnan(damage).any(axis=1, keepdims=True), np.nan, damage)
        sums = np.nansum(damage, axis=0)[:, ~np.isnan(damage).all(axis=(0, 1))]

        def removed(rows: Ints) -> float:
            with_defence, without = sums[:, rows].sum(axis=1)
            return 1.0 - float(with_defence / without) if without > 0.0 else math.nan

        return intervals.pooled(removed, sums.shape[1])

    def _published(self) -> Iterable[Published]:
        """The published methods that this study played."""
        played = {name for cell in self.records for name in (cell.defence, cell.attack)}
        return (replace(entry, ours=list(self._ours(entry))) for entry in PUBLISHED if entry.method in played)

    def _ours(self, entry: Published) -> Iterable[PublishedNumber]:
        every = list(dict.fromkeys(cell.defence for cell in self.records))
        chosen = entry.defences or tuple(name for name in every if name != UNDEFENDED)
        for quantity in entry.quantities:
            for defence in chosen:
                cells = [cell for cell in self.records if cell.defence == defence and cell.lies]
                cells = [cell for cell in cells if not entry.attacks or cell.attack in entry.attacks]
                if cells:
                    alone = quantity == "fn_added_alone"
                    attacks = () if alone else tuple(dict.fromkeys(cell.attack for cell in cells))
                    value = self._quantity(quantity, cells)
                    yield PublishedNumber(quantity=quantity, defence=defence, attacks=attacks, value=value)

    def _quantity(self, name: str, cells: Sequence[Cell]) -> Measured:
        """One of `field_results.QUANTITIES`, of cells of one defence."""
        groups = self._by_trial(cells)
        suspending = cells[0].defence in self._suspending
        detects = suspending or not {cell.attack for cell in cells} <= BY_SUSPENSION
        computed: dict[str, Callable[[], Measured]] = {
            "lies_detected": lambda: matrix_records.lies_detected(groups) if detects else Measured(),
            "harm_removed": lambda: self._harm_removed(cells),
            "honest_suspended_time": lambda: (
                matrix_records.state_shares(groups).get("honest", {}).get("suspended", Measured())
            ),
            "median_delay_s": lambda: matrix_records.median_delay(groups) if suspending else Measured(),
            "targets_suspended": lambda: _liars_suspended(groups),
            "fn_added_alone": lambda: self.mean(self._added(cells[0].alone, "fn"), paired=True),
            "fp_added": lambda: self._mean_of(cells, lambda cell: self._added(cell, "fp")),
            "damage": lambda: self._mean_of(cells, self._damage),
            "ospa_vs_undefended_m": lambda: self._mean_of(
                cells, lambda cell: self.values(cell, "ospa_m") - self.values(cell.undefended, "ospa_m")
            ),
            "cpu_growth": lambda: self._growth(cells),
        }
        return computed[name]()

    def _mean_of(self, cells: Sequence[Cell], values: Callable[[Cell], Floats]) -> Measured:
        """The mean over trials of the mean over cells."""
        return self.mean(_mean_known(np.stack([values(cell) for cell in cells])), paired=True)

    def _growth(self, cells: Sequence[Cell]) -> Measured:
        """Processor time relative to the other attacks on the same defence, by as many adversaries of one placement."""
        parts = []
        for cell in cells:
            place = (cell.defence, cell.n_adversaries, cell.placement)
            others = [
                self._processor(each)
                for each in self.records
                if each.lies and each.attack != cell.attack
                if (each.defence, each.n_adversaries, each.placement) == place
            ]
            if others:
                parts.append((self._processor(cell), _mean_known(np.stack(others))))
        stacks = [np.stack(part) for part in zip(*parts, strict=True)]
        return ratio(*stacks, scenes=self.scenes) if parts else Measured()


def ratio(values: Floats, references: Floats, *, scenes: int = 1) -> Measured:
    """The geometric mean of paired ratios over trials.

    values, references: (trials,) or (cells, trials), positive; NaN where one has none
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithms = np.log(np.atleast_2d(values)) - np.log(np.atleast_2d(references))
    measured = intervals.mean(_mean_known(logarithms), scenes=scenes)
    value, low, high = (math.exp(each) for each in measured[:3])
    return measured._replace(value=value, low=low, high=high)


def _liars_suspended(groups: matrix_records.Groups) -> Measured:
    """The share of agents with an observable lie that were suspended, of those that were judged."""
    delays = [[suspended for record in group for _, suspended in record.delays] for group in groups]
    return intervals.share([sum(each) for each in delays], [len(each) for each in delays])


def _mean_known(values: Floats) -> Floats:
    """(n,) or (n, k) means over the first axis without NaN; NaN where all are."""
    known = ~np.isnan(values)
    count = known.sum(axis=0)
    sums = np.where(known, values, 0.0).sum(axis=0)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)


def _is_single(counts: Sequence[int]) -> bool:
    """Whether attacks were played with one number of adversaries alone."""
    return len({*counts} - {0}) == 1


def _crossing(counts: Sequence[int], shares: Floats) -> float:
    """The number of adversaries at which half of the trials are broken; shares: (trials, counts), NaN: none.

    Interpolated between numbers that were tried, if these are several; with a single one there is no curve.
    """
    means = _mean_known(shares)
    known = ~np.isnan(means)
    if _is_single(counts) and known.any():
        reached = np.asarray(counts)[means >= HALF - _ROUNDING]
        return float(reached.min()) if len(reached) else math.inf
    return mean_crossing(counts, shares.T)
