"""What attacks do to a car that is driven, and what defences spare it.

Every trial under attack is paired with its twin, the same scene, seed and defence without the attack. Every trial with
a defence is paired with the same scene, seed and attack without one. A twin shares all random draws, so a difference is
due to the attack, or to the defence, and to what follows from it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.estimates import MISSION
from mast_zenoh.metrics.significance import clearest
from mast_zenoh.metrics.study_results import NEGLIGIBLE, Row, SeriesEstimate, Statistic, plural
from mast_zenoh.report.tables.study_rows import over_trials, value
from mast_zenoh.report.tables.text_table import (
    BOUNDS,
    DASH,
    ResultTables,
    TextTable,
    digits,
    number,
    whole_percent,
)
from mast_zenoh.study import statistics
from mast_zenoh.study.defences.intervals import share_of_trials
from mast_zenoh.study.defences.kinds import Factors, Kind
from mast_zenoh.study.numbers import own_metrics
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure

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

    def of_kind(self, kind: str) -> dict[str, SeriesEstimate]:
        """The numbers of a kind: mean, added or spared, by name; of DRIVING_MEASURES."""
        return {name: self.numbers[f"{kind} {name}"] for name in DRIVING_MEASURES if f"{kind} {name}" in self.numbers}


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
        own = list(dict.fromkeys(name for each in trials for name in each if name.startswith("own ")))
        numbers: dict[str, Any] = {}
        for name in (*DRIVING_MEASURES, *own):
            least = 0.0 if name in DRIVING_MEASURES else -math.inf
            values, short = self._units(factors, name), name.removeprefix("own ")
            numbers[f"mean {short}"] = statistics.trial_estimate(values, (least, math.inf))
            for kind, other in (("added", twin), ("spared", undefended if name in DRIVING_MEASURES else None)):
                if other is not None:
                    difference = values - self._units(other, name)
                    numbers[f"{kind} {short}"] = statistics.trial_estimate(
                        difference, (-math.inf, math.inf), paired=True
                    )
        numbers["harmed"], numbers["changed"] = (
            self._affected(factors, twin, -1),
            self._affected(factors, undefended, 0),
        )
        flaws = Counter(flaw for each in trials for flaw in each["flaws"])
        compared = [self.trials.get(other, {}) for other in (factors, twin, undefended) if other]
        of = {name: factors[name] for name in ("attack", "wire", "defence")}
        return DrivingRow(
            of, len(trials), numbers, flaws, any(each["flaws"] for by_key in compared for each in by_key.values())
        )

    def _affected(self, factors: Factors, other: Factors | None, sign: int) -> Statistic:
        """In how many pairs any measure differs; sign: -1: for the worse alone."""
        if other is None:
            return Statistic(0.0)
        pairs = {name: self._units(factors, name) - self._units(other, name) for name in DRIVING_MEASURES}
        differs = [
            (sign * DRIVING_MEASURES[name].better * each if sign else np.abs(each)) > NEGLIGIBLE
            for name, each in pairs.items()
        ]
        happened, known = np.any(differs, axis=0), ~np.isnan(pairs["collisions"])
        chance = share_of_trials(int(happened.any(axis=0).sum()), int(known.any(axis=0).sum()))
        return chance._replace(value=float(happened.sum()), trials=int(known.sum()))

    def _units(self, factors: Factors, name: str) -> Floats:
        """(scenes, seeds) a number of each planned trial, NaN where there is none.

        Of fewer than five seeds but not scenes, scenes are the units of intervals: then it is (seeds, scenes).
        """
        values = self.values(factors, name).reshape(len(self.scenes), -1)
        return values.T if values.shape[1] < statistics.MIN_CLUSTERS <= len(self.scenes) else values

    def tables(self, table: Sequence[DrivingRow]) -> ResultTables:
        """The CSV has a row for each attack, defence, measure and kind of number."""
        return driving_tables(table, self.size)

    def figures(self, table: Sequence[DrivingRow]) -> Mapping[str, RenderedFigure]:
        """A panel for each measure, with a line for each attack, and on it a point for each defence."""
        from mast_zenoh.report.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.report.figures.facets import Axis, facet

        rows = [
            Row({"attack": row.title, "defence": row.of["defence"] or "no defence"}, row.trials, row.numbers)
            for row in table
            if row.of["attack"] and row.trials
        ]
        axes = [Axis(f"added {name}", f"added {each.heading}") for name, each in DRIVING_MEASURES.items()]
        height = 1.3 + 0.46 * max(1, len({row.of["attack"] for row in rows}))
        figure = facet(rows, "attack", axes, "defence", size=(2.2, height))
        caption = (
            f"What an attack adds to a trial of its twin, the same seed and defence without it ({self.size}). Bars: "
            "95 % intervals of the paired difference; a point without a bar: all differences are equal, most are 0, or "
            "too few trials."
        )
        return {self.name: render(self.name, figure, " ".join(conclusion(table)), caption, printed=True)}


# -- what readers see --------------------------------------------------------------------------------------------------

_ABOUT = (
    "Per trial. Each trial under attack is paired with its twin: the same scene, seed and defence without the attack. "
    "Each trial with a defence is paired with the same scene, seed and attack without one. Brackets: 95 % intervals, "
    "Student's t over seeds, or over scenes if there are fewer than five seeds but not scenes (n: their number); none "
    "where all are equal."
)
_NONE = "none"
_HEADINGS = tuple(measure.heading for measure in DRIVING_MEASURES.values())
#: What a headline names if no effect is clear, the worst first.
_HEADLINE = ("collisions", "needless_brakes", "progress_m")
_NO_HARM = "No attack adds collisions or needless brakes, or shortens the way"


def driving_tables(table: Sequence[DrivingRow], size: str) -> ResultTables:
    """The tables of the study."""
    row_heads = ("attack", "on", "defence", "trials")
    own = list(dict.fromkeys(name for row in table for name in _own(row)))
    numbers = [
        [*_names(row), kind, name, *_digits(estimate, row.trials)]
        for row in table
        for kind in ("mean", "added", "spared")
        for name, estimate in row.of_kind(kind).items()
    ]
    numbers += [
        [*_names(row), kind, name, *_digits(row.numbers.get(f"{kind} {name}", SeriesEstimate()), row.trials)]
        for row in table
        for name in _own(row)
        for kind in ("mean", "added")
    ]
    sentences = conclusion(table)
    zeros = "(0 in N % [a, b]): the share of pairs without a difference, and its exact 95 % interval."
    tables = [
        TextTable(title, about, (*row_heads, *_HEADINGS), lines, 3)
        for title, kind, about in (
            ("What the car did", "mean", ""),
            ("What the attack adds to what the car did", "added", f"Differences from the twin. {zeros}"),
            ("What the defence changes of what the car did", "spared", f"Differences from no defence. {zeros}"),
        )
        if (lines := [_line(row, each) for row in table if (each := row.of_kind(kind))])
    ]
    if own:
        heads = [heading for name in own for heading in (name, f"{name}, added by the attack")]
        names = [f"{kind} {name}" for name in own for kind in ("mean", "added")]
        lines = [
            [*_names(row), str(row.trials), *(over_trials(row.numbers.get(name, SeriesEstimate())) for name in names)]
            for row in table
        ]
        tables.append(TextTable("Your metrics", "Of what the car's agent acts on.", (*row_heads, *heads), lines, 3))
    brief_heads = ("attack, defence", *_HEADINGS)
    brief_lines = [
        [f"{row.title}, {row.of['defence'] or _NONE}", *(number(each.mean) for each in row.of_kind("mean").values())]
        for row in table
    ]
    brief = TextTable("Driving under attack, means of a trial", " ".join(sentences), brief_heads, brief_lines, 1)
    headings = ("attack", "on", "defence", "number", "measure", *BOUNDS, "zero_share", "zero_low", "zero_high")
    return ResultTables(
        "Driving under attack",
        " ".join([f"{size}.", *sentences, _ABOUT]),
        size,
        tables,
        (headings, numbers),
        [brief],
        headline=headline(table),
        reading=sentences,
    )


def _own(row: DrivingRow) -> list[str]:
    """The user's metrics."""
    names = (name.removeprefix("mean ") for name in row.numbers if name.startswith("mean "))
    return [name for name in names if name not in DRIVING_MEASURES]


def headline(table: Sequence[DrivingRow]) -> str:
    """The clearest harm by an attack; else the worst that one adds; without a full stop.

    Of attacks without a defence, if any was run. Without a harm, what did not take part comes first.
    """
    rows = [row for row in _first_rows(table) if row["harmed"].trials]
    effects = {(index, name): each for index, row in enumerate(rows) for name, each in row.of_kind("added").items()}
    clear = [(rows[index], name) for index, name in clearest(effects)]
    same = [(row, name) for name in _HEADLINE for row in rows if row.of_kind("added")[name].certain]
    for row, name in (*clear, *same):
        if _harm(name, row.of_kind("added")[name]) > 0.0:
            return _effect(row, name)
    for name in _HEADLINE:
        added = [(row, row.of_kind("added")[name]) for row in rows]
        harms = [(_harm(name, each), row, each) for row, each in added if not math.isnan(each.trial_mean)]
        if harms and (worst := max(harms, key=lambda harm: harm[0]))[0] > 0.0:
            alone = "distinguishable alone, but not when all are read together"
            return f"{_effect(worst[1], name)}: {alone if worst[2].differs else 'too few trials to tell'}"
    if any(row.flawed for row in rows):
        return next(iter(flaws(table)), "").removesuffix(".")
    if not rows:
        return ""
    harmed, pairs = sum(row["harmed"].value for row in rows), sum(row["harmed"].trials for row in rows)
    return f"{_NO_HARM} in the mean" if harmed else f"No attack did harm in any of {plural(pairs, 'pair')}"


def _effect(row: DrivingRow, name: str) -> str:
    """`The attack phantom_queue on picture changes the way driven by -54 [-62, -46] m a trial`."""
    added, heading = row.of_kind("added")[name], DRIVING_MEASURES[name].heading
    what = f"changes {heading} by {over_trials(added)}"
    if name == "progress_m":
        what = f"changes the way driven by {over_trials(added)} m"
    elif _harm(name, added) > 0.0:
        what = f"adds {_worded(name, added)}"
    defended = f", with {row.of['defence']}," if row.of["defence"] else ""
    return f"The attack {row.title}{defended} {what} a trial"


def conclusion(table: Sequence[DrivingRow]) -> list[str]:
    """Sentences: what did not take part, what attacks do, what defences change about it, and what was not run."""
    sentences = flaws(table)
    attacked = [row for row in table if row.of["attack"] and row.trials]
    sentences += map(_attack_sentence, _first_rows(table))
    for defence in dict.fromkeys(row.of["defence"] for row in table if row.of["defence"]):
        rows = [row for row in attacked if row.of["defence"] == defence and row["changed"].trials]
        for sign, verb in ((1, "helps against"), (-1, "makes worse")):
            spared = ((row, _shown(row.of_kind("spared"), sign)) for row in rows)
            if against := [f"{row.title} ({', '.join(shown)})" for row, shown in spared if shown]:
                sentences.append(f"{defence} {verb} {'; '.join(against)}.")
        unclear = [row for row in rows if not (_shown(row.of_kind("spared"), 1) or _shown(row.of_kind("spared"), -1))]
        if flawed := [row.title for row in unclear if row.flawed]:
            sentences.append(f"What {defence} changes for {'; '.join(flawed)} was not tried in every run: see above.")
        tried = [row for row in unclear if not row.flawed]
        if same := [f"{row.title} ({_none_of(row['changed'])})" for row in tried if not row["changed"].value]:
            sentences.append(f"No change by {defence} was seen for {'; '.join(same)}.")
        if others := [row.title for row in tried if row["changed"].value]:
            sentences.append(f"Too few trials to tell what {defence} changes for {'; '.join(others)}.")
    if not_run := [f"{row.title}, {row.of['defence'] or _NONE}" for row in table if not row.trials]:
        sentences.append(f"Not run: {'; '.join(not_run)}.")
    return sentences


def flaws(table: Sequence[DrivingRow]) -> list[str]:
    """A sentence for each thing that did not take part as the scenario says, with its number of runs."""
    where: dict[tuple[str, int, int], list[str]] = {}
    for row in table:
        defended = f" and {row.of['defence']}" if row.of["defence"] else ""
        for what, count in row.flaws.items():
            where.setdefault((what, count, row.trials), []).append(f"{row.title}{defended}")
    played = [row.trials for row in table if row.trials]
    sentences = []
    for (what, count, trials), titles in where.items():
        if count == trials and len(titles) == len(played):
            sentences.append(f"In all {sum(played)} runs, {what}.")
        else:
            each = "each " * (len(titles) > 1)
            sentences.append(f"In {count} of {trials} runs {each}with {'; '.join(titles)}, {what}.")
    return sentences


def _first_rows(table: Sequence[DrivingRow]) -> list[DrivingRow]:
    """The rows under attack without a defence, or all if there is none."""
    attacked = [row for row in table if row.of["attack"] and row.trials]
    return [row for row in attacked if not row.of["defence"]] or attacked


def _attack_sentence(row: DrivingRow) -> str:
    """What an attack adds."""
    defended = f"With {row.of['defence']}" if row.of["defence"] else "Without a defence"
    worse, perhaps = _shown(row.of_kind("added"), -1), _not_shown(row.of_kind("added"))
    does = [f"adds {', '.join(worse)}"] * bool(worse)
    does += [f"{'perhaps ' * bool(worse)}adds {', '.join(perhaps)}: too few trials to tell"] * bool(perhaps)
    if does:
        return f"{defended}, {row.title} {' and '.join(does)}."
    if not row["harmed"].trials:
        return f"{row.title[:1].upper()}{row.title[1:]} has no pair with a run without it."
    if row.flawed:
        return f"{defended}, what {row.title} does was not tried in every run: see above."
    if not row["harmed"].value:
        return f"{defended}, no harm by {row.title} was seen {_none_of(row['harmed'])}."
    pairs = f"{row['harmed'].value:.0f} of {plural(row['harmed'].trials, 'pair')}"
    return f"{defended}, {row.title} does harm in {pairs}, and none in the mean."


def _none_of(affected: Statistic) -> str:
    """`in 5 of 5 pairs; its chance is below 52 % (exact, 95 %)`, for what did not happen."""
    bound = whole_percent(affected.high)
    return f"in {affected.trials} of {plural(affected.trials, 'pair')}; its chance is below {bound} % (exact, 95 %)"


def _shown(numbers: Mapping[str, SeriesEstimate], sign: int) -> list[str]:
    """The measures that are shown to differ, for the better (1) or for the worse (-1), with their intervals."""
    return [_worded(name, each) for name, each in numbers.items() if each.differs and sign * _harm(name, each) < 0.0]


def _not_shown(numbers: Mapping[str, SeriesEstimate]) -> list[str]:
    """The measures that are worse in the mean, although too few trials show it."""
    return [_worded(name, each) for name, each in numbers.items() if _harm(name, each) > 0.0 and not each.differs]


def _harm(name: str, each: SeriesEstimate) -> float:
    """The mean, positive where it is worse for the car."""
    return -each.trial_mean * DRIVING_MEASURES[name].better


def _worded(name: str, each: SeriesEstimate) -> str:
    """`3.03 [2.51, 3.56] needless brakes`, or `0.27 collisions (0 in 73 % [54, 88] of the pairs)`."""
    heading = DRIVING_MEASURES[name].heading
    if not each.mostly_zero:
        return f"{over_trials(each)} {heading}"
    share, low, high = map(whole_percent, (each.zero_share, each.zero_low, each.zero_high))
    return f"{value(each)} {heading} (0 in {share} % [{low}, {high}] of the pairs)"


def _names(row: DrivingRow) -> tuple[str, str, str]:
    return row.of["attack"] or _NONE, row.of["wire"] or DASH, row.of["defence"] or _NONE


def _line(row: DrivingRow, estimates: Mapping[str, SeriesEstimate]) -> list[str]:
    return [*_names(row), str(row.trials), *(over_trials(estimates[name]) for name in DRIVING_MEASURES)]


def _digits(each: SeriesEstimate, done: int) -> list[str]:
    """BOUNDS of an estimate, and its share of zeros. done: number of trials"""
    trials = each.scenes * each.seeds
    interval = "" if math.isnan(each.low) else "Student's t"
    zeros = digits(each.zero_share, each.zero_low, each.zero_high)
    return [*digits(each.trial_mean, each.low, each.high), interval, str(trials), str(done - trials), *zeros]
