"""What a reader sees of a search: tables, a figure, and all results as JSON.

Optuna's own plots draw with pyplot and change the style of all figures, know neither intervals nor differences from no
attack, and have no panel beside them.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mast_zenoh import run_folder
from mast_zenoh.metrics.study_results import Statistic
from mast_zenoh.show.figures.drawing import RenderedFigure, render
from mast_zenoh.show.figures.facets import curve
from mast_zenoh.show.figures.style import LINE_STYLES, Figure, light_axes, plain
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.number_text import DASH, digits, number, over_trials
from mast_zenoh.show.palette import INK, LOCAL, RUN_COLOURS
from mast_zenoh.show.study_columns import MOSTLY_ZERO_NOTE
from mast_zenoh.show.tables.text_table import ResultTables, TextTable, csv_text, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.kinds import StudyFiles, write_files
from mast_zenoh.study.search.plan import SEARCHED, as_text
from mast_zenoh.study.search.results import ESTIMATES, SearchResults


def write(folder: Path, results: SearchResults) -> StudyFiles:
    """Write search.md, .csv and .tex, candidates.csv, search.json and the figure into the study's folder."""
    tables, figure = search_tables(results), search_figure(results)
    texts = tables.texts("search") | {
        "candidates.csv": candidates_csv(results),
        "search.json": json.dumps(run_folder.finite(as_json(results)), indent=2, allow_nan=False) + "\n",
    }
    figures = {figure.name: figure}
    return StudyFiles(tables, figures, write_files(folder, texts, figures), on_page=False)


def as_json(results: SearchResults) -> dict[str, Any]:
    """All results as plain values; numbers that are not known are NaN."""
    study, plan, best = results.study, results.plan, results.candidates.best_trial
    optimism, over_baseline = results.optimism
    return {
        "name": study.name,
        "objective": plan.objective.text,
        "direction": "maximise" if plan.maximise else "minimise",
        "sampler": results.sampler,
        "parameters": {name: as_text(each) for name, each in plan.space.items()},
        "scenes": [scene.label for scene in study.scenes],
        "frames": study.frames,
        "search_seeds": list(results.search_seeds),
        "held_out_seeds": list(results.held_out_seeds),
        "baseline": study.baseline,
        "default": {"configuration": plan.run, "values": dict(results.defaults)},
        "searched": {
            "configuration": SEARCHED,
            "candidate": best.number + 1,
            "values": best.params,
            "optimism": optimism,
            "optimism_over_baseline": over_baseline,
        },
        "results": [
            {"configuration": label, "search": row["search"].value}
            | {name: row[name]._asdict() | {"trial_mean": row[name].value} for name in ESTIMATES}
            for label, row in results.rows.items()
        ],
        "candidates": [
            {"candidate": number + 1, "batch": number // plan.batch + 1, "values": each.params, "value": value}
            for number, (each, value) in enumerate(zip(results.candidates.trials, results.values, strict=True))
        ],
    }


# -- tables ------------------------------------------------------------------------------------------------------------

#: So many candidates are in the table; all are in candidates.csv.
MOST = 10
#: Decimals of parameters.
_DIGITS = 4
_HEADINGS = ("configuration", "search seeds", "held-out seeds", "minus no attack", "minus default")


def search_tables(results: SearchResults) -> ResultTables:
    """All tables of a search."""
    objective, rows = results.plan.objective, [*results.rows.values()]
    optimism = dict(zip(("optimism", "optimism_over_baseline"), map(Statistic, results.optimism), strict=True))
    found = results.rows[SEARCHED]
    task = f"{'Maximised' if results.plan.maximise else 'Minimised'}: {objective.label} (`{objective.text}`)"
    columns = {_HEADINGS[1]: shown("search", lambda each: number(each.value))}
    columns |= {heading: shown(name, _text) for heading, name in zip(_HEADINGS[2:], ESTIMATES, strict=True)}
    held_out = table_of_rows(task, _optimism(results), rows, columns, {_HEADINGS[0]: _HEADINGS[0]})
    brief = (held_out, _parameters(results))
    return ResultTables(
        title=f"Search {results.study.name}",
        about=f"{task}. {results.size}. Sampler: {results.sampler}.",
        size=results.size,
        tables=(*brief, _best(results)),
        numbers=numbers_of_rows([*rows, replace(found, numbers=optimism)]),
        brief=brief,
    )


def _text(each: Statistic) -> str:
    return over_trials(each) if each.seeds else DASH


def _optimism(results: SearchResults) -> str:
    """How far to believe the search's own value."""
    rows, known = results.rows, [each for each in results.values if not math.isnan(each)]
    sentences = of_study(
        "search",
        plan=results.plan,
        baseline=results.study.baseline,
        best=results.candidates.best_trial,
        known=known,
        rows=rows,
        optimism=results.optimism,
        over_baseline=results.over_baseline,
        left_out=rows[SEARCHED]["held_out"].seeds_left_out(results.count),
    )
    if any(each.mostly_zero for of_label in rows.values() for each in of_label.numbers.values()):
        sentences.append(MOSTLY_ZERO_NOTE)
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
    """All candidates with all digits, in the order in which they were proposed.

    Columns:
    candidate, batch: number of the candidate, and of the batch in which it was proposed; its parameters follow
    value: of the objective
    best: the best one so far
    """
    space, batch = results.plan.space, results.plan.batch
    lines = [
        [each.number + 1, each.number // batch + 1, *(each.params[name] for name in space), *digits(*values)]
        for each, *values in zip(results.candidates.trials, results.values, results.best_so_far, strict=True)
    ]
    return csv_text(["candidate", "batch", *space, "value", "best"], lines)


# -- figure ------------------------------------------------------------------------------------------------------------

#: Colours of no attack, of the default, and of what the search found.
_BASELINE, _DEFAULT, _SEARCHED = LOCAL, RUN_COLOURS[0], RUN_COLOURS[1]
_WIDTH, _HEIGHT = 10.0, 4.4
#: Characters of a line of a label.
_LABEL, _TICK = 36, 12
#: The ring around the search's own value of its result, in both panels.
_RING: dict[str, Any] = dict(
    marker="o", markersize=9, markerfacecolor="none", markeredgewidth=1.6, color=_SEARCHED, linestyle="none", zorder=5
)


def search_figure(results: SearchResults) -> RenderedFigure:
    """Candidates in their order on the search's seeds; next to it, held-out seeds with 95 % intervals.

    Both show differences from no attack if the objective has a value there: these are paired by scene and seed, so that
    it does not matter how hard the seeds are.
    """
    label, over_baseline = results.plan.objective.label, results.over_baseline
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained", facecolor="white")
    in_order, held_out = figure.subplots(1, 2, sharey=True, width_ratios=(2.1, 1.0))
    offset = results.rows[results.study.baseline]["search"].value if over_baseline else 0.0
    _candidates(in_order, results, offset)
    _held_out(held_out, results, offset)
    words = f"{label}, minus no attack" if over_baseline else label
    in_order.set_ylabel(plain("\n".join(textwrap.wrap(words, _LABEL))), fontsize=9.5, color=INK)
    handles, labels = in_order.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=5, frameon=False, fontsize=9, labelcolor=INK)
    better = results.optimism[over_baseline]
    caption = paragraph("figure_search", maximise=results.plan.maximise, size=results.size, better=better)
    rows = [(label, row["held_out"]) for label, row in results.rows.items() if row["held_out"].seeds]
    values = "; ".join(f"{label} {over_trials(each)}" for label, each in rows)
    alt = f"Search over {results.plan.candidates} candidates. {label} on held-out seeds: {values}."
    return render("search", figure, alt, caption, printed=True)


def _candidates(axes: Axes, results: SearchResults, offset: float) -> None:
    _begin(axes, "search", results.search_seeds)
    at = np.arange(1, results.plan.candidates + 1)
    values, best = np.array(results.values) - offset, np.array(results.best_so_far) - offset
    axes.scatter(at, values, s=22, color=_SEARCHED, alpha=0.5, linewidths=0.0, label="candidate")
    axes.step(at, best, where="post", color=_SEARCHED, linewidth=1.8, label="best so far")
    axes.plot(results.candidates.best_trial.number + 1, best[-1], label="result of the search", **_RING)
    default = results.rows[results.plan.run]["search"]
    if default.known:
        label = plain(f"{results.plan.run} (default)")
        axes.axhline(default.value - offset, color=_DEFAULT, linestyle=LINE_STYLES[1], linewidth=1.6, label=label)
    _no_attack(axes, results)
    axes.set_xlabel("candidate", fontsize=9.5, color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0.0, len(at) + 1.0)


def _held_out(axes: Axes, results: SearchResults, offset: float) -> None:
    _begin(axes, "held out", results.held_out_seeds)
    _no_attack(axes, results)
    name = "over_baseline" if results.over_baseline else "held_out"
    estimates = {label: row[name] for label, row in results.rows.items() if row[name].known}
    colours, free = {results.plan.run: 0, SEARCHED: 1}, count(2)
    for at, (label, estimate) in enumerate(estimates.items()):
        curve(axes, [at], [estimate], colours[label] if label in colours else next(free), "")
    if SEARCHED in estimates:
        axes.plot(list(estimates).index(SEARCHED), results.candidates.best_value - offset, **_RING)
    axes.set_xticks(range(len(estimates)), [plain("\n".join(textwrap.wrap(label, _TICK))) for label in estimates])
    axes.set_xlim(-0.6, len(estimates) - 0.4)
    axes.tick_params(axis="y", labelleft=True)


def _begin(axes: Axes, name: str, seeds: range) -> None:
    light_axes(axes)
    which = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
    axes.set_title(f"{name}, {which}", fontsize=9.5, color=INK, loc="left")


def _no_attack(axes: Axes, results: SearchResults) -> None:
    """The line of no attack."""
    if results.over_baseline:
        label = plain(f"{results.study.baseline} (no attack)")
        axes.axhline(0.0, color=_BASELINE, linestyle=LINE_STYLES[2], linewidth=1.6, label=label)
