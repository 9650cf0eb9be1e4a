"""Writes the self-contained HTML page of a study with trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mast_zenoh.metrics.study_results import StudyFacts, StudyRow, plural
from mast_zenoh.report.figures.drawing import RenderedFigure
from mast_zenoh.report.narrative.study import compare, comparisons_made, other_changes, reservations, result, titled
from mast_zenoh.report.page import render
from mast_zenoh.report.tables.study import sections, side_by_side

#: Files of the study's folder that the page links to, if they are there.
_TABLES = ("table.csv", "table.md", "table.tex", "results.parquet", "frames.parquet")
#: This many failed trials are listed; the others are collapsed.
_SHOWN_AT_ONCE = 10


def write_page(
    folder: Path, rows: Sequence[StudyRow], facts: StudyFacts, figures: Mapping[str, RenderedFigure]
) -> Path:
    """Write `report.html` into the folder of a study, and return its path.

    figures: of `figures_over_trials`, by name
    """
    rows, facts = titled(rows, facts)
    comparisons = compare(rows, facts.baseline)
    tables = sections(rows, facts.baseline, comparisons)
    scores = side_by_side(rows)
    content = {
        "title": f"Study {facts.name}",
        "headline": result(rows, facts, comparisons).removesuffix("."),
        "facts": _facts(facts),
        "failures": facts.failures,
        "failed": facts.failed,
        "shown_at_once": _SHOWN_AT_ONCE,
        "reservations": reservations(rows, facts),
        "reading": other_changes(rows, facts, comparisons),
        "figures": figures,
        "added": [each for each in tables if each.title.startswith("What the attack adds")],
        "comparisons": comparisons_made(comparisons),
        "scores": scores if scores.lines else None,
        "others": [each for each in tables if not each.title.startswith(("What the attack adds", "Scores"))],
        "configurations": [
            (label, scenario, settings, facts.done.get(label, 0), facts.planned)
            for label, (scenario, settings) in facts.configurations.items()
        ],
        "baseline": facts.baseline,
        "scenes": facts.scenes,
        "tables": [name for name in _TABLES if (folder / name).is_file()],
        "environment": facts.environment,
    }
    return render("study_trials.html.j2", content, folder)


def _facts(facts: StudyFacts) -> list[str]:
    seeds = f"{facts.seeds[0]} to {facts.seeds[-1]}" if len(facts.seeds) > 1 else str(facts.seeds[0])
    done = sum(facts.done.values())
    return [
        f"study {facts.name}",
        plural(len(facts.configurations), "configuration"),
        facts.size,
        f"seeds {seeds}" if len(facts.seeds) > 1 else f"seed {seeds}",
        f"{done} of {facts.trials} trials have results" if done < facts.trials else plural(done, "trial"),
        f"{facts.frames} frames each" if facts.frames else "all frames of each scene",
        f"runtime {facts.runtime}",
        f"mast-zenoh {facts.environment.get('mast-zenoh', 'unknown')}",
    ]
