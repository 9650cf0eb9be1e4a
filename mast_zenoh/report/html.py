"""Writes the HTML reports of runs and of compared runs, with their figures as PNG."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.report import comparison
from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.figures.of_run import frame_choice, run_figures, save_user_figures, study_figures, user_figures
from mast_zenoh.report.figures.view import PANELS, check_frame, choose_common_frame, choose_frame, frame_view, settled
from mast_zenoh.report.narrative.adversaries import attack_description
from mast_zenoh.report.narrative.changes import largest_change
from mast_zenoh.report.narrative.run import headline, reading, reference_status, study_headline, study_reading
from mast_zenoh.report.page import render
from mast_zenoh.report.run_facts import facts, facts_of_compared, healing
from mast_zenoh.report.run_figure import FigureContext
from mast_zenoh.report.tables.of_run import (
    achieved_table,
    cause_table,
    check_rows,
    conduct_table,
    confidence_tables,
    driving_table,
    latency_tables,
    suspension_table,
    trust_sentences,
)
from mast_zenoh.report.tables.scores import Cell, ScoreTable, Value, number, score_table, signed
from mast_zenoh.report.tables.wiring import wire_rows
from mast_zenoh.viewer.frame import Frame, has_boxes
from mast_zenoh.viewer.interposers import BAD, EFFECTS, failure_lines, interposers, node_row
from mast_zenoh.viewer.page.block import run_block
from mast_zenoh.viewer.page.page import ViewerParts, viewer_parts
from mast_zenoh.viewer.run import RunRecord

#: Runs of a study that its viewer holds.
_MOST_IN_VIEWER = 4


def write_report(
    run_folder: Path, frame: int | None = None, against: Path | None = None, figures: Sequence[Path] = ()
) -> Path:
    """Write `report.html` and `figures/*.png` into a run folder.

    frame:   the frame that pictures show; by default from `view.choose_frame`
    against: folder of a reference run of the same scene
    figures: Python files whose figures are added (`RunFigure`)
    Returns the path of the report. Raises RunFolderError if the folder is not a run folder, or has no such frame;
    NotComparable if the runs cannot be compared.
    """
    run = RunRecord.load(run_folder)
    return write_page(run, frame, None if against is None else comparison.reference(run, against), figures)


def write_page(
    run: RunRecord, frame: int | None = None, reference: Reference | None = None, figures: Sequence[Path] = ()
) -> Path:
    """Write the report of a loaded run; see `write_report`."""
    estimate = _estimate(run, reference)
    if frame is None:
        chosen = choose_frame(run, reference.run if reference else None, estimate)
        frame_note = frame_choice(run, estimate, reference.name if reference else "")
    else:
        chosen, frame_note = check_frame(run, frame), ""
        if not settled(run, np.array([frame])).all():
            frame_note = "This frame was requested; it is not a scored frame."
    view = None if chosen is None else frame_view(run, chosen, estimate)
    return _write_run(FigureContext(run, view, frame_note, reference, estimate), figures)[1]


def _estimate(run: RunRecord, reference: Reference | None) -> str:
    """The ego's estimate with the largest change, if it has boxes, else the picture."""
    change = largest_change(run, reference.run if reference else None)
    drawable = change is not None and change.agent == run.ego and has_boxes(run, change.estimate)
    return change.estimate if change is not None and drawable else "picture"


def write_study_report(study_folder: Path, runs: Mapping[str, Path], frame: int | None = None) -> Path:
    """Write the report of compared runs and each run's own report.

    The former goes into `study_folder`.

    runs:  folders of runs of one scene and seed by label, in the order to show them; the one labelled `baseline`,
           or else the first, is what the others are compared with
    frame: the frame that all pictures show; by default from `view.choose_common_frame`
    Returns the path of the report. Raises RunFolderError like `write_report`.
    """
    folders = {label: RunRecord.load(path) for label, path in runs.items()}
    reference = "baseline" if "baseline" in folders else next(iter(folders))
    largest_changes = [largest_change(run, folders[reference]) for run in folders.values()]
    change = max((each for each in largest_changes if each), key=lambda each: abs(each.weight), default=None)
    estimate = change.estimate if change and change.estimate in PANELS else "mission" if change else "picture"
    chosen = choose_common_frame(list(folders.values()), folders[reference], estimate)
    frame_views = {label: _view_to_show(run, frame, chosen) for label, run in folders.items()}
    table = _scores(folders, reference)
    pages: list[dict[str, Any]] = []
    for label, run in folders.items():
        page, path = _write_run(FigureContext(run, frame_views[label]), study=study_folder)
        link = _relative(path, study_folder)
        pages.append({"label": label, "anchor": f"run-{len(pages) + 1}", "link": link} | page)
    views = {label: view for label, view in frame_views.items() if view is not None}
    if any(estimate not in view.boxes for view in views.values()):  # of an older run
        estimate = "picture"
    figures = study_figures(folders, table, views, estimate, chosen=frame is None)
    for each in figures.values():
        each.save(study_folder / "figures")
    viewer, problems = _viewer(dict(list(folders.items())[:_MOST_IN_VIEWER]), frame if frame is not None else chosen)
    content = {
        "title": "Runs compared",
        "viewer": viewer,
        "problems": problems,
        "headline": study_headline(folders, table),
        "reading": study_reading(folders, table),
        "facts": facts_of_compared(folders),
        "figures": figures,
        **_score_rows(table),
        "pages": pages,
    }
    return render("study.html.j2", content, study_folder)


def _view_to_show(run: RunRecord, frame: int | None, common: int | None) -> Frame | None:
    """The view of a run at the requested frame.

    Without one: at the common frame, or else at the run's own choice.
    """
    if frame is not None:
        return frame_view(run, check_frame(run, frame))
    chosen = choose_frame(run) if common is None else common
    return None if chosen is None else frame_view(run, chosen)


def _scores(runs: Mapping[str, RunRecord], reference: str | None = None) -> ScoreTable:
    ego = next((run.ego for run in runs.values() if run.ego), "ego")
    metrics = {label: run.metrics for label, run in runs.items()}
    return score_table(metrics, counts={name: run.counts for name, run in runs.items()}, agent=ego, reference=reference)


def _write_run(
    context: FigureContext, files: Sequence[Path] = (), study: Path | None = None
) -> tuple[dict[str, Any], Path]:
    """Write a run's own report; returns its content and path.

    study: the folder of the study that the report links back to
    """
    run, reference = context.run, context.reference
    figures, own = run_figures(context), user_figures(context, files)
    runs = {reference.name: reference.run, run.label: run} if reference is not None else {run.label: run}
    scores = _scores(runs, reference.name if reference else None)
    for each in figures.values():
        each.save(run.path / "figures")
    save_user_figures(own, run.path / "figures")
    shown_runs = {run.label: run} | ({reference.name: reference.run} if reference is not None else {})
    viewer, problems = _viewer(shown_runs, context.view.index if context.view else None)
    content = {
        "title": f"Run {run.run.get('id', run.label)}",
        "headline": headline(run, reference),
        "attack": attack_description(run),
        "reading": reading(run, reference),
        "facts": facts(run) + ([f"compared with {reference.name}"] if reference else []),
        "status": run.run.get("status", "unknown"),
        "message": run.run.get("message"),
        "failures": failure_lines(run),
        "reference_status": reference_status(reference),
        "notices": [f"{notice['kind']}: {notice['text']}" for notice in run.run.get("notices", ())],
        "missing": (*run.missing, *problems),
        "back": _relative(study / "report.html", run.path) if study is not None else None,
        "viewer": viewer,
        "figures": figures,
        "user_figures": own,
        **(_score_rows(scores) if run.metrics else {"rows": []}),
        "confidence": confidence_tables(run),
        "interposers": interposers(run),
        "suspensions": suspension_table(run),
        "conduct": conduct_table(run),
        "trust": trust_sentences(run),
        "achieved": achieved_table(run, reference.run if reference else None),
        "driving": driving_table(run, reference.run, reference.name) if reference else driving_table(run),
        "effects": EFFECTS,
        "bad_verdicts": BAD,
        "results": run.results,
        "blame": cause_table({run.label: run.metrics}) if run.faulted or run.withholds else None,
        "checks": check_rows(run.checks),
        "healed": healing(run),
        "latency": latency_tables(run.metrics),
        "wires": wire_rows(run),
        "nodes": [(name, node_row(run, name)) for name in run.run.get("nodes", {})],
        "command": _command(run),
        "versions": run.run.get("versions", {}),
        "scenario": json.dumps(run.scenario, indent=2) if run.scenario else None,
        "timings": json.dumps(run.run["timings"], indent=2) if run.run.get("timings") else None,
    }
    return content, render("run.html.j2", content, run.path)


def _relative(path: Path, folder: Path) -> str:
    """The link to a file from a page in a folder."""
    return quote(os.path.relpath(path, folder).replace(os.sep, "/"))


def _viewer(runs: Mapping[str, RunRecord], frame: int | None) -> tuple[ViewerParts | None, tuple[str, ...]]:
    """The moving picture of runs by label (None: nothing to show), and why it is left out."""
    try:
        blocks = [block for label, run in runs.items() if (block := run_block(run, frame, label))]
    except ValueError as error:
        return None, (f"The viewer is left out: {error}.",)
    return viewer_parts(blocks) if blocks else None, ()


def _score_rows(table: ScoreTable) -> dict[str, Any]:
    """The scores for the page: columns, and rows of (text, spread, change)."""

    def spread(value: Value) -> str | None:
        return None if value.std is None else f"{value.std:.2f}"

    rows = []
    for row in table.rows:
        cells = []
        for name in table.estimates:
            cell = row.cells.get(name, Cell(Value(), Value()))
            change = None if cell.change.mean is None else signed(cell.change, row.measure)
            cells.append((number(cell.value, row.measure), spread(cell.value), change))
        over = signed(row.over_alone, row.measure), spread(row.over_alone), None
        rows.append((row.measure.heading, row.run, [*cells, over]))
    return {
        "estimates": [ESTIMATES[name].column for name in table.estimates],
        "rows": rows,
        "runs": len(table.runs),
        "reference": table.reference,
    }


def _command(run: RunRecord) -> str | None:
    command = run.run.get("command")
    return shlex.join(map(str, command)) if isinstance(command, list) else command
