"""Prints the results of runs on the terminal. Loads no drawing libraries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from mast_zenoh.report import comparison
from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.adversaries import explanations
from mast_zenoh.report.narrative.changes import effects, plural
from mast_zenoh.report.narrative.driven import car_sentences
from mast_zenoh.report.narrative.run import defence_sentence, headline, reference_status, status
from mast_zenoh.report.tables.of_run import causes_as_rich, check_lines, nees_as_rich, suspension_lines, undecided_lines
from mast_zenoh.report.tables.pictures import channel_sentences, picture_sentences
from mast_zenoh.report.tables.scores import as_rich, score_table
from mast_zenoh.runs.interposers import BAD, interposers
from mast_zenoh.runs.run import Run


def show(console: Console, runs: Mapping[str, Path]) -> None:
    """Print the results of run folders by label.

    The reference is `baseline`, or else the first.
    A run without a readable metrics.json gets dashes. Runs with links or faults also get the causes of their errors;
    runs with checks get the outcome of every check.
    """
    folders = {label: Run(path) for label, path in runs.items()}
    agent = next((run.ego for run in folders.values() if run.ego), "ego")
    console.print(as_rich(score_table({label: run.files.summary for label, run in folders.items()}, agent=agent)))
    _show_causes(console, folders, agent)
    nees = nees_as_rich({label: run.files.summary for label, run in folders.items()}, agent) if len(runs) > 1 else None
    if nees is not None:
        console.print(nees)
    for label, run in folders.items():
        prefix = f"{label}: " if len(runs) > 1 else ""
        _show_lines(console, prefix, run)
        if defence := defence_sentence(run):
            console.print(escape(f"{prefix}{run.worded(defence)}"), highlight=False)


def show_run(console: Console, run_folder: Path, against: Path | None = None) -> None:
    """Print one run's results and its largest change, over a reference if given.

    Raises NotComparable if the two cannot be compared.
    """
    run = Run(run_folder)
    show_loaded(console, run, None if against is None else comparison.reference(run, against))


def show_driven(console: Console, run_folder: Path, twin: Path) -> None:
    """Print what happened to the driven cars of a run, in one line. twin: the folder of the same run without attack"""
    run = Run(run_folder)
    sentences = car_sentences(run, comparison.reference(run, twin))
    if sentences:
        console.print(escape(f"{run.name}: {'. '.join(sentences)}."), highlight=False)


def failure(run_folder: Path) -> str:
    """How a run failed, in one line; empty: it did not."""
    run = Run(run_folder)
    text, message = status(run), str(run.files.record.get("message") or "")
    return f"{text}: {message}" if text and message else text


def show_loaded(console: Console, run: Run, reference: Reference | None = None) -> None:
    """Print the results of a loaded run; see `show_run`."""
    runs = {run.name: run} if reference is None else {reference.name: reference.run, run.name: run}
    metrics = {label: each.files.summary for label, each in runs.items()}
    table = score_table(metrics, agent=run.ego or "ego", reference=reference.name if reference else None)
    console.print(as_rich(table))
    _show_causes(console, {run.name: run}, run.ego or "ego")
    _show_lines(console, "", run, reference.run if reference else None)
    if unsound := reference_status(reference):
        text = f"warning: {unsound}: the differences may be wrong"
        console.print(text, markup=False, highlight=False, style="bold yellow")
    console.print(escape(f"{headline(run, reference)}."), highlight=False, style="bold")
    if cars := car_sentences(run, reference):
        console.print(escape(f"{'. '.join(cars)}."), highlight=False)
    if defence := defence_sentence(run):
        console.print(escape(run.worded(defence)), highlight=False)


def _show_causes(console: Console, runs: Mapping[str, Run], agent: str) -> None:
    causes = causes_as_rich(
        {label: run.files.summary for label, run in runs.items() if run.faulted or run.withholds}, agent
    )
    if causes is not None:
        console.print(causes)


def _show_lines(console: Console, label: str, run: Run, reference: Run | None = None) -> None:
    """Print what interposers did, why it had limited effect, and every check."""
    lines = []
    notable = [each for each in interposers(run) if not each.is_link or each.verdict in BAD]
    why = explanations(run, reference)
    for each in notable:
        bad = f"; {each.verdict}" if each.verdict in BAD else ""
        verdict = f"; its handlers failed in {plural(each.failed_frames, 'frame')}" if each.failed_frames else bad
        measured = "not measured" if each.effects is None else effects(each)
        lines.append(f"{each.description} on {each.place}: {measured}{verdict}")
        lines += [f"  limited effect: {reason}" for reason in why.get(each.name, ()) if each.changed]
    lines += [*picture_sentences(run), *channel_sentences(run)]
    for line in (*lines, *suspension_lines(run), *undecided_lines(run), *check_lines(run.files.checks)):
        console.print(escape(f"{label}{run.worded(line)}"), highlight=False)
