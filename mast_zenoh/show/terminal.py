"""Prints the results of runs on the terminal. Loads no drawing libraries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.runs.run import Run
from mast_zenoh.show import comparison
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.findings import found_in, of_compared
from mast_zenoh.show.findings.cars import of_cars
from mast_zenoh.show.findings.results import status, unsound
from mast_zenoh.show.findings.words import defence_line, said, text
from mast_zenoh.show.tables.of_run import cause_table, check_lines, nees_table, own_messages
from mast_zenoh.show.tables.scores import score_table


def show(console: Console, runs: Mapping[str, Path]) -> None:
    """Print the results of compared run folders by label, with what their page says of each.

    The reference is `baseline`, or else the first.
    A run without a readable metrics.json gets dashes. Runs with links or faults also get the causes of their errors;
    runs with checks get the outcome of every check.
    """
    folders = {label: Run(path) for label, path in runs.items()}
    agent = next((run.ego for run in folders.values() if run.ego), "ego")
    metrics = {label: run.files.summary for label, run in folders.items()}
    reference = "baseline" if "baseline" in folders else next(iter(folders))
    console.print(score_table(folders, reference).as_rich())
    _show_causes(console, folders, agent)
    if (nees := nees_table(metrics, agent)).lines:
        console.print(nees.as_rich())
    title, sentences = of_compared(folders, Reference(folders[reference], reference))
    _print_headline(console, title)
    for each in sentences:
        console.print(escape(each), highlight=False)
    for label, run in folders.items():
        found = {name: part for name, part in found_in(run).items() if name not in ("headline", "details", "cars")}
        _show_findings(console, f"{label}: ", run, found)


def show_run(console: Console, run_folder: Path, against: Path | None = None) -> None:
    """Print one run's results and its largest change, over a reference if given.

    Raises NotComparable if the two cannot be compared.
    """
    run = Run(run_folder)
    reference = None if against is None else comparison.reference(run, against)
    show_loaded(console, run, reference, found_in(run, reference))


def show_driven(console: Console, run_folder: Path, twin: Path) -> None:
    """Print what happened to the driven cars of a run, in one line. twin: the folder of the same run without attack"""
    run = Run(run_folder)
    if happened := text(run, of_cars(run, comparison.reference(run, twin))):
        console.print(escape(f"{run.name}: {happened}."), highlight=False)


def failure(run_folder: Path) -> str:
    """How a run failed, in one line; empty: it did not."""
    run = Run(run_folder)
    failed, message = text(run, status(run)), str(run.files.record.get("message") or "")
    return f"{failed}: {message}" if failed and message else failed


def show_loaded(
    console: Console, run: Run, reference: Reference | None, found: Mapping[str, Sequence[Finding]]
) -> None:
    """Print the results of a loaded run, see `show_run`; found: as from `found_in`."""
    runs = {run.name: run} if reference is None else {reference.name: reference.run, run.name: run}
    console.print(score_table(runs, reference.name if reference else None).as_rich())
    if (messages := own_messages(run)).lines:
        console.print(messages.as_rich())
    _show_causes(console, {run.name: run}, run.ego or "ego")
    for warning in said(run, unsound(reference), capitals=False):
        line = f"warning: {warning} the differences may be wrong"
        console.print(line, markup=False, highlight=False, style="bold yellow")
    _show_findings(console, "", run, found)


def _print_headline(console: Console, headline: str) -> None:
    console.print(escape(f"{headline}."), highlight=False, style="bold")


def _show_causes(console: Console, runs: Mapping[str, Run], agent: str) -> None:
    summaries = {label: run.files.summary for label, run in runs.items() if run.faulted or run.withholds}
    if (causes := cause_table(summaries, agent)).lines:
        console.print(causes.as_rich())


#: Suspensions and undecided agents that have a line.
_MOST_JUDGED = 8


def _show_findings(console: Console, label: str, run: Run, found: Mapping[str, Sequence[Finding]]) -> None:
    """Print findings in the order of `found_in`, but for notices, and every check.

    Why an adversary had limited effect is below what it did. Of suspensions, the first _MOST_JUDGED are printed.
    """
    lines: list[str] = []
    for name, part in found.items():
        if name == "headline":
            _print_headline(console, text(run, part))
        elif name == "attacks":
            for each in part:
                lines += said(run, [each])
                why = [reason for reason in found["limits"] if each.kind == "attack" and reason.who == each.who]
                lines += [f"  limited effect: {reason}" for reason in said(run, why, capitals=False)]
        elif name == "defence":
            lines += [f"{line}." for line in [defence_line(run, part)] if line]
        elif name == "periods":
            judged = said(run, part, capitals=False)
            lines += judged[:_MOST_JUDGED]
            if len(judged) > _MOST_JUDGED:
                lines.append(f"  and {len(judged) - _MOST_JUDGED} agents more, see the report")
        elif name not in ("limits", "notices") and part:
            lines.append(f"{text(run, part)}.")
    for line in (*lines, *check_lines(run.files.checks)):
        console.print(escape(f"{label}{line}"), highlight=False)
