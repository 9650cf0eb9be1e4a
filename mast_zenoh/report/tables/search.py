"""The tables of a search: its result on held-out seeds, the parameters that it found, and its best candidates."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mast_zenoh.metrics.search_results import CandidateRow, SearchResults, SearchRow
from mast_zenoh.metrics.study_results import Estimate, plural
from mast_zenoh.report.tables.study_rows import MOSTLY_ZERO, over_trials
from mast_zenoh.report.tables.text_table import DASH, ResultTables, TextTable, csv_text, digits, number

#: So many candidates are in the table; all are in candidates.csv.
MOST = 10
#: Decimals of parameters.
_DIGITS = 4


def search_tables(results: SearchResults) -> ResultTables:
    """All tables of a search."""
    brief = (_held_out(results), _parameters(results))
    return ResultTables(
        title=f"Search {results.name}",
        about=f"{_task(results)} {results.size}. Sampler: {results.sampler}.",
        size=results.size,
        tables=(*brief, _best(results)),
        numbers=(_HEADINGS, [_numbers(row, results) for row in results.rows.values()]),
        brief=brief,
    )


def _task(results: SearchResults) -> str:
    return f"{'Maximised' if results.maximise else 'Minimised'}: {results.label} (`{results.objective}`)."


def _held_out(results: SearchResults) -> TextTable:
    return TextTable(
        _task(results).rstrip("."),
        _optimism(results),
        (
            "configuration",
            "search seeds",
            "held-out seeds",
            "minus no attack",
            "minus default",
        ),
        [
            (
                row.label,
                number(row.search),
                _estimate(row.held_out),
                _estimate(row.over_baseline),
                _estimate(row.over_default),
            )
            for row in results.rows.values()
        ],
        1,
    )


def _optimism(results: SearchResults) -> str:
    """How far to believe the search's own value."""
    row = results.rows[results.searched]
    sentences = [
        f"The result is candidate {results.best + 1} of {len(results.candidates)}. Optimism of the search: "
        f"{number(row.search)} on its own seeds, {number(row.held_out.trial_mean)} on held-out seeds, "
        f"{number(results.optimism)} too good"
    ]
    if results.over_baseline:
        own = row.search - results.rows[results.baseline].search
        sentences[0] += (
            f"; as the difference from no attack, {number(own)} and {number(row.over_baseline.trial_mean)}, "
            f"{number(results.optimism_over_baseline)} too good"
        )
    sentences[0] += "."
    sentences += _no_better(results)
    if left_out := row.held_out.left_out:
        sentences.append(f"Left out: {plural(left_out, 'held-out seed')}, because a trial failed or has no value.")
    if results.without_value:
        sentences.append(f"Without a value, so never chosen: {plural(results.without_value, 'candidate')}.")
    roles = f"No attack: {results.baseline}. Default: {results.default}."
    explained = ["Brackets: 95 % interval over seeds; differences are paired by scene and seed."]
    if any(each.mostly_zero for line in results.rows.values() for each in (line.over_baseline, line.over_default)):
        explained.append(MOSTLY_ZERO)
    return " ".join([roles, *sentences, *explained])


def _no_better(results: SearchResults) -> list[str]:
    """Sentences on a search that has not found more than the default has, or that had nothing to choose from."""
    values = [each.value for each in results.candidates if not math.isnan(each.value)]
    if len(values) > 1 and min(values) == max(values):
        return ["All candidates have the same value: within these ranges, nothing that is searched changes it."]
    default, best = results.rows[results.default].search, results.found.value
    if math.isnan(default) or (best > default if results.maximise else best < default):
        return []
    return [
        f"The search found nothing better than the default: {number(default)} with its parameters, {number(best)} with "
        "the best of the candidates, on the same seeds."
    ]


def _estimate(estimate: Estimate) -> str:
    return over_trials(estimate) if estimate.seeds else DASH


def _parameters(results: SearchResults) -> TextTable:
    return TextTable(
        "Parameters",
        f"{DASH}: not known." if len(results.defaults) < len(results.space) else "",
        ("parameter", "range", "default", "searched"),
        [
            (short, space, _value(results.defaults.get(name, DASH)), _value(results.found.values[name]))
            for short, (name, space) in zip(short_names(list(results.space)), results.space.items(), strict=True)
        ],
        1,
    )


def short_names(names: Sequence[str]) -> list[str]:
    """Dotted names without their first steps, as far as they stay different: `selection.region` becomes `region`."""
    steps = [name.split(".") for name in names]
    kept = next(
        n for n in range(1, 1 + max(map(len, steps))) if len({tuple(each[-n:]) for each in steps}) == len(names)
    )
    return [".".join(each[-kept:]) for each in steps]


def _best(results: SearchResults) -> TextTable:
    """The best candidates on the search's seeds."""
    known = [each for each in results.candidates if not math.isnan(each.value)]
    best = sorted(known, key=lambda each: (-each.value if results.maximise else each.value, each.number))[:MOST]
    return TextTable(
        f"Best candidates on the search's seeds, {len(best)} of {len(results.candidates)}",
        "",
        ("candidate", *short_names(list(results.space)), "value"),
        [(str(each.number + 1), *_values(each, results), number(each.value)) for each in best],
        1,
    )


def _values(candidate: CandidateRow, results: SearchResults) -> list[str]:
    return [_value(candidate.values[name]) for name in results.space]


def _value(value: object) -> str:
    """A parameter's value for readers."""
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else str(value)


_ESTIMATES = ("held_out", "over_baseline", "over_default")
_HEADINGS = (
    "configuration",
    "search",
    *(f"{name}{suffix}" for name in _ESTIMATES for suffix in ("", "_low", "_high")),
    "p_over_baseline",
    "p_over_default",
    "seeds",
    "seeds_left_out",
    "optimism",
    "optimism_over_baseline",
)


def _numbers(row: SearchRow, results: SearchResults) -> Sequence[object]:
    """A line of search.csv, with all digits."""
    estimates: list[Estimate] = [getattr(row, name) for name in _ESTIMATES]
    bounds = [value for each in estimates for value in digits(each.trial_mean, each.low, each.high)]
    p = digits(row.over_baseline.p, row.over_default.p)
    both = (results.optimism, results.optimism_over_baseline)
    optimism = digits(*both) if row.label == results.searched else ["", ""]
    held_out = row.held_out
    return [row.label, *digits(row.search), *bounds, *p, held_out.seeds, held_out.left_out, *optimism]


def candidates_csv(results: SearchResults) -> str:
    """All candidates with all digits, in the order in which they were proposed."""
    lines = [
        [
            each.number + 1,
            each.batch + 1,
            *(each.values[name] for name in results.space),
            *digits(each.value, each.best),
        ]
        for each in results.candidates
    ]
    return csv_text(["candidate", "batch", *results.space, "value", "best"], lines)
