"""Writes the self-contained HTML pages of runs, of compared runs and of studies, with their figures as PNG."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from mast_zenoh.errors import plural
from mast_zenoh.metrics.study_results import Row, StudyFacts
from mast_zenoh.run_folder import write_bytes
from mast_zenoh.run_folder.finding import Finding, notice_lines
from mast_zenoh.runs.frame import has_boxes
from mast_zenoh.runs.interposers import BAD, WITH_COLUMN, failure_lines, interposers, node_row
from mast_zenoh.runs.run import Run
from mast_zenoh.show import comparison, findings
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.figures import of_run as figures_of_run
from mast_zenoh.show.figures.drawing import RenderedFigure
from mast_zenoh.show.figures.view import PANELS, check_frame, choose_common_frame, choose_frame, frame_view, settled
from mast_zenoh.show.findings import found_in, of_compared, of_study
from mast_zenoh.show.findings.adversaries import attacks
from mast_zenoh.show.findings.cars import of_cars
from mast_zenoh.show.findings.changes import largest_change
from mast_zenoh.show.findings.results import unsound
from mast_zenoh.show.findings.words import defence_line, said, text
from mast_zenoh.show.page.block import run_block
from mast_zenoh.show.page.page import ViewerParts, viewer_parts
from mast_zenoh.show.run_figure import FigureContext
from mast_zenoh.show.tables import of_run as tables_of_run
from mast_zenoh.show.tables.scores import score_table
from mast_zenoh.show.tables.study import difference_title, sections, side_by_side
from mast_zenoh.show.tables.text_table import TextTable
from mast_zenoh.show.tables.wiring import wire_rows
from mast_zenoh.version import __version__

#: Where a template wants its table of contents, and a heading that it lists.
_CONTENTS = "<!-- contents -->"
_SCRIPTS = re.compile(r"(<script.*?</script>)", re.DOTALL)
_HEADING = re.compile(r'<h2 id="([\w-]+)">(.*?)</h2>')


def render(template: str, content: Mapping[str, Any], folder: Path, worded: Callable[[str], str] | None = None) -> Path:
    """Write `report.html` into a folder, which is created if needed; returns the path.

    worded: changes the words of a text; scripts, whose digests the page names, stay as they are
    """
    page = page_text(template, content)
    if worded is not None:
        parts = _SCRIPTS.split(page)  # texts and scripts in turn
        page = "".join(part if index % 2 else worded(part) for index, part in enumerate(parts))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.html"
    write_bytes(path, page.encode("utf-8", "surrogateescape"))  # paths that are not UTF-8
    return path


def page_text(template: str, content: Mapping[str, Any]) -> str:
    """The page as text."""
    page = environment().get_template(template).render(content, version=__version__)
    return page.replace(_CONTENTS, _table_of_contents(page), 1)


def _table_of_contents(page: str) -> str:
    """Links to all sections of a page; empty for fewer than three."""
    links = [f'<li><a href="#{name}">{title}</a></li>' for name, title in _HEADING.findall(page)]
    return f'<nav class="contents" aria-label="contents"><ul>{"".join(links)}</ul></nav>' if len(links) > 2 else ""


@cache
def environment() -> Environment:
    """The templates of this package, with HTML escaping."""
    return Environment(
        loader=PackageLoader("mast_zenoh.show"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )


def facts(run: Run) -> list[str]:
    """What identifies a run: id, status, scene, length, seed, mode and speed."""
    record = run.files.record
    facts = [f"run {record['id']}"] if "id" in record else []
    facts += [str(record["status"])] if "status" in record else []
    facts += [f"scene {run.files.scene.name}"] if run.files.scene else []
    facts += [_frames_in_words(run)] if "frames" in run.files.summary else []
    facts += [f"seed {record['seed']}"] if "seed" in record else []
    every = run.files.sample.step
    facts += [f"boxes and causes of one frame in {every}, scores of all"] if every > 1 else []
    facts += [_origin(record["replay"])] if record.get("replay") else []
    facts += [f"{record['mode']} on {record.get('runtime', 'mesh')}"] if "mode" in record else []
    speed = record.get("timings", {}).get("frames_per_second")
    facts += [f"{speed:.0f} frames/s"] if speed else []
    latency = run.files.summary.get("latency_ms", {}).get("sim_to_picture", {})
    if latency.get("p50") is not None and latency.get("p99"):  # lock-step has no latency: scene time stands still
        facts.append(f"simulator to picture {latency['p50']:.1f} ms (99 %: {latency['p99']:.1f} ms)")
    ages = run.files.summary.get("picture_age_s", {})
    age = ages.get("ego", next(iter(ages.values()), {}))
    facts += [f"pictures used at an age of {age['mean']:.2f} s (at most {age['max']:.2f} s)"] if age.get("max") else []
    return facts


def _security(run: Run) -> str:
    """The security level of a run on a mesh, and how many control messages were obeyed without a signature."""
    level, unsigned = run.files.record.get("security"), run.files.record.get("unsigned_control")
    if not level or run.files.record.get("runtime") != "mesh":
        return ""
    obeyed = f"; {unsigned} control messages were obeyed without a signature" if unsigned else ""
    return f"Security level {level}{obeyed}."


def _origin(replay: Mapping[str, Any]) -> str:
    """What a replay replays."""
    changed = ", ".join(f"{node} ({', '.join(keys)})" for node, keys in replay.get("changed", {}).items())
    return f"replay of run {replay.get('run')} from the {replay.get('from')}" + (
        f", changed: {changed}" if changed else ""
    )


def healing(run: Run) -> list[str]:
    """When faults healed, and how soon the picture then equalled the fault-free one."""
    heals, converged = run.files.checks.get("heals_s") or [], run.files.checks.get("converged_after_s")
    facts = [f"healed at {', '.join(f'{each:g}' for each in heals)} s"] if heals else []
    if isinstance(converged, (int, float)):
        facts.append(f"the picture converged to the unfaulted one {converged:.1f} s after the heal")
    return facts


def facts_of_compared(runs: Mapping[str, Run]) -> list[str]:
    """What compared runs have in common, and which of them failed; runs: by label."""
    facts = [f"{len(runs)} runs"]
    scenes = {run.files.scene.name for run in runs.values() if run.files.scene}
    seeds = {str(run.files.record["seed"]) for run in runs.values() if "seed" in run.files.record}
    frames = {_frames_in_words(run) for run in runs.values() if "frames" in run.files.summary}
    facts += [f"scene {', '.join(sorted(scenes))}"] if scenes else []
    facts += [f"seed {', '.join(sorted(seeds))}"] if seeds else []
    facts += [f"each {frames.pop()}"] if len(frames) == 1 else []
    bad = [label for label, run in runs.items() if run.files.record.get("status") != "ok"]
    return facts + ([f"did not end well: {', '.join(bad)}"] if bad else [])


def _frames_in_words(run: Run) -> str:
    scored = run.files.summary.get("scored_frames")
    return f"{run.files.summary['frames']} frames" + (f", scored from {scored[0]} to {scored[-1]}" if scored else "")


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
    run = Run(run_folder, frame)
    return write_page(run, frame, None if against is None else comparison.reference(run, against), figures)


def write_page(
    run: Run,
    frame: int | None = None,
    reference: Reference | None = None,
    figures: Sequence[Path] = (),
    found: Mapping[str, Sequence[Finding]] | None = None,
) -> Path:
    """Write the report of a loaded run, see `write_report`; found: its findings, as from `found_in`, if known."""
    estimate = _estimate(run, reference)
    if frame is None:
        chosen = choose_frame(run, reference.run if reference else None, estimate)
        frame_note = figures_of_run.frame_choice(run, estimate, reference.name if reference else "")
    else:
        chosen, frame_note = check_frame(run, frame), ""
        if not settled(run, np.array([frame])).all():
            frame_note = "This frame was requested; it is not a scored frame."
    view = None if chosen is None else frame_view(run, chosen, estimate)
    found = found_in(run, reference) if found is None else found
    return _write_run(FigureContext(run, view, frame_note, reference, estimate), found, figures)[1]


def _estimate(run: Run, reference: Reference | None) -> str:
    """The ego's estimate with the largest change, if it has boxes, else the picture."""
    change = largest_change(run, reference)
    drawable = change is not None and change.agent == run.ego and has_boxes(run, change.estimate)
    return change.estimate if change is not None and drawable else "picture"


def write_study_report(study_folder: Path, runs: Mapping[str, Path], driven: tuple[Path, Path] | None = None) -> Path:
    """Write the report of compared runs and each run's own report.

    The former goes into `study_folder`.

    runs:  folders of runs of one scene and seed by label, in the order to show them; the one labelled `baseline`,
           or else the first, is what the others are compared with
    driven: folders of a run with drivers and of its unattacked twin, which are not among the compared ones
    Returns the path of the report. Raises RunFolderError like `write_report`.
    """
    folders = {label: Run(path) for label, path in runs.items()}
    reference = "baseline" if "baseline" in folders else next(iter(folders))
    over = Reference(folders[reference], reference)
    largest_changes = [largest_change(run, over) for run in folders.values()]
    change = max((each for each in largest_changes if each), key=lambda each: abs(each.weight), default=None)
    estimate = change.estimate if change and change.estimate in PANELS else "mission" if change else "picture"
    chosen = choose_common_frame(list(folders.values()), folders[reference], estimate)
    frames = {label: choose_frame(run) if chosen is None else chosen for label, run in folders.items()}
    frame_views = {label: frame_view(folders[label], each) for label, each in frames.items() if each is not None}
    table = score_table(folders, reference)
    title, sentences = of_compared(folders, over)
    pages: list[dict[str, Any]] = []
    for label, run in folders.items():
        page, path = _write_run(FigureContext(run, frame_views.get(label)), found_in(run), study=study_folder)
        link = _relative(path, study_folder)
        pages.append({"label": label, "anchor": f"run-{len(pages) + 1}", "link": link} | page)
    views = {label: view for label, view in frame_views.items() if view is not None}
    if any(estimate not in view.boxes for view in views.values()):  # of an older run
        estimate = "picture"
    figures = figures_of_run.study_figures(folders, table, views, estimate)
    car, car_figures = _driven(driven)
    figures |= car_figures
    for each in figures.values():
        each.save(study_folder / "figures")
    viewer, problems = _viewer(dict(list(folders.items())[:_MOST_IN_VIEWER]), chosen)
    content = {
        "title": "Runs compared",
        "viewer": viewer,
        "problems": problems,
        "headline": title,
        "reading": sentences,
        "facts": facts_of_compared(folders),
        "figures": figures,
        "scores": table,
        "nees": tables_of_run.nees_table(
            {label: run.files.summary for label, run in folders.items()},
            next((run.ego for run in folders.values() if run.ego), "ego"),
        ),
        "car": car,
        "pages": pages,
    }
    return render("study.html.j2", content, study_folder)


def _driven(folders: tuple[Path, Path] | None) -> tuple[list[str], dict[str, RenderedFigure]]:
    """What happened to the car of a run with drivers, in sentences, and its figure; both empty without such a run."""
    if folders is None:
        return [], {}
    run = Run(folders[0])
    reference = comparison.reference(run, folders[1])
    drawn = figures_of_run.rendered(figures_of_run.Driven(), FigureContext(run, None, reference=reference))
    happened = [*attacks(run), *of_cars(run, reference)]
    return [f"{each}." for each in said(run, happened)], {} if drawn is None else {drawn.name: drawn}


def _write_run(
    context: FigureContext,
    found: Mapping[str, Sequence[Finding]],
    files: Sequence[Path] = (),
    study: Path | None = None,
) -> tuple[dict[str, Any], Path]:
    """Write a run's own report; returns its content and path.

    found: its findings
    study: the folder of the study that the report links back to
    """
    run, reference = context.run, context.reference
    figures, own = figures_of_run.run_figures(context), figures_of_run.user_figures(context, files)
    runs = {reference.name: reference.run, run.name: run} if reference is not None else {run.name: run}
    scores = score_table(runs, reference.name if reference else None)
    for each in figures.values():
        each.save(run.path / "figures")
    figures_of_run.save_user_figures(own, run.path / "figures")
    shown_runs = {run.name: run} | ({reference.name: reference.run} if reference is not None else {})
    viewer, problems = _viewer(shown_runs, context.view.index if context.view else None)
    beside = (reference.run, reference.name) if reference else ()
    content = {
        "title": f"Run {run.files.record.get('id', run.name)}",
        "headline": text(run, found["headline"]),
        "attack": _first(said(run, found["attacks"])),
        "reading": text(run, found["details"]),
        "facts": facts(run) + ([f"compared with {reference.name}"] if reference else []),
        "status": run.files.record.get("status", "unknown"),
        "message": run.files.record.get("message"),
        "failures": failure_lines(run),
        "reference_status": text(run, unsound(reference)).removesuffix(":"),
        "notices": notice_lines(run.files.record),
        "missing": (*run.files.missing, *problems),
        "back": _relative(study / "report.html", run.path) if study is not None else None,
        "viewer": viewer,
        "figures": figures,
        "user_figures": own,
        "scores": scores if run.files.summary else None,
        "messages": tables_of_run.message_table(run),
        "confidence": tables_of_run.confidence_tables(run),
        "pictures": tables_of_run.picture_table(run),
        "of_pictures": text(run, found["pictures"]),
        "interposers": interposers(run),
        "suspensions": tables_of_run.suspension_table(run),
        "undecided": tables_of_run.undecided_table(run),
        "conduct": tables_of_run.conduct_table(run),
        "trust": defence_line(run, found["defence"]),
        "achieved": tables_of_run.achieved_table(run, found["limits"]),
        "limited": [(each.who[0], *said(run, [each], capitals=False)) for each in found["limits"]],
        "driven": tables_of_run.driven_table(run, *beside),
        "cars": text(run, found["cars"]),
        "driving": tables_of_run.driving_table(run, *beside),
        "effects": WITH_COLUMN,
        "bad_verdicts": BAD,
        "results": run.files.results,
        "blame": tables_of_run.cause_table({run.name: run.files.summary}) if run.faulted or run.withholds else None,
        "checks": tables_of_run.check_table(run.files.checks),
        "healed": healing(run),
        "latency": tables_of_run.latency_tables(run.files.summary),
        "wires": wire_rows(run),
        "security": _security(run),
        "nodes": [(name, node_row(run, name)) for name in run.files.record.get("nodes", {})],
        "command": _command(run),
        "versions": run.files.record.get("versions", {}),
        "scenario": json.dumps(run.files.scenario, indent=2) if run.files.scenario else None,
        "timings": json.dumps(run.files.record["timings"], indent=2) if run.files.record.get("timings") else None,
    }
    findings.write(run, found)
    return content, render("run.html.j2", content, run.path, run.worded)


#: Adversaries that the first paragraph of a page describes; the table has all.
_MOST_DESCRIBED = 3


def _first(sentences: list[str]) -> str:
    more = f" {len(sentences) - _MOST_DESCRIBED} more are in the table of interposers."
    return ". ".join(sentences[:_MOST_DESCRIBED]) + "." + more * (len(sentences) > _MOST_DESCRIBED)


def _relative(path: Path, folder: Path) -> str:
    """The link to a file from a page in a folder."""
    return quote(os.path.relpath(path, folder).replace(os.sep, "/"))


def _viewer(runs: Mapping[str, Run], frame: int | None) -> tuple[ViewerParts | None, tuple[str, ...]]:
    """The moving picture of runs by label (None: nothing to show), and why it is left out."""
    try:
        blocks = [block for label, run in runs.items() if (block := run_block(run, frame, label))]
    except ValueError as error:
        return None, (f"The viewer is left out: {error}.",)
    return viewer_parts(blocks) if blocks else None, ()


def _command(run: Run) -> str | None:
    command = run.files.record.get("command")
    return shlex.join(map(str, command)) if isinstance(command, list) else command


#: Files of the study's folder that the page links to, if they are there.
_STUDY_FILES = (
    *("search.md", "search.csv", "candidates.csv", "search.json"),
    *("table.csv", "table.md", "table.tex", "results.parquet", "frames.parquet"),
)
#: This many failed trials are listed; the others are collapsed.
_SHOWN_AT_ONCE = 10


def write_trials_page(
    folder: Path,
    rows: Sequence[Row],
    facts: StudyFacts,
    figures: Mapping[str, RenderedFigure],
    tables: Sequence[TextTable] = (),
    own_headline: str = "",
    own_reading: Sequence[str] = (),
) -> Path:
    """Write `report.html` into the folder of a study, and return its path.

    figures: of `figures_over_trials`, by name;  tables: of a study of defences
    own_headline, own_reading: what comes before errors of estimates, such as what happened to driven cars; or empty.
                  Errors are then described above their tables
    """
    rows, facts = of_study.titled(rows, facts)
    comparisons = of_study.compare(rows, facts.baseline)
    parts = sections(rows, facts, comparisons)
    said_first = of_study.conclusions(rows, facts, comparisons, own_headline, own_reading)
    scores, title = side_by_side(rows), difference_title(rows, facts.baseline)
    content = {
        "title": f"Study {facts.name}",
        "headline": said_first.headline,
        "facts": _study_facts(facts),
        "failures": facts.failures,
        "failed": facts.failed,
        "shown_at_once": _SHOWN_AT_ONCE,
        "reservations": of_study.reservations(rows, facts),
        "reading": said_first.reading,
        "errors": said_first.errors,
        "figures": figures,
        "added": parts.added,
        "added_title": f"{title}: errors of estimates" if own_reading else title,
        "own_tables": tables,
        "comparisons": of_study.comparisons_made(comparisons),
        "scores": scores if scores.lines else None,
        "others": parts.others,
        "configurations": [
            (label, scenario, settings, facts.done.get(label, 0), facts.planned)
            for label, (scenario, settings) in facts.configurations.items()
        ],
        "baseline": facts.baseline,
        "scenes": facts.scenes,
        "tables": [name for name in _STUDY_FILES if (folder / name).is_file()],
        "environment": facts.environment,
    }
    return render("study_trials.html.j2", content, folder)


def _study_facts(facts: StudyFacts) -> list[str]:
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
