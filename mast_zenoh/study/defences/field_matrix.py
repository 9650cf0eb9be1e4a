"""The matrix of published and own methods: that of `matrix`, by kind of scene, with processor time and breakdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.show.tables.text_table import ResultTables
from mast_zenoh.study import statistics
from mast_zenoh.study.choices import SCENE_KINDS, UNDEFENDED
from mast_zenoh.study.defences import breakdown, matrix
from mast_zenoh.study.defences.breakdown import HALF, honest_first, mean_crossing, measures_of_breaking
from mast_zenoh.study.defences.kinds import Factors
from mast_zenoh.study.defences.matrix import alone, is_fault, lies, undefended
from mast_zenoh.study.defences.matrix_table import MatrixTable, Published
from mast_zenoh.study.defences.scoreboard import BY_SUSPENSION, PUBLISHED, published_tables, scoreboard_tables
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
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


class FieldMatrix(matrix.DefenceMatrix):
    """The rows of the matrix, in all scenes and in each; breakdown; and published figures next to ours."""

    name = "matrix"
    drawn = (*matrix.DefenceMatrix.drawn, "harm_by_scene")
    #: Without an attack, the whole run counts for the breakdown.
    without_lies = matrix.NO_LIES | {"compromised": [], "frames_s": []}

    def __init__(self, factors: Mapping[str, Factors], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        super().__init__(factors, scenes, seeds)
        #: number of agents by scene
        self._agents: dict[str, int] = {}

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The parts of `matrix` and of `breakdown`."""
        own = matrix.DefenceMatrix.evaluate(run, compromised)
        return breakdown.Breakdown.evaluate(run, compromised) | own

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """Those of the matrix and of `measures_of_breaking`; and ms of processor time per frame, NaN: not known."""
        self._agents[outcome.trial.scene] = len(outcome.metrics["agents"])
        cpu_ms = 1e3 * outcome.cpu_s / outcome.metrics["frames"] if outcome.cpu_s > 0.0 else math.nan
        broken = measures_of_breaking(outcome, factors["attack_start_s"])
        return broken | super().measures(factors, outcome) | {"cpu_ms": cpu_ms}

    def more_tables(self, table: MatrixTable) -> Mapping[str, ResultTables]:
        return {"scoreboard": scoreboard_tables(table), "published": published_tables(table)}

    def table(self) -> MatrixTable:
        """The matrix with all that is computed from its trials."""
        scenes = ["", *self.scenes]
        defences = self.several("defence")
        attacked = [name for name in defences if any(lies(each) for each in self._of_defence(name))]
        of_matrix = super().table()
        added = {name: self._field_summary(name) for name in attacked}
        return replace(
            of_matrix,
            summaries=[
                replace(row, numbers={**row.numbers, **added.get(row.of["defence"], {})}) for row in of_matrix.summaries
            ],
            scenes=[scene_title(scene) for scene in self.scenes],
            by_scene=[self._field_row(factors, scene) for scene in scenes for factors in self.trials],
            breakdowns=[self._breakdown(scene, name) for name in attacked for scene in scenes],
            published=list(self._published()),
        )

    # -- rows ----------------------------------------------------------------------------------------------------------

    def _in_scene(self, values: Floats, scene: str) -> Floats:
        """The values of the trials of a scene; "": all."""
        return values[[not scene or key.scene == scene for key in self.order]]

    def _field_row(self, factors: Factors, scene: str) -> Row:
        keys = [key for key in self.order if key in self.trials[factors] and scene in ("", key.scene)]
        groups = [[self.trials[factors][key]] for key in keys]
        cpu_ms, scenes = self._in_scene(self._processor(factors), scene), 1 if scene else len(self.scenes)
        compared = factors, alone(factors), undefended(factors)
        damages = [self._in_scene(self.damage(each), scene) for each in compared]
        differences = (damages[0], damages[0] - damages[1], damages[0] - damages[2])
        damage, by_attack, harm = (statistics.mean(each, scenes=scenes, paired=True) for each in differences)
        numbers = {
            "damage": damage,
            "by_attack": by_attack,
            "harm": harm,
            "attacked": matrix.attacked_share(groups) if lies(factors) else Statistic(),
            "honest_suspended": matrix.shares_of_runs(groups)["honest_suspended"],
            "cpu_ms": statistics.mean(cpu_ms, scenes=scenes),
            "cpu_ratio": ratio(cpu_ms, self._in_scene(self._processor(undefended(factors)), scene), scenes=scenes),
        }
        of = {name: factors[name] for name in ("defence", "attack", "n_adversaries", "placement")}
        return Row({"scene": scene_title(scene)} | of, len(keys), numbers)

    def _processor(self, factors: Factors) -> Floats:
        """(trials,) ms of processor time per frame, NaN where it is not known."""
        return self.values(factors, "cpu_ms")

    # -- breakdown -----------------------------------------------------------------------------------------------------

    def _breakdown(self, scene: str, defence: str) -> Row:
        """With how many adversaries a defence breaks; without any, the same run counts for all attacks.

        Of: scene; defence; agents, 0 if scenes differ; weakest, the attack with the smallest point, "" if none is
        reached. Its numbers:
        broken N:   share of broken trials of all attacks with N adversaries
        breaks_at:  number of adversaries at which half of them are broken, interpolated; infinite: more than were
                    tried. If only one number was tried, it is that one, as an upper bound, and has no interval
        weakest_at: that point of the weakest attack
        """
        keys = [key for key in self.order if scene in ("", key.scene)]
        cells = [each for each in self._of_defence(defence) if not is_fault(each)]
        attacks = dict.fromkeys(each["attack"] for each in cells if lies(each))
        counts = sorted({each["n_adversaries"] for each in cells})
        shares = {
            attack: self._in_scene(
                np.stack([self._broken_share(cells, attack, count) for count in counts], axis=1), scene
            )
            for attack in attacks
        }
        every = _mean_known(np.stack(list(shares.values())))  # (trials, counts)
        points = {attack: _crossing(counts, values) for attack, values in shares.items()}
        reached = {attack: point for attack, point in points.items() if math.isfinite(point)}
        most_broken = {attack: np.nanmax(_mean_known(shares[attack])) for attack in reached}
        weakest = min(reached, key=lambda attack: (reached[attack], -most_broken[attack]), default="")
        point = statistics.pooled(lambda rows: _crossing(counts, every[rows]), len(keys))
        if _is_single(counts):
            point = Statistic(point.value, trials=point.trials)
        scenes = 1 if scene else len(self.scenes)
        sizes = {self._agents[key.scene] for key in keys if key.scene in self._agents}
        agents = sizes.pop() if len(sizes) == 1 else 0
        numbers = {
            f"broken {count}": statistics.mean(every[:, index], (0.0, 1.0), scenes=scenes)
            for index, count in enumerate(counts)
        }
        numbers |= {"breaks_at": point, "weakest_at": Statistic(reached.get(weakest, math.inf))}
        of = {"scene": scene_title(scene), "defence": defence, "agents": agents, "weakest": weakest}
        return Row(of, len(keys), numbers)

    def _broken_share(self, cells: Iterable[Factors], attack: str, count: int) -> Floats:
        """(trials,) the share of broken runs, as in `breakdown`, under one attack with a number of adversaries."""
        played = [each for each in cells if each["attack"] in ("", attack) and each["n_adversaries"] == count]
        runs = [np.fmax(self.values(each, "worse"), honest_first(self, each, alone(each))) for each in played]
        return _mean_known(np.array(runs, np.float64).reshape(-1, len(self.order)))

    # -- summaries and published figures -------------------------------------------------------------------------------

    def _field_summary(self, defence: str) -> dict[str, Statistic]:
        """What the summary of a defence has, too."""
        attacked = [each for each in self._of_defence(defence) if lies(each)]
        pairs = [(self._processor(each), self._processor(undefended(each))) for each in attacked]
        without = alone(attacked[0])
        of_alone = self._processor(without), self._processor(undefended(without))
        of_attacked = (np.stack(part) for part in zip(*pairs, strict=True))
        return {
            "harm_removed": self._harm_removed(attacked),
            "cpu_ratio_alone": ratio(*of_alone, scenes=len(self.scenes)),
            "cpu_ratio_attacked": ratio(*of_attacked, scenes=len(self.scenes)),
        }

    def _harm_removed(self, cells: Sequence[Factors]) -> Statistic:
        """1 minus what the attacks of all cells add with the defence over what they add without it.

        Each is relative to the same run without the attack, so that neither the cost of a defence nor what it removes
        of the sensors' own errors counts. NaN if attacks add nothing without the defence. Runs in which the adversaries
        did not lie to this defence are left out.
        """
        sums = self.paired_sums(cells, lambda each: self.damage(each) - self.damage(alone(each)))
        sums = sums[:, ~np.isnan(sums[0])]

        def removed(rows: Ints) -> float:
            with_defence, without = sums[:, rows].sum(axis=1)
            return 1.0 - float(with_defence / without) if without > 0.0 else math.nan

        return statistics.pooled(removed, sums.shape[1])

    def _published(self) -> Iterator[tuple[Published, list[Row]]]:
        """The published methods that this study played, with ours."""
        played = {name for each in self.trials for name in (each["defence"], each["attack"])}
        for entry in PUBLISHED:
            if entry.method in played:
                chosen = entry.defences or tuple(name for name in self.several("defence") if name != UNDEFENDED)
                pairs = product(entry.quantities, chosen)
                yield entry, [ours for pair in pairs if (ours := self._ours(entry.attacks, *pair)) is not None]

    def _ours(self, among: Sequence[str], quantity: str, defence: str) -> Row | None:
        """One of QUANTITIES under attacks, all if none is named; None: none was played."""
        cells = [each for each in self._of_defence(defence) if lies(each) and (not among or each["attack"] in among)]
        if not cells:
            return None
        attacks = () if quantity == "fn_added_alone" else dict.fromkeys(each["attack"] for each in cells)
        groups, suspending = self._by_trial(cells), self.suspends(defence)
        detects = suspending or not {each["attack"] for each in cells} <= BY_SUSPENSION
        honest = matrix.state_shares(groups).get("honest", {})
        computed: dict[str, Callable[[], Statistic]] = {
            "lies_detected": lambda: matrix.lies_detected(groups) if detects else Statistic(),
            "harm_removed": lambda: self._harm_removed(cells),
            "honest_suspended_time": lambda: honest.get("suspended", Statistic()),
            "median_delay_s": lambda: matrix.median_delay(groups) if suspending else Statistic(),
            "targets_suspended": lambda: _liars_suspended(groups),
            "fn_added_alone": lambda: self.mean(self.added(alone(cells[0]), "fn"), paired=True),
            "fp_added": lambda: self._mean_of(cells, lambda each: self.added(each, "fp")),
            "damage": lambda: self._mean_of(cells, self.damage),
            "ospa_vs_undefended_m": lambda: self._mean_of(
                cells, lambda each: self.values(each, "ospa_m") - self.values(undefended(each), "ospa_m")
            ),
            "cpu_growth": lambda: self._growth(cells),
        }
        value = computed[quantity]()
        return Row({"defence": defence, "attack": ", ".join(attacks)}, value.trials, {quantity: value})

    def _mean_of(self, cells: Sequence[Factors], values: Callable[[Factors], Floats]) -> Statistic:
        """The mean over trials of the mean over cells."""
        return self.mean(_mean_known(np.stack([values(each) for each in cells])), paired=True)

    def _growth(self, cells: Sequence[Factors]) -> Statistic:
        """Processor time relative to the other attacks on the same defence, by as many adversaries of one placement."""
        parts = []
        for each in cells:
            others = [
                self._processor(other)
                for other in self.trials
                if lies(other) and other["attack"] != each["attack"]
                if other.but(attack="", budget=None) == each.but(attack="", budget=None)
            ]
            if others:
                parts.append((self._processor(each), _mean_known(np.stack(others))))
        stacks = [np.stack(part) for part in zip(*parts, strict=True)]
        return ratio(*stacks, scenes=len(self.scenes)) if parts else Statistic()


def ratio(values: Floats, references: Floats, *, scenes: int = 1) -> Statistic:
    """The geometric mean of paired ratios over trials.

    values, references: (trials,) or (cells, trials), positive; NaN where one has none
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithms = np.log(np.atleast_2d(values)) - np.log(np.atleast_2d(references))
    measured = statistics.mean(_mean_known(logarithms), scenes=scenes)
    value, low, high = (math.exp(each) for each in measured[:3])
    return measured._replace(value=value, low=low, high=high)


def _liars_suspended(groups: matrix.Groups) -> Statistic:
    """The share of agents with an observable lie that were suspended, of those that were judged."""
    delays = [[suspended for each in group for _, suspended in each["delays"]] for group in groups]
    return statistics.share([sum(each) for each in delays], [len(each) for each in delays])


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
