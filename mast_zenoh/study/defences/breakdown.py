"""With how many liars a defence breaks, next to the share at which honest viewers lose their majority."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.metrics import Table
from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.number_text import number, percent
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.choices import honest_majority
from mast_zenoh.study.defences.kinds import Factors, Kind
from mast_zenoh.study.numbers import ego, scored_frames
from mast_zenoh.study.statistics import pooled, share_of_trials
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure

#: Half of the trials, and half of the objects.
HALF = 0.5
_ROUNDING, _ROUNDING_S = 1e-12, 1e-6
#: Measures of trials that happen or not, and means.
_SHARES, _MEANS = ("broken", "worse", "honest_first"), ("honest_suspended", "honest_majority")
#: A row for each number of liars, and one for each breakdown point.
Tables = tuple[Sequence[Row], Sequence[Row]]


def suspended_before_liars(
    honest_s: Mapping[str, float], liar_s: float, without_liars_s: Mapping[str, float] | None
) -> bool:
    """Whether an honest agent is suspended before any compromised one.

    honest_s: s of the first suspension of each honest agent that was suspended;  liar_s: of a compromised one
    without_liars_s: the first, of the same scene and seed without liars. An agent that is suspended there by the same
    time is a false alarm that no liar caused, and does not count; None: unknown, so all count
    """
    alarms_s = without_liars_s or {}
    return any(
        time_s < liar_s and alarms_s.get(name, math.inf) > time_s + _ROUNDING_S for name, time_s in honest_s.items()
    )


def measures_of_breaking(outcome: TrialOutcome, attack_start_s: float) -> dict[str, Any]:
    """Of a trial with the part `defence` of `Breakdown.evaluate`:

    worse:    whether the picture has more missed and false objects than the ego alone, in all frames from the start
              of the attack on
    honest_s: s of the first suspension of each honest agent that was suspended
    liar_s:   s of the first suspension of a compromised agent; infinite: none
    honest_majority: share of the objects that more honest agents see than compromised ones
    """
    metrics, per_frame = outcome.metrics, outcome.per_frame
    part, agents = metrics["defence"], metrics.get("integrity", {}).get("agents", {})
    suspended = {
        name: min(each["from_s"] for each in agent["suspensions"])
        for name, agent in agents.items()
        if agent["suspensions"]
    }
    compromised = set(part["compromised"])
    first, last = scored_frames(metrics)
    start = int(np.searchsorted(part["frames_s"], attack_start_s - _ROUNDING_S))
    frames = range(max(first, start), last + 1)
    agent = ego(metrics)
    return {
        "worse": _errors(per_frame, agent, "picture", frames) > _errors(per_frame, agent, "local", frames),
        "honest_s": {name: time_s for name, time_s in suspended.items() if name not in compromised},
        "liar_s": min((suspended[name] for name in compromised & suspended.keys()), default=math.inf),
        "honest_majority": float(part["honest_majority"]),
    }


def honest_first(kind: Kind, factors: Factors, without_liars: Factors) -> Floats:
    """(trials,) whether an honest agent is suspended before any compromised one; NaN: the trial failed.

    kind: with the measures of `measures_of_breaking`;  without_liars: factors of what is the same without them
    """
    alarms_s = {key: each["honest_s"] for key, each in kind.trials.get(without_liars, {}).items()}
    first = np.full(len(kind.order), np.nan)
    for key, each in kind.trials[factors].items():
        first[kind.order[key]] = suspended_before_liars(each["honest_s"], each["liar_s"], alarms_s.get(key))
    return first


class Breakdown(Kind):
    """Broken trials and breakdown points.

    Its factors: attack, "" without liars; agents, the ego included; liars; attack_start_s, s of scene time
    """

    name = "breakdown"
    drawn = ("breakdown",)

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        honest_majority: share of the objects that more honest agents see than compromised ones; 1.0 without adversaries
        compromised: names of the agents with an adversary
        frames_s: s of scene time of each frame
        """
        recording = Recording.load(run.path / RECORDING)
        times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
        lying = [name in compromised for name in recording.agent_names]
        return {
            "honest_majority": honest_majority(recording.points, lying),
            "compromised": sorted(compromised),
            "frames_s": np.round(times_s, 9).tolist(),
        }

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """Those of `measures_of_breaking`, and the share of the honest agents that are suspended at any time."""
        result = measures_of_breaking(outcome, factors["attack_start_s"])
        honest = factors["agents"] - len(outcome.metrics["defence"]["compromised"])
        return result | {"honest_suspended": len(result["honest_s"]) / honest}

    def table(self) -> Tables:
        """The rows of all cells, with shares of trials and means over them:

        broken:    `worse`, the picture is worse than the ego alone, or `honest_first`, an honest agent is suspended
                   before any liar, and not without liars
        honest_suspended: share of the honest agents that are suspended at any time
        honest_majority:  share of objects that more honest agents see than liars

        And those of breakdown points, shares of liars that are infinite if they are not reached:

        breakdown_point: smallest at which half of the trials are broken
        breakdown_bound: at which half of the objects have no honest majority;  breakdown_difference: point minus bound
        """
        rows, points = [], []
        for attack, agents in product(filter(None, self.several("attack")), self.several("agents")):
            cells = [each for each in self.trials if each["agents"] == agents and each["attack"] in ("", attack)]
            values = {each["liars"]: self._of_trials(each) for each in sorted(cells, key=lambda each: each["liars"])}
            of = {"attack": attack, "agents": agents}
            rows += [_row(of | {"liars": liars}, each) for liars, each in values.items()]
            shares = {liars / agents: each for liars, each in values.items() if not np.isnan(each["worse"]).all()}
            if shares:
                points.append(_point(of, shares))
        return rows, points

    def _of_trials(self, factors: Factors) -> dict[str, Floats]:
        """By measure, (trials,) its value in each planned trial; NaN: it failed."""
        values = {name: self.values(factors, name) for name in ("worse", *_MEANS)}
        first = honest_first(self, factors, factors.but(attack="", liars=0))
        return values | {"honest_first": first, "broken": np.fmax(values["worse"], first)}

    def tables(self, table: Tables) -> ResultTables:
        """The CSV has a row for each attack, numbers of agents and liars, and measure.

        Then those of points, in which the column `liars` is empty; shares from 0 to 1.
        """
        rows, points = table
        of_points = table_of_rows("Breakdown points", paragraph("breakdown_points"), points, _points_columns(rows))
        short = table_of_rows("Broken trials (%)", "", rows, _BRIEF, {"attack": "attack"})
        return ResultTables(
            "Breakdown point",
            f"{self.size}. {paragraph('breakdown_about')}",
            self.size,
            [of_points, table_of_rows("Broken trials", _ABOUT_ROWS, rows, _COLUMNS)],
            numbers_of_rows([*rows, *points]),
            [of_points._replace(about=""), short],
        )

    def figures(self, table: Tables) -> Mapping[str, RenderedFigure]:
        rows, points = table
        if not rows:
            return {}
        return {self.name: _figure(rows, _in_words(rows, points), self.size)}


def _row(of: dict[str, Any], values: Mapping[str, Floats]) -> Row:
    known = {name: each[~np.isnan(each)] for name, each in values.items()}
    trials = len(known["worse"])
    numbers = {name: share_of_trials(known[name].sum(), trials) for name in _SHARES}
    return Row(of, trials, numbers | {name: Statistic(_mean(known[name]), trials=trials) for name in _MEANS})


def _point(of: dict[str, Any], shares: Mapping[float, Mapping[str, Floats]]) -> Row:
    """The breakdown point of one attack, by share of liars; units are scenes with seeds, which all shares have."""
    measures = np.array([[each["broken"], 1.0 - each["honest_majority"]] for each in shares.values()])
    measures = measures[:, :, ~np.isnan(measures).all(axis=(0, 1))]

    def broken(trials: Ints) -> float:
        return mean_crossing([*shares], measures[:, 0, trials])

    def bound(trials: Ints) -> float:
        return mean_crossing([*shares], measures[:, 1, trials])

    def difference(trials: Ints) -> float:
        of_bound = bound(trials)
        return math.nan if math.isinf(of_bound) else broken(trials) - of_bound

    count = measures.shape[2]
    numbers = {"point": broken, "bound": bound, "difference": difference}
    return Row(of, count, {f"breakdown_{name}": pooled(each, count) for name, each in numbers.items()})


def _mean(values: Floats) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _errors(per_frame: Table, agent: str, estimator: str, frames: range) -> float:
    """Missed and false objects of an estimate in some frames."""
    rows = (per_frame["agent"] == agent) & (per_frame["estimator"] == estimator)
    rows &= (per_frame["frame"] >= frames.start) & (per_frame["frame"] < frames.stop)
    return float(per_frame["fn"][rows].sum() + per_frame["fp"][rows].sum())


def crossing(x: ArrayLike, y: ArrayLike) -> float:
    """The smallest x at which y reaches one half, by linear interpolation; infinite if it never does.

    x: (n,) ascending;  y: (n,)

    A breakdown point is the smallest share that breaks a defence, so a later fall of y changes nothing. With few trials
    a chance peak makes it smaller, which is the safe side. If y is one half or more from the first x on, that is the
    answer. Raises ValueError for no points.
    """
    at, share = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if not len(at):
        raise ValueError("x: found no points, expected one or more")
    reached = share >= HALF - _ROUNDING
    if not reached.any():
        return math.inf
    after = int(reached.argmax())
    if after == 0:
        return float(at[0])
    return float(np.interp(HALF, share[after - 1 : after + 1], at[after - 1 : after + 1]))


def mean_crossing(x: Sequence[float], values: Floats) -> float:
    """`crossing` of the means over trials; NaN without any. values: (n, trials), NaN where a trial has none."""
    known = [(at, line[~np.isnan(line)]) for at, line in zip(x, values, strict=True)]
    points = [(at, _mean(line)) for at, line in known if len(line)]
    return crossing(*zip(*points, strict=True)) if points else math.nan


# -- what readers see --------------------------------------------------------------------------------------------------

_ABOUT_ROWS = "With the 95 % interval of Clopper and Pearson."
_COLUMNS = {
    "liars (%)": lambda row: f"{100.0 * _share(row):.0f}",
    "trials": lambda row: str(row.trials),
    "broken (%)": shown("broken", percent),
    "picture worse than the ego alone (%)": shown("worse", percent),
    "honest agent suspended first (%)": shown("honest_first", percent),
    "honest agents suspended (%)": shown("honest_suspended", percent),
    "objects with an honest majority (%)": shown("honest_majority", percent),
}


def _whole(each: Statistic) -> str:
    return number(100.0 * each.value, 0)


#: Of the terminal's table, in per cent.
_BRIEF = {
    "liars": lambda row: "{liars} of {agents}".format_map(row.of),
    "broken": shown("broken", percent),
    "worse": shown("worse", _whole),
    "honest first": shown("honest_first", _whole),
    "honest suspended": shown("honest_suspended", _whole),
    "majority": shown("honest_majority", _whole),
}


def _share(row: Row) -> float:
    """Share of liars among all agents."""
    return float(row.of["liars"] / row.of["agents"])


def _most(rows: Sequence[Row], point: Row) -> float:
    """The greatest share of liars that was tried for a point."""
    return max(_share(row) for row in rows if row.trials and point.of.items() <= row.of.items())


def _points_columns(rows: Sequence[Row]) -> dict[str, Callable[[Row], str]]:
    """rows: of all numbers of liars, beyond which points may be"""

    def reached(measure: str) -> Callable[[Row], str]:
        return lambda point: percent(point[measure], beyond=f"> {100.0 * _most(rows, point):.0f}")

    def difference(point: Row) -> str:
        beyond = 100.0 * (_most(rows, point) - point["breakdown_bound"].value)
        return percent(point["breakdown_difference"], beyond=f"> {number(beyond, 0)}")

    return {
        "breakdown point (%)": reached("breakdown_point"),
        "bound (%)": reached("breakdown_bound"),
        "difference (percentage points)": difference,
    }


def _in_words(rows: Sequence[Row], points: Sequence[Row]) -> str:
    reached = [(point, _most(rows, point)) for point in points]
    return paragraph("breakdown_points_reached", points=reached)


def _figure(rows: Sequence[Row], words: str, size: str) -> RenderedFigure:
    """A panel for each attack, and a curve for each number of agents next to its bound."""
    from matplotlib.lines import Line2D  # drawing libraries are slow to load

    from mast_zenoh.show.figures.drawing import render
    from mast_zenoh.show.figures.facets import Axis, facet, legend_above
    from mast_zenoh.show.palette import LOCAL, RUN_COLOURS

    shown = [
        replace(row, of=row.of | {"share": 100.0 * _share(row), "curve": f"{row.of['agents']} agents"})
        for row in rows
        if row.trials
    ]
    axis, label = Axis("broken", "broken trials (%)", 100.0), "liars (% of all agents)"
    figure = facet(shown, "share", [axis], "curve", by="attack", label=label, size=(4.6, 4.3))
    style: dict[str, Any] = dict(linestyle=(0, (4, 2)), linewidth=1.3)
    for axes, attack in zip(figure.axes, dict.fromkeys(row.of["attack"] for row in shown), strict=True):
        axes.axhline(50.0, color=LOCAL, linewidth=0.8)
        axes.set_ylim(-3.0, 103.0)
        for index, curve in enumerate(dict.fromkeys(row.of["curve"] for row in shown)):
            of_curve = [row for row in shown if (row.of["attack"], row.of["curve"]) == (attack, curve)]
            without = [100.0 * (1.0 - row["honest_majority"].value) for row in of_curve]
            colour = RUN_COLOURS[index % len(RUN_COLOURS)]
            axes.plot([row.of["share"] for row in of_curve], without, color=colour, **style)
    bound = Line2D([], [], color=LOCAL, label="objects without an honest majority", **style)
    legend_above(figure, bound)
    caption = paragraph("figure_breakdown", size=size)
    return render("breakdown", figure, f"Broken trials over the share of liars. {words}", caption, printed=True)
