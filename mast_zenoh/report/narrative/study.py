"""The result of a study in words, made from its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mast_zenoh.report.narrative.study_comparisons import LEVEL, Comparisons
from mast_zenoh.report.study_facts import IdleAttack, StudyFacts, plural
from mast_zenoh.report.tables.study_rows import (
    ADDED,
    ALL_SCORES,
    ESTIMATORS,
    PAPER,
    Column,
    Estimate,
    StudyRow,
    bounds,
    columns_of,
    value,
)

#: What an attack can change, by the metric that shows it: its name, and how a change of it reads.
_CHANGES = {
    "fp_iob": ("false objects", "{size} {more} false objects a frame"),
    "fn_iob": ("missed objects", "{size} {more} missed objects a frame"),
    "id_switches_iob": ("identity switches", "{size} {more} identity switches a run"),
    "rmse_m_iob": ("RMSE", "{size} m {more} RMSE"),
}
#: The metrics of which the first with a change has the headline, and the least change that may.
_HEADLINES = ((("fp_iob", "fn_iob"), 0.0), (("id_switches_iob",), 0.0), (("rmse_m_iob",), 0.01))
#: Where to look for a change first: at what the ego acts on.
_WHERE = {"mission": "the ego with the picture has", "picture": "the picture has", "local": "the ego alone has"}
_IN = {"mission": "what the ego acts on", "picture": "the picture", "local": "what the ego sees alone"}

_Change = tuple[StudyRow, Column]


def titled(rows: Sequence[StudyRow], facts: StudyFacts) -> tuple[list[StudyRow], StudyFacts]:
    """The same with configurations named so that a reader knows which number is which parameter's."""
    return [replace(row, label=row.title) for row in rows], facts.titled({row.label: row.title for row in rows})


def result(rows: Sequence[StudyRow], facts: StudyFacts, comparisons: Comparisons) -> str:
    """The largest change in one sentence, or that there is none: of false or missed objects, else of less relevance.

    Before it, which attacks never began: of these nothing else is said.
    """
    idle = [_never_began(each) for each in facts.idle]
    attacked = _attacked(rows, facts)
    if attacked or not idle:
        idle.append(_result(rows, attacked, comparisons))
    return " ".join(idle)


def _never_began(idle: IdleAttack) -> str:
    """`The attack of uncoordinated never began: it begins at 4 s, and the trials end after 3.8 s.`"""
    where = f" in {', '.join(idle.scenes)}" if idle.scenes else ""
    when = f"it begins at {idle.begins_s:g} s, and the trials end after {idle.ends_s:g} s"
    return f"The attack of {idle.configuration} never began{where}: {when}."


def _attacked(rows: Sequence[StudyRow], facts: StudyFacts) -> list[StudyRow]:
    """The configurations that can differ from the baseline: their attacks began in some trial."""
    return [row for row in rows if row.label != facts.baseline and row.label not in facts.never_attacked]


def _result(rows: Sequence[StudyRow], attacked: Sequence[StudyRow], comparisons: Comparisons) -> str:
    if not attacked:
        return f"{plural(len(rows), 'configuration')}, nothing to compare."
    headline = _headline(attacked, comparisons)
    if headline:
        return f"The largest change of {_compared(headline)}: {_sentence(headline)}."
    any_change = _largest(attacked, ("fp_iob", "fn_iob"), None)
    if not any_change:
        return "No trial has the results of its baseline beside it, so there is nothing to compare."
    greatest = any_change[1].of(any_change[0])
    if greatest.trial_mean == 0.0 and math.isnan(greatest.low):
        return "No attack changes false or missed objects in any trial."
    if comparisons.count:
        many = plural(comparisons.count, "comparison")
        return f"No attack changes false or missed objects distinguishably, of {many} with the baseline."
    return f"The largest change of {_compared(any_change)}, too few seeds for an interval: {_sentence(any_change)}."


def other_changes(rows: Sequence[StudyRow], facts: StudyFacts, comparisons: Comparisons) -> list[str]:
    """The largest change of each kind that `result` does not name, and the kinds that show none."""
    attacked = _attacked(rows, facts)
    if not attacked:
        return []
    named = _headline(attacked, comparisons)
    sentences: list[str] = []
    equal, indistinct = [], []
    for metric, (name, _) in _CHANGES.items():
        change = _largest(attacked, (metric,), comparisons)
        if change and change != named:
            sentences.append(f"{name[:1].upper()}{name[1:]}: {_sentence(change)}.")
        elif not change and comparisons.count:
            known = _known(attacked, metric)
            if known and all(each.unchanged for each in known):
                equal.append(name)
            elif any(not math.isnan(each.low) for each in known):
                indistinct.append(name)
    for name, columns in ADDED:
        if attacked and all(column.of(row).unchanged for row in attacked for column in columns):
            sentences.append(f"Not changed in any trial: {name}.")
    if equal:
        sentences.append(f"Unchanged in all trials: {', '.join(equal)}.")
    if indistinct:
        sentences.append(f"Not distinguishable from the baseline: {', '.join(indistinct)}.")
    return sentences


def _compared(change: _Change) -> str:
    """Among which changes this one is the largest: those of other estimates may be larger."""
    metrics = next(metrics for metrics, _ in _HEADLINES if change[1].metric in metrics)
    names = " or ".join(_CHANGES[metric][0] for metric in metrics).replace(" objects or ", " or ")
    return f"{names} in {_IN[change[1].estimator]}"


def _known(rows: Sequence[StudyRow], metric: str) -> list[Estimate]:
    """What is known of a metric, in all estimates of all configurations."""
    found = [Column("", metric, estimator).of(row) for row in rows for estimator in _WHERE]
    return [each for each in found if not math.isnan(each.trial_mean)]


def _headline(rows: Sequence[StudyRow], comparisons: Comparisons) -> _Change | None:
    """The largest change of the most relevant metrics that show any."""
    for metrics, least in _HEADLINES:
        change = _largest(rows, metrics, comparisons)
        if change and abs(change[1].of(change[0]).trial_mean) >= least:
            return change
    return None


def _largest(rows: Sequence[StudyRow], metrics: Sequence[str], comparisons: Comparisons | None) -> _Change | None:
    """The largest change of the first estimate that shows any; with `comparisons`, one that remains or is certain."""
    for estimator in _WHERE:
        changes = [(row, Column("", metric, estimator)) for row in rows for metric in metrics]
        known = [(row, column) for row, column in changes if not math.isnan(column.of(row).trial_mean)]
        if comparisons:
            known = [each for each in known if comparisons.remains(*each) or each[1].of(each[0]).certain]
        if known:
            return max(known, key=lambda change: abs(change[1].of(change[0]).trial_mean))
    return None


def _sentence(change: _Change) -> str:
    """`in uncoordinated-3 the picture has 6.10 more false objects a frame [5.20, 7.00] than the baseline`."""
    row, column = change
    estimate = column.of(row)
    sign = 1.0 if estimate.trial_mean >= 0.0 else -1.0
    ends = sorted((sign * estimate.low, sign * estimate.high))
    positive = replace(estimate, trial_mean=sign * estimate.trial_mean, low=ends[0], high=ends[1])
    more = "more" if sign > 0 else "less" if column.metric == "rmse_m_iob" else "fewer"
    text = _CHANGES[column.metric][1].format(size=value(positive), more=more)
    what = f"in {row.label} {_WHERE[column.estimator]} {text}"
    if estimate.certain:
        return f"{what} than the baseline, in all {estimate.seeds} seeds; no spread, so no interval"
    return f"{what} {bounds(positive)} than the baseline"


def comparisons_made(comparisons: Comparisons) -> str:
    """How many comparisons there are, what that means for each, and what the mark is."""
    if not comparisons.count:
        return "No comparison with the baseline has an interval."
    count = comparisons.count
    others = f" table.csv has {comparisons.others} more, which are not counted." if comparisons.others else ""
    return (
        f"{plural(count, 'comparison')} with the baseline, each with a 95 % interval of its own: "
        f"{LEVEL * count:.1f} of them would exclude 0 by chance if no attack did anything. "
        f"They hold together at 95 % if each is held to a level of {comparisons.bonferroni:.2g} (Bonferroni). "
        f"* marks the {comparisons.remaining()} that remain distinguishable from 0 after Holm's procedure.{others}"
    )


def reservations(rows: Sequence[StudyRow], facts: StudyFacts) -> list[str]:
    """What to know before trusting a number: which are no pure effect of an attack, and which rest on fewer seeds."""
    sentences = []
    if facts.other_scenes:
        sentences.append(
            f"{', '.join(facts.other_scenes)}: not the baseline's scene, or other agents in it, so differences from "
            "the baseline are not the attack's alone."
        )
    names = {(column.estimator, column.metric): column.heading for column in columns_of((*ALL_SCORES, *ADDED, *PAPER))}
    for row in rows:
        by_count: dict[int, list[str]] = {}
        for series, estimate in row.estimates.items():
            if (series.estimator, series.metric) in names:
                name = names[series.estimator, series.metric]
                where = ESTIMATORS.get(series.estimator, series.estimator)
                change = "change of " if series.metric.endswith("_iob") and "IoB" not in name else ""
                by_count.setdefault(estimate.left_out, []).append(f"{change}{name} ({where})")
        if not by_count:
            sentences.append(f"{row.label}: no trial has results.")
        for count, which in sorted(by_count.items()):
            if count:
                of = "" if len(by_count) == 1 else f" for {', '.join(dict.fromkeys(which))}"
                sentences.append(
                    f"{row.label}: {count} of {plural(len(facts.seeds), 'seed')} left out{of}: a trial failed or has "
                    "no such value."
                )
    return sentences
