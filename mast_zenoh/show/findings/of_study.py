"""The result of a study in words, with comparisons corrected for multiple testing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from mast_zenoh.errors import plural
from mast_zenoh.metrics.estimates import ESTIMATES, LOCAL, MISSION, PICTURE
from mast_zenoh.metrics.measures import SUMMARY_NAMES
from mast_zenoh.metrics.study_results import LEVEL, Row, Statistic, StudyFacts, StudySeries, clearest, holm
from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.show.findings.changes import DISPLACED, ERRORS, FALSE, IDENTITY, MISSED
from mast_zenoh.show.findings.words import of_study
from mast_zenoh.show.number_text import value
from mast_zenoh.show.study_columns import ADDED, ALL_SCORES, DRIVEN, ESTIMATORS, PAPER, series_of, unchanged


@dataclass(frozen=True, slots=True)
class Comparisons:
    """The contrasts with the baseline that are tested in the tables.

    adjusted: by configuration and series, the p-value adjusted by Holm's procedure
    clearest: those that remain distinguishable from 0, the clearest first
    others:   number of other tested contrasts in table.csv, which are not counted
    """

    adjusted: Mapping[tuple[str, StudySeries], float]
    clearest: Sequence[tuple[str, StudySeries]]
    others: int

    @property
    def count(self) -> int:
        """The number of contrasts."""
        return len(self.adjusted)

    @property
    def bonferroni(self) -> float:
        """Bonferroni level of each interval for a joint level of LEVEL."""
        return LEVEL / max(self.count, 1)

    def remains(self, row: Row, series: StudySeries) -> bool:
        """Whether the difference is distinguishable from 0 after Holm's procedure."""
        return self.adjusted.get((row.configuration, series), 1.0) <= LEVEL

    def shows(self, row: Row, series: StudySeries) -> bool:
        """Whether the difference remains, or is the same in all seeds."""
        return self.remains(row, series) or row.get(series).certain

    def remaining(self) -> int:
        """The number of contrasts that remain distinguishable from 0."""
        return sum(p <= LEVEL for p in self.adjusted.values())


def compare(rows: Sequence[Row], baseline: str) -> Comparisons:
    """The contrasts with a p-value in the tables of increments, each counted once."""
    tested = {
        (row.configuration, series): estimate
        for row in rows
        if row.configuration != baseline
        for series, estimate in row.numbers.items()
        if not math.isnan(estimate.p)
    }
    in_tables = {*series_of(ADDED + PAPER)}
    counted = {(label, series): estimate for (label, series), estimate in tested.items() if series in in_tables}
    priority = {estimator: rank for rank, estimator in enumerate(_PRIORITY)}  # of equally clear ones
    counted = dict(sorted(counted.items(), key=lambda item: priority.get(item[0][1].estimator, len(priority))))
    adjusted = dict(zip(counted, holm([each.p for each in counted.values()]), strict=True))
    return Comparisons(adjusted, clearest(counted), len(tested) - len(counted))


#: By metric: the name of what an attack changes, and its kind of error.
_CHANGES = {
    "fp_iob": ("false objects", FALSE),
    "fn_iob": ("missed objects", MISSED),
    "id_switches_iob": ("identity switches", IDENTITY),
    "rmse_m_iob": ("RMSE", DISPLACED),
    "length_error_m_iob": ("lengths", "length"),
    "width_error_m_iob": ("widths", "width"),
    "heading_error_deg_iob": ("headings", "heading"),
    "velocity_error_mps_iob": ("velocities", "velocity"),
}
_WRONG = ("fp_iob", "fn_iob")
_COUNTED = (*_WRONG, "id_switches_iob")
#: The smallest change of other metrics that the headline reports, in their units.
_LEAST = 0.01
#: Estimates in order of priority: what the ego acts on comes first.
_PRIORITY = (MISSION, PICTURE, LOCAL)

_Change = tuple[Row, StudySeries]


def titled(rows: Sequence[Row], facts: StudyFacts) -> tuple[list[Row], StudyFacts]:
    """Copies whose configuration labels name each parameter."""
    renamed = [replace(row, of={"configuration": row.title}) for row in rows]
    return renamed, facts.titled({row.configuration: row.title for row in rows})


class Conclusions(NamedTuple):
    """What a study says first, on the page, on the terminal and in other places.

    headline: without a full stop;  reading: sentences below it
    errors:   sentences on errors of estimates, where the other two are about something else; empty: they are about it
    """

    headline: str
    reading: Sequence[str]
    errors: Sequence[str] = ()


def conclusions(
    rows: Sequence[Row],
    facts: StudyFacts,
    comparisons: Comparisons,
    own_headline: str = "",
    own_reading: Sequence[str] = (),
) -> Conclusions:
    """What a study says first.

    own_headline, own_reading: what a kind of study says of its own measures, such as what happened to driven cars; it
                               comes before errors of estimates. Empty: nothing
    """
    result, others = clearest_change(rows, facts, comparisons), other_changes(rows, facts, comparisons)
    if not own_headline:
        return Conclusions(result.removesuffix("."), own_reading or others, others if own_reading else ())
    if own_reading:
        return Conclusions(own_headline, own_reading, [result, *others])
    # That no error changes clearly is no news where the study's own measure does.
    no_news = not facts.idle and _nothing_changes(_attacked(rows, facts), comparisons)
    return Conclusions(own_headline, others if no_news else [result, *others])


def clearest_change(rows: Sequence[Row], facts: StudyFacts, comparisons: Comparisons) -> str:
    """The clearest change in a sentence, after one for each attack that never began."""
    idle = [text for each in facts.idle for text in of_study("never_began", idle=each)]
    attacked = _attacked(rows, facts)
    return " ".join([*idle, *([_result(rows, attacked, comparisons)] if attacked or not idle else [])])


def _attacked(rows: Sequence[Row], facts: StudyFacts) -> list[Row]:
    """Configurations other than the baseline whose attack began in some trial."""
    known = (facts.baseline, *facts.never_attacked)
    return [row for row in rows if row.configuration not in known]


def _nothing_changes(attacked: Sequence[Row], comparisons: Comparisons) -> bool:
    """Whether no estimate of the ego has false or missed objects more or fewer, as far as this is known."""
    known = _estimates_of(attacked, *_WRONG)
    changed = any(not each.is_zero for each in known)
    return bool(known) and _headline(attacked, comparisons) is None and (bool(comparisons.count) or not changed)


def _result(rows: Sequence[Row], attacked: Sequence[Row], comparisons: Comparisons) -> str:
    headline = _headline(attacked, comparisons)
    changes = _changes(attacked, _WRONG)
    largest = _largest([(row, series) for row, series in changes if not row.get(series).is_zero])
    return of_study(
        "result",
        rows=rows,
        attacked=attacked,
        headline=headline and _sentence(headline),
        largest=largest and _sentence(largest),
        compared=largest and _compared(largest),
        rare=largest and largest[0].get(largest[1]).mostly_zero,
        unchanged=_nothing_changes(attacked, comparisons),
        made=comparisons,
    )[0]


def other_changes(rows: Sequence[Row], facts: StudyFacts, comparisons: Comparisons) -> list[str]:
    """The largest change of each kind not in `result`, and the kinds without change."""
    attacked = _attacked(rows, facts)
    if not attacked:
        return []
    headline_change = _headline(attacked, comparisons)
    sentences: list[str] = []
    silent: dict[str, list[str]] = {phrase: [] for phrase in (_UNCHANGED, _RARE, _ALONE, _INDISTINCT, "")}
    for metric, (name, _) in _CHANGES.items():
        clear = [each for each in _changes(attacked, (metric,)) if comparisons.shows(*each)]
        change = _largest(clear)
        if change is None:
            silent[_silence(_estimates_of(attacked, metric), tested=bool(comparisons.count))].append(name)
        elif change != headline_change:
            sentences.append(f"{name[:1].upper()}{name[1:]}: {_sentence(change)}.")
    sentences += [f"Not changed in any trial: {name}." for name, columns in ADDED if unchanged(attacked, columns)]
    phrases = ((phrase.format(plural(comparisons.count, "comparison")), names) for phrase, names in silent.items())
    return sentences + [f"{phrase}: {', '.join(names)}." for phrase, names in phrases if phrase and names]


_UNCHANGED, _RARE = "Unchanged in all trials", "Changed in few trials, and therefore without interval"
_ALONE = "Distinguishable from the baseline if read alone, not if all {} are read together"
_INDISTINCT = "Not distinguishable from the baseline"


def _silence(known: Sequence[Statistic], *, tested: bool) -> str:
    """Why there is no change to name; "": that is not known."""
    if tested and known and all(each.unchanged for each in known):
        return _UNCHANGED
    if any(each.mostly_zero and not each.unchanged for each in known):
        return _RARE
    if tested and any(each.seen for each in known):
        return _ALONE
    return _INDISTINCT if tested and any(not math.isnan(each.low) for each in known) else ""


def _compared(change: _Change) -> str:
    """The group of changes of which this one is the largest."""
    names = "false or missed objects"
    row, series = change
    if series.estimator == MISSION and any(each.estimator == DRIVEN for each in row.numbers):
        return f"{names} in the mission estimate"  # with a veto, its driver acts on something else
    return f"{names} in {ESTIMATES[series.estimator].noun}"


def _changes(rows: Sequence[Row], metrics: Sequence[str]) -> list[_Change]:
    """All known changes of metrics, of estimates in order of priority."""
    every = [(row, StudySeries("", each, name)) for each in _PRIORITY for row in rows for name in metrics]
    return [(row, series) for row, series in every if row.get(series).known]


def _estimates_of(rows: Sequence[Row], *metrics: str) -> list[Statistic]:
    """All known estimates of metrics."""
    return [row.get(series) for row, series in _changes(rows, metrics)]


def _largest(changes: Sequence[_Change]) -> _Change | None:
    """The largest of the changes in the first estimate that has any."""
    first = [each for each in changes if each[1].estimator == changes[0][1].estimator]
    return max(first, key=lambda change: abs(change[0].get(change[1]).value), default=None)


def _headline(rows: Sequence[Row], comparisons: Comparisons) -> _Change | None:
    """The clearest change of the ego's estimates; without any, the largest that is the same in all seeds."""
    by_label = {row.configuration: row for row in rows}
    for label, series in comparisons.clearest:
        row = by_label.get(label)
        if row is None or series.owner or series.estimator not in _PRIORITY or series.metric not in _CHANGES:
            continue
        if series.metric in _COUNTED or abs(row.get(series).value) >= _LEAST:
            return row, series
    return _largest([(row, series) for row, series in _changes(rows, _COUNTED) if row.get(series).certain])


def _sentence(change: _Change) -> str:
    """`in attacked-3 the picture has 6.10 more false objects a frame [5.20, 7.00] …`."""
    row, series = change
    estimate = row.get(series)
    sign = 1.0 if estimate.value >= 0.0 else -1.0
    ends = sorted((sign * estimate.low, sign * estimate.high))
    positive = estimate._replace(value=sign * estimate.value, low=ends[0], high=ends[1])
    kind = _CHANGES[series.metric][1]
    difference = Finding("difference", what=kind, value=estimate.value, unit=ERRORS[kind].unit)
    text = sentence(difference, value(positive))
    subject = ESTIMATES[series.estimator].subject
    return of_study(
        "changed_in", label=row.configuration, subject=subject, text=text, each=estimate, positive=positive
    )[0]


def comparisons_made(comparisons: Comparisons) -> str:
    """Number of comparisons, its effect on each interval, and the meaning of the mark."""
    return of_study("comparisons", made=comparisons, level=LEVEL)[0]


def is_of_user(series: StudySeries) -> bool:
    """Whether a series is a user's metric of one of the ego's main estimates."""
    metric, ego = series.metric, not series.owner and series.estimator in ESTIMATORS
    return ego and metric.isidentifier() and metric not in SUMMARY_NAMES and not metric.endswith(("_iob", "_ioe"))


def reservations(rows: Sequence[Row], facts: StudyFacts) -> list[str]:
    """Caveats: differences not due to attacks alone, and numbers based on fewer seeds."""
    columns = (column for _, group in (*ALL_SCORES, *ADDED, *PAPER) for column in group.items())
    names = {(series.estimator, series.metric): heading for heading, series in columns}
    left_out: dict[str, dict[int, list[str]]] = {}
    for row in rows:
        by_count = left_out.setdefault(row.configuration, {})
        for series, estimate in row.numbers.items():
            own = is_of_user(series)
            if own or (series.estimator, series.metric) in names:
                name = series.metric if own else names[series.estimator, series.metric]
                where = ESTIMATORS.get(series.estimator, series.estimator)
                change = "change of " if series.metric.endswith("_iob") and "IoB" not in name else ""
                count = estimate.seeds_left_out(len(facts.seeds))
                by_count.setdefault(count, []).append(f"{change}{name} ({where})")
    return of_study("reservations", facts=facts, rows=left_out)
