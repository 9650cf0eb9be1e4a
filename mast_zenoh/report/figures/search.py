"""The figure of a search: the value of every candidate, and what its result is worth on held-out seeds."""

from __future__ import annotations

import math
import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mast_zenoh.metrics.search_results import SearchResults
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import LINE_STYLES, MARKERS, Figure, light_axes, plain
from mast_zenoh.report.tables.study_rows import over_trials
from mast_zenoh.report.tables.text_table import number
from mast_zenoh.viewer.palette import INK, LOCAL, RUN_COLOURS

#: Colours of no attack, of the default, and of what the search found.
_BASELINE, _DEFAULT, _SEARCHED = LOCAL, RUN_COLOURS[0], RUN_COLOURS[1]
_WIDTH, _HEIGHT = 10.0, 4.4


def search_figure(results: SearchResults) -> RenderedFigure:
    """Candidates over time on the search's seeds; next to it, the held-out seeds with 95 % intervals."""
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained", facecolor="white")
    over_time, held_out = figure.subplots(1, 2, sharey=True, width_ratios=(2.1, 1.0))
    _candidates(over_time, results)
    _held_out(held_out, results)
    over_time.set_ylabel(plain("\n".join(textwrap.wrap(results.label, 42))), fontsize=9.5, color=INK)
    handles, labels = over_time.get_legend_handles_labels()
    more, others = held_out.get_legend_handles_labels()
    figure.legend(
        [*handles, *more],
        [*labels, *others],
        loc="outside upper left",
        ncols=3,
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )
    direction = "Higher" if results.maximise else "Lower"
    caption = (
        f"{direction} is better for the attacker ({results.size}). Left: every candidate on the search's seeds. Right: "
        f"the same numbers on seeds that the search has not seen, with 95 % intervals over seeds where there are any. "
        f"The search's own value of its result is {number(results.optimism)} better than that on held-out seeds."
    )
    return render("search", figure, f"Search over {len(results.candidates)} candidates. {_values(results)}", caption, printed=True)


def _candidates(axes: Axes, results: SearchResults) -> None:
    light_axes(axes)
    shown = np.array([each.number + 1 for each in results.candidates])
    axes.scatter(
        shown,
        [each.value for each in results.candidates],
        s=18,
        color=_SEARCHED,
        alpha=0.45,
        linewidths=0.0,
        label="candidate",
    )
    axes.step(
        shown,
        [each.best for each in results.candidates],
        where="post",
        color=_SEARCHED,
        linewidth=1.8,
        label="best up to then",
    )
    axes.plot(
        results.best + 1,
        results.found.value,
        marker="o",
        markersize=9,
        markerfacecolor="none",
        markeredgewidth=1.6,
        color=_SEARCHED,
        linestyle="none",
        label="searched: the result",
    )
    for label, colour, style, name in (
        (results.default, _DEFAULT, LINE_STYLES[1], f"{results.default}: default"),
        (results.baseline, _BASELINE, LINE_STYLES[2], f"{results.baseline}: no attack"),
    ):
        value = results.rows[label].search
        if not math.isnan(value):
            axes.axhline(value, color=colour, linestyle=style, linewidth=1.5, label=plain(name))
    axes.set_title(f"search, seeds {_seeds(results.search_seeds)}", fontsize=9.5, color=INK, loc="left")
    axes.set_xlabel("candidate", fontsize=9.5, color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0.0, len(results.candidates) + 1.0)


def _held_out(axes: Axes, results: SearchResults) -> None:
    light_axes(axes)
    labels = [label for label in results.rows if not math.isnan(results.rows[label].held_out.trial_mean)]
    known = {results.baseline: _BASELINE, results.default: _DEFAULT, results.searched: _SEARCHED}
    others = [label for label in labels if label not in known]
    for at, label in enumerate(labels):
        estimate = results.rows[label].held_out
        spread = [estimate.trial_mean - estimate.low, estimate.high - estimate.trial_mean]
        place = others.index(label) + 2 if label in others else 0
        axes.errorbar(
            at,
            estimate.trial_mean,
            yerr=np.nan_to_num(spread)[:, None],
            color=known.get(label, RUN_COLOURS[place % len(RUN_COLOURS)]),
            marker=MARKERS[at % len(MARKERS)],
            markersize=6,
            linewidth=1.8,
            capsize=4,
        )
    if results.searched in labels:
        axes.plot(
            labels.index(results.searched),
            results.found.value,
            marker="o",
            markersize=9,
            markerfacecolor="none",
            markeredgewidth=1.6,
            color=_SEARCHED,
            linestyle="none",
        )
    axes.set_title(f"held out, seeds {_seeds(results.held_out_seeds)}", fontsize=9.5, color=INK, loc="left")
    axes.set_xticks(range(len(labels)), [plain("\n".join(textwrap.wrap(label, 12))) for label in labels])
    axes.set_xlim(-0.6, len(labels) - 0.4)
    axes.tick_params(axis="y", labelleft=True)


def _seeds(seeds: tuple[int, ...]) -> str:
    return str(seeds[0]) if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"


def _values(results: SearchResults) -> str:
    values = "; ".join(f"{row.label} {over_trials(row.held_out)}" for row in results.rows.values() if row.held_out.seeds)
    return f"{results.label} on held-out seeds: {values}."
