"""docs/ref-metrics.md: every metric, with its unit, its range and what it means."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mast_zenoh.api.catalogue import summary
from mast_zenoh.metrics.causes import CAUSES
from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.metrics.measures import MEASURES, Measure
from reference import linked, page, table
from reference.docstrings import described_table, sources

_INTRODUCTION = """\
Look up here what each number of a run or a study means, its unit and its range.
[explanation-metrics-and-causes.md](explanation-metrics-and-causes.md) has the formulas, the rules by which objects
count, and their sources. Metrics of your own are in the same files."""
_SCORES = """\
## Scores of an estimate

`agents.AGENT.ESTIMATE` of metrics.json. Those of frames are columns of metrics.parquet, too. Over the scored frames,
counts, set distances and errors of pairs have `mean` and `std`, the others one number. None (null, NaN): undefined.
"""
#: Headings, each with where its numbers are, and what writes them.
PARTS = (
    ("Causes of errors", "`agents.AGENT.ESTIMATE` of metrics.json.", "mast_zenoh.metrics.causes:causes_of"),
    ("What an attack achieved", "`achieved.ADVERSARY` of metrics.json.", "mast_zenoh.metrics.achievement:summary"),
    ("Consequences for driving", "`driving.AGENT.ESTIMATE` of metrics.json.", "mast_zenoh.metrics.driving:summary"),
    (
        "What happened to driven cars",
        "`driven.CAR` of metrics.json.",
        "mast_zenoh.driving.consequences:consequences",
        "mast_zenoh.evaluation.run_scoring:RunScoring._on_truth",
    ),
    (
        "Confidence and accuracy",
        "`consistency.AGENT.ESTIMATE` of metrics.json, for `position` and `velocity`.",
        "mast_zenoh.metrics.consistency:Consistency.nees_summary",
    ),
    ("Confidence without truth", "`innovations.NODE` of run.json.", "mast_zenoh.tracking.base:Innovations.summary"),
    ("Trust", "`integrity` of metrics.json.", "mast_zenoh.metrics.trust:summary"),
    ("Trust in an agent", "`integrity.agents.AGENT` of metrics.json.", "mast_zenoh.metrics.trust:_of_agent"),
    ("Several pictures", "`pictures` of metrics.json.", "mast_zenoh.metrics.pictures:of_pictures"),
    ("The radio channel", "`channel` of metrics.json.", "mast_zenoh.evaluation.run_scoring:RunScoring._channel"),
    ("Latencies", "`latency_ms` of metrics.json.", "mast_zenoh.launch.conclusion:latency_ms"),
    ("Further numbers of trials", "In results.parquet of a study.", "mast_zenoh.study.numbers:numbers"),
    (
        "Differences from the baseline",
        "In results.parquet and table.csv of a study.",
        "mast_zenoh.study.numbers:values",
    ),
)


def metrics_page() -> str:
    """Every metric that a run or a study writes."""
    return page("Metrics by name", "mast_zenoh/metrics", _INTRODUCTION, _sections())


def _sections() -> Iterator[str]:
    yield _SCORES
    yield table(("metric", "unit", "range", "per frame", "meaning"), map(_row, MEASURES.values()))
    yield "The estimates that every evaluator knows; a map can name others:\n"
    yield table(("estimate", "of the ego"), ((f"`{name}`", each.panel) for name, each in ESTIMATES.items()))
    yield f"Causes: {', '.join(f'`{cause}`' for cause in CAUSES)}.\n"
    for heading, place, *writers in PARTS:
        yield f"## {heading}\n\n{place}\n"
        yield described_table("Keys", *writers)


def _row(measure: Measure) -> tuple[str, ...]:
    low, high = (f"{bound:g}" if math.isfinite(bound) else "" for bound in measure.range)
    bounds = f"{low} to {high}" if low and high else f"from {low}" if low else ""
    words = " ".join([f"{summary(type(measure))}.", *sources(type(measure))])
    return f"`{measure.label}`", measure.unit, bounds, "yes" if measure.axis else "", linked(words)
