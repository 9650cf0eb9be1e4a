"""The figure of a study: what an attack adds, against how many adversaries there are."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mast_zenoh.report.study_rows import StudyRow
from mast_zenoh.report.style import INK, LOCAL, RUN_COLOURS, light_axes, plain, png

_PANELS = (
    ("fp_iob", "False tracks in the picture"),
    ("fn_iob", "Missed objects in the picture"),
    ("cafp_iob", "False tracks of compromised agents"),
)


def increments_figure(rows: Sequence[StudyRow], parameter: str = "n_adversaries") -> bytes | None:
    """PNG: increments over the baseline with 95 % intervals over trials, a line for each run of the study file.

    parameter: of the grid, along the x axis. None if no configuration has it.
    """
    shown = [row for row in rows if isinstance(row.point.get(parameter), (int, float))]
    if not shown:
        return None
    runs = list(dict.fromkeys(row.run for row in shown))
    figure = Figure(figsize=(11.0, 3.9), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(_PANELS))
    for axes, (metric, title) in zip(panels, _PANELS, strict=True):
        light_axes(axes)
        axes.axhline(0.0, color=LOCAL, linewidth=0.8)
        for index, run in enumerate(runs):
            aside = 0.05 * (index - (len(runs) - 1) / 2)  # so that intervals do not hide one another
            colour = RUN_COLOURS[(index + 1) % len(RUN_COLOURS)]  # the first is the baseline's
            _line(axes, [row for row in shown if row.run == run], parameter, metric, colour, aside)
        axes.set_title(title, fontsize=10.5, color=INK, loc="left")
        axes.set_xlabel(parameter.replace("n_", "number of ").replace("_", " "), fontsize=9.5, color=INK)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.margins(x=0.12)
    panels[0].set_ylabel("more than in the baseline, per frame", fontsize=9.5, color=INK)
    panels[0].legend(frameon=False, fontsize=9.5, loc="upper left", labelcolor=INK)
    trials = max(row.get("fp_iob").trials for row in shown)
    figure.supxlabel(f"mean over {trials} trials and 95 % bootstrap interval, paired with the baseline", fontsize=8.5)
    return png(figure)


def _line(axes: Axes, rows: Sequence[StudyRow], parameter: str, metric: str, colour: str, aside: float) -> None:
    """The line of one run, and its label."""
    known = [row for row in rows if not math.isnan(row.get(metric).trial_mean)]
    known.sort(key=lambda row: _x(row, parameter))
    found = [row.get(metric) for row in known]
    axes.errorbar(
        [_x(row, parameter) + aside for row in known],
        [each.trial_mean for each in found],
        yerr=[
            [0.0 if math.isnan(each.low) else each.trial_mean - each.low for each in found],
            [0.0 if math.isnan(each.high) else each.high - each.trial_mean for each in found],
        ],
        color=colour,
        marker="o",
        markersize=5,
        linewidth=1.8,
        capsize=4,
        label=plain(rows[0].run),
    )


def _x(row: StudyRow, parameter: str) -> float:
    value = row.point[parameter]
    assert isinstance(value, (int, float))
    return float(value)
