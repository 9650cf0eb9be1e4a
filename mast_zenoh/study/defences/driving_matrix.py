"""What attacks do to a car that is driven, and what defences spare it.

Every trial under attack is paired with its twin, the same scene, seed and defence without the attack. Every trial with
a defence is paired with the same scene, seed and attack without one. A twin shares all random draws, so a difference is
due to the attack, or to the defence, and to what follows from it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mast_zenoh.errors import plural
from mast_zenoh.metrics.estimates import MISSION
from mast_zenoh.metrics.study_results import NEGLIGIBLE, Row, Statistic, clearest
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.number_text import number, over_trials
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study import statistics
from mast_zenoh.study.defences.kinds import Factors, Kind
from mast_zenoh.study.numbers import own_metrics
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.show.figures.drawing import RenderedFigure

#: Effects that change no message.
_UNCHANGED = frozenset({"unsettled"})


class DrivingMeasure(NamedTuple):
    """A number of one trial; heading: of its column;  better: -1: less is better, 1: more is"""

    heading: str
    better: int


#: The measures by their key in `driven` of metrics.json; of lists, their length counts.
DRIVING_MEASURES = {
    "collisions": DrivingMeasure("collisions", -1),
    "needless_brakes": DrivingMeasure("needless brakes", -1),
    "missed_brakes": DrivingMeasure("missed brakes", -1),
    "hard_brakes": DrivingMeasure("hard brakes", -1),
    "progress_m": DrivingMeasure("way driven (m)", 1),
}


@dataclass(frozen=True, slots=True, eq=False)
class DrivingRow(Row):
    """Trials of one attack (`attack`, `wire`; empty: none) and one defence (`defence`; empty: none).

    Its numbers, of DRIVING_MEASURES and of the user's metrics of what the car's agent acts on:
    mean NAME:   of a trial
    added NAME:  difference from the twin: the same seed, scene and defence without the attack
    spared NAME: difference from the same seed, scene and attack without a defence
    harmed, changed: numbers of pairs with the twin in which any measure is worse, and of pairs with no defence in which
                 any differs (value), of all pairs (trials), and the exact interval of the chance, of seeds or scenes
    flaws:   by what did not take part as the scenario says, in how many trials
    flawed:  whether it, or what it is compared with, has any
    """

    flaws: Mapping[str, int]
    flawed: bool

    @property
    def title(self) -> str:
        """The attack and where it is."""
        return f"{self.of['attack']} on {self.of['wire']}" if self.of["attack"] else "no attack"

    def of_kind(self, kind: str) -> dict[str, Statistic]:
        """The numbers of a kind: mean, added or spared, by name; of DRIVING_MEASURES."""
        return {name: self.numbers[f"{kind} {name}"] for name in DRIVING_MEASURES if f"{kind} {name}" in self.numbers}

    def harm(self, kind: str, name: str) -> float:
        """The mean of a number, positive where it is worse for the car."""
        return -self[f"{kind} {name}"].value * DRIVING_MEASURES[name].better

    def shown(self, kind: str, sign: int) -> dict[str, Statistic]:
        """The measures that are shown to differ, for the better (1) or for the worse (-1)."""
        numbers = self.of_kind(kind).items()
        return {name: each for name, each in numbers if each.seen and sign * self.harm(kind, name) < 0.0}

    @property
    def perhaps(self) -> dict[str, Statistic]:
        """The measures that an attack makes worse in the mean, although too few trials show it."""
        numbers = self.of_kind("added").items()
        return {name: each for name, each in numbers if not each.seen and self.harm("added", name) > 0.0}


class DrivingMatrix(Kind):
    """Consequences by attack and defence.

    Its factors: attack, "": none; wire, where it is; defence, "": none; car, whose consequences count
    """

    name = "driving"
    drawn = ("driving",)

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """DRIVING_MEASURES, the user's metrics (`own NAME`), and `flaws`: what did not take part."""
        metrics, car = outcome.metrics, factors["car"]
        driven = metrics["driven"][car]
        values = {name: driven[name] for name in DRIVING_MEASURES}
        counted = {name: float(len(each) if isinstance(each, list) else each) for name, each in values.items()}
        obeyed = driven["obeyed_commands"]
        flaws = ["no command of the driver was accepted"] * (not obeyed)
        flaws += ["the car had no new command in some frames"] * bool(obeyed and driven["uncommanded_frames"])
        flaws += ["the driver had no estimate in some frames"] * (driven["blind_frames"] > 0)
        flaws += [
            f"{name} changed no message"
            for name, interposer in metrics["interposers"].items()
            if interposer["role"] == "adversary" and not set(interposer["effects"]) - _UNCHANGED
        ]
        return counted | own_metrics(metrics.get("agents", {}).get(car, {}).get(MISSION, {})) | {"flaws": flaws}

    def table(self) -> list[DrivingRow]:
        """A row for each attack and defence."""
        return [self._row(factors) for factors in self.trials]

    def _row(self, factors: Factors) -> DrivingRow:
        trials = self.trials[factors].values()
        twin = factors.but(attack="", wire="") if factors["attack"] else None
        undefended = factors.but(defence="") if factors["defence"] else None
        numbers: dict[str, Statistic] = {}
        for name in (*DRIVING_MEASURES, *self.own):
            values, short = self.values(factors, name), name.removeprefix("own ")
            numbers[f"mean {short}"] = self.mean(values, (-math.inf if name in self.own else 0.0, math.inf))
            for kind, other in (("added", twin), ("spared", None if name in self.own else undefended)):
                if other is not None:
                    numbers[f"{kind} {short}"] = self.mean(values - self.values(other, name), paired=True)
        for name, each in numbers.items():
            interval = "" if math.isnan(each.low) else each.interval
            numbers[name] = each._replace(left_out=len(trials) - each.trials, interval=interval)
        numbers["harmed"] = self._affected(factors, twin, -1)
        numbers["changed"] = self._affected(factors, undefended, 0)
        compared = [self.trials.get(other, {}) for other in (factors, twin, undefended) if other]
        return DrivingRow(
            {name: factors[name] for name in ("attack", "wire", "defence")},
            len(trials),
            numbers,
            Counter(flaw for each in trials for flaw in each["flaws"]),
            any(each["flaws"] for by_key in compared for each in by_key.values()),
        )

    def _affected(self, factors: Factors, other: Factors | None, sign: int) -> Statistic:
        """In how many pairs any measure differs; sign: -1: for the worse alone."""
        if other is None:
            return Statistic(0.0)
        pairs = {name: self.values(factors, name) - self.values(other, name) for name in DRIVING_MEASURES}
        differs = [
            (sign * DRIVING_MEASURES[name].better * each if sign else np.abs(each)) > NEGLIGIBLE
            for name, each in pairs.items()
        ]
        happened, known = np.any(differs, axis=0), ~np.isnan(pairs["collisions"])
        units = [int(statistics.units(each, len(self.scenes)).any(axis=0).sum()) for each in (happened, known)]
        return statistics.share_of_trials(*units)._replace(value=float(happened.sum()), trials=int(known.sum()))

    def tables(self, table: Sequence[DrivingRow]) -> ResultTables:
        """The CSV has a row for each attack, defence, kind of number and measure."""
        return driving_tables(table, self.size)

    def figures(self, table: Sequence[DrivingRow]) -> Mapping[str, RenderedFigure]:
        """A panel for each measure, with a line for each attack, and on it a point for each defence."""
        from mast_zenoh.show.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.show.figures.facets import Axis, facet

        rows = [
            Row({"attack": row.title, "defence": row.of["defence"] or "no defence"}, row.trials, row.numbers)
            for row in table
            if row.of["attack"] and row.trials
        ]
        axes = [Axis(f"added {name}", f"added {each.heading}") for name, each in DRIVING_MEASURES.items()]
        height = 1.3 + 0.46 * max(1, len({row.of["attack"] for row in rows}))
        figure = facet(rows, "attack", axes, "defence", size=(2.2, height))
        caption = paragraph("figure_driving", size=self.size)
        return {self.name: render(self.name, figure, " ".join(conclusion(table)), caption, printed=True)}


# -- what readers see --------------------------------------------------------------------------------------------------

_NONE = "none"
#: What a headline names if no effect is clear, the worst first.
_HEADLINE = ("collisions", "needless_brakes", "progress_m")
_NO_HARM = "No attack adds collisions or needless brakes, or shortens the way"
_ZEROS = "(0 in N % [a, b]): the share of pairs without a difference, and its exact 95 % interval."
#: Tables by kind of number, with their titles.
_KINDS = {
    "mean": ("What the car did", ""),
    "added": ("What the attack adds to what the car did", f"Differences from the twin. {_ZEROS}"),
    "spared": ("What the defence changes of what the car did", f"Differences from no defence. {_ZEROS}"),
}


def driving_tables(table: Sequence[DrivingRow], size: str) -> ResultTables:
    """The tables of the study."""
    named = [
        replace(
            row, of={"attack": row.of["attack"] or _NONE, "on": row.of["wire"], "defence": row.of["defence"] or _NONE}
        )
        for row in table
    ]
    own = [name.removeprefix("mean ") for name in (table[0].numbers if table else ()) if name.startswith("mean ")]
    own = [name for name in own if name not in DRIVING_MEASURES]
    trials: dict[str, Callable[[Row], str]] = {"trials": lambda row: str(row.trials)}
    tables = [
        table_of_rows(
            *(title, about, rows),
            trials | {each.heading: shown(f"{kind} {name}", over_trials) for name, each in DRIVING_MEASURES.items()},
            texts=3,
        )
        for kind, (title, about) in _KINDS.items()
        if (rows := [row for row in named if row.of_kind(kind)])
    ]
    if own:
        columns = {
            f"{name}{end}": shown(f"{kind} {name}", over_trials)
            for name in own
            for kind, end in (("mean", ""), ("added", ", added by the attack"))
        }
        tables.append(
            table_of_rows("Your metrics", "Of what the car's agent acts on.", named, trials | columns, texts=3)
        )
    brief: Mapping[str, Callable[[Row], str]] = {
        each.heading: shown(f"mean {name}", lambda mean: number(mean.value)) for name, each in DRIVING_MEASURES.items()
    }
    titled = [Row({"": f"{row.title}, {row.of['defence'] or _NONE}"}, row.trials, row.numbers) for row in table]
    sentences = conclusion(table)
    of_means = "Driving under attack, means of a trial"
    return ResultTables(
        "Driving under attack",
        " ".join([f"{size}.", *sentences, paragraph("driving_about")]),
        size,
        tables,
        numbers_of_rows(named),
        [table_of_rows(of_means, " ".join(sentences), titled, brief, {"attack, defence": ""})],
        headline=headline(table),
        reading=sentences,
    )


def headline(table: Sequence[DrivingRow]) -> str:
    """The clearest harm by an attack; else the worst that one adds; without a full stop.

    Of attacks without a defence, if any was run. Without a harm, what did not take part comes first.
    """
    rows = [row for row in _first_rows(table) if row["harmed"].trials]
    effects = {(index, name): each for index, row in enumerate(rows) for name, each in row.of_kind("added").items()}
    clear = [(rows[index], name) for index, name in clearest(effects)]
    clear += [(row, name) for name in _HEADLINE for row in rows if row[f"added {name}"].certain]
    for row, name in clear:
        if row.harm("added", name) > 0.0:
            return _effect(row, name)
    for name in _HEADLINE:
        harmful = [row for row in rows if row.harm("added", name) > 0.0]
        if harmful:
            worst = max(harmful, key=lambda row: row.harm("added", name))
            alone = "distinguishable alone, but not when all are read together"
            seen = worst[f"added {name}"].seen
            return f"{_effect(worst, name)}: {alone if seen else 'too few trials to tell'}"
    if any(row.flawed for row in rows):
        return next(iter(flaws(table)), "").removesuffix(".")
    if not rows:
        return ""
    harmed, pairs = sum(row["harmed"].value for row in rows), sum(row["harmed"].trials for row in rows)
    return f"{_NO_HARM} in the mean" if harmed else f"No attack did harm in any of {plural(pairs, 'pair')}"


def _effect(row: DrivingRow, name: str) -> str:
    """`The attack phantom_queue on picture changes the way driven by -54 [-62, -46] m a trial`."""
    return of_study("driving_headline", row=row, name=name, measures=DRIVING_MEASURES)[0]


def conclusion(table: Sequence[DrivingRow]) -> list[str]:
    """Sentences: what did not take part, what attacks do, what defences change about it, and what was not run.

    Where something did not take part, only what is shown to differ is named.
    """
    attacked = [row for row in table if row.of["attack"] and row["changed"].trials]
    defended = {
        defence: [row for row in attacked if row.of["defence"] == defence]
        for defence in dict.fromkeys(row.of["defence"] for row in table if row.of["defence"])
    }
    rows = dict(first=_first_rows(table), not_run=[row for row in table if not row.trials])
    return flaws(table) + of_study("driving", **rows, defended=defended, measures=DRIVING_MEASURES)


def flaws(table: Sequence[DrivingRow]) -> list[str]:
    """A sentence for each thing that did not take part as the scenario says, with its number of runs."""
    where: dict[tuple[str, int, int], list[str]] = {}
    for row in table:
        defended = f" and {row.of['defence']}" if row.of["defence"] else ""
        for what, count in row.flaws.items():
            where.setdefault((what, count, row.trials), []).append(f"{row.title}{defended}")
    played = [row.trials for row in table if row.trials]
    names = ("what", "count", "trials")
    return [
        text
        for key, titles in where.items()
        for text in of_study("flaw", **dict(zip(names, key, strict=True)), titles=titles, played=played)
    ]


def _first_rows(table: Sequence[DrivingRow]) -> list[DrivingRow]:
    """The rows under attack without a defence, or all if there is none."""
    attacked = [row for row in table if row.of["attack"] and row.trials]
    return [row for row in attacked if not row.of["defence"]] or attacked
