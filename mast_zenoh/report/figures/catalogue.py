"""The figures that compare runs, with alt texts and captions."""

from __future__ import annotations

from collections.abc import Mapping

from mast_zenoh.report.figures.charts import counts_over_time
from mast_zenoh.report.figures.drawing import RenderedFigure, render, side_by_side_figure
from mast_zenoh.report.figures.of_run import counts_caption, tally
from mast_zenoh.report.figures.view import FrameView
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import ESTIMATES, ScoreTable

_CHOICE_ATTACKED = (
    "The frame is the scored one, since the first change by an adversary, with the most errors {where}{beyond}"
)
_CHOICE_CLEAN = "The frame is the scored one in which the picture spares the ego the most errors"
_FULL_NAMES = {"local": "The ego alone", "picture": "The common picture", "mission": "The ego with the picture"}


def study_figures(
    runs: Mapping[str, RunFolder],
    table: ScoreTable,
    views: Mapping[str, FrameView],
    estimate: str = "picture",
    *,
    chosen: bool,
) -> dict[str, RenderedFigure]:
    """The figures that compare runs, by name."""
    figures = []
    if views:
        tallies = "; ".join(f"{label}: {tally(view, estimate)}" for label, view in views.items())
        name = _FULL_NAMES[estimate]
        caption = f"{name} in the same frame of every run; under it, means per frame over the scored frames."
        if chosen:
            beyond = f" less those of {table.reference} in the same frame"
            caption += f" {_CHOICE_ATTACKED.format(where=f'of the {ESTIMATES[estimate]}', beyond=beyond)}."
        alt = f"Bird's-eye views side by side, {next(iter(views.values())).time_label}. {tallies}."
        figures.append(render("side_by_side", side_by_side_figure(views, table, estimate), alt, caption))
    over_time = counts_over_time(runs, next(iter(views.values())).frame if views else None, estimate)
    if over_time is not None:
        alt = f"Missed objects, false objects and RMSE over time: ego alone, and {ESTIMATES[estimate]} of every run."
        figures.append(render("counts", over_time, alt, counts_caption(list(runs.values()))))
    return {each.name: each for each in figures}


def frame_choice(run: RunFolder, estimate: str, reference: str = "") -> str:
    """A sentence that explains how a frame was chosen.

    reference: name of the run whose errors were subtracted
    """
    if not run.attack_frames and not reference:
        return f"{_CHOICE_CLEAN}."
    beyond = f" beyond those of {reference} in the same frame" if reference else ""
    sentence = _CHOICE_ATTACKED.format(where=f"of the {ESTIMATES.get(estimate, estimate)}", beyond=beyond)
    return (
        sentence.replace(", since the first change by an adversary,", "") + "."
        if not run.attack_frames
        else f"{sentence}."
    )
