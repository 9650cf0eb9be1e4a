"""Every defence against every adversary: what each defence is worth.

Measures of trials are put together in groups: a group has those of one pair of scene and seed, one for a cell, several
for a defence. Groups are the trials of `study.statistics`: runs of the same scene and seed are not independent.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.metrics.trust import AgentTrustSeries, Roc, TrustPanel, auc, partial_auc, roc
from mast_zenoh.show.tables.text_table import ResultTables
from mast_zenoh.study import statistics
from mast_zenoh.study.choices import PREFIX, UNDEFENDED
from mast_zenoh.study.defences.kinds import Factors, Kind
from mast_zenoh.study.defences.matrix_table import DEFENCE_MEASURES, MatrixTable
from mast_zenoh.study.defences.matrix_tables import matrix_tables
from mast_zenoh.study.numbers import ego, own_metrics
from mast_zenoh.study.statistics import Survival, kaplan_meier
from mast_zenoh.study.trial import TrialKey, TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure

#: Panels of trust over time, and agents in a panel.
MAX_PANELS, MAX_AGENTS = 12, 5
#: False alarms per hour below which the partial area under the characteristic is taken.
ALARMS_PER_HOUR = 1.0
#: Liars are below the local majority in a trial if they outnumber the honest viewers of fewer than this share of the
#: lies that an honest agent could notice.
MAJORITY = 0.5
#: Scores of the ego's picture, per frame and in m, by the names of their differences.
SCORES = {"fn{}": "fn", "fp{}": "fp", "ospa{}_m": "ospa_m"}
#: The part `defence` of the metrics of a trial in which nothing lies and nothing is faulty, see `matrix_trial`.
NO_LIES: dict[str, Any] = {
    "first_attack_s": None,
    "lies": {"all": 0, "observable": 0, "detected": 0},
    "agents": {},
    "false": {"identifiable": 0.0, "unidentifiable": 0.0},
    "honest_majority": 1.0,
    "outnumbered": None,
}

#: Measures of trials, by scene and seed.
Groups = Sequence[Sequence[Mapping[str, Any]]]


def is_fault(factors: Mapping[str, Any]) -> bool:
    """Whether agents of a configuration are faulty and nobody lies."""
    return str(factors["attack"]).startswith(PREFIX)


def lies(factors: Mapping[str, Any]) -> bool:
    """Whether a configuration has adversaries."""
    return bool(factors["attack"]) and not is_fault(factors)


def undefended(factors: Factors) -> Factors:
    """The same without a defence."""
    return factors.but(defence=UNDEFENDED)


def alone(factors: Factors) -> Factors:
    """The same defence without an attack."""
    return factors.but(attack="", n_adversaries=0, placement="", budget=None)


class DefenceMatrix(Kind):
    """A row for each cell, and a summary for each defence.

    Its factors are those of `study.defences.matrix_study`.
    """

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

    def __init__(self, factors: Mapping[str, Factors], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        super().__init__(factors, scenes, seeds)
        #: of the first trial of each configuration that has a trace; all of a large study would need much memory
        self._traces: dict[Factors, tuple[TrialKey, Mapping[str, Any]]] = {}

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        from mast_zenoh.study.defences import matrix_trial  # PyArrow is slow to load

        return matrix_trial.evaluate(run, compromised)

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """What the matrix needs of one trial's metrics:

        fn, fp, ospa_m: of the ego's picture, per frame and in m;  own NAME: the user's metrics of it
        fp_identifiable, fp_unidentifiable: false objects inserted;  honest_majority: share of objects with one
        attacked:  whether an adversary changed a message;  observable, detected: numbers of lies
        delays:    (s, whether it was suspended) of each agent with an observable lie, from that lie on
        suspended_before: number of agents that were suspended already at that lie, which have no delay
        suspicion: (greatest score, whether it lied) of each agent that was honest or lied
        seconds:   s by conduct and state;  hours: of the run, 0 without trust;  frames: of the run
        alarms:    suspensions of honest agents;  fault_alarms: of faulty agents that did not lie
        wrongly_suspended: whether an agent that never lied was suspended, faulty or not
        framed:    whether an agent that was honest was suspended after the attack began, and itself never lied
        outnumbered: share of the lies, by object and frame, of which liars have more viewers than honest agents
        doubts:    whether an agent is suspended or undecided
        """
        metrics, key = outcome.metrics, outcome.trial.key
        part, trust = metrics["defence"], metrics.get("integrity", {})
        trace = part.get("trust")
        if trace is not None and (
            factors not in self._traces or self.order[key] < self.order[self._traces[factors][0]]
        ):
            self._traces[factors] = key, trace
        picture = metrics["agents"][ego(metrics)]["picture"]
        watched = [each for each in part["agents"].values() if each["observed_s"] is not None]
        judged = trust.get("agents", {})
        never_lied = [each["suspensions"] for each in judged.values() if not each["lied"]]
        noticeable = [name for name, each in part["agents"].items() if each["first_observable_s"] is not None]
        begins_s = part["first_attack_s"]
        return {
            **{name: _known(picture[name]["mean"]) for name in SCORES.values()},
            **{f"fp_{name}": value for name, value in part["false"].items()},
            **own_metrics(picture),
            "honest_majority": part["honest_majority"],
            "attacked": begins_s is not None,
            "observable": part["lies"]["observable"],
            "detected": part["lies"]["detected"],
            "delays": [(each["observed_s"], each["suspended_after_s"] is not None) for each in watched],
            "suspended_before": len([name for name in noticeable if name in judged]) - len(watched),
            "suspicion": [
                (_known(each["suspicion"]["max"]), each["lied"])
                for each in judged.values()
                if each["lied"] or not each.get("faulty")
            ],
            "seconds": trust.get("seconds", {}),
            "hours": trust.get("hours", 0.0),
            "frames": metrics["frames"],
            "alarms": trust.get("false_alarms", 0),
            "fault_alarms": sum(each["fault_alarms"] for each in judged.values()),
            "wrongly_suspended": any(never_lied),
            "framed": begins_s is not None
            and any(
                suspension["conduct"] == "honest" and suspension["from_s"] >= begins_s
                for suspensions in never_lied
                for suspension in suspensions
            ),
            "outnumbered": _known(part["outnumbered"]),
            "doubts": trace is not None and doubts(trace),
        }

    def suspends(self, defence: str) -> bool:
        """Whether a defence suspended an agent in any run."""
        trials = (each for factors in self._of_defence(defence) for each in self.trials[factors].values())
        return any(states.get("suspended") for each in trials for states in each["seconds"].values())

    def _of_defence(self, defence: str) -> list[Factors]:
        return [factors for factors in self.trials if factors["defence"] == defence]

    def table(self) -> MatrixTable:
        """The rows of all cells, each with the budget that does the most damage."""
        groups: dict[Factors, list[Factors]] = {}
        for factors in self.trials:
            groups.setdefault(factors.but(budget=None), []).append(factors)
        worst = {max(cells, key=self._mean_damage): len(cells) for cells in groups.values()}
        every = self.several("defence")
        defences = [name for name in every if name != UNDEFENDED]
        trials = {name: self._by_trial(self._of_defence(name)) for name in every}
        delays = {name: delay_curve(trials[name]) for name in defences if self.suspends(name)}
        curves = {name: characteristic(self._by_trial(self._of_defence(name), idle=False)) for name in defences}
        panels, unshown = self._panels([*worst])
        return MatrixTable(
            rows=[self._row(factors, budgets) for factors, budgets in worst.items()],
            rocs={name: curve[0] for name, curve in curves.items() if curve is not None},
            delays={name: delay for name, delay in delays.items() if delay is not None},
            summaries=[
                self._summary(name, [factors for factors in worst if factors["defence"] == name], curves[name])
                for name in defences
            ],
            size=self.size,
            states=[
                Row({"defence": name, "conduct": conduct}, 0, shares)
                for name, each in trials.items()
                for conduct, shares in state_shares(each).items()
            ],
            panels=panels,
            unshown=unshown,
            not_suspending=[
                name
                for name in defences
                if not self.suspends(name) and any(each["hours"] for group in trials[name] for each in group)
            ],
        )

    def tables(self, table: MatrixTable) -> ResultTables:
        return matrix_tables(table)

    def figures(self, table: MatrixTable) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.study.defences.matrix_figures import figures_of_defences  # drawing libraries are slow to load

        return figures_of_defences(table)

    def _mean_damage(self, factors: Factors) -> float:
        damage = self.damage(factors)
        known = damage[~np.isnan(damage)]
        return float(known.mean()) if known.size else -math.inf

    def added(self, factors: Factors, name: str) -> Floats:
        """(trials,) a score minus that without attack and without defence, of the same scene and seed."""
        return self.values(factors, name) - self.values(undefended(alone(factors)), name)

    def damage(self, factors: Factors) -> Floats:
        """(trials,) missed and false objects per frame, minus those without attack and without defence."""
        return self.added(factors, "fn") + self.added(factors, "fp")

    def _row(self, factors: Factors, budgets: int) -> Row:
        values = {name.format("_added"): self.added(factors, score) for name, score in SCORES.items()}
        values["damage"] = self.damage(factors)
        for name, score in SCORES.items():
            difference = self.values(factors, score) - self.values(undefended(factors), score)
            values[name.format("_vs_undefended")] = difference
        numbers = {name: self.mean(each, paired=True) for name, each in values.items()}
        for name in ("fp_identifiable", "fp_unidentifiable"):
            numbers[name] = self.mean(self.values(factors, name), (0.0, math.inf))
        majority = self.values(factors, "honest_majority")
        # Where nobody lies because agents are faulty, there is no bound.
        numbers["honest_majority"] = Statistic() if is_fault(factors) else self.mean(majority, (0.0, 1.0))
        groups = self._by_trial([factors])
        numbers |= {
            "identifiable_removed": self._removed([factors]),
            "lies_detected": lies_detected(groups),
            "median_delay_s": median_delay(groups) if self.suspends(factors["defence"]) else Statistic(),
            "honest_suspended_per_hour": alarms_per_hour(groups),
            "faulty_suspended_per_hour": alarms_per_hour(groups, "fault_alarms"),
            "attacked": attacked_share(groups) if lies(factors) else Statistic(),
            **shares_of_runs(groups),
        }
        delay = delay_curve(groups)
        before = sum(each["suspended_before"] for group in groups for each in group)
        watched = (delay.watched, delay.detections) if delay else (0, 0)
        counts = dict(zip(("liars_watched", "liars_suspended", "suspended_before"), (*watched, before), strict=True))
        seconds: Counter[str] = Counter()
        for each in self.trials[factors].values():
            for conduct, states in each["seconds"].items():
                seconds.update({f"seconds {conduct} {state}": seconds_s for state, seconds_s in states.items()})
        numbers |= {name: Statistic(float(each), trials=len(groups)) for name, each in (counts | dict(seconds)).items()}
        own = {name: self.mean(self.values(factors, name)) for name in self.own}
        own |= {f"{name} difference": self.mean(self.added(factors, name), paired=True) for name in self.own}
        of = {name: factors[name] for name in ("defence", "attack", "n_adversaries", "placement", "budget")}
        names = (*DEFENCE_MEASURES, *seconds)
        return Row(of | {"budgets": budgets}, len(groups), {name: numbers[name] for name in names} | own)

    def _summary(self, defence: str, cells: Sequence[Factors], curve: tuple[Roc, dict[str, Statistic]] | None) -> Row:
        """cells: of the rows of this defence;  curve: its `characteristic`"""
        without, attacked = alone(cells[0]), [factors for factors in cells if lies(factors)]
        lying, faulty = self._by_trial(attacked), self._by_trial(filter(is_fault, cells))
        quiet = self._by_trial([without] if without in self.trials else [])
        alarms = alarms_per_hour(quiet)
        frames = sum(each["frames"] for group in quiet for each in group if each["hours"])
        numbers = {
            "lies_detected": lies_detected(lying),
            "median_delay_s": median_delay(lying) if self.suspends(defence) else Statistic(),
            "identifiable_removed": self._removed(attacked),
            "alarms_per_hour": alarms,
            "frames": Statistic(float(frames), trials=alarms.trials),
            "fn_added": self.mean(self.added(without, "fn"), paired=True),
            "fp_added": self.mean(self.added(without, "fp"), paired=True),
            "faults_suspended": shares_of_runs(faulty)["wrongly_suspended"],
            "framed_by_minority": shares_of_runs(lying)["framed_by_minority"],
            **(curve[1] if curve else {}),
        }
        return Row({"defence": defence}, len(lying), numbers)

    def _removed(self, cells: Sequence[Factors]) -> Statistic:
        """Share of identifiable inserted objects of the undefended runs that are not in the defended ones.

        cells: added up by scene and seed, without runs in which the adversaries did not lie to this defence; a cell
        without a defence has none to remove
        """
        attacked = [factors for factors in cells if lies(factors) and factors["defence"] != UNDEFENDED]
        if not attacked:
            return Statistic()
        return statistics.one_minus(
            statistics.share(*self.paired_sums(attacked, lambda each: self.values(each, "fp_identifiable")))
        )

    def paired_sums(self, cells: Sequence[Factors], values: Callable[[Factors], Floats]) -> Floats:
        """(2, trials) values with the defence and without it, added up over cells; NaN: no cell has both.

        Without runs in which the adversaries did not lie to this defence.
        """
        pairs = np.array(
            [
                np.where(
                    self.values(factors, "attacked") == 1.0, [values(factors), values(undefended(factors))], np.nan
                )
                for factors in cells
            ]
        )
        pairs = np.where(np.isnan(pairs).any(axis=1, keepdims=True), np.nan, pairs)
        return np.where(np.isnan(pairs).all(axis=(0, 1)), np.nan, np.nansum(pairs, axis=0))

    def _by_trial(self, cells: Iterable[Factors], *, idle: bool = True) -> list[list[dict[str, Any]]]:
        """The measures of cells, grouped by scene and seed; idle: also those whose adversaries never lied."""
        groups: dict[TrialKey, list[dict[str, Any]]] = {}
        for factors in cells:
            for key, each in self.trials[factors].items():
                if idle or each["attacked"] or not lies(factors):
                    groups.setdefault(key, []).append(each)
        return [groups[key] for key in sorted(groups, key=self.order.__getitem__)]

    def _panels(self, cells: Sequence[Factors]) -> tuple[list[TrustPanel], int]:
        """The first trial of each defence that doubts agents, under each adversary; and the number of other such pairs.

        cells: of the rows
        """
        doubting = {
            factors["defence"]
            for factors, trials in self.trials.items()
            if any(each["doubts"] for each in trials.values())
        }
        first: dict[tuple[str, str], Factors] = {}
        for factors in cells:
            if factors["attack"] and factors["defence"] in doubting and factors in self._traces:
                first.setdefault((factors["attack"], factors["defence"]), factors)
        attacks = list(dict.fromkeys(factors["attack"] for factors in cells))
        pairs = sorted(first, key=lambda pair: attacks.index(pair[0]))  # the defences of one adversary side by side
        shown = [first[pair] for pair in pairs[:MAX_PANELS]]
        title = "{defence} against {attack} ({n_adversaries}, {placement})"
        return [panel(self._traces[each][1], title.format_map(each)) for each in shown], len(pairs) - len(shown)


def _known(value: float | None) -> float:
    return math.nan if value is None else float(value)


# -- measures of groups ------------------------------------------------------------------------------------------------


def lies_detected(groups: Groups) -> Statistic:
    """The share of observable lies that were detected."""
    return statistics.share(*(_sums(groups, name) for name in ("detected", "observable")))


def _sums(groups: Groups, name: str) -> list[float]:
    return [sum(each[name] for each in group) for group in groups]


def median_delay(groups: Groups) -> Statistic:
    """The median delay; its upper bound is infinite if it is not known that half are detected."""
    delays = [each for each in _pairs(groups, "delays") if len(each)]

    def median(rows: Ints) -> float:
        drawn = np.concatenate([delays[row] for row in rows.tolist()])
        value = kaplan_meier(drawn[:, 0], drawn[:, 1]).median_s
        return math.inf if math.isnan(value) else value

    measured = statistics.pooled(median, len(delays))
    return measured._replace(value=math.nan) if math.isinf(measured.value) else measured


def delay_curve(groups: Groups) -> Survival | None:
    """The share of liars not suspended yet; None: nobody lied, or nobody was judged."""
    delays = np.concatenate([np.zeros((0, 2)), *_pairs(groups, "delays")])
    return kaplan_meier(delays[:, 0], delays[:, 1]) if len(delays) else None


def alarms_per_hour(groups: Groups, name: str = "alarms") -> Statistic:
    """Suspensions of honest agents, or of faulty ones (`fault_alarms`)."""
    judged = [each for group in groups for each in group if each["hours"]]
    return statistics.rate(sum(each[name] for each in judged), sum(each["hours"] for each in judged), len(judged))


def attacked_share(groups: Groups) -> Statistic:
    """The share of runs in which adversaries lied, which some never do."""
    return statistics.share_of_runs([[each["attacked"] for each in group] for group in groups])


def shares_of_runs(groups: Groups) -> dict[str, Statistic]:
    """The share of runs in which something happened, of those in which it can happen: with lies or without."""

    def share(happened: str, counts: Callable[[Mapping[str, Any]], bool]) -> Statistic:
        return statistics.share_of_runs(
            [[each[happened] > 0 for each in group if each["hours"] and counts(each)] for group in groups]
        )

    return {
        "wrongly_suspended": share("wrongly_suspended", lambda each: not each["attacked"]),
        "honest_suspended": share("alarms", lambda each: True),
        "framed": share("framed", lambda each: each["attacked"]),
        "framed_by_minority": share("framed", lambda each: each["outnumbered"] < MAJORITY),
        "framed_by_majority": share("framed", lambda each: each["outnumbered"] >= MAJORITY),
    }


def state_shares(groups: Groups) -> dict[str, dict[str, Statistic]]:
    """By conduct and state of trust, the share of the time with this conduct."""
    shares = {}
    for conduct in dict.fromkeys(name for group in groups for each in group for name in each["seconds"]):
        seconds = [[each["seconds"][conduct] for each in group if conduct in each["seconds"]] for group in groups]
        states = dict.fromkeys(state for group in seconds for each in group for state in each)
        sums = {state: np.array([sum(each.get(state, 0.0) for each in group) for group in seconds]) for state in states}
        whole = np.sum(list(sums.values()), axis=0)
        if whole.any():
            shares[conduct] = {state: statistics.share(part, whole) for state, part in sums.items()}
    return shares


def characteristic(groups: Groups) -> tuple[Roc, dict[str, Statistic]] | None:
    """The characteristic of one score for each agent and run; None if nobody lied, or scores are equal or unknown.

    With auc, partial_auc, which is unknown for less than an hour, and hours of all runs together.
    """
    judged = [group for group in groups if any(each["hours"] for each in group)]
    parts, hours = _pairs(judged, "suspicion"), np.array(_sums(judged, "hours"))
    pairs = np.concatenate([np.zeros((0, 2)), *parts])
    if not pairs[:, 1].any() or len(set(pairs[~np.isnan(pairs[:, 0]), 0].tolist())) < 2:
        return None

    def area(rows: Ints) -> float:
        drawn = np.concatenate([parts[row] for row in rows.tolist()])
        return auc(drawn[:, 0], drawn[:, 1])

    def partial(rows: Ints) -> float:
        drawn = np.concatenate([parts[row] for row in rows.tolist()])
        return partial_auc(drawn[:, 0], drawn[:, 1], float(hours[rows].sum()), ALARMS_PER_HOUR)

    whole = statistics.pooled(area, len(parts))
    enough = hours.sum() * ALARMS_PER_HOUR >= 1.0  # a single alarm in less is more than that
    below = statistics.pooled(partial, len(parts)) if enough else Statistic()
    numbers = {"auc": whole, "partial_auc": below, "hours": Statistic(float(hours.sum()), trials=len(parts))}
    return roc(pairs[:, 0], pairs[:, 1]), numbers


def _pairs(groups: Groups, name: str) -> list[Floats]:
    """(n, 2) delays s and whether each ended with a suspension, or suspicions, of each group."""
    return [np.array([each for trial in group for each in trial[name]], np.float64).reshape(-1, 2) for group in groups]


# -- trust over time ---------------------------------------------------------------------------------------------------


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
        np.array([_known(value) for value in content["log_odds"]], np.float64),
        {state: [(start, stop) for start, stop in spans] for state, spans in content["states"].items()},
        [(start, stop) for start, stop in content["lies"]],
        [(kind, start, stop) for kind, start, stop in content["faults"]],
    )
