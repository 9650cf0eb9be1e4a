"""The figure of a search: the value of every candidate, and what its result is worth on held-out seeds.

Optuna's own plots draw with pyplot and change the style of all figures, know neither intervals nor differences from no
attack, and have no panel beside them.
"""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import LINE_STYLES, MARKERS, Figure, light_axes, plain
from mast_zenoh.report.tables.study_rows import over_trials
from mast_zenoh.report.tables.text_table import number
from mast_zenoh.study.search.plan import SEARCHED
from mast_zenoh.study.search.results import SearchResults
from mast_zenoh.viewer.palette import INK, LOCAL, RUN_COLOURS

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
    offset = results.rows[results.study.baseline].search if over_baseline else 0.0
    _candidates(in_order, results, offset)
    _held_out(held_out, results, offset)
    words = f"{label}, minus no attack" if over_baseline else label
    in_order.set_ylabel(plain("\n".join(textwrap.wrap(words, _LABEL))), fontsize=9.5, color=INK)
    handles, labels = in_order.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=5, frameon=False, fontsize=9, labelcolor=INK)
    caption = (
        f"{'Higher' if results.plan.maximise else 'Lower'} is better for the attacker ({results.size}). Left: every "
        "candidate on the search's seeds. Right: seeds that the search has not seen, with 95 % intervals over seeds; "
        "no bar: fewer than five seeds, equal values, or no change in most trials. The ring is the search's own value "
        f"of its result: it is {number(results.optimism[over_baseline])} better than that on held-out seeds."
    )
    rows = [row for row in results.rows.values() if row.held_out.seeds]
    values = "; ".join(f"{row.configuration} {over_trials(row.held_out)}" for row in rows)
    alt = f"Search over {results.plan.candidates} candidates. {label} on held-out seeds: {values}."
    return render("search", figure, alt, caption, printed=True)


def _candidates(axes: Axes, results: SearchResults, offset: float) -> None:
    _begin(axes, "search", results.search_seeds)
    at = np.arange(1, results.plan.candidates + 1)
    values, best = np.array(results.values) - offset, np.array(results.best_so_far) - offset
    axes.scatter(at, values, s=22, color=_SEARCHED, alpha=0.5, linewidths=0.0, label="candidate")
    axes.step(at, best, where="post", color=_SEARCHED, linewidth=1.8, label="best so far")
    axes.plot(results.candidates.best_trial.number + 1, best[-1], label="result of the search", **_RING)
    default = results.rows[results.plan.run]
    if not math.isnan(default.search):
        label = plain(f"{default.configuration} (default)")
        axes.axhline(default.search - offset, color=_DEFAULT, linestyle=LINE_STYLES[1], linewidth=1.6, label=label)
    _no_attack(axes, results)
    axes.set_xlabel("candidate", fontsize=9.5, color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0.0, len(at) + 1.0)


def _held_out(axes: Axes, results: SearchResults, offset: float) -> None:
    _begin(axes, "held out", results.held_out_seeds)
    _no_attack(axes, results)
    estimates = {
        label: row.over_baseline if results.over_baseline else row.held_out for label, row in results.rows.items()
    }
    shown = {label: estimate for label, estimate in estimates.items() if not math.isnan(estimate.trial_mean)}
    colours = {results.study.baseline: _BASELINE, results.plan.run: _DEFAULT, SEARCHED: _SEARCHED}
    free = iter(RUN_COLOURS[2:] * len(shown))
    for at, (label, estimate) in enumerate(shown.items()):
        mean = estimate.trial_mean
        axes.errorbar(
            at,
            mean,
            yerr=np.nan_to_num([[mean - estimate.low], [estimate.high - mean]]),
            color=colours.get(label) or next(free),
            marker=MARKERS[at % len(MARKERS)],
            markersize=6,
            linewidth=1.8,
            capsize=4,
        )
    if SEARCHED in shown:
        axes.plot(list(shown).index(SEARCHED), results.candidates.best_value - offset, **_RING)
    axes.set_xticks(range(len(shown)), [plain("\n".join(textwrap.wrap(label, _TICK))) for label in shown])
    axes.set_xlim(-0.6, len(shown) - 0.4)
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
