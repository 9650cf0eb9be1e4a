"""The figure of a search: the value of every candidate, and what its result is worth on held-out seeds."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mast_zenoh.metrics.search_results import SearchResults, SearchRow
from mast_zenoh.metrics.study_results import Estimate
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import LINE_STYLES, MARKERS, Figure, light_axes, plain
from mast_zenoh.report.tables.study_rows import over_trials
from mast_zenoh.report.tables.text_table import number
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
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained", facecolor="white")
    in_order, held_out = figure.subplots(1, 2, sharey=True, width_ratios=(2.1, 1.0))
    _candidates(in_order, results)
    _held_out(held_out, results)
    label = f"{results.label}, minus no attack" if results.over_baseline else results.label
    in_order.set_ylabel(plain("\n".join(textwrap.wrap(label, _LABEL))), fontsize=9.5, color=INK)
    handles, labels = in_order.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=5, frameon=False, fontsize=9, labelcolor=INK)
    direction = "Higher" if results.maximise else "Lower"
    optimism = results.optimism_over_baseline if results.over_baseline else results.optimism
    caption = (
        f"{direction} is better for the attacker ({results.size}). Left: every candidate on the search's seeds. Right: "
        "seeds that the search has not seen, with 95 % intervals over seeds; no bar: fewer than five seeds, equal "
        "values, or no change in most trials. The ring is the search's own value of its result: it is "
        f"{number(optimism)} better than that on held-out seeds."
    )
    alt = f"Search over {len(results.candidates)} candidates. {_values(results)}"
    return render("search", figure, alt, caption, printed=True)


def _offset(results: SearchResults) -> float:
    """What is subtracted from values on the search's seeds."""
    return results.rows[results.baseline].search if results.over_baseline else 0.0


def _shown(row: SearchRow, results: SearchResults) -> Estimate:
    """What is shown of a configuration on held-out seeds."""
    return row.over_baseline if results.over_baseline else row.held_out


def _candidates(axes: Axes, results: SearchResults) -> None:
    light_axes(axes)
    offset = _offset(results)
    at = np.array([each.number + 1 for each in results.candidates])
    values, best = (
        np.array([getattr(each, name) for each in results.candidates]) - offset for name in ("value", "best")
    )
    axes.scatter(at, values, s=22, color=_SEARCHED, alpha=0.5, linewidths=0.0, label="candidate")
    axes.step(at, best, where="post", color=_SEARCHED, linewidth=1.8, label="best so far")
    axes.plot(results.best + 1, results.found.value - offset, label="result of the search", **_RING)
    default = results.rows[results.default].search - offset
    if not math.isnan(default):
        axes.axhline(
            default,
            color=_DEFAULT,
            linestyle=LINE_STYLES[1],
            linewidth=1.6,
            label=plain(f"{results.default} (default)"),
        )
    _no_attack(axes, results)
    axes.set_title(f"search, {_seeds(results.search_seeds)}", fontsize=9.5, color=INK, loc="left")
    axes.set_xlabel("candidate", fontsize=9.5, color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0.0, len(results.candidates) + 1.0)


def _no_attack(axes: Axes, results: SearchResults) -> None:
    """The line of no attack."""
    if results.over_baseline:
        name = plain(f"{results.baseline} (no attack)")
        axes.axhline(0.0, color=_BASELINE, linestyle=LINE_STYLES[2], linewidth=1.6, label=name)


def _held_out(axes: Axes, results: SearchResults) -> None:
    light_axes(axes)
    _no_attack(axes, results)
    shown = {row.label: _shown(row, results) for row in results.rows.values()}
    shown = {label: estimate for label, estimate in shown.items() if not math.isnan(estimate.trial_mean)}
    colours = {results.baseline: _BASELINE, results.default: _DEFAULT, results.searched: _SEARCHED}
    free = iter(RUN_COLOURS[2:] * len(shown))
    for at, (label, estimate) in enumerate(shown.items()):
        spread = np.array([[estimate.trial_mean - estimate.low], [estimate.high - estimate.trial_mean]])
        axes.errorbar(
            at,
            estimate.trial_mean,
            yerr=np.nan_to_num(spread),
            color=colours.get(label) or next(free),
            marker=MARKERS[at % len(MARKERS)],
            markersize=6,
            linewidth=1.8,
            capsize=4,
        )
    if results.searched in shown:
        axes.plot(list(shown).index(results.searched), results.found.value - _offset(results), **_RING)
    axes.set_title(f"held out, {_seeds(results.held_out_seeds)}", fontsize=9.5, color=INK, loc="left")
    axes.set_xticks(range(len(shown)), [plain("\n".join(textwrap.wrap(label, _TICK))) for label in shown])
    axes.set_xlim(-0.6, len(shown) - 0.4)
    axes.tick_params(axis="y", labelleft=True)


def _seeds(seeds: tuple[int, ...]) -> str:
    return f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"


def _values(results: SearchResults) -> str:
    rows = [row for row in results.rows.values() if row.held_out.seeds]
    return (
        f"{results.label} on held-out seeds: {'; '.join(f'{row.label} {over_trials(row.held_out)}' for row in rows)}."
    )
