"""The tables of a search: its result on held-out seeds, the parameters that it found, and its best candidates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import count
from typing import Any

from mast_zenoh.metrics.study_results import Estimate, plural
from mast_zenoh.report.tables.study_rows import MOSTLY_ZERO, over_trials
from mast_zenoh.report.tables.text_table import DASH, ResultTables, TextTable, csv_text, digits, number
from mast_zenoh.study.search.plan import SEARCHED
from mast_zenoh.study.search.results import ESTIMATES, SearchResults, SearchRow
from mast_zenoh.study.search.space import as_text

#: So many candidates are in the table; all are in candidates.csv.
MOST = 10
#: Decimals of parameters.
_DIGITS = 4
_HEADINGS = ("configuration", "search seeds", "held-out seeds", "minus no attack", "minus default")
#: The columns of search.csv.
_COLUMNS = (
    "configuration",
    "search",
    *(f"{name}{suffix}" for name in ESTIMATES for suffix in ("", "_low", "_high")),
    *("p_over_baseline", "p_over_default", "seeds", "seeds_left_out", "optimism", "optimism_over_baseline"),
)


def search_tables(results: SearchResults) -> ResultTables:
    """All tables of a search."""
    objective, rows = results.plan.objective, results.rows.values()
    task = f"{'Maximised' if results.plan.maximise else 'Minimised'}: {objective.label} (`{objective.text}`)"
    held_out = TextTable(task, _optimism(results), _HEADINGS, [_line(row) for row in rows], 1)
    brief = (held_out, _parameters(results))
    return ResultTables(
        title=f"Search {results.study.name}",
        about=f"{task}. {results.size}. Sampler: {results.sampler}.",
        size=results.size,
        tables=(*brief, _best(results)),
        numbers=(_COLUMNS, [_numbers(row, results) for row in rows]),
        brief=brief,
    )


def _estimates(row: SearchRow) -> list[Estimate]:
    return [getattr(row, name) for name in ESTIMATES]


def _line(row: SearchRow) -> list[str]:
    texts = (over_trials(each) if each.seeds else DASH for each in _estimates(row))
    return [row.configuration, number(row.search), *texts]


def _numbers(row: SearchRow, results: SearchResults) -> Sequence[object]:
    """A line of search.csv, with all digits."""
    bounds = [value for each in _estimates(row) for value in digits(each.trial_mean, each.low, each.high)]
    p = digits(row.over_baseline.p, row.over_default.p)
    optimism = digits(*results.optimism) if row.configuration == SEARCHED else ["", ""]
    seeds = row.held_out.seeds, row.held_out.left_out
    return [row.configuration, *digits(row.search), *bounds, *p, *seeds, *optimism]


def _optimism(results: SearchResults) -> str:
    """How far to believe the search's own value."""
    plan, rows, best = results.plan, results.rows, results.candidates.best_trial
    row, baseline, default = rows[SEARCHED], rows[results.study.baseline], rows[plan.run]
    held_out, known = row.held_out, [each for each in results.values if not math.isnan(each)]
    optimism, added_optimism = map(number, results.optimism)
    added = (
        f"; as the difference from no attack, {number(row.search - baseline.search)} and "
        f"{number(row.over_baseline.trial_mean)}, {added_optimism} too good"
    )
    sentences = [
        f"No attack: {baseline.configuration}. Default: {default.configuration}.",
        f"The result is candidate {best.number + 1} of {plan.candidates}. Optimism of the search: {number(row.search)} "
        f"on its own seeds, {number(held_out.trial_mean)} on held-out seeds, {optimism} too good"
        f"{added if results.over_baseline else ''}.",
    ]
    if len(known) > 1 and min(known) == max(known):
        sentences += ["All candidates have the same value: within these ranges, nothing that is searched changes it."]
    elif (row.search <= default.search) if plan.maximise else (row.search >= default.search):
        sentences.append(
            f"The search found nothing better than the default: {number(default.search)} with its parameters, "
            f"{number(row.search)} with the best of the candidates, on the same seeds."
        )
    if held_out.left_out:
        seeds = plural(held_out.left_out, "held-out seed")
        sentences.append(f"Left out: {seeds}, because a trial failed or has no value.")
    if without := plan.candidates - len(known):
        sentences.append(f"Without a value, so never chosen: {plural(without, 'candidate')}.")
    sentences.append("Brackets: 95 % interval over seeds; differences are paired by scene and seed.")
    if any(each.mostly_zero for of_label in rows.values() for each in _estimates(of_label)):
        sentences.append(MOSTLY_ZERO)
    return " ".join(sentences)


def _parameters(results: SearchResults) -> TextTable:
    space, best = results.plan.space, results.candidates.best_params
    lines = [
        (short, as_text(values), _value(results.defaults.get(name, DASH)), _value(best[name]))
        for short, (name, values) in zip(short_names(list(space)), space.items(), strict=True)
    ]
    about = f"{DASH}: not known." if len(results.defaults) < len(space) else ""
    return TextTable("Parameters", about, ("parameter", "range", "default", "searched"), lines, 1)


def short_names(names: Sequence[str]) -> list[str]:
    """Dotted names without their first steps, as far as they stay different: `selection.region` becomes `region`."""
    shortened = ([".".join(name.split(".")[-kept:]) for name in names] for kept in count(1))
    return next(short for short in shortened if len({*short}) == len(names))


def _best(results: SearchResults) -> TextTable:
    """The best candidates on the search's seeds."""
    space, sign = list(results.plan.space), -1.0 if results.plan.maximise else 1.0
    known = [each for each in zip(results.values, results.candidates.trials, strict=True) if not math.isnan(each[0])]
    best = sorted(known, key=lambda each: sign * each[0])[:MOST]
    return TextTable(
        f"Best candidates on the search's seeds, {len(best)} of {results.plan.candidates}",
        "",
        ("candidate", *short_names(space), "value"),
        [(str(each.number + 1), *(_value(each.params[name]) for name in space), number(value)) for value, each in best],
        1,
    )


def _value(value: Any) -> str:
    """A parameter's value for readers."""
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else str(value)


def candidates_csv(results: SearchResults) -> str:
    """All candidates with all digits, in the order in which they were proposed."""
    space, batch = results.plan.space, results.plan.batch
    lines = [
        [each.number + 1, each.number // batch + 1, *(each.params[name] for name in space), *digits(*values)]
        for each, *values in zip(results.candidates.trials, results.values, results.best_so_far, strict=True)
    ]
    return csv_text(["candidate", "batch", *space, "value", "best"], lines)
